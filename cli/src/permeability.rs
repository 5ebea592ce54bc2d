//! `porograin permeability`.

use crate::arguments::{self, Axis, Corners, Permeability, Sides};
use crate::{Failure, Outcome};
use glam::DVec3;
use porograin::Slip;
use porograin::import::{self, Spheres};
use porograin::output::frame::pore_mesh;
use porograin::output::vtk::{self, Field, Values};
use porograin::permeability::{Outcome as Flow, Problem, measure};
use porograin::pores::{Conductance, Solver};
use porograin_geometry::Cell;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::Path;

/// Relative residual of the pressure solve.
pub const RESIDUAL: f64 = 1e-10;

/// `porograin permeability`.
pub fn permeability(arguments: &Permeability) -> Outcome {
    let problem = problem(arguments)?;
    let (cell, spheres) = packing(&arguments.grains, arguments.packing.corners)?;
    let flow = measure(&cell, &spheres.position, &spheres.radius, &problem)
        .map_err(|e| Failure::Run(e.to_string()))?;
    if let Some(path) = &arguments.forces {
        write_forces(path, &flow)?;
    }
    if let Some(path) = &arguments.vtk {
        write_vtk(path, &cell, &spheres, &flow)?;
    }
    eprintln!(
        "permeability {:.6e} m2, porosity {:.4}, {} pores, {} throats",
        flow.permeability, flow.porosity, flow.mesh.census.pores, flow.mesh.census.throats
    );
    Ok(Some(object(&flow)))
}

fn problem(arguments: &Permeability) -> Result<Problem, Failure> {
    if arguments.alpha.is_some() && !matches!(arguments.conductance, arguments::Conductance::HydraulicRadius)
    {
        return Err(Failure::Input("--alpha belongs to --conductance hydraulic-radius".into()));
    }
    let conductance = match arguments.conductance {
        arguments::Conductance::HydraulicRadius => match arguments.alpha {
            Some(alpha) => Conductance::HydraulicRadius { alpha },
            None => Conductance::hydraulic_radius(),
        },
        arguments::Conductance::EffectiveRadius => Conductance::EffectiveRadius,
        arguments::Conductance::LocalDrag => Conductance::LocalDrag,
    };
    Ok(Problem {
        axis: match arguments.axis {
            Axis::X => 0,
            Axis::Y => 1,
            Axis::Z => 2,
        },
        drop: arguments.drop,
        sides: match arguments.sides {
            Sides::Symmetry => Slip::Symmetry,
            Sides::NoSlip => Slip::NoSlip,
        },
        viscosity: arguments.viscosity,
        conductance,
        solver: match arguments.solver {
            arguments::Solver::Auto => Solver::Auto,
            arguments::Solver::Cholesky => Solver::Cholesky,
            arguments::Solver::Cg => Solver::Cg,
            arguments::Solver::GaussSeidel => Solver::GaussSeidel,
        },
        residual: RESIDUAL,
    })
}

/// Reads the grains and checks them against the box.
pub fn packing(path: &Path, Corners(lower, upper): Corners) -> Result<(Cell, Spheres), Failure> {
    let name = path.display().to_string();
    let text = import::read(path).map_err(|e| Failure::Input(e.to_string()))?;
    let spheres = import::spheres(&name, &text).map_err(|e| Failure::Input(e.to_string()))?;
    let (lower, upper) = (DVec3::from_array(lower), DVec3::from_array(upper));
    spheres.within(&name, &text, lower, upper).map_err(|e| Failure::Input(e.to_string()))?;
    Ok((Cell::walled(lower, upper), spheres))
}

fn write_forces(path: &Path, flow: &Flow) -> Result<(), Failure> {
    let mut text = String::new();
    for (force, torque) in flow.loads.force.iter().zip(&flow.loads.torque) {
        let _ = writeln!(
            text,
            "{:e},{:e},{:e},{:e},{:e},{:e}",
            force.x, force.y, force.z, torque.x, torque.y, torque.z
        );
    }
    std::fs::write(path, text).map_err(|e| Failure::Input(format!("cannot write {}: {e}", path.display())))
}

/// Grains and pores for ParaView.
fn write_vtk(folder: &Path, cell: &Cell, spheres: &Spheres, flow: &Flow) -> Result<(), Failure> {
    let grains = vtk::points(
        &spheres.position,
        &[
            Field { name: "radius [m]", values: Values::Scalars(&spheres.radius) },
            Field { name: "fluid force [N]", values: Values::Vectors(&flow.loads.force) },
            Field { name: "fluid torque [N m]", values: Values::Vectors(&flow.loads.torque) },
        ],
    );
    let pores = vtk::mesh(&pore_mesh(&flow.mesh, &spheres.position, cell, &flow.pressure));
    let write = || {
        std::fs::create_dir_all(folder)?;
        std::fs::write(folder.join("grains.vtp"), grains)?;
        std::fs::write(folder.join("pores.vtu"), pores)
    };
    write().map_err(|e| Failure::Input(format!("cannot write into {}: {e}", folder.display())))
}

/// The object that `--json` prints.
pub fn object(flow: &Flow) -> Value {
    let walls: Vec<[f64; 3]> = flow.loads.wall.iter().map(|f| f.to_array()).collect();
    json!({
        "permeability": flow.permeability,
        "inflow": flow.inflow,
        "outflow": flow.outflow,
        "porosity": flow.porosity,
        "pores": flow.mesh.census.pores,
        "throats": flow.mesh.census.throats,
        "pressure_profile": flow.pressure_profile,
        "force_sum": flow.force_sum.to_array(),
        "wall_forces": walls,
        "seconds": {
            "triangulation": flow.seconds.triangulation,
            "conductance": flow.seconds.conductance,
            "solve": flow.seconds.solve,
        },
        "residual": flow.residual,
        "iterations": flow.iterations,
        "merged": flow.mesh.census.merged,
        "closed": flow.mesh.census.closed,
        "clamped": flow.mesh.census.clamped,
    })
}

//! `porograin permeability`.

use crate::arguments::{self, Axis, Corners, Lattice, Permeability, Region, Sides};
use crate::{Failure, Outcome};
use glam::{DMat3, DVec3};
use porograin::case::reason;
use porograin::import::{self, Spheres};
use porograin::measure::{PoreFlow, Sensor, Site, Walk};
use porograin::output::frame::{edges, pore_mesh, throats};
use porograin::output::replace;
use porograin::output::table::number;
use porograin::output::vtk::{self, Field, PoreMesh, Values};
use porograin::permeability::{
    Flow, Outcome as Walled, PeriodicOutcome, PeriodicProblem, Problem, Seconds, measure, measure_periodic,
    outflow,
};
use porograin::pores::{Conductance, Coupling, Solver};
use porograin::{Loads, Slip};
use porograin_geometry::Cell;
use porograin_geometry::throat::Packing;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::Path;

/// Relative residual of the pressure solve.
pub const RESIDUAL: f64 = 1e-10;

/// `porograin permeability`.
pub fn permeability(arguments: &Permeability) -> Outcome {
    for (key, path) in [("forces", &arguments.forces), ("fields", &arguments.fields)] {
        for read in [Some(&arguments.grains), arguments.at.as_ref()].into_iter().flatten() {
            if path.as_ref().is_some_and(|path| same_file(path, read)) {
                return Err(Failure::Input(format!(
                    "--{key} would write over {}, which is read: name another file",
                    read.display()
                )));
            }
        }
    }
    let (cell, spheres) = match &arguments.region {
        Region { corners: Some(corners), .. } => packing(&arguments.grains, *corners)?,
        Region { period: Some(lattice), .. } | Region { lattice: Some(lattice), .. } => {
            periodic_packing(&arguments.grains, *lattice)?
        }
        _ => return Err(Failure::Input("the box or the period of the grains is needed".into())),
    };
    let axes = match arguments.axis {
        Axis::X => vec![0],
        Axis::Y => vec![1],
        Axis::Z => vec![2],
        Axis::All => vec![0, 1, 2],
    };
    if cell.periodic == [true; 3] {
        periodic(arguments, &cell, &spheres, &axes)
    } else {
        walled(arguments, &cell, &spheres, &axes)
    }
}

fn walled(arguments: &Permeability, cell: &Cell, spheres: &Spheres, axes: &[usize]) -> Outcome {
    let (mut flows, mut columns) = (Vec::new(), Vec::new());
    let places = places(arguments)?;
    for &axis in axes {
        let problem = problem(arguments, axis)?;
        let flow = measure(cell, &spheres.position, &spheres.radius, &problem)
            .map_err(|e| Failure::Run(e.to_string()))?;
        let packing = Packing { cell, position: &spheres.position, radius: &spheres.radius };
        let site = Site::new(packing, &flow.mesh);
        if let Some(path) = &arguments.vtk {
            let pores = pore_mesh(&flow.mesh, &spheres.position, cell, &flow.pressure);
            write_vtk(
                &folder_of(path, axis, axes),
                &site,
                &flow.loads,
                pores,
                &Moving::walled(&site, &flow),
            )?;
        }
        if let Some(places) = &places {
            columns.push(sensed(&site, &flow.pressure, &Moving::walled(&site, &flow), DVec3::ZERO, places));
        }
        say!(
            "permeability {:.6e} m2 along {}, porosity {:.4}, {} pores, {} throats",
            flow.permeability,
            AXES[axis],
            flow.porosity,
            flow.mesh.census.pores,
            flow.mesh.census.throats
        );
        flows.push(flow);
    }
    if let (Some(path), Some(places)) = (&arguments.fields, &places) {
        write_fields(path, places, &columns, axes)?;
    }
    if let Some(path) = &arguments.forces {
        write_forces(path, &flows.iter().map(|flow| &flow.loads).collect::<Vec<_>>())?;
    }
    Ok(Some(match &flows[..] {
        [flow] => object(flow),
        all => json!({
            "permeability": all.iter().map(|flow| flow.permeability).collect::<Vec<_>>(),
            "porosity": all[0].porosity,
            "flows": all.iter().map(object).collect::<Vec<_>>(),
        }),
    }))
}

fn periodic(arguments: &Permeability, cell: &Cell, spheres: &Spheres, axes: &[usize]) -> Outcome {
    let problem = PeriodicProblem {
        slope: arguments.slope,
        viscosity: arguments.viscosity,
        conductance: conductance(arguments)?,
        coupling: coupling(arguments),
        solver: solver(arguments),
        residual: RESIDUAL,
    };
    let found = measure_periodic(cell, &spheres.position, &spheres.radius, &problem)
        .map_err(|e| Failure::Run(e.to_string()))?;
    if let Some(path) = &arguments.forces {
        write_forces(path, &axes.iter().map(|&axis| &found.flows[axis].loads).collect::<Vec<_>>())?;
    }
    let packing = Packing { cell, position: &found.position, radius: &spheres.radius };
    let site = Site::new(packing, &found.mesh);
    let (mut columns, places) = (Vec::new(), places(arguments)?);
    for &axis in axes {
        let flow = &found.flows[axis];
        let local = found.mesh.pore_pressure(flow.gradient, &flow.pressure);
        if let Some(places) = &places {
            // What has the period of the cell; sensors add the rest.
            let mut beside = vec![0.0; found.mesh.nodes()];
            for (pore, &node) in found.mesh.node.iter().enumerate() {
                beside[node as usize] = local[pore] - flow.gradient.dot(site.centre[pore] - cell.origin);
            }
            columns.push(sensed(&site, &beside, &Moving::periodic(&site, flow), flow.gradient, places));
        }
        if let Some(path) = &arguments.vtk {
            let mut pores = pore_mesh(&found.mesh, &found.position, cell, &flow.pressure);
            pores.scalars = vec![("pressure [Pa]".into(), local)];
            let moving = Moving::periodic(&site, flow);
            write_vtk(&folder_of(path, axis, axes), &site, &flow.loads, pores, &moving)?;
        }
    }
    if let (Some(path), Some(places)) = (&arguments.fields, &places) {
        write_fields(path, places, &columns, axes)?;
    }
    say!("permeability [m2], {} pores, {} throats:", found.mesh.census.pores, found.mesh.census.throats);
    for row in rows(found.tensor) {
        say!("  {:14.6e} {:14.6e} {:14.6e}", row[0], row[1], row[2]);
    }
    say!("porosity {:.4}; pressures: {LEVEL}", found.porosity);
    Ok(Some(periodic_object(&found, cell, axes)))
}

/// What fixes the level of the pressures in a periodic cell, where no face does.
const LEVEL: &str = "their level is free, fixed at a mean of zero once the gradient is taken out";

const AXES: [&str; 3] = ["x", "y", "z"];

fn rows(tensor: DMat3) -> [[f64; 3]; 3] {
    tensor.transpose().to_cols_array_2d()
}

fn problem(arguments: &Permeability, axis: usize) -> Result<Problem, Failure> {
    Ok(Problem {
        axis,
        drop: arguments.drop,
        sides: match arguments.sides {
            Sides::Symmetry => Slip::Symmetry,
            Sides::NoSlip => Slip::NoSlip,
        },
        viscosity: arguments.viscosity,
        conductance: conductance(arguments)?,
        coupling: coupling(arguments),
        solver: solver(arguments),
        residual: RESIDUAL,
    })
}

fn conductance(arguments: &Permeability) -> Result<Conductance, Failure> {
    if arguments.alpha.is_some() && !matches!(arguments.conductance, arguments::Conductance::HydraulicRadius)
    {
        return Err(Failure::Input("--alpha belongs to --conductance hydraulic-radius".into()));
    }
    Ok(match arguments.conductance {
        arguments::Conductance::HydraulicRadius => match arguments.alpha {
            Some(alpha) => Conductance::HydraulicRadius { alpha },
            None => Conductance::hydraulic_radius(),
        },
        arguments::Conductance::EffectiveRadius => Conductance::EffectiveRadius,
        arguments::Conductance::LocalDrag => Conductance::LocalDrag,
    })
}

fn coupling(arguments: &Permeability) -> Coupling {
    match arguments.coupling {
        arguments::Coupling::Reciprocal => Coupling::Reciprocal,
        arguments::Coupling::Geometric => Coupling::Geometric,
    }
}

fn solver(arguments: &Permeability) -> Solver {
    match arguments.solver {
        arguments::Solver::Auto => Solver::Auto,
        arguments::Solver::Cholesky => Solver::Cholesky,
        arguments::Solver::Cg => Solver::Cg,
        arguments::Solver::GaussSeidel => Solver::GaussSeidel,
    }
}

/// Reads the grains and checks them against the box.
pub fn packing(path: &Path, Corners(lower, upper): Corners) -> Result<(Cell, Spheres), Failure> {
    let (lower, upper) = (DVec3::from_array(lower), DVec3::from_array(upper));
    let spheres = read(path, |spheres, name, text| spheres.within(name, text, lower, upper))?;
    Ok((Cell::walled(lower, upper), spheres))
}

/// Reads the grains and checks them against the period.
fn periodic_packing(path: &Path, Lattice(edges): Lattice) -> Result<(Cell, Spheres), Failure> {
    let cell = Cell::periodic(DVec3::ZERO, DMat3::from_cols_array_2d(&edges));
    let spheres = read(path, |spheres, name, text| spheres.within_period(name, text, &cell))?;
    Ok((cell, spheres))
}

fn read(
    path: &Path,
    check: impl Fn(&Spheres, &str, &str) -> Result<(), porograin::case::CaseError>,
) -> Result<Spheres, Failure> {
    let name = path.display().to_string();
    let text = import::read(path).map_err(|e| Failure::Input(e.to_string()))?;
    let spheres = import::spheres(&name, &text).map_err(|e| Failure::Input(e.to_string()))?;
    check(&spheres, &name, &text).map_err(|e| Failure::Input(e.to_string()))?;
    Ok(spheres)
}

fn write_forces(path: &Path, flows: &[&Loads]) -> Result<(), Failure> {
    let mut text = String::new();
    for grain in 0..flows.first().map_or(0, |loads| loads.force.len()) {
        let numbers = flows.iter().flat_map(|l| [l.force[grain], l.torque[grain]]).flat_map(|v| v.to_array());
        let line: Vec<String> = numbers.map(|x| format!("{x:e}")).collect();
        let _ = writeln!(text, "{}", line.join(","));
    }
    replace(path, text.as_bytes())
        .map_err(|e| Failure::Input(format!("cannot write {}: {}", path.display(), reason(&e))))
}

fn same_file(a: &Path, b: &Path) -> bool {
    a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b))
}

/// The folder of the flow along `axis`.
fn folder_of(folder: &Path, axis: usize, axes: &[usize]) -> std::path::PathBuf {
    if axes.len() > 1 { folder.join(AXES[axis]) } else { folder.to_owned() }
}

/// How the water moves between grains at rest.
struct Moving {
    /// Through each link [m³/s].
    flux: Vec<f64>,
    /// In each pore [m/s].
    velocity: Vec<DVec3>,
    /// Around each grain [m/s].
    around: Vec<DVec3>,
}

impl Moving {
    fn walled(site: &Site, flow: &Walled) -> Moving {
        let flux = flow.mesh.link_fluxes(DVec3::ZERO, &flow.pressure);
        Moving::new(site, flux, &outflow(&flow.mesh, &flow.pressure), flow.mesh.open)
    }

    fn periodic(site: &Site, flow: &Flow) -> Moving {
        let flux = site.mesh.link_fluxes(flow.gradient, &flow.pressure);
        Moving::new(site, flux, &vec![0.0; site.mesh.nodes()], [false; 6])
    }

    fn new(site: &Site, flux: Vec<f64>, entering: &[f64], open: [bool; 6]) -> Moving {
        let rest = vec![DVec3::ZERO; site.packing.position.len()];
        let walk = Walk { grain: &rest, wall: [DVec3::ZERO; 6], gradient: DMat3::ZERO };
        let flow = PoreFlow::new(site, &flux, entering, open);
        let velocity = flow.velocity(site, &walk);
        let around = flow.around_grains(site, &walk, &velocity);
        Moving { flux, velocity, around }
    }
}

/// The places at which to tell of the water.
fn places(arguments: &Permeability) -> Result<Option<Vec<DVec3>>, Failure> {
    let Some(path) = &arguments.at else { return Ok(None) };
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path)
        .map_err(|e| Failure::Input(format!("cannot read the places in {name}: {}", reason(&e))))?;
    let places = import::places(&name, &text);
    places.map(Some).map_err(|e| Failure::Input(e.to_string()))
}

/// Pressure and velocity at each place; `None` where there is no water to ask. `pressure` is that of the nodes, less its
/// macroscopic part.
fn sensed(
    site: &Site,
    pressure: &[f64],
    moving: &Moving,
    gradient: DVec3,
    places: &[DVec3],
) -> Vec<Option<[f64; 4]>> {
    let mut sensor = Sensor::new(site, pressure);
    let at = |&x: &DVec3| {
        let found = sensor.at(x)?;
        let u = moving.velocity[found.pore];
        Some([found.pressure + gradient.dot(x - site.packing.cell.origin), u.x, u.y, u.z])
    };
    places.iter().map(at).collect()
}

/// Writes what was found at the places; `columns` has the numbers of each flow.
fn write_fields(
    path: &Path,
    places: &[DVec3],
    columns: &[Vec<Option<[f64; 4]>>],
    axes: &[usize],
) -> Result<(), Failure> {
    let mut text = String::from("x [m],y [m],z [m]");
    for &axis in axes {
        let flow = if axes.len() > 1 { format!("_flow_{}", AXES[axis]) } else { String::new() };
        let _ = write!(text, ",pressure{flow} [Pa]");
        AXES.iter().for_each(|along| text += &format!(",velocity_{along}{flow} [m/s]"));
    }
    for (k, x) in places.iter().enumerate() {
        let _ = write!(text, "\n{},{},{}", number(x.x), number(x.y), number(x.z));
        for column in columns {
            match column[k] {
                Some(found) => found.iter().for_each(|&value| text += &format!(",{}", number(value))),
                None => text.push_str(",,,,"),
            }
        }
    }
    text.push('\n');
    replace(path, text.as_bytes())
        .map_err(|e| Failure::Input(format!("cannot write {}: {}", path.display(), reason(&e))))
}

/// Grains, pores, throats and Voronoi edges for ParaView.
fn write_vtk(
    folder: &Path,
    site: &Site,
    loads: &Loads,
    mut pores: PoreMesh,
    moving: &Moving,
) -> Result<(), Failure> {
    let grains = vtk::points(
        site.packing.position,
        &[
            Field { name: "radius [m]", values: Values::Scalars(site.packing.radius) },
            Field { name: "fluid velocity [m/s]", values: Values::Vectors(&moving.around) },
            Field { name: "fluid force [N]", values: Values::Vectors(&loads.force) },
            Field { name: "fluid torque [N m]", values: Values::Vectors(&loads.torque) },
        ],
    );
    pores.vectors.push(("velocity [m/s]".into(), moving.velocity.clone()));
    let write = || {
        std::fs::create_dir_all(folder)?;
        replace(&folder.join("grains.vtp"), &grains)?;
        replace(&folder.join("throats.vtp"), &throats(site, &moving.flux))?;
        replace(&folder.join("edges.vtp"), &edges(site, &moving.flux))?;
        replace(&folder.join("pores.vtu"), &vtk::mesh(&pores))
    };
    write().map_err(|e| Failure::Input(format!("cannot write into {}: {}", folder.display(), reason(&e))))
}

/// The object that `--json` prints for a box.
pub fn object(flow: &Walled) -> Value {
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
        "seconds": seconds(&flow.seconds),
        "residual": flow.residual,
        "iterations": flow.iterations,
        "merged": flow.mesh.census.merged,
        "closed": flow.mesh.census.closed,
        "clamped": flow.mesh.census.clamped,
    })
}

/// The object that `--json` prints for a periodic cell; what belongs to a flow is a list of three with `--axis all`.
fn periodic_object(found: &PeriodicOutcome, cell: &Cell, axes: &[usize]) -> Value {
    let each = |of: &dyn Fn(usize) -> Value| match axes {
        [axis] => of(*axis),
        all => all.iter().map(|&axis| of(axis)).collect(),
    };
    let vector = |v: DVec3| json!(v.to_array());
    let flow = |axis: usize| &found.flows[axis];
    json!({
        "permeability": each(&|axis| found.tensor.col(axis)[axis].into()),
        "permeability_tensor": rows(found.tensor),
        "gradient": each(&|axis| vector(flow(axis).gradient)),
        "mean_velocity": each(&|axis| vector(flow(axis).mean_velocity)),
        "force_sum": each(&|axis| vector(flow(axis).force_sum)),
        "flux_imbalance": each(&|axis| flow(axis).imbalance.into()),
        "residual": each(&|axis| flow(axis).residual.into()),
        "iterations": each(&|axis| flow(axis).iterations.into()),
        "porosity": found.porosity,
        "volume": cell.volume(),
        "pores": found.mesh.census.pores,
        "throats": found.mesh.census.throats,
        "merged": found.mesh.census.merged,
        "closed": found.mesh.census.closed,
        "pressure_level": LEVEL,
        "seconds": seconds(&found.seconds),
        "clamped": found.mesh.census.clamped,
    })
}

fn seconds(seconds: &Seconds) -> Value {
    json!({
        "triangulation": seconds.triangulation,
        "conductance": seconds.conductance,
        "solve": seconds.solve,
    })
}

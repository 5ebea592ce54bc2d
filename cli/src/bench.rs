//! `porograin bench`.

use crate::arguments::{Bench, Law, What};
use crate::permeability::{RESIDUAL, object, packing};
use crate::{Failure, Outcome, threads};
use porograin::bench;
use porograin::import::Spheres;
use porograin::permeability::{Outcome as Flow, Problem, measure};
use porograin::pores::{Conductance, Coupling, Solver};
use porograin::{Domain, Model, Slip};
use porograin_geometry::Cell;

/// Steps timed unless asked otherwise.
const STEPS: u64 = 2000;
/// Measurements of the permeability, of which the fastest counts.
const REPEATS: u64 = 3;

/// `porograin bench`.
pub fn bench(arguments: &Bench) -> Outcome {
    threads(Some(arguments.threads))?;
    if let What::Solvers = arguments.what {
        return solvers(arguments);
    }
    let (cell, spheres) = match (&arguments.grains, arguments.corners, arguments.count) {
        (Some(grains), Some(corners), _) => packing(grains, corners)?,
        (_, _, Some(count)) => bench::grown(count).map_err(failed)?,
        _ => return Err(Failure::Input("give --grains and --box, or --packing and --count".into())),
    };
    match arguments.what {
        What::Dry => dry(arguments, &cell, spheres),
        What::Coupled => coupled(arguments, &cell, spheres),
        What::Coarse => coarse(arguments, &cell, spheres),
        What::Permeability | What::Solvers => permeability(arguments, &cell, &spheres),
    }
}

/// Holds the packing and times the dry step.
fn dry(arguments: &Bench, cell: &Cell, spheres: Spheres) -> Outcome {
    let domain = Domain::walled(cell.origin, cell.upper());
    let steps = arguments.steps.unwrap_or(STEPS) as usize;
    let law = match arguments.law {
        Law::Linear => bench::linear(),
        Law::HertzMindlin => bench::hertz_mindlin(),
    };
    let mut model = Model { contact: law.into(), ..bench::dry_model() };
    if let Some(rate) = arguments.flow {
        bench::flow(&mut model, cell, rate);
    }
    let cost = bench::dry(spheres.position, spheres.radius, domain, &model, steps).map_err(failed)?;
    say!(
        "{:.1} ns per contact and step ({:.1} in the mean), {:.3e} s per step, {} grains, {} contacts; neighbours anew {:.0} ns per grain",
        cost.ns_per_contact_step,
        cost.mean_ns_per_contact_step,
        cost.seconds_per_step,
        cost.grains,
        cost.contacts,
        cost.rebuild_ns_per_grain
    );
    if let Some(bytes) = cost.bytes_per_grain {
        say!("{bytes:.0} bytes of memory per grain");
    }
    say_speed_up(cost.speed_up);
    say_phases(&cost.phases);
    serde_json::to_value(&cost).map(Some).map_err(failed)
}

/// Consolidates the packing and times the coupled step.
fn coupled(arguments: &Bench, cell: &Cell, spheres: Spheres) -> Outcome {
    let domain = Domain::walled(cell.origin, cell.upper());
    let steps = arguments.steps.unwrap_or(STEPS) as usize;
    let Bench { viscosity, residual, .. } = *arguments;
    let cost = bench::coupled(spheres.position, spheres.radius, domain, steps, viscosity, residual)
        .map_err(failed)?;
    say!(
        "{:.3e} s per step, {:.1} dry steps; {} grains, {} contacts, {} pores\n\
         {:.2} iterations of {} per step to a residual of {:.0e}; dt {:.3e} s, limited by {}; dt mu/(k rho) = {:.3}",
        cost.seconds_per_step,
        cost.ratio_to_dry,
        cost.grains,
        cost.contacts,
        cost.pores,
        cost.iterations_per_step,
        cost.solver,
        cost.residual,
        cost.dt,
        cost.limit,
        cost.viscous_number
    );
    say_speed_up(cost.speed_up);
    say_phases(&cost.phases);
    serde_json::to_value(&cost).map(Some).map_err(failed)
}

/// Consolidates the packing on a coarse grid and times the step.
fn coarse(arguments: &Bench, cell: &Cell, spheres: Spheres) -> Outcome {
    let domain = Domain::walled(cell.origin, cell.upper());
    let steps = arguments.steps.unwrap_or(STEPS) as usize;
    let cost =
        bench::coarse(spheres.position, spheres.radius, domain, steps, arguments.residual).map_err(failed)?;
    say!(
        "{:.3e} s per step, the water {:.0} % of the dry {:.3e} s; {} grains, {} cells, {:.2} iterations per step",
        cost.seconds_per_step,
        100.0 * cost.water_over_dry,
        cost.dry_seconds_per_step,
        cost.grains,
        cost.cells,
        cost.iterations_per_step
    );
    say!("  phase [ms]      dry    water");
    for (phase, [dry, wet]) in &cost.phases {
        say!("  {phase:12} {:6.3}   {:+6.3}", 1e3 * dry, 1e3 * (wet - dry));
    }
    serde_json::to_value(&cost).map(Some).map_err(failed)
}

/// Every solver on packings of growing size.
fn solvers(arguments: &Bench) -> Outcome {
    let max =
        arguments.max.ok_or_else(|| Failure::Input("give --max, the largest number of grains".into()))?;
    say!(
        "   grains    pores   triangulation conductance | solver        set-up    solve iterations      MB flux error | thesis \
         (Gauss-Seidel, PARDISO, TAUCS)"
    );
    let mut all = Vec::new();
    for grains in bench::sizes(max) {
        let size = bench::solvers(grains).map_err(failed)?;
        for (k, s) in size.solvers.iter().enumerate() {
            let name = serde_json::to_value(s.solver).map_err(failed)?;
            match k {
                0 => say_part!(
                    "{:9} {:8} {:11.3} s {:9.3} s |",
                    size.grains,
                    size.pores,
                    size.triangulation,
                    size.conductance
                ),
                _ => say_part!("{:44}|", ""),
            }
            say_part!(
                " {:12} {:7.3} s {:7.3} s {:8} {:9.1} {:9.1e} |",
                name.as_str().unwrap_or_default(),
                s.setup,
                s.solve,
                s.iterations,
                s.bytes as f64 / 1e6,
                s.flux_error
            );
            match size.thesis.filter(|_| k == 0) {
                Some(t) => say!(" {} s, {} s, {} s", t.gauss_seidel, t.pardiso, t.taucs),
                None => say!(),
            }
        }
        all.push(size);
    }
    if let Some(power) = bench::growth(&all) {
        say!("from 32000 grains on the whole, by cg, grows with their power {power:.2}");
    }
    serde_json::to_value(&all).map(Some).map_err(failed)
}

/// Measures a few times and tells the median. No more is kept of each than what is told: the pores of a million grains take gigabytes.
fn permeability(arguments: &Bench, cell: &Cell, spheres: &Spheres) -> Outcome {
    let problem = Problem {
        axis: 2,
        drop: 1.0,
        sides: Slip::Symmetry,
        viscosity: arguments.viscosity.unwrap_or(1e-3),
        conductance: Conductance::hydraulic_radius(),
        coupling: Coupling::Reciprocal,
        solver: Solver::Auto,
        residual: RESIDUAL,
    };
    let mut all = Vec::new();
    for _ in 0..arguments.steps.unwrap_or(REPEATS).max(1) {
        let flow = measure(cell, &spheres.position, &spheres.radius, &problem).map_err(failed)?;
        let mut object = object(&flow);
        object["conductance"] = problem.conductance.name().into();
        object["seconds"]["total"] = total(&flow).into();
        all.push((total(&flow), object));
    }
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let best = all[0].0;
    let (seconds, object) = all.swap_remove(all.len() / 2);
    say!("{seconds:.3} s for {} grains, {best:.3} s at best", spheres.radius.len());
    Ok(Some(object))
}

fn total(flow: &Flow) -> f64 {
    flow.seconds.triangulation + flow.seconds.conductance + flow.seconds.solve
}

fn say_phases(phases: &[(&str, f64)]) {
    for (phase, share) in phases {
        say!("  {phase:12} {:5.1} %", 100.0 * share);
    }
}

fn say_speed_up(speed_up: Option<bench::SpeedUp>) {
    if let Some(bench::SpeedUp { threads, step, ideal }) = speed_up {
        say!(
            "on {threads} threads {step:.2} times faster than on one, a loop that shares nothing {ideal:.2} times: {:.0} % of that",
            100.0 * step / ideal
        );
    }
}

fn failed(error: impl std::fmt::Display) -> Failure {
    Failure::Run(error.to_string())
}

//! Makes the dense packings of the benchmarks: a cloud, pressed together by pistons, at rest.
//!
//! `cargo run --release -p porograin --example dense_packing -- 5000 benches/packings/dense-5000.csv`

use glam::DVec3;
use porograin::contact::Contacts;
use porograin::{Domain, Face, Signal, Solid, State, Work, bench, measure, packing, step};
use std::fmt::Write as _;

fn main() -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let mut arguments = std::env::args().skip(1);
    let count: usize = arguments.next().ok_or("usage: dense_packing COUNT FILE.csv")?.parse()?;
    let file = arguments.next().ok_or("usage: dense_packing COUNT FILE.csv")?;
    let state = rayon::ThreadPoolBuilder::new().build()?.install(|| dense(count))?;

    let corner = state.domain.cell.upper() - state.domain.cell.origin;
    let mut text = format!(
        "# {count} grains at rest under 5 kPa, E = 15 MPa; x,y,z,r in m; porosity {:.4}, {:.3} contacts per grain\n\
         # cargo run --release -p porograin --example dense_packing -- {count} FILE\n\
         # --box 0,0,0,{:.9},{:.9},{:.9}\n",
        measure::porosity(&state),
        measure::coordination(&state),
        corner.x,
        corner.y,
        corner.z
    );
    for (x, r) in state.grains.position.iter().zip(&state.grains.radius) {
        let x = *x - state.domain.cell.origin;
        writeln!(text, "{:.9},{:.9},{:.9},{r:.9}", x.x, x.y, x.z)?;
    }
    std::fs::write(file, text)?;
    Ok(())
}

/// A cloud pressed by three pistons at 5 kPa with 5° of friction until the unbalanced force is below 1e-3, grains of
/// 2.5 mm mean radius or so whatever their number.
fn dense(count: usize) -> Result<State, Box<dyn std::error::Error + Send + Sync>> {
    let size = 0.1 * (count as f64 / 5000.0).cbrt();
    let domain = Domain::walled(DVec3::ZERO, DVec3::splat(size));
    let mut grains = packing::cloud(&domain.cell, count, 0.2, 7, 0.75, bench::DENSITY)?;
    let mut model = bench::dry_model();
    model.contact.set_friction(5.0);
    let piston = Solid::Servo { stress: Signal::Constant(5e3), mass: None, speed: None };
    for face in [1, 3, 5] {
        model.faces[face] = Face { solid: piston.clone(), ..Face::default() };
    }
    grains = packing::ordered(&domain.cell, grains);
    let mut state =
        State { time: 0.0, step: 0, dt: 0.0, domain, grains, contacts: Contacts::default(), fluid: None };
    let mut work = Work::default();
    loop {
        step(&mut state, &model, &mut work)?;
        if state.step % 100 == 0 {
            let unbalanced = measure::unbalanced(&state, &model, &work.loads);
            let stress = measure::wall_stress(&state.domain);
            let pressed = [1, 3, 5].iter().all(|&face| (stress[face] / 5e3 - 1.0).abs() < 1e-3);
            if state.step % 1000 == 0 {
                eprintln!(
                    "step {} porosity {:.4} unbalanced {unbalanced:.2e}",
                    state.step,
                    measure::porosity(&state)
                );
            }
            if pressed && unbalanced < 1e-3 {
                return Ok(state);
            }
        }
    }
}

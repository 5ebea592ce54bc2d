//! The example `24-wave-speed`: the numbers of its README.

use porograin::case::Case;
use porograin::measure;
use porograin::run::Simulation;
use std::path::Path;

/// A pulse along or across a column runs at the square root of the modulus over the density.
#[test]
fn pulses_run_at_the_speed_of_the_modulus() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/24-wave-speed/case.toml");
    let mut simulation = Simulation::new(&Case::from_file(&path, &[]).unwrap()).unwrap();
    // By direction (along, across): when the upper plate feels most, and the modulus.
    let (mut first, mut most, mut arrival, mut stiffness) = ([0.0; 2], [0.0; 2], [0.0; 2], [0.0; 2]);
    let mut name = String::new();
    while simulation.advance().unwrap().is_some() {
        let Some(stage) = simulation.stage() else { break };
        let (state, new) = (&simulation.state, stage.name != name);
        name.clone_from(&stage.name);
        let (k, axis) = if name.starts_with("shear") { (1, 0) } else { (0, 2) };
        let felt = state.domain.wall_force[5][axis];
        if new {
            first[k] = felt;
        }
        let Some(began) = simulation.progress.began else { continue };
        let change = (felt - first[k]).abs();
        match name.as_str() {
            "pulse" | "shear pulse" if change > most[k] => {
                // The lower plate is fastest after 0.3 ms.
                (most[k], arrival[k]) = (change, state.time - state.dt - began.time - 3e-4);
            }
            "squeeze" | "shear" => {
                let strain = 1e-4 * 1.0005e-2 / state.domain.cell.edges.z_axis.z;
                stiffness[k] = change / state.domain.area(5) / strain;
            }
            _ => {}
        }
    }
    let state = &simulation.state;
    let (height, density) = (state.domain.cell.edges.z_axis.z, 2600.0 * (1.0 - measure::porosity(state)));
    // The pulses are 15 and 9 grains long, so that they run a little slower than longer ones would.
    for (k, modulus, speed) in [(0, 3.13e6, 42.9), (1, 1.25e6, 27.1)] {
        assert!((stiffness[k] / modulus - 1.0).abs() < 0.05, "modulus {stiffness:?}");
        let found = height / arrival[k];
        assert!((found / speed - 1.0).abs() < 0.03, "speed {found}");
        let expected = (stiffness[k] / density).sqrt();
        // Of a chain of grains, no pulse is faster, and none of more than nine grains is slower than cos(pi/9).
        assert!((0.94..1.005).contains(&(found / expected)), "{found} beside {expected}");
    }
}

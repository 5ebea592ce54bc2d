//! One consolidation with both kinds of water, `examples/21-pores-or-darcy`.

use porograin::case::Case;
use porograin::run::Simulation;
use std::path::Path;

/// Every millisecond of the load: time [s], settlement [m], pressure at mid-height [Pa]. And the permeability [m²].
fn consolidate(file: &str, overrides: &[String]) -> (Vec<[f64; 3]>, f64) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/21-pores-or-darcy").join(file);
    let mut simulation = Simulation::new(&Case::from_file(&path, overrides).unwrap()).unwrap();
    while simulation.stage().is_some_and(|stage| stage.name != "load") {
        simulation.advance().unwrap();
    }
    let height = |simulation: &Simulation| simulation.state.domain.cell.upper().z;
    let (start, top) = (simulation.state.time, height(&simulation));
    let (mut seen, mut next) = (Vec::new(), 1e-3);
    while simulation.advance().unwrap().is_some() {
        let time = simulation.state.time - start;
        if time >= next {
            next += 1e-3;
            seen.push([time, top - height(&simulation), simulation.profile().unwrap()[6]]);
        }
    }
    (seen, simulation.progress.consolidation.as_ref().unwrap().permeability)
}

#[test]
#[ignore = "long: two consolidations of 5000 grains, minutes"]
fn pores_and_grid_consolidate_alike() {
    let (pores, measured) = consolidate("case.toml", &[]);
    // The number in `darcy.toml` is as old as its picture: a dense sample comes out a little different with every change.
    assert!((measured / 2.873e-8 - 1.0).abs() < 0.01, "{measured}");
    let flow = "fluid.flow.darcy.permeability.given";
    let (darcy, given) = consolidate("darcy.toml", &[format!("{flow}=[{measured},{measured},{measured}]")]);
    assert!((given / measured - 1.0).abs() < 1e-6, "{given} {measured}");
    let last = pores.last().unwrap()[1];
    let worst = |from: f64, of: usize| {
        let late = pores.iter().zip(&darcy).filter(|(a, _)| a[0] >= from);
        late.map(|(a, b)| (a[of] - b[of]).abs()).fold(0.0, f64::max)
    };
    println!(
        "settlement within {:.4} of the last, pressure within {:.4} of the load",
        worst(0.0, 1) / last,
        worst(4.5e-3, 2) / 5e3
    );
    for (a, b) in pores.iter().zip(&darcy) {
        assert!((a[1] - b[1]).abs() < 0.05 * last, "{a:?} {b:?}");
        // At first the piston rings and the pressure with it.
        assert!(a[0] < 4.5e-3 || (a[2] - b[2]).abs() < 0.05 * 5e3, "{a:?} {b:?}");
    }
}

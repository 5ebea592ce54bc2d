//! A sheared periodic cell followed by repair. `cargo run --release -p porograin-geometry --example shear`

use glam::{DMat3, DVec3};
use porograin_geometry::throat::{Packing, pore_volume};
use porograin_geometry::{Cell, Triangulation};

/// Prints what the head of this file says.
pub fn main() {
    let n = 6000;
    let mut state = 3u64;
    let mut dice = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    // Where each grain is in fractions of the period; the cell carries them along.
    let fraction: Vec<DVec3> = (0..n).map(|_| DVec3::new(dice(), dice(), dice())).collect();
    let radius: Vec<f64> = (0..n).map(|_| 0.015 + 0.01 * dice()).collect();
    let at = |cell: &Cell| fraction.iter().map(|f| cell.edges * *f).collect::<Vec<DVec3>>();
    let sheared =
        |by: f64| Cell::periodic(DVec3::ZERO, DMat3::from_cols(DVec3::X, DVec3::new(by, 1.0, 0.0), DVec3::Z));

    let start = sheared(0.0);
    let mut mesh = Triangulation::new(&start, &at(&start), &radius).expect("a sound cell");
    println!("shear  pores  replaced    flips  hidden");
    for step in 1..=5 {
        let cell = sheared(0.002 * f64::from(step));
        let position = at(&cell);
        let report = mesh.repair(&cell, &position, &radius).expect("a sound cell");
        println!(
            "{:.3}  {}  {:8} {:8}  {:6}",
            cell.edges.y_axis.x,
            mesh.pores.len(),
            report.replaced,
            report.flips,
            mesh.hidden.len()
        );
        assert!(!report.rebuilt);
        // Not just equivalent: the same pores in the same places with the same shifts.
        assert!(mesh == Triangulation::new(&cell, &position, &radius).expect("a sound cell"));
        // Each pore appears once, whatever the period: they fill it.
        let packing = Packing { cell: &cell, position: &position, radius: &radius };
        let volume: f64 = (0..mesh.pores.len()).map(|pore| pore_volume(packing, &mesh, pore)).sum();
        assert!((volume - cell.volume()).abs() < 1e-12);
    }
}

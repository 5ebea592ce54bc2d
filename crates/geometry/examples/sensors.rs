//! Which pore a sensor is in, and how fast that pore grows. `cargo run --release -p porograin-geometry --example sensors`

use glam::DVec3;
use porograin_geometry::gradient::pore_volume_gradient;
use porograin_geometry::locate::locate;
use porograin_geometry::throat::{Packing, pore_volume};
use porograin_geometry::triangulation::wall;
use porograin_geometry::{Cell, Triangulation};

/// Prints what the head of this file says.
pub fn main() {
    let cell = Cell::walled(DVec3::ZERO, DVec3::ONE);
    let mut state = 7u64;
    let mut dice = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let position: Vec<DVec3> = (0..2000).map(|_| DVec3::new(dice(), dice(), dice())).collect();
    let radius: Vec<f64> = (0..2000).map(|_| 0.01 + 0.02 * dice()).collect();
    let velocity: Vec<DVec3> = position.iter().map(|x| DVec3::new(x.y, -x.x, 0.3 * x.z)).collect();
    let mesh = Triangulation::new(&cell, &position, &radius).expect("all centres are in the box");
    let packing = Packing { cell: &cell, position: &position, radius: &radius };

    let mut hint = 0;
    for sensor in (1..10).map(|k| DVec3::new(0.5, 0.5, 0.1 * f64::from(k))) {
        // The last pore found is the best place to start from.
        let Some(found) = locate(packing, &mesh, sensor, hint) else { continue };
        hint = found.pore;
        let pore = found.pore as usize;
        // The walls stand still.
        let of = |v: u32| if wall(v).is_some() { DVec3::ZERO } else { velocity[v as usize] };
        let gradient = pore_volume_gradient(packing, &mesh, pore);
        let rate: f64 = (0..4).map(|k| gradient[k].dot(of(mesh.pores[pore][k]))).sum();
        let volume = pore_volume(packing, &mesh, pore);
        println!("{sensor}: pore {pore} of {volume:.3e} m³ grows by {rate:+.3e} m³/s");

        // The same from the volumes a little earlier and later.
        let h = 1e-6;
        let moved = |by: f64| {
            let x: Vec<DVec3> = position.iter().zip(&velocity).map(|(x, v)| *x + *v * by).collect();
            pore_volume(Packing { position: &x, ..packing }, &mesh, pore)
        };
        assert!((rate - (moved(h) - moved(-h)) / (2.0 * h)).abs() < 1e-9);
    }
}

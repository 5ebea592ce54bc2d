//! Properties for any input: adversarial coordinates give a valid complex or an error that names the cause, never a panic
//! or a hang; geometry sums to the whole.

mod common;

use common::complex;
use glam::{DMat3, DVec3};
use porograin_geometry::throat::{Packing, pore_volume, radical_centres};
use porograin_geometry::voronoi::voronoi;
use porograin_geometry::{Cell, Triangulation};
use proptest::prelude::*;

/// A coordinate in [0, 1], often special.
fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        3 => 0.0..=1.0f64,
        2 => (0u8..=4).prop_map(|k| f64::from(k) / 4.0),
        1 => Just(1e-300),
        1 => Just(f64::MIN_POSITIVE / 2.0),
        1 => Just(0.5 + f64::EPSILON),
        1 => Just(1.0 - f64::EPSILON),
        1 => (0.0..1e-14f64).prop_map(|e| 0.25 + e),
    ]
}

fn grain() -> impl Strategy<Value = ([f64; 3], f64)> {
    let radius =
        prop_oneof![3 => 0.0..0.3f64, 1 => Just(0.25), 1 => Just(0.0), 1 => Just(1e-300), 1 => Just(500.0)];
    ([coordinate(), coordinate(), coordinate()], radius)
}

fn size() -> impl Strategy<Value = f64> {
    prop_oneof![3 => Just(1.0), 1 => Just(1e-290), 1 => Just(1e300), 1 => 1e-9..1e9f64]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 100, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn adversarial_clouds_give_complexes(grains in prop::collection::vec(grain(), 0..40), size in size(), aspect in 1e-12..1.0f64) {
        let edges = DVec3::new(1.0, aspect, 1.0) * size;
        let cell = Cell::walled(DVec3::ZERO, edges);
        let x: Vec<DVec3> = grains.iter().map(|g| DVec3::from(g.0) * edges).collect();
        let r: Vec<f64> = grains.iter().map(|g| g.1 * size).collect();
        let t = Triangulation::new(&cell, &x, &r).unwrap();
        complex(x.len(), &t);
        // In any period the same must come to an end, and hide the same or more.
        let torus = Cell { periodic: [true, aspect > 0.5, true], ..cell };
        if aspect > 1e-3 {
            let t = Triangulation::new(&torus, &x, &r).unwrap();
            prop_assert!(t.pores.len() == t.shifts.len() && (t.pores.is_empty() == x.is_empty()));
        }
    }

    #[test]
    fn repair_equals_rebuild(grains in prop::collection::vec((grain(), grain()), 1..40), by in prop_oneof![Just(1.0), Just(1e-3), Just(1e-9)], periodic in any::<[bool; 3]>()) {
        let cell = Cell { periodic, ..Cell::walled(DVec3::ZERO, DVec3::ONE) };
        let x: Vec<DVec3> = grains.iter().map(|g| DVec3::from(g.0.0)).collect();
        let y: Vec<DVec3> = grains.iter().map(|g| DVec3::from(g.0.0).lerp(DVec3::from(g.1.0), by)).collect();
        let r: Vec<f64> = grains.iter().map(|g| g.0.1.min(0.5)).collect();
        let mut t = Triangulation::new(&cell, &x, &r).unwrap();
        let y: Vec<DVec3> = y.into_iter().map(|p| p.clamp(DVec3::ZERO, DVec3::ONE)).collect();
        t.repair(&cell, &y, &r).unwrap();
        prop_assert!(t == Triangulation::new(&cell, &y, &r).unwrap());
    }

    #[test]
    fn volumes_sum_to_the_cell(points in prop::collection::vec([0.0..1.0f64, 0.0..1.0, 0.0..1.0], 1..60), r in 0.0..0.2f64, kind in 0u8..8, shear in -0.5..0.5f64) {
        let periodic = [kind & 1 != 0, kind & 2 != 0, kind & 4 != 0];
        let mut edges = DMat3::IDENTITY;
        if periodic[0] && periodic[1] {
            edges.y_axis.x = shear;
        }
        let cell = Cell { origin: DVec3::splat(-0.5), edges, periodic };
        let x: Vec<DVec3> = points.iter().map(|p| cell.origin + cell.edges * DVec3::from(*p)).collect();
        let r: Vec<f64> = (0..x.len()).map(|k| r * (k as f64 * 0.7).sin().abs()).collect();
        let t = Triangulation::new(&cell, &x, &r).unwrap();
        let packing = Packing { cell: &cell, position: &x, radius: &r };
        let pores: f64 = (0..t.pores.len()).map(|p| pore_volume(packing, &t, p)).sum();
        prop_assert!((pores - 1.0).abs() < 1e-10, "pores {pores}");
        let cells: f64 = voronoi(packing, &t, &radical_centres(packing, &t)).volume.iter().sum();
        prop_assert!((cells - 1.0).abs() < 1e-9, "power cells {cells}");
    }

    /// Anything at all: an error or a result, no panic and no hang.
    #[test]
    fn any_bits(bits in prop::collection::vec(any::<[u64; 4]>(), 0..30), edges in any::<[u64; 9]>(), plain in any::<bool>(), periodic in any::<[bool; 3]>()) {
        let edges = DMat3::from_cols_array(&edges.map(f64::from_bits));
        let cell = if plain { Cell { periodic, ..Cell::walled(DVec3::splat(-1e300), DVec3::splat(1e300)) } } else { Cell { origin: DVec3::ZERO, edges, periodic } };
        let x: Vec<DVec3> = bits.iter().map(|b| DVec3::new(f64::from_bits(b[0]), f64::from_bits(b[1]), f64::from_bits(b[2]))).collect();
        let r: Vec<f64> = bits.iter().map(|b| f64::from_bits(b[3]).abs()).collect();
        let _ = Triangulation::new(&cell, &x, &r);
        let (x, r): (Vec<DVec3>, Vec<f64>) = x.into_iter().zip(r).filter(|(x, r)| x.abs().max_element() < 1e300 && *r < 1e300).unzip();
        let _ = Triangulation::new(&cell, &x, &r);
    }
}

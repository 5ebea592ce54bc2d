//! Repair gives what a rebuild gives, bit for bit.

mod common;

use common::{Dice, STEP, complex};
use glam::{DMat3, DVec3};
use porograin_geometry::{Cell, Triangulation, TriangulationError};

fn cells() -> [Cell; 3] {
    let sheared = DMat3::from_cols(DVec3::X, DVec3::new(0.25, 1.0, 0.0), DVec3::new(0.0, 0.125, 1.0));
    [
        Cell::walled(DVec3::ZERO, DVec3::ONE),
        Cell::periodic(DVec3::ZERO, sheared),
        Cell { origin: DVec3::ZERO, edges: DMat3::IDENTITY, periodic: [true, false, true] },
    ]
}

fn shaken(dice: &mut Dice, x: &[DVec3], by: f64) -> Vec<DVec3> {
    let moved = |p: &DVec3| *p + (dice.point() - 0.5) * 2.0 * by;
    x.iter().map(moved).map(|p| p.clamp(DVec3::ZERO, DVec3::ONE)).collect()
}

/// Well-spread grains: one in each cell of a grid.
fn grid(dice: &mut Dice, m: u64) -> Vec<DVec3> {
    let corner = |i: u64| DVec3::new((i % m) as f64, (i / m % m) as f64, (i / m / m) as f64);
    (0..m * m * m).map(|i| (corner(i) + 0.1 + 0.8 * dice.point()) / m as f64).collect()
}

#[test]
fn small_and_large_motions() {
    let mut dice = Dice(21);
    for cell in cells() {
        let mut followed = 0;
        for m in [2, 5, 9, 18] {
            let x = grid(&mut dice, m);
            let r: Vec<f64> = x.iter().map(|_| (0.1 + 0.5 * dice.unit()) / m as f64).collect();
            for by in [0.0, 1e-12, 1e-6, 1e-3, 0.01, 0.05, 0.5] {
                let mut t = Triangulation::new(&cell, &x, &r).unwrap();
                let y = shaken(&mut dice, &x, by / m as f64);
                let report = t.repair(&cell, &y, &r).unwrap();
                assert!(t == Triangulation::new(&cell, &y, &r).unwrap(), "{m} {by} {report:?}");
                followed += usize::from(!report.rebuilt);
                if m > 17 && by < 2e-3 {
                    assert!(!report.rebuilt, "{by} {report:?}");
                    assert!(by == 1e-6 || (report.replaced > 0) == (by > 1e-6), "{by} {report:?}");
                }
            }
        }
        assert!(followed >= 8);
    }
}

#[test]
#[ignore = "long: 600 small tori followed through motions of every size"]
fn small_tori() {
    let mut dice = Dice(25);
    let mut followed = 0;
    for trial in 0..200 {
        for cell in cells() {
            let n = 60 + dice.below(600) as usize;
            let x: Vec<DVec3> = (0..n).map(|_| dice.point()).collect();
            let r: Vec<f64> = x.iter().map(|_| 0.06 * dice.unit()).collect();
            let mut t = Triangulation::new(&cell, &x, &r).unwrap();
            let by = 10f64.powi(-(trial % 5) - 1) * 0.1;
            let y = shaken(&mut dice, &x, by);
            followed += usize::from(!t.repair(&cell, &y, &r).unwrap().rebuilt);
            assert!(t == Triangulation::new(&cell, &y, &r).unwrap(), "{trial} {n}");
        }
    }
    assert!(followed > 200, "{followed}");
}

#[test]
fn grains_that_appear_and_disappear() {
    let mut dice = Dice(22);
    let cell = &cells()[0];
    let mut reinserted = 0;
    for _ in 0..60 {
        let x: Vec<DVec3> = (0..300).map(|_| dice.point()).collect();
        let r: Vec<f64> = x.iter().map(|_| 0.15 * dice.unit()).collect();
        let mut t = Triangulation::new(cell, &x, &r).unwrap();
        for by in [1e-4, 1e-3, 2e-3] {
            let y = shaken(&mut dice, &x, by);
            let report = t.repair(cell, &y, &r).unwrap();
            assert!(t == Triangulation::new(cell, &y, &r).unwrap(), "{by} {report:?}");
            complex(x.len(), &t);
            reinserted += report.reinserted;
        }
    }
    assert!(reinserted > 100);
}

#[test]
fn ties_before_and_after() {
    let mut dice = Dice(23);
    let cell = &cells()[0];
    for m in [3u64, 4, 6] {
        let corner = |i: u64| DVec3::new((i % m) as f64, (i / m % m) as f64, (i / m / m) as f64);
        let lattice: Vec<DVec3> =
            (0..m * m * m).map(|i| ((corner(i) + 0.5) / m as f64 / STEP).round() * STEP).collect();
        let r = vec![0.0625; lattice.len()];
        for by in [STEP, 1e-3] {
            let shaken = shaken(&mut dice, &lattice, by);
            for (from, to) in [(&lattice, &shaken), (&shaken, &lattice)] {
                let mut t = Triangulation::new(cell, from, &r).unwrap();
                let report = t.repair(cell, to, &r).unwrap();
                assert!(t == Triangulation::new(cell, to, &r).unwrap(), "{report:?}");
            }
        }
    }
}

#[test]
fn the_cell_may_shear_and_radii_may_grow() {
    let mut dice = Dice(24);
    let cell = cells()[1];
    let f: Vec<DVec3> = grid(&mut dice, 18);
    let mut r: Vec<f64> = f.iter().map(|_| 0.01 + 0.01 * dice.unit()).collect();
    let at = |cell: &Cell| f.iter().map(|f| cell.edges * *f).collect::<Vec<DVec3>>();
    let mut t = Triangulation::new(&cell, &at(&cell), &r).unwrap();
    let (mut now, mut replaced) = (cell, 0);
    for step in 0..5 {
        now.edges.y_axis.x += 0.004;
        r.iter_mut().for_each(|r| *r *= 1.001);
        // Every other time the grains are put back into another period.
        let mut x = at(&now);
        if step % 2 == 1 {
            x.iter_mut().step_by(3).for_each(|p| *p += now.edges.y_axis - now.edges.x_axis);
        }
        let report = t.repair(&now, &x, &r).unwrap();
        assert!(!report.rebuilt);
        replaced += report.replaced;
        assert!(t == Triangulation::new(&now, &x, &r).unwrap());
    }
    assert!(replaced > 100);
}

#[test]
fn another_sample_is_rebuilt_and_bad_input_changes_nothing() {
    let mut dice = Dice(25);
    let cell = cells()[0];
    let x = grid(&mut dice, 4);
    let r = vec![0.05; 64];
    let mut t = Triangulation::new(&cell, &x, &r).unwrap();
    let before = t.clone();
    let mut bad = x.clone();
    bad[9].x = f64::NAN;
    assert_eq!(t.repair(&cell, &bad, &r), Err(TriangulationError::Position { grain: 9 }));
    assert_eq!(t, before);
    assert!(t.repair(&cell, &x[..60], &r[..60]).unwrap().rebuilt);
    assert_eq!(t, Triangulation::new(&cell, &x[..60], &r[..60]).unwrap());
    let periodic = Cell { periodic: [true; 3], ..cell };
    assert!(t.repair(&periodic, &x, &r).unwrap().rebuilt);
    assert_eq!(t, Triangulation::new(&periodic, &x, &r).unwrap());
}

/// Face-centred lattices are full of ties: two pores become three, three two and four four, and nothing gets stuck. Shaken
/// simple cubic ones change everywhere.
#[test]
fn lattices_are_followed_by_flips() {
    let mut dice = Dice(26);
    let lattice = |m: u32, basis: &[DVec3]| -> Vec<DVec3> {
        let corner = |i: u32| DVec3::new((i % m).into(), (i / m % m).into(), (i / m / m).into());
        let cube = |i: u32| basis.iter().map(move |b| (corner(i) + 0.25 + *b) / f64::from(m));
        (0..m * m * m).flat_map(cube).collect()
    };
    let half = |x, y, z| DVec3::new(x, y, z) / 2.0;
    let face = [DVec3::ZERO, half(1.0, 1.0, 0.0), half(1.0, 0.0, 1.0), half(0.0, 1.0, 1.0)];
    let [walled, _, mixed] = cells();
    for cell in [walled, Cell { periodic: [true; 3], ..walled }, mixed] {
        for m in [7, 10] {
            let x = lattice(m, &face);
            let r = vec![0.25 / f64::from(m); x.len()];
            let first = Triangulation::new(&cell, &x, &r).unwrap();
            let strained =
                Cell { edges: cell.edges * DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.99)), ..cell };
            for by in [0.0, 1e-9, 1e-3, 0.03] {
                let mut t = first.clone();
                let y: Vec<DVec3> = shaken(&mut dice, &x, by / f64::from(m));
                let y: Vec<DVec3> = y.iter().map(|y| strained.edges * (cell.edges.inverse() * *y)).collect();
                let report = t.repair(&strained, &y, &r).unwrap();
                assert!(t == Triangulation::new(&strained, &y, &r).unwrap(), "{m} {by} {report:?}");
                assert!(!report.rebuilt && report.flips > x.len() / 10, "{m} {by} {report:?}");
            }
        }
    }
    let x = lattice(14, &[DVec3::ZERO]);
    let r = vec![0.02; x.len()];
    let mut t = Triangulation::new(&cells()[0], &x, &r).unwrap();
    let y = shaken(&mut dice, &x, 1e-3 / 14.0);
    assert!(t.repair(&cells()[0], &y, &r).unwrap().rebuilt);
}

/// Pores turned inside out are refilled before anything is flipped.
#[test]
fn inverted_pores_do_not_stop_it() {
    let mut dice = Dice(27);
    let cell = cells()[0];
    let x = grid(&mut dice, 18);
    let r: Vec<f64> = x.iter().map(|_| (0.3 + 0.2 * dice.unit()) / 18.0).collect();
    let mut t = Triangulation::new(&cell, &x, &r).unwrap();
    let y = shaken(&mut dice, &x, 0.1 / 18.0);
    let report = t.repair(&cell, &y, &r).unwrap();
    assert!(!report.rebuilt && report.flips > 1000 && report.holes > 10, "{report:?}");
    assert!(t == Triangulation::new(&cell, &y, &r).unwrap());
}

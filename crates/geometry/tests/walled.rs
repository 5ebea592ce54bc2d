//! The triangulation of a walled box against brute force, on random and degenerate clouds.

mod common;

use common::{Dice, STEP, complex, empty_spheres};
use glam::{DMat3, DVec3};
use porograin_geometry::triangulation::{FIRST_WALL, wall};
use porograin_geometry::{Cell, Triangulation, TriangulationError};

fn unit() -> Cell {
    Cell::walled(DVec3::ZERO, DVec3::ONE)
}

fn check(cell: &Cell, x: &[DVec3], r: &[f64]) -> Triangulation {
    let t = Triangulation::new(cell, x, r).unwrap();
    complex(x.len(), &t);
    empty_spheres(cell, x, r, &t);
    t
}

fn radii(dice: &mut Dice, n: usize, largest: f64) -> Vec<f64> {
    // 1:10 polydisperse, whole steps.
    (0..n).map(|_| ((0.1 + 0.9 * dice.unit()) * largest / STEP).round() * STEP).collect()
}

#[test]
fn random_clouds() {
    let mut dice = Dice(1);
    let mut hidden = 0;
    for trial in 0..200 {
        let n = 1 + dice.below(60) as usize;
        let x: Vec<DVec3> = (0..n).map(|_| dice.point()).collect();
        let r = radii(&mut dice, n, [0.05, 0.2, 0.6][trial % 3]);
        hidden += check(&unit(), &x, &r).hidden.len();
    }
    assert!(hidden > 200, "the clouds must hide grains: {hidden}");
}

#[test]
fn a_box_off_the_origin_with_unequal_edges() {
    let mut dice = Dice(2);
    let cell = Cell::walled(DVec3::new(-3.0, 0.5, 7.0), DVec3::new(-1.0, 0.75, 8.0));
    for _ in 0..30 {
        let x: Vec<DVec3> = (0..50)
            .map(|_| {
                let p = cell.origin + dice.point() * DVec3::new(2.0, 0.25, 1.0);
                (p / STEP).round() * STEP
            })
            .collect();
        check(&cell, &x, &radii(&mut dice, 50, 0.1));
    }
}

#[test]
fn coarse_grids_full_of_ties() {
    let mut dice = Dice(3);
    for trial in 0..300u64 {
        let m = 2 + trial % 4;
        let n = 1 + dice.below(50) as usize;
        let x: Vec<DVec3> = (0..n)
            .map(|_| {
                DVec3::new(dice.below(m + 1) as f64, dice.below(m + 1) as f64, dice.below(m + 1) as f64)
                    / m as f64
            })
            .map(|p| (p / STEP).round() * STEP)
            .collect();
        let r: Vec<f64> =
            (0..n).map(|_| if trial % 2 == 0 { 0.125 } else { 0.125 * dice.below(4) as f64 }).collect();
        check(&unit(), &x, &r);
    }
}

fn lattice(m: usize, basis: &[[f64; 3]], offset: f64) -> Vec<DVec3> {
    let mut x = Vec::new();
    for i in 0..m {
        for j in 0..m {
            for k in 0..m {
                for b in basis {
                    let p = DVec3::new(i as f64 + b[0], j as f64 + b[1], k as f64 + b[2]);
                    x.push((p + offset) / m as f64);
                }
            }
        }
    }
    x
}

#[test]
fn lattices() {
    let simple: &[[f64; 3]] = &[[0.0; 3]];
    let body: &[[f64; 3]] = &[[0.0; 3], [0.5; 3]];
    let face: &[[f64; 3]] = &[[0.0; 3], [0.5, 0.5, 0.0], [0.5, 0.0, 0.5], [0.0, 0.5, 0.5]];
    for basis in [simple, body, face] {
        for offset in [0.0, 0.25, 0.5] {
            let x: Vec<DVec3> =
                lattice(4, basis, offset).into_iter().filter(|p| p.max_element() <= 1.0).collect();
            let t = check(&unit(), &x, &vec![0.125; x.len()]);
            assert!(t.hidden.is_empty());
            if basis.len() == 1 {
                // Kuhn: six pores in every cube between the grains.
                let inner = t.pores.iter().filter(|p| p.iter().all(|&v| wall(v).is_none())).count();
                assert_eq!(inner, 6 * 27);
            }
        }
    }
}

#[test]
fn lattices_that_are_not_on_the_grid() {
    // Hexagonal close packing and a cubic lattice of spacing 1/7: nearly, not exactly, tied.
    let mut x = Vec::new();
    for (i, j, k) in (0..6).flat_map(|i| (0..6).flat_map(move |j| (0..6).map(move |k| (i, j, k)))) {
        let (i, j, k) = (f64::from(i), f64::from(j), f64::from(k));
        let odd = k % 2.0;
        let p = DVec3::new(
            i + 0.5 * ((j + k) % 2.0),
            3f64.sqrt() * (0.5 * j + odd / 6.0),
            (2f64 / 3.0).sqrt() * k,
        );
        x.push(p * 0.14 + 0.01);
    }
    let t = Triangulation::new(&unit(), &x, &vec![0.07; x.len()]).unwrap();
    complex(x.len(), &t);
    let x = lattice(7, &[[0.0; 3]], 0.3);
    let t = Triangulation::new(&unit(), &x, &vec![0.07; x.len()]).unwrap();
    complex(x.len(), &t);
}

#[test]
fn coinciding_collinear_and_coplanar_grains() {
    let r = vec![0.0625; 40];
    let t = check(&unit(), &[DVec3::splat(0.25); 40], &r);
    assert_eq!(t.hidden, (1..40).collect::<Vec<u32>>(), "the lowest index stays");
    let mut grown = r.clone();
    grown[7] = 0.125;
    let t = check(&unit(), &[DVec3::splat(0.25); 40], &grown);
    assert!(!t.hidden.contains(&7) && t.hidden.len() == 39, "the largest stays");
    for direction in [DVec3::X, DVec3::new(1.0, 1.0, 0.0), DVec3::ONE] {
        let line: Vec<DVec3> = (0..33).map(|k| direction * (f64::from(k) / 32.0)).collect();
        assert!(check(&unit(), &line, &[0.0625; 33]).hidden.is_empty());
    }
    let mut dice = Dice(5);
    for normal in 0..3 {
        for height in [0.0, 0.375, 1.0] {
            let plane: Vec<DVec3> = (0..40)
                .map(|_| {
                    let mut p = dice.point();
                    p[normal] = height;
                    p
                })
                .collect();
            assert!(check(&unit(), &plane, &r).hidden.is_empty());
        }
    }
}

#[test]
fn one_grain_makes_eight_pores() {
    let t = check(&unit(), &[DVec3::new(0.0, 0.5, 1.0)], &[0.0]);
    assert_eq!(t.pores.len(), 8);
    assert!(t.pores.iter().all(|p| p[0] == 0 && p[1..].iter().all(|&v| v >= FIRST_WALL)));
    assert_eq!(Triangulation::new(&unit(), &[], &[]).unwrap(), Triangulation::default());
}

/// The same pores after renaming the grains back.
fn renamed(t: &Triangulation, p: &[usize]) -> Vec<[u32; 4]> {
    let name = |v: u32| if wall(v).is_some() { v } else { p[v as usize] as u32 };
    let mut pores: Vec<[u32; 4]> = t
        .pores
        .iter()
        .map(|pore| {
            let mut q = pore.map(name);
            q.sort_unstable();
            q
        })
        .collect();
    pores.sort_unstable();
    pores
}

#[test]
fn relabelling_changes_nothing_even_on_lattices() {
    let mut dice = Dice(6);
    let random: Vec<DVec3> = (0..500).map(|_| dice.point()).collect();
    for x in [random, lattice(6, &[[0.0; 3]], 0.5), lattice(5, &[[0.0; 3], [0.5; 3]], 0.25)] {
        let r: Vec<f64> = vec![0.03; x.len()];
        let p = dice.shuffle(x.len());
        let identity: Vec<usize> = (0..x.len()).collect();
        let y: Vec<DVec3> = p.iter().map(|&i| x[i]).collect();
        let a = Triangulation::new(&unit(), &x, &r).unwrap();
        let b = Triangulation::new(&unit(), &y, &r).unwrap();
        assert_eq!(renamed(&a, &identity), renamed(&b, &p));
    }
}

#[test]
fn scaling_translation_and_quarter_turns() {
    let mut dice = Dice(8);
    let x: Vec<DVec3> = (0..400).map(|_| dice.point()).collect();
    let r = radii(&mut dice, 400, 0.08);
    let a = Triangulation::new(&unit(), &x, &r).unwrap();
    for scale in [2f64.powi(-20), 2f64.powi(20), 2f64.powi(-900), 2f64.powi(900), 1e-6, 1e6] {
        let cell = Cell::walled(DVec3::ZERO, DVec3::splat(scale));
        let y: Vec<DVec3> = x.iter().map(|p| *p * scale).collect();
        let s: Vec<f64> = r.iter().map(|r| r * scale).collect();
        assert_eq!(Triangulation::new(&cell, &y, &s).unwrap(), a, "scaled by {scale}");
    }
    let shift = DVec3::new(3.0, -5.0, 0.25);
    let y: Vec<DVec3> = x.iter().map(|p| *p + shift).collect();
    assert_eq!(Triangulation::new(&Cell::walled(shift, shift + 1.0), &y, &r).unwrap(), a);
    // x, y, z -> 1 - y, x, z turns the walls too.
    let y: Vec<DVec3> = x.iter().map(|p| DVec3::new(1.0 - p.y, p.x, p.z)).collect();
    let b = Triangulation::new(&unit(), &y, &r).unwrap();
    let turn = |v: u32| match wall(v) {
        Some(f) => FIRST_WALL + [2, 3, 1, 0, 4, 5][f],
        None => v,
    };
    let sorted = |t: &Triangulation, f: &dyn Fn(u32) -> u32| {
        let mut pores: Vec<[u32; 4]> = t.pores.iter().map(|p| p.map(f)).collect();
        pores.iter_mut().for_each(|p| p.sort_unstable());
        pores.sort_unstable();
        pores
    };
    assert_eq!(sorted(&a, &turn), sorted(&b, &|v| v));
}

#[test]
fn larger_clouds_keep_the_complex() {
    let mut dice = Dice(9);
    let x: Vec<DVec3> = (0..20_000).map(|_| dice.point()).collect();
    let r = radii(&mut dice, x.len(), 0.03);
    complex(x.len(), &Triangulation::new(&unit(), &x, &r).unwrap());
}

#[test]
fn bad_input_is_named() {
    let x = vec![DVec3::splat(0.5); 3];
    let tri = |x: &[DVec3], r: &[f64]| Triangulation::new(&unit(), x, r).unwrap_err();
    for bad in [f64::NAN, f64::INFINITY, -1e-300, -1.0, 1e30] {
        assert_eq!(tri(&x, &[0.1, 0.1, bad]), TriangulationError::Radius { grain: 2 });
    }
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut y = x.clone();
        y[1].y = bad;
        assert_eq!(tri(&y, &[0.1; 3]), TriangulationError::Position { grain: 1 });
    }
    let mut y = x.clone();
    y[1].z = 1.25;
    assert_eq!(tri(&y, &[0.1; 3]), TriangulationError::Outside { grain: 1, face: 5 });
    assert!(tri(&y, &[0.1; 3]).to_string().contains("grain 1 lies beyond the top wall"));
    assert_eq!(tri(&x, &[0.1; 2]), TriangulationError::Lengths { positions: 3, radii: 2 });
    let bad_cells = [
        Cell::walled(DVec3::ZERO, DVec3::new(1.0, 0.0, 1.0)),
        Cell::walled(DVec3::ONE, DVec3::ZERO),
        Cell::walled(DVec3::ZERO, DVec3::splat(f64::NAN)),
        Cell::walled(DVec3::ZERO, DVec3::new(1.0, 1.0, 1e-30)),
        Cell {
            origin: DVec3::ZERO,
            edges: DMat3::from_cols(DVec3::X, DVec3::new(0.1, 1.0, 0.0), DVec3::Z),
            periodic: [false; 3],
        },
    ];
    for cell in bad_cells {
        assert!(matches!(Triangulation::new(&cell, &[], &[]), Err(TriangulationError::Cell(_))));
    }
}

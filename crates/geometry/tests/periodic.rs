//! Periodic and partly periodic cells: against brute force, the tiled sample, and themselves moved or re-based.

mod common;

use common::{Dice, STEP, determinant};
use glam::{DMat3, DVec3};
use porograin_geometry::triangulation::{FACET, FIRST_WALL, NONE, wall};
use porograin_geometry::{Cell, Triangulation, TriangulationError};
use std::collections::{BTreeMap, BTreeSet};

type Image = (u32, [i64; 3]);

/// Vertices and shifts of a pore (or part of one), sorted and relative to the first.
fn normal(part: impl Iterator<Item = Image>) -> Vec<Image> {
    let mut images: Vec<Image> = part.collect();
    images.sort_unstable();
    let first = images[0].1;
    for (v, shift) in &mut images {
        if wall(*v).is_none() {
            (0..3).for_each(|k| shift[k] -= first[k]);
        }
    }
    images
}

fn image(t: &Triangulation, pore: usize, k: usize) -> Image {
    (t.pores[pore][k], t.shifts[pore][k].map(i64::from))
}

fn place(cell: &Cell, x: &[DVec3], t: &Triangulation, pore: usize, k: usize) -> DVec3 {
    x[t.pores[pore][k] as usize] + cell.shift(t.shifts[pore][k])
}

/// Every facet has two sides that name each other, every edge and vertex is counted once (Euler).
fn complex(cell: &Cell, x: &[DVec3], t: &Triangulation) {
    let mut facets: BTreeMap<Vec<Image>, Vec<(usize, usize)>> = BTreeMap::new();
    let (mut edges, mut used) = (BTreeSet::new(), BTreeSet::new());
    for p in 0..t.pores.len() {
        assert!(wall(t.pores[p][0]).is_none() && t.shifts[p][0] == [0; 3]);
        for k in 0..4 {
            facets.entry(normal(FACET[k].into_iter().map(|j| image(t, p, j)))).or_default().push((p, k));
            used.insert(t.pores[p][k]);
            for j in 0..k {
                edges.insert(normal([image(t, p, j), image(t, p, k)].into_iter()));
            }
        }
    }
    for (key, sides) in &facets {
        assert_eq!(sides.len(), 2, "facet {key:?}");
        for i in 0..2 {
            assert_eq!(t.neighbours[sides[i].0][sides[i].1] as usize, sides[1 - i].0);
        }
    }
    let walls = used.iter().filter(|&&v| v >= FIRST_WALL).count();
    let euler = used.len() as i64 - edges.len() as i64 + facets.len() as i64 - t.pores.len() as i64;
    // Torus; torus times an interval with a point at each end; circle times a disc with a square at infinity.
    assert_eq!((walls, euler), [(0, 0), (2, 2), (4, 0)][cell.periodic.iter().filter(|p| !**p).count()]);
    assert_eq!(used.len() - walls + t.hidden.len(), x.len());
    if walls == 0 {
        let volume: f64 = (0..t.pores.len())
            .map(|p| {
                let v = [0, 1, 2, 3].map(|k| place(cell, x, t, p, k));
                (v[1] - v[0]).cross(v[2] - v[0]).dot(v[3] - v[0]) / 6.0
            })
            .sum();
        assert!((volume - cell.volume()).abs() < 1e-12 * cell.volume(), "{volume} {}", cell.volume());
    }
}

/// No image within `reach` periods lies in a power sphere; exact.
fn empty_spheres(cell: &Cell, x: &[DVec3], r: &[f64], t: &Triangulation, reach: i64) {
    let whole = |c: f64| {
        assert_eq!(c / STEP, (c / STEP).round());
        (c / STEP) as i128
    };
    let grain = |p: DVec3, g: u32| {
        let [x, y, z] = p.to_array().map(whole);
        let w = whole(r[g as usize]);
        [x, y, z, x * x + y * y + z * z - w * w, 1]
    };
    let range = |axis: usize| if cell.periodic[axis] { -reach..=reach } else { 0..=0 };
    for p in 0..t.pores.len() {
        let centre = place(cell, x, t, p, 0);
        let row = |v: u32, at: DVec3| match wall(v) {
            None => grain(at - centre, v),
            Some(face) => {
                let n = if face % 2 == 0 { -1 } else { 1 };
                let mut row = [0; 5];
                row[face / 2] = n;
                row[3] = 2 * n * whole(cell.wall_position(face) - centre[face / 2]);
                row
            }
        };
        let at = |k: usize| if wall(t.pores[p][k]).is_some() { DVec3::ZERO } else { place(cell, x, t, p, k) };
        let rows = [0, 1, 2, 3].map(|k| row(t.pores[p][k], at(k)));
        let flat = rows.map(|r| [r[0], r[1], r[2], r[4]]);
        assert!(determinant(&[&flat[0], &flat[1], &flat[2], &flat[3]]) < 0, "not positively oriented");
        let test = |row: [i128; 5]| determinant(&[&rows[0], &rows[1], &rows[2], &rows[3], &row]) >= 0;
        for (i, j, k) in range(0).flat_map(|i| range(1).flat_map(move |j| range(2).map(move |k| (i, j, k)))) {
            let shift = cell.edges * DVec3::new(i as f64, j as f64, k as f64);
            for g in 0..x.len() as u32 {
                assert!(test(row(g, x[g as usize] + shift)), "grain {g} in the sphere of {:?}", t.pores[p]);
            }
        }
        for face in (0..6).filter(|f| !cell.periodic[f / 2]) {
            let v = FIRST_WALL + face as u32;
            assert!(t.pores[p].contains(&v) || test(row(v, DVec3::ZERO)));
        }
    }
}

fn check(cell: &Cell, x: &[DVec3], r: &[f64], reach: i64) -> Triangulation {
    let t = Triangulation::new(cell, x, r).unwrap();
    complex(cell, x, &t);
    empty_spheres(cell, x, r, &t, reach);
    t
}

fn cube() -> Cell {
    Cell::periodic(DVec3::ZERO, DMat3::IDENTITY)
}

fn sheared() -> Cell {
    let edges = DMat3::from_cols(DVec3::X, DVec3::new(0.375, 1.0, 0.0), DVec3::new(-0.25, 0.4375, 1.25));
    Cell::periodic(DVec3::new(0.5, -1.0, 0.0), edges)
}

/// Whole steps anywhere in the cell.
fn cloud(dice: &mut Dice, cell: &Cell, n: usize) -> Vec<DVec3> {
    (0..n).map(|_| ((cell.origin + cell.edges * dice.point()) / STEP).round() * STEP).collect()
}

fn radii(dice: &mut Dice, n: usize, largest: f64) -> Vec<f64> {
    (0..n).map(|_| ((0.1 + 0.9 * dice.unit()) * largest / STEP).round() * STEP).collect()
}

fn cells() -> Vec<Cell> {
    let mut cells = vec![cube(), sheared()];
    for periodic in [[true, false, true], [true, true, false], [false, true, false], [false, false, true]] {
        cells.push(Cell { periodic, ..cube() });
    }
    let edges = DMat3::from_cols(DVec3::new(1.0, 0.0, 0.25), DVec3::Y * 0.75, DVec3::new(0.5, 0.0, 1.0));
    cells.push(Cell { origin: DVec3::ZERO, edges, periodic: [true, false, true] });
    cells
}

#[test]
fn small_samples() {
    let mut dice = Dice(11);
    for cell in cells() {
        for n in [1, 1, 2, 3, 5, 9, 14] {
            let x = cloud(&mut dice, &cell, n);
            let r = radii(&mut dice, n, 0.3);
            check(&cell, &x, &r, 3);
        }
    }
}

#[test]
fn small_samples_full_of_ties() {
    let mut dice = Dice(12);
    for cell in cells() {
        for m in [1u64, 2, 3, 4, 2, 3, 4] {
            let n = 1 + dice.below(10) as usize;
            let x: Vec<DVec3> = (0..n)
                .map(|_| {
                    let f = DVec3::new(dice.below(m) as f64, dice.below(m) as f64, dice.below(m) as f64)
                        / m as f64;
                    ((cell.origin + cell.edges * f) / STEP).round() * STEP
                })
                .collect();
            check(&cell, &x, &vec![0.125; n], 3);
        }
    }
}

#[test]
fn lattices_of_one_grain_per_period() {
    let face =
        DMat3::from_cols(DVec3::new(0.0, 0.5, 0.5), DVec3::new(0.5, 0.0, 0.5), DVec3::new(0.5, 0.5, 0.0));
    let body =
        DMat3::from_cols(DVec3::new(-0.5, 0.5, 0.5), DVec3::new(0.5, -0.5, 0.5), DVec3::new(0.5, 0.5, -0.5));
    for edges in [DMat3::IDENTITY, face, body] {
        let cell = Cell::periodic(DVec3::ZERO, edges);
        // Six tetrahedra per grain fill space in every lattice triangulation.
        assert_eq!(check(&cell, &[DVec3::ZERO], &[0.25], 3).pores.len(), 6);
    }
}

/// The pores, shifts and hidden grains are those at the central copy of 27.
fn equal_to_tiled(cell: &Cell, x: &[DVec3], r: &[f64]) {
    let n = x.len();
    let t = Triangulation::new(cell, x, r).unwrap();
    complex(cell, x, &t);
    let shifts: Vec<[i64; 3]> = (0..27).map(|c| [c % 3 - 1, c / 3 % 3 - 1, c / 9 - 1]).collect();
    let tiled: Vec<DVec3> = shifts
        .iter()
        .flat_map(|s| x.iter().map(|p| *p + cell.edges * DVec3::new(s[0] as f64, s[1] as f64, s[2] as f64)))
        .collect();
    let big = Triangulation::new(&Cell::walled(DVec3::splat(-8.0), DVec3::splat(8.0)), &tiled, &r.repeat(27))
        .unwrap();
    // Pores of the tiled sample at the central copy.
    let central = 13 * n as u32..14 * n as u32;
    let of = |v: u32| (v % n as u32, shifts[v as usize / n]);
    let a: BTreeSet<Vec<Image>> = big
        .pores
        .iter()
        .filter(|p| p.iter().any(|v| central.contains(v)))
        .map(|p| normal(p.iter().map(|&v| of(v))))
        .collect();
    let b: BTreeSet<Vec<Image>> =
        (0..t.pores.len()).map(|p| normal((0..4).map(|k| image(&t, p, k)))).collect();
    assert_eq!(b.len(), t.pores.len(), "every pore appears once");
    assert!(a == b);
    let hidden: Vec<u32> =
        big.hidden.iter().filter(|v| central.contains(v)).map(|v| v - central.start).collect();
    assert_eq!(t.hidden, hidden);
}

/// Larger samples go through the torus; compare with images only by tiling.
#[test]
fn equal_to_the_sample_tiled_three_times() {
    let mut dice = Dice(13);
    let lattice: Vec<DVec3> = (0..1000)
        .map(|i| DVec3::new(f64::from(i % 10), f64::from(i / 10 % 10), f64::from(i / 100)) / 8.0)
        .filter(|p| p.max_element() < 1.0)
        .collect();
    for cell in [cube(), sheared()] {
        for trial in 0..3 {
            let x = if trial == 2 && cell == cube() {
                lattice.clone()
            } else {
                cloud(&mut dice, &cell, [60, 2000, 2000][trial])
            };
            let n = x.len();
            let r = if trial == 2 { vec![0.0625; n] } else { radii(&mut dice, n, 0.06) };
            equal_to_tiled(&cell, &x, &r);
        }
    }
}

#[test]
#[ignore = "long: 200 samples around the size at which the torus begins"]
fn equal_to_the_sample_tiled_where_the_torus_begins() {
    let mut dice = Dice(17);
    for trial in 0..100 {
        for cell in [cube(), sheared()] {
            let n = 60 + 12 * trial;
            let x = cloud(&mut dice, &cell, n);
            let largest = [0.0, 0.03, 0.1][trial % 3];
            equal_to_tiled(&cell, &x, &radii(&mut dice, n, largest));
        }
    }
}

/// Pores as sets, with each shift mapped.
fn pores(t: &Triangulation, map: impl Fn(u32, [i64; 3]) -> [i64; 3]) -> BTreeSet<Vec<Image>> {
    let mapped = |(v, s): Image| if wall(v).is_some() { (v, s) } else { (v, map(v, s)) };
    (0..t.pores.len()).map(|p| normal((0..4).map(|k| mapped(image(t, p, k))))).collect()
}

#[test]
fn moving_everything_changes_nothing() {
    let mut dice = Dice(14);
    for cell in cells() {
        for n in [3, 40, 1500] {
            let x = cloud(&mut dice, &cell, n);
            let r = radii(&mut dice, n, 0.05);
            let a = Triangulation::new(&cell, &x, &r).unwrap();
            complex(&cell, &x, &a);
            // Along the periodic axes, by a fraction of a period and whole periods of single grains.
            let mut by = DVec3::ZERO;
            for k in (0..3).filter(|&k| cell.periodic[k]) {
                by += cell.edges.col(k) * 0.3125;
            }
            let whole: Vec<[i64; 3]> = (0..n)
                .map(|_| [0, 1, 2].map(|k| if cell.periodic[k] { dice.below(7) as i64 - 3 } else { 0 }))
                .collect();
            let y: Vec<DVec3> =
                (0..n).map(|g| x[g] + by + cell.edges * DVec3::from(whole[g].map(|c| c as f64))).collect();
            let b = Triangulation::new(&cell, &y, &r).unwrap();
            let back = pores(&b, |v, s| [0, 1, 2].map(|k| s[k] + whole[v as usize][k]));
            assert!(back == pores(&a, |_, s| s));
            assert_eq!(a.hidden, b.hidden);
        }
    }
}

#[test]
fn a_change_of_lattice_basis_changes_only_shifts() {
    let mut dice = Dice(15);
    let changes = [
        [[1, 1, 0], [0, 1, 0], [0, 0, 1]],
        [[1, 2, -1], [0, 1, 3], [0, 0, 1]],
        [[0, 1, 0], [1, 0, 0], [4, -3, -1]],
    ];
    for cell in [cube(), sheared()] {
        for m in changes {
            for n in [1, 4, 30, 1500] {
                let x = cloud(&mut dice, &cell, n);
                let r = radii(&mut dice, n, 0.05);
                let a = Triangulation::new(&cell, &x, &r).unwrap();
                let matrix =
                    DMat3::from_cols_array_2d(&[0, 1, 2].map(|j| [0, 1, 2].map(|i| f64::from(m[i][j]))));
                let other = Cell { edges: cell.edges * matrix, ..cell };
                let b = Triangulation::new(&other, &x, &r).unwrap();
                complex(&other, &x, &b);
                let back =
                    pores(&b, |_, s| [0, 1, 2].map(|i| (0..3).map(|j| i64::from(m[i][j]) * s[j]).sum()));
                assert!(back == pores(&a, |_, s| s));
            }
        }
    }
}

#[test]
fn dense_samples_in_every_kind_of_cell() {
    let mut dice = Dice(16);
    for cell in cells() {
        let x = cloud(&mut dice, &cell, 5000);
        let r = radii(&mut dice, 5000, 0.04);
        let t = Triangulation::new(&cell, &x, &r).unwrap();
        complex(&cell, &x, &t);
        assert!(t.neighbours.iter().flatten().all(|&p| p != NONE));
    }
    // A slab and a needle: few grains across.
    for edges in [DVec3::new(1.0, 1.0, 0.0625), DVec3::new(1.0, 0.03125, 0.03125)] {
        let cell = Cell::periodic(DVec3::ZERO, DMat3::from_diagonal(edges));
        let x = cloud(&mut dice, &cell, 200);
        let t = Triangulation::new(&cell, &x, &radii(&mut dice, 200, 0.02)).unwrap();
        complex(&cell, &x, &t);
    }
}

#[test]
fn bad_periodic_input_is_named() {
    let fails = |cell: Cell, x: DVec3| Triangulation::new(&cell, &[x], &[0.1]).unwrap_err();
    let far = DVec3::new(1e9, 0.0, 0.0);
    assert_eq!(fails(cube(), far), TriangulationError::Far { grain: 0 });
    let flat = DMat3::from_cols(DVec3::X, DVec3::Y, DVec3::X + DVec3::Y);
    assert!(matches!(fails(Cell::periodic(DVec3::ZERO, flat), DVec3::ZERO), TriangulationError::Cell(_)));
    let tilted = DMat3::from_cols(DVec3::X, DVec3::Y, DVec3::new(0.0, 0.5, 1.0));
    let cell = Cell { origin: DVec3::ZERO, edges: tilted, periodic: [true, false, true] };
    assert!(matches!(fails(cell, DVec3::ZERO), TriangulationError::Cell(_)));
    let cell = Cell { periodic: [true, true, false], ..cube() };
    let outside = TriangulationError::Outside { grain: 0, face: 4 };
    assert_eq!(fails(cell, DVec3::new(7.5, 0.0, -0.5)), outside);
}

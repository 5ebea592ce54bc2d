//! What is derived from a triangulation: power cells, point location, derivatives of volume.

mod common;

use common::Dice;
use glam::{DMat3, DVec3};
use porograin_geometry::gradient::pore_volume_gradient;
use porograin_geometry::locate::locate;
use porograin_geometry::throat::{Packing, pore_volume, radical_centres, shapes, throats};
use porograin_geometry::triangulation::wall;
use porograin_geometry::voronoi::{Voronoi, voronoi};
use porograin_geometry::{Cell, Triangulation};
use std::f64::consts::PI;

fn cells() -> Vec<Cell> {
    let sheared = DMat3::from_cols(DVec3::X, DVec3::new(0.25, 1.0, 0.0), DVec3::new(-0.25, 0.125, 1.0));
    let mut cells = vec![Cell::periodic(DVec3::new(0.5, 0.0, -2.0), sheared)];
    for periodic in [[false; 3], [true; 3], [true, false, true], [false, false, true]] {
        cells.push(Cell { periodic, ..Cell::walled(DVec3::new(-1.0, 2.0, 0.0), DVec3::new(0.0, 3.5, 0.75)) });
    }
    cells
}

fn cloud(dice: &mut Dice, cell: &Cell, n: usize) -> (Vec<DVec3>, Vec<f64>) {
    let x = (0..n).map(|_| cell.origin + cell.edges * dice.point()).collect();
    (x, (0..n).map(|_| 0.02 + 0.05 * dice.unit()).collect())
}

/// Power distance to a point of the nearest image.
fn nearest(packing: Packing, x: DVec3) -> f64 {
    let range = |k: usize| if packing.cell.periodic[k] { -2..=2 } else { 0..=0 };
    let mut least = f64::INFINITY;
    for (i, j, k) in range(0).flat_map(|i| range(1).flat_map(move |j| range(2).map(move |k| (i, j, k)))) {
        let by = packing.cell.shift([i, j, k]);
        for (p, r) in packing.position.iter().zip(packing.radius) {
            least = least.min((x - *p - by).length_squared() - r * r);
        }
    }
    least
}

fn check(packing: Packing, v: &Voronoi) {
    let n = packing.position.len();
    let total: f64 = v.volume.iter().sum();
    assert!((total - packing.cell.volume()).abs() < 1e-11 * packing.cell.volume(), "{total}");
    // Every cell is closed.
    let mut closing = vec![DVec3::ZERO; n];
    for f in &v.facets {
        closing[f.between[0] as usize] += f.area;
        if wall(f.between[1]).is_none() {
            closing[f.between[1] as usize] -= f.area;
        }
    }
    for (g, c) in closing.iter().enumerate() {
        assert!(c.length() < 1e-11, "cell {g} is open by {c}");
        let own = v.around(g as u32).iter().map(|&f| &v.facets[f as usize]);
        assert!(own.into_iter().all(|f| f.between.contains(&(g as u32))));
    }
}

#[test]
fn power_cells_partition_the_sample() {
    let mut dice = Dice(31);
    for cell in cells() {
        for n in [1, 2, 7, 60, 900] {
            let (x, r) = cloud(&mut dice, &cell, n);
            let packing = Packing { cell: &cell, position: &x, radius: &r };
            let t = Triangulation::new(&cell, &x, &r).unwrap();
            let v = voronoi(packing, &t, &radical_centres(packing, &t));
            check(packing, &v);
            if n > 60 {
                continue;
            }
            for f in &v.facets {
                let a = x[f.between[0] as usize];
                let ra = r[f.between[0] as usize];
                let size = f.area.length();
                if size < 1e-6 {
                    continue;
                }
                let normal = f.area / size;
                match wall(f.between[1]) {
                    Some(face) => assert!(normal.distance(porograin_geometry::cell::NORMALS[face]) < 1e-6),
                    None => {
                        let b = x[f.between[1] as usize] + cell.shift(f.shift);
                        assert!(normal.distance((b - a).normalize()) < 1e-6, "{f:?}");
                    }
                }
                // The middle of a facet is as near to its grain as to any.
                let own = (f.centroid - a).length_squared() - ra * ra;
                assert!((own - nearest(packing, f.centroid)).abs() < 1e-9, "{f:?}");
                assert!(v.corners(f).len() > 2);
            }
        }
    }
}

/// Distance of a centre to the nearest other, images included.
fn free(cell: &Cell, x: &[DVec3], g: usize) -> f64 {
    let range = |k: usize| if cell.periodic[k] { -1..=1 } else { 0..=0 };
    let mut least = f64::INFINITY;
    for (i, j, k) in range(0).flat_map(|i| range(1).flat_map(move |j| range(2).map(move |k| (i, j, k)))) {
        let to = |p: &DVec3| (*p + cell.shift([i, j, k])).distance(x[g]);
        least = x.iter().map(to).filter(|d| *d > 0.0).fold(least, f64::min);
    }
    least
}

#[test]
fn void_and_surface_partition_every_cell() {
    let mut dice = Dice(34);
    for cell in cells() {
        for n in [1, 2, 7, 60, 900] {
            let (x, mut r) = cloud(&mut dice, &cell, n);
            // Overlaps, but no centre within another grain (or its own image).
            for g in 0..n {
                r[g] = r[g].min(free(&cell, &x, g));
            }
            let packing = Packing { cell: &cell, position: &x, radius: &r };
            let t = Triangulation::new(&cell, &x, &r).unwrap();
            let throats = throats(&t);
            let (mut void, mut grains, mut walls) = (0.0, vec![0.0; n], [0.0; 6]);
            let centres = radical_centres(packing, &t);
            for (vertices, shape) in shapes(packing, &t, &centres, &throats, |t, s| (t.vertices, s)) {
                void += shape.void;
                for (v, surface) in vertices.into_iter().zip(shape.surface) {
                    *wall(v).map_or_else(|| &mut grains[v as usize], |face| &mut walls[face]) += surface;
                }
            }
            assert!(t.hidden.is_empty());
            let seen = |g: usize| 4.0 * PI * r[g] * r[g];
            let solid: f64 = (0..n).map(|g| seen(g) * r[g] / 3.0).sum();
            assert!((void - (cell.volume() - solid)).abs() < 1e-10 * cell.volume(), "{void} {solid}");
            for g in 0..n {
                assert!((grains[g] - seen(g)).abs() < 1e-10 * seen(g), "grain {g} of {n}: {}", grains[g]);
            }
            for (face, found) in walls.into_iter().enumerate() {
                let e = |k: usize| cell.edges.col((face / 2 + k) % 3);
                let expected = if cell.periodic[face / 2] { 0.0 } else { e(1).cross(e(2)).length() };
                assert!((found - expected).abs() < 1e-10, "face {face}: {found} {expected}");
            }
        }
    }
}

#[test]
fn turning_and_moving_a_periodic_sample_turns_and_moves_everything() {
    let mut dice = Dice(35);
    let cell = cells()[0];
    let turn = DMat3::from_axis_angle(DVec3::new(1.0, -2.0, 0.5).normalize(), 1.1);
    let by = DVec3::new(0.3, -7.0, 2.5);
    let turned_cell = Cell { origin: turn * cell.origin + by, edges: turn * cell.edges, ..cell };
    for n in [1, 5, 60, 2000] {
        let (x, r) = cloud(&mut dice, &cell, n);
        let y: Vec<DVec3> = x.iter().map(|x| turn * *x + by).collect();
        let [before, after] = [(&cell, &x), (&turned_cell, &y)].map(|(cell, position)| {
            let packing = Packing { cell, position, radius: &r };
            let t = Triangulation::new(cell, position, &r).unwrap();
            let centres = radical_centres(packing, &t);
            let shapes = shapes(packing, &t, &centres, &throats(&t), |_, shape| shape);
            let volumes: Vec<f64> = (0..t.pores.len()).map(|p| pore_volume(packing, &t, p)).collect();
            let cells = voronoi(packing, &t, &centres);
            (t, shapes, volumes, cells)
        });
        // One grain per period ties everywhere: other pores, the same volumes.
        if n > 1 {
            assert!(before.0 == after.0, "the same pores with the same shifts");
            for (a, b) in before.1.iter().zip(&after.1) {
                assert!((turn * a.normal).distance(b.normal) < 1e-6);
                for (a, b) in [(a.area, b.area), (a.fluid_area, b.fluid_area), (a.void, b.void)] {
                    assert!((a - b).abs() < 1e-9, "{a} {b}");
                }
                assert!((0..3).all(|k| (a.surface[k] - b.surface[k]).abs() < 1e-9));
            }
            assert!(before.2.iter().zip(&after.2).all(|(a, b)| (a - b).abs() < 1e-12));
        }
        assert!(before.3.volume.iter().zip(&after.3.volume).all(|(a, b)| (a - b).abs() < 1e-9));
    }
}

#[test]
fn power_cells_of_lattices() {
    let cell = Cell::periodic(DVec3::ZERO, DMat3::IDENTITY);
    let one = |x: &[DVec3]| {
        let r = vec![0.25; x.len()];
        let packing = Packing { cell: &cell, position: x, radius: &r };
        let t = Triangulation::new(&cell, x, &r).unwrap();
        voronoi(packing, &t, &radical_centres(packing, &t))
    };
    let sizes = |v: &Voronoi| {
        let mut sizes: Vec<f64> = v.facets.iter().map(|f| f.area.length()).filter(|a| *a > 1e-9).collect();
        sizes.sort_by(f64::total_cmp);
        sizes
    };
    // Cube: three facets per grain; truncated octahedron: three squares (1/2)²/2 and four hexagons of side sqrt(2)/4.
    let cube = sizes(&one(&[DVec3::splat(0.125)]));
    assert!(cube.len() == 3 && cube.iter().all(|a| (a - 1.0).abs() < 1e-12), "{cube:?}");
    let body = sizes(&one(&[DVec3::ZERO, DVec3::splat(0.5)]));
    let expected = [vec![0.125; 6], vec![3.0 * 3f64.sqrt() / 16.0; 8]].concat();
    assert_eq!(body.len(), expected.len());
    assert!(body.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12), "{body:?}");
}

#[test]
fn located_pores_contain_their_points() {
    let mut dice = Dice(32);
    for cell in cells() {
        for n in [1, 3, 40, 2000] {
            let (x, r) = cloud(&mut dice, &cell, n);
            let packing = Packing { cell: &cell, position: &x, radius: &r };
            let t = Triangulation::new(&cell, &x, &r).unwrap();
            let mut hint = 0;
            for trial in 0..100 {
                let mut f = dice.point();
                for k in (0..3).filter(|&k| cell.periodic[k]) {
                    f[k] = 7.0 * f[k] - 3.0;
                }
                let p = if trial == 0 { x[0] } else { cell.origin + cell.edges * f };
                let found = locate(packing, &t, p, hint).unwrap();
                hint = if trial % 3 == 0 { u32::MAX } else { found.pore };
                for k in 0..4 {
                    let facet = porograin_geometry::triangulation::FACET[k];
                    let [a, b, c] = facet.map(|j| match packing.point(&t, found.pore as usize, j) {
                        Some(q) => q + found.offset - p,
                        None => {
                            porograin_geometry::cell::NORMALS[wall(t.pores[found.pore as usize][j]).unwrap()]
                        }
                    });
                    assert!(a.dot(b.cross(c)) > -1e-12);
                }
            }
            assert_eq!(locate(packing, &t, DVec3::NAN, 0), None);
        }
    }
}

#[test]
fn volume_derivatives_are_those_of_the_volumes() {
    let mut dice = Dice(33);
    for cell in cells() {
        let (mut x, r) = cloud(&mut dice, &cell, 30);
        let t = Triangulation::new(&cell, &x, &r).unwrap();
        let mut kinds = [0; 5];
        for pore in 0..t.pores.len() {
            let packing = Packing { cell: &cell, position: &x, radius: &r };
            let gradient = pore_volume_gradient(packing, &t, pore);
            assert!(gradient.iter().sum::<DVec3>().length() < 1e-13);
            kinds[t.pores[pore].iter().filter(|v| wall(**v).is_some()).count()] += 1;
            for k in 0..4 {
                let v = t.pores[pore][k];
                let direction = dice.point() - 0.5;
                // By central differences; every image of a grain moves with it.
                let own = (0..4).filter(|&m| t.pores[pore][m] == v);
                let expected: f64 = own.map(|m| gradient[m].dot(direction)).sum();
                let h = 1e-5;
                let volume = |x: &[DVec3], cell: &Cell| {
                    pore_volume(Packing { cell, position: x, radius: &r }, &t, pore)
                };
                let measured = match wall(v) {
                    None => {
                        let home = x[v as usize];
                        x[v as usize] = home + direction * h;
                        let up = volume(&x, &cell);
                        x[v as usize] = home - direction * h;
                        let down = volume(&x, &cell);
                        x[v as usize] = home;
                        (up - down) / (2.0 * h)
                    }
                    Some(face) => {
                        let axis = face / 2;
                        let moved = |by: f64| {
                            let mut other = cell;
                            if face % 2 == 0 {
                                other.origin[axis] += by;
                                other.edges.col_mut(axis)[axis] -= by;
                            } else {
                                other.edges.col_mut(axis)[axis] += by;
                            }
                            volume(&x, &other)
                        };
                        let by = h * direction[axis];
                        (moved(by) - moved(-by)) / (2.0 * h)
                    }
                };
                assert!((measured - expected).abs() < 1e-8, "{:?}: {measured} {expected}", t.pores[pore]);
            }
        }
        let walls = cell.periodic.iter().filter(|p| !**p).count();
        assert!((0..=walls).all(|k| kinds[k] > 0), "{kinds:?}");
    }
}

#[test]
fn two_threads_give_the_bits_of_one() {
    let mut dice = Dice(35);
    for cell in cells() {
        let (x, r) = cloud(&mut dice, &cell, 3000);
        let middle = cell.origin + cell.edges * DVec3::splat(0.5);
        // Towards the middle, so that no grain leaves the cell.
        let moved: Vec<DVec3> = x.iter().map(|&x| x + 0.004 * dice.unit() * (middle - x)).collect();
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let packing = Packing { cell: &cell, position: &x, radius: &r };
                let mut t = Triangulation::new(&cell, &x, &r).unwrap();
                let centres = radical_centres(packing, &t);
                let all = shapes(packing, &t, &centres, &throats(&t), |_, s| {
                    [s.void, s.surface[0], s.surface[1], s.surface[2]].map(f64::to_bits)
                });
                t.repair(&cell, &moved, &r).unwrap();
                (all, t)
            })
        };
        assert!(run(1) == run(2));
    }
}

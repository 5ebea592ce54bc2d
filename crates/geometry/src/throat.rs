//! The shape of pores and throats: radical centres, signed solid angles, void volumes, wetted surfaces, areas.
//!
//! A throat is the facet shared by two pores. Its three vertices are grains or walls; a wall counts as the point at
//! infinity along its outward normal, cut off at the wall itself. So the facet is
//!
//! | vertices          | polygon                                                          |
//! |-------------------|------------------------------------------------------------------|
//! | 3 grains          | their triangle                                                   |
//! | 2 grains, 1 wall  | the trapezoid down to their projections on the wall              |
//! | 1 grain, 2 walls  | the rectangle between the grain and the edge where the walls meet |
//!
//! and the throat's region is the double pyramid on that polygon whose apexes are the radical centres of the two
//! pores. Everything is signed by the side on which a centre lies, which makes the regions partition the sample
//! exactly: over all throats the void volumes sum to the void, the wetted surfaces to the surface of the solid. Overlapping
//! grains count as often as they overlap; no centre may lie so deep in another grain that it leaves its own power cell.

mod shape;

use crate::cell::{Cell, NORMALS};
use crate::triangulation::{FACET, NONE, Triangulation, Vertex, wall};
use glam::DVec3;
use rayon::prelude::*;

/// A pore thinner than this (volume over the product of three edge lengths) is flat: its own radical centre is
/// decided by rounding, so it takes a neighbour's. Random dense packings hold about one such pore in 10⁵.
pub const FLAT: f64 = 1e-5;

/// The packing a triangulation was made of.
#[derive(Clone, Copy, Debug)]
pub struct Packing<'a> {
    /// The region.
    pub cell: &'a Cell,
    /// Centres of the grains [m].
    pub position: &'a [DVec3],
    /// Radii of the grains [m].
    pub radius: &'a [f64],
}

/// Radical (power) centre of every pore.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Centres {
    /// Where each pore's pressure lives [m], in the frame of the pore's vertex shifts.
    pub point: Vec<DVec3>,
    /// Flat pores, each with the neighbour whose centre it took.
    pub borrowed: Vec<[u32; 2]>,
}

/// A facet shared by two pores.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Throat {
    /// The two pores; the normal points from the first to the second.
    pub pores: [u32; 2],
    /// Which facet of the first pore it is.
    pub facet: u8,
    /// Its vertices, counter-clockwise seen from the second pore.
    pub vertices: [Vertex; 3],
    /// What to add to the second pore's shifts to bring it beside the first.
    pub shift: [i8; 3],
}

/// Areas, volumes and surfaces of a throat. Entries of three belong to its three vertices.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shape {
    /// Unit normal from the first pore to the second; zero where the facet has no area.
    pub normal: DVec3,
    /// Area of the whole polygon [m²].
    pub area: f64,
    /// Centroid of the polygon [m].
    pub centroid: DVec3,
    /// Distance between the two radical centres along the normal [m].
    pub length: f64,
    /// Facet angle at each grain [rad]; zero at walls.
    pub angle: [f64; 3],
    /// Area of the polygon that each grain covers [m²]: the sector `angle r²/2`, less what reaches past the other
    /// edges; zero at walls.
    pub covered: [f64; 3],
    /// First moment of the covered area about the grain's centre [m³].
    pub covered_moment: [DVec3; 3],
    /// First moment of the whole sector about the grain's centre [m³]; over the facets of one pore that meet at a
    /// grain, the sum of `normal x sector_moment` vanishes.
    pub sector_moment: [DVec3; 3],
    /// The polygon less the covered areas [m²].
    pub fluid_area: f64,
    /// Void volume of the double pyramid [m³].
    pub void: f64,
    /// Surface of each vertex in the double pyramid: of the sphere, or of the wall [m²].
    pub surface: [f64; 3],
}

impl Throat {
    /// The places of the throat's vertices in the second pore. Names alone do not tell: in a small periodic sample a
    /// pore can have several images of one grain.
    pub fn slots(&self, mesh: &Triangulation) -> [usize; 3] {
        let [first, second] = self.pores.map(|pore| pore as usize);
        std::array::from_fn(|k| {
            let same = |&slot: &usize| {
                let (vertex, other) = (self.vertices[k], mesh.pores[second][slot]);
                vertex == other
                    && (mesh.shifts.is_empty() || wall(vertex).is_some() || {
                        let mine = mesh.shifts[first][FACET[self.facet as usize][k]];
                        let theirs = mesh.shifts[second][slot];
                        (0..3).all(|axis| theirs[axis] + self.shift[axis] == mine[axis])
                    })
            };
            // Two pores share all three vertices of the facet between them.
            (0..4).find(same).unwrap_or(0)
        })
    }
}

impl Packing<'_> {
    /// The centre of vertex `k` of a pore, or `None` for a wall.
    #[inline]
    pub fn point(&self, mesh: &Triangulation, pore: usize, k: usize) -> Option<DVec3> {
        let vertex = mesh.pores[pore][k];
        if wall(vertex).is_some() {
            return None;
        }
        let point = self.position[vertex as usize];
        Some(if mesh.shifts.is_empty() { point } else { point + self.cell.shift(mesh.shifts[pore][k]) })
    }
}

/// Direction from a grain at `x` to a vertex: the vector to another grain, the outward normal of a wall.
#[inline]
fn toward(x: DVec3, point: Option<DVec3>, vertex: Vertex) -> DVec3 {
    match point {
        Some(p) => p - x,
        None => NORMALS[(vertex - crate::triangulation::FIRST_WALL) as usize],
    }
}

/// Distance from `x` to the wall of `face`, positive inside [m].
#[inline]
pub(crate) fn depth(cell: &Cell, x: DVec3, face: usize) -> f64 {
    let axis = face / 2;
    (cell.wall_position(face) - x[axis]) * NORMALS[face][axis]
}

/// The radical centre of one pore and how thick the pore is (see [`FLAT`]).
///
/// In coordinates relative to one of its grains, of radius r, the centre y satisfies `2 b·y = |b|² - r_b² + r²` for
/// another grain at b and `2 n·y = 2 depth` for a wall: three planes.
fn radical_centre(packing: Packing, mesh: &Triangulation, pore: usize) -> (DVec3, f64) {
    let vertices = mesh.pores[pore];
    // The first vertex of a pore is a grain.
    let Some(origin) = packing.point(mesh, pore, 0) else { return (DVec3::NAN, 0.0) };
    let r = packing.radius[vertices[0] as usize];
    let plane = |k: usize| match packing.point(mesh, pore, k) {
        Some(x) => {
            let other = packing.radius[vertices[k] as usize];
            (x - origin, (x - origin).length_squared() + (r - other) * (r + other))
        }
        None => {
            let face = wall(vertices[k]).unwrap_or(0);
            (NORMALS[face], 2.0 * depth(packing.cell, origin, face))
        }
    };
    let [(b, hb), (c, hc), (d, hd)] = [plane(1), plane(2), plane(3)];
    let (cd, db, bc) = (c.cross(d), d.cross(b), b.cross(c));
    let det = b.dot(cd);
    let thickness = det.abs() / (b.length() * c.length() * d.length());
    let y = (cd * hb + db * hc + bc * hd) / (2.0 * det);
    (origin + y, if thickness.is_finite() { thickness } else { 0.0 })
}

/// Radical centres of all pores. A flat pore takes the centre of a neighbour, so that it forms one pore with it
/// and the result does not depend on which way rounding tipped it.
pub fn radical_centres(packing: Packing, mesh: &Triangulation) -> Centres {
    let found: Vec<(DVec3, f64)> =
        (0..mesh.pores.len()).into_par_iter().map(|pore| radical_centre(packing, mesh, pore)).collect();
    let mut centres = Centres { point: found.iter().map(|f| f.0).collect(), borrowed: Vec::new() };
    let mut waiting: Vec<u32> = (0..found.len() as u32).filter(|&i| found[i as usize].1 < FLAT).collect();
    if waiting.is_empty() {
        return centres;
    }
    let mut flat: Vec<bool> = found.iter().map(|f| f.1 < FLAT).collect();
    // Flat pores can neighbour flat pores: let the centres spread from round to round.
    while !waiting.is_empty() {
        let mut settled = Vec::new();
        for &pore in &waiting {
            let lender = (0..4).find_map(|k| {
                let other = mesh.neighbours[pore as usize][k];
                (other != NONE && !flat[other as usize]).then_some((k, other))
            });
            if let Some((k, other)) = lender {
                let shift = shift_to(mesh, pore as usize, k, other as usize);
                centres.point[pore as usize] = centres.point[other as usize] + packing.cell.shift(shift);
                centres.borrowed.push([pore, other]);
                settled.push(pore);
            }
        }
        if settled.is_empty() {
            break; // every pore is flat: a single sheet of grains cannot be, its walls stand off
        }
        for pore in &settled {
            flat[*pore as usize] = false;
        }
        waiting.retain(|&pore| flat[pore as usize]);
    }
    centres
}

/// What to add to the shifts of `other` to bring it beside `pore` across facet `k`.
pub(crate) fn shift_to(mesh: &Triangulation, pore: usize, k: usize, other: usize) -> [i8; 3] {
    if mesh.shifts.is_empty() {
        return [0; 3];
    }
    // The facet's grains with their shifts, seen from both sides, differ by one common shift.
    let mine = FACET[k].map(|m| (mesh.pores[pore][m], mesh.shifts[pore][m]));
    for opposite in 0..4 {
        if mesh.neighbours[other][opposite] != pore as u32 {
            continue;
        }
        let theirs = FACET[opposite].map(|m| (mesh.pores[other][m], mesh.shifts[other][m]));
        for anchor in mine.iter().filter(|v| wall(v.0).is_none()).take(1) {
            for candidate in theirs.iter().filter(|v| v.0 == anchor.0) {
                let shift: [i8; 3] = std::array::from_fn(|a| anchor.1[a] - candidate.1[a]);
                let same = shift != [0; 3] || pore != other || opposite != k;
                if same
                    && mine.iter().all(|v| {
                        theirs.iter().any(|w| {
                            w.0 == v.0 && (wall(v.0).is_some() || (0..3).all(|a| w.1[a] + shift[a] == v.1[a]))
                        })
                    })
                {
                    return shift;
                }
            }
        }
    }
    [0; 3]
}

/// Every facet shared by two pores, once, in the order of the lower pore.
pub fn throats(mesh: &Triangulation) -> Vec<Throat> {
    let mut throats = Vec::with_capacity(2 * mesh.pores.len());
    for pore in 0..mesh.pores.len() {
        for k in 0..4 {
            let other = mesh.neighbours[pore][k];
            if other == NONE || (other as usize) < pore {
                continue;
            }
            let shift = shift_to(mesh, pore, k, other as usize);
            // A pore beside its own image shares two facets with itself: keep the one seen in positive direction.
            if other as usize == pore && shift < [0; 3] {
                continue;
            }
            throats.push(Throat {
                pores: [pore as u32, other],
                facet: k as u8,
                vertices: FACET[k].map(|m| mesh.pores[pore][m]),
                shift,
            });
        }
    }
    throats
}

/// The numbers of one throat.
#[inline]
pub fn shape(packing: Packing, mesh: &Triangulation, centres: &Centres, throat: &Throat) -> Shape {
    let pore = throat.pores[0] as usize;
    let [i, j, k] = FACET[throat.facet as usize];
    let points = [packing.point(mesh, pore, i), packing.point(mesh, pore, j), packing.point(mesh, pore, k)];
    let [first, second] = throat.pores;
    let mut apexes = [centres.point[first as usize], centres.point[second as usize]];
    if !mesh.shifts.is_empty() {
        apexes[1] += packing.cell.shift(throat.shift);
    }
    match points {
        [Some(a), Some(b), Some(c)] => {
            let [i, j, k] = throat.vertices;
            let radius = [packing.radius[i as usize], packing.radius[j as usize], packing.radius[k as usize]];
            shape::of_triangle([a, b, c], radius, apexes)
        }
        _ => shape::at_walls(packing, throat.vertices, points, apexes),
    }
}

/// The corners of a throat's polygon, beside its first pore [m], and how many there are, 3 or 4; counter-clockwise seen
/// from the second pore.
pub fn corners(packing: Packing, mesh: &Triangulation, throat: &Throat) -> ([DVec3; 4], usize) {
    let points = FACET[throat.facet as usize].map(|k| packing.point(mesh, throat.pores[0] as usize, k));
    let (corners, count, _) = shape::polygon(packing.cell, throat.vertices, points);
    (corners, count)
}

/// What `keep` takes from the shape of each throat, in order. (A shape has 300 bytes: keep what is needed.)
pub fn shapes<T: Send>(
    packing: Packing,
    mesh: &Triangulation,
    centres: &Centres,
    throats: &[Throat],
    keep: impl Fn(&Throat, Shape) -> T + Sync,
) -> Vec<T> {
    let of = |throat: &Throat| keep(throat, shape(packing, mesh, centres, throat));
    throats.par_iter().with_min_len(256).map(of).collect()
}

/// Volume of each pore: the tetrahedron, or the prism between its grains and its walls [m³]; they sum to the cell.
pub fn pore_volume(packing: Packing, mesh: &Triangulation, pore: usize) -> f64 {
    let vertices = mesh.pores[pore];
    let point = |k: usize| packing.point(mesh, pore, k);
    let points = [point(0), point(1), point(2), point(3)];
    if let [Some(a), Some(b), Some(c), Some(d)] = points {
        return (b - a).cross(c - a).dot(d - a) / 6.0;
    }
    let Some(base) = points.iter().position(Option::is_some) else { return 0.0 };
    let Some(apex) = points[base] else { return 0.0 };
    // Pyramids from one of its corners over the facets and wall faces that do not contain it. Walls first: the
    // face on a wall has the area that closes the pore.
    let mut volume = 0.0;
    let mut closing = DVec3::ZERO;
    for k in 0..4 {
        let order = FACET[k];
        let corners: [Option<DVec3>; 3] = std::array::from_fn(|c| points[order[c]]);
        if corners.iter().all(Option::is_none) {
            continue;
        }
        let (corner, _, area) = shape::polygon(packing.cell, order.map(|m| vertices[m]), corners);
        closing += area;
        volume += area.dot(corner[0] - apex) / 3.0;
    }
    for &vertex in &vertices {
        if let Some(face) = wall(vertex) {
            volume -= closing.dot(NORMALS[face]) * depth(packing.cell, apex, face) / 3.0;
        }
    }
    volume
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// A deterministic cloud of non-overlapping spheres with radii spread over `ratio`.
    fn cloud(n: usize, ratio: f64, seed: u64) -> (Vec<DVec3>, Vec<f64>) {
        let mut s = seed;
        let mut random = move || {
            s = s.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (s >> 11) as f64 / (1u64 << 53) as f64
        };
        let (mut x, mut r): (Vec<DVec3>, Vec<f64>) = (Vec::new(), Vec::new());
        while x.len() < n {
            let radius = 0.06 * ratio.powf(-random());
            let free = |v: f64| radius + v * (1.0 - 2.0 * radius);
            let p = DVec3::new(free(random()), free(random()), free(random())) * DVec3::new(1.0, 1.2, 0.9)
                + DVec3::new(0.3, -0.1, 5.0);
            if x.iter().zip(&r).all(|(q, b): (&DVec3, &f64)| q.distance(p) > radius + b) {
                x.push(p);
                r.push(radius);
            }
        }
        (x, r)
    }

    fn partition_error(cell: &Cell, x: &[DVec3], r: &[f64]) -> [f64; 4] {
        let packing = Packing { cell, position: x, radius: r };
        let mesh = Triangulation::new(cell, x, r).unwrap();
        let centres = radical_centres(packing, &mesh);
        let throats = throats(&mesh);
        let shapes = shapes(packing, &mesh, &centres, &throats, |_, shape| shape);
        let box_volume = cell.volume();
        let solid: f64 = r.iter().map(|r| 4.0 / 3.0 * PI * r.powi(3)).sum();
        let surface: f64 = r.iter().map(|r| 4.0 * PI * r * r).sum();
        let size = cell.upper() - cell.origin;
        let walls = 2.0 * (size.x * size.y + size.y * size.z + size.z * size.x);
        let pores: f64 = (0..mesh.pores.len()).map(|i| pore_volume(packing, &mesh, i)).sum();
        let void: f64 = shapes.iter().map(|s| s.void).sum();
        let (mut wet, mut wet_walls) = (0.0, 0.0);
        for (throat, shape) in throats.iter().zip(&shapes) {
            for k in 0..3 {
                if wall(throat.vertices[k]).is_some() {
                    wet_walls += shape.surface[k];
                } else {
                    wet += shape.surface[k];
                }
            }
            assert!(shape.length >= -1e-9 && shape.fluid_area > 0.0, "{shape:?}");
        }
        [
            (pores / box_volume - 1.0).abs(),
            (void / (box_volume - solid) - 1.0).abs(),
            (wet / surface - 1.0).abs(),
            (wet_walls / walls - 1.0).abs(),
        ]
    }

    #[test]
    fn regions_partition_volume_void_and_surface() {
        let cell = Cell::walled(DVec3::new(0.3, -0.1, 5.0), DVec3::new(1.3, 1.1, 5.9));
        for (n, ratio) in [(1, 1.0), (2, 1.0), (7, 2.0), (300, 1.0), (400, 2.0), (600, 8.0)] {
            for seed in 1..4 {
                let (x, r) = cloud(n, ratio, seed);
                for error in partition_error(&cell, &x, &r) {
                    assert!(error < 1e-10, "{n} {ratio} {seed}: {error}");
                }
            }
        }
    }

    #[test]
    fn lattices_partition_too() {
        let cell = Cell::walled(DVec3::ZERO, DVec3::splat(4.0));
        let mut x = Vec::new();
        for i in 0..64 {
            x.push(DVec3::new((i % 4) as f64, (i / 4 % 4) as f64, (i / 16) as f64) + DVec3::splat(0.5));
        }
        for error in partition_error(&cell, &x, &[0.5; 64]) {
            assert!(error < 1e-10, "{error}");
        }
    }

    #[test]
    fn centres_have_equal_power_and_boundary_centres_lie_on_walls() {
        let cell = Cell::walled(DVec3::new(0.3, -0.1, 5.0), DVec3::new(1.3, 1.1, 5.9));
        let (x, r) = cloud(300, 3.0, 9);
        let packing = Packing { cell: &cell, position: &x, radius: &r };
        let mesh = Triangulation::new(&cell, &x, &r).unwrap();
        let centres = radical_centres(packing, &mesh);
        assert!(centres.borrowed.is_empty());
        for (vertices, p) in mesh.pores.iter().zip(&centres.point) {
            let mut power = Vec::new();
            for &v in vertices {
                match wall(v) {
                    Some(face) => assert!((p[face / 2] - cell.wall_position(face)).abs() < 1e-12),
                    None => power.push((x[v as usize] - *p).length_squared() - r[v as usize].powi(2)),
                }
            }
            assert!(power.iter().all(|w| (w - power[0]).abs() < 1e-9));
        }
    }

    #[test]
    fn sector_moments_close_around_each_grain_of_a_pore() {
        let cell = Cell::walled(DVec3::new(0.3, -0.1, 5.0), DVec3::new(1.3, 1.1, 5.9));
        let (x, r) = cloud(200, 3.0, 4);
        let packing = Packing { cell: &cell, position: &x, radius: &r };
        let mesh = Triangulation::new(&cell, &x, &r).unwrap();
        let centres = radical_centres(packing, &mesh);
        let mut sum = vec![[DVec3::ZERO; 4]; mesh.pores.len()];
        for throat in throats(&mesh) {
            let shape = shape(packing, &mesh, &centres, &throat);
            for (side, sign) in [(0, 1.0), (1, -1.0)] {
                let pore = throat.pores[side] as usize;
                for k in 0..3 {
                    let slot = mesh.pores[pore].iter().position(|&v| v == throat.vertices[k]).unwrap();
                    sum[pore][slot] += sign * shape.sector_moment[k].cross(shape.normal);
                }
            }
        }
        for (vertices, sums) in mesh.pores.iter().zip(&sum) {
            if vertices.iter().all(|&v| wall(v).is_none()) {
                assert!(sums.iter().all(|s| s.length() < 1e-15), "{sums:?}");
            }
        }
    }
}

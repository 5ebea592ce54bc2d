//! The numbers of one throat, from its vertices and the radical centres on its two sides.

use super::{Packing, Shape, depth, toward};
use crate::angle::angle;
use crate::cell::{Cell, NORMALS};
use crate::triangulation::{Vertex, wall};
use glam::DVec3;

/// The shape of a facet of three grains at `x` with radii `r`; `apexes` are the radical centres behind and before it.
#[inline]
pub(super) fn of_triangle(x: [DVec3; 3], r: [f64; 3], apexes: [DVec3; 2]) -> Shape {
    // Arrays are spelled out here: the compiler does not inline closures mapped over them.
    let edge = [x[1] - x[0], x[2] - x[1], x[0] - x[2]];
    let square = [edge[0].length_squared(), edge[1].length_squared(), edge[2].length_squared()];
    let length = [square[0].sqrt(), square[1].sqrt(), square[2].sqrt()];
    // Twice the area: the product of two edges, the same at every corner.
    let cross = edge[2].cross(edge[0]);
    let across = cross.length();
    if across == 0.0 {
        return Shape::default();
    }
    let mut shape = Shape::new(cross * 0.5, 0.5 * across, apexes);
    shape.centroid = (x[0] + x[1] + x[2]) / 3.0;
    let triple = [cross.dot(apexes[0] - x[0]), cross.dot(apexes[1] - x[0])];
    for k in 0..3 {
        let (next, previous) = ((k + 1) % 3, (k + 2) % 3);
        let corner = Corner {
            r: r[k],
            sides: [edge[k], -edge[previous]],
            lengths: [length[k], length[previous]],
            across,
            apexes: [apexes[0] - x[k], apexes[1] - x[k]],
            triple,
        };
        // The disc is cut where the opposite edge is nearer than its radius.
        let cut = if across * across < r[k] * r[k] * square[next] { covered(&x, x[k], r[k]) } else { None };
        shape.add(k, &corner, cut);
    }
    shape
}

/// The shape of a facet with one or two walls.
#[inline(never)]
pub(super) fn at_walls(
    packing: Packing,
    vertices: [Vertex; 3],
    points: [Option<DVec3>; 3],
    apexes: [DVec3; 2],
) -> Shape {
    let (corner, corners, area_vector) = polygon(packing.cell, vertices, points);
    let area = area_vector.length();
    if area == 0.0 {
        return Shape::default();
    }
    let mut shape = Shape::new(area_vector, area, apexes);
    let [a, b, c, d] = corner;
    let (one, two) = ((b - a).cross(c - a).dot(shape.normal), (c - a).cross(d - a).dot(shape.normal));
    shape.centroid = (one * (a + b + c) + two * (a + c + d)) / (3.0 * (one + two));
    for k in 0..3 {
        let (next, previous) = ((k + 1) % 3, (k + 2) % 3);
        match points[k] {
            Some(x) => {
                let r = packing.radius[vertices[k] as usize];
                let sides = [next, previous].map(|j| toward(x, points[j], vertices[j]));
                let cross = sides[0].cross(sides[1]);
                let apexes = apexes.map(|apex| apex - x);
                let corner = Corner {
                    r,
                    sides,
                    lengths: sides.map(|side| side.length()),
                    across: cross.dot(shape.normal).max(0.0),
                    apexes,
                    triple: apexes.map(|apex| cross.dot(apex)),
                };
                shape.add(k, &corner, covered(&[a, b, c, d][..corners], x, r));
            }
            None => {
                // The wall's part of the region is a triangle or a kite: half the product of its diagonals.
                let width = match (points[next], points[previous]) {
                    (Some(a), Some(b)) => {
                        let n = NORMALS[wall(vertices[k]).unwrap_or(0)];
                        (b - a).cross(n).length()
                    }
                    (Some(a), None) => depth(packing.cell, a, wall(vertices[previous]).unwrap_or(0)),
                    (None, Some(a)) => depth(packing.cell, a, wall(vertices[next]).unwrap_or(0)),
                    (None, None) => 0.0,
                };
                shape.surface[k] = 0.5 * width * shape.length;
            }
        }
    }
    shape
}

/// A facet as seen from one of its grains.
struct Corner {
    r: f64,
    /// Directions to the next and the previous vertex: edges, or the normals of walls.
    sides: [DVec3; 2],
    lengths: [f64; 2],
    /// Length of the product of the sides.
    across: f64,
    /// The radical centres from the grain, and their products with those of the sides.
    apexes: [DVec3; 2],
    triple: [f64; 2],
}

impl Shape {
    fn new(area_vector: DVec3, area: f64, apexes: [DVec3; 2]) -> Self {
        let normal = area_vector / area;
        let length = (apexes[1] - apexes[0]).dot(normal);
        Shape { normal, area, length, fluid_area: area, void: area * length / 3.0, ..Shape::default() }
    }

    /// Takes in the grain at corner `k`; `cut` is the part of the polygon it covers where that is not the whole sector.
    #[inline(always)]
    fn add(&mut self, k: usize, corner: &Corner, cut: Option<(f64, DVec3)>) {
        let &Corner { r, sides: [u, v], lengths: [lu, lv], across, .. } = corner;
        let (product, dot) = (lu * lv, u.dot(v));
        self.angle[k] = angle(across, dot);
        let (squared, cubed) = (r * r, r * r * r);
        // The first moment of a sector is 2/3 r³ sin(angle/2) along the bisector u/|u| + v/|v|, whose
        // length is 2 cos(angle/2); tan(angle/2) = sin / (1 + cos).
        let tangent = if product + dot > 1e-14 * product { across / (product + dot) } else { 0.0 };
        self.sector_moment[k] = (u * lv + v * lu) * (cubed / 3.0 * tangent / product);
        (self.covered[k], self.covered_moment[k]) =
            cut.unwrap_or((0.5 * self.angle[k] * squared, self.sector_moment[k]));
        self.fluid_area -= self.covered[k];
        let solid_angle = corner.solid_angle(product, dot);
        self.void -= solid_angle * cubed / 3.0;
        self.surface[k] = solid_angle * squared;
    }
}

impl Corner {
    /// Solid angle spanned by the sides and the two apexes: that of the cone with the second less that of the
    /// cone with the first, each signed by the side of the facet (Van Oosterom & Strackee 1983). The facet's
    /// normal points to the side of the second.
    #[inline(always)]
    fn solid_angle(&self, product: f64, dot: f64) -> f64 {
        let [u, v] = self.sides;
        // tan(half the solid angle) = triple product / real part; the difference of two angles is the argument of a
        // product of complex numbers, which costs one arctangent in place of two.
        let middle = u * self.lengths[1] + v * self.lengths[0];
        let real = |w: DVec3| (product + dot) * w.length() + w.dot(middle);
        let ([re1, re2], [im1, im2]) = ([real(self.apexes[0]), real(self.apexes[1])], self.triple);
        2.0 * angle(im2 * re1 - re2 * im1, re1 * re2 + im1 * im2)
    }
}

/// The polygon of a facet: its corners (3 or 4), and its area as a vector along the outward normal.
pub(super) fn polygon(
    cell: &Cell,
    vertices: [Vertex; 3],
    points: [Option<DVec3>; 3],
) -> ([DVec3; 4], usize, DVec3) {
    let onto = |x: DVec3, face: usize| x + NORMALS[face] * depth(cell, x, face);
    match points {
        [Some(a), Some(b), Some(c)] => ([a, b, c, c], 3, (b - a).cross(c - a) * 0.5),
        _ => {
            // Turn the triple until its walls stand last.
            let grain = |k: usize| points[k % 3].is_some();
            let s = (0..3).find(|&s| grain(s) && !grain(s + 2)).unwrap_or(0);
            let at = |k: usize| (points[(s + k) % 3], vertices[(s + k) % 3]);
            match (at(0), at(1), at(2)) {
                ((Some(a), _), (Some(b), _), (None, w)) => {
                    let face = wall(w).unwrap_or(0);
                    let mean = 0.5 * (depth(cell, a, face) + depth(cell, b, face));
                    ([a, b, onto(b, face), onto(a, face)], 4, mean * (b - a).cross(NORMALS[face]))
                }
                ((Some(a), _), (None, u), (None, v)) => {
                    let (f, g) = (wall(u).unwrap_or(0), wall(v).unwrap_or(0));
                    let area = depth(cell, a, f) * depth(cell, a, g) * NORMALS[f].cross(NORMALS[g]);
                    ([a, onto(a, f), onto(onto(a, f), g), onto(a, g)], 4, area)
                }
                _ => ([DVec3::ZERO; 4], 3, DVec3::ZERO),
            }
        }
    }
}

/// Area and first moment about `x` of the part of a convex polygon that the disc about its corner `x` covers;
/// `None` if the disc reaches past no edge, so that the part is the whole sector.
fn covered(corner: &[DVec3], x: DVec3, r: f64) -> Option<(f64, DVec3)> {
    let n = corner.len();
    let edges = || (0..n).map(|k| (corner[k] - x, corner[if k + 1 == n { 0 } else { k + 1 }] - x));
    let reaches = |(p, q): (DVec3, DVec3)| {
        p != DVec3::ZERO && q != DVec3::ZERO && p.cross(q).length_squared() < r * r * (q - p).length_squared()
    };
    if !edges().any(reaches) {
        return None;
    }
    let (mut area, mut moment, mut cut) = (0.0, DVec3::ZERO, false);
    for (p, q) in edges() {
        let edge = (q - p).length();
        // Edges that end at x span no triangle with it.
        if p == DVec3::ZERO || q == DVec3::ZERO || edge == 0.0 {
            continue;
        }
        let along = (q - p) / edge;
        let (from, to) = (p.dot(along), q.dot(along));
        let foot = p - along * from;
        let height = foot.length();
        let out = foot.normalize_or_zero();
        // Along the edge, measured from the foot of the perpendicular: within the disc the part is a triangle,
        // on either side a sector.
        let half = (r * r - height * height).max(0.0).sqrt();
        cut |= half > 0.0 && from < half && to > -half;
        let (a, b) = (from.max(-half), to.min(half));
        if b > a {
            let triangle = 0.5 * height * (b - a);
            area += triangle;
            moment += triangle / 3.0 * (2.0 * foot + along * (a + b));
        }
        for (s, t) in [(from, to.min(-half)), (from.max(half), to)] {
            if t > s {
                let (begin, end) = (s.atan2(height), t.atan2(height));
                area += 0.5 * r * r * (end - begin);
                moment +=
                    r * r * r / 3.0 * ((end.sin() - begin.sin()) * out + (begin.cos() - end.cos()) * along);
            }
        }
    }
    cut.then_some((area, moment))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_past_the_opposite_edge_is_cut() {
        // Corner at the origin, opposite edge x = 0.5 from y = -1 to 1, unit disc: triangle of height 0.5.
        let corner = [DVec3::ZERO, DVec3::new(0.5, -1.0, 0.0), DVec3::new(0.5, 1.0, 0.0)];
        let (area, moment) = covered(&corner, DVec3::ZERO, 1.0).unwrap();
        // By integration in polar angle: within |phi| < 60° the ray ends on the edge, beyond on the circle.
        let n = 200_000;
        let phi0 = 2.0_f64.atan();
        let (mut a, mut mx) = (0.0, 0.0);
        for i in 0..n {
            let phi = phi0 * (2.0 * (i as f64 + 0.5) / n as f64 - 1.0);
            let reach = (0.5 / phi.cos()).min(1.0);
            a += 0.5 * reach * reach * 2.0 * phi0 / n as f64;
            mx += reach.powi(3) / 3.0 * phi.cos() * 2.0 * phi0 / n as f64;
        }
        assert!(
            (area - a).abs() < 1e-9 && (moment - DVec3::X * mx).length() < 1e-9,
            "{area} {a} {moment} {mx}"
        );
        assert!(covered(&corner, DVec3::ZERO, 0.49).is_none());
    }
}

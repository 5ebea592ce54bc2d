//! What walls look like, and where a grain touches them.

use super::Mesh;
use glam::DVec3;
use std::sync::Arc;

/// A surface, at the place where the case puts it [m]. All but the plane have two sides and no thickness.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// An endless plane; grains are on the side its normal points to.
    Plane {
        /// On the plane.
        point: DVec3,
        /// Unit vector.
        normal: DVec3,
    },
    /// A flat round plate.
    Disc {
        /// Its middle.
        centre: DVec3,
        /// Unit vector.
        normal: DVec3,
        /// Of its rim.
        radius: f64,
    },
    /// A tube, for grains inside and outside.
    Cylinder {
        /// On the axis, where the tube begins.
        point: DVec3,
        /// Unit vector.
        axis: DVec3,
        /// From the axis to the surface.
        radius: f64,
        /// Along the axis; `None`: endless in both directions.
        length: Option<f64>,
    },
    /// Triangles: rectangles, boxes, STL files.
    Mesh(Arc<Mesh>),
}

/// The place of a part of a wall that is nearest to a grain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foot {
    /// From the centre of the grain to the wall, as long as the distance.
    pub branch: DVec3,
    /// The same direction, of unit length, where the centre is on the wall.
    pub normal: DVec3,
}

impl Foot {
    /// The foot at `branch` from the centre; where that is no direction, `normal`.
    fn new(branch: DVec3, normal: DVec3) -> Self {
        Foot { branch, normal }
    }
}

impl Shape {
    /// Number of its parts.
    pub fn parts(&self) -> u32 {
        match self {
            Shape::Plane { .. } => 1,
            Shape::Disc { .. } => 2,
            Shape::Cylinder { .. } => 3,
            Shape::Mesh(mesh) => mesh.parts(),
        }
    }

    /// What its forces are moments about, and how it turns: a point of the plane, the middle of everything else [m].
    pub fn centre(&self) -> DVec3 {
        match self {
            Shape::Plane { point, .. } => *point,
            Shape::Disc { centre, .. } => *centre,
            Shape::Cylinder { point, axis, length, .. } => *point + 0.5 * length.unwrap_or(0.0) * *axis,
            Shape::Mesh(mesh) => mesh.centre(),
        }
    }

    /// Distance of its furthest point from its centre [m]; infinite for endless ones.
    pub fn extent(&self) -> f64 {
        match self {
            Shape::Plane { .. } | Shape::Cylinder { length: None, .. } => f64::INFINITY,
            Shape::Disc { radius, .. } => *radius,
            Shape::Cylinder { radius, length: Some(length), .. } => radius.hypot(0.5 * length),
            Shape::Mesh(mesh) => mesh.extent(),
        }
    }

    /// Whether it looks the same from everywhere along this direction.
    pub fn is_endless_along(&self, direction: DVec3) -> bool {
        match self {
            Shape::Plane { normal, .. } => normal.dot(direction).abs() <= 1e-12 * direction.length(),
            Shape::Cylinder { axis, length: None, .. } => {
                axis.cross(direction).length() <= 1e-12 * direction.length()
            }
            _ => false,
        }
    }

    /// Appends the triangles of a mesh that are within `reach` of a centre; returns whether anything of the wall is
    /// within. For all but meshes the answer may be yes a little too early.
    pub fn near(&self, centre: DVec3, reach: f64, triangles: &mut Vec<u32>) -> bool {
        match self {
            Shape::Plane { point, normal } => (centre - *point).dot(*normal) < reach,
            Shape::Disc { centre: middle, normal, radius } => {
                let from = centre - *middle;
                let height = from.dot(*normal);
                height.abs() < reach && (from - height * *normal).length() < radius + reach
            }
            Shape::Cylinder { point, axis, radius, length } => {
                let (along, out) = split(centre - *point, *axis);
                (out.length() - radius).abs() < reach
                    && length.is_none_or(|length| -reach < along && along < length + reach)
            }
            Shape::Mesh(mesh) => mesh.near(centre, reach, triangles),
        }
    }

    /// Appends the parts on which a grain has a foot; `triangles` are those [near](Self::near) it.
    #[inline]
    pub fn feet(&self, centre: DVec3, triangles: &[u32], found: &mut Vec<u32>) {
        match self {
            Shape::Plane { .. } => found.push(0),
            Shape::Disc { centre: middle, normal, radius } => {
                let (_, out) = split(centre - *middle, *normal);
                found.push(u32::from(out.length_squared() > radius * radius));
            }
            Shape::Cylinder { point, axis, length, .. } => {
                let along = (centre - *point).dot(*axis);
                found.push(match length {
                    Some(_) if along < 0.0 => 1,
                    Some(length) if along > *length => 2,
                    _ => 0,
                });
            }
            Shape::Mesh(mesh) => mesh.feet(centre, triangles, found),
        }
    }

    /// The foot on a part, for which the part is taken to have no end.
    pub fn foot(&self, part: u32, centre: DVec3) -> Foot {
        match self {
            Shape::Plane { point, normal } => {
                // What has come through is still on the right side.
                let height = (centre - *point).dot(*normal).max(0.0);
                Foot::new(-height * *normal, -*normal)
            }
            Shape::Disc { centre: middle, normal, radius } => {
                let (height, out) = split(centre - *middle, *normal);
                match part {
                    0 => Foot::new(-height * *normal, -*normal),
                    _ => {
                        let outward = out.normalize_or(normal.any_orthonormal_vector());
                        let branch = (radius * outward - out) - height * *normal;
                        Foot::new(branch, -outward)
                    }
                }
            }
            Shape::Cylinder { point, axis, radius, length } => {
                let (along, out) = split(centre - *point, *axis);
                let outward = out.normalize_or(axis.any_orthonormal_vector());
                let branch = (radius - out.length()) * outward;
                match part {
                    0 => Foot::new(branch, outward),
                    1 => Foot::new(branch - along * *axis, outward),
                    _ => Foot::new(branch + (length.unwrap_or(0.0) - along) * *axis, outward),
                }
            }
            Shape::Mesh(mesh) => mesh.foot(part, centre),
        }
    }

    /// How deep a grain is in the wall at most [m]; `None` where it does not touch.
    pub fn depth(&self, centre: DVec3, radius: f64) -> Option<f64> {
        let (mut near, mut feet) = (Vec::new(), Vec::new());
        if !self.near(centre, radius, &mut near) {
            return None;
        }
        self.feet(centre, &near, &mut feet);
        let depth = |part: u32| radius - self.foot(part, centre).branch.length();
        feet.into_iter().map(depth).filter(|&depth| depth > 0.0).reduce(f64::max)
    }

    /// Area across a direction [m²] of what is flat and has an end; of a parallelogram or a disc.
    pub fn area_across(&self, direction: DVec3) -> Option<f64> {
        let area = match self {
            Shape::Disc { normal, radius, .. } => std::f64::consts::PI * radius * radius * *normal,
            Shape::Mesh(mesh) => mesh.area()?,
            Shape::Plane { .. } | Shape::Cylinder { .. } => return None,
        };
        Some(area.dot(direction.normalize()).abs())
    }

    /// How much a centre has come through a surface that grains are on one side of only [m]; negative in front.
    pub fn beyond(&self, centre: DVec3) -> Option<f64> {
        match self {
            Shape::Plane { point, normal } => Some(-(centre - *point).dot(*normal)),
            _ => None,
        }
    }

    /// Triangles that show it, those of endless ones cut off at `extent` from the centre of the view [m].
    pub fn drawn(&self, view: DVec3, extent: f64) -> Vec<[DVec3; 3]> {
        /// Corners of a circle.
        const CORNERS: usize = 48;
        let circle = |middle: DVec3, normal: DVec3, radius: f64| -> Vec<DVec3> {
            let (a, b) = normal.any_orthonormal_pair();
            let corner = |k: usize| {
                let (sin, cos) = (std::f64::consts::TAU * k as f64 / CORNERS as f64).sin_cos();
                middle + radius * (cos * a + sin * b)
            };
            (0..=CORNERS).map(|k| corner(k % CORNERS)).collect()
        };
        match self {
            Shape::Plane { point, normal } => {
                let middle = view - (view - *point).dot(*normal) * *normal;
                let (a, b) = normal.any_orthonormal_pair();
                let at = |s: f64, t: f64| middle + extent * (s * a + t * b);
                vec![
                    [at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0)],
                    [at(-1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)],
                ]
            }
            Shape::Disc { centre, normal, radius } => {
                circle(*centre, *normal, *radius).windows(2).map(|w| [*centre, w[0], w[1]]).collect()
            }
            Shape::Cylinder { point, axis, radius, length } => {
                let (from, to) = match length {
                    Some(length) => (*point, *point + *length * *axis),
                    None => {
                        let middle = *point + (view - *point).dot(*axis) * *axis;
                        (middle - extent * *axis, middle + extent * *axis)
                    }
                };
                let (low, high) = (circle(from, *axis, *radius), circle(to, *axis, *radius));
                let quad = |k: usize| [[low[k], low[k + 1], high[k + 1]], [low[k], high[k + 1], high[k]]];
                (0..CORNERS).flat_map(quad).collect()
            }
            Shape::Mesh(mesh) => mesh.triangles().collect(),
        }
    }
}

/// The part of a vector along a unit vector, and the rest.
#[inline]
fn split(x: DVec3, axis: DVec3) -> (f64, DVec3) {
    let along = x.dot(axis);
    (along, x - along * axis)
}

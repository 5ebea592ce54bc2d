//! How easily water passes a throat: pure functions of the throat's shape.

use crate::boundary::Slip;
use glam::DVec3;
use porograin_geometry::cell::NORMALS;
use porograin_geometry::throat::{Centres, Packing, Shape, Throat};
use porograin_geometry::triangulation::{FACET, Triangulation, Vertex, wall};
use serde::de::value::MapAccessDeserializer;
use serde::de::{self, Deserializer, IgnoredAny, MapAccess, Visitor};
use serde::{Deserialize, Serialize, Serializer};
use std::f64::consts::PI;
use std::fmt;

/// Solid fractions of a throat that the local drag is calibrated for; others count as the nearest of these.
const SOLID: [f64; 2] = [1e-4, 0.97];

/// The narrowest gap of the local drag, in radii of the grain.
const NARROWEST: f64 = 1e-3;

/// The factor of the hydraulic radius for which a round tube conducts as Hagen and Poiseuille say.
const ALPHA: f64 = 0.5;

/// The choice of conductance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Conductance {
    /// `g = alpha A_f R_h² / mu`, the hydraulic radius `R_h` being void volume over wetted surface (Catalano 3.4-3.5).
    HydraulicRadius {
        /// Calibration factor [-], 1/2 in the thesis.
        alpha: f64,
    },
    /// `g = 2 pi R_e⁴ / mu`, `R_e = (r_eq + r_in) / 4`: the radii of the disc with the throat's open area and of the circle
    /// between its grains (Catalano 3.6, after Bryant and Blunt). At a mirror the throat is half of a whole one.
    EffectiveRadius,
    /// `g = 2 A V eps^(9/4) / (3 mu D)`, `D = sum(gamma) (1/a + 11/(4 delta)) + 11/4 sum(gamma_w / h_w)`: the drag of
    /// the throat's grains, of mean radius `a`, at gaps `delta`, and of the walls `w` that water sticks to.
    #[default]
    LocalDrag,
    /// A function of your own, from Rust.
    Custom(Custom),
}

/// Names of the conductances as case files spell them, and what they are.
pub const CONDUCTANCES: [(&str, &str); 3] = [
    ("hydraulic-radius", "by the hydraulic radius of the throat (Catalano 2012)"),
    ("effective-radius", "by the narrowest section of the throat (Bryant and Blunt)"),
    ("local-drag", "by the drag of the throat's grains, calibrated on Stokes flow"),
];

/// A conductance written in Rust.
///
/// Checkpoints keep its `id` only: a run goes on with the mesh it has if the model's conductance has the same.
#[derive(Clone, Copy)]
pub struct Custom {
    /// Tells it from others.
    pub id: u32,
    /// `g / L` [m³/(Pa s)] of a throat with open area in water of the given viscosity [Pa s].
    pub of: fn(&Passage, f64) -> f64,
    /// How the viscous force is shared by the throat's vertices (not negative); scaled to the sum 1. For the thesis'
    /// shares take [`Passage::drag_surfaces`].
    pub shares: fn(&Passage) -> [f64; 3],
}

impl fmt::Debug for Custom {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "Custom({})", self.id)
    }
}

impl PartialEq for Custom {
    fn eq(&self, other: &Custom) -> bool {
        self.id == other.id
    }
}

impl Serialize for Custom {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.id.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Custom {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // Only ever compared with that of the model, which knows its functions.
        Ok(Custom {
            id: u32::deserialize(deserializer)?,
            of: |_, _| f64::NAN,
            shares: |passage| passage.drag_surfaces(),
        })
    }
}

/// Reads the choice of a case file: a name, or `{ hydraulic-radius = { alpha = 0.4 } }`.
///
/// # Errors
/// For other words and tables.
pub fn read<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Conductance, D::Error> {
    struct NameOrTable;
    impl<'de> Visitor<'de> for NameOrTable {
        type Value = Conductance;
        fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
            f.write_str(
                "the name of a conductance, or a table such as { hydraulic-radius = { alpha = 0.5 } }",
            )
        }
        fn visit_str<E: de::Error>(self, name: &str) -> Result<Conductance, E> {
            Conductance::named(name).ok_or_else(|| E::unknown_variant(name, &NAMES))
        }
        fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Conductance, A::Error> {
            #[derive(Deserialize)]
            #[serde(rename_all = "kebab-case")]
            enum WithFactor {
                HydraulicRadius(Factor),
                EffectiveRadius(IgnoredAny),
                LocalDrag(IgnoredAny),
            }
            #[derive(Deserialize)]
            #[serde(deny_unknown_fields)]
            struct Factor {
                alpha: f64,
            }
            match WithFactor::deserialize(MapAccessDeserializer::new(map))? {
                WithFactor::HydraulicRadius(Factor { alpha }) => Ok(Conductance::HydraulicRadius { alpha }),
                WithFactor::EffectiveRadius(_) | WithFactor::LocalDrag(_) => {
                    Err(de::Error::custom("only `hydraulic-radius` has a table: write this name alone"))
                }
            }
        }
    }
    const NAMES: [&str; 3] = [CONDUCTANCES[0].0, CONDUCTANCES[1].0, CONDUCTANCES[2].0];
    deserializer.deserialize_any(NameOrTable)
}

/// What the flow through one throat meets.
#[derive(Clone, Copy, Debug)]
pub struct Passage<'a> {
    /// The throat's areas, volumes and surfaces.
    pub shape: &'a Shape,
    /// Its vertices.
    pub vertices: [Vertex; 3],
    /// Whether water sticks to each of the six walls.
    pub slip: &'a [Slip; 6],
    /// Radii of its grains [m]; zero at walls.
    pub radius: [f64; 3],
    /// Length of the facet's edge on each wall [m]; zero at grains.
    pub edge: [f64; 3],
    /// From its first grain to the others, and straight to the walls [m].
    pub reach: [DVec3; 3],
    /// Width of the gap at each grain, from its surface to the middle of the throat [m]; zero at walls, negative where
    /// grains overlap much.
    pub gap: [f64; 3],
}

impl<'a> Passage<'a> {
    /// What the flow through `throat`, of the given shape, meets.
    pub fn new(
        packing: Packing,
        mesh: &Triangulation,
        centres: &Centres,
        throat: &Throat,
        shape: &'a Shape,
        slip: &'a [Slip; 6],
    ) -> Passage<'a> {
        let pore = throat.pores[0] as usize;
        let points = FACET[throat.facet as usize].map(|m| packing.point(mesh, pore, m));
        let (mut radius, mut edge, mut reach) = ([0.0; 3], [0.0; 3], [DVec3::ZERO; 3]);
        // Power of the first radical centre, less its squared distance to the facet [m²]: the same at every grain.
        let mut power = 0.0;
        let first = points.iter().flatten().next().copied().unwrap_or_default();
        for k in 0..3 {
            let (next, previous) = (points[(k + 1) % 3], points[(k + 2) % 3]);
            match (points[k], wall(throat.vertices[k])) {
                (Some(x), _) => {
                    radius[k] = packing.radius[throat.vertices[k] as usize];
                    reach[k] = x - first;
                    let from = centres.point[pore] - x;
                    let height = from.dot(shape.normal);
                    power = from.length_squared() - radius[k] * radius[k] - height * height;
                }
                (None, Some(face)) => {
                    let axis = face / 2;
                    reach[k][axis] = packing.cell.wall_position(face) - first[axis];
                    edge[k] = match (next, previous) {
                        (Some(a), Some(b)) => (b - a).reject_from_normalized(NORMALS[face]).length(),
                        // A rectangle: its other side is the grain's depth below this wall.
                        (Some(_), None) | (None, Some(_)) => shape.area / reach[k][axis].abs(),
                        (None, None) => 0.0,
                    };
                }
                (None, None) => {}
            }
        }
        // The same as sqrt(r² + power) - r, without the difference of near numbers.
        let gap = radius.map(|r| if r > 0.0 { power / ((r * r + power).max(0.0).sqrt() + r) } else { 0.0 });
        Passage { shape, vertices: throat.vertices, slip, radius, edge, reach, gap }
    }

    /// The gap at grain `k`, not narrower than the local drag is calibrated for [m].
    fn wide_gap(&self, k: usize) -> f64 {
        self.gap[k].max(NARROWEST * self.radius[k])
    }

    /// Part of the throat's region that is solid [-].
    fn solid(&self) -> f64 {
        1.0 - self.shape.void / (self.shape.area * self.shape.length / 3.0)
    }

    /// Whether water passes at all: no, where grains overlap so much that no void or no open area is left.
    fn is_open(&self) -> bool {
        self.shape.fluid_area > 0.0 && self.shape.void > 0.0 && self.shape.length > 0.0
    }

    /// Surface of each vertex that resists the flow [m²].
    pub fn drag_surfaces(&self) -> [f64; 3] {
        [0, 1, 2].map(|k| self.drag_surface(k))
    }

    /// How many of its vertices are walls that mirror the flow.
    fn mirrors(&self) -> i32 {
        self.vertices.iter().filter(|&&v| wall(v).is_some_and(|f| self.slip[f] == Slip::Symmetry)).count()
            as i32
    }

    /// Radius of the circle in the facet's plane that touches its grains and the walls that water sticks to; its centre
    /// lies on the mirrors [m]. Zero where there is none.
    ///
    /// With the centre at `y` from the first grain, of radius `r`, and the radius `c`: `|y| = r + c`, for another grain
    /// at `d` `d·y + (r_d - r) c = (|d|² + r² - r_d²)/2`, and for a wall at `d` `d·y + |d| c = |d|²`, without the
    /// `c` for a mirror. The last two make `y = y_0 + c y_1`.
    fn inscribed(&self) -> f64 {
        let Some(first) = (0..3).find(|&k| self.is_grain(k)) else { return 0.0 };
        let r = self.radius[first];
        let row = |k: usize| {
            let (d, other) = (self.reach[k], self.radius[k]);
            match wall(self.vertices[k]) {
                None => (d, other - r, 0.5 * (d.length_squared() + (r - other) * (r + other))),
                Some(face) if self.slip[face] == Slip::Symmetry => (d, 0.0, d.length_squared()),
                Some(_) => (d, d.length(), d.length_squared()),
            }
        };
        let [(d, dc, dh), (e, ec, eh)] = [row((first + 1) % 3), row((first + 2) % 3)];
        let n = self.shape.normal;
        let across = d.cross(e).dot(n);
        let solve = |dh: f64, eh: f64| (e.cross(n) * dh + n.cross(d) * eh) / across;
        let (y0, y1) = (solve(dh, eh), -solve(dc, ec));
        // (|y1|² - 1) c² + 2 (y0·y1 - r) c + |y0|² - r² = 0.
        let (a, b, rest) = (y1.length_squared() - 1.0, y0.dot(y1) - r, y0.length_squared() - r * r);
        let root = b * b - a * rest;
        if rest <= 0.0 || root < 0.0 {
            return 0.0;
        }
        // The smaller positive root, in the form that also holds for a = 0.
        let c = rest / (root.sqrt() - b);
        if c.is_finite() { c.max(0.0) } else { 0.0 }
    }

    /// `gamma_w / h_w` of wall `k` [m], `h_w` being the fluid area over the edge on the wall.
    fn wall_drag(&self, k: usize) -> f64 {
        self.drag_surface(k) * self.edge[k] / self.shape.fluid_area
    }

    fn is_grain(&self, k: usize) -> bool {
        wall(self.vertices[k]).is_none()
    }

    /// Surface of vertex `k` that resists the flow [m²]: all of a grain's, a wall's only where water sticks to it.
    #[inline]
    pub fn drag_surface(&self, k: usize) -> f64 {
        match wall(self.vertices[k]) {
            Some(face) if self.slip[face] == Slip::Symmetry => 0.0,
            // Where the two radical centres almost coincide rounding can tip the sign.
            _ => self.shape.surface[k].max(0.0),
        }
    }
}

impl Conductance {
    /// The hydraulic radius with the factor of a round tube, as in the thesis.
    pub const fn hydraulic_radius() -> Conductance {
        Conductance::HydraulicRadius { alpha: ALPHA }
    }

    /// The conductance of that name, with the factors it has unless told otherwise.
    pub fn named(name: &str) -> Option<Conductance> {
        let all = [Conductance::hydraulic_radius(), Conductance::EffectiveRadius, Conductance::LocalDrag];
        CONDUCTANCES.iter().position(|known| known.0 == name).map(|k| all[k])
    }

    /// Its name in case files.
    pub fn name(&self) -> &'static str {
        match self {
            Conductance::HydraulicRadius { .. } => CONDUCTANCES[0].0,
            Conductance::EffectiveRadius => CONDUCTANCES[1].0,
            Conductance::LocalDrag => CONDUCTANCES[2].0,
            Conductance::Custom(_) => "custom",
        }
    }

    /// Whether the throat lies outside the range this conductance is calibrated for and counts as one at its end.
    pub fn clamps(self, passage: &Passage) -> bool {
        if self != Conductance::LocalDrag || !passage.is_open() {
            return false;
        }
        let narrow = |k: usize| passage.gap[k] < NARROWEST * passage.radius[k];
        !(SOLID[0]..=SOLID[1]).contains(&passage.solid()) || (0..3).any(|k| passage.is_grain(k) && narrow(k))
    }

    /// `g / L` [m³/(Pa s)]: flux from the first pore to the second per pressure difference. Zero where grains
    /// overlap so much that no void or no open area is left.
    pub fn of(self, passage: &Passage, viscosity: f64) -> f64 {
        if !passage.is_open() {
            return 0.0;
        }
        let shape = passage.shape;
        match self {
            Conductance::HydraulicRadius { alpha } => {
                let wetted: f64 = passage.drag_surfaces().iter().sum();
                let radius = shape.void / wetted;
                alpha * shape.fluid_area * radius * radius / (viscosity * shape.length)
            }
            Conductance::EffectiveRadius => {
                let whole = 2.0f64.powi(passage.mirrors());
                let radius = 0.25 * ((whole * shape.fluid_area / PI).sqrt() + passage.inscribed());
                2.0 * PI * radius.powi(4) / (whole * viscosity * shape.length)
            }
            Conductance::LocalDrag => {
                let volume = shape.area * shape.length / 3.0;
                let solid = passage.solid().clamp(SOLID[0], SOLID[1]);
                let angles: f64 = shape.angle.iter().sum();
                let (mut surface, mut log_gap, mut walls) = (0.0, 0.0, 0.0);
                for k in 0..3 {
                    if passage.is_grain(k) {
                        surface += passage.drag_surface(k);
                        log_gap += shape.angle[k] / angles * passage.wide_gap(k).ln();
                    } else {
                        walls += passage.wall_drag(k);
                    }
                }
                let radius = 3.0 * solid * volume / surface;
                let drag = surface * (1.0 / radius + 2.75 / log_gap.exp()) + 2.75 * walls;
                2.0 / 3.0 * shape.area * volume * (1.0 - solid).powf(2.25) / (viscosity * drag * shape.length)
            }
            Conductance::Custom(custom) => (custom.of)(passage, viscosity),
        }
    }

    /// Shares (sum 1) of the throat's viscous force: in proportion to the surfaces (Catalano 3.14), or to their
    /// drag `gamma_k (1/R_k + 1/delta_k)`, `gamma_w / h_w` at walls.
    pub fn shares(self, passage: &Passage) -> [f64; 3] {
        let weight: [f64; 3] = match self {
            Conductance::LocalDrag if passage.shape.fluid_area > 0.0 => std::array::from_fn(|k| {
                if passage.is_grain(k) {
                    passage.drag_surface(k) * (1.0 / passage.radius[k] + 1.0 / passage.wide_gap(k))
                } else {
                    passage.wall_drag(k)
                }
            }),
            Conductance::Custom(custom) => (custom.shares)(passage),
            _ => passage.drag_surfaces(),
        };
        let total: f64 = weight.iter().sum();
        if total > 0.0 {
            return weight.map(|w| w / total);
        }
        let grains = passage.vertices.map(|v| f64::from(u8::from(wall(v).is_none())));
        let count: f64 = grains.iter().sum();
        grains.map(|g| g / count)
    }
}

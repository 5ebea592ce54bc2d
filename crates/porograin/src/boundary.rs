//! The faces of the domain: where they are now, what they do to grains, what they do to water.

use crate::expression::Expression;
use crate::membrane::Skin;
use crate::walls::{Glue, Place};
use glam::{DMat3, DVec3};
use porograin_geometry::Cell;
use serde::de::value::MapAccessDeserializer;
use serde::de::{Deserializer, MapAccess, Visitor};
use serde::{Deserialize, Serialize};

/// Names of the six faces as case files spell them, in face order.
pub const FACE_NAMES: [&str; 6] = ["left", "right", "front", "back", "bottom", "top"];

/// Where the faces are now and how they move.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Domain {
    /// The box.
    pub cell: Cell,
    /// Velocity of each wall, of the middle of the last step [m/s].
    pub wall_velocity: [DVec3; 6],
    /// Total force on each wall at the last step, grains and water together [N].
    pub wall_force: [DVec3; 6],
    /// Velocity gradient of a periodic cell in the middle of the last step [1/s].
    pub rate: DMat3,
    /// The period vectors as they were when the stage began, as columns: what [`Cell::edges`] has become of [m].
    pub reference: DMat3,
    /// Its images move at this times their shift [1/s]: the same gradient, referred to the end of the step.
    pub gradient: DMat3,
    /// The velocity gradient summed over time [-]: logarithmic strains and shear strains, extension positive.
    pub strain: DMat3,
    /// How many periods each grain has been taken back by, in the order of the grains; empty in a walled box.
    pub crossed: Vec<[i32; 3]>,
    /// Where the walls are that the case adds, in its order.
    pub walls: Vec<Place>,
    /// The grains that are glued to walls.
    pub glue: Glue,
    /// The membrane, where there is one.
    pub skin: Skin,
}

impl Domain {
    /// A walled box at rest.
    pub fn walled(lower: DVec3, upper: DVec3) -> Self {
        Domain {
            cell: Cell::walled(lower, upper),
            wall_velocity: Default::default(),
            wall_force: Default::default(),
            rate: DMat3::ZERO,
            reference: DMat3::from_diagonal(upper - lower),
            gradient: DMat3::ZERO,
            strain: DMat3::ZERO,
            crossed: Vec::new(),
            walls: Vec::new(),
            glue: Glue::default(),
            skin: Skin::default(),
        }
    }

    /// A cell at rest.
    pub fn of(cell: Cell) -> Self {
        Domain { cell, reference: cell.edges, ..Domain::walled(DVec3::ZERO, DVec3::ONE) }
    }

    /// Whether any axis is periodic.
    pub fn is_periodic(&self) -> bool {
        self.cell.periodic != [false; 3]
    }

    /// Where grain `k`, now at `x`, would be had it never been taken back into the cell [m].
    pub fn unwrapped(&self, k: usize, x: DVec3) -> DVec3 {
        let [a, b, c] = self.crossed.get(k).copied().unwrap_or_default();
        x + self.cell.edges * DVec3::new(a.into(), b.into(), c.into())
    }

    /// Velocity of a grain besides what goes with its place in the deforming cell [m/s].
    pub fn peculiar(&self, position: DVec3, velocity: DVec3) -> DVec3 {
        velocity - self.gradient * (position - self.cell.origin)
    }

    /// Area of a face [m²].
    pub fn area(&self, face: usize) -> f64 {
        let axis = face / 2;
        let (a, b) = (self.cell.edges.col((axis + 1) % 3), self.cell.edges.col((axis + 2) % 3));
        a.cross(b)[axis].abs()
    }
}

/// What one face does: a rule for the grains and a rule for the water.
#[derive(Clone, Debug, PartialEq)]
pub struct Face {
    /// How the wall moves.
    pub solid: Solid,
    /// What the water meets there.
    pub water: Water,
    /// Whether water sticks to the wall.
    pub slip: Slip,
    /// Friction angle between wall and grains [degrees].
    pub friction: f64,
    /// Whether the grains that touch the wall when this begins stick to it.
    pub glue: bool,
}

impl Default for Face {
    fn default() -> Self {
        Face { solid: Solid::Fixed, water: Water::Sealed, slip: Slip::Symmetry, friction: 0.0, glue: false }
    }
}

/// How a wall moves.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum Solid {
    /// It stays where it is.
    Fixed,
    /// It moves by decree [m/s].
    Moving {
        /// Velocity of the wall; the normal component moves the face, the tangential ones drag the grains.
        velocity: [Signal; 3],
    },
    /// A piston: a rigid plate with inertia, free along its normal, pressed by `stress` against grains and water.
    Servo {
        /// Total normal stress on the sample, positive in compression [Pa].
        stress: Signal,
        /// Mass of the plate [kg]; by default a tenth of the mass of the grains.
        mass: Option<f64>,
        /// The plate never moves faster than this [m/s]; by default the speed at which the sample deforms at the
        /// inertial number 0.01.
        speed: Option<f64>,
    },
}

/// What the water meets at a face.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Water {
    /// No flow through the face.
    Sealed,
    /// The excess pressure is imposed [Pa].
    Pressure(Signal),
    /// Water comes in at this rate per area of the face [m/s], the specific discharge; it leaves where negative.
    Inflow(Signal),
}

/// Whether the water slides along a wall freely or sticks to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Slip {
    /// The wall is a mirror: no shear.
    Symmetry,
    /// The wall's wetted surface resists the flow and takes its share of the drag.
    NoSlip,
}

/// A number that varies in time; in case files a plain number, a table such as `{ ramp = … }` or a formula.
#[derive(Clone, Debug, PartialEq)]
pub enum Signal {
    /// Always the same.
    Constant(f64),
    /// From `from` at time `start` to `to` at time `end`, constant before and after.
    Ramp {
        /// Value until `start`.
        from: f64,
        /// Value from `end` on.
        to: f64,
        /// [s]
        start: f64,
        /// [s]
        end: f64,
    },
    /// `mean + amplitude sin(2 pi (t - start) / period)`.
    Sine {
        /// Mean value.
        mean: f64,
        /// Amplitude.
        amplitude: f64,
        /// [s]
        period: f64,
        /// [s]
        start: f64,
    },
    /// Straight lines between points `[t, value]`, constant outside.
    Table(Vec<[f64; 2]>),
    /// A formula of t and, for the water, of x, y and z.
    Expression(Expression),
}

impl<'de> Deserialize<'de> for Signal {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        /// The choices that are written as a table; `untagged` would lose the place of an error inside.
        #[derive(Deserialize)]
        #[serde(rename_all = "kebab-case")]
        enum Varying {
            Ramp(Ramp),
            Sine(Sine),
            Table(Vec<[f64; 2]>),
        }
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Ramp {
            from: f64,
            to: f64,
            #[serde(default)]
            start: f64,
            end: f64,
        }
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Sine {
            #[serde(default)]
            mean: f64,
            amplitude: f64,
            period: f64,
            #[serde(default)]
            start: f64,
        }
        struct Any;
        impl<'de> Visitor<'de> for Any {
            type Value = Signal;
            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                f.write_str("a number, a table such as { ramp = { from = 0, to = 1, end = 2 } } or a formula of x, y, z, t")
            }
            fn visit_f64<E>(self, value: f64) -> Result<Signal, E> {
                Ok(Signal::Constant(value))
            }
            fn visit_i64<E>(self, value: i64) -> Result<Signal, E> {
                Ok(Signal::Constant(value as f64))
            }
            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Signal, E> {
                text.parse().map(Signal::Expression).map_err(E::custom)
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Signal, A::Error> {
                Ok(match Varying::deserialize(MapAccessDeserializer::new(map))? {
                    Varying::Ramp(Ramp { from, to, start, end }) => Signal::Ramp { from, to, start, end },
                    Varying::Sine(Sine { mean, amplitude, period, start }) => {
                        Signal::Sine { mean, amplitude, period, start }
                    }
                    Varying::Table(points) => Signal::Table(points),
                })
            }
        }
        deserializer.deserialize_any(Any)
    }
}

impl Signal {
    /// The value at time `t` of a signal that is the same everywhere; stage signals count `t` from the start of the
    /// stage.
    pub fn at(&self, t: f64) -> f64 {
        self.field(DVec3::ZERO, t)
    }

    /// Whether it depends on x, y or z.
    pub fn varies_in_space(&self) -> bool {
        matches!(self, Signal::Expression(formula) if formula.varies_in_space())
    }

    /// The value at the place `x` and time `t`.
    pub fn field(&self, x: DVec3, t: f64) -> f64 {
        match self {
            Signal::Expression(formula) => formula.at(x, t),
            Signal::Constant(value) => *value,
            Signal::Ramp { from, to, start, end } => {
                let part = if end > start {
                    ((t - start) / (end - start)).clamp(0.0, 1.0)
                } else {
                    f64::from(t >= *start)
                };
                from + (to - from) * part
            }
            Signal::Sine { mean, amplitude, period, start } => {
                mean + amplitude * (std::f64::consts::TAU * (t - start) / period).sin()
            }
            Signal::Table(points) => {
                let next = points.partition_point(|p| p[0] <= t);
                match (next.checked_sub(1).map(|k| points[k]), points.get(next)) {
                    (None, None) => 0.0,
                    (None, Some(first)) => first[1],
                    (Some(last), None) => last[1],
                    (Some(a), Some(b)) => a[1] + (b[1] - a[1]) * (t - a[0]) / (b[0] - a[0]),
                }
            }
        }
    }
}

//! Which axes of the domain are periodic, and what a case may ask of a periodic cell.

use super::check::Range;
use super::{Case, CaseError, FaceTable};
use crate::boundary::Signal;
use crate::cell::{COMPONENTS, CellRule};
use crate::grains::Grains;
use crate::model::Flow;
use glam::DMat3;
use porograin_geometry::{Cell, Neighbours, Period};
use serde::de::{self, Deserialize, Deserializer, SeqAccess, Visitor};

/// Which axes repeat: `"xy"` or `[true, true, false]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Periodic(pub [bool; 3]);

impl<'de> Deserialize<'de> for Periodic {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct AxesOrFlags;
        impl<'de> Visitor<'de> for AxesOrFlags {
            type Value = Periodic;
            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                f.write_str("the names of axes such as \"xy\", or three of true and false")
            }
            fn visit_str<E: de::Error>(self, text: &str) -> Result<Periodic, E> {
                let mut axes = [false; 3];
                for c in text.chars() {
                    let Some(axis) = "xyz".find(c).filter(|&axis| !axes[axis]) else {
                        return Err(E::invalid_value(de::Unexpected::Str(text), &self));
                    };
                    axes[axis] = true;
                }
                Ok(Periodic(axes))
            }
            fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<Periodic, A::Error> {
                <[bool; 3]>::deserialize(de::value::SeqAccessDeserializer::new(seq)).map(Periodic)
            }
        }
        deserializer.deserialize_any(AxesOrFlags)
    }
}

const AXES: [&str; 3] = ["x", "y", "z"];

impl Case {
    /// Faces across a periodic axis have no wall for a rule to speak of.
    pub(super) fn faces_are_walled(&self, table: &str, faces: &FaceTable) -> Result<(), CaseError> {
        let periodic = self.domain.periodic.0;
        for (key, _, which) in faces.rules() {
            if which.clone().all(|face| periodic[face / 2]) {
                let axes: Vec<&str> = (0..3).filter(|&k| periodic[k]).map(|k| AXES[k]).collect();
                return self.refuse(
                    &format!("{table}.{key}"),
                    format!("`{key}` has no wall: the domain is periodic along {}", axes.join(" and ")),
                );
            }
        }
        Ok(())
    }

    /// The size of the cell is given, or its periods, not both; periods lie along the walls, and each goes up along its own axis, which
    /// [`DomainTable::size`](super::DomainTable::size) then tells.
    pub(super) fn check_periods(&mut self) -> Result<(), CaseError> {
        let (path, walled) = ("domain.periods", self.domain.periodic.0.map(|periodic| !periodic));
        let Some(periods) = self.domain.periods else {
            let there = self.source.has("domain.size");
            return if there {
                Ok(())
            } else {
                self.refuse("domain", "the key `size` is missing in `domain`")
            };
        };
        if self.source.has("domain.size") {
            return self.refuse(path, "the cell has a `size` and `periods`: give one of the two");
        }
        if walled == [true; 3] || self.domain.discs {
            return self
                .refuse(path, "only a periodic domain of spheres has `periods`: give a box its `size`");
        }
        for (k, name) in AXES.into_iter().enumerate() {
            let along = periods[k][k];
            if along <= 0.0 {
                let sentence =
                    format!("period {} must go up along {name}, its own axis, not by {along} m", k + 1);
                return self.refuse(&format!("{path}.{k}"), sentence);
            }
            let leans = |axis: usize| axis != k && (walled[axis] || walled[k]) && periods[k][axis] != 0.0;
            if let Some(axis) = (0..3).find(|&axis| leans(axis)) {
                let sentence = format!(
                    "edge {} leans along {} by {} m, but the walls of this domain are across x, y or z",
                    k + 1,
                    AXES[axis],
                    periods[k][axis]
                );
                return self.refuse(&format!("{path}.{k}"), sentence);
            }
        }
        let edges = DMat3::from_cols_array_2d(&periods);
        let room = (0..3).map(|k| edges.col(k).length()).product::<f64>();
        if edges.determinant() < 1e-6 * room {
            return self.refuse(path, "the periods enclose no volume, or turn left-handed");
        }
        for (key, what) in [("cloud.within", "a part of it"), ("lattice.arrangement", "touching spheres")] {
            let path = format!("grains.packing.{key}");
            if self.source.has(&path) {
                let sentence =
                    format!("a cell given by its periods is not filled with {what}: give a `size`");
                return self.refuse(&path, sentence);
            }
        }
        self.domain.size = [0, 1, 2].map(|k| periods[k][k]);
        Ok(())
    }

    /// What is asked of the cell belongs to a periodic axis, once, and is in range.
    pub(super) fn cell_rule(&self, table: &str, rule: &CellRule) -> Result<(), CaseError> {
        let periodic = self.domain.periodic.0;
        self.optional(&format!("{table}.mass"), rule.mass, Range::Positive)?;
        self.optional(&format!("{table}.rate"), rule.rate, Range::Positive)?;
        let mut seen = [false; 9];
        for (kind, components) in [("gradient", &rule.gradient), ("stress", &rule.stress)] {
            for (row, column, signal) in components.given() {
                let name = COMPONENTS[3 * row + column];
                let path = format!("{table}.{kind}.{name}");
                self.signal_in_time(&path, signal)?;
                // A period along one axis must not lean out of the planes of the walls.
                for axis in [column, row] {
                    if !periodic[axis] {
                        return self.refuse(
                            &path,
                            format!(
                                "the cell cannot be driven along {name}: the domain is not periodic along {}",
                                AXES[axis]
                            ),
                        );
                    }
                }
                if std::mem::replace(&mut seen[3 * row + column], true) {
                    return self.refuse(
                        &path,
                        format!("{name} of the cell is given both as gradient and as stress"),
                    );
                }
            }
        }
        Ok(())
    }

    /// A periodic cell must be large enough for a grain to see one image of each neighbour.
    pub(super) fn roomy(&self, cell: &Cell, grains: &Grains) -> Result<(), CaseError> {
        if grains.is_empty() {
            // The first that falls is looked at by the step.
            return Ok(());
        }
        let Some(period) = Period::of(cell) else { return Ok(()) };
        let mut near = Neighbours::default();
        near.refresh(cell, &grains.position, &grains.radius, 0.0);
        let (height, room) = (period.height(), near.room());
        if height >= room {
            return Ok(());
        }
        Err(self
            .source
            .fault(
                if self.domain.periods.is_some() { "domain.periods" } else { "domain.size" },
                format!("the periodic cell is {height:.4e} m across, these grains need at least {room:.4e} m"),
            )
            .hint("a grain must see one image of each neighbour only: twice the largest diameter, and room to move"))
    }

    /// What water asks of a periodic domain in stage `k`.
    pub(super) fn water_in_periods(&self, k: usize) -> Result<(), CaseError> {
        let periodic = self.domain.periodic.0;
        let model = self.model(k, 0.0);
        let Some(fluid) = model.fluid.as_ref().filter(|_| periodic != [false; 3]) else { return Ok(()) };
        let place = |key: &str| {
            let own = format!("stage.{k}.{key}");
            if self.source.has(&own) { own } else { key.to_owned() }
        };
        if matches!(fluid.flow, Flow::Darcy(_)) {
            return Err(self
                .source
                .fault(
                    &place("fluid"),
                    "water on a grid needs walls on all sides: no axis of the domain may be periodic",
                )
                .hint("leave `flow` out: water in the pores can be periodic"));
        }
        if fluid.bulk_modulus.is_some() || model.has_pressure() {
            return Ok(());
        }
        let volume = |(row, column, _): &(usize, usize, &Signal)| row == column;
        let given: Vec<&Signal> = model.cell.gradient.given().filter(volume).map(|given| given.2).collect();
        let constant = |signal: &&Signal| match signal {
            Signal::Constant(value) => Some(*value),
            _ => None,
        };
        let rates: Option<Vec<f64>> = given.iter().map(constant).collect();
        let keeps = rates.is_some_and(|rates| {
            let size = rates.iter().map(|rate| rate.abs()).sum::<f64>();
            rates.iter().sum::<f64>().abs() <= 1e-12 * size
        });
        let held = model.cell.stress.given().any(|given| volume(&given));
        if held || !keeps {
            let name = &self.stage[k].name;
            let key = if held { "stress" } else { "gradient" };
            return Err(self
                .source
                .fault(
                    &place(&format!("cell.{key}")),
                    format!(
                        "in the stage `{name}` the cell changes its volume, but the water is incompressible and no face lets \
                         it out"
                    ),
                )
                .hint("give rates that sum to zero as numbers, hold shear stresses only, or give the stage its own cell = {}"));
        }
        Ok(())
    }
}

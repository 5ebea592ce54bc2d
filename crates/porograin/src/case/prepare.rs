//! What can be said against the rain and the growth of a stage.

use super::check::Range;
use super::{Case, CaseError};
use crate::packing::Grading;
use crate::rain::Rain;

impl Case {
    /// The grains that stage `k` lets fall.
    pub(super) fn rain(&self, k: usize) -> Result<(), CaseError> {
        let (name, stage) = (&self.stage[k].name, &self.stage[k]);
        let Some(rain) = &stage.rain else { return Ok(()) };
        let table = format!("stage.{k}.rain");
        let at = |key: &str| format!("{table}.{key}");
        let Rain { count, mass, height, rate, layer, radius, grading, within, .. } = rain;
        self.optional(&at("mass"), *mass, Range::Positive)?;
        self.optional(&at("rate"), *rate, Range::Positive)?;
        self.optional(&at("radius"), *radius, Range::Positive)?;
        self.check_within(&at("within"), *within)?;
        if let Some(grading) = grading {
            self.check_grading(&at("grading"), grading)?;
        }
        for (key, count) in [("count", count), ("layer", layer)] {
            if *count == Some(0) {
                return self.refuse(&at(key), format!("with a {key} of 0 no grain falls"));
            }
        }
        let (lower, upper) = self.corners();
        if height.is_some_and(|height| !(lower.z < height && height < upper.z)) {
            let sentence = format!(
                "the `height` of the bed must lie between {} and {} m, where the box is",
                lower.z, upper.z
            );
            return self.refuse(&at("height"), sentence);
        }
        if count.is_none() && mass.is_none() && height.is_none() {
            return self.refuse(&table, "the rain never ends: give it a `count`, a `mass` or a `height`");
        }
        if rate.is_some() == layer.is_some() {
            return self.refuse(
                &table,
                "grains fall at a `rate` or in layers of so many, `layer`: give one of the two",
            );
        }
        if layer.is_some() && !stage.until.waits() {
            return Err(self
                .source
                .fault(
                    &format!("stage.{k}.until"),
                    format!(
                        "the next layer falls when the conditions of the stage `{name}` hold, but it has none"
                    ),
                )
                .hint("until = { unbalanced = 1e-2, max-steps = 500000 }, say"));
        }
        let absolute = grading.as_ref().is_some_and(Grading::is_absolute);
        if absolute == radius.is_some() {
            return self.refuse(
                &table,
                "grains that fall have a `radius`, or the diameters of a sieve table: give one of the two",
            );
        }
        let across = (upper - lower).min_element();
        if 2.0 * rain.largest() > across {
            let sentence = format!(
                "the largest grain that falls, {:.3e} m across, does not fit into the box",
                2.0 * rain.largest()
            );
            return self.refuse(&table, sentence);
        }
        let refused = if self.domain.discs {
            "grains that fall are spheres, but `domain.discs` asks for discs"
        } else if self.domain.periodic.0[2] {
            "grains fall along z, but the domain is periodic along z"
        } else if self.model(k, 0.0).fluid.is_some() {
            "grains fall into dry stages only: say `fluid = false` in it, and let the water in afterwards"
        } else {
            return Ok(());
        };
        self.refuse(&table, format!("in the stage `{name}`, {refused}"))
    }

    /// The growth of the grains in stage `k`.
    pub(super) fn growth(&self, k: usize) -> Result<(), CaseError> {
        let stage = &self.stage[k];
        let Some(grow) = &stage.grow else { return Ok(()) };
        let table = format!("stage.{k}.grow");
        let at = |key: &str| format!("{table}.{key}");
        self.number(&at("rate"), grow.rate, Range::Positive)?;
        self.optional(&at("porosity"), grow.porosity, Range::Between)?;
        self.optional(&at("stress"), grow.stress, Range::Positive)?;
        if grow.porosity.is_some() == grow.stress.is_some() {
            return self.refuse(&table, "grains grow to a `porosity` or to a `stress`: give one of the two");
        }
        if grow.stress.is_some() && stage.until.stress_error.is_none() {
            let name = &stage.name;
            return Err(self
                .source
                .fault(
                    &format!("stage.{k}.until"),
                    format!("the grains of the stage `{name}` grow to a stress, but it does not wait for it"),
                )
                .hint("until = { unbalanced = 1e-2, stress-error = 0.02, max-steps = 500000 }, say"));
        }
        if self.model(k, 0.0).fluid.is_some() {
            return self
                .refuse(&table, format!("in the stage `{}`, grains grow in dry stages only", stage.name));
        }
        Ok(())
    }
}

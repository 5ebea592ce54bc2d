//! The regions of a case: what can be said against them, and their names.

use super::check::Range;
use super::{Case, CaseError, RegionTable};
use crate::measure::Region;
use crate::watch::{Measure, Names};
use glam::DVec3;

impl Case {
    /// The regions, in order.
    pub fn regions(&self) -> Vec<Region> {
        self.region.iter().map(|table| table.shape).collect()
    }

    /// What measures may have a column for each of.
    pub fn names(&self) -> Names {
        Names {
            walls: self.wall_names(),
            regions: self.region.iter().map(|table| table.name.clone()).collect(),
        }
    }

    pub(super) fn check_regions(&self) -> Result<(), CaseError> {
        let (lower, upper) = self.corners();
        for (k, RegionTable { name, shape }) in self.region.iter().enumerate() {
            let at = |key: &str| format!("region.{k}.{key}");
            if name.is_empty() || name.contains(|c: char| c.is_whitespace() || ",.[]".contains(c)) {
                return self
                    .refuse(&at("name"), "a region needs a name of one word, without dots and commas");
            }
            if self.region[..k].iter().any(|other| other.name == *name) {
                return self.refuse(&at("name"), format!("two regions are called `{name}`"));
            }
            match shape {
                Region::Box { lower, upper } => {
                    if let Some(axis) = (0..3).find(|&axis| lower[axis] >= upper[axis]) {
                        let sentence = format!(
                            "the region `{name}` has nothing between its corners along {}",
                            ["x", "y", "z"][axis]
                        );
                        return self.refuse(&at("shape.box"), sentence);
                    }
                }
                Region::Sphere { radius, .. } => {
                    self.number(&at("shape.sphere.radius"), *radius, Range::Positive)?
                }
                Region::Cylinder { axis, radius, length, .. } => {
                    self.number(&at("shape.cylinder.radius"), *radius, Range::Positive)?;
                    self.number(&at("shape.cylinder.length"), *length, Range::Positive)?;
                    if DVec3::from(*axis).try_normalize().is_none() {
                        return self
                            .refuse(&at("shape.cylinder.axis"), "`axis` has no direction: it is zero");
                    }
                }
            }
            let [low, high] = shape.around();
            let slack = 1e-9 * (upper - lower);
            if (low + slack).cmplt(lower).any() || (high - slack).cmpgt(upper).any() {
                return self.refuse(&at("shape"), format!("the region `{name}` reaches out of the box"));
            }
        }
        let watched = |k: usize| self.watch[k].measures.contains(&Measure::Regions);
        match (0..self.watch.len()).find(|&k| watched(k)) {
            Some(k) if self.region.is_empty() => Err(self
                .source
                .fault(&format!("watch.{k}.measures"), "`regions` are to be measured, but the case has none")
                .hint("a region is added with [[region]]")),
            _ => Ok(()),
        }
    }
}

//! What can be said against the grains of a case before they are made.

use super::check::Range;
use super::{Case, CaseError, Cloud, Lattice, Packing};
use crate::packing::Grading;

impl Case {
    pub(super) fn check_packing(&self) -> Result<(), CaseError> {
        self.number("grains.density", self.grains.density, Range::Positive)?;
        match &self.grains.packing {
            Packing::Cloud(_) if self.domain.discs => self.refuse(
                "grains.packing.cloud",
                "a cloud is made of spheres, but `domain.discs` asks for discs: use a lattice or a file",
            ),
            Packing::Cloud(cloud) => self.check_cloud(cloud),
            Packing::Lattice(lattice) => self.check_lattice(lattice),
            Packing::File(_) => Ok(()),
            Packing::Empty if self.stage.first().is_some_and(|stage| stage.rain.is_none()) => Err(self
                .source
                .fault("grains.packing", "the box is empty, and the first stage lets no grain fall")
                .hint("rain = { count = 500, rate = 1000.0, radius = 1e-3 } in the first stage, say")),
            Packing::Empty => Ok(()),
        }
    }

    fn check_cloud(&self, cloud: &Cloud) -> Result<(), CaseError> {
        let at = |key: &str| format!("grains.packing.cloud.{key}");
        if cloud.count == Some(0) {
            return self.refuse(&at("count"), "a cloud of 0 grains has nothing to simulate");
        }
        self.check_within(&at("within"), cloud.within)?;
        self.optional(&at("spread"), cloud.spread, Range::Part)?;
        self.optional(&at("radius"), cloud.radius, Range::Positive)?;
        if let Some(porosity) = cloud.porosity
            && !(0.5..1.0).contains(&porosity)
        {
            return self.refuse(
                &at("porosity"),
                format!(
                    "a cloud of grains that do not touch has a porosity from 0.5 to 1, not {porosity}: let a stage \
                     compact it"
                ),
            );
        }
        if let Some(grading) = &cloud.grading {
            if cloud.spread.is_some() {
                return self.refuse(
                    &at("spread"),
                    "the sizes are given twice: `spread` is short for `grading = { uniform = { spread } }`",
                );
            }
            if cloud.radius.is_some() && grading.is_absolute() {
                return self
                    .refuse(&at("radius"), "the sieve table gives the sizes already: leave `radius` out");
            }
            self.check_grading(&at("grading"), grading)?;
        }
        if cloud.amount().is_some() {
            return Ok(());
        }
        Err(if cloud.count.is_some() {
            let sentence = "the count and the sizes of the cloud decide its porosity, which is given too";
            self.source
                .fault(&at("porosity"), sentence)
                .hint("leave out `porosity` or `count`: no size is ever changed")
        } else {
            let sentence = "the cloud has neither a count nor sizes";
            self.source
                .fault("grains.packing.cloud", sentence)
                .hint("give `count`, or `radius`, or `grading = { sieve = [[diameter, passing], …] }`")
        })
    }

    pub(super) fn check_within(&self, path: &str, within: Option<[[f64; 3]; 2]>) -> Result<(), CaseError> {
        let Some([lower, upper]) = within else { return Ok(()) };
        let (low, high) = self.corners();
        for axis in 0..3 {
            if low[axis] <= lower[axis] && lower[axis] < upper[axis] && upper[axis] <= high[axis] {
                continue;
            }
            let sentence = format!(
                "`within` must be a part of the box: along {} it goes from {} to {} m, the box from {} to {} m",
                ["x", "y", "z"][axis],
                lower[axis],
                upper[axis],
                low[axis],
                high[axis]
            );
            return self.refuse(path, sentence);
        }
        Ok(())
    }

    pub(super) fn check_grading(&self, path: &str, grading: &Grading) -> Result<(), CaseError> {
        match grading {
            Grading::Uniform { spread } => {
                self.number(&format!("{path}.uniform.spread"), *spread, Range::Part)
            }
            Grading::Normal { deviation } => {
                let path = format!("{path}.normal.deviation");
                if !(0.0..1.0 / 3.0).contains(deviation) {
                    return self.refuse(
                        &path,
                        format!("`deviation` must be at least 0 and less than a third of the mean, not {deviation}"),
                    );
                }
                Ok(())
            }
            Grading::LogNormal { deviation } => {
                self.number(&format!("{path}.log-normal.deviation"), *deviation, Range::NotNegative)
            }
            Grading::Sieve(table) => {
                let path = format!("{path}.sieve");
                let [Some(first), Some(last)] = [table.first(), table.last()] else {
                    return self.refuse(&path, "the sieve table has no sieve");
                };
                self.number(&format!("{path}.0.0"), first[0], Range::Positive)?;
                if first[1] != 0.0 || last[1] != 1.0 {
                    return self.refuse(
                        &path,
                        format!(
                            "the passing part of the mass must go from 0 at the smallest sieve to 1 at the largest, not from \
                             {} to {}",
                            first[1], last[1]
                        ),
                    );
                }
                match table.windows(2).position(|w| w[1][0] <= w[0][0] || w[1][1] < w[0][1]) {
                    Some(k) => self.refuse(
                        &format!("{path}.{}", k + 1),
                        "a sieve table goes from small to large: diameters rise, and no sieve lets less pass than a finer one",
                    ),
                    None => Ok(()),
                }
            }
        }
    }

    fn check_lattice(&self, lattice: &Lattice) -> Result<(), CaseError> {
        let at = |key: &str| format!("grains.packing.lattice.{key}");
        self.number(&at("radius"), lattice.radius, Range::Positive)?;
        let count = match (lattice.count, lattice.arrangement) {
            (Some(count), None) => count,
            (None, Some(_)) if !self.domain.discs => return Ok(()),
            (None, Some(_)) => {
                return self
                    .refuse(&at("arrangement"), "an arrangement is made of spheres: give discs a `count`");
            }
            (None, None) => {
                return Err(self
                    .source
                    .fault("grains.packing.lattice", "the lattice has no count and no arrangement")
                    .hint("give count = [nx, ny, nz], or arrangement = \"face-centred\""));
            }
            (Some(_), Some(_)) => {
                return self.refuse(
                    &at("count"),
                    "an arrangement has as many touching spheres as fit into the box: leave `count` out",
                );
            }
        };
        for (k, &count) in count.iter().enumerate() {
            let path = at(&format!("count.{k}"));
            if count == 0 {
                return self.refuse(&path, "a lattice of 0 grains has nothing to simulate");
            }
            if self.domain.discs && k == 1 {
                if count != 1 {
                    return self.refuse(
                        &path,
                        format!("discs are as thick as the box along y: there is room for 1, not {count}"),
                    );
                }
                continue;
            }
            let needed = 2.0 * lattice.radius * count as f64;
            if needed > self.domain.size[k] * (1.0 + 1e-12) {
                return self.refuse(
                    &path,
                    format!(
                        "{count} grains of radius {} m need {needed} m along {}, the box has {} m",
                        lattice.radius,
                        ["x", "y", "z"][k],
                        self.domain.size[k]
                    ),
                );
            }
        }
        Ok(())
    }
}

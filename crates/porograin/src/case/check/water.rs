//! What a case says of its water, checked.

use super::Range;
use crate::boundary::Signal;
use crate::case::{Case, CaseError};
use crate::darcy::{Cells, Darcy, Permeability, Transfer};
use crate::model::Flow;
use crate::pores::{Conductance, Coupling, PointWater, Pores, Stepping};
use glam::DVec3;

/// A grid of more cells than this is a mistake: each takes some kilobyte.
const MOST_CELLS: f64 = 1e7;

impl Case {
    /// The settings of a flow.
    pub(super) fn flow(&self, path: &str, flow: &Flow) -> Result<(), CaseError> {
        match flow {
            Flow::Pores(pores) => {
                self.number(&format!("{path}.pores.residual"), pores.residual, Range::Positive)?;
                if let Conductance::HydraulicRadius { alpha } = pores.conductance {
                    let path = format!("{path}.pores.conductance.hydraulic-radius.alpha");
                    self.number(&path, alpha, Range::Positive)?;
                }
                let path_implicit = format!("{path}.pores.implicit-residual");
                self.number(&path_implicit, pores.implicit_residual, Range::Positive)?;
                self.places(&format!("{path}.pores"), pores)?;
                self.gradient(&format!("{path}.pores.gradient"), &pores.gradient)?;
                if pores.coupling == Coupling::Geometric && pores.step == Stepping::Implicit {
                    return self.refuse(
                        &format!("{path}.pores.step"),
                        "implicit steps need the coupling `reciprocal`: with `geometric` the water can give the grains \
                         energy, and implicit steps blow up",
                    );
                }
                self.number(&format!("{path}.pores.remesh.strain"), pores.remesh.strain, Range::Positive)
            }
            Flow::Darcy(darcy) => self.darcy(&format!("{path}.darcy"), darcy),
        }
    }

    /// A macroscopic gradient needs an axis that repeats.
    fn gradient(&self, path: &str, gradient: &[Signal; 3]) -> Result<(), CaseError> {
        for (axis, signal) in gradient.iter().enumerate() {
            let path = format!("{path}.{axis}");
            if signal.varies_in_space() {
                let sentence = "a macroscopic gradient is the same everywhere: only t may stand in this formula, not x, y or z";
                return self.refuse(&path, sentence);
            }
            self.signal(&path, signal)?;
            if !self.domain.periodic.0[axis] && *signal != Signal::Constant(0.0) {
                let along = ["x", "y", "z"][axis];
                return Err(self
                    .source
                    .fault(
                        &path,
                        format!("a macroscopic gradient along {along} needs a domain that is periodic along {along}"),
                    )
                    .hint("between walls, give two faces water = { pressure = … }"));
            }
        }
        Ok(())
    }

    /// Points lie in the box and outside blocked regions, which have an inside.
    fn places(&self, path: &str, pores: &Pores) -> Result<(), CaseError> {
        for (k, block) in pores.blocked.iter().enumerate() {
            if let Some(axis) = (0..3).find(|&a| block.from[a] >= block.to[a]) {
                return self.refuse(
                    &format!("{path}.blocked.{k}"),
                    format!("the blocked region ends along {} before it begins", ["x", "y", "z"][axis]),
                );
            }
        }
        let (lower, upper) = self.corners();
        for (k, point) in pores.point.iter().enumerate() {
            let (place, at) = (format!("{path}.point.{k}.at"), DVec3::from_array(point.at));
            if !(lower.cmple(at).all() && at.cmple(upper).all()) {
                return self
                    .refuse(&place, format!("the point ({}, {}, {}) is outside the box", at.x, at.y, at.z));
            }
            if pores.blocked.iter().any(|block| block.contains(at)) {
                return self.refuse(
                    &place,
                    format!("the point ({}, {}, {}) is in a blocked region", at.x, at.y, at.z),
                );
            }
            let kind = match &point.water {
                PointWater::Pressure(_) => "pressure",
                PointWater::Source(_) => "source",
            };
            self.signal(&format!("{path}.point.{k}.water.{kind}"), point.water.signal())?;
        }
        Ok(())
    }

    fn darcy(&self, path: &str, darcy: &Darcy) -> Result<(), CaseError> {
        let at = |key: &str| format!("{path}.{key}");
        self.number(&at("residual"), darcy.residual, Range::Between)?;
        self.number(&at("renew"), darcy.renew, Range::Positive)?;
        match darcy.cells {
            Cells::Count(count) => {
                if self.domain.discs && count[1] != 1 {
                    return self.refuse(
                        &at("cells.count.1"),
                        format!(
                            "discs are as thick as the box along y: the grid has 1 cell there, not {}",
                            count[1]
                        ),
                    );
                }
                if let Some(axis) = count.iter().position(|&n| n == 0) {
                    return self.refuse(
                        &at(&format!("cells.count.{axis}")),
                        "a grid of 0 cells has nowhere to put water",
                    );
                }
            }
            Cells::Grains(each) => self.number(&at("cells.grains"), each, Range::Positive)?,
            Cells::Size(edge) => self.number(&at("cells.size"), edge, Range::Positive)?,
        }
        let cells: f64 = match darcy.cells {
            Cells::Count(count) => count.iter().map(|&n| n as f64).product(),
            Cells::Size(edge) => self.domain.size.iter().map(|size| (size / edge).max(1.0)).product(),
            Cells::Grains(_) => 1.0,
        };
        if cells > MOST_CELLS {
            return self.refuse(
                &at("cells"),
                format!(
                    "a grid of {cells:.1e} cells does not fit into memory: make them larger, a cell should hold a \
                     few grains"
                ),
            );
        }
        if let Transfer::Kernel { width } = darcy.transfer {
            self.number(&at("transfer.kernel.width"), width, Range::Positive)?;
        }
        match darcy.permeability {
            Permeability::KozenyCarman(constant) => {
                self.number(&at("permeability.kozeny-carman"), constant, Range::Positive)
            }
            Permeability::Given(along) => along.iter().enumerate().try_for_each(|(axis, &k)| {
                self.number(&at(&format!("permeability.given.{axis}")), k, Range::Positive)
            }),
        }
    }
}

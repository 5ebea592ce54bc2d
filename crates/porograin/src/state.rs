//! Everything a restart needs.

use crate::boundary::Domain;
use crate::contact::Contacts;
use crate::darcy::GridState;
use crate::fluid::Fluid;
use crate::grains::Grains;
use crate::pores::PoreState;
use serde::{Deserialize, Serialize};

/// The state of a simulation between two steps. Writing and reading it back changes no bit of what follows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// [s]
    pub time: f64,
    /// Steps done since the case began.
    pub step: u64,
    /// Length of the current step [s]; kept here because it is renewed only now and then.
    pub dt: f64,
    /// Where the faces are.
    pub domain: Domain,
    /// The grains.
    pub grains: Grains,
    /// The touching pairs.
    pub contacts: Contacts,
    /// The water, while a stage has any.
    pub fluid: Option<Fluid>,
}

impl State {
    /// The water, where it is computed pore by pore.
    pub fn pores(&self) -> Option<&PoreState> {
        match self.fluid.as_ref()? {
            Fluid::Pores(pores) => Some(pores),
            Fluid::Darcy(_) => None,
        }
    }

    /// The water, where it is computed on a grid.
    pub fn grid(&self) -> Option<&GridState> {
        match self.fluid.as_ref()? {
            Fluid::Pores(_) => None,
            Fluid::Darcy(grid) => Some(grid),
        }
    }
}

//! Fluid-saturated granular media, grain by grain and pore by pore.

pub mod boundary;
pub mod case;
pub mod contact;
pub mod grains;
pub mod import;
pub mod model;
pub mod output;
pub mod permeability;
pub mod pores;
pub mod state;
pub mod watch;

pub use boundary::{Domain, Face, Signal, Slip, Solid, Water};
pub use grains::{Grains, Loads};
pub use model::{Flow, FluidModel, Model, TimeStep};
pub use state::State;

//! Fluid-saturated granular media, grain by grain and pore by pore.

pub mod bench;
pub mod boundary;
pub mod budget;
pub mod case;
pub mod cell;
pub mod compaction;
pub mod consolidation;
pub mod contact;
pub mod darcy;
pub mod expression;
pub mod fluid;
pub mod grains;
pub mod gravity;
pub mod import;
pub mod measure;
pub mod model;
pub mod motion;
pub mod output;
pub mod packing;
pub mod permeability;
pub mod pores;
pub mod progress;
pub mod run;
pub mod stability;
pub mod state;
pub mod step;
pub mod timers;
pub mod trouble;
pub mod walls;
pub mod watch;

pub use boundary::{Domain, Face, Signal, Slip, Solid, Water};
pub use cell::CellRule;
pub use grains::{Grains, Loads};
pub use model::{Flow, FluidModel, Model, TimeStep};
pub use state::State;
pub use step::{Report, StepError, Work, step};

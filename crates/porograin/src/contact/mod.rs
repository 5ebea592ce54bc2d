//! Contacts: who touches whom, the memory of each contact, and the laws.

mod damping;
mod follow;
mod friction;
mod hertz_mindlin;
mod law;
mod linear;
mod memory;
mod pass;
#[cfg(test)]
mod tests;
mod touch;
pub use damping::Restitution;
pub use follow::follow;
pub use friction::{Extras, Plain, Spring};
pub use hertz_mindlin::HertzMindlin;
pub use law::{ContactLaw, Law, Laws, PairLaw, PairLoad, WALL};
pub use linear::Linear;
pub use memory::{Contacts, Memory, More};
pub use pass::{Scratch, add};
pub use touch::{Near, Stiffness, Surroundings, Touch, turn};

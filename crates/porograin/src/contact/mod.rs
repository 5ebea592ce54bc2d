//! Contacts: who touches whom, the memory of each contact, and the laws.

mod account;
mod adhesion;
mod capillary;
mod damping;
mod follow;
mod friction;
mod hertz_mindlin;
mod lanes;
mod law;
mod linear;
mod memory;
mod parts;
mod pass;
mod rolling;
#[cfg(test)]
mod tests;
mod touch;
pub use account::Account;
pub use adhesion::{Adhesion, Bond};
pub use capillary::Capillary;
pub use damping::Restitution;
pub use follow::follow;
pub use friction::{Extras, Plain, Spring};
pub use hertz_mindlin::HertzMindlin;
pub use law::{ContactLaw, Law, Laws, PairLaw, PairLoad, WALL};
pub use linear::Linear;
pub use memory::{Contacts, Memory, More};
pub use pass::{Scratch, add};
pub use rolling::Rolling;
pub use touch::{Near, Stiffness, Surroundings, Touch, turn};

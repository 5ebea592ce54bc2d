//! Shape and neighbourhood of a packing of spheres: no mass, no time, no fluid.
//!
//! - [`cell`]: the region the grains live in, a box whose axes are walled or periodic;
//! - [`neighbours`]: the pairs of grains, and of grains and walls, closer than a skin;
//! - [`order`]: numbering along a space-filling curve;
//! - [`triangulation`]: the regular (weighted Delaunay) triangulation of the grains, exact, walls as vertices;
//! - [`throat`]: areas, signed solid angles and void volumes of its throats;
//! - [`gradient`]: how the volumes of pores change with their vertices;
//! - [`voronoi`]: power cells of the grains, their facets and neighbours;
//! - [`locate`]: which pore contains a point.

mod angle;
pub mod cell;
pub mod gradient;
pub mod locate;
pub mod neighbours;
pub mod order;
mod predicates;
pub mod throat;
pub mod triangulation;
pub mod voronoi;
pub use cell::Cell;
pub use neighbours::Neighbours;
pub use triangulation::{Repair, Triangulation, TriangulationError};

/// The example of the README, run as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

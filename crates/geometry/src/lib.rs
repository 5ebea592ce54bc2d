//! Shape and neighbourhood of a packing of spheres: no mass, no time, no fluid.
//!
//! - [`cell`]: the region the grains live in, a box whose axes are walled or periodic;
//! - [`neighbours`]: the pairs of grains, and of grains and walls, closer than a skin;
//! - [`period`]: the periods of a cell, nearest images;
//! - [`order`]: numbering along a space-filling curve, or in columns;
//! - [`triangulation`]: the regular (weighted Delaunay) triangulation of the grains, exact, walls as vertices;
//! - [`throat`]: areas, signed solid angles and void volumes of its throats;
//! - [`gradient`]: how the volumes of pores change with their vertices;
//! - [`voronoi`]: power cells of the grains, their facets and neighbours;
//! - [`locate`]: which pore contains a point.
//!
//! Everything derived from a triangulation takes the [`Packing`](throat::Packing) it belongs to: the triangulation names
//! grains and period shifts only, positions stay with their owner. Lengths may have any unit; results scale with it.
//!
//! A periodic cell of two grains, and the porosity around each:
//!
//! ```
//! use glam::{DMat3, DVec3};
//! use porograin_geometry::throat::{Packing, radical_centres};
//! use porograin_geometry::voronoi::voronoi;
//! use porograin_geometry::{Cell, Triangulation};
//!
//! let cell = Cell::periodic(DVec3::ZERO, DMat3::from_diagonal(DVec3::new(2.0, 1.0, 1.0)));
//! let position = [DVec3::new(0.5, 0.5, 0.5), DVec3::new(1.5, 0.5, 0.5)];
//! let radius = [0.5, 0.25];
//! let mesh = Triangulation::new(&cell, &position, &radius)?;
//! let packing = Packing { cell: &cell, position: &position, radius: &radius };
//! let cells = voronoi(packing, &mesh, &radical_centres(packing, &mesh));
//! // The plane between the two is nearer to the smaller.
//! assert!((cells.volume[0] - 1.1875).abs() < 1e-12 && (cells.volume[1] - 0.8125).abs() < 1e-12);
//! # Ok::<(), porograin_geometry::TriangulationError>(())
//! ```

mod angle;
pub mod cell;
pub mod gradient;
pub mod locate;
pub mod neighbours;
pub mod order;
pub mod period;
mod predicates;
pub mod throat;
pub mod triangulation;
pub mod voronoi;
pub use cell::Cell;
pub use neighbours::Neighbours;
pub use period::Period;
pub use triangulation::{Repair, Triangulation, TriangulationError};

/// The example of the README, run as a test.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

//! The periods of a cell as the neighbour search and the contacts need them: nearest image, wrapping.

use crate::cell::Cell;
use glam::{DMat3, DVec3};

/// The periods of a cell, with their inverse. Walled axes have no period and are never shifted.
///
/// Nearest images are found by rounding, which is right for every difference shorter than half the
/// [height](Self::height): its coordinates are then less than half a period each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Period {
    origin: DVec3,
    /// The period vectors as columns [m]; zero along walled axes.
    edges: DMat3,
    /// Takes a vector to its coordinates in periods [1/m]; those along walled axes are zero.
    dual: DMat3,
}

impl Period {
    /// The periods of a cell; `None` when all its axes are walled.
    pub fn of(cell: &Cell) -> Option<Self> {
        if cell.periodic == [false; 3] {
            return None;
        }
        let (mut edges, mut basis) = (cell.edges, cell.edges);
        for axis in (0..3).filter(|&axis| !cell.periodic[axis]) {
            *edges.col_mut(axis) = DVec3::ZERO;
            *basis.col_mut(axis) = DVec3::AXES[axis];
        }
        // Zero rows for walled axes.
        let mut rows = basis.inverse().transpose();
        for axis in (0..3).filter(|&axis| !cell.periodic[axis]) {
            *rows.col_mut(axis) = DVec3::ZERO;
        }
        Some(Period { origin: cell.origin, edges, dual: rows.transpose() })
    }

    /// The vector to add to a difference of two points to get the shortest of its images [m]. Right whenever that image is shorter than half the [height](Self::height).
    #[inline]
    pub fn nearest(&self, difference: DVec3) -> DVec3 {
        let periods = self.dual * difference;
        self.edges * -periods.map(f64::round_ties_even)
    }

    /// How many periods a point lies beyond the cell along each axis; zero inside and along walled axes.
    #[inline]
    pub fn beyond(&self, point: DVec3) -> DVec3 {
        (self.dual * (point - self.origin)).floor()
    }

    /// The displacement of so many periods [m].
    #[inline]
    pub fn shift(&self, periods: DVec3) -> DVec3 {
        self.edges * periods
    }

    /// Coordinates of a point in periods, from the low corner; zero along walled axes.
    #[inline]
    pub fn coordinates(&self, point: DVec3) -> DVec3 {
        self.dual * (point - self.origin)
    }

    /// The distance of the lattice planes across an axis [m]; infinite for a walled one.
    pub fn across(&self, axis: usize) -> f64 {
        self.dual.row(axis).length().recip()
    }

    /// The smallest distance of lattice planes [m].
    pub fn height(&self) -> f64 {
        (0..3).map(|axis| self.across(axis)).fold(f64::INFINITY, f64::min)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_the_nearest_and_walls_are_not_crossed() {
        let edges =
            DMat3::from_cols(DVec3::new(1.0, 0.1, 0.0), DVec3::new(0.4, 1.2, 0.0), DVec3::new(0.0, 0.0, 0.7));
        let cell = Cell { origin: DVec3::new(3.0, -2.0, 1.0), edges, periodic: [true, true, false] };
        let period = Period::of(&cell).unwrap();
        assert!((period.across(1) - edges.determinant() / (0.7 * edges.x_axis.length())).abs() < 1e-12);
        assert_eq!(period.across(2), f64::INFINITY);
        let short = DVec3::new(0.2, -0.35, 5.0);
        assert!(short.truncate().length() < 0.5 * period.height());
        for (a, b) in [(0.0, 0.0), (1.0, -1.0), (-3.0, 2.0)] {
            let far = short + period.shift(DVec3::new(a, b, 7.0));
            assert!((far + period.nearest(far) - short).length() < 1e-12);
            let point = cell.origin + edges * DVec3::new(0.3, 0.9, 0.5) + period.shift(DVec3::new(a, b, 0.0));
            assert_eq!(period.beyond(point), DVec3::new(a, b, 0.0));
        }
        assert!(Period::of(&Cell::walled(DVec3::ZERO, DVec3::ONE)).is_none());
    }
}

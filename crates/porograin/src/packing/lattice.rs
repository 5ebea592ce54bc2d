//! Regular arrangements of equal spheres that touch.

use glam::DVec3;
use porograin_geometry::Cell;
use serde::{Deserialize, Serialize};

/// A regular arrangement of equal touching spheres.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Lattice {
    /// Simple cubic, 6 contacts, porosity 0.476.
    SimpleCubic,
    /// Body-centred cubic, 8 contacts, porosity 0.320.
    BodyCentred,
    /// Face-centred cubic, 12 contacts, porosity 0.260.
    FaceCentred,
    /// Hexagonal close packed, 12 contacts, porosity 0.260.
    HexagonalClose,
}

impl Lattice {
    /// The brick that repeats, and the centres in it, both in radii.
    fn brick(self) -> (DVec3, Vec<DVec3>) {
        let (root2, root3, root6) = (2f64.sqrt(), 3f64.sqrt(), 6f64.sqrt());
        match self {
            Lattice::SimpleCubic => (DVec3::splat(2.0), vec![DVec3::ZERO]),
            Lattice::BodyCentred => {
                let a = 4.0 / root3;
                (DVec3::splat(a), vec![DVec3::ZERO, DVec3::splat(0.5 * a)])
            }
            Lattice::FaceCentred => {
                let corner = |x, y, z| DVec3::new(x, y, z) * root2;
                let motif =
                    vec![DVec3::ZERO, corner(0.0, 1.0, 1.0), corner(1.0, 0.0, 1.0), corner(1.0, 1.0, 0.0)];
                (DVec3::splat(2.0 * root2), motif)
            }
            Lattice::HexagonalClose => {
                let layer = DVec3::new(1.0, 1.0 / root3, 2.0 * root6 / 3.0);
                let second = DVec3::new(1.0, root3, 0.0);
                let brick = DVec3::new(2.0, 2.0 * root3, 4.0 * root6 / 3.0);
                // The last one taken back into the brick.
                let last = layer + second - DVec3::new(2.0, 0.0, 0.0);
                (brick, vec![DVec3::ZERO, second, layer, last])
            }
        }
    }
}

/// A period that is no whole number of the lattice's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// Along x, y or z: 0, 1, 2.
    pub axis: usize,
    /// The period of the lattice [m].
    pub period: f64,
    /// How many of them are nearest to the period of the cell, at least 1.
    pub nearest: f64,
}

/// Centres [m] of as many touching spheres of one radius as fit into a box, starting at its low corner. Along a
/// periodic axis the lattice goes on through the sides.
///
/// # Errors
/// A period of the cell that is no whole number of periods of the lattice, to one part in 10⁶.
pub fn lattice(kind: Lattice, cell: &Cell, radius: f64) -> Result<Vec<DVec3>, Misfit> {
    let (brick, motif) = kind.brick();
    let (brick, extent) = (radius * brick, cell.upper() - cell.origin);
    // A box made for a whole number of spheres must not lose a layer to rounding.
    let small = 1e-9 * radius;
    let (mut first, mut last) = (DVec3::splat(radius), extent - radius + small);
    for axis in (0..3).filter(|&axis| cell.periodic[axis]) {
        let times = extent[axis] / brick[axis];
        let nearest = times.round().max(1.0);
        if (times - nearest).abs() > 1e-6 * nearest {
            return Err(Misfit { axis, period: brick[axis], nearest });
        }
        (first[axis], last[axis]) = (0.0, extent[axis] - 0.1 * radius);
    }
    let bricks = (extent / brick).ceil();
    let mut centres = Vec::new();
    for z in 0..bricks.z as usize + 1 {
        for y in 0..bricks.y as usize + 1 {
            for x in 0..bricks.x as usize + 1 {
                let corner = first + brick * DVec3::new(x as f64, y as f64, z as f64);
                let places = motif.iter().map(|part| corner + radius * *part);
                centres.extend(places.filter(|x| x.cmple(last).all()).map(|x| cell.origin + x));
            }
        }
    }
    Ok(centres)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grains::sphere_volume;

    #[test]
    fn lattices_touch_as_often_as_they_should() {
        let cases = [
            (Lattice::SimpleCubic, 6, 0.4764),
            (Lattice::BodyCentred, 8, 0.3198),
            (Lattice::FaceCentred, 12, 0.2595),
            (Lattice::HexagonalClose, 12, 0.2595),
        ];
        for (kind, coordination, porosity) in cases {
            let cell = Cell::walled(DVec3::ZERO, DVec3::splat(20.0));
            let centres = lattice(kind, &cell, 0.5).unwrap();
            let middle = centres
                .iter()
                .min_by(|a, b| a.distance(DVec3::splat(10.0)).total_cmp(&b.distance(DVec3::splat(10.0))))
                .unwrap();
            let touching = centres.iter().filter(|x| (x.distance(*middle) - 1.0).abs() < 1e-9).count();
            let overlapping = centres.iter().filter(|x| x.distance(*middle) < 1.0 - 1e-9).count();
            assert_eq!((touching, overlapping), (coordination, 1), "{kind:?}");
            // Away from walls: count the centres within an inner box.
            let n = centres.iter().filter(|x| (**x - 10.0).abs().max_element() < 7.0).count();
            let inner = 1.0 - n as f64 * sphere_volume(0.5) / 14f64.powi(3);
            assert!((inner - porosity).abs() < 0.04, "{kind:?} {inner}");
        }
        let tight = Cell::walled(DVec3::ZERO, DVec3::splat(0.6));
        assert_eq!(lattice(Lattice::SimpleCubic, &tight, 0.1).unwrap().len(), 27);
    }

    #[test]
    fn a_periodic_lattice_touches_through_the_sides() {
        for (kind, coordination, porosity) in [
            (Lattice::SimpleCubic, 6, 0.4764),
            (Lattice::BodyCentred, 8, 0.3198),
            (Lattice::FaceCentred, 12, 0.2595),
            (Lattice::HexagonalClose, 12, 0.2595),
        ] {
            let size = 0.5 * DVec3::splat(3.0) * kind.brick().0;
            let cell =
                Cell { periodic: [true; 3], ..Cell::walled(DVec3::splat(-1.0), size - DVec3::splat(1.0)) };
            let centres = lattice(kind, &cell, 0.5).unwrap();
            let solid = centres.len() as f64 * sphere_volume(0.5) / size.element_product();
            assert!((1.0 - solid - porosity).abs() < 1e-4, "{kind:?} {solid}");
            for a in &centres {
                let near = |b: &&DVec3| {
                    let d = (**b - *a) / size;
                    (((d - d.round()) * size).length() - 1.0).abs() < 1e-9
                };
                assert_eq!(centres.iter().filter(near).count(), coordination, "{kind:?}");
            }
            let off = Cell { periodic: [true; 3], ..Cell::walled(DVec3::ZERO, 1.01 * size) };
            let misfit = lattice(kind, &off, 0.5).unwrap_err();
            assert_eq!((misfit.axis, misfit.nearest), (0, 3.0));
        }
    }
}

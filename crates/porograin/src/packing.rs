//! Initial states: random clouds, regular lattices, growth. All of them report what they made; sizes never change
//! silently.

use crate::grains::{Grains, sphere_volume};
use crate::state::State;
use glam::DVec3;
use porograin_geometry::{Cell, order};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::RngCore;
use std::fmt;

/// Places tried for one grain before a cloud is given up.
const TRIES: usize = 20_000;

/// A cloud that could not be made.
#[derive(Clone, Debug, PartialEq)]
pub enum CloudError {
    /// Some number is out of its range.
    Input(&'static str),
    /// The largest grain does not fit between the walls.
    Size {
        /// Largest diameter [m].
        diameter: f64,
    },
    /// No room is left for random insertion.
    Room {
        /// Grains placed.
        placed: usize,
        /// Grains asked for.
        count: usize,
    },
}

impl fmt::Display for CloudError {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            CloudError::Input(why) => f.write_str(why),
            CloudError::Size { diameter } => {
                write!(f, "the box is smaller than the largest grain of the cloud, {diameter:.3e} m across")
            }
            CloudError::Room { placed, count } => write!(
                f,
                "only {placed} of {count} grains found room: random insertion stops near porosity 0.65, start looser and \
                 compact"
            ),
        }
    }
}

impl std::error::Error for CloudError {}

/// `count` grains at rest, thrown at random into a box, walled or periodic, without touching each other or a wall.
///
/// Radii are uniform within `mean (1 ± spread)`, the mean such that the void part of the box is `porosity`;
/// `density` in kg/m³. The same numbers give the same cloud on every machine (generator PCG64 XSL-RR, its 53 high
/// bits). Grains come in space-filling order; [`Grains::id`] is the order of creation, largest first.
///
/// # Errors
/// Numbers out of range, a box too small for the largest grain, or no room.
pub fn cloud(
    cell: &Cell,
    count: usize,
    spread: f64,
    seed: u64,
    porosity: f64,
    density: f64,
) -> Result<Grains, CloudError> {
    if count == 0 || count > 100_000_000 {
        return Err(CloudError::Input("the count of a cloud must lie between 1 and 1e8"));
    }
    if !(0.0..1.0).contains(&spread) {
        return Err(CloudError::Input("the spread of a cloud must be at least 0 and less than 1"));
    }
    if !(porosity > 0.0 && porosity < 1.0) {
        return Err(CloudError::Input("the porosity of a cloud must lie between 0 and 1"));
    }
    let mut random = Pcg64::new(u128::from(seed), 0x0a02_bdbf_7bb3_c0a7_ac28_fa16_a64a_bf96);
    let mut uniform = move || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    let mut radius: Vec<f64> = (0..count).map(|_| 1.0 + spread * (2.0 * uniform() - 1.0)).collect();
    radius.sort_by(|a, b| b.total_cmp(a)); // large grains find room first
    let solid: f64 = radius.iter().map(|&r| sphere_volume(r)).sum();
    let scale = ((1.0 - porosity) * cell.volume() / solid).cbrt();
    radius.iter_mut().for_each(|r| *r *= scale);

    let (lower, extent) = (cell.origin, cell.upper() - cell.origin);
    if extent.min_element() < 2.0 * radius[0] {
        return Err(CloudError::Size { diameter: 2.0 * radius[0] });
    }
    let mut room = Room::new(lower, extent, cell.periodic, 2.0 * radius[0], count);
    let mut position: Vec<DVec3> = Vec::with_capacity(count);
    for (k, &r) in radius.iter().enumerate() {
        // Walls keep a radius away.
        let edge = DVec3::from_array(cell.periodic.map(|p| if p { 0.0 } else { r }));
        let free = extent - 2.0 * edge;
        let place = (0..TRIES).find_map(|_| {
            let x = lower + edge + free * DVec3::new(uniform(), uniform(), uniform());
            room.is_free(x, r, &position, &radius).then_some(x)
        });
        let Some(x) = place else { return Err(CloudError::Room { placed: k, count }) };
        room.put(k, x);
        position.push(x);
    }
    Ok(ordered(cell, Grains::at_rest(position, radius, density)))
}

/// The grains in space-filling order, each keeping its [id](Grains::id).
pub fn ordered(cell: &Cell, grains: Grains) -> Grains {
    let order = order::hilbert(cell, &grains.position);
    fn pick<T: Copy>(values: &[T], order: &[u32]) -> Vec<T> {
        order.iter().map(|&k| values[k as usize]).collect()
    }
    Grains {
        shape: grains.shape,
        position: pick(&grains.position, &order),
        velocity: pick(&grains.velocity, &order),
        spin: pick(&grains.spin, &order),
        radius: pick(&grains.radius, &order),
        mass: pick(&grains.mass, &order),
        material: pick(&grains.material, &order),
        id: pick(&grains.id, &order),
    }
}

/// Multiplies every radius by `factor`, masses by its cube; returns the mean radius [m] that results.
pub fn grow(state: &mut State, factor: f64) -> f64 {
    let grains = &mut state.grains;
    grains.radius.iter_mut().for_each(|r| *r *= factor);
    grains.mass.iter_mut().for_each(|m| *m *= factor * factor * factor);
    grains.radius.iter().sum::<f64>() / grains.len().max(1) as f64
}

/// A regular arrangement of equal touching spheres.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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

/// Centres [m] of as many touching spheres of one radius as fit into a walled box, starting at its low corner.
pub fn lattice(kind: Lattice, cell: &Cell, radius: f64) -> Vec<DVec3> {
    let (root2, root3, root6) = (2f64.sqrt(), 3f64.sqrt(), 6f64.sqrt());
    // The repeating brick, in radii, and the centres in it.
    let (brick, motif): (DVec3, Vec<DVec3>) = match kind {
        Lattice::SimpleCubic => (DVec3::splat(2.0), vec![DVec3::ZERO]),
        Lattice::BodyCentred => {
            let a = 4.0 / root3;
            (DVec3::splat(a), vec![DVec3::ZERO, DVec3::splat(0.5 * a)])
        }
        Lattice::FaceCentred => {
            let (a, h) = (2.0 * root2, root2);
            let corner = |x, y, z| DVec3::new(x, y, z) * h;
            let motif =
                vec![DVec3::ZERO, corner(0.0, 1.0, 1.0), corner(1.0, 0.0, 1.0), corner(1.0, 1.0, 0.0)];
            (DVec3::splat(a), motif)
        }
        Lattice::HexagonalClose => {
            let layer = DVec3::new(1.0, 1.0 / root3, 2.0 * root6 / 3.0);
            let second = DVec3::new(1.0, root3, 0.0);
            let brick = DVec3::new(2.0, 2.0 * root3, 4.0 * root6 / 3.0);
            (brick, vec![DVec3::ZERO, second, layer, layer + second])
        }
    };
    let extent = cell.upper() - cell.origin;
    // A box made for a whole number of spheres must not lose a layer to rounding.
    let last = (extent - radius) + 1e-9 * radius;
    let bricks = (extent / (radius * brick)).ceil();
    let mut centres = Vec::new();
    for z in 0..bricks.z as usize + 1 {
        for y in 0..bricks.y as usize + 1 {
            for x in 0..bricks.x as usize + 1 {
                for part in &motif {
                    let place =
                        radius * (DVec3::ONE + brick * DVec3::new(x as f64, y as f64, z as f64) + *part);
                    // Rows of a hexagonal layer start a radius further on, or wrap back by one brick.
                    if place.cmple(last).all() {
                        centres.push(cell.origin + place);
                    }
                }
            }
        }
    }
    centres
}

/// Grains placed so far, by cubes as large as the largest grain: chains through `next`, one per cube.
struct Room {
    lower: DVec3,
    extent: DVec3,
    periodic: [bool; 3],
    per_length: DVec3,
    count: [usize; 3],
    head: Vec<u32>,
    next: Vec<u32>,
}

const END: u32 = u32::MAX;

impl Room {
    fn new(lower: DVec3, extent: DVec3, periodic: [bool; 3], diameter: f64, grains: usize) -> Self {
        let mut size = diameter;
        let count = loop {
            let count = (extent / size).floor().max(DVec3::ONE);
            if count.element_product() <= 8.0 * grains as f64 + 64.0 {
                break count;
            }
            size *= 1.25;
        };
        let count_ = [count.x as usize, count.y as usize, count.z as usize];
        let head = vec![END; count_[0] * count_[1] * count_[2]];
        let (per_length, next) = (count / extent, Vec::with_capacity(grains));
        Room { lower, extent, periodic, per_length, count: count_, head, next }
    }

    fn place(&self, x: DVec3) -> [usize; 3] {
        let p = (x - self.lower) * self.per_length;
        std::array::from_fn(|k| (p[k] as usize).min(self.count[k] - 1))
    }

    fn cube(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.count[1] + y) * self.count[0] + x
    }

    fn put(&mut self, grain: usize, x: DVec3) {
        let cube = self.cube(self.place(x));
        self.next.push(self.head[cube]);
        self.head[cube] = grain as u32;
    }

    /// The cubes next to one along an axis, itself included, none twice.
    fn beside(&self, at: [usize; 3], axis: usize) -> impl Iterator<Item = usize> + use<> {
        let (k, n, periodic) = (at[axis], self.count[axis], self.periodic[axis]);
        let (from, count) = match periodic {
            true if n < 3 => (0, n),
            true => (k + n - 1, 3),
            false => (k.saturating_sub(1), (k + 2).min(n) - k.saturating_sub(1)),
        };
        (from..from + count).map(move |k| k % n)
    }

    /// The shortest image of a difference.
    fn nearest(&self, mut difference: DVec3) -> DVec3 {
        for axis in (0..3).filter(|&axis| self.periodic[axis]) {
            difference[axis] -= self.extent[axis] * (difference[axis] / self.extent[axis]).round();
        }
        difference
    }

    fn is_free(&self, x: DVec3, r: f64, position: &[DVec3], radius: &[f64]) -> bool {
        let at = self.place(x);
        for z in self.beside(at, 2) {
            for y in self.beside(at, 1) {
                for cube in self.beside(at, 0).map(|x| self.cube([x, y, z])) {
                    let mut k = self.head[cube];
                    while k != END {
                        let (other, reach) = (position[k as usize], r + radius[k as usize]);
                        if self.nearest(other - x).length_squared() <= reach * reach {
                            return false;
                        }
                        k = self.next[k as usize];
                    }
                }
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use porograin_geometry::Neighbours;

    fn near(cell: &Cell, grains: &Grains) -> Neighbours {
        let mut near = Neighbours::default();
        near.refresh(cell, &grains.position, &grains.radius, 0.0);
        near
    }

    #[test]
    fn a_cloud_has_its_count_spread_and_porosity_and_no_overlap() {
        let cell = Cell::walled(DVec3::new(1.0, 2.0, 3.0), DVec3::new(1.5, 2.4, 3.7));
        let grains = cloud(&cell, 3000, 0.3, 7, 0.7, 2600.0).unwrap();
        assert_eq!(grains.len(), 3000);
        assert!((1.0 - grains.volume() / cell.volume() - 0.7).abs() < 1e-12);
        let (small, large) =
            grains.radius.iter().fold((f64::MAX, 0.0_f64), |(a, b), &r| (a.min(r), b.max(r)));
        assert!((large / small - 1.3 / 0.7).abs() < 0.01, "{}", large / small);
        for [i, j] in near(&cell, &grains).pairs {
            let (i, j) = (i as usize, j as usize);
            if j < grains.len() {
                let gap =
                    grains.position[i].distance(grains.position[j]) - grains.radius[i] - grains.radius[j];
                assert!(gap > 0.0);
            }
        }
        for (x, r) in grains.position.iter().zip(&grains.radius) {
            assert!((*x - *r).cmpge(cell.origin).all() && (*x + *r).cmple(cell.upper()).all());
        }
        let mut ids = grains.id.clone();
        ids.sort_unstable();
        assert!(ids.iter().enumerate().all(|(k, &id)| k as u32 == id));
    }

    /// The generator is part of the format: these numbers must never change.
    #[test]
    fn a_seed_names_a_cloud() {
        let cell = Cell::walled(DVec3::ZERO, DVec3::ONE);
        let first = cloud(&cell, 10, 0.2, 7, 0.9, 1000.0).unwrap();
        assert_eq!(first, cloud(&cell, 10, 0.2, 7, 0.9, 1000.0).unwrap());
        assert_ne!(first.position, cloud(&cell, 10, 0.2, 8, 0.9, 1000.0).unwrap().position);
        let k = first.id.iter().position(|&id| id == 0).unwrap();
        let known = DVec3::new(0.5820551436688379, 0.49024295744421986, 0.18349269195611562);
        assert!(first.position[k].distance(known) < 1e-12, "{:?}", first.position[k]);
    }

    #[test]
    fn a_cloud_that_cannot_be_is_refused() {
        let cell = Cell::walled(DVec3::ZERO, DVec3::ONE);
        assert!(matches!(cloud(&cell, 500, 0.0, 1, 0.4, 1.0), Err(CloudError::Room { .. })));
        assert!(matches!(cloud(&cell, 1, 0.0, 1, 0.1, 1.0), Err(CloudError::Size { .. })));
        assert!(matches!(cloud(&cell, 0, 0.0, 1, 0.7, 1.0), Err(CloudError::Input(_))));
        assert!(matches!(cloud(&cell, 9, f64::NAN, 1, 0.7, 1.0), Err(CloudError::Input(_))));
        assert!(matches!(cloud(&cell, 9, 0.1, 1, f64::NAN, 1.0), Err(CloudError::Input(_))));
    }

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
            let centres = lattice(kind, &cell, 0.5);
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
        assert_eq!(lattice(Lattice::SimpleCubic, &tight, 0.1).len(), 27);
    }
}

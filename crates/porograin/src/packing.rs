//! Initial states: random clouds, regular lattices, growth. All of them report what they made; sizes never change
//! silently.

mod grading;
mod lattice;
pub use grading::Grading;
pub use lattice::{Lattice, Misfit, lattice};

use crate::grains::{Grains, Shape, sphere_volume};
use crate::state::State;
use glam::{DMat3, DVec3};
use porograin_geometry::{Cell, Period, order};
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
                "only {placed} of {count} grains found room: random insertion stops near porosity 0.65, start looser or in \
                 a larger box, and compact"
            ),
        }
    }
}

impl std::error::Error for CloudError {}

/// How many grains a cloud has and how large they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Amount {
    /// So many grains, a relative grading times what makes the void part of the box `porosity`.
    Scaled {
        /// How many.
        count: usize,
        /// Void part of the box.
        porosity: f64,
    },
    /// So many grains, the grading times `radius` [m]; 1 for a sieve table.
    Count {
        /// How many.
        count: usize,
        /// What a relative grading counts from.
        radius: f64,
    },
    /// As many grains as leave the void part `porosity`, the grading times `radius` [m]; 1 for a sieve table.
    Fill {
        /// Void part of the box.
        porosity: f64,
        /// What a relative grading counts from.
        radius: f64,
    },
}

/// [`graded_cloud`] with radii uniform within `mean (1 ± spread)`.
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
    if !(0.0..1.0).contains(&spread) {
        return Err(CloudError::Input("the spread of a cloud must be at least 0 and less than 1"));
    }
    graded_cloud(cell, &Grading::Uniform { spread }, Amount::Scaled { count, porosity }, seed, density)
}

/// Grains at rest, thrown at random into a box, walled or periodic, without touching each other or a wall.
///
/// `density` in kg/m³. The same numbers give the same cloud on every machine (generator PCG64 XSL-RR, its 53 high
/// bits). Grains come in an [order](ordered) that keeps neighbours close; [`Grains::id`] is the order of creation, largest first.
///
/// # Errors
/// Numbers out of range, a box too small for the largest grain, or no room.
pub fn graded_cloud(
    cell: &Cell,
    grading: &Grading,
    amount: Amount,
    seed: u64,
    density: f64,
) -> Result<Grains, CloudError> {
    if let Amount::Scaled { porosity, .. } | Amount::Fill { porosity, .. } = amount
        && !(porosity > 0.0 && porosity < 1.0)
    {
        return Err(CloudError::Input("the porosity of a cloud must lie between 0 and 1"));
    }
    let count = match amount {
        Amount::Scaled { count, .. } | Amount::Count { count, .. } => count,
        Amount::Fill { porosity, radius } => {
            let mean = sphere_volume(radius) * grading.mean_cube();
            ((1.0 - porosity) * cell.volume() / mean).round() as usize
        }
    };
    if count == 0 || count > 100_000_000 {
        return Err(CloudError::Input("the count of a cloud must lie between 1 and 1e8"));
    }
    let mut random = Pcg64::new(u128::from(seed), 0x0a02_bdbf_7bb3_c0a7_ac28_fa16_a64a_bf96);
    let mut uniform = move || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
    let mut radius = grading.draw(count, &mut uniform);
    radius.sort_by(|a, b| b.total_cmp(a)); // large grains find room first
    let scale = match amount {
        Amount::Scaled { porosity, .. } => {
            let solid: f64 = radius.iter().map(|&r| sphere_volume(r)).sum();
            ((1.0 - porosity) * cell.volume() / solid).cbrt()
        }
        Amount::Count { radius, .. } | Amount::Fill { radius, .. } => radius,
    };
    radius.iter_mut().for_each(|r| *r *= scale);

    let mut room = Room::new(cell, 2.0 * radius[0], count);
    if room.extent.min_element() < 2.0 * radius[0] {
        return Err(CloudError::Size { diameter: 2.0 * radius[0] });
    }
    let mut position: Vec<DVec3> = Vec::with_capacity(count);
    for (k, &r) in radius.iter().enumerate() {
        let place = (0..TRIES).find_map(|_| {
            let x = room.somewhere(r, DVec3::new(uniform(), uniform(), uniform()));
            room.is_free(x, r, &position, &radius).then_some(x)
        });
        let Some(x) = place else { return Err(CloudError::Room { placed: k, count }) };
        room.put(k, x);
        position.push(x);
    }
    Ok(ordered(cell, Grains::at_rest(position, radius, density)))
}

/// Up to so many grains the arrays stay in the second cache of a processor, where either order is as good.
const LARGE: usize = 16_384;

/// The grains along a [Hilbert curve](order::hilbert), or where they are many in [columns](order::columns), each keeping its
/// [id](Grains::id).
pub fn ordered(cell: &Cell, grains: Grains) -> Grains {
    let order = if grains.len() < LARGE { order::hilbert } else { order::columns }(cell, &grains.position);
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

/// Multiplies every radius by `factor`, masses by its cube, of discs by its square; returns the mean radius [m] that results.
pub fn grow(state: &mut State, factor: f64) -> f64 {
    let grains = &mut state.grains;
    grains.radius.iter_mut().for_each(|r| *r *= factor);
    let heavier = match grains.shape {
        Shape::Sphere => factor * factor * factor,
        Shape::Disc { .. } => factor * factor,
    };
    grains.mass.iter_mut().for_each(|m| *m *= heavier);
    grains.radius.iter().sum::<f64>() / grains.len().max(1) as f64
}

/// Grains placed so far, by cubes as large as the largest grain: chains through `next`, one per cube.
struct Room {
    lower: DVec3,
    /// Distance of opposite sides.
    extent: DVec3,
    /// Edges of a cell that leans and what takes a vector to its coordinates along them; such a cell is cut along its edges.
    leaning: Option<(DMat3, DMat3, Period)>,
    periodic: [bool; 3],
    per_length: DVec3,
    count: [usize; 3],
    head: Vec<u32>,
    next: Vec<u32>,
}

const END: u32 = u32::MAX;

impl Room {
    fn new(cell: &Cell, diameter: f64, grains: usize) -> Self {
        let (lower, edges, periodic) = (cell.origin, cell.edges, cell.periodic);
        let size = DVec3::new(edges.x_axis.x, edges.y_axis.y, edges.z_axis.z);
        let upright = edges == DMat3::from_diagonal(size);
        let leaning = Period::of(cell).filter(|_| !upright).map(|period| (edges, edges.inverse(), period));
        let extent = match &leaning {
            None => cell.upper() - lower,
            Some((_, along, _)) => DVec3::from([0, 1, 2].map(|axis| along.row(axis).length().recip())),
        };
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
        Room { lower, extent, leaning, periodic, per_length, count: count_, head, next }
    }

    /// A place for a grain of radius `r`, by three numbers from 0 to 1.
    fn somewhere(&self, r: f64, part: DVec3) -> DVec3 {
        // Walls keep a radius away.
        let edge = DVec3::from_array(self.periodic.map(|p| if p { 0.0 } else { r }));
        let Some((edges, ..)) = self.leaning else {
            let free = self.extent - 2.0 * edge;
            return self.lower + edge + free * part;
        };
        let edge = edge / self.extent;
        self.lower + edges * (edge + (1.0 - 2.0 * edge) * part)
    }

    fn place(&self, x: DVec3) -> [usize; 3] {
        let from = x - self.lower;
        let p =
            self.leaning.as_ref().map_or(from, |(_, along, _)| *along * from * self.extent) * self.per_length;
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
        if let Some((.., period)) = &self.leaning {
            return difference + period.nearest(difference);
        }
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

    /// Of count, porosity and sizes two decide; the third is what follows, and no size changes.
    #[test]
    fn sizes_are_those_asked_for() {
        let cell = Cell::walled(DVec3::ZERO, DVec3::splat(20e-3));
        let sieve = Grading::Sieve(vec![[1e-3, 0.0], [1.5e-3, 0.5], [2e-3, 1.0]]);
        let fill = Amount::Fill { porosity: 0.7, radius: 1.0 };
        let grains = graded_cloud(&cell, &sieve, fill, 1, 2600.0).unwrap();
        let porosity = 1.0 - grains.volume() / cell.volume();
        assert!((porosity - 0.7).abs() < 1e-3, "{porosity}");
        assert!(grains.radius.iter().all(|r| (0.5e-3..=1e-3).contains(r)));
        assert!(sieve.difference(&grains.radius) < 0.005);
        let amount = Amount::Count { count: 400, radius: 1e-3 };
        let normal = Grading::Normal { deviation: 0.1 };
        let grains = graded_cloud(&cell, &normal, amount, 1, 2600.0).unwrap();
        let mean = grains.radius.iter().sum::<f64>() / 400.0;
        assert!(grains.len() == 400 && (mean - 1e-3).abs() < 2e-6, "{mean}");
    }
}

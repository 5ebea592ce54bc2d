//! How the water moves in the pores and around the grains.
//!
//! The mean over the void of a pore of the velocity of the water, less that of the grains around it, follows from the fluxes
//! through its throats: with `div u = 0`, `∫ u dV = ∮ x (u·n) dA`, and the surfaces of grains and walls let nothing through
//! (the average of Catalano 4.23 and 6.24, there in words). So
//!
//! `u_i = 1/V_i (sum_j q_ij (c_ij - m_i) - Q_i (c_i - m_i))`, c_ij the middle of the throat's fluid area, `Q_i` what comes in through a
//! wall and `c_i` the middle of the pore's face there. `m_i`, the mean of the c_ij weighted by the voids of the throats, matters only while
//! the pore changes its volume. `V_i` is half of the void of its throats, always positive; these volumes sum to the void of the
//! sample, and so `porosity <u> = 1/V sum V_i u_i` is the flux per area through the sample, to round-off.

use crate::pores::Mesh;
use glam::{DMat3, DVec3};
use porograin_geometry::throat::{Centres, Packing, shape};
use porograin_geometry::triangulation::{FIRST_WALL, wall};

/// Pores with their grains where they are.
#[derive(Clone, Debug)]
pub struct Site<'a> {
    /// The grains; in a periodic cell each in the period in which the mesh knows it.
    pub packing: Packing<'a>,
    /// The pores.
    pub mesh: &'a Mesh,
    /// Where the pressure of each pore lives [m].
    pub centre: Vec<DVec3>,
    /// Where the slots of each grain begin in `slots`.
    starts: Vec<u32>,
    /// Slots `4 pore + vertex` by grain, in rising order.
    slots: Vec<u32>,
}

/// How grains, walls and images move.
#[derive(Clone, Copy, Debug)]
pub struct Walk<'a> {
    /// Velocities of the grains [m/s].
    pub grain: &'a [DVec3],
    /// Velocities of the six walls [m/s].
    pub wall: [DVec3; 6],
    /// Velocity gradient of the periodic cell: an image that lies `d` away is faster by that times d [1/s].
    pub gradient: DMat3,
}

/// What flows through the pores.
#[derive(Clone, Debug, PartialEq)]
pub struct PoreFlow {
    /// Void volume that belongs to each pore [m³]; they sum to the void of the sample.
    pub void: Vec<f64>,
    /// Mean velocity of the water in each pore less that of the grains around it [m/s]; pores of one node share one.
    pub seepage: Vec<DVec3>,
}

impl<'a> Site<'a> {
    /// Of grains that stand where the mesh was made.
    pub fn new(packing: Packing<'a>, mesh: &'a Mesh) -> Self {
        let grains = packing.position.len();
        let vertices = || mesh.triangulation.pores.as_flattened().iter().enumerate();
        let mut starts = vec![0; grains + 1];
        vertices().filter(|(_, v)| **v < FIRST_WALL).for_each(|(_, &v)| starts[v as usize + 1] += 1);
        (0..grains).for_each(|grain| starts[grain + 1] += starts[grain]);
        let (mut next, mut slots) = (starts.clone(), vec![0; starts[grains] as usize]);
        for (slot, &v) in vertices().filter(|(_, v)| **v < FIRST_WALL) {
            slots[next[v as usize] as usize] = slot as u32;
            next[v as usize] += 1;
        }
        Site { packing, mesh, centre: mesh.centre.clone(), starts, slots }
    }

    /// Where a grain is a vertex: each pore and the place in it.
    pub(super) fn slots(&self, grain: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        let range = self.starts[grain] as usize..self.starts[grain + 1] as usize;
        self.slots[range].iter().map(|&slot| (slot as usize / 4, slot as usize % 4))
    }

    /// Of grains that have moved from `then`, where the mesh was made: each pore goes with its grains, at a wall with the
    /// wall.
    pub fn moved(packing: Packing<'a>, then: Packing, mesh: &'a Mesh) -> Self {
        let mut site = Site::new(packing, mesh);
        for (pore, centre) in site.centre.iter_mut().enumerate() {
            let (mut sum, mut count) = (DVec3::ZERO, 0.0);
            for k in 0..4 {
                let places = [packing, then].map(|p| p.point(&mesh.triangulation, pore, k));
                if let [Some(now), Some(before)] = places {
                    sum += now - before;
                    count += 1.0;
                }
            }
            *centre += sum / count;
            for face in mesh.triangulation.pores[pore].iter().filter_map(|&v| wall(v)) {
                centre[face / 2] = packing.cell.wall_position(face);
            }
        }
        site
    }

    /// The period shift of a vertex of a pore [m].
    pub(super) fn shift(&self, pore: usize, k: usize) -> DVec3 {
        let shift = self.mesh.triangulation.shifts.get(pore).map(|shifts| shifts[k]);
        shift.map_or(DVec3::ZERO, |shift| self.packing.cell.shift(shift))
    }

    /// What to add to a place beside a pore to have it beside the pore that leads its node [m].
    fn frame(&self, pore: usize) -> DVec3 {
        self.mesh.images.as_ref().map_or(DVec3::ZERO, |images| self.packing.cell.shift(images.frame[pore]))
    }

    /// The middle of the face that a pore has on a wall [m].
    fn wall_face(&self, pore: usize, face: usize) -> DVec3 {
        let onto = |mut x: DVec3, face: usize| {
            x[face / 2] = self.packing.cell.wall_position(face);
            x
        };
        let vertices = &self.mesh.triangulation.pores[pore];
        let grains = (0..4).filter_map(|k| self.packing.point(&self.mesh.triangulation, pore, k));
        let mut corners: Vec<DVec3> = grains.map(|x| onto(x, face)).collect();
        // Each further wall doubles the polygon: there and back.
        for other in vertices.iter().filter_map(|&v| wall(v)).filter(|&other| other != face) {
            let back: Vec<DVec3> = corners.iter().rev().map(|&x| onto(x, other)).collect();
            corners.extend(back);
        }
        let (mut sum, mut area) = (DVec3::ZERO, 0.0);
        for pair in corners.windows(2).skip(1) {
            let part = (pair[0] - corners[0]).cross(pair[1] - corners[0]).length();
            sum += part * (corners[0] + pair[0] + pair[1]) / 3.0;
            area += part;
        }
        if area > 0.0 { sum / area } else { corners[0] }
    }
}

impl PoreFlow {
    /// Of the flux through each link, from its first node to its second, and of what comes into each node through a wall, spread
    /// over its faces on the walls that are `open` to it [m³/s].
    pub fn new(site: &Site, flux: &[f64], entering: &[f64], open: [bool; 6]) -> PoreFlow {
        let Site { packing, mesh, centre, .. } = site;
        let centres = Centres { point: centre.clone(), borrowed: Vec::new() };
        let nodes = mesh.nodes();
        let mut void = vec![0.0; mesh.node.len()];
        let (mut middle, mut weight) = (vec![DVec3::ZERO; nodes], vec![0.0; nodes]);
        let (mut first, mut out) = (vec![DVec3::ZERO; nodes], vec![0.0; nodes]);
        for (throat, link) in mesh.throats() {
            let shape = shape(*packing, &mesh.triangulation, &centres, &throat);
            let mut moment = shape.area * shape.centroid;
            for (k, &vertex) in throat.vertices.iter().enumerate().filter(|(_, v)| **v < FIRST_WALL) {
                let place = porograin_geometry::triangulation::FACET[throat.facet as usize][k];
                let shift = site.shift(throat.pores[0] as usize, place);
                let x = packing.position[vertex as usize] + shift;
                moment -= shape.covered[k] * x + shape.covered_moment[k];
            }
            let closed = shape.fluid_area <= 1e-6 * shape.area;
            let place = if closed { shape.centroid } else { moment / shape.fluid_area };
            let flux = link.map_or(0.0, |link| flux[link]);
            let beside = [place, place - packing.cell.shift(throat.shift)];
            for (side, sign) in [1.0, -1.0].into_iter().enumerate() {
                let pore = throat.pores[side] as usize;
                let node = mesh.node[pore] as usize;
                let place = beside[side] + site.frame(pore);
                let part = 0.5 * shape.void.max(0.0);
                void[pore] += part;
                weight[node] += part;
                middle[node] += part * place;
                first[node] += sign * flux * place;
                out[node] += sign * flux;
            }
        }
        let (mut entry, mut area) = (vec![DVec3::ZERO; nodes], vec![0.0; nodes]);
        for side in mesh.wall_faces.iter().filter(|side| open[side.face as usize]) {
            let (pore, face) = (side.pore as usize, side.face as usize);
            let node = mesh.node[pore] as usize;
            entry[node] += side.area * (site.wall_face(pore, face) + site.frame(pore));
            area[node] += side.area;
        }
        let of_node = |node: usize| {
            if weight[node] <= 0.0 {
                return DVec3::ZERO;
            }
            let (mut first, mut out) = (first[node], out[node]);
            if area[node] > 0.0 {
                first -= entering[node] * entry[node] / area[node];
                out -= entering[node];
            }
            (first - out * middle[node] / weight[node]) / weight[node]
        };
        let of_nodes: Vec<DVec3> = (0..nodes).map(of_node).collect();
        PoreFlow { void, seepage: mesh.node.iter().map(|&node| of_nodes[node as usize]).collect() }
    }

    /// Flux of the water past the grains per area of the sample [m/s]: porosity times mean seepage.
    pub fn discharge(&self, site: &Site) -> DVec3 {
        let sum: DVec3 = self.void.iter().zip(&self.seepage).map(|(&void, &u)| void * u).sum();
        sum / site.packing.cell.volume()
    }

    /// Velocity of the water in each pore [m/s]: the seepage and the mean velocity of the pore's grains and walls.
    pub fn velocity(&self, site: &Site, walk: &Walk) -> Vec<DVec3> {
        let solid = |pore: usize| -> DVec3 {
            let each = site.mesh.triangulation.pores[pore].iter().enumerate().map(|(k, &v)| match wall(v) {
                Some(face) => walk.wall[face],
                None => walk.grain[v as usize] + walk.gradient * site.shift(pore, k),
            });
            each.sum::<DVec3>() / 4.0
        };
        self.seepage.iter().enumerate().map(|(pore, &u)| u + solid(pore)).collect()
    }

    /// Velocity of the water around each grain: the mean over the pores it is a vertex of, weighted by their void [m/s]; of a
    /// grain in no pore its own. `velocity` is that in each pore.
    pub fn around_grains(&self, site: &Site, walk: &Walk, velocity: &[DVec3]) -> Vec<DVec3> {
        let around = |(grain, &own): (usize, &DVec3)| {
            let (mut sum, mut void) = (DVec3::ZERO, 0.0);
            for (pore, k) in site.slots(grain) {
                sum += self.void[pore] * (velocity[pore] - walk.gradient * site.shift(pore, k));
                void += self.void[pore];
            }
            if void > 0.0 { sum / void } else { own }
        };
        walk.grain.iter().enumerate().map(around).collect()
    }
}

//! What a period adds to the pores (Marzougui §2.6): the image of a pore that lies a whole number of periods `d` away has
//! the pressure `p + G·d`, G the macroscopic gradient, and moves with the deformation of the cell.

use super::mesh::{Carried, Mesh, between};
use crate::grains::Loads;
use crate::motion::Velocities;
use glam::{DMat3, DVec3};
use porograin_geometry::Cell;
use porograin_geometry::throat::{Throat, throats};
use porograin_geometry::triangulation::{Vertex, wall};

/// Where the pores and the links of a mesh lie among the images of a periodic cell.
///
/// The pressure of a node is that of the pore that leads it, where its [shifts](porograin_geometry::Triangulation::shifts)
/// place it.
#[derive(Clone, Debug)]
pub struct Images {
    /// The cell when the mesh was made.
    pub cell: Cell,
    /// How many periods to move each pore by to bring it beside the one that leads its node.
    pub frame: Vec<[i8; 3]>,
    /// The links that cross the period, with how far away the cell lies in which their second node is met [m].
    pub crossings: Vec<(u32, DVec3)>,
    /// The force per pressure difference that throats among those put on walls that water sticks to [m²], with the wall
    /// and the same distance [m].
    pub wall_drag: Vec<(u8, DVec3, DVec3)>,
    /// Volume that leaves each pore per velocity gradient of the cell, `sum force ⊗ place` over its vertices [m³]; the
    /// trace is three times the pore's volume.
    pub stretch: Vec<DMat3>,
}

/// What a throat adds to the [stretch](Images::stretch) of its two pores: `points` are the places of its vertices beside the
/// first pore, relative to the low corner of the cell, `beyond` is what lies between the frames of the two [m].
pub(super) fn stretch(force: [DVec3; 3], points: [DVec3; 3], beyond: DVec3) -> [DMat3; 2] {
    let mut both = [DMat3::ZERO; 2];
    for (force, point) in force.into_iter().zip(points) {
        both[0] += outer(force, point);
        both[1] -= outer(force, point - beyond);
    }
    both
}

impl Images {
    /// Keeps what a throat that crosses the period puts on walls.
    pub(super) fn add_wall_drag(&mut self, vertices: [Vertex; 3], force: [DVec3; 3], away: [i8; 3]) {
        if away != [0; 3] {
            let beyond = self.cell.shift(away);
            let walls = vertices.into_iter().zip(force).filter_map(|(v, force)| Some((wall(v)?, force)));
            self.wall_drag.extend(walls.map(|(face, force)| (face as u8, force, beyond)));
        }
    }
}

impl Mesh {
    /// [`carried`](Mesh::carried), and what leaves because the cell deforms.
    pub fn carried_with_cell(&self, velocities: &Velocities, out: &mut Carried) {
        self.carried(&velocities.grain, &velocities.spin, &velocities.wall, out);
        self.add_stretch(velocities.cell, out);
    }

    /// Adds what leaves pores and nodes because the cell deforms with the velocity gradient `rate` [1/s], the grains and
    /// their images with it; nothing in a walled box.
    pub fn add_stretch(&self, rate: DMat3, out: &mut Carried) {
        let Some(images) = self.images.as_ref().filter(|_| rate != DMat3::ZERO) else { return };
        for (pore, stretch) in images.stretch.iter().enumerate() {
            let volume = match &self.volume_rate {
                None => product(*stretch, rate),
                Some(_) => self.volume[pore] * (rate.x_axis.x + rate.y_axis.y + rate.z_axis.z),
            };
            out.pore[pore] += volume;
            out.node[self.node[pore] as usize] += volume;
        }
    }

    /// What pressures do to the cell: the power they give to a velocity gradient, per component [J]. Over the volume of
    /// the cell that is their share of the stress, compression positive. Zero in a walled box.
    pub fn stretching(&self, pressure: &[f64]) -> DMat3 {
        let mut sum = DMat3::ZERO;
        if let Some(images) = &self.images {
            for (&node, &stretch) in self.node.iter().zip(&images.stretch) {
                sum += pressure[node as usize] * stretch;
            }
        }
        sum
    }

    /// Adds to the sources of the nodes what flows into them because the pressure of images differs by the macroscopic
    /// gradient [Pa/m].
    pub fn add_gradient_sources(&self, gradient: DVec3, source: &mut Vec<f64>) {
        let Some(images) = &self.images else { return };
        source.resize(self.nodes(), 0.0);
        for &(link, beyond) in &images.crossings {
            let [i, j] = self.links[link as usize];
            let flux = self.conductance[link as usize] * gradient.dot(beyond);
            source[i as usize] += flux;
            source[j as usize] -= flux;
        }
    }

    /// Flux through each link from its first node to its second [m³/s] under a macroscopic gradient [Pa/m].
    pub fn link_fluxes(&self, gradient: DVec3, pressure: &[f64]) -> Vec<f64> {
        let drop = |&[i, j]: &[u32; 2]| pressure[i as usize] - pressure[j as usize];
        let mut flux: Vec<f64> = self.links.iter().zip(&self.conductance).map(|(l, g)| g * drop(l)).collect();
        for &(link, beyond) in self.images.iter().flat_map(|images| &images.crossings) {
            flux[link as usize] -= self.conductance[link as usize] * gradient.dot(beyond);
        }
        flux
    }

    /// Every throat, with its link where it has one: throats inside of a node have none.
    pub fn throats(&self) -> impl Iterator<Item = (Throat, Option<usize>)> {
        let mut links = 0..self.links.len();
        throats(&self.triangulation).into_iter().map(move |throat| {
            let [i, j] = throat.pores.map(|pore| pore as usize);
            let frames = self.images.as_ref().map(|images| [images.frame[i], images.frame[j]]);
            let away = frames.map_or([0; 3], |[i, j]| between(throat.shift, i, j));
            let open = self.node[i] != self.node[j] || away != [0; 3];
            (throat, if open { links.next() } else { None })
        })
    }

    /// Flux times the period it crosses, summed over the links [m⁴/s]: over the volume of the cell, the mean velocity.
    pub fn crossing_flux(&self, gradient: DVec3, pressure: &[f64]) -> DVec3 {
        let flux = |&(link, beyond): &(u32, DVec3)| {
            let [i, j] = self.links[link as usize].map(|node| pressure[node as usize]);
            self.conductance[link as usize] * (i - j - gradient.dot(beyond)) * beyond
        };
        self.images.iter().flat_map(|images| &images.crossings).map(flux).sum()
    }

    /// Pressure of each pore where the mesh places it [Pa].
    pub fn pore_pressure(&self, gradient: DVec3, pressure: &[f64]) -> Vec<f64> {
        let mut local: Vec<f64> = self.node.iter().map(|&node| pressure[node as usize]).collect();
        if let Some(images) = self.images.as_ref().filter(|_| gradient != DVec3::ZERO) {
            for (p, &frame) in local.iter_mut().zip(&images.frame) {
                *p -= gradient.dot(images.cell.shift(frame));
            }
        }
        local
    }

    /// Adds the forces and torques of a macroscopic gradient [Pa/m] beside those of the pressures of the nodes. The
    /// forces on grains and walls sum to `-gradient V`; what the gradient presses onto a wall along its normal has no
    /// mean over a period and is left out.
    pub fn add_gradient_loads(&self, gradient: DVec3, loads: &mut Loads) {
        let Some(images) = self.images.as_ref().filter(|_| gradient != DVec3::ZERO) else { return };
        for (pore, vertices) in self.triangulation.pores.iter().enumerate() {
            let (frame, push) = (images.frame[pore], self.push.of(pore));
            for (k, &vertex) in vertices.iter().enumerate() {
                if wall(vertex).is_some() {
                    continue;
                }
                // The image of the pore that this vertex, unshifted, belongs to.
                let shift = self.triangulation.shifts[pore][k];
                let away = std::array::from_fn(|axis| frame[axis] + shift[axis]);
                let pressure = -gradient.dot(images.cell.shift(away));
                loads.force[vertex as usize] += pressure * push[k].force();
                loads.torque[vertex as usize] += pressure * push[k].torque();
            }
        }
        for &(face, force, beyond) in &images.wall_drag {
            loads.wall[face as usize] -= gradient.dot(beyond) * force;
        }
    }
}

/// `a ⊗ b`, row along `a`.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// `sum_ij a_ij b_ij`.
pub(super) fn product(a: DMat3, b: DMat3) -> f64 {
    a.x_axis.dot(b.x_axis) + a.y_axis.dot(b.y_axis) + a.z_axis.dot(b.z_axis)
}

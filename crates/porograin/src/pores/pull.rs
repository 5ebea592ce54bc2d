//! A macroscopic gradient G of the pressure that drives water through a periodic cell.
//!
//! The pressure is `p + G·(x - x_0)`, p with the period of the cell: p is what a node holds, and x the place of the pore that leads it.
//! A throat from pore i to the image of pore j a shift d away carries `q = (g/L) (p_i - p_j + r_i - r_j - G·d)` with the rise
//! `r = G·(x - x_0)`; so p does not know in which image a pore is named, and G enters as sources and as forces. On grains
//! and on walls that water sticks to these sum to `-G V`. What G presses onto a wall along its normal has no mean over a period and
//! is left out; the stress of the cell is that of p alone.

use super::mesh::Mesh;
use crate::grains::Loads;
use crate::motion::Velocities;
use glam::DVec3;
use porograin_geometry::cell::NORMALS;

/// The gradient in a step, and what it does to a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pull {
    /// The gradient [Pa/m].
    pub gradient: DVec3,
    /// `G·(x - x_0)` of each node; empty without a gradient [Pa].
    rise: Vec<f64>,
    /// What the gradient adds to the pressure difference of each link; empty without one [Pa].
    drop: Vec<f64>,
}

impl Pull {
    /// Of this gradient [Pa/m] in a periodic cell.
    pub fn new(mesh: &Mesh, gradient: DVec3) -> Pull {
        let mut pull = Pull { gradient, ..Pull::default() };
        let Some(images) = mesh.images.as_ref().filter(|_| gradient != DVec3::ZERO) else { return pull };
        pull.rise = vec![0.0; mesh.nodes()];
        // The lowest pore of a node leads it.
        for (pore, &node) in mesh.node.iter().enumerate().rev() {
            pull.rise[node as usize] = gradient.dot(mesh.centre[pore] - images.cell.origin);
        }
        let rise = |&[i, j]: &[u32; 2]| pull.rise[i as usize] - pull.rise[j as usize];
        pull.drop = mesh.links.iter().map(rise).collect();
        for &(link, beyond) in &images.crossings {
            pull.drop[link as usize] -= gradient.dot(beyond);
        }
        pull
    }

    /// Whether there is none.
    pub fn is_none(&self) -> bool {
        self.drop.is_empty()
    }

    /// What it adds to the pressure difference of a link [Pa].
    pub fn drop(&self, link: usize) -> f64 {
        self.drop.get(link).copied().unwrap_or(0.0)
    }

    /// Flux through each link from its first node to its second [m³/s].
    pub fn fluxes(&self, mesh: &Mesh, pressure: &[f64]) -> Vec<f64> {
        let flux = |(link, (&[i, j], &g)): (usize, (&[u32; 2], &f64))| {
            g * (pressure[i as usize] - pressure[j as usize] + self.drop(link))
        };
        mesh.links.iter().zip(&mesh.conductance).enumerate().map(flux).collect()
    }

    /// Adds to the sources of the nodes what the gradient makes flow into them [m³/s].
    pub fn add_sources(&self, mesh: &Mesh, source: &mut Vec<f64>) {
        if self.is_none() {
            return;
        }
        source.resize(mesh.nodes(), 0.0);
        for ((&[i, j], &g), &drop) in mesh.links.iter().zip(&mesh.conductance).zip(&self.drop) {
            source[i as usize] -= g * drop;
            source[j as usize] += g * drop;
        }
    }

    /// Adds the forces and torques of the gradient.
    pub fn add_loads(&self, mesh: &Mesh, loads: &mut Loads) {
        if self.is_none() {
            return;
        }
        let mut pulled = Loads::default();
        pulled.clear(loads.force.len());
        mesh.add_loads(&self.rise, &mut pulled);
        mesh.add_gradient_loads(self.gradient, &mut pulled);
        for (load, pulled) in [(&mut loads.force, pulled.force), (&mut loads.torque, pulled.torque)] {
            load.iter_mut().zip(pulled).for_each(|(load, pulled)| *load += pulled);
        }
        for (face, pulled) in pulled.wall.into_iter().enumerate() {
            loads.wall[face] += pulled - pulled.dot(NORMALS[face]) * NORMALS[face];
        }
    }

    /// The power of the gradient [W]: on the water that flows past the grains, and on grains and walls, which move with these
    /// velocities beside the flow of the cell.
    pub fn power(&self, mesh: &Mesh, pressure: &[f64], velocities: &Velocities) -> f64 {
        if self.is_none() {
            return 0.0;
        }
        let mut loads = Loads::default();
        loads.clear(velocities.grain.len());
        self.add_loads(mesh, &mut loads);
        let water: f64 = self.fluxes(mesh, pressure).iter().zip(&self.drop).map(|(q, drop)| q * drop).sum();
        let dot = |a: &[DVec3], b: &[DVec3]| -> f64 { a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum() };
        water
            + dot(&loads.force, &velocities.grain)
            + dot(&loads.torque, &velocities.spin)
            + dot(&loads.wall, &velocities.wall)
    }
}

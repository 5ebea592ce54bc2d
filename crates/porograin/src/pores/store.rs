//! Compressible water: what the pores hold beyond what fills them at zero pressure.
//!
//! Of a node with the void volume `V_f`, `(V_f/K_f) dp/dt = -Sᵀ (v, spin) - sum q + Q` (`physics` §3), by backward
//! Euler. What a node holds is kept apart from its pressure: it changes by exactly what flows in and what the grains push
//! out, so that no water is lost whatever the residual of the solve; what the solve leaves over is made up for in the next.

use super::mesh::{Carried, FREE, Mesh};
use serde::{Deserialize, Serialize};

/// What compressible water keeps from step to step. Volumes are those that the water would have at zero pressure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Store {
    /// Water in each node beyond its void volume [m³]: `V_f p / K_f`, but for what the last solve left over.
    pub surplus: Vec<f64>,
    /// Void volume of all nodes: that of the mesh, and what grains and walls have added since [m³].
    pub void: f64,
    /// The interval that the solver was prepared for [s].
    pub interval: f64,
}

/// `V_f / K_f` of each node of a mesh [m³/Pa].
pub fn capacity(mesh: &Mesh, bulk_modulus: f64) -> Vec<f64> {
    mesh.void.iter().map(|void| void.max(0.0) / bulk_modulus).collect()
}

impl Store {
    /// At the given pressures of the nodes [Pa], which it shifts by the same amount everywhere but in held nodes such that
    /// all water together is `total` [m³], where that is known. `pending` is what moving grains and walls have already added
    /// to the void of the mesh, but the next solve is to answer [m³].
    pub fn new(
        mesh: &Mesh,
        capacity: &[f64],
        pressure: &mut [f64],
        total: Option<f64>,
        pending: f64,
    ) -> Store {
        let void = mesh.void.iter().sum::<f64>() - pending;
        let mut store = Store { surplus: Vec::new(), void, interval: 0.0 };
        store.fill(capacity, pressure);
        if let Some(total) = total {
            let free = |node: usize| mesh.held[node] == FREE;
            let room: f64 = (0..capacity.len()).filter(|&node| free(node)).map(|node| capacity[node]).sum();
            if room > 0.0 {
                let shift = (total - store.total()) / room;
                (0..capacity.len()).filter(|&node| free(node)).for_each(|node| pressure[node] += shift);
                store.fill(capacity, pressure);
                // The last digits, which the shift was too coarse for.
                if let Some(first) = (0..capacity.len()).find(|&node| free(node)) {
                    store.surplus[first] += total - store.total();
                }
            }
        }
        store
    }

    fn fill(&mut self, capacity: &[f64], pressure: &[f64]) {
        self.surplus = capacity.iter().zip(pressure).map(|(c, p)| c * p).collect();
    }

    /// All water [m³].
    pub fn total(&self) -> f64 {
        self.void + self.surplus.iter().sum::<f64>()
    }

    /// Gives what the nodes hold over to a solve over `interval` [s], as sources [m³/s].
    pub fn give(&self, interval: f64, source: &mut Vec<f64>) {
        source.resize(self.surplus.len(), 0.0);
        source.iter_mut().zip(&self.surplus).for_each(|(source, surplus)| *source += surplus / interval);
    }

    /// Takes in what has flowed and moved at the pressures found [Pa]. `carried` is what left the nodes, less sources,
    /// those of [`give`](Self::give) among them; what the pressures take up of it is added there, so that in free
    /// nodes it balances the flow.
    pub fn take(
        &mut self,
        mesh: &Mesh,
        capacity: &[f64],
        pressure: &[f64],
        interval: f64,
        carried: &mut Carried,
    ) {
        self.void += interval * carried.pore.iter().sum::<f64>();
        for (node, rate) in carried.node.iter_mut().enumerate() {
            self.surplus[node] = capacity[node] * pressure[node];
            *rate += self.surplus[node] / interval;
            if mesh.held[node] == FREE {
                self.surplus[node] -= interval * *rate;
            }
        }
        for (&[i, j], &g) in mesh.links.iter().zip(&mesh.conductance) {
            let (i, j) = (i as usize, j as usize);
            let moved = interval * g * (pressure[i] - pressure[j]);
            for (node, moved) in [(i, moved), (j, -moved)] {
                if mesh.held[node] == FREE {
                    self.surplus[node] -= moved;
                }
            }
        }
    }
}

//! The pores as a network: nodes joined by conductances, and the coupling of every pore with its grains and walls.

use super::conductance::{Conductance, Passage};
use super::coupling::{Push, coupling};
use super::images::{self, Images};
use super::patch::{Patches, Room};
use super::pushes::{Piles, Pushes};
use crate::boundary::Slip;
use crate::grains::Loads;
use glam::{DMat3, DVec3};
use porograin_geometry::cell::NORMALS;
use porograin_geometry::throat::{Centres, Packing, Throat, pore_volume, radical_centres, shape, throats};
use porograin_geometry::triangulation::{FACET, FIRST_WALL, NONE, Triangulation, TriangulationError, wall};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Pores whose radical centres are closer than this many mean radii of their throat's grains are one node.
///
/// The throat between them would conduct without bound; what is neglected is a resistance 10⁻⁴ of a typical one.
const COINCIDENT: f64 = 1e-4;

/// Nodes that are worth a thread.
const SHARE: usize = 4096;

/// Throats worked out before they are added up.
const BLOCK: usize = 1 << 12;

/// The node is free: no face holds its pressure.
pub const FREE: u8 = u8::MAX;
/// The node lets no water through.
pub const BLOCKED: u8 = u8::MAX - 1;
/// A point holds the pressure of the node.
pub const POINT: u8 = u8::MAX - 2;

/// What the six walls are to the water.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Walls {
    /// Whether the pressure is imposed there.
    pub open: [bool; 6],
    /// Whether the water sticks to it.
    pub slip: [Slip; 6],
}

/// What was found while making a mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Census {
    /// Pores (tetrahedra, prisms at the walls).
    pub pores: usize,
    /// Throats.
    pub throats: usize,
    /// Pores merged into a neighbour because their radical centres coincide.
    pub merged: usize,
    /// Flat pores among those.
    pub flat: usize,
    /// Throats that overlapping grains close.
    pub closed: usize,
    /// Throats outside the range that their conductance is calibrated for: they count as one at its end.
    pub clamped: usize,
    /// Nodes that let no water through because the case says so.
    #[serde(default)]
    pub blocked: usize,
}

/// The face of a pore on a wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WallFace {
    /// The pore.
    pub pore: u32,
    /// The wall.
    pub face: u8,
    /// [m²]
    pub area: f64,
}

/// The pores, ready to carry water. A node is a pore, or several whose radical centres coincide. Free nodes come first, then those
/// whose pressure is held.
#[derive(Clone, Debug)]
pub struct Mesh {
    /// The triangulation it was made of.
    pub triangulation: Triangulation,
    /// Radical centre of each pore [m].
    pub centre: Vec<DVec3>,
    /// Volume of each pore when the mesh was made [m³].
    pub volume: Vec<f64>,
    /// The node of each pore.
    pub node: Vec<u32>,
    /// Void volume of each node when the mesh was made, half of that of its throats [m³]; they sum to the void.
    pub void: Vec<f64>,
    /// Whether the pressure is imposed at each face of the box.
    pub open: [bool; 6],
    /// The face that holds the pressure of each node, or [`POINT`], [`BLOCKED`], [`FREE`].
    pub held: Vec<u8>,
    /// Each held node and where its pressure lives [m].
    pub holds: Vec<(u32, DVec3)>,
    /// The node of each point that has a rule of its own.
    pub points: Vec<u32>,
    /// Number of free nodes.
    pub unknowns: usize,
    /// The two nodes of each open throat.
    pub links: Vec<[u32; 2]>,
    /// `g / L` of each link [m³/(Pa s)].
    pub conductance: Vec<f64>,
    /// What the pressure of each pore does to each of its vertices.
    pub push: Pushes,
    /// Volume rate of each pore per velocity and spin of its vertices, where that is not the transpose of `push` but the
    /// [geometric](super::geometric) one.
    pub volume_rate: Option<Pushes>,
    /// The faces that pores have on walls; those of one wall sum to the area of the box's face.
    pub wall_faces: Vec<WallFace>,
    patches: Patches,
    /// The first pore of each node, and all others.
    first: Vec<u32>,
    merged: Vec<u32>,
    /// Slots `4 pore + vertex` of wall vertices, in rising order.
    wall_slots: Vec<u32>,
    /// What a period adds; `None` in a box with six walls.
    pub images: Option<Images>,
    /// What was found.
    pub census: Census,
}

impl Mesh {
    /// Meshes the pores between the grains.
    ///
    /// # Errors
    /// Those of the triangulation.
    pub fn new(
        packing: Packing,
        walls: &Walls,
        conductance: Conductance,
        viscosity: f64,
    ) -> Result<Mesh, TriangulationError> {
        let triangulation = Triangulation::new(packing.cell, packing.position, packing.radius)?;
        Ok(Mesh::from_triangulation(packing, triangulation, walls, conductance, viscosity))
    }

    /// The network of a given triangulation.
    pub fn from_triangulation(
        packing: Packing,
        triangulation: Triangulation,
        walls: &Walls,
        conductance: Conductance,
        viscosity: f64,
    ) -> Mesh {
        let centres = radical_centres(packing, &triangulation);
        let throats = throats(&triangulation);
        let pores = triangulation.pores.len();
        let mut census =
            Census { pores, throats: throats.len(), flat: centres.borrowed.len(), ..Census::default() };
        let mut sets = Sets::new(pores);
        for throat in &throats {
            let pores = throat.pores.map(|p| centres.point[p as usize]);
            let apart = pores[1] + packing.cell.shift(throat.shift) - pores[0];
            if apart.length() < COINCIDENT * mean_radius(packing, throat.vertices) {
                census.merged += usize::from(sets.join(throat.pores, throat.shift));
            }
        }
        let mut frame = vec![[0; 3]; pores];
        let mut node = vec![0u32; pores];
        let mut held = Vec::with_capacity(pores);
        let (mut first, mut merged) = (Vec::with_capacity(pores), Vec::new());
        for pore in 0..pores {
            let (leader, away) = sets.leader(pore as u32);
            let leader = leader as usize;
            frame[pore] = away;
            if leader == pore {
                node[pore] = held.len() as u32;
                held.push(FREE);
                first.push(pore as u32);
            } else {
                node[pore] = node[leader];
                merged.push(pore as u32);
            }
        }
        for (pore, vertices) in triangulation.pores.iter().enumerate() {
            for face in vertices.iter().filter_map(|&v| wall(v)).filter(|&f| walls.open[f]) {
                // Where two open faces meet, the one named later rules: the top before the sides.
                let holder = &mut held[node[pore] as usize];
                *holder = if *holder == FREE { face as u8 } else { (*holder).max(face as u8) };
            }
        }
        let slots = (0..).zip(triangulation.pores.iter().flatten());
        let wall_slots = slots.filter(|(_, vertex)| **vertex >= FIRST_WALL).map(|(slot, _)| slot).collect();
        let mut mesh = Mesh {
            centre: Vec::new(),
            volume: (0..pores)
                .into_par_iter()
                .map(|pore| pore_volume(packing, &triangulation, pore))
                .collect(),
            void: vec![0.0; held.len()],
            node,
            open: walls.open,
            holds: Vec::new(),
            points: Vec::new(),
            held,
            unknowns: 0,
            links: Vec::with_capacity(throats.len()),
            conductance: Vec::with_capacity(throats.len()),
            push: Pushes::with_room(pores),
            volume_rate: None,
            wall_faces: Vec::new(),
            patches: Patches::new(&triangulation.pores, packing.position.len()),
            first,
            merged,
            wall_slots,
            images: (packing.cell.periodic != [false; 3]).then(|| Images {
                cell: *packing.cell,
                frame,
                crossings: Vec::new(),
                wall_drag: Vec::new(),
                stretch: vec![DMat3::ZERO; pores],
            }),
            census,
            triangulation,
        };
        let mut piles = Piles::new(pores);
        let mut closing = vec![DVec3::ZERO; pores];
        // Block by block: what all throats contribute would be half of the memory of a mesh.
        for block in throats.chunks(BLOCK) {
            // Throats come in the order of their first pores.
            mesh.pack(&mut piles, &closing, block[0].pores[0] as usize);
            let part = |throat| {
                Part::of(throat, packing, &mesh.triangulation, &centres, walls, conductance, viscosity)
            };
            let parts: Vec<Part> = block.par_iter().with_min_len(256).map(part).collect();
            for (throat, part) in block.iter().zip(&parts) {
                let [i, j] = throat.pores.map(|p| p as usize);
                let (order, slots) = (FACET[throat.facet as usize], throat.slots(&mesh.triangulation));
                for k in 0..3 {
                    let of_throat = Push::new(part.force[k], part.torque[k]);
                    piles.of(i)[order[k]] += of_throat;
                    piles.of(j)[slots[k]] -= of_throat;
                }
                closing[i] += part.area;
                closing[j] -= part.area;
                let nodes = throat.pores.map(|p| mesh.node[p as usize]);
                nodes.iter().for_each(|&node| mesh.void[node as usize] += 0.5 * part.void);
                let mut away = [0; 3];
                if let Some(images) = &mut mesh.images {
                    away = between(throat.shift, images.frame[i], images.frame[j]);
                    let link = mesh.links.len() as u32;
                    if away != [0; 3] {
                        images.crossings.push((link, packing.cell.shift(away)));
                    }
                    images.add_wall_drag(throat.vertices, part.force, away);
                    let points = order.map(|m| packing.point(&mesh.triangulation, i, m));
                    let points = points.map(|x| x.unwrap_or(part.centroid) - packing.cell.origin);
                    let both = images::stretch(part.force, points, packing.cell.shift(throat.shift));
                    images.stretch[i] += both[0];
                    images.stretch[j] += both[1];
                }
                // A node beside its own image has a link to itself.
                if nodes[0] != nodes[1] || away != [0; 3] {
                    mesh.census.closed += usize::from(part.conductance == 0.0);
                    mesh.census.clamped += usize::from(part.clamped);
                    mesh.links.push(nodes);
                    mesh.conductance.push(part.conductance);
                }
            }
        }
        mesh.pack(&mut piles, &closing, pores);
        mesh.centre = centres.point;
        for (pore, &node) in mesh.node.iter().enumerate() {
            let known = mesh.holds.last().is_some_and(|hold| node <= hold.0); // of pores in one node the first rules
            if mesh.held[node as usize] != FREE && !known {
                mesh.holds.push((node, mesh.centre[pore]));
            }
        }
        mesh.number();
        mesh
    }

    /// Completes and packs the pushes of the pores up to `done`.
    fn pack(&mut self, piles: &mut Piles, closing: &[DVec3], done: usize) {
        while let Some((first, mut pile)) = piles.next(done) {
            self.add_wall_faces(first, closing, &mut pile);
            self.push.extend(&pile);
        }
    }

    /// Numbers the nodes: the free ones first, else as they were.
    pub(super) fn number(&mut self) {
        let free = |&node: &usize| self.held[node] == FREE;
        let (mut order, held): (Vec<usize>, Vec<usize>) = (0..self.nodes()).partition(free);
        self.unknowns = order.len();
        order.extend(held);
        let mut place = vec![0u32; order.len()];
        (0..).zip(&order).for_each(|(new, &old)| place[old] = new);
        self.held = order.iter().map(|&old| self.held[old]).collect();
        self.void = order.iter().map(|&old| self.void[old]).collect();
        self.first = order.iter().map(|&old| self.first[old]).collect();
        let named = self.node.iter_mut().chain(self.links.iter_mut().flatten());
        let named = named.chain(&mut self.points).chain(self.holds.iter_mut().map(|hold| &mut hold.0));
        named.for_each(|node| *node = place[*node as usize]);
    }

    /// The face a pore has on a wall closes its surface; the pressure pushes it outwards: for the pores from `first` on, whose
    /// pushes are given.
    pub(super) fn add_wall_faces(&mut self, first: usize, closing: &[DVec3], push: &mut [[Push; 4]]) {
        for ((pore, vertices), push) in self.triangulation.pores.iter().enumerate().skip(first).zip(push) {
            for (k, &vertex) in vertices.iter().enumerate() {
                if let Some(face) = wall(vertex) {
                    let normal = NORMALS[face];
                    let area = -closing[pore].dot(normal);
                    push[k] += Push::new(normal * area, DVec3::ZERO);
                    self.wall_faces.push(WallFace { pore: pore as u32, face: face as u8, area });
                }
            }
        }
    }

    /// Number of nodes.
    pub fn nodes(&self) -> usize {
        self.held.len()
    }

    /// Writes the pressure of each held node, a function of its face and its place [m], into `pressure` [Pa].
    ///
    /// # Errors
    /// The first place where the function has no value.
    pub fn hold(&self, imposed: impl Fn(usize, DVec3) -> f64, pressure: &mut [f64]) -> Result<(), DVec3> {
        for &(node, place) in &self.holds {
            let value = imposed(self.held[node as usize] as usize, place);
            if !value.is_finite() {
                return Err(place);
            }
            pressure[node as usize] = value;
        }
        Ok(())
    }

    /// Writes one pressure for each face [Pa] to the nodes it holds.
    pub fn hold_faces(&self, held: &[f64; 6], pressure: &mut [f64]) {
        for &(node, _) in &self.holds {
            pressure[node as usize] = held[self.held[node as usize] as usize];
        }
    }

    /// `Sᵀ (v, spin)`: the volume that moving grains and walls carry out of each node [m³/s], written to `out`
    /// (length nodes).
    pub fn carried(&self, velocity: &[DVec3], spin: &[DVec3], wall_velocity: &[DVec3; 6], out: &mut Carried) {
        let rates = self.volume_rate.as_ref().unwrap_or(&self.push);
        out.pore.resize(self.node.len(), 0.0);
        self.patches.carried(rates, velocity, spin, wall_velocity, &mut out.pore);
        let Carried { pore, node, source } = out;
        let out_of = |&first: &u32| pore[first as usize];
        self.first.par_iter().with_min_len(SHARE).map(out_of).collect_into_vec(node);
        for &merged in &self.merged {
            node[self.node[merged as usize] as usize] += pore[merged as usize];
        }
        node.iter_mut().zip(source).for_each(|(node, source)| *node -= *source);
    }

    /// `S p`: adds the forces and torques of the pressures of the nodes [Pa], and what they do to a periodic cell, to
    /// the loads.
    pub fn add_loads(&self, pressure: &[f64], loads: &mut Loads) {
        self.add_loads_in(&mut Room::new(), pressure, loads);
    }

    /// The same with `room` that is kept from one time to the next.
    pub fn add_loads_in(&self, room: &mut Room, pressure: &[f64], loads: &mut Loads) {
        self.patches.load(&self.push, &self.node, pressure, room, loads);
        loads.cell += self.stretching(pressure);
    }

    /// What [`add_loads`](Self::add_loads) adds to the walls.
    pub fn add_wall_loads(&self, pressure: &[f64], load: &mut [DVec3; 6]) {
        for &slot in &self.wall_slots {
            let (pore, k) = (slot as usize / 4, slot as usize % 4);
            let face = (self.triangulation.pores[pore][k] - FIRST_WALL) as usize;
            load[face] += pressure[self.node[pore] as usize] * self.push.of(pore)[k].force();
        }
    }

    /// The largest change of a pore's volume since the mesh was made, relative to that volume [-]; with the pore.
    ///
    /// Pores thinner than a quarter of the mean count as a quarter of the mean: the relative change of a sliver
    /// says nothing about the packing.
    pub fn strain(&self, packing: Packing) -> (f64, usize) {
        let mean = self.volume.iter().sum::<f64>() / self.volume.len().max(1) as f64;
        (0..self.volume.len())
            .into_par_iter()
            .with_min_len(1024)
            .map(|pore| {
                let now = pore_volume(packing, &self.triangulation, pore);
                ((now - self.volume[pore]).abs() / self.volume[pore].max(0.25 * mean), pore)
            })
            .reduce(|| (0.0, 0), |a, b| if b.0 > a.0 || (b.0 == a.0 && b.1 < a.1) { b } else { a })
    }

    /// Pores across the facets of a pore.
    pub fn neighbours(&self, pore: usize) -> impl Iterator<Item = usize> + '_ {
        self.triangulation.neighbours[pore].iter().filter(|&&p| p != NONE).map(|&p| p as usize)
    }
}

/// Volumes carried out of pores and nodes per second [m³/s].
#[derive(Clone, Debug, Default)]
pub struct Carried {
    /// Out of each pore.
    pub pore: Vec<f64>,
    /// Out of each node, less what is given into it.
    pub node: Vec<f64>,
    /// Given into each node from outside; empty where nothing is.
    pub source: Vec<f64>,
}

/// What one throat contributes.
struct Part {
    conductance: f64,
    clamped: bool,
    void: f64,
    force: [DVec3; 3],
    torque: [DVec3; 3],
    area: DVec3,
    centroid: DVec3,
}

impl Part {
    fn of(
        throat: &Throat,
        packing: Packing,
        triangulation: &Triangulation,
        centres: &Centres,
        walls: &Walls,
        conductance: Conductance,
        viscosity: f64,
    ) -> Part {
        let shape = shape(packing, triangulation, centres, throat);
        let passage = Passage::new(packing, triangulation, centres, throat, &shape, &walls.slip);
        let pore = throat.pores[0] as usize;
        let points = FACET[throat.facet as usize].map(|m| packing.point(triangulation, pore, m));
        let coupled = coupling(packing, &passage, points, conductance);
        Part {
            conductance: conductance.of(&passage, viscosity),
            clamped: conductance.clamps(&passage),
            void: shape.void,
            force: coupled.force,
            torque: coupled.torque,
            area: shape.area * shape.normal,
            centroid: shape.centroid,
        }
    }
}

fn mean_radius(packing: Packing, vertices: [u32; 3]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for v in vertices.into_iter().filter(|&v| v < FIRST_WALL) {
        sum += packing.radius[v as usize];
        count += 1.0;
    }
    sum / count
}

/// Pores that form one node, each with the periods to move it by to bring it beside another one of its set.
struct Sets {
    parent: Vec<u32>,
    away: Vec<[i8; 3]>,
}

impl Sets {
    /// Every pore for itself.
    fn new(pores: usize) -> Sets {
        Sets { parent: (0..pores as u32).collect(), away: vec![[0; 3]; pores] }
    }

    /// The pore that leads the set of `pore`, and the periods to move `pore` by to bring it beside.
    fn leader(&mut self, mut pore: u32) -> (u32, [i8; 3]) {
        let mut total = [0; 3];
        while self.parent[pore as usize] != pore {
            let (here, parent) = (pore as usize, self.parent[pore as usize] as usize);
            self.parent[here] = self.parent[parent];
            self.away[here] = sum(self.away[here], self.away[parent]);
            total = sum(total, self.away[here]);
            pore = self.parent[here];
        }
        (pore, total)
    }

    /// Joins the sets of two pores, of which the second lies beside the first when moved by `shift`; false if they are
    /// one already. The lowest pore leads.
    fn join(&mut self, pores: [u32; 2], shift: [i8; 3]) -> bool {
        let [(a, from_a), (b, from_b)] = pores.map(|pore| self.leader(pore));
        let away = between(shift, from_a, from_b);
        let (low, high, away) = if a < b { (a, b, away) } else { (b, a, away.map(|s: i8| -s)) };
        self.parent[high as usize] = low;
        if a != b {
            self.away[high as usize] = away;
        }
        a != b
    }
}

/// The periods to move the leader of a second pore by to bring it beside the leader of a first, when the second pore lies
/// beside the first moved by `shift`, and the two beside their leaders moved by `first` and `second`.
pub(super) fn between(shift: [i8; 3], first: [i8; 3], second: [i8; 3]) -> [i8; 3] {
    std::array::from_fn(|axis| shift[axis] + first[axis] - second[axis])
}

fn sum(a: [i8; 3], b: [i8; 3]) -> [i8; 3] {
    std::array::from_fn(|axis| a[axis] + b[axis])
}

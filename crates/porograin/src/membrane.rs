//! A flexible membrane: a stress on the outer grains of a sample (Catalano fig. 2.5b).
//!
//! The membrane is the closed surface of triangles between centres of grains that a ball rolling around the sample leaves: of the
//! regular triangulation of the grains, every tetrahedron whose orthogonal sphere is no larger than the probe is inside, and
//! what the outside reaches through larger ones is bounded by the membrane. On the grain `k` acts
//!
//! `F_k = -sigma sum over its triangles of A/3 = -sigma dV/dx_k`,
//!
//! A the area of the triangle along its outward normal, V the volume inside. It is the force of a uniform pressure on the
//! surface, shared equally among the corners of each triangle: the sum of all forces and the sum of their moments
//! vanish, and their work is `-sigma dV`.

use crate::boundary::Signal;
use crate::grains::{Grains, Loads};
use crate::model::Model;
use crate::state::State;
use glam::{DMat3, DVec3};
use porograin_geometry::triangulation::{FACET, NONE, Triangulation, wall};
use serde::{Deserialize, Serialize};

/// Probe in terms of the mean radius, unless it is given.
const PROBE: f64 = 2.0;

/// What a membrane does.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Membrane {
    /// Positive in compression [Pa].
    pub stress: Signal,
    /// Radius of the orthogonal sphere up to which a tetrahedron of grains is inside [m]; by default twice the mean radius of
    /// the grains.
    pub probe: Option<f64>,
    /// Steps after which the outer grains are found anew.
    #[serde(default = "often")]
    pub renew: u64,
}

fn often() -> u64 {
    20
}

/// Where the membrane is: part of the state, since it depends on when it was made.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Skin {
    /// Three grains each, wound so that the right-hand normal points outwards.
    pub triangles: Vec<[u32; 3]>,
    /// The step before which it was made.
    pub made_at_step: Option<u64>,
}

impl Skin {
    /// Adds what a stress [Pa] does to the grains to their forces [N].
    pub fn press(&self, stress: f64, grains: &Grains, forces: &mut [DVec3]) {
        for triangle in &self.triangles {
            let force = -stress / 3.0 * areas(grains, triangle);
            triangle.iter().for_each(|&k| forces[k as usize] += force);
        }
    }

    /// Area of the membrane [m²] and volume inside it [m³].
    pub fn area_and_volume(&self, grains: &Grains) -> [f64; 2] {
        let Some(first) = self.triangles.first() else { return [0.0; 2] };
        let origin = grains.position[first[0] as usize];
        let (mut area, mut volume) = (0.0, 0.0);
        for triangle in &self.triangles {
            let a = areas(grains, triangle);
            area += a.length();
            volume += a.dot(grains.position[triangle[0] as usize] - origin) / 3.0;
        }
        [area, volume]
    }
}

/// The area of a triangle along its normal [m²].
fn areas(grains: &Grains, triangle: &[u32; 3]) -> DVec3 {
    let [a, b, c] = triangle.map(|k| grains.position[k as usize]);
    0.5 * (b - a).cross(c - a)
}

/// Adds the stress of the membrane to the loads, after having found the outer grains where that is due.
///
/// # Errors
/// When the grains cannot be triangulated, in a sentence.
pub fn add(loads: &mut Loads, state: &mut State, model: &Model) -> Result<(), String> {
    let Some(membrane) = &model.membrane else {
        state.domain.skin = Skin::default();
        return Ok(());
    };
    let (grains, skin) = (&state.grains, &mut state.domain.skin);
    if skin.made_at_step.is_none_or(|made| state.step - made >= membrane.renew) {
        let mean = grains.radius.iter().sum::<f64>() / grains.len().max(1) as f64;
        let triangulation = Triangulation::new(&state.domain.cell, &grains.position, &grains.radius)
            .map_err(|e| format!("the membrane cannot be found: {e}"))?;
        skin.triangles = outside(&triangulation, grains, membrane.probe.unwrap_or(PROBE * mean));
        skin.made_at_step = Some(state.step);
    }
    skin.press(membrane.stress.at(state.time - model.stage_start), grains, &mut loads.force);
    Ok(())
}

/// The triangles between what is inside and what the outside reaches.
fn outside(triangulation: &Triangulation, grains: &Grains, probe: f64) -> Vec<[u32; 3]> {
    let Triangulation { pores, neighbours, .. } = triangulation;
    let small = |pore: &[u32; 4]| {
        pore.iter().all(|&v| wall(v).is_none()) && power(pore.map(|v| v as usize), grains) <= probe * probe
    };
    let inside: Vec<bool> = pores.iter().map(small).collect();
    let mut reached: Vec<bool> = pores.iter().map(|pore| pore.iter().any(|&v| wall(v).is_some())).collect();
    let mut open: Vec<usize> = (0..pores.len()).filter(|&pore| reached[pore]).collect();
    let mut triangles = Vec::new();
    while let Some(pore) = open.pop() {
        for &next in neighbours[pore].iter().filter(|&&next| next != NONE) {
            let next = next as usize;
            if !inside[next] && !std::mem::replace(&mut reached[next], true) {
                open.push(next);
            }
        }
    }
    for (pore, vertices) in pores.iter().enumerate().filter(|(pore, _)| inside[*pore]) {
        for (facet, &next) in FACET.iter().zip(&neighbours[pore]) {
            if next != NONE && reached[next as usize] {
                triangles.push(facet.map(|k| vertices[k]));
            }
        }
    }
    triangles
}

/// Squared radius of the sphere that meets four grains at right angles [m²]; negative where they overlap that much,
/// infinite where they lie in a plane.
fn power(pore: [usize; 4], grains: &Grains) -> f64 {
    let [a, b, c, d] = pore.map(|k| grains.position[k]);
    let edges = DMat3::from_cols(b - a, c - a, d - a);
    let square = |k: usize| grains.radius[k] * grains.radius[k];
    let side = |k: usize, edge: DVec3| 0.5 * (edge.length_squared() - square(pore[k]) + square(pore[0]));
    let right = DVec3::new(side(1, edges.x_axis), side(2, edges.y_axis), side(3, edges.z_axis));
    let volume = edges.determinant();
    let scale = edges.x_axis.length() * edges.y_axis.length() * edges.z_axis.length();
    if volume.abs() <= 1e-12 * scale {
        return f64::INFINITY;
    }
    let centre = edges.transpose().inverse() * right;
    centre.length_squared() - square(pore[0])
}

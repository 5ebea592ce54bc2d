//! What can be said of single grains: porosity around them, displacement and strain.

use crate::grains::Shape;
use crate::state::State;
use glam::{DMat3, DVec3};
use porograin_geometry::throat::{Packing, radical_centres};
use porograin_geometry::triangulation::{Triangulation, wall};
use porograin_geometry::voronoi::voronoi;

/// Where the grains are, in order of their [id](crate::Grains::id), as if none had ever been taken back into a periodic
/// cell [m].
pub fn places(state: &State) -> Vec<DVec3> {
    let grains = &state.grains;
    let last = grains.id.iter().max().map_or(0, |&id| id as usize + 1);
    let mut places = vec![DVec3::ZERO; last];
    for (k, &x) in grains.position.iter().enumerate() {
        places[grains.id[k] as usize] = state.domain.unwrapped(k, x);
    }
    places
}

/// How far each grain has moved from its place in `from`, [places] of an earlier state [m]; zero for grains that came later.
pub fn displacement(state: &State, from: &[DVec3]) -> Vec<DVec3> {
    let of = |(k, &x): (usize, &DVec3)| {
        let before = from.get(state.grains.id[k] as usize);
        before.map_or(DVec3::ZERO, |&before| state.domain.unwrapped(k, x) - before)
    };
    state.grains.position.iter().enumerate().map(of).collect()
}

/// What the triangulation tells of each grain.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Local {
    /// Void part of each grain's power cell [-]; 0 for a grain that has none.
    pub porosity: Vec<f64>,
    /// Mean gradient of the displacement around each grain [-], row: the displacement's direction.
    pub gradient: Vec<DMat3>,
}

/// Porosity by power (Voronoi) cells, and the gradient of `displacement` [m] around each grain; `None` for discs and where
/// there is no triangulation.
///
/// The gradient is the mean over the tetrahedra of grains that meet at the grain, weighted by their volumes: by the divergence
/// theorem `1/V ∮ u ⊗ n dA` over the surface of their union, the polyhedron of the grain's neighbours, u linear on its
/// triangles (Catalano 2.20-2.21, corrected). In a periodic cell the images of grains have moved with the periods since `displacement`
/// began with the stage. Tetrahedra at walls have no say; a grain without any other gets zero.
pub fn local(state: &State, displacement: &[DVec3]) -> Option<Local> {
    let grains = &state.grains;
    if grains.shape != Shape::Sphere {
        return None;
    }
    let cell = &state.domain.cell;
    let mesh = Triangulation::new(cell, &grains.position, &grains.radius).ok()?;
    let packing = Packing { cell, position: &grains.position, radius: &grains.radius };
    let volume = voronoi(packing, &mesh, &radical_centres(packing, &mesh)).volume;
    let void = |(k, &volume): (usize, &f64)| {
        if volume > 0.0 { 1.0 - grains.shape.volume(grains.radius[k]) / volume } else { 0.0 }
    };
    let porosity = volume.iter().enumerate().map(void).collect();
    // An image has moved with its grain and with the periods between them.
    let edges = cell.edges.inverse();
    let image = |k: usize, place: DVec3| {
        if !state.domain.is_periodic() {
            return DVec3::ZERO;
        }
        let crossed = state.domain.crossed.get(k).copied().unwrap_or_default();
        let periods = (edges * (place - grains.position[k])).round() - DVec3::from(crossed.map(f64::from));
        (cell.edges - state.domain.reference) * periods
    };
    let mut gradient = vec![DMat3::ZERO; grains.len()];
    let mut weight = vec![0.0; grains.len()];
    for (pore, vertices) in mesh.pores.iter().enumerate() {
        if vertices.iter().any(|&v| wall(v).is_some()) {
            continue;
        }
        let x = [0, 1, 2, 3].map(|k| packing.point(&mesh, pore, k).unwrap_or_default());
        let u = [0, 1, 2, 3].map(|k| {
            let grain = vertices[k] as usize;
            displacement[grain] + image(grain, x[k])
        });
        let edges = DMat3::from_cols(x[1] - x[0], x[2] - x[0], x[3] - x[0]);
        let size = edges.determinant().abs() / 6.0;
        if size <= 0.0 {
            continue;
        }
        let changes = DMat3::from_cols(u[1] - u[0], u[2] - u[0], u[3] - u[0]);
        let own = changes * edges.inverse() * size;
        for &v in vertices {
            gradient[v as usize] += own;
            weight[v as usize] += size;
        }
    }
    for (gradient, weight) in gradient.iter_mut().zip(weight) {
        if weight > 0.0 {
            *gradient *= 1.0 / weight;
        }
    }
    Some(Local { porosity, gradient })
}

/// Deviator of a strain [-], `sqrt(2/3 e:e)`, e the deviatoric part of the symmetric part of a displacement gradient: in
/// triaxial compression two thirds of the difference of axial and radial strain.
pub fn strain_deviator(gradient: DMat3) -> f64 {
    let e = 0.5 * (gradient + gradient.transpose());
    let mean = (e.x_axis.x + e.y_axis.y + e.z_axis.z) / 3.0;
    let e = e - DMat3::from_diagonal(DVec3::splat(mean));
    let square = e.x_axis.length_squared() + e.y_axis.length_squared() + e.z_axis.length_squared();
    (square / 1.5).sqrt()
}

//! The thesis' coupling, for comparison: the flow answers the volume rates of the tetrahedra, while the forces are shared
//! by wetted surface and turn nothing (Catalano 3.10-3.14, 4.4). The two are not transposes of each other, so the water
//! can give the grains energy: see the tests of the implicit step.

use super::conductance::{Conductance, Passage};
use super::coupling::Push;
use super::images;
use super::mesh::{Mesh, Walls, between};
use super::pushes::Pushes;
use glam::{DMat3, DVec3};
use porograin_geometry::gradient::pore_volume_gradient;
use porograin_geometry::throat::{Packing, radical_centres, shape, throats};
use porograin_geometry::triangulation::FACET;

/// Replaces the coupling of a mesh.
pub fn couple(mesh: &mut Mesh, packing: Packing, walls: &Walls, conductance: Conductance) {
    let pores = mesh.triangulation.pores.len();
    let mut push = vec![[Push::default(); 4]; pores];
    if let Some(images) = &mut mesh.images {
        images.stretch.fill(DMat3::ZERO);
        images.wall_drag.clear();
    }
    mesh.wall_faces.clear();
    let centres = radical_centres(packing, &mesh.triangulation);
    let mut closing = vec![DVec3::ZERO; pores];
    for throat in throats(&mesh.triangulation) {
        let shape = shape(packing, &mesh.triangulation, &centres, &throat);
        let passage = Passage::new(packing, &mesh.triangulation, &centres, &throat, &shape, &walls.slip);
        let share = conductance.shares(&passage);
        let [i, j] = throat.pores.map(|pore| pore as usize);
        let slots = throat.slots(&mesh.triangulation);
        let mut forces = [DVec3::ZERO; 3];
        for (k, &slot) in FACET[throat.facet as usize].iter().enumerate() {
            let force = (shape.covered[k] + shape.fluid_area * share[k]) * shape.normal;
            push[i][slot] += Push::new(force, DVec3::ZERO);
            push[j][slots[k]] -= Push::new(force, DVec3::ZERO);
            forces[k] = force;
        }
        if let Some(images) = &mut mesh.images {
            let points = FACET[throat.facet as usize].map(|m| packing.point(&mesh.triangulation, i, m));
            let points = points.map(|x| x.unwrap_or(shape.centroid) - packing.cell.origin);
            let both = images::stretch(forces, points, packing.cell.shift(throat.shift));
            images.stretch[i] += both[0];
            images.stretch[j] += both[1];
            let away = between(throat.shift, images.frame[i], images.frame[j]);
            images.add_wall_drag(throat.vertices, forces, away);
        }
        closing[i] += shape.area * shape.normal;
        closing[j] -= shape.area * shape.normal;
    }
    mesh.add_wall_faces(0, &closing, &mut push);
    mesh.push = Pushes::new(&push);
    let gradient = |pore| {
        pore_volume_gradient(packing, &mesh.triangulation, pore).map(|force| Push::new(force, DVec3::ZERO))
    };
    let rates: Vec<[Push; 4]> = (0..pores).map(gradient).collect();
    mesh.volume_rate = Some(Pushes::new(&rates));
}

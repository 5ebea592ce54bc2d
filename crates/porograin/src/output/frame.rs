//! One instant for ParaView.

use super::vtk::{self, Field, PoreMesh, Shape, Values};
use crate::grains::Loads;
use crate::watch::Snapshot;
use glam::DVec3;
use porograin_geometry::throat::Packing;
use porograin_geometry::triangulation::wall;

/// The grains, in order of their id.
pub fn grains(now: &Snapshot) -> Vec<u8> {
    let grains = &now.state.grains;
    let mut order: Vec<usize> = (0..grains.len()).collect();
    order.sort_by_key(|&i| grains.id[i]);
    let vectors = |values: &[DVec3]| -> Vec<DVec3> {
        order.iter().map(|&i| values.get(i).copied().unwrap_or_default()).collect()
    };
    let radius: Vec<f64> = order.iter().map(|&i| grains.radius[i]).collect();
    let id: Vec<u32> = order.iter().map(|&i| grains.id[i]).collect();
    let (velocity, spin) = (vectors(&grains.velocity), vectors(&grains.spin));
    let force = vectors(&now.loads.force);
    let mut water = Loads::default();
    water.clear(grains.len());
    if let Some((mesh, pressure)) = now.water() {
        mesh.add_loads(pressure, &mut water);
    }
    let fluid_force = vectors(&water.force);
    vtk::points(
        &vectors(&grains.position),
        &[
            Field { name: "id", values: Values::Integers(&id) },
            Field { name: "radius [m]", values: Values::Scalars(&radius) },
            Field { name: "velocity [m/s]", values: Values::Vectors(&velocity) },
            Field { name: "spin [rad/s]", values: Values::Vectors(&spin) },
            Field { name: "fluid force [N]", values: Values::Vectors(&fluid_force) },
            Field { name: "resultant [N]", values: Values::Vectors(&force) },
        ],
    )
}

/// The pores with their pressure: tetrahedra, and at the walls wedges and boxes; `None` in a dry stage.
pub fn pores(now: &Snapshot) -> Option<PoreMesh> {
    let (mesh, pressure) = now.water()?;
    let cell = &now.state.domain.cell;
    let packing = Packing { cell, position: &now.state.grains.position, radius: &now.state.grains.radius };
    let mut drawn = PoreMesh { points: packing.position.to_vec(), ..PoreMesh::default() };
    let onto = |mut x: DVec3, faces: &[usize]| {
        for &face in faces {
            x[face / 2] = cell.wall_position(face);
        }
        x
    };
    for vertices in &mesh.triangulation.pores {
        let grains: Vec<u32> = vertices.iter().copied().filter(|&v| wall(v).is_none()).collect();
        let faces: Vec<usize> = vertices.iter().filter_map(|&v| wall(v)).collect();
        let mut corner = |grain: u32, faces: &[usize]| {
            drawn.points.push(onto(packing.position[grain as usize], faces));
            drawn.points.len() as u32 - 1
        };
        let (shape, corners) = match (&grains[..], &faces[..]) {
            ([a, b, c], [f]) => {
                (Shape::Wedge, vec![*a, *b, *c, corner(*a, &[*f]), corner(*b, &[*f]), corner(*c, &[*f])])
            }
            ([a, b], [f, g]) => {
                let mut end = |x: u32| [x, corner(x, &[*f]), corner(x, &[*f, *g]), corner(x, &[*g])];
                (Shape::Hexahedron, [end(*a), end(*b)].concat())
            }
            ([a], [f, g, h]) => {
                let bottom = [*a, corner(*a, &[*f]), corner(*a, &[*f, *g]), corner(*a, &[*g])];
                let top = [&[*h][..], &[*f, *h], &[*f, *g, *h], &[*g, *h]].map(|faces| corner(*a, faces));
                (Shape::Hexahedron, [bottom, top].concat())
            }
            _ => (Shape::Tetrahedron, grains),
        };
        drawn.shapes.push(shape);
        drawn.corners.extend(corners);
    }
    let of_pore = |values: &[f64]| mesh.node.iter().map(|&node| values[node as usize]).collect();
    drawn.scalars.push(("pressure [Pa]".into(), of_pore(pressure)));
    Some(drawn)
}

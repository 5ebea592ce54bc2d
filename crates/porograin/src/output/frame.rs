//! One instant for ParaView.

use super::vtk::{self, Cells, Field, PoreMesh, Shape, Values};
use crate::darcy::{self, Grid};
use crate::grains::Loads;
use crate::measure::{self, Site};
use crate::pores::Mesh;
use crate::watch::Snapshot;
use glam::{DMat3, DVec3};
use porograin_geometry::Cell;
use porograin_geometry::throat::corners;
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
    let whole = |values: &dyn Fn(usize) -> u32| -> Vec<u32> { order.iter().map(|&i| values(i)).collect() };
    let (touching, carrying) = (measure::contacts_of_grains(now.state), measure::carrying(now.state));
    let contacts = whole(&|i| touching[i]);
    let carries = whole(&|i| u32::from(carrying[i]));
    let material = whole(&|i| u32::from(grains.material[i]));
    let (velocity, spin) = (vectors(&grains.velocity), vectors(&grains.spin));
    let force = vectors(&now.loads.force);
    let mut water = Loads::default();
    water.clear(grains.len());
    if let Some((mesh, pressure)) = now.pores() {
        mesh.add_loads(pressure, &mut water);
    }
    if let Some((grid, pressure)) = now.grid() {
        water.force = darcy::pressure::force(grid, pressure).0;
    }
    let fluid_force = vectors(&water.force);
    let fluid_velocity = around_grains(now).map(|around| vectors(&around)).unwrap_or_default();
    let stress = measure::grain_stress(now.state, now.model);
    let deviator: Vec<f64> = order.iter().map(|&i| measure::invariants(stress[i])[1]).collect();
    let stress: Vec<[f64; 6]> = order.iter().map(|&i| symmetric(stress[i])).collect();
    let moved = measure::displacement(now.state, now.places);
    let displacement = vectors(&moved);
    let local = measure::local(now.state, &moved).unwrap_or_default();
    let porosity: Vec<f64> = order.iter().filter_map(|&i| local.porosity.get(i).copied()).collect();
    let gradient: Vec<DMat3> = order.iter().filter_map(|&i| local.gradient.get(i).copied()).collect();
    let strain: Vec<[f64; 6]> = gradient.iter().map(|&g| symmetric(g)).collect();
    let shear: Vec<f64> = gradient.iter().map(|&g| measure::strain_deviator(g)).collect();
    // What could not be found is left out.
    fn some(field: Field<'_>, there: bool) -> Option<Field<'_>> {
        there.then_some(field)
    }
    let fields = [
        some(Field { name: "porosity [-]", values: Values::Scalars(&porosity) }, !porosity.is_empty()),
        some(Field { name: "strain [-]", values: Values::Tensors(&strain) }, !strain.is_empty()),
        some(Field { name: "strain deviator [-]", values: Values::Scalars(&shear) }, !shear.is_empty()),
        some(
            Field { name: "fluid velocity [m/s]", values: Values::Vectors(&fluid_velocity) },
            !fluid_velocity.is_empty(),
        ),
    ];
    let always = [
        Field { name: "displacement [m]", values: Values::Vectors(&displacement) },
        Field { name: "stress deviator [Pa]", values: Values::Scalars(&deviator) },
        Field { name: "id", values: Values::Integers(&id) },
        Field { name: "material", values: Values::Integers(&material) },
        Field { name: "contacts", values: Values::Integers(&contacts) },
        Field { name: "carries load", values: Values::Integers(&carries) },
        Field { name: "radius [m]", values: Values::Scalars(&radius) },
        Field { name: "velocity [m/s]", values: Values::Vectors(&velocity) },
        Field { name: "spin [rad/s]", values: Values::Vectors(&spin) },
        Field { name: "fluid force [N]", values: Values::Vectors(&fluid_force) },
        Field { name: "stress [Pa]", values: Values::Tensors(&stress) },
        Field { name: "resultant [N]", values: Values::Vectors(&force) },
    ];
    let all: Vec<Field> = always.into_iter().chain(fields.into_iter().flatten()).collect();
    vtk::points(&vectors(&grains.position), &all)
}

/// The contacts as lines, from the centre of the first grain to that of the image of the second that it touches, or to the contact point at a
/// wall, with their forces: as a vector on the second, its part along the line (positive where it presses) and the size of that across it.
pub fn contacts(now: &Snapshot) -> Vec<u8> {
    let (mut points, mut force, mut normal, mut tangential, mut overlap) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for ([first, second], touch, on_first) in measure::contact_forces(now.state, now.model) {
        let from = now.state.grains.position[first as usize];
        let [near, far] = touch.levers();
        let branch = if wall(second).is_some() { near } else { near + far };
        points.extend([from, from + branch * touch.normal]);
        let along = -on_first.dot(touch.normal);
        normal.push(along);
        tangential.push((on_first + along * touch.normal).length());
        force.push(-on_first);
        overlap.push(touch.overlap);
    }
    vtk::cells(
        Cells::Lines,
        &points,
        (0..normal.len()).map(|k| 2 * k + 2),
        &[
            Field { name: "force [N]", values: Values::Vectors(&force) },
            Field { name: "normal force [N]", values: Values::Scalars(&normal) },
            Field { name: "tangential force [N]", values: Values::Scalars(&tangential) },
            Field { name: "overlap [m]", values: Values::Scalars(&overlap) },
        ],
    )
}

/// The walls that the case adds, where they are now; `None` when there are none.
pub fn walls(now: &Snapshot) -> Option<Vec<u8>> {
    let (walls, domain) = (&now.model.walls, &now.state.domain);
    let middle = 0.5 * (domain.cell.origin + domain.cell.upper());
    let extent = middle.distance(domain.cell.origin);
    let (mut triangles, mut number, mut velocity) = (Vec::new(), Vec::new(), Vec::new());
    for (k, (wall, place)) in walls.iter().zip(&domain.walls).enumerate().filter(|(_, w)| w.0.present) {
        let centre = place.forth(wall.shape.centre());
        for corners in wall.shape.drawn(place.back(middle), extent) {
            let corners = corners.map(|x| place.forth(x));
            let x = corners.iter().sum::<DVec3>() / 3.0;
            triangles.push(corners);
            number.push(k as u32);
            velocity.push(place.velocity + place.spin.cross(x - centre));
        }
    }
    (!walls.is_empty()).then(|| {
        vtk::surface(
            &triangles,
            &[
                Field { name: "wall", values: Values::Integers(&number) },
                Field { name: "velocity [m/s]", values: Values::Vectors(&velocity) },
            ],
        )
    })
}

/// The membrane with the stress it presses with; `None` where there is none.
pub fn membrane(now: &Snapshot) -> Option<Vec<u8>> {
    let (membrane, skin) = (now.model.membrane.as_ref()?, &now.state.domain.skin);
    let corner = |&grain: &u32| now.state.grains.position[grain as usize];
    let triangles: Vec<[DVec3; 3]> = skin.triangles.iter().map(|t| t.each_ref().map(corner)).collect();
    let stress = membrane.stress.at(now.state.time - now.model.stage_start);
    let stress = vec![stress; triangles.len()];
    Some(vtk::surface(&triangles, &[Field { name: "stress [Pa]", values: Values::Scalars(&stress) }]))
}

/// The symmetric part as xx, yy, zz, xy, yz, xz.
fn symmetric(s: DMat3) -> [f64; 6] {
    let (x, y, z) = (s.x_axis, s.y_axis, s.z_axis);
    [x.x, y.y, z.z, 0.5 * (x.y + y.x), 0.5 * (y.z + z.y), 0.5 * (x.z + z.x)]
}

/// The pores with their pressure; `None` in a dry stage.
pub fn pores(now: &Snapshot) -> Option<PoreMesh> {
    let (mesh, pressure) = now.pores()?;
    let beside = now.beside()?;
    let mut drawn = pore_mesh(mesh, &beside.position, &beside.cell, pressure);
    let (velocity, _) = flow(now)?;
    drawn.vectors.push(("velocity [m/s]".into(), velocity));
    Some(drawn)
}

/// Velocity of the water in each pore, and around each grain where it is named now [m/s].
fn flow(now: &Snapshot) -> Option<(Vec<DVec3>, Vec<DVec3>)> {
    let (beside, mut room) = (now.beside()?, Vec::new());
    let site = now.site(&beside)?;
    let flow = now.pore_flow(&site)?;
    let walk = now.walk(&beside, &mut room);
    let velocity = flow.velocity(&site, &walk);
    let mut around = flow.around_grains(&site, &walk, &velocity);
    for ((around, &there), &here) in around.iter_mut().zip(&*beside.position).zip(&now.state.grains.position)
    {
        *around -= walk.gradient * (there - here);
    }
    Some((velocity, around))
}

/// Velocity of the water around each grain, on a grid at its centre [m/s]; `None` in a dry stage.
fn around_grains(now: &Snapshot) -> Option<Vec<DVec3>> {
    let Some(coarse) = now.coarse_flow() else { return Some(flow(now)?.1) };
    let grains = &now.state.grains;
    let of = |(&x, &own): (&DVec3, &DVec3)| coarse.at(x).map_or(own, |found| found.velocity);
    Some(grains.position.iter().zip(&grains.velocity).map(of).collect())
}

/// The throats and the Voronoi edges, as two files; `None` without pores.
pub fn network(now: &Snapshot) -> Option<[Vec<u8>; 2]> {
    let beside = now.beside()?;
    let site = now.site(&beside)?;
    let (flux, _) = now.water.flows(now.state)?;
    Some([throats(&site, &flux), edges(&site, &flux)])
}

/// The throats as polygons, each beside its first pore: triangles, and at walls the quadrilaterals down to them. `flux` is that through
/// each link, from the first pore, at the back of the polygon, to the second [m³/s]. Throats inside of a node carry nothing that is
/// known, and are left out.
pub fn throats(site: &Site, flux: &[f64]) -> Vec<u8> {
    let (mut points, mut ends, mut through) = (Vec::new(), Vec::new(), Through::default());
    for (throat, link) in site.mesh.throats() {
        let Some(link) = link else { continue };
        let (corners, count) = corners(site.packing, &site.mesh.triangulation, &throat);
        points.extend(&corners[..count]);
        ends.push(points.len());
        through.add(site, flux, link);
    }
    vtk::cells(Cells::Polygons, &points, ends.into_iter(), &through.fields())
}

/// The Voronoi edges as lines, from the radical centre of the first pore of each throat to that of the second, in one piece also where it
/// crosses the period.
pub fn edges(site: &Site, flux: &[f64]) -> Vec<u8> {
    let (mut points, mut through) = (Vec::new(), Through::default());
    for (throat, link) in site.mesh.throats() {
        let Some(link) = link else { continue };
        let [from, to] = throat.pores.map(|pore| site.centre[pore as usize]);
        points.extend([from, to + site.packing.cell.shift(throat.shift)]);
        through.add(site, flux, link);
    }
    vtk::cells(Cells::Lines, &points, (0..points.len() / 2).map(|k| 2 * k + 2), &through.fields())
}

/// What goes with each link.
#[derive(Default)]
struct Through {
    flux: Vec<f64>,
    conductance: Vec<f64>,
}

impl Through {
    fn add(&mut self, site: &Site, flux: &[f64], link: usize) {
        self.flux.push(flux[link]);
        self.conductance.push(site.mesh.conductance[link]);
    }

    fn fields(&self) -> [Field<'_>; 2] {
        [
            Field { name: "flux [m3/s]", values: Values::Scalars(&self.flux) },
            Field { name: "conductance [m3/(Pa s)]", values: Values::Scalars(&self.conductance) },
        ]
    }
}

/// The grid with pressure, velocity of the water, porosity and permeability of its cells; `None` without coarse water.
pub fn grid(now: &Snapshot) -> Option<PoreMesh> {
    let (grid, pressure) = now.grid()?;
    let mut drawn = grid_mesh(grid, pressure, now.state.grid()?.viscosity);
    drawn.vectors.push(("velocity [m/s]".into(), now.coarse_flow()?.in_cells()));
    Some(drawn)
}

fn grid_mesh(grid: &Grid, pressure: &[f64], viscosity: f64) -> PoreMesh {
    let mut drawn = PoreMesh::default();
    let [x, y, z] = &grid.planes;
    for &z in z {
        for &y in y {
            drawn.points.extend(x.iter().map(|&x| DVec3::new(x, y, z)));
        }
    }
    let [nx, ny, _] = grid.count;
    let cells = grid.census.cells;
    for [x, y, z] in (0..cells).map(|cell| grid.place(cell)) {
        let corner = |dx, dy, dz| (((z + dz) * (ny + 1) + y + dy) * (nx + 1) + x + dx) as u32;
        drawn.shapes.push(Shape::Hexahedron);
        for dz in 0..2 {
            drawn.corners.extend([corner(0, 0, dz), corner(1, 0, dz), corner(1, 1, dz), corner(0, 1, dz)]);
        }
    }
    let permeability: Vec<f64> = grid.mobility.iter().map(|m| m.z * viscosity).collect();
    drawn.scalars = vec![
        ("pressure [Pa]".into(), pressure[..cells].to_vec()),
        ("porosity [-]".into(), grid.porosity.clone()),
        ("permeability along z [m2]".into(), permeability),
    ];
    drawn
}

/// Pores as cells: tetrahedra, and at the walls wedges and boxes. `pressure` has one entry per node of the mesh [Pa].
///
/// Every pore of a periodic cell is drawn once, in one piece: some stick out of the cell.
pub fn pore_mesh(mesh: &Mesh, position: &[DVec3], cell: &Cell, pressure: &[f64]) -> PoreMesh {
    let mut drawn = PoreMesh { points: position.to_vec(), ..PoreMesh::default() };
    let onto = |mut x: DVec3, faces: &[usize]| {
        for &face in faces {
            x[face / 2] = cell.wall_position(face);
        }
        x
    };
    for (pore, vertices) in mesh.triangulation.pores.iter().enumerate() {
        let mut grains = Vec::with_capacity(4);
        for (k, &vertex) in vertices.iter().enumerate().filter(|&(_, &v)| wall(v).is_none()) {
            match mesh.triangulation.shifts.get(pore).map_or([0; 3], |shifts| shifts[k]) {
                [0, 0, 0] => grains.push(vertex),
                shift => {
                    grains.push(drawn.points.len() as u32);
                    drawn.points.push(position[vertex as usize] + cell.shift(shift));
                }
            }
        }
        let faces: Vec<usize> = vertices.iter().filter_map(|&v| wall(v)).collect();
        let mut corner = |grain: u32, faces: &[usize]| {
            let below = onto(drawn.points[grain as usize], faces);
            drawn.points.push(below);
            drawn.points.len() as u32 - 1
        };
        let (shape, mut corners) = match (&grains[..], &faces[..]) {
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
        // VTK counts a volume as positive when its first face, seen from the opposite one, turns left.
        let at = |k: usize| drawn.points[corners[k] as usize];
        let side = corners.len() / 2;
        let normal = (at(1) - at(0)).cross(at(side - 1) - at(0));
        if shape != Shape::Tetrahedron && normal.dot(at(side) - at(0)) < 0.0 {
            corners.rotate_left(side);
        }
        drawn.shapes.push(shape);
        drawn.corners.extend(corners);
    }
    let of_pore = |values: &[f64]| mesh.node.iter().map(|&node| values[node as usize]).collect();
    drawn.scalars.push(("pressure [Pa]".into(), of_pore(pressure)));
    drawn
}

#[cfg(test)]
mod tests {
    use super::{Mesh, Shape, pore_mesh};
    use crate::boundary::Slip;
    use crate::pores::{Conductance, Walls};
    use glam::DVec3;
    use porograin_geometry::Cell;
    use porograin_geometry::throat::Packing;

    #[test]
    fn cells_fill_the_box_and_none_is_inside_out() {
        // A lattice shaken by a fixed rule, so that no four grains lie in a plane.
        let (mut position, mut shake) = (Vec::new(), 0.3_f64);
        for k in 0..27 {
            let place = DVec3::new((k % 3) as f64, (k / 3 % 3) as f64, (k / 9) as f64) + 0.5;
            let mut next = || {
                shake = (shake * 97.0 + 0.137).fract();
                0.2 * (shake - 0.5)
            };
            position.push(place + DVec3::new(next(), next(), next()));
        }
        let radius = vec![0.35; position.len()];
        let cell = Cell::walled(DVec3::ZERO, DVec3::splat(3.0));
        let packing = Packing { cell: &cell, position: &position, radius: &radius };
        let walls = Walls { open: [false, false, false, false, true, true], slip: [Slip::Symmetry; 6] };
        let mesh = Mesh::new(packing, &walls, Conductance::hydraulic_radius(), 1.0).unwrap();
        let drawn = pore_mesh(&mesh, &position, &cell, &vec![0.0; mesh.nodes()]);
        let mut corners = drawn.corners.iter().map(|&c| drawn.points[c as usize]);
        let mut sum = 0.0;
        for shape in &drawn.shapes {
            let tetrahedron = |[a, b, c, d]: [DVec3; 4]| (b - a).cross(c - a).dot(d - a) / 6.0;
            let wedge = |[a, b, c, d, e, f]: [DVec3; 6]| {
                [[a, b, c, d], [b, d, e, c], [c, d, e, f]].map(tetrahedron).map(f64::abs).iter().sum::<f64>()
            };
            let mut next = || corners.next().unwrap();
            let (volume, upright) = match shape {
                Shape::Tetrahedron => {
                    let volume = tetrahedron([next(), next(), next(), next()]);
                    (volume, volume)
                }
                Shape::Wedge => {
                    let c: [DVec3; 6] = std::array::from_fn(|_| next());
                    (wedge(c), tetrahedron([c[0], c[1], c[2], c[3]]))
                }
                Shape::Hexahedron => {
                    let [a, b, c, d, e, f, g, h] = std::array::from_fn(|_| next());
                    (wedge([a, b, c, e, f, g]) + wedge([a, c, d, e, g, h]), tetrahedron([a, b, d, e]))
                }
            };
            assert!(upright > 0.0, "a {shape:?} is inside out");
            sum += volume;
        }
        assert!((sum / 27.0 - 1.0).abs() < 1e-12, "{sum}");
    }
}

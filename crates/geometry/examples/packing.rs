//! A packing in a box: pores, throats, porosity, the loosest place. `cargo run --release -p porograin-geometry --example packing`

use glam::DVec3;
use porograin_geometry::throat::{Packing, pore_volume, radical_centres, shapes, throats};
use porograin_geometry::triangulation::wall;
use porograin_geometry::voronoi::voronoi;
use porograin_geometry::{Cell, Triangulation, order};

/// Prints what the head of this file says.
pub fn main() {
    // Spheres of two sizes on a slightly disturbed lattice, 1 m wide; numbered along a space-filling curve, so that what is
    // near in space is near in memory.
    let (m, cell) = (12, Cell::walled(DVec3::ZERO, DVec3::ONE));
    let mut state = 1u64;
    let mut dice = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    };
    let grid = |i: i32| DVec3::new(f64::from(i % m), f64::from(i / m % m), f64::from(i / m / m));
    let place: Vec<DVec3> = (0..m * m * m)
        .map(|i| (grid(i) + 0.5 + 0.1 * DVec3::new(dice(), dice(), dice())) / f64::from(m))
        .collect();
    let curve = order::hilbert(&cell, &place);
    let position: Vec<DVec3> = curve.iter().map(|&i| place[i as usize]).collect();
    let radius: Vec<f64> = curve.iter().map(|&i| if i % 3 == 0 { 0.03 } else { 0.037 }).collect();

    let mesh = Triangulation::new(&cell, &position, &radius).expect("all centres are in the box");
    let packing = Packing { cell: &cell, position: &position, radius: &radius };
    let centres = radical_centres(packing, &mesh);
    let throats = throats(&mesh);
    println!("{} grains, {} pores, {} throats", position.len(), mesh.pores.len(), throats.len());

    // Of each throat keep the void volume of its double pyramid and the area left to the water.
    let kept = shapes(packing, &mesh, &centres, &throats, |_, shape| (shape.void, shape.fluid_area));
    let void: f64 = kept.iter().map(|k| k.0).sum();
    let solid: f64 = radius.iter().map(|r| 4.0 / 3.0 * std::f64::consts::PI * r.powi(3)).sum();
    println!("porosity from the throats {void:.12}, from the grains {:.12}", 1.0 - solid);
    assert!((void - (1.0 - solid)).abs() < 1e-12);
    let narrowest = kept.iter().map(|k| k.1).fold(f64::INFINITY, f64::min);
    println!("narrowest throat {narrowest:.2e} m²");

    let pores: f64 = (0..mesh.pores.len()).map(|pore| pore_volume(packing, &mesh, pore)).sum();
    assert!((pores - 1.0).abs() < 1e-12);

    // Local porosity: the void in each grain's power cell.
    let cells = voronoi(packing, &mesh, &centres);
    let porosity = |g: usize| 1.0 - 4.0 / 3.0 * std::f64::consts::PI * radius[g].powi(3) / cells.volume[g];
    let loosest = (0..radius.len()).max_by(|&a, &b| porosity(a).total_cmp(&porosity(b))).unwrap_or(0);
    println!("loosest around grain {loosest}: porosity {:.3}; its neighbours:", porosity(loosest));
    for facet in cells.around(loosest as u32).iter().map(|&f| &cells.facets[f as usize]) {
        let other = facet.between.into_iter().find(|&v| v != loosest as u32);
        let name =
            other.map_or(String::new(), |v| wall(v).map_or(format!("grain {v}"), |f| format!("face {f}")));
        println!("  {name:12} across {:.2e} m²", facet.area.length());
    }
}

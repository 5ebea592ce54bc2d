//! How the volume of a pore changes with the positions of its vertices.

use crate::cell::NORMALS;
use crate::throat::{Packing, depth};
use crate::triangulation::{FACET, Triangulation, wall};
use glam::DVec3;

/// Derivative of [`pore_volume`](crate::throat::pore_volume) with the position of each vertex [m²].
///
/// For a grain the vector `dV/dx`; for a wall its outward normal times the change with the wall's position along it. The four
/// sum to zero (translation), and `sum_k g_k·v_k` is the rate of volume for velocities `v_k` (of a wall: any
/// vector with the right normal component).
///
/// With four grains it is minus a third of the opposite facet's outward area vector; a pore at walls is a prism,
/// `V = A (h_a + h_b + h_c)/3` over the projected triangle, `V = L (2 h_a k_a + h_a k_b + h_b k_a + 2 h_b k_b)/6` along the edge
/// of two walls, or `V = h k l` in a corner, with depths `h, k, l` below the walls.
pub fn pore_volume_gradient(packing: Packing, mesh: &Triangulation, pore: usize) -> [DVec3; 4] {
    let vertex = mesh.pores[pore];
    let point = [0, 1, 2, 3].map(|k| packing.point(mesh, pore, k));
    let mut gradient = [DVec3::ZERO; 4];
    let grains: Places = places(|k| point[k].is_some());
    let walls: Places = places(|k| point[k].is_none());
    let x = |i: usize| point[grains.at[i]].unwrap_or(DVec3::NAN);
    let normal = |j: usize| NORMALS[wall(vertex[walls.at[j]]).unwrap_or(0)];
    let h = |i: usize, j: usize| depth(packing.cell, x(i), wall(vertex[walls.at[j]]).unwrap_or(0));
    match grains.count {
        4 => {
            for k in 0..4 {
                let [a, b, c] = FACET[k].map(|j| point[j].unwrap_or(DVec3::NAN));
                gradient[k] = (b - a).cross(c - a) / -6.0;
            }
        }
        3 => {
            let n = normal(0);
            let twice = (x(1) - x(0)).cross(x(2) - x(0)).dot(n);
            let (area, sign) = (0.5 * twice.abs(), twice.signum());
            let mean = (h(0, 0) + h(1, 0) + h(2, 0)) / 3.0;
            for i in 0..3 {
                let across = (x((i + 1) % 3) - x((i + 2) % 3)).cross(n);
                gradient[grains.at[i]] = n * (-area / 3.0) + across * (0.5 * sign * mean);
            }
            gradient[walls.at[0]] = n * area;
        }
        2 => {
            let along = normal(0).cross(normal(1));
            let signed = (x(1) - x(0)).dot(along);
            let (length, sign) = (signed.abs(), signed.signum());
            let [a, b] = [0, 1].map(|i| [h(i, 0), h(i, 1)]);
            let section = (2.0 * a[0] * a[1] + a[0] * b[1] + b[0] * a[1] + 2.0 * b[0] * b[1]) / 6.0;
            for (i, own, other) in [(0, a, b), (1, b, a)] {
                let end = if i == 0 { -sign } else { sign };
                let mut g = along * (end * section);
                for j in 0..2 {
                    // dV/dh_j of this grain; its depth falls as it moves along the normal.
                    let by_depth = length * (2.0 * own[1 - j] + other[1 - j]) / 6.0;
                    g -= normal(j) * by_depth;
                    gradient[walls.at[j]] += normal(j) * by_depth;
                }
                gradient[grains.at[i]] = g;
            }
        }
        1 => {
            for j in 0..3 {
                let by_depth = h(0, (j + 1) % 3) * h(0, (j + 2) % 3);
                gradient[walls.at[j]] = normal(j) * by_depth;
                gradient[grains.at[0]] -= normal(j) * by_depth;
            }
        }
        _ => {}
    }
    gradient
}

/// Some of the places `0..4`.
struct Places {
    at: [usize; 4],
    count: usize,
}

fn places(keep: impl Fn(usize) -> bool) -> Places {
    let mut places = Places { at: [0; 4], count: 0 };
    for k in (0..4).filter(|&k| keep(k)) {
        places.at[places.count] = k;
        places.count += 1;
    }
    places
}

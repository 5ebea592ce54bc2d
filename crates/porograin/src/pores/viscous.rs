//! How fast the water damps the grains: the largest eigenvalue of `M⁻¹ V`, `V = S G⁻¹ Sᵀ`.

use super::mesh::{Carried, Mesh};
use super::pressure::System;
use crate::grains::{Grains, Loads};
use crate::motion::Velocities;
use glam::{DMat3, DVec3};
use porograin_geometry::cell::NORMALS;
use porograin_linear::Error;

/// Lanczos steps; the largest eigenvalue then stands to a few per cent on meshes of 10² to 10⁵ grains.
const STEPS: usize = 24;
/// The estimate comes from below: this covers what is missing.
const MARGIN: f64 = 1.05;

/// The largest eigenvalue of `M⁻¹ V` [1/s]: an explicit step must keep `2 dt lambda + dt² omega² < 4`
/// (`physics` §3b). `piston` is the mass of each wall that is free to move along its normal [kg], `cell` the inertia of
/// each component of a periodic cell that is free [kg m²], zero for the others.
///
/// Lanczos iteration on `M^-1/2 V M^-1/2` from a fixed start, so that the same mesh gives the same bits.
///
/// # Errors
/// Those of the pressure solve.
pub fn rate(
    mesh: &Mesh,
    system: &mut System,
    grains: &Grains,
    piston: &[Option<f64>; 6],
    cell: &DMat3,
) -> Result<f64, Error> {
    let n = grains.len();
    let size = 6 * n + 6 + 9;
    let mut root_mass = vec![0.0; size];
    for i in 0..n {
        root_mass[6 * i..6 * i + 3].fill(1.0 / grains.mass[i].sqrt());
        root_mass[6 * i + 3..6 * i + 6].fill(1.0 / grains.inertia(i).sqrt());
    }
    for face in 0..6 {
        root_mass[6 * n + face] = piston[face].map_or(0.0, |mass| 1.0 / mass.sqrt());
    }
    for (root, &inertia) in root_mass[6 * n + 6..].iter_mut().zip(cell.as_ref()) {
        *root = if inertia > 0.0 { 1.0 / inertia.sqrt() } else { 0.0 };
    }
    let mut seed = 1u64;
    let mut now: Vec<f64> = root_mass
        .iter()
        .map(|&m| {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            if m == 0.0 { 0.0 } else { (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5 }
        })
        .collect();
    let mut before = vec![0.0; size];
    let mut work = Work::default();
    let (mut diagonal, mut beside): (Vec<f64>, Vec<f64>) = (Vec::new(), Vec::new());
    let mut length = norm(&now);
    for _ in 0..STEPS {
        if length == 0.0 {
            break;
        }
        now.iter_mut().for_each(|v| *v /= length);
        let mut next = apply(mesh, system, &root_mass, &now, &mut work)?;
        let alpha: f64 = next.iter().zip(&now).map(|(a, b)| a * b).sum();
        let beta = beside.last().copied().unwrap_or(0.0);
        for k in 0..size {
            next[k] -= alpha * now[k] + beta * before[k];
        }
        diagonal.push(alpha);
        length = norm(&next);
        beside.push(length);
        before = std::mem::replace(&mut now, next);
        if length <= 1e-12 * diagonal[0].abs() {
            break;
        }
    }
    Ok(MARGIN * largest_eigenvalue(&diagonal, &beside))
}

#[derive(Default)]
struct Work {
    velocities: Velocities,
    carried: Carried,
    pressure: Vec<f64>,
    loads: Loads,
}

/// `M^-1/2 S G⁻¹ Sᵀ M^-1/2 x`.
fn apply(
    mesh: &Mesh,
    system: &mut System,
    root_mass: &[f64],
    x: &[f64],
    work: &mut Work,
) -> Result<Vec<f64>, Error> {
    let n = (x.len() - 6 - 9) / 6;
    let scaled = |k: usize| x[k] * root_mass[k];
    let three = |k: usize| DVec3::new(scaled(k), scaled(k + 1), scaled(k + 2));
    let Velocities { grain, spin, wall, cell } = &mut work.velocities;
    grain.clear();
    grain.extend((0..n).map(|i| three(6 * i)));
    spin.clear();
    spin.extend((0..n).map(|i| three(6 * i + 3)));
    *wall = std::array::from_fn(|f| NORMALS[f] * scaled(6 * n + f));
    *cell = DMat3::from_cols(three(6 * n + 6), three(6 * n + 9), three(6 * n + 12));
    mesh.carried_with_cell(&work.velocities, &mut work.carried);
    work.pressure.clear();
    work.pressure.resize(mesh.nodes(), 0.0);
    system.solve(mesh, &work.carried.node, &mut work.pressure)?;
    work.loads.clear(n);
    mesh.add_loads(&work.pressure, &mut work.loads);
    let mut y = vec![0.0; x.len()];
    for i in 0..n {
        y[6 * i..6 * i + 3].copy_from_slice(&work.loads.force[i].to_array());
        y[6 * i + 3..6 * i + 6].copy_from_slice(&work.loads.torque[i].to_array());
    }
    for f in 0..6 {
        y[6 * n + f] = work.loads.wall[f].dot(NORMALS[f]);
    }
    y[6 * n + 6..].copy_from_slice(work.loads.cell.as_ref());
    // Motion carries water out, which lowers the pressure, which pulls back: V = -S G⁻¹ (-Sᵀ).
    y.iter_mut().zip(root_mass).for_each(|(y, m)| *y *= -m);
    Ok(y)
}

fn norm(x: &[f64]) -> f64 {
    x.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Largest eigenvalue of the symmetric tridiagonal matrix with `diagonal` (length k) and `beside` it (length k,
/// the last unused), by bisection on the number of negative pivots.
fn largest_eigenvalue(diagonal: &[f64], beside: &[f64]) -> f64 {
    let k = diagonal.len();
    if k == 0 {
        return 0.0;
    }
    let off = |i: usize| if i + 1 < k { beside[i].abs() } else { 0.0 };
    let reach = |i: usize| off(i) + if i > 0 { off(i - 1) } else { 0.0 };
    let mut high = (0..k).map(|i| diagonal[i] + reach(i)).fold(f64::NEG_INFINITY, f64::max);
    let mut low = (0..k).map(|i| diagonal[i]).fold(f64::NEG_INFINITY, f64::max);
    let all_below = |x: f64| {
        let mut pivot = diagonal[0] - x;
        for i in 1..k {
            if pivot >= 0.0 {
                return false;
            }
            pivot = diagonal[i] - x - off(i - 1) * off(i - 1) / pivot;
        }
        pivot < 0.0
    };
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if all_below(middle) { high = middle } else { low = middle }
    }
    high
}

#[cfg(test)]
mod tests {
    use super::largest_eigenvalue;

    #[test]
    fn largest_eigenvalue_of_the_second_difference() {
        // 2 - 2 cos(k pi / (n + 1)), largest for k = n.
        let n = 9;
        let exact = 2.0 - 2.0 * (n as f64 * std::f64::consts::PI / (n + 1) as f64).cos();
        assert!((largest_eigenvalue(&vec![2.0; n], &vec![-1.0; n]) - exact).abs() < 1e-12);
    }
}

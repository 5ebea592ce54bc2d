//! Porosity, contacts per grain, settlement.

use crate::boundary::Domain;
use crate::grains::Grains;
use crate::model::Model;
use crate::state::State;
use glam::DMat3;
use porograin_geometry::triangulation::wall;

/// Void part of the box [-]; overlaps count twice as solid.
pub fn porosity(state: &State) -> f64 {
    1.0 - state.grains.volume() / state.domain.cell.volume()
}

/// Mean number of contacts per grain, those with walls included [-].
pub fn coordination(state: &State) -> f64 {
    let ends: usize = state.contacts.pairs().map(|pair| if wall(pair[1]).is_some() { 1 } else { 2 }).sum();
    ends as f64 / state.grains.len().max(1) as f64
}

/// Number of contacts of each grain.
pub fn contacts_of_grains(state: &State) -> Vec<u32> {
    let mut count = vec![0; state.grains.len()];
    for [i, j] in state.contacts.pairs() {
        count[i as usize] += 1;
        if wall(j).is_none() {
            count[j as usize] += 1;
        }
    }
    count
}

/// Fabric tensor `<n ⊗ n>` of the contacts between grains [-], its trace 1; zero without contacts.
pub fn fabric(state: &State, model: &Model) -> DMat3 {
    let between = super::contact_forces(state, model).filter(|([_, second], ..)| wall(*second).is_none());
    let (count, sum) = between.fold((0, DMat3::ZERO), |(count, sum), (_, touch, _)| {
        (count + 1, sum + super::stress::outer(touch.normal, touch.normal))
    });
    sum * f64::from(count.max(1)).recip()
}

/// Shortening of the cell along x, y and z and its loss of volume since its edges were `before` [-], positive in
/// compression; small strains of engineers, not logarithmic.
pub fn compression(before: DMat3, now: DMat3) -> [f64; 4] {
    let gradient = now * before.inverse();
    [1.0 - gradient.x_axis.x, 1.0 - gradient.y_axis.y, 1.0 - gradient.z_axis.z, 1.0 - gradient.determinant()]
}

/// Number of rattlers, the grains that carry nothing: see [`carrying`].
pub fn rattlers(state: &State) -> usize {
    carrying(state).iter().filter(|carries| !**carries).count()
}

/// Whether each grain carries load: at least three contacts with walls or with grains that carry load themselves.
pub fn carrying(state: &State) -> Vec<bool> {
    let n = state.grains.len();
    let mut holds = vec![0_u32; n];
    let mut partners = vec![Vec::new(); n];
    for [i, j] in state.contacts.pairs() {
        holds[i as usize] += 1;
        if wall(j).is_none() {
            holds[j as usize] += 1;
            partners[i as usize].push(j);
            partners[j as usize].push(i);
        }
    }
    let mut loose: Vec<usize> = (0..n).filter(|&k| holds[k] < 3).collect();
    let mut is_loose: Vec<bool> = holds.iter().map(|&h| h < 3).collect();
    let mut next = 0;
    while next < loose.len() {
        for &other in &partners[loose[next]] {
            let other = other as usize;
            holds[other] -= 1;
            if holds[other] < 3 && !is_loose[other] {
                is_loose[other] = true;
                loose.push(other);
            }
        }
        next += 1;
    }
    is_loose.iter().map(|loose| !loose).collect()
}

/// Parts of the mass at which a grading is told.
pub const PASSING: [f64; 5] = [0.1, 0.3, 0.5, 0.6, 0.9];

/// The diameter [m] that `part` of the mass of the grains is finer than; half of a grain's own mass counts as finer than itself,
/// with straight lines in between.
pub fn diameter(grains: &Grains, part: f64) -> f64 {
    let mut order: Vec<usize> = (0..grains.len()).collect();
    order.sort_by(|&a, &b| grains.radius[a].total_cmp(&grains.radius[b]));
    let total: f64 = grains.mass.iter().sum();
    let (mut finer, mut last) = (0.0, None);
    for k in order {
        let (size, middle) = (2.0 * grains.radius[k], (finer + 0.5 * grains.mass[k]) / total);
        if middle >= part {
            let (at, before) = last.unwrap_or((middle, size));
            return before + if middle > at { (size - before) * (part - at) / (middle - at) } else { 0.0 };
        }
        finer += grains.mass[k];
        last = Some((middle, size));
    }
    last.map_or(0.0, |(_, size)| size)
}

/// How far a face has moved inwards from where it was in `before` [m].
pub fn settlement(before: &Domain, now: &Domain, face: usize) -> f64 {
    let moved = now.cell.wall_position(face) - before.cell.wall_position(face);
    if face % 2 == 0 { moved } else { -moved }
}

/// Oedometric modulus [Pa] from two states at rest, along the axis of `face`: the change of its normal stress over
/// the strain between them, both positive in compression.
pub fn oedometric_modulus(before: &Domain, now: &Domain, face: usize) -> f64 {
    let axis = face / 2;
    let length = |domain: &Domain| (domain.cell.upper() - domain.cell.origin)[axis];
    let strain = 1.0 - length(now) / length(before);
    let stress = |domain: &Domain| super::wall_stress(domain)[face];
    (stress(now) - stress(before)) / strain
}

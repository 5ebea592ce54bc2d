//! Which part of each grain lies around which corner of the cells.
//!
//! The region around a corner reaches to the centres of the cells that meet there, and to the wall. A grain no larger than
//! a cell lies around at most two corners along each axis: its eight parts are one row, and what larger grains have
//! beyond these is kept apart.

use super::transfer::{Pieces, Transfer};
use crate::grains::{Grains, Shape};
use rayon::prelude::*;

/// The parts of a grain around the corners of one cell.
///
/// They are weights, so that sixteen bits do: what must balance does so because all sums take them as they are, and together (with
/// what is beyond) they are the volume of the grain in whatever way they were rounded.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub(super) struct Share {
    /// The lowest of the eight corners.
    pub first: u32,
    /// What a part of 1 stands for [m³].
    pub unit: f32,
    /// x fastest, then y.
    pub part: [u16; 8],
}

/// Parts of the volume of grains around corners.
#[derive(Clone, Debug, Default)]
pub struct Corners {
    /// Corners along each axis; discs have one along y.
    pub count: [usize; 3],
    /// Volume of grains around each corner [m³].
    pub solid: Vec<f64>,
    /// What leads from a corner to the next along each axis; 0 where there is none.
    pub stride: [usize; 3],
    /// Of each grain.
    pub(super) share: Vec<Share>,
    /// Grain, corner and part of what is beyond these, grains in rising order.
    pub(super) beyond: Vec<(u32, u32, f32)>,
    /// Where the grains around each corner start in the following lists, and the end.
    pub(super) starts: Vec<u32>,
    /// The grains around each corner in rising order, those of `beyond` last.
    pub(super) grain: Vec<u32>,
    /// Their parts.
    pub(super) part: Vec<f32>,
}

/// Grains handed to a thread at once.
const BLOCK: usize = 512;

impl Corners {
    /// Cuts every grain at the centres of the cells between the planes.
    pub fn new(grains: &Grains, transfer: Transfer, planes: &[Vec<f64>; 3]) -> Corners {
        let flat = matches!(grains.shape, Shape::Disc { .. });
        let centres: [Vec<f64>; 3] = std::array::from_fn(|axis| {
            let between = if flat && axis == 1 { &[] } else { planes[axis].as_slice() };
            between.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect()
        });
        let centres = centres.each_ref().map(Vec::as_slice);
        let count = centres.map(|centres| centres.len() + 1);
        let step = |axis: usize, stride: usize| if count[axis] > 1 { stride } else { 0 };
        let stride = [step(0, 1), step(1, count[0]), step(2, count[0] * count[1])];
        let rows: Vec<(Share, Vec<(u32, f32)>)> = (0..grains.len())
            .into_par_iter()
            .with_min_len(BLOCK)
            .map_init(Pieces::default, |pieces, k| {
                pieces.cut(transfer, grains.shape, grains.position[k].to_array(), grains.radius[k], centres);
                row(pieces, count, stride)
            })
            .collect();
        let mut corners = Corners { count, stride, ..Corners::default() };
        corners.share = rows.iter().map(|(share, _)| *share).collect();
        for (k, (_, more)) in rows.into_iter().enumerate() {
            corners.beyond.extend(more.into_iter().map(|(corner, part)| (k as u32, corner, part)));
        }
        // The passes over the grains rely on it.
        let reach = corners.rows()[3] + 2;
        assert!(corners.share.iter().all(|share| share.first as usize + reach <= corners.len()));
        corners.turn();
        corners
    }

    /// Number of corners.
    pub fn len(&self) -> usize {
        self.count.iter().product()
    }

    /// Whether there is no corner.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Lists the parts by corner.
    fn turn(&mut self) {
        let offsets = self.offsets();
        let shares = self.share.iter().enumerate().flat_map(|(k, share)| {
            let parts = offsets.iter().zip(share.part).filter(|(_, part)| *part > 0);
            parts.map(move |(offset, part)| (k as u32, share.first + *offset as u32, f32::from(part)))
        });
        let all = || shares.clone().chain(self.beyond.iter().copied());
        let mut starts = vec![0; self.len() + 1];
        all().for_each(|(_, corner, _)| starts[corner as usize + 1] += 1);
        (0..self.len()).for_each(|corner| starts[corner + 1] += starts[corner]);
        let (mut next, count) = (starts.clone(), starts[self.len()] as usize);
        let (mut grain, mut part, mut solid) = (vec![0; count], vec![0.0; count], vec![0.0; self.len()]);
        for (k, corner, share) in all() {
            let (corner, unit) = (corner as usize, self.share[k as usize].unit);
            let at = next[corner] as usize;
            (grain[at], part[at]) = (k, share);
            solid[corner] += f64::from(share) * f64::from(unit);
            next[corner] += 1;
        }
        (self.starts, self.grain, self.part, self.solid) = (starts, grain, part, solid);
    }

    /// From the lowest of eight corners to each of them.
    fn offsets(&self) -> [usize; 8] {
        let [x, y, z] = self.stride;
        std::array::from_fn(|c| (c & 1) * x + (c >> 1 & 1) * y + (c >> 2) * z)
    }

    /// Number of grains.
    pub fn grains(&self) -> usize {
        self.share.len()
    }

    /// Volume of a grain around all corners [m³].
    pub fn volume(&self, k: usize) -> f64 {
        let beyond = self.beyond.iter().filter(|(grain, ..)| *grain as usize == k);
        let Share { unit, part, .. } = self.share[k];
        let parts = part.into_iter().map(f64::from).chain(beyond.map(|(.., part)| f64::from(*part)));
        f64::from(unit) * parts.sum::<f64>()
    }

    /// From the lowest corner to the first of each pair along x.
    pub(super) fn rows(&self) -> [usize; 4] {
        let [_, y, z] = self.stride;
        [0, y, z, y + z]
    }
}

/// What all parts of a grain sum to, or nearly so.
const WHOLE: f64 = u16::MAX as f64;

/// The pieces of a grain as parts around its eight corners, and those beyond.
fn row(pieces: &Pieces, count: [usize; 3], stride: [usize; 3]) -> (Share, Vec<(u32, f32)>) {
    let lowest: [usize; 3] =
        std::array::from_fn(|axis| pieces.first[axis].min(count[axis].saturating_sub(2)));
    let number = |at: [usize; 3]| (at[0] * stride[0] + at[1] * stride[1] + at[2] * stride[2]) as u32;
    let (mut part, mut beyond) = ([0; 8], Vec::new());
    let [nx, ny, _] = pieces.count;
    let (volume, mut sum) = (pieces.volume.iter().sum::<f64>(), 0.0);
    for (i, piece) in pieces.volume.iter().enumerate() {
        let share = WHOLE * piece / volume;
        let place = [i % nx, i / nx % ny, i / nx / ny];
        let at: [usize; 3] = std::array::from_fn(|axis| pieces.first[axis] + place[axis]);
        let near: [usize; 3] = std::array::from_fn(|axis| at[axis] - lowest[axis]);
        if near.iter().all(|&step| step < 2) {
            let share = share.round();
            part[near[0] + 2 * near[1] + 4 * near[2]] = share as u16;
            sum += share;
        } else if share > 0.0 {
            beyond.push((number(at), share as f32));
            sum += f64::from(share as f32);
        }
    }
    (Share { first: number(lowest), unit: (volume / sum) as f32, part }, beyond)
}

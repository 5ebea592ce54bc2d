//! An approximate inverse of the system of the pressures: one cycle of a multigrid that stays in the cache, where a factor does not.
//!
//! Each level is a grid with half the cells along every axis that conducts well, so that columns, layers and grids that conduct
//! mainly along one axis are halved along that one first. All levels are scaled to a diagonal of 1, `x -> D^(1/2) x`, in single
//! precision: a product reads one vector and three links per cell. The correction of a cell is that of the coarse cell it
//! lies in. Coarse cells are farther apart, so that their links are about half as strong as the sum of the links between them
//! (Wesseling 1992, An Introduction to Multigrid Methods, 5.3). Polynomials of Chebyshev smooth (Adams et al. 2003, J. Comput. Phys. 188,
//! 593): they know no order of the cells, so that any number of them is worked on at once.

use super::grid::Grid;
use porograin_linear::{Preconditioner, Sums};

/// What the smoother deals with of the eigenvalues of `D⁻¹ A`, none of which is beyond 2.
const SMOOTHED: [f32; 2] = [0.5, 2.0];
/// Degree of the polynomial before and after a coarse correction. Four need two iterations to 1e-6 where three need three and two
/// need four; each iteration has products in double precision and two ways between the levels besides.
const DEGREE: usize = 4;
/// An axis is halved if its links are at least this part of the strongest.
const WEAK: f64 = 0.25;

/// The levels, the finest first.
pub struct Multigrid {
    /// All conductances are multiples of it [m³/(Pa s)].
    unit: f64,
    levels: Vec<Level>,
}

/// A wall at a cell.
#[derive(Clone, Copy, Debug)]
pub struct Held {
    /// The cell.
    pub cell: usize,
    /// Across which the wall is.
    pub axis: usize,
    /// Conductance between the two [m³/(Pa s)].
    pub g: f64,
    /// How the wall gives way [m³/(Pa s)]: not at all, or without limit where the pressure is given.
    pub give: f64,
}

impl Held {
    /// What it adds to the row sum of the cell.
    pub fn excess(&self) -> f64 {
        if self.g > 0.0 { self.g / (1.0 + self.g / self.give) } else { 0.0 }
    }
}

/// A grid.
struct Level {
    count: [usize; 3],
    /// Along which axes the next level has half the cells.
    halved: [bool; 3],
    /// What links each cell to the one before along each axis over the roots of both diagonals, 0 if nothing does; as many zeros
    /// as the stride at the end.
    link: [Vec<f32>; 3],
    /// Root of the diagonal.
    root: Vec<f32>,
    /// One over it; 0 where the diagonal is.
    inverse: Vec<f32>,
    x: Vec<f32>,
    /// What is left of the right-hand side.
    residual: Vec<f32>,
    /// The last correction, between zeros, and room for the next.
    step: [Vec<f32>; 2],
}

/// What a level is made of.
struct Coefficients {
    count: [usize; 3],
    /// Between each cell and the one before along each axis.
    link: [Vec<f64>; 3],
    held: Vec<Held>,
    storage: Vec<f64>,
    /// Of the cells along each axis [m].
    width: [Vec<f64>; 3],
}

impl Coefficients {
    /// Along which axes the next level has half the cells; none if nothing is left to be halved.
    fn halved(&self) -> [bool; 3] {
        let cells = self.storage.len();
        let strength: [f64; 3] = std::array::from_fn(|axis| {
            let links = cells - cells / self.count[axis];
            self.link[axis].iter().sum::<f64>() / links.max(1) as f64
        });
        let strongest = strength.into_iter().fold(0.0, f64::max);
        strength.map(|strength| strength > 0.0 && strength >= WEAK * strongest)
    }

    fn coarser(&self, halved: [bool; 3]) -> Coefficients {
        let width: [Vec<f64>; 3] = std::array::from_fn(|axis| {
            self.width[axis].chunks(1 + usize::from(halved[axis])).map(|cells| cells.iter().sum()).collect()
        });
        let count = width.each_ref().map(Vec::len);
        let cells = count.iter().product();
        let [nx, ny, _] = self.count;
        let place = |cell: usize| [cell % nx, cell / nx % ny, cell / nx / ny];
        let to = |at: [usize; 3]| -> [usize; 3] {
            std::array::from_fn(|axis| at[axis] >> usize::from(halved[axis]))
        };
        let number = |[x, y, z]: [usize; 3]| (z * count[1] + y) * count[0] + x;
        let mut next = Coefficients {
            count,
            link: std::array::from_fn(|_| vec![0.0; cells]),
            held: Vec::with_capacity(self.held.len()),
            storage: vec![0.0; cells],
            width,
        };
        for (cell, storage) in self.storage.iter().enumerate() {
            let at = place(cell);
            let parent = to(at);
            next.storage[number(parent)] += storage;
            for axis in 0..3 {
                let (fine, coarse) = (at[axis], parent[axis]);
                // Other links are at the wall or within a coarse cell.
                if fine > 0 && !(halved[axis] && fine % 2 == 1) {
                    let apart = |width: &[f64], last: usize| width[last - 1] + width[last];
                    let part = apart(&self.width[axis], fine) / apart(&next.width[axis], coarse);
                    next.link[axis][number(parent)] += part * self.link[axis][cell];
                }
            }
        }
        for held in &self.held {
            let at = place(held.cell);
            let (parent, axis) = (to(at), held.axis);
            let part = self.width[axis][at[axis]] / next.width[axis][parent[axis]];
            next.held.push(Held { cell: number(parent), g: part * held.g, ..*held });
        }
        next
    }
}

impl Level {
    fn new(of: &Coefficients, halved: [bool; 3]) -> Level {
        let [nx, ny, _] = of.count;
        let stride = [1, nx, nx * ny];
        let cells = of.storage.len();
        let mut diagonal = of.storage.clone();
        of.held.iter().for_each(|held| diagonal[held.cell] += held.excess());
        for (link, stride) in of.link.iter().zip(stride) {
            for (cell, &link) in link.iter().enumerate().filter(|(_, link)| **link > 0.0) {
                diagonal[cell] += link;
                diagonal[cell - stride] += link;
            }
        }
        let root: Vec<f64> = diagonal.iter().map(|d| d.sqrt()).collect();
        let link = std::array::from_fn(|axis| {
            let stride = stride[axis];
            let scaled = of.link[axis].iter().enumerate().map(|(cell, &link)| {
                if link > 0.0 { (link / (root[cell] * root[cell - stride])) as f32 } else { 0.0 }
            });
            scaled.chain(std::iter::repeat_n(0.0, stride)).collect()
        });
        let between = || vec![0.0; cells + 2 * stride[2]];
        Level {
            count: of.count,
            halved,
            link,
            inverse: root.iter().map(|&root| if root > 0.0 { root.recip() as f32 } else { 0.0 }).collect(),
            root: root.iter().map(|&root| root as f32).collect(),
            x: vec![0.0; cells],
            residual: vec![0.0; cells],
            step: [between(), between()],
        }
    }

    fn pad(&self) -> usize {
        self.count[0] * self.count[1]
    }

    fn stride(&self) -> [usize; 3] {
        [1, self.count[0], self.pad()]
    }

    /// A polynomial of Chebyshev, from nothing on: `x`, and what it leaves of the residual.
    #[inline(always)]
    fn smooth_before(&mut self) {
        let pad = self.pad();
        let take = CHEBYSHEV[0][1];
        let Level { residual, step: [last, _], .. } = self;
        last[pad..].iter_mut().zip(&*residual).for_each(|(d, r)| *d = take * r);
        self.sweep::<FIRST>(CHEBYSHEV[1]);
        for factors in &CHEBYSHEV[2..] {
            self.sweep::<BETWEEN>(*factors);
        }
        self.sweep::<LEAVE>([0.0; 2]);
    }

    /// Adds the last correction and a polynomial of Chebyshev of what it leaves.
    #[inline(always)]
    fn smooth_after(&mut self) {
        for factors in &CHEBYSHEV[..DEGREE - 1] {
            self.sweep::<BETWEEN>(*factors);
        }
        self.sweep::<END>(CHEBYSHEV[DEGREE - 1]);
    }

    /// Adds the last correction to x, takes what it does from the residual, and makes of both the next.
    #[inline(always)]
    fn sweep<const PLACE: u8>(&mut self, factors: [f32; 2]) {
        let stride = self.stride();
        let Level { link, x, residual, step: [last, next], .. } = self;
        sweep::<PLACE>(
            around(link, stride, x.len()),
            near(last, stride, x.len()),
            residual,
            x,
            &mut next[stride[2]..],
            factors,
        );
        self.step.swap(0, 1);
    }
}

/// Places of a sweep: x is nothing before it,
const FIRST: u8 = 0;
/// there are sweeps before and after it,
const BETWEEN: u8 = 1;
/// the residual matters after it and no other correction,
const LEAVE: u8 = 2;
/// only x matters after it.
const END: u8 = 3;

/// The links of each cell to both sides along each axis.
#[inline(always)]
fn around(link: &[Vec<f32>; 3], stride: [usize; 3], n: usize) -> [[&[f32]; 2]; 3] {
    std::array::from_fn(|axis| [&link[axis][..n], &link[axis][stride[axis]..][..n]])
}

/// The values of each cell and on both sides along each axis, of a vector between zeros.
#[inline(always)]
fn near(vector: &[f32], stride: [usize; 3], n: usize) -> ([[&[f32]; 2]; 3], &[f32]) {
    let pad = stride[2];
    (stride.map(|stride| [&vector[pad - stride..][..n], &vector[pad + stride..][..n]]), &vector[pad..][..n])
}

/// `residual -= A last`, `x += last`, `next = keep last + take residual`.
#[inline(always)]
fn sweep<const PLACE: u8>(
    [[to_left, to_right], [to_front, to_back], [to_below, to_above]]: [[&[f32]; 2]; 3],
    ([[left, right], [front, back], [below, above]], own): ([[&[f32]; 2]; 3], &[f32]),
    residual: &mut [f32],
    x: &mut [f32],
    next: &mut [f32],
    [keep, take]: [f32; 2],
) {
    let n = x.len();
    let (residual, next) = (&mut residual[..n], &mut next[..n]);
    for k in 0..n {
        let along_x = to_left[k] * left[k] + to_right[k] * right[k];
        let along_y = to_front[k] * front[k] + to_back[k] * back[k];
        let along_z = to_below[k] * below[k] + to_above[k] * above[k];
        let r = residual[k] - (own[k] - (along_x + along_y + along_z));
        match PLACE {
            FIRST => x[k] = own[k],
            END => x[k] += own[k] + (keep * own[k] + take * r),
            _ => x[k] += own[k],
        }
        if PLACE != END {
            residual[k] = r;
        }
        if PLACE == FIRST || PLACE == BETWEEN {
            next[k] = keep * own[k] + take * r;
        }
    }
}

/// The residual of the coarse cells: the sums of that in their cells.
#[inline(always)]
fn restrict(fine: &Level, coarse: &mut Level) {
    let [nx, ny, nz] = fine.count;
    let [hx, hy, hz] = fine.halved;
    let [mx, my, _] = coarse.count;
    coarse.residual.fill(0.0);
    for z in 0..nz {
        for y in 0..ny {
            let from = (z * ny + y) * nx;
            let to = ((z >> usize::from(hz)) * my + (y >> usize::from(hy))) * mx;
            let (residual, root) = (&fine.residual[from..][..nx], &fine.root[from..][..nx]);
            let to = &mut coarse.residual[to..][..mx];
            if hx {
                let ((pairs, last), (roots, last_root)) = (residual.as_chunks::<2>(), root.as_chunks::<2>());
                for ((to, [a, b]), [ra, rb]) in to.iter_mut().zip(pairs).zip(roots) {
                    *to += a * ra + b * rb;
                }
                if let ([a], [ra]) = (last, last_root) {
                    to[mx - 1] += a * ra;
                }
            } else {
                to.iter_mut().zip(residual).zip(root).for_each(|((to, a), ra)| *to += a * ra);
            }
        }
    }
    coarse.residual.iter_mut().zip(&coarse.inverse).for_each(|(r, inverse)| *r *= inverse);
}

/// The correction of the coarse cells becomes the last one of their cells.
#[inline(always)]
fn prolong(coarse: &mut Level, fine: &mut Level) {
    let [nx, ny, nz] = fine.count;
    let [hx, hy, hz] = fine.halved;
    let [mx, my, _] = coarse.count;
    coarse.x.iter_mut().zip(&coarse.inverse).for_each(|(x, inverse)| *x *= inverse);
    let pad = fine.pad();
    for z in 0..nz {
        for y in 0..ny {
            let to = (z * ny + y) * nx;
            let from = ((z >> usize::from(hz)) * my + (y >> usize::from(hy))) * mx;
            let root = &fine.root[to..][..nx];
            let to = &mut fine.step[0][pad + to..][..nx];
            let from = &coarse.x[from..][..mx];
            if hx {
                let ((pairs, last), (roots, last_root)) = (to.as_chunks_mut::<2>(), root.as_chunks::<2>());
                for ((from, [a, b]), [ra, rb]) in from.iter().zip(pairs).zip(roots) {
                    (*a, *b) = (from * ra, from * rb);
                }
                if let ([a], [ra]) = (last, last_root) {
                    *a = from[mx - 1] * ra;
                }
            } else {
                to.iter_mut().zip(from).zip(root).for_each(|((to, from), root)| *to = from * root);
            }
        }
    }
}

/// What each correction keeps of the one before and takes of the residual, so that after all of them their sum is the polynomial
/// of Chebyshev.
const CHEBYSHEV: [[f32; 2]; DEGREE] = {
    let [low, high] = SMOOTHED;
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    let sigma = middle / half;
    let mut factors = [[0.0, 1.0 / middle]; DEGREE];
    let (mut rho, mut k) = (1.0 / sigma, 1);
    while k < DEGREE {
        let next = 1.0 / (2.0 * sigma - rho);
        factors[k] = [next * rho, 2.0 * next / half];
        (rho, k) = (next, k + 1);
    }
    factors
};

impl Multigrid {
    /// Of links `g` [m³/(Pa s)], the walls and the storage of each cell [m³/(Pa s)].
    pub fn new(grid: &Grid, g: &[f64], held: &[Held], storage: &[f64]) -> Multigrid {
        let cells = grid.census.cells;
        let all = || g.iter().chain(storage);
        let greatest = all().fold(0.0_f64, |a, &b| a.max(b));
        let unit = if greatest > 0.0 { greatest } else { 1.0 };
        let of = |held: &Held| Held { g: held.g / unit, give: held.give / unit, ..*held };
        let mut coefficients = Coefficients {
            count: grid.count,
            link: std::array::from_fn(|_| vec![0.0; cells]),
            held: held.iter().map(of).collect(),
            storage: storage.iter().map(|storage| storage / unit).collect(),
            width: grid.planes.each_ref().map(|planes| planes.windows(2).map(|p| p[1] - p[0]).collect()),
        };
        for (axis, to) in coefficients.link.iter_mut().enumerate() {
            for link in grid.links(axis) {
                let [low, high] = grid.ends[link].map(|end| end as usize);
                if low < cells && high < cells {
                    to[high] = g[link] / unit;
                }
            }
        }
        let mut levels = Vec::new();
        loop {
            let halved = coefficients.halved();
            levels.push(Level::new(&coefficients, halved));
            if !halved.contains(&true) {
                return Multigrid { unit, levels };
            }
            coefficients = coefficients.coarser(halved);
        }
    }

    /// One cycle: from the residual of the finest level to x there.
    #[inline(always)]
    fn cycle(&mut self) {
        let last = self.levels.len() - 1;
        for l in 0..last {
            self.levels[l].smooth_before();
            let (fine, coarse) = self.levels.split_at_mut(l + 1);
            restrict(&fine[l], &mut coarse[0]);
        }
        // One cell, or cells that are not linked: their diagonal is 1.
        let Level { x, residual, .. } = &mut self.levels[last];
        x.copy_from_slice(residual);
        for l in (0..last).rev() {
            let (fine, coarse) = self.levels.split_at_mut(l + 1);
            prolong(&mut coarse[0], &mut fine[l]);
            fine[l].smooth_after();
        }
    }

    /// `z = M⁻¹ r`, returning `z · r`; `size` is the norm of r.
    #[inline(always)]
    fn invert(&mut self, r: &[f64], size: f64, z: &mut [f64]) -> f64 {
        let n = r.len();
        let Level { inverse, residual, .. } = &mut self.levels[0];
        let (inverse, to) = (&inverse[..n], &mut residual[..n]);
        let by = size.recip();
        for k in 0..n {
            to[k] = (by * r[k]) as f32 * inverse[k];
        }
        self.cycle();
        let Level { inverse, x, .. } = &self.levels[0];
        let (inverse, x, z) = (&inverse[..n], &x[..n], &mut z[..n]);
        let by = size / self.unit;
        for k in 0..n {
            z[k] = by * f64::from(x[k] * inverse[k]);
        }
        let mut part = [0.0; 8];
        let ((z, z_rest), (r, r_rest)) = (z.as_chunks::<8>(), r.as_chunks::<8>());
        for (z, r) in z.iter().zip(r) {
            for lane in 0..8 {
                part[lane] += z[lane] * r[lane];
            }
        }
        part.iter().sum::<f64>() + z_rest.iter().zip(r_rest).map(|(z, r)| z * r).sum::<f64>()
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn invert_wide(&mut self, r: &[f64], size: f64, z: &mut [f64]) -> f64 {
        self.invert(r, size, z)
    }
}

impl Preconditioner for Multigrid {
    fn apply(&mut self, r: &[f64], size: f64, z: &mut [f64], _: &mut Sums) -> f64 {
        #[cfg(target_arch = "x86_64")]
        if super::wide::wide() {
            // SAFETY: the processor has what the function was compiled for.
            return unsafe { self.invert_wide(r, size, z) };
        }
        self.invert(r, size, z)
    }
}

#[cfg(test)]
mod tests {
    use super::super::stencil::Stencil;
    use super::*;
    use crate::darcy::grid::Plan;
    use crate::darcy::{Permeability, Transfer};
    use crate::grains::Grains;
    use glam::DVec3;
    use porograin_linear::{Operator, Params, Work, conjugate_gradients};

    /// Cells of one size in a box with one grain.
    fn grid(count: [usize; 3], permeability: [f64; 3]) -> Grid {
        let plan = Plan {
            planes: count.map(|n| (0..=n).map(|k| k as f64).collect()),
            transfer: Transfer::Overlap,
            permeability: Permeability::Given(permeability),
            viscosity: 1e3,
            slowed: &[],
        };
        Grid::new(&Grains::at_rest(vec![DVec3::splat(0.5)], vec![0.1], 1.0), &plan)
    }

    /// Numbers between -1 and 1.
    fn noise(n: usize, seed: f64) -> Vec<f64> {
        (0..n)
            .map(|k| ((k as f64 + seed) * 12.9898).sin() * 43758.5453)
            .map(|x| 2.0 * (x - x.floor()) - 1.0)
            .collect()
    }

    /// The walls at the ends of the z axis.
    fn ends(grid: &Grid, give: [f64; 2]) -> Vec<Held> {
        let walls = grid.wall_face.iter().zip(&grid.wall_link).filter(|(face, _)| **face >= 4);
        let held = |(face, link): (&u8, &u32)| {
            let [low, high] = grid.ends[*link as usize];
            let g = grid.conductance[*link as usize];
            Held { cell: low.min(high) as usize, axis: 2, g, give: give[usize::from(*face) - 4] }
        };
        walls.map(held).collect()
    }

    struct Problem {
        stencil: Stencil,
        multigrid: Multigrid,
        free: bool,
    }

    impl Problem {
        fn new(grid: &Grid, g: &[f64], held: &[Held], storage: f64) -> Problem {
            let storage = vec![storage; grid.census.cells];
            let mut excess = storage.clone();
            held.iter().for_each(|held| excess[held.cell] += held.excess());
            Problem {
                stencil: Stencil::new(grid, g, &excess),
                multigrid: Multigrid::new(grid, g, held, &storage),
                free: excess.iter().all(|&excess| excess == 0.0),
            }
        }

        /// Iterations to this residual.
        fn iterations(&mut self, tolerance: f64) -> usize {
            let n = self.stencil.nodes();
            let mut b = noise(n, 0.3);
            let mean = if self.free { b.iter().sum::<f64>() / n as f64 } else { 0.0 };
            b.iter_mut().for_each(|b| *b -= mean);
            let params = Params { tolerance, ..Params::default() };
            let (mut x, mut work) = (vec![0.0; n], Work::default());
            let Problem { stencil, multigrid, .. } = self;
            conjugate_gradients(stencil, multigrid, &b, &mut x, &params, &mut work).unwrap().iterations
        }
    }

    const OPEN: [f64; 2] = [f64::INFINITY; 2];

    #[test]
    fn few_iterations_on_any_grid() {
        let cases = [
            ("cubes", [14, 14, 14], [1e-9; 3], OPEN, 0.0, 5),
            ("more cubes", [30, 31, 33], [1e-9; 3], OPEN, 0.0, 6),
            ("a column", [1, 1, 2000], [1e-9; 3], OPEN, 0.0, 5),
            ("a layer", [40, 40, 1], [1e-9; 3], OPEN, 0.0, 2),
            ("a plane", [40, 1, 40], [1e-9; 3], OPEN, 0.0, 4),
            ("one axis conducts", [12, 13, 14], [1e-15, 1e-9, 1e-13], OPEN, 0.0, 5),
            ("one axis does not", [12, 13, 14], [1e-9, 0.0, 1e-9], OPEN, 0.0, 4),
            ("nothing is held", [14, 13, 9], [1e-9; 3], [0.0; 2], 0.0, 5),
            ("next to nothing is stored", [14, 13, 9], [1e-9; 3], [0.0; 2], 1e-19, 5),
            ("a stiff piston", [14, 13, 9], [1e-9; 3], [0.0, 1e-19], 0.0, 6),
            ("a soft piston", [14, 13, 9], [1e-9; 3], [0.0, 1e-6], 0.0, 5),
            ("much is stored", [14, 13, 9], [1e-9; 3], [0.0; 2], 1e-10, 2),
            ("one cell", [1, 1, 1], [1e-9; 3], OPEN, 0.0, 1),
        ];
        for (name, count, permeability, give, storage, most) in cases {
            let grid = grid(count, permeability);
            let mut problem = Problem::new(&grid, &grid.conductance, &ends(&grid, give), storage);
            let found = problem.iterations(1e-7);
            assert!(found <= most, "{name}: {found}");
        }
    }

    #[test]
    fn links_that_differ_a_thousandfold_take_some_more() {
        let grid = grid([14, 15, 16], [1e-9; 3]);
        // Links scattered over three decades, and a layer a thousand times better than all others.
        let n = grid.ends.len();
        let scattered: Vec<f64> =
            noise(n, 0.7).iter().zip(&grid.conductance).map(|(a, g)| g * 10f64.powf(1.5 * a)).collect();
        let layer: Vec<f64> = grid
            .ends
            .iter()
            .zip(&grid.conductance)
            .map(|([low, high], g)| if low.min(high) / (14 * 15) >= 12 { 1e3 * g } else { *g })
            .collect();
        for (g, most) in [(scattered, 19), (layer, 7)] {
            let found = Problem::new(&grid, &g, &ends(&grid, OPEN), 0.0).iterations(1e-7);
            assert!(found <= most, "{found}");
        }
    }

    #[test]
    fn a_cycle_is_symmetric_and_the_same_in_wide_registers() {
        let grid = grid([7, 6, 5], [1e-9; 3]);
        let mut multigrid = Problem::new(&grid, &grid.conductance, &ends(&grid, OPEN), 0.0).multigrid;
        let n = grid.census.cells;
        let (a, b) = (noise(n, 0.1), noise(n, 0.6));
        let (mut from_a, mut from_b, mut plain) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        let mut sums = Sums::new();
        let aa = multigrid.apply(&a, 3.0, &mut from_a, &mut sums);
        multigrid.apply(&b, 2.0, &mut from_b, &mut sums);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        assert!((aa / dot(&a, &from_a) - 1.0).abs() < 1e-14 && aa > 0.0);
        let size = (dot(&a, &from_a) * dot(&b, &from_b)).sqrt();
        assert!((dot(&a, &from_b) - dot(&b, &from_a)).abs() < 1e-6 * size);
        assert_eq!(multigrid.invert(&a, 3.0, &mut plain), aa);
        assert_eq!(plain, from_a);
    }
}

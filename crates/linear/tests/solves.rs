//! Every method on every kind of matrix: answers against a dense factorisation, residuals, refusals, same bits.

mod network;

use network::{Network, Random, network};
use porograin_linear::{
    Error, FIXED, Info, Matrix, Method, Operator, Params, Preconditioner, Solver, Work, conjugate_gradients,
};

const METHODS: [Method; 3] = [Method::Cholesky, Method::ConjugateGradients, Method::GaussSeidel];

fn matrix(network: &Network) -> Matrix {
    Matrix::new(network.positions.len(), &network.ends, &network.conductance, &network.extra).unwrap()
}

fn noise(n: usize, seed: u64) -> Vec<f64> {
    let mut random = Random(seed);
    (0..n).map(|_| random.normal()).collect()
}

/// `‖b - A x‖ / ‖b‖` by a plain loop.
fn residual(matrix: &Matrix, b: &[f64], x: &[f64]) -> f64 {
    let mut square = 0.0;
    for i in 0..b.len() {
        let (columns, values) = matrix.row(i);
        let off: f64 = columns.iter().zip(values).map(|(&j, a)| a * x[j as usize]).sum();
        square += (b[i] - matrix.diagonal()[i] * x[i] - off).powi(2);
    }
    (square / b.iter().map(|b| b * b).sum::<f64>()).sqrt()
}

/// Solution by a dense Cholesky factorisation.
fn dense(matrix: &Matrix, b: &[f64]) -> Vec<f64> {
    let n = matrix.nodes();
    let mut l = vec![vec![0.0; n]; n];
    for i in 0..n {
        l[i][i] = matrix.diagonal()[i];
        for (&j, &a) in matrix.row(i).0.iter().zip(matrix.row(i).1) {
            l[i][j as usize] = a;
        }
    }
    for j in 0..n {
        for k in 0..j {
            let f = l[j][k];
            for i in j..n {
                l[i][j] -= l[i][k] * f;
            }
        }
        let d = l[j][j].sqrt();
        for i in j..n {
            l[i][j] /= d;
        }
    }
    let mut x = b.to_vec();
    for i in 0..n {
        x[i] = (x[i] - (0..i).map(|k| l[i][k] * x[k]).sum::<f64>()) / l[i][i];
    }
    for i in (0..n).rev() {
        x[i] = (x[i] - (i + 1..n).map(|k| l[k][i] * x[k]).sum::<f64>()) / l[i][i];
    }
    x
}

#[test]
fn answers_match_a_dense_factorisation() {
    for (count, positions) in [(8, true), (216, true), (512, false)] {
        let net = network(count, 5);
        let a = matrix(&net);
        let b = noise(a.nodes(), 1);
        let exact = dense(&a, &b);
        let size = exact.iter().fold(0.0f64, |s, x| s.max(x.abs()));
        for method in METHODS {
            let params = Params { method, tolerance: 1e-12, max_iterations: 1_000_000, ..Params::default() };
            let mut solver = Solver::new(&a, &params, positions.then_some(&net.positions[..])).unwrap();
            let mut x = vec![0.0; a.nodes()];
            let info = solver.solve(&a, &b, &mut x).unwrap();
            assert_eq!(info.method, method);
            let error = x.iter().zip(&exact).fold(0.0f64, |s, (x, e)| s.max((x - e).abs()));
            assert!(error < 1e-7 * size, "{count} {method:?}: {error} of {size}");
        }
    }
}

#[test]
fn residuals_are_true_and_small() {
    let net = network(9000, 2);
    let a = matrix(&net);
    let b = noise(a.nodes(), 3);
    for method in [Method::Cholesky, Method::ConjugateGradients] {
        for tolerance in [1e-4, 1e-8, 1e-11] {
            let params = Params { method, tolerance, ..Params::default() };
            let mut solver = Solver::new(&a, &params, Some(&net.positions)).unwrap();
            let mut x = vec![0.0; a.nodes()];
            let info = solver.solve(&a, &b, &mut x).unwrap();
            let found = residual(&a, &b, &x);
            assert!(info.residual <= tolerance, "{info:?}");
            assert!((found - info.residual).abs() <= 1e-3 * tolerance + 1e-12, "{found} {info:?}");
            // A solved system is left as it is.
            let before = x.clone();
            assert_eq!(solver.solve(&a, &b, &mut x).unwrap().iterations, 0);
            assert_eq!(x, before);
        }
    }
}

#[test]
fn a_floor_spares_work() {
    let net = network(1000, 2);
    let a = matrix(&net);
    let b = noise(a.nodes(), 3);
    let params = Params { floor: 1e10, ..Params::default() };
    let mut solver = Solver::new(&a, &params, None).unwrap();
    let mut x = vec![0.0; a.nodes()];
    assert_eq!(solver.solve(&a, &b, &mut x).unwrap().iterations, 0);
    assert!(x.iter().all(|&x| x == 0.0));
}

#[test]
fn zero_right_hand_side_gives_zero() {
    let net = network(500, 2);
    let a = matrix(&net);
    for method in METHODS {
        let mut solver = Solver::new(&a, &Params { method, ..Params::default() }, None).unwrap();
        let mut x = noise(a.nodes(), 1);
        let info = solver.solve(&a, &vec![0.0; a.nodes()], &mut x).unwrap();
        assert_eq!((info.iterations, info.residual), (0, 0.0));
        assert!(x.iter().all(|&x| x == 0.0));
    }
}

#[test]
fn refresh_equals_new() {
    let net = network(3000, 4);
    let mut a = matrix(&net);
    let b = noise(a.nodes(), 3);
    for method in [Method::Cholesky, Method::ConjugateGradients] {
        let params = Params { method, ..Params::default() };
        a.refresh(&net.conductance, &net.extra).unwrap();
        let mut kept = Solver::new(&a, &params, Some(&net.positions)).unwrap();
        let mut other = net.conductance.clone();
        for (g, s) in other.iter_mut().zip(noise(net.ends.len(), 9)) {
            *g *= (0.3 * s).exp();
        }
        a.refresh(&other, &net.extra).unwrap();
        let mut stale = vec![0.0; a.nodes()];
        let info = kept.solve(&a, &b, &mut stale).unwrap();
        assert!(residual(&a, &b, &stale) <= 1.001e-8, "a stale set-up still solves: {info:?}");
        kept.refresh(&a).unwrap();
        let mut fresh = Solver::new(&a, &params, Some(&net.positions)).unwrap();
        let (mut x, mut y) = (vec![0.0; a.nodes()], vec![0.0; a.nodes()]);
        assert_eq!(kept.solve(&a, &b, &mut x).unwrap(), fresh.solve(&a, &b, &mut y).unwrap());
        assert_eq!(x, y, "{method:?}");
        assert_ne!(x, stale, "{method:?}");
    }
}

#[test]
fn preconditioners_are_symmetric_and_positive() {
    let net = network(4000, 6);
    let a = matrix(&net);
    let n = a.nodes();
    // Up to single precision: a sweep without its mirror image would show as tens of percent.
    for (method, bound) in [(Method::Cholesky, 1e-5), (Method::ConjugateGradients, 1e-5)] {
        let mut solver =
            Solver::new(&a, &Params { method, ..Params::default() }, Some(&net.positions)).unwrap();
        let (u, v) = (noise(n, 1), noise(n, 2));
        let (mut mu, mut mv) = (vec![0.0; n], vec![0.0; n]);
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let mut sums = Vec::new();
        for (u, mu) in [(&u, &mut mu), (&v, &mut mv)] {
            let told = solver.apply(u, dot(u, u).sqrt(), mu, &mut sums);
            assert!((told / dot(u, mu) - 1.0).abs() < 1e-12);
        }
        let size = (dot(&u, &mu) * dot(&v, &mv)).sqrt();
        assert!(dot(&u, &mu) > 0.0 && dot(&v, &mv) > 0.0);
        let skew = (dot(&v, &mu) - dot(&u, &mv)).abs() / size;
        assert!(skew < bound, "{method:?}: {skew}");
    }
}

#[test]
fn same_bits_on_any_number_of_threads() {
    let net = network(80_000, 7);
    let a = matrix(&net);
    let b = noise(a.nodes(), 3);
    for method in [Method::Cholesky, Method::ConjugateGradients] {
        let solve = |threads: usize| -> (Info, Vec<f64>) {
            rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
                let params = Params { method, ..Params::default() };
                let mut solver = Solver::new(&a, &params, Some(&net.positions)).unwrap();
                let mut x = vec![0.0; a.nodes()];
                (solver.solve(&a, &b, &mut x).unwrap(), x)
            })
        };
        assert_eq!(solve(1), solve(2), "{method:?}");
    }
}

/// The network of clusters is factored for many solves, coarsened further for few: the same answer, in fewer iterations; also for
/// the values of a refresh.
#[test]
fn a_factor_of_the_clusters_saves_iterations() {
    let net = network(9000, 11);
    let mut a = matrix(&net);
    let b = noise(a.nodes(), 5);
    let solver = |solves: usize| {
        let params = Params {
            method: Method::ConjugateGradients,
            tolerance: 1e-9,
            expected_solves: solves,
            ..Params::default()
        };
        Solver::new(&a, &params, Some(&net.positions)).unwrap()
    };
    let (mut many, mut few) = (solver(1000), solver(1));
    let stiffer: Vec<f64> =
        net.conductance.iter().enumerate().map(|(k, g)| g * (1.0 + (k % 7) as f64)).collect();
    for conductance in [&net.conductance, &stiffer] {
        a.refresh(conductance, &net.extra).unwrap();
        let [one, other] = [&mut many, &mut few].map(|solver| {
            solver.refresh(&a).unwrap();
            let mut x = vec![0.0; a.nodes()];
            let info = solver.solve(&a, &b, &mut x).unwrap();
            assert!(residual(&a, &b, &x) < 1.1e-9);
            (info.iterations, x)
        });
        assert!(one.0 < other.0 && one.0 > 1, "{} {}", one.0, other.0);
        let size = one.1.iter().fold(0.0f64, |m, x| m.max(x.abs()));
        assert!(one.1.iter().zip(&other.1).all(|(x, y)| (x - y).abs() < 1e-6 * size));
    }
    assert!(many.setup().entries > few.setup().entries);
}

#[test]
fn what_is_not_a_number_is_an_error() {
    let net = network(300, 1);
    let a = matrix(&net);
    let n = a.nodes();
    for method in METHODS {
        let mut solver = Solver::new(&a, &Params { method, ..Params::default() }, None).unwrap();
        let (mut b, mut x) = (vec![1.0; n], vec![0.0; n]);
        b[7] = f64::NAN;
        let found = solver.solve(&a, &b, &mut x).unwrap_err();
        assert!(
            matches!(found, Error::Value { what: "right-hand side", index: 7, .. }),
            "{method:?} {found:?}"
        );
        b[7] = 1.0;
        x[9] = f64::INFINITY;
        let found = solver.solve(&a, &b, &mut x).unwrap_err();
        assert!(matches!(found, Error::Value { what: "start", index: 9, .. }), "{method:?} {found:?}");
        assert!(matches!(solver.solve(&a, &b[1..], &mut [0.0]), Err(Error::Length { .. })));
    }
}

#[test]
fn undetermined_parts_are_named() {
    let ends = [[0, 1], [1, 2], [3, 4], [5, FIXED]];
    let a = Matrix::new(6, &ends, &[1.0; 4], &[0.0, 0.0, 1e-3, 0.0, 0.0, 0.0]).unwrap();
    for method in METHODS {
        let found = Solver::new(&a, &Params { method, ..Params::default() }, None).err();
        assert_eq!(found, Some(Error::Singular { nodes: vec![3, 4] }));
    }
}

#[test]
fn another_pattern_is_refused() {
    let a = Matrix::new(2, &[[0, 1], [1, FIXED]], &[1.0; 2], &[0.0; 2]).unwrap();
    let other = Matrix::new(3, &[[0, 1], [1, 2], [2, FIXED]], &[1.0; 3], &[0.0; 3]).unwrap();
    let mut solver = Solver::new(&a, &Params::default(), None).unwrap();
    assert_eq!(solver.refresh(&other), Err(Error::Pattern));
    assert_eq!(solver.solve(&other, &[0.0; 3], &mut [0.0; 3]), Err(Error::Pattern));
    assert!(matches!(Solver::new(&a, &Params::default(), Some(&[])), Err(Error::Length { .. })));
}

#[test]
fn running_out_of_iterations_is_an_error() {
    let net = network(3000, 1);
    let a = matrix(&net);
    let b = noise(a.nodes(), 1);
    for method in [Method::ConjugateGradients, Method::GaussSeidel] {
        let params = Params { method, max_iterations: 2, ..Params::default() };
        let mut solver = Solver::new(&a, &params, None).unwrap();
        let found = solver.solve(&a, &b, &mut vec![0.0; a.nodes()]);
        assert!(matches!(found, Err(Error::NotConverged { .. })), "{found:?}");
    }
}

/// `A + c s sᵀ`, known only by its product.
struct Coupled<'a>(&'a Matrix, f64, Vec<f64>);

impl Operator for Coupled<'_> {
    fn nodes(&self) -> usize {
        self.0.nodes()
    }
    fn apply(&mut self, x: &[f64], y: &mut [f64]) {
        let mut a = self.0;
        a.apply(x, y);
        let s = self.1 * self.2.iter().zip(x).map(|(s, x)| s * x).sum::<f64>();
        y.iter_mut().zip(&self.2).for_each(|(y, v)| *y += s * v);
    }
}

#[test]
fn a_product_is_enough_of_an_operator() {
    let net = network(4000, 1);
    let a = matrix(&net);
    let n = a.nodes();
    let b = noise(n, 1);
    let params = Params { method: Method::Cholesky, ..Params::default() };
    let mut solver = Solver::new(&a, &params, Some(&net.positions)).unwrap();
    let mut operator = Coupled(&a, 1e-10, noise(n, 4));
    let mut x = vec![0.0; n];
    let info = solver.solve_operator(&mut operator, &b, &mut x).unwrap();
    let mut y = vec![0.0; n];
    operator.apply(&x, &mut y);
    let wrong: f64 = y.iter().zip(&b).map(|(y, b)| (y - b).powi(2)).sum::<f64>().sqrt();
    assert!(wrong <= 1.001e-8 * b.iter().map(|b| b * b).sum::<f64>().sqrt());
    assert!((1..=6).contains(&info.iterations), "a rank-one change costs an iteration or two: {info:?}");
    // The same through the bare function.
    let mut again = vec![0.0; n];
    conjugate_gradients(&mut operator, &mut solver, &b, &mut again, &params, &mut Work::default()).unwrap();
    assert_eq!(x, again);
}

#[test]
fn an_indefinite_operator_is_an_error() {
    struct Minus;
    impl Operator for Minus {
        fn nodes(&self) -> usize {
            2
        }
        fn apply(&mut self, x: &[f64], y: &mut [f64]) {
            y.iter_mut().zip(x).for_each(|(y, x)| *y = -x);
        }
    }
    let a = Matrix::new(2, &[[0, 1], [1, FIXED]], &[1.0; 2], &[0.0; 2]).unwrap();
    let mut solver = Solver::new(&a, &Params::default(), None).unwrap();
    let found = solver.solve_operator(&mut Minus, &[1.0, 1.0], &mut [0.0; 2]);
    assert_eq!(found, Err(Error::NotPositive { node: None }));
}

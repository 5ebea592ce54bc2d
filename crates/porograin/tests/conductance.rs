//! Conductances: what holds for every one of them, and the local drag against Stokes flow.

use glam::DVec3;
use porograin::boundary::Slip;
use porograin::permeability::{Outcome, Problem, measure};
use porograin::pores::conductance::{CONDUCTANCES, Conductance, Custom, Passage};
use porograin::pores::{Coupling, Pores, Solver};
use porograin_geometry::throat::{Packing, radical_centres, shape, throats};
use porograin_geometry::{Cell, Triangulation};
use std::f64::consts::PI;

/// Poiseuille's tube with the hydraulic radius, written from outside.
const MINE: Custom = Custom {
    id: 7,
    of: |passage, viscosity| {
        let radius = passage.shape.void / passage.drag_surfaces().iter().sum::<f64>();
        0.5 * passage.shape.fluid_area * radius * radius / (viscosity * passage.shape.length)
    },
    shares: |passage| passage.drag_surfaces(),
};

fn all() -> Vec<Conductance> {
    let mut all: Vec<Conductance> = CONDUCTANCES.iter().map(|c| Conductance::named(c.0).unwrap()).collect();
    all.push(Conductance::HydraulicRadius { alpha: 0.3 });
    all.push(Conductance::Custom(MINE));
    all
}

struct Sample {
    cell: Cell,
    x: Vec<DVec3>,
    r: Vec<f64>,
}

impl Sample {
    fn packing(&self) -> Packing<'_> {
        Packing { cell: &self.cell, position: &self.x, radius: &self.r }
    }

    /// The same, `length` times as large.
    fn scaled(&self, length: f64) -> Sample {
        Sample {
            cell: Cell::walled(self.cell.origin * length, self.cell.upper() * length),
            x: self.x.iter().map(|&x| x * length).collect(),
            r: self.r.iter().map(|&r| r * length).collect(),
        }
    }

    /// The same grains in reverse order.
    fn reversed(&self) -> Sample {
        let (x, r) = (self.x.iter().rev(), self.r.iter().rev());
        Sample { cell: self.cell, x: x.copied().collect(), r: r.copied().collect() }
    }

    fn flow(&self, conductance: Conductance, sides: Slip, viscosity: f64) -> Outcome {
        let (solver, residual) = (Solver::Cholesky, 1e-10);
        let coupling = Coupling::Reciprocal;
        let problem =
            Problem { axis: 2, drop: 1.0, sides, viscosity, conductance, coupling, solver, residual };
        measure(&self.cell, &self.x, &self.r, &problem).unwrap()
    }
}

/// Separate spheres of radii between `big / ratio` and `big` thrown into the unit cube.
fn cloud(n: usize, big: f64, ratio: f64) -> Sample {
    let mut seed = 5u64;
    let mut random = || {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (seed >> 11) as f64 / (1u64 << 53) as f64
    };
    let (mut x, mut r): (Vec<DVec3>, Vec<f64>) = (Vec::new(), Vec::new());
    while x.len() < n {
        let radius = big * ratio.powf(-(x.len() as f64 / n as f64));
        let p = DVec3::new(random(), random(), random()) * (1.0 - 2.0 * radius) + radius;
        if x.iter().zip(&r).all(|(q, b)| q.distance(p) > radius + b) {
            x.push(p);
            r.push(radius);
        }
    }
    Sample { cell: Cell::walled(DVec3::ZERO, DVec3::ONE), x, r }
}

/// `side³` grains on a simple cubic lattice of pitch 1, each moved by up to `shake`.
fn lattice(side: usize, radius: f64, shake: f64) -> Sample {
    let place = |i: usize| DVec3::new((i % side) as f64, (i / side % side) as f64, (i / side / side) as f64);
    let moved =
        |i: usize| shake * DVec3::new((7.3 * i as f64).sin(), (4.1 * i as f64).cos(), (i as f64).sin());
    let x = (0..side.pow(3)).map(|i| place(i) + 0.5 + moved(i)).collect();
    let cell = Cell::walled(DVec3::ZERO, DVec3::splat(side as f64));
    Sample { cell, x, r: vec![radius; side.pow(3)] }
}

/// `of` for every throat of the sample.
fn throats_of<T>(sample: &Sample, sides: Slip, of: impl Fn(&Passage) -> T) -> Vec<T> {
    let packing = sample.packing();
    let mesh = Triangulation::new(&sample.cell, &sample.x, &sample.r).unwrap();
    let centres = radical_centres(packing, &mesh);
    let passage = |throat| {
        let shape = shape(packing, &mesh, &centres, throat);
        of(&Passage::new(packing, &mesh, &centres, throat, &shape, &[sides; 6]))
    };
    throats(&mesh).iter().map(passage).collect()
}

#[test]
fn every_conductance_is_positive_and_a_length_to_the_fourth_over_the_viscosity() {
    for sample in [cloud(200, 0.1, 3.0), lattice(4, 0.4, 0.05)] {
        for conductance in all() {
            for sides in [Slip::Symmetry, Slip::NoSlip] {
                let base = throats_of(&sample, sides, |passage| conductance.of(passage, 1.0));
                assert!(base.iter().all(|g| *g > 0.0 && g.is_finite()), "{conductance:?} {sides:?}");
                // Powers of two change no digit of the geometry, so that the same throats are compared.
                for (length, viscosity) in [(2f64.powi(-20), 1.0), (2f64.powi(17), 250.0)] {
                    let other = throats_of(&sample.scaled(length), sides, |p| conductance.of(p, viscosity));
                    for (a, b) in base.iter().zip(&other) {
                        let expected = a * length.powi(3) / viscosity;
                        assert!(
                            (b / expected - 1.0).abs() < 1e-12,
                            "{conductance:?} {sides:?}: {b} {expected}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn every_conductance_is_blind_to_units_and_labels() {
    let sample = cloud(200, 0.1, 3.0);
    for conductance in all() {
        let base = sample.flow(conductance, Slip::NoSlip, 1.0);
        let small = sample.scaled(1e-3).flow(conductance, Slip::NoSlip, 0.02);
        assert!((small.permeability / base.permeability * 1e6 - 1.0).abs() < 1e-9, "{conductance:?}");
        let reversed = sample.reversed().flow(conductance, Slip::NoSlip, 1.0);
        assert!((reversed.permeability / base.permeability - 1.0).abs() < 1e-9, "{conductance:?}");
        for (a, b) in base.loads.force.iter().zip(reversed.loads.force.iter().rev()) {
            assert!((*a - *b).length() < 1e-9, "{conductance:?}");
        }
    }
}

#[test]
fn shares_are_parts_of_one() {
    for conductance in all() {
        for sides in [Slip::Symmetry, Slip::NoSlip] {
            for shares in throats_of(&cloud(200, 0.1, 3.0), sides, |passage| conductance.shares(passage)) {
                assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12 && shares.iter().all(|s| *s >= 0.0));
            }
        }
    }
}

#[test]
fn a_conductance_of_ones_own_is_used() {
    let sample = cloud(100, 0.1, 2.0);
    let permeability = |conductance| sample.flow(conductance, Slip::NoSlip, 1.0).permeability;
    let thesis = permeability(Conductance::hydraulic_radius());
    assert!((permeability(Conductance::Custom(MINE)) / thesis - 1.0).abs() < 1e-12);
    // The factor scales the flow and nothing else.
    assert!((permeability(Conductance::HydraulicRadius { alpha: 0.3 }) / thesis - 0.6).abs() < 1e-12);
}

#[test]
fn a_case_names_its_conductance() {
    let read = |text: &str| toml_edit::de::from_str::<Pores>(text).map(|pores| pores.conductance);
    assert_eq!(read("").unwrap(), Conductance::LocalDrag);
    for (name, _) in CONDUCTANCES {
        let found = read(&format!("conductance = \"{name}\"")).unwrap();
        assert_eq!(found.name(), name);
        // What a checkpoint keeps is the same value.
        let bytes = postcard::to_stdvec(&found).unwrap();
        assert_eq!(postcard::from_bytes::<Conductance>(&bytes).unwrap(), found);
    }
    let factor = read("conductance = { hydraulic-radius = { alpha = 0.4 } }").unwrap();
    assert_eq!(factor, Conductance::HydraulicRadius { alpha: 0.4 });
    let own = Conductance::Custom(MINE);
    assert_eq!(postcard::from_bytes::<Conductance>(&postcard::to_stdvec(&own).unwrap()).unwrap(), own);
}

#[test]
fn the_effective_radius_takes_the_circle_between_three_grains() {
    // Three touching unit spheres: the circle between them has the radius 2/sqrt(3) - 1, the open area is sqrt(3) - pi/2.
    let height = 3f64.sqrt();
    let x = [DVec3::new(3.0, 3.0, 3.0), DVec3::new(5.0, 3.0, 3.0), DVec3::new(4.0, 3.0 + height, 3.0)];
    let centre = DVec3::new(4.0, 3.0 + height / 3.0, 3.0);
    let [above, below] = [1.2, -1.2].map(|z| centre + DVec3::Z * z);
    let sample = Sample {
        cell: Cell::walled(DVec3::ZERO, DVec3::new(8.0, 8.0, 6.0)),
        x: [&x[..], &[above, below]].concat(),
        r: vec![1.0, 1.0, 1.0, 0.3, 0.3],
    };
    let found = throats_of(&sample, Slip::NoSlip, |passage| {
        let central = passage.vertices.iter().all(|&v| v < 3);
        central.then(|| Conductance::EffectiveRadius.of(passage, 1.0) * passage.shape.length)
    });
    let found: Vec<f64> = found.into_iter().flatten().collect();
    let radius = (((height - PI / 2.0) / PI).sqrt() + 2.0 / height - 1.0) / 4.0;
    assert_eq!(found.len(), 1);
    assert!((found[0] / (2.0 * PI * radius.powi(4)) - 1.0).abs() < 1e-12, "{found:?}");
}

#[test]
fn mirrors_cut_a_throat_of_the_effective_radius_in_parts_of_a_whole_one() {
    // A column of pores of a cubic lattice in the corner of two mirrors: a quarter of the square between four grains.
    let radius = 0.45;
    let walls = |v: &u32| porograin_geometry::triangulation::wall(*v).is_some();
    let found = throats_of(&lattice(2, radius, 0.0), Slip::Symmetry, |passage| {
        let corner = passage.vertices.iter().filter(|v| walls(v)).count() == 2;
        corner.then(|| Conductance::EffectiveRadius.of(passage, 1.0) * passage.shape.length)
    });
    let whole = (((1.0 - PI * radius * radius) / PI).sqrt() + 0.5f64.sqrt() - radius) / 4.0;
    let found: Vec<f64> = found.into_iter().flatten().collect();
    assert_eq!(found.len(), 24);
    assert!(found.iter().all(|g| (g / (0.5 * PI * whole.powi(4)) - 1.0).abs() < 1e-12), "{found:?}");
}

/// Permeability of a simple cubic lattice of solid fraction `c` and pitch 1, `2 R² / (9 c K)` with the drag `K` over
/// that of Stokes (Sangani & Acrivos 1982, Zick & Homsy 1982).
fn exact(c: f64, drag: f64) -> f64 {
    2.0 * (0.75 * c / PI).powf(2.0 / 3.0) / (9.0 * c * drag)
}

#[test]
fn local_drag_of_cubic_lattices_is_near_stokes_flow() {
    let flow = |c: f64| {
        let radius = (0.75 * c / PI).cbrt();
        lattice(4, 0.9999 * radius, 0.0).flow(Conductance::LocalDrag, Slip::Symmetry, 1.0).permeability
    };
    let table = [
        // Nearly alone: the drag of Stokes, 6 pi mu R v, but for a tenth.
        (0.000125, 1.096, 0.03),
        (0.001, 1.212, 0.12),
        (0.008, 1.525, 0.12),
        (0.064, 2.810, 0.12),
        (0.125, 4.292, 0.12),
        (0.216, 7.442, 0.12),
        (0.343, 15.4, 0.12),
        (0.45, 28.1, 0.12),
        (PI / 6.0, 42.1, 0.12),
    ];
    for (c, drag, tolerance) in table {
        let ratio = flow(c) / exact(c, drag);
        assert!((ratio - 1.0).abs() < tolerance, "solid fraction {c}: {ratio}");
    }
}

#[test]
fn local_drag_of_shaken_suspensions_is_near_happels_cell_model() {
    // Happel (1958): K = (3 + 2 g^5)/(3 - 9/2 g + 9/2 g^5 - 3 g^6), g the cube root of the solid fraction.
    // Shaken lattices, so that the mirrors do not thin the grains out. Stokes flow through such lattices at rest is
    // itself up to 16 % off his model, which knows nothing of their order.
    for (c, shake, told) in
        [(0.05f64, 0.25, 0.858), (0.1, 0.2, 0.838), (0.2, 0.13, 0.844), (0.3, 0.08, 0.883)]
    {
        let radius = (0.75 * c / PI).cbrt();
        let g = c.cbrt();
        let drag = (3.0 + 2.0 * g.powi(5)) / (3.0 - 4.5 * g + 4.5 * g.powi(5) - 3.0 * g.powi(6));
        let flow = lattice(6, radius, shake).flow(Conductance::LocalDrag, Slip::Symmetry, 1.0);
        let ratio = flow.permeability / exact(c, drag);
        assert!((ratio - 1.0).abs() < 0.2, "solid fraction {c}: {ratio}");
        // The figures of docs/conductance.md.
        assert!((ratio - told).abs() < 1e-3, "solid fraction {c}: {ratio}");
    }
}

#[test]
fn permeability_does_not_jump_where_the_triangulation_changes() {
    for conductance in [Conductance::LocalDrag, Conductance::hydraulic_radius()] {
        let permeability =
            |shake| lattice(4, 0.45, shake).flow(conductance, Slip::Symmetry, 1.0).permeability;
        let tie = permeability(0.0);
        for (shake, most) in
            [(1e-9, 1e-8), (-1e-9, 1e-8), (1e-6, 1e-5), (-1e-6, 1e-5), (1e-4, 2e-3), (-1e-4, 2e-3)]
        {
            let jump = permeability(shake) / tie - 1.0;
            assert!(jump.abs() < most, "{conductance:?} shaken by {shake}: {jump}");
        }
    }
}

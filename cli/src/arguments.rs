//! The command line.

use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Fluid-saturated granular media, grain by grain and pore by pore.
#[derive(Parser)]
#[command(name = "porograin", version, about, max_term_width = 100)]
#[command(
    after_help = "Start with: porograin new 01-oedometer, then porograin run 01-oedometer/quick.toml\n\
    Exit codes: 0 done, 1 the run failed, 2 bad input."
)]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Subcommand)]
pub enum Command {
    /// Run a case.
    Run(Run),
    /// Go on with a run that stopped, bit for bit as if it had not.
    Resume(Resume),
    /// Say what the numbers of a case imply, or why it cannot be run.
    Check(Check),
    /// List examples, contact laws, measures, boundary rules and packings.
    List,
    /// Copy an example to start from.
    New {
        /// Its name; see `porograin list`.
        example: String,
        /// The new folder; by default the name of the example.
        folder: Option<PathBuf>,
    },
    /// Draw the plots of a run again, or of several runs over each other.
    Plot(Plot),
    /// Write the grains of a run as they are now: x,y,z,r [m], one line per grain, below the domain for a case to go on with.
    Export(Export),
    /// Measure the permeability of a packing, between two faces of its box or through a periodic cell.
    Permeability(Box<Permeability>),
    /// Measure speed on a given packing.
    Bench(Bench),
}

/// `porograin run`.
#[derive(Args)]
pub struct Run {
    /// The case file.
    pub case: PathBuf,
    /// Folder of the results; by default `out/` and the name of the case. A run in it is never overwritten.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Override a value of the case, such as `contact.linear.friction=20` or `stage.load.until.time=1`.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Threads; by default one per core. They are busy all the time a run takes, looking for work. The results are the same bits with any
    /// number.
    #[arg(long, value_name = "N", value_parser = threads, allow_negative_numbers = true)]
    pub threads: Option<usize>,
    /// Stop at this simulated time [s]; `porograin resume` goes on.
    #[arg(long, value_name = "T", value_parser = positive, allow_negative_numbers = true)]
    pub until: Option<f64>,
    /// Say nothing but errors.
    #[arg(long)]
    pub quiet: bool,
    /// Print one JSON object on standard output.
    #[arg(long)]
    pub json: bool,
}

/// `porograin resume`.
#[derive(Args)]
pub struct Resume {
    /// Folder of the run.
    pub folder: PathBuf,
    /// Stop at this simulated time [s].
    #[arg(long, value_name = "T", value_parser = positive, allow_negative_numbers = true)]
    pub until: Option<f64>,
    /// Threads; by default one per core.
    #[arg(long, value_name = "N", value_parser = threads, allow_negative_numbers = true)]
    pub threads: Option<usize>,
    /// Say nothing but errors.
    #[arg(long)]
    pub quiet: bool,
    /// Print one JSON object on standard output.
    #[arg(long)]
    pub json: bool,
}

/// `porograin check`.
#[derive(Args)]
pub struct Check {
    /// The case file.
    pub case: PathBuf,
    /// Override a value of the case.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Print one JSON object on standard output.
    #[arg(long)]
    pub json: bool,
}

/// `porograin plot`.
#[derive(Args)]
pub struct Plot {
    /// Folders of runs; the case of the first says what to draw.
    #[arg(required = true)]
    pub folders: Vec<PathBuf>,
    /// Folder of the pictures; by default that of the first run.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print one JSON object on standard output.
    #[arg(long)]
    pub json: bool,
}

/// `porograin export`.
#[derive(Args)]
pub struct Export {
    /// Folder of the run.
    pub folder: PathBuf,
    /// The new file; it is never overwritten.
    pub grains: PathBuf,
    /// Write the velocities too, beside the flow of a periodic cell that deforms: x,y,z,r,vx,vy,vz.
    #[arg(long)]
    pub velocities: bool,
    /// Print one JSON object on standard output.
    #[arg(long)]
    pub json: bool,
}

/// The region a packing fills.
#[derive(Args)]
#[group(required = true, multiple = false)]
pub struct Region {
    /// A box with walls: x0,y0,z0,x1,y1,z1 [m].
    #[arg(long = "box", value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = corners, allow_hyphen_values = true)]
    pub corners: Option<Corners>,
    /// A cell that repeats along x, y and z after these lengths [m].
    #[arg(long, value_name = "A,B,C", value_parser = period, allow_hyphen_values = true)]
    pub period: Option<Lattice>,
    /// A cell that repeats after three vectors: ax,ay,az,bx,by,bz,cx,cy,cz [m].
    #[arg(long, value_name = "AX,AY,AZ,…,CZ", value_parser = lattice, allow_hyphen_values = true)]
    pub lattice: Option<Lattice>,
}

/// The period vectors of a cell [m].
#[derive(Clone, Copy, Debug)]
pub struct Lattice(pub [[f64; 3]; 3]);

/// The low and the high corner of a box [m].
#[derive(Clone, Copy, Debug)]
pub struct Corners(pub [f64; 3], pub [f64; 3]);

/// `porograin permeability`.
#[derive(Args)]
pub struct Permeability {
    /// The grains: a CSV file of x,y,z,r [m].
    pub grains: PathBuf,
    #[command(flatten)]
    pub region: Region,
    /// Along which axis the water flows; of a periodic cell the whole tensor is measured with any.
    #[arg(long, value_enum, default_value = "z")]
    pub axis: Axis,
    /// What the water does at the four walls along the flow.
    #[arg(long, value_enum, default_value = "symmetry", conflicts_with_all = ["period", "lattice"])]
    pub sides: Sides,
    /// Dynamic viscosity [Pa s].
    #[arg(long, value_name = "MU", default_value = "1e-3", value_parser = positive, allow_negative_numbers = true)]
    pub viscosity: f64,
    /// Pressure at the low face of a box less that at the high face [Pa].
    #[arg(long, value_name = "DP", default_value = "1", value_parser = positive, allow_negative_numbers = true, conflicts_with_all = ["period", "lattice"])]
    pub drop: f64,
    /// How much the pressure falls per length in a periodic cell [Pa/m].
    #[arg(long, value_name = "G", default_value = "1", value_parser = positive, allow_negative_numbers = true, conflicts_with = "corners")]
    pub slope: f64,
    /// How a throat conducts.
    #[arg(long, value_enum, default_value = "local-drag")]
    pub conductance: Conductance,
    /// Calibration factor of the hydraulic radius; by default that of a round tube, 0.5.
    #[arg(long, value_name = "ALPHA", value_parser = positive, allow_negative_numbers = true)]
    pub alpha: Option<f64>,
    /// How the force of the water is shared among the grains; the flow is the same.
    #[arg(long, value_enum, default_value = "reciprocal")]
    pub coupling: Coupling,
    /// How to solve for the pressures.
    #[arg(long, value_enum, default_value = "auto")]
    pub solver: Solver,
    /// Write the force and torque of the water on each grain: fx,fy,fz,tx,ty,tz, one line per grain in input order;
    /// with `--axis all` three times as many numbers, for the flows along x, y and z.
    #[arg(long, value_name = "F.csv")]
    pub forces: Option<PathBuf>,
    /// Places to tell pressure and velocity of the water at: a CSV file of x,y,z [m].
    #[arg(long, value_name = "PLACES.csv", requires = "fields")]
    pub at: Option<PathBuf>,
    /// Write pressure and velocity of the water at these places, one line per place; empty where there is no water.
    #[arg(long, value_name = "F.csv", requires = "at")]
    pub fields: Option<PathBuf>,
    /// Write grains, pores, throats and Voronoi edges for ParaView into this folder; with `--axis all` into its folders x, y
    /// and z.
    #[arg(long, value_name = "DIR")]
    pub vtk: Option<PathBuf>,
    /// Print one JSON object on standard output.
    #[arg(long)]
    pub json: bool,
}

/// `porograin bench`.
#[derive(Args)]
pub struct Bench {
    /// What to measure.
    #[arg(value_enum)]
    pub what: What,
    /// The grains: a CSV file of x,y,z,r [m].
    #[arg(
        long,
        value_name = "GRAINS.csv",
        requires = "corners",
        required_unless_present_any = ["packing", "max"],
        conflicts_with = "packing"
    )]
    pub grains: Option<PathBuf>,
    /// The box of the grains: x0,y0,z0,x1,y1,z1 [m].
    #[arg(long = "box", value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = corners, allow_hyphen_values = true)]
    pub corners: Option<Corners>,
    /// Grains made on the spot: a cloud, grown until it is dense.
    #[arg(long, value_enum, requires = "count")]
    pub packing: Option<Made>,
    /// How many grains to make.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    pub count: Option<usize>,
    /// The largest packing of `solvers`: 2000, 4000, … 256000 and 1000000 grains up to this.
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    pub max: Option<usize>,
    /// Contact law of the dry step.
    #[arg(long, value_enum, default_value = "linear")]
    pub law: Law,
    /// The grains of `dry` flow instead of being at rest: the box is narrowed and heightened at this rate [1/s].
    #[arg(long, value_name = "RATE", value_parser = positive, allow_negative_numbers = true)]
    pub flow: Option<f64>,
    /// How many steps to time.
    #[arg(long, value_name = "N")]
    pub steps: Option<u64>,
    /// Dynamic viscosity [Pa s]; by default such that dt mu / (k rho) = 0.2, dt being that of a dry step.
    #[arg(long, value_name = "MU", value_parser = positive, allow_negative_numbers = true)]
    pub viscosity: Option<f64>,
    /// Relative residual of the pressure solve of `coupled` and `coarse`; by default 1e-6.
    #[arg(long, value_name = "R", value_parser = positive)]
    pub residual: Option<f64>,
    /// Threads.
    #[arg(long, value_name = "N", value_parser = threads, allow_negative_numbers = true, default_value = "1")]
    pub threads: usize,
    /// Print one JSON object on standard output.
    #[arg(long)]
    pub json: bool,
}

/// How grains are made on the spot.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Made {
    Cloud,
}

/// A contact law of the benchmark.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Law {
    Linear,
    HertzMindlin,
}

/// An axis of the box.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Axis {
    X,
    Y,
    Z,
    /// One after the other.
    All,
}

/// What the water does at a wall along the flow.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Sides {
    Symmetry,
    NoSlip,
}

/// How a throat conducts.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Conductance {
    HydraulicRadius,
    EffectiveRadius,
    LocalDrag,
}

/// How the force of the water is shared.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Coupling {
    /// In moment balance in every throat, with torques.
    Reciprocal,
    /// By wetted surface, without torques (Catalano).
    Geometric,
}

/// How to solve for the pressures.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Solver {
    Auto,
    Cholesky,
    Cg,
    GaussSeidel,
}

/// What to time.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum What {
    /// The step without water.
    Dry,
    /// The step with water.
    Coupled,
    /// The step with water on a coarse grid.
    Coarse,
    /// One permeability.
    Permeability,
    /// Every solver on packings of growing size, beside the thesis' Table 5.1.
    Solvers,
}

impl Command {
    /// Whether one JSON object is to go to standard output.
    pub fn json(&self) -> bool {
        match self {
            Command::Run(a) => a.json,
            Command::Resume(a) => a.json,
            Command::Check(a) => a.json,
            Command::Plot(a) => a.json,
            Command::Export(a) => a.json,
            Command::Permeability(a) => a.json,
            Command::Bench(a) => a.json,
            Command::List | Command::New { .. } => false,
        }
    }
}

fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if RANGE.contains(&value) => Ok(value),
        Ok(value) if value > 0.0 => {
            Err(format!("a number between {:e} and {:e} is needed", RANGE.start(), RANGE.end()))
        }
        _ => Err("a number greater than 0 is needed".into()),
    }
}

/// Numbers beyond these would have products that a number cannot hold.
const RANGE: std::ops::RangeInclusive<f64> = 1e-30..=1e30;
/// More threads than this only wait for each other.
const MOST_THREADS: usize = 1024;

fn threads(text: &str) -> Result<usize, String> {
    match at_least_one(text) {
        Ok(count) if count > MOST_THREADS => Err(format!("at most {MOST_THREADS} threads can be used")),
        other => other,
    }
}

fn at_least_one(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if count > 0 => Ok(count),
        _ => Err("a whole number, 1 or more, is needed".into()),
    }
}

fn corners(text: &str) -> Result<Corners, String> {
    let [x0, y0, z0, x1, y1, z1] = numbers(text, "x0,y0,z0,x1,y1,z1")?;
    if x1 <= x0 || y1 <= y0 || z1 <= z0 {
        return Err("the second corner must be above the first along x, y and z".into());
    }
    if ![x1 - x0, y1 - y0, z1 - z0].iter().all(|edge| RANGE.contains(edge)) {
        return Err(format!("edges between {:e} m and {:e} m are needed", RANGE.start(), RANGE.end()));
    }
    Ok(Corners([x0, y0, z0], [x1, y1, z1]))
}

fn numbers<const N: usize>(text: &str, names: &str) -> Result<[f64; N], String> {
    let words: Vec<&str> = text.split(',').map(str::trim).collect();
    let numbers: Vec<f64> = words.iter().filter_map(|word| word.parse().ok()).collect();
    if words.len() != N || numbers.iter().any(|x| !x.is_finite()) {
        return Err(format!("{N} numbers {names} are needed"));
    }
    <[f64; N]>::try_from(numbers).map_err(|_| format!("{N} numbers {names} are needed"))
}

fn period(text: &str) -> Result<Lattice, String> {
    let [a, b, c] = numbers(text, "a,b,c")?;
    if a <= 0.0 || b <= 0.0 || c <= 0.0 {
        return Err("periods greater than 0 are needed".into());
    }
    Ok(Lattice([[a, 0.0, 0.0], [0.0, b, 0.0], [0.0, 0.0, c]]))
}

fn lattice(text: &str) -> Result<Lattice, String> {
    let [ax, ay, az, bx, by, bz, cx, cy, cz] = numbers(text, "ax,ay,az,bx,by,bz,cx,cy,cz")?;
    let volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx);
    let length = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let size = length([ax, ay, az]) * length([bx, by, bz]) * length([cx, cy, cz]);
    if volume.is_nan() || volume.abs() <= 1e-9 * size {
        return Err("the three vectors must span a volume".into());
    }
    Ok(Lattice([[ax, ay, az], [bx, by, bz], [cx, cy, cz]]))
}

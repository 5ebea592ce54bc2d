//! Case files: what a user writes, read straight into the values the simulation works with.
//!
//! A case is TOML with SI numbers; a table is a type, a key is a field, a choice is named by its key
//! (`[contact.linear]`, `flow = { pores = … }`). Unknown keys are refused. Angles are in degrees.

mod build;
mod check;
mod cost;
mod error;
mod grains;
mod implied;
mod material;
mod periodic;
mod prepare;
mod region;
mod source;
mod stage;
mod walls;

pub use build::{Plan, Stage, at};
pub use error::{CaseError, Place, nearest};
pub use implied::{Implied, ImpliedStage, ImpliedWater};
pub use material::{Material, Pair};
pub use periodic::Periodic;
pub use stage::{StageTable, Until, Water as StageWater};
pub use walls::{SHAPES, ShapeTable, WallRule, WallTable};

use crate::boundary::{FACE_NAMES, Face, Signal, Slip, Solid, Water};
use crate::cell::CellRule;
use crate::contact::Law;
use crate::field::Field;
use crate::measure::Region;
use crate::membrane::Membrane;
use crate::model::{FluidModel, TimeStep};
use crate::output::plot::Plot;
use crate::packing::{self, Amount, Grading};
use crate::trouble::On;
use crate::walls::Shape;
use crate::watch::Watch;
use serde::Deserialize;
use source::Source;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A case as written: a domain and its faces, grains, a contact law, water, and the stages to go through.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Case {
    /// One line that says what it is.
    pub title: String,
    /// The box.
    pub domain: DomainTable,
    /// How the grains are made.
    pub grains: GrainsTable,
    /// The law of every contact that has no law of its own.
    pub contact: Law,
    /// What the grains are made of, by name.
    #[serde(default)]
    pub material: BTreeMap<String, Material>,
    /// Laws between two materials.
    #[serde(default)]
    pub pair: Vec<Pair>,
    /// Rules of the six faces; stages may override them.
    #[serde(default)]
    pub face: FaceTable,
    /// Walls besides those at the faces; stages may override how they move.
    #[serde(default)]
    pub wall: Vec<WallTable>,
    /// Parts of the box to measure in.
    #[serde(default)]
    pub region: Vec<RegionTable>,
    /// A flexible membrane around the sample; stages may replace it.
    pub membrane: Option<Membrane>,
    /// What drives the periodic cell; stages may replace it.
    pub cell: Option<CellRule>,
    /// Acceleration [m/s²].
    #[serde(default = "weightless")]
    pub gravity: [Signal; 3],
    /// Cundall's local damping, from 0 to 1; by default 0.2 in dry stages and 0 with water.
    pub damping: Option<f64>,
    /// Whether contacts give back what the time integration takes.
    #[serde(default)]
    pub conserve_energy: bool,
    /// How long a step is.
    #[serde(default)]
    pub time_step: TimeStep,
    /// The water.
    pub fluid: Option<FluidModel>,
    /// What to do, in order.
    pub stage: Vec<StageTable>,
    /// What to do about signs of trouble.
    #[serde(default)]
    pub on: On,
    /// What to write into `history.csv`.
    #[serde(default)]
    pub watch: Vec<Watch>,
    /// Where else to tell of the water.
    #[serde(default)]
    pub field: Vec<Field>,
    /// What else to write, and how often.
    #[serde(default)]
    pub output: OutputTable,
    /// Pictures of the history.
    #[serde(default)]
    pub plot: Vec<Plot>,
    #[serde(skip)]
    source: Source,
    #[serde(skip)]
    folder: PathBuf,
    /// Of the walls, in order.
    #[serde(skip)]
    shapes: Vec<Shape>,
}

/// The box in which it happens.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct DomainTable {
    /// Lengths of the edges [m]; of a cell given by its `periods` how far each goes along its own axis.
    #[serde(default)]
    pub size: [f64; 3],
    /// In place of the size, the vectors of the edges [m]: any period vectors.
    pub periods: Option<[[f64; 3]; 3]>,
    /// Which axes repeat; the others end at walls.
    #[serde(default)]
    pub periodic: Periodic,
    /// The low corner [m].
    #[serde(default)]
    pub origin: [f64; 3],
    /// The grains are discs that move in the plane of x and z, as thick as the box along y.
    #[serde(default)]
    pub discs: bool,
}

/// How the grains are made.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct GrainsTable {
    /// Where they are and how big.
    pub packing: Packing,
    /// Of the solid [kg/m³].
    pub density: f64,
}

/// The choice of initial packing.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Packing {
    /// Grains thrown at random into the box without touching each other.
    Cloud(Cloud),
    /// Equal grains on a lattice.
    Lattice(Lattice),
    /// Grains of a CSV file `x,y,z,r`, lines starting with `#` ignored.
    File(String),
    /// No grain: the first stage lets some fall.
    Empty,
}

/// Names of the packings as case files spell them, and what they are.
pub const PACKINGS: [(&str, &str); 4] = [
    ("cloud", "grains thrown at random into the box, not touching"),
    ("lattice", "equal grains on a simple cubic lattice, or in an arrangement of touching spheres"),
    ("file", "grains of a CSV file x,y,z,r"),
    ("empty", "no grain: the first stage lets some fall"),
];

/// Grains thrown at random into the box. Of `count`, `porosity` and the sizes two are given; the third follows.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Cloud {
    /// How many.
    pub count: Option<usize>,
    /// Void part of the box; 0.75 where it is needed and left out.
    pub porosity: Option<f64>,
    /// Mean radius, of a log-normal grading the median [m].
    pub radius: Option<f64>,
    /// Radii are uniform within `mean (1 ± spread)`: short for a uniform grading.
    pub spread: Option<f64>,
    /// How the sizes are distributed; all equal where nothing is said.
    pub grading: Option<Grading>,
    /// The same number gives the same cloud.
    #[serde(default)]
    pub seed: u64,
    /// Low and high corner of the part of the box that it fills [m]; left out: all of it.
    pub within: Option<[[f64; 3]; 2]>,
}

impl Cloud {
    /// How the sizes are distributed.
    pub fn grading(&self) -> Grading {
        let uniform = || Grading::Uniform { spread: self.spread.unwrap_or(0.0) };
        self.grading.clone().unwrap_or_else(uniform)
    }

    /// How many grains there are and how large; `None` when that is given twice or not at all.
    pub fn amount(&self) -> Option<Amount> {
        let absolute = self.grading.as_ref().is_some_and(Grading::is_absolute);
        let size = if absolute { Some(1.0) } else { self.radius };
        let porosity = self.porosity.unwrap_or(LOOSE);
        match (self.count, size) {
            (Some(count), None) => Some(Amount::Scaled { count, porosity }),
            (Some(count), Some(radius)) if self.porosity.is_none() => Some(Amount::Count { count, radius }),
            (None, Some(radius)) => Some(Amount::Fill { porosity, radius }),
            _ => None,
        }
    }
}

/// Porosity of a cloud when the case does not say.
const LOOSE: f64 = 0.75;

fn weightless() -> [Signal; 3] {
    [0.0; 3].map(Signal::Constant)
}

/// Equal grains on a lattice: simple cubic, spread evenly over the box, or touching spheres in a given arrangement.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Lattice {
    /// How many along x, y and z, spread evenly.
    pub count: Option<[usize; 3]>,
    /// How as many as fit touch each other, from the low corner of the box.
    pub arrangement: Option<packing::Lattice>,
    /// Of every grain [m].
    pub radius: f64,
}

/// A part of the box to measure in.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct RegionTable {
    /// One word, the end of the heads of its columns.
    pub name: String,
    /// Which part.
    pub shape: Region,
}

/// Names of the shapes of regions as case files spell them, and what they are.
pub const REGIONS: [(&str, &str); 3] = [
    ("box", "between a low and a high corner"),
    ("sphere", "around a centre"),
    ("cylinder", "a round bar from a point along an axis, with two ends"),
];

/// Rules of the faces: first `all`, then `sides` (left, right, front, back), then the faces by name.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct FaceTable {
    /// All six faces.
    pub all: Option<FaceRule>,
    /// The four vertical faces.
    pub sides: Option<FaceRule>,
    /// Low x.
    pub left: Option<FaceRule>,
    /// High x.
    pub right: Option<FaceRule>,
    /// Low y.
    pub front: Option<FaceRule>,
    /// High y.
    pub back: Option<FaceRule>,
    /// Low z.
    pub bottom: Option<FaceRule>,
    /// High z.
    pub top: Option<FaceRule>,
}

/// What a case says of a face; what it leaves out stays as it was.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct FaceRule {
    /// How the wall moves; at first fixed.
    pub solid: Option<Solid>,
    /// What the water meets; at first sealed.
    pub water: Option<Water>,
    /// Whether the water sticks; at first symmetry.
    pub slip: Option<Slip>,
    /// Friction angle with the grains [degrees]; at first 0.
    pub friction: Option<f64>,
    /// Whether the grains that touch the wall when this begins stick to it; at first not.
    pub glue: Option<bool>,
}

/// What is written besides the history.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct OutputTable {
    /// When to write grains and pores for ParaView; the end of every stage is always written.
    pub vtk: Option<crate::watch::Every>,
    /// Whether a frame has the contacts, the throats and the Voronoi edges too.
    pub network: bool,
    /// Seconds of wall time between checkpoints; the end of every stage is always one.
    pub checkpoint: f64,
}

impl Default for OutputTable {
    fn default() -> Self {
        OutputTable { vtk: None, network: false, checkpoint: 60.0 }
    }
}

impl FaceTable {
    /// Applies the rules to `faces`.
    pub fn apply(&self, faces: &mut [Face; 6]) {
        for (_, rule, which) in self.rules() {
            for k in which {
                rule.apply(&mut faces[k]);
            }
        }
    }

    /// The rules given, with their key and the faces they speak of, in the order they apply.
    pub fn rules(&self) -> impl Iterator<Item = (&'static str, &FaceRule, std::ops::Range<usize>)> {
        let named = [&self.left, &self.right, &self.front, &self.back, &self.bottom, &self.top];
        let named = named.into_iter().enumerate().map(|(k, rule)| (FACE_NAMES[k], rule, k..k + 1));
        [("all", &self.all, 0..6), ("sides", &self.sides, 0..4)]
            .into_iter()
            .chain(named)
            .filter_map(|(key, rule, which)| Some((key, rule.as_ref()?, which)))
    }
}

impl FaceRule {
    fn apply(&self, face: &mut Face) {
        if let Some(solid) = &self.solid {
            face.solid = solid.clone();
        }
        if let Some(water) = &self.water {
            face.water = water.clone();
        }
        face.slip = self.slip.unwrap_or(face.slip);
        face.friction = self.friction.unwrap_or(face.friction);
        face.glue = self.glue.unwrap_or(face.glue);
    }
}

impl Case {
    /// Reads a case file, applies the overrides `key.key=value` in order, and checks what can be checked without
    /// making the grains.
    ///
    /// # Errors
    /// Whatever is wrong with it, with the place in the file.
    pub fn from_file(path: &Path, overrides: &[String]) -> Result<Self, CaseError> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|e| CaseError::new(format!("cannot read the case {name}: {}", reason(&e))))?;
        let folder = path.parent().map(Path::to_path_buf).unwrap_or_default();
        Self::from_text(&name, text.trim_start_matches(BYTE_ORDER_MARK), &folder, overrides)
    }

    /// The same of a text; files it names are looked up in `folder`.
    pub fn from_text(name: &str, text: &str, folder: &Path, overrides: &[String]) -> Result<Self, CaseError> {
        if text.trim().is_empty() {
            return Err(CaseError::new(format!("the case {name} is empty")));
        }
        let source = Source::new(name, text, overrides)?;
        let mut case: Case = source.read()?;
        case.source = source;
        case.folder = folder.to_owned();
        case.finite()?;
        case.check_periods()?;
        case.check_walls()?;
        case.shapes = case.make_shapes()?;
        case.check()?;
        case.check_shapes()?;
        Ok(case)
    }

    /// The files that grains and walls are read from, as the case names them and where they are.
    pub fn files(&self) -> impl Iterator<Item = (&str, PathBuf)> {
        let grains = match &self.grains.packing {
            Packing::File(file) => Some(file.as_str()),
            _ => None,
        };
        let walls = self.wall.iter().filter_map(WallTable::file);
        grains.into_iter().chain(walls).map(|file| (file, self.whereabouts(file)))
    }

    /// Where a file is: where the case says, or, in the folder of a run, beside it.
    fn whereabouts(&self, file: &str) -> PathBuf {
        let (named, beside) = (self.folder.join(file), Path::new(file).file_name());
        match beside.map(|name| self.folder.join(name)) {
            Some(beside) if !named.exists() && beside.exists() => beside,
            _ => named,
        }
    }

    /// The text of the case as run, overrides applied.
    pub fn text(&self) -> &str {
        &self.source.text
    }

    /// The name of the case: of its file, or of the file's folder when the file is called `case.toml`.
    pub fn name(&self) -> String {
        let path = Path::new(&self.source.name);
        let stem = |p: &Path| p.file_stem().map(|s| s.to_string_lossy().into_owned());
        match stem(path) {
            Some(name) if name != "case" => name,
            _ => path
                .canonicalize()
                .ok()
                .and_then(|p| p.parent().and_then(stem))
                .unwrap_or_else(|| "case".into()),
        }
    }
}

/// What some editors and spreadsheets put before the first word of a text.
pub(crate) const BYTE_ORDER_MARK: char = '\u{feff}';

/// An input-output error as a few words for a sentence.
pub fn reason(error: &std::io::Error) -> String {
    match error.kind() {
        std::io::ErrorKind::NotFound => "there is no such file".into(),
        std::io::ErrorKind::PermissionDenied => "permission denied".into(),
        std::io::ErrorKind::IsADirectory => "it is a folder".into(),
        std::io::ErrorKind::NotADirectory => "a part of the path is not a folder".into(),
        std::io::ErrorKind::InvalidData => "it is not text".into(),
        std::io::ErrorKind::AlreadyExists => "it is there already, and is never overwritten".into(),
        _ => error.to_string(),
    }
}

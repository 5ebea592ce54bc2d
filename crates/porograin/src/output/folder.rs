//! The folder of a run: `case.toml`, `history.csv`, `vtk/`, `checkpoint`, `summary.json`.

use super::plot::{History, Plot, draw};
use super::restart::{Checkpoint, RestartError};
use super::summary::Summary;
use super::table::Table;
use super::{frame, replace, vtk};
use crate::case::{Case, reason};
use crate::field::{self, Field};
use crate::progress::Progress;
use crate::state::State;
use crate::watch::{Every, Measure, Names, Snapshot, Watch};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};

/// The folder of a run, open for writing.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    case_text: String,
    watches: Vec<Watch>,
    measures: Vec<Measure>,
    /// What some measures have a column for each of.
    names: Names,
    vtk: Option<Every>,
    network: bool,
    plots: Vec<Plot>,
    history: Table,
    fields: Vec<(Field, Table)>,
    written: Written,
    /// What `summary.json` says.
    pub summary: Summary,
    /// Keeps other processes out as long as it is open.
    _lock: File,
}

/// What a run writes, besides frames.
const OURS: [&str; 5] = ["case.toml", "history.csv", "checkpoint", "summary.json", "vtk"];
/// The first words of every `case.toml` that a run writes.
const SIGNATURE: &str = "# Run by porograin ";

/// How much of each file belongs to the run up to a checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Written {
    /// Bytes of the history.
    pub history: u64,
    /// The interval of each watch that has its row.
    pub rows: Vec<Option<u64>>,
    /// Bytes of the table of each field, and the interval that has its rows.
    pub fields: Vec<(u64, Option<u64>)>,
    /// Frames for ParaView.
    pub frames: Vec<Frame>,
    /// The interval that has its frame.
    pub frame: Option<u64>,
}

/// A frame for ParaView.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// [s]
    pub time: f64,
    /// Whether it has pores.
    pub pores: bool,
    /// Whether it has the grid of coarse water.
    pub grid: bool,
    /// Whether it has walls that the case adds.
    pub walls: bool,
    /// Whether it has a membrane.
    pub membrane: bool,
    /// Whether it has throats and Voronoi edges.
    pub network: bool,
}

/// Why a folder cannot be used: one sentence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FolderError(pub String);

impl fmt::Display for FolderError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for FolderError {}

impl Folder {
    /// Makes the folder `path` for a run of `case`; nothing in it is ever overwritten.
    ///
    /// # Errors
    /// When it holds a run already, or cannot be written.
    pub fn create(path: &Path, case: &Case) -> Result<Self, FolderError> {
        let shown = path.display();
        if OURS.iter().any(|name| path.join(name).exists()) && !never_began(path) {
            return Err(FolderError(format!(
                "{shown} holds a run already: go on with it (porograin resume {shown}), or choose another folder \
                 with --out"
            )));
        }
        if never_began(path) {
            // A run that has only just begun holds it.
            lock(path)?;
        }
        let failed = |e: io::Error| FolderError(format!("cannot write into {shown}: {}", reason(&e)));
        fs::create_dir_all(path.join("vtk")).map_err(failed)?;
        // A case from the folder of another run is signed already.
        let unsigned = match case.text().split_once('\n') {
            Some((first, rest)) if first.starts_with(SIGNATURE) => rest,
            _ => case.text(),
        };
        let case_text = format!("{SIGNATURE}{}.\n{unsigned}", env!("CARGO_PKG_VERSION"));
        replace(&path.join("case.toml"), case_text.as_bytes()).map_err(failed)?;
        let lock = lock(path)?;
        for (named, found) in case.files() {
            let name = Path::new(named).file_name().unwrap_or(named.as_ref());
            if OURS.iter().any(|ours| name == *ours) {
                return Err(FolderError(format!(
                    "the run keeps a copy of {named}, but writes a file of that name itself: rename it"
                )));
            }
            keep(&found, &path.join(name))?;
        }
        let measures = measures(&case.watch);
        let history =
            Table::create(&path.join("history.csv"), &heads(&measures, &case.names())).map_err(failed)?;
        let mut fields = Vec::new();
        for field in &case.field {
            let heads: Vec<String> =
                ["stage"].iter().chain(&field::HEADS).map(|&head| head.to_owned()).collect();
            let table = Table::create(&path.join(table_of(field)), &heads).map_err(failed)?;
            fields.push((field.clone(), table));
        }
        let written = Written {
            history: history.length(),
            rows: vec![None; case.watch.len()],
            fields: fields.iter().map(|(_, table)| (table.length(), None)).collect(),
            ..Written::default()
        };
        Ok(Folder {
            path: path.to_owned(),
            case_text,
            watches: case.watch.clone(),
            measures,
            names: case.names(),
            vtk: case.output.vtk,
            network: case.output.network,
            plots: case.plot.clone(),
            history,
            fields,
            written,
            summary: Summary::new(&case.title),
            _lock: lock,
        })
    }

    /// Opens the folder of a run that stopped: its case, and the state and progress of its checkpoint. What was
    /// written after the checkpoint is forgotten.
    ///
    /// # Errors
    /// When there is no run, or its files are damaged or belong to another case.
    pub fn reopen(path: &Path) -> Result<(Self, Case, State, Progress), FolderError> {
        let shown = path.display();
        let case_path = path.join("case.toml");
        let case_text = fs::read_to_string(&case_path).map_err(|e| {
            FolderError(format!("{shown} holds no run: cannot read case.toml: {}", reason(&e)))
        })?;
        let case = Case::from_text(&case_path.display().to_string(), &case_text, path, &[])
            .map_err(|e| FolderError(e.to_string()))?;
        let lock = lock(path)?;
        let checkpoint_path = path.join("checkpoint");
        let Checkpoint { state, progress, written } = Checkpoint::read(&checkpoint_path, &case_text)
            .map_err(|e| FolderError(format!("cannot resume from {}: {e}", checkpoint_path.display())))?;
        let history = Table::reopen(&path.join("history.csv"), written.history)
            .map_err(|e| FolderError(format!("cannot go on writing {shown}/history.csv: {}", reason(&e))))?;
        let mut fields = Vec::new();
        for (field, &(length, _)) in case.field.iter().zip(&written.fields) {
            let table = Table::reopen(&path.join(table_of(field)), length).map_err(|e| {
                FolderError(format!("cannot go on writing {shown}/{}: {}", table_of(field), reason(&e)))
            })?;
            fields.push((field.clone(), table));
        }
        let summary = fs::read_to_string(path.join("summary.json"))
            .ok()
            .and_then(|text| serde_json::from_str(&text).ok())
            .unwrap_or_else(|| {
                let warning = "summary.json was lost or damaged: what it said of earlier stages is gone";
                Summary { warnings: vec![warning.into()], ..Summary::new(&case.title) }
            });
        let folder = Folder {
            path: path.to_owned(),
            case_text,
            measures: measures(&case.watch),
            names: case.names(),
            watches: case.watch.clone(),
            vtk: case.output.vtk,
            network: case.output.network,
            plots: case.plot.clone(),
            history,
            fields,
            written,
            summary,
            _lock: lock,
        };
        let failed = |e: io::Error| FolderError(format!("cannot write into {shown}/vtk: {}", reason(&e)));
        folder.forget_later_frames().map_err(failed)?;
        folder.write_series().map_err(failed)?;
        Ok((folder, case, state, progress))
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Writes what is due after a step: a row of the history, a frame. At the end of a stage everything is due.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn record(&mut self, now: &Snapshot, stage_end: bool) -> Result<(), (PathBuf, io::Error)> {
        let (time, step) = (now.state.time, now.state.step);
        let mut due = Vec::new();
        for (watch, last) in self.watches.iter().zip(&mut self.written.rows) {
            let interval = Some(watch.every.interval(time, step));
            if stage_end || *last != interval {
                *last = interval;
                due.extend(&watch.measures);
            }
        }
        if !due.is_empty() {
            let mut cells = vec![Some(step as f64), Some(time)];
            for measure in &self.measures {
                let columns = measure.columns(&self.names).len();
                match measure.evaluate(now).filter(|_| due.contains(measure)) {
                    Some(values) => cells.extend(values.into_iter().map(Some)),
                    None => cells.extend(vec![None; columns]),
                }
            }
            let path = || self.path.join("history.csv");
            self.history.row(now.stage, &cells).map_err(|e| (path(), e))?;
            self.written.history = self.history.length();
        }
        for ((field, table), (length, last)) in self.fields.iter_mut().zip(&mut self.written.fields) {
            let interval = Some(field.every.interval(time, step));
            if !stage_end && *last == interval {
                continue;
            }
            *last = interval;
            let path = || self.path.join(table_of(field));
            for row in field.rows(now).unwrap_or_default() {
                table.row(now.stage, &row).map_err(|e| (path(), e))?;
            }
            *length = table.length();
        }
        let interval = self.vtk.map(|every| every.interval(time, step));
        if stage_end || (interval.is_some() && self.written.frame != interval) {
            self.written.frame = interval;
            self.frame(now)?;
        }
        Ok(())
    }

    /// Writes the checkpoint and the summary.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn checkpoint(&self, state: &State, progress: &Progress) -> Result<(), (PathBuf, io::Error)> {
        let checkpoint =
            Checkpoint { state: state.clone(), progress: progress.clone(), written: self.written.clone() };
        let path = self.path.join("checkpoint");
        checkpoint.write(&path, &self.case_text).map_err(|e| match e {
            RestartError::File(reason) => (path, io::Error::other(reason)),
            other => (path, io::Error::other(other)),
        })?;
        self.write_summary()
    }

    /// Writes `summary.json`.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write_summary(&self) -> Result<(), (PathBuf, io::Error)> {
        let path = self.path.join("summary.json");
        let text =
            serde_json::to_string_pretty(&self.summary).map_err(|e| (path.clone(), io::Error::other(e)))?;
        replace(&path, format!("{text}\n").as_bytes()).map_err(|e| (path, e))
    }

    /// Writes a file beside the others.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, name: &str, bytes: &[u8]) -> Result<(), (PathBuf, io::Error)> {
        let path = self.path.join(name);
        replace(&path, bytes).map_err(|e| (path, e))
    }

    /// Draws the pictures of the history as it stands.
    ///
    /// # Errors
    /// When a file cannot be read or written.
    pub fn draw(&self) -> Result<(), (PathBuf, io::Error)> {
        if self.plots.is_empty() {
            return Ok(());
        }
        let path = self.path.join("history.csv");
        let history = History::read(&path).map_err(|e| (path, e))?;
        let runs = [(String::new(), history)];
        draw(&self.plots, &runs).iter().try_for_each(|(name, picture)| self.write(name, picture.as_bytes()))
    }

    fn frame(&mut self, now: &Snapshot) -> Result<(), (PathBuf, io::Error)> {
        let number = self.written.frames.len();
        let put = |kind: Kind, bytes: Vec<u8>| {
            let path = self.path.join("vtk").join(kind.file(number));
            replace(&path, &bytes).map_err(|e| (path, e))
        };
        put(Kind::Grains, frame::grains(now))?;
        if self.network {
            put(Kind::Contacts, frame::contacts(now))?;
        }
        let (pores, grid) = (frame::pores(now), frame::grid(now));
        let (walls, membrane) = (frame::walls(now), frame::membrane(now));
        let network = self.network.then(|| frame::network(now)).flatten();
        let frame = Frame {
            time: now.state.time,
            pores: pores.is_some(),
            grid: grid.is_some(),
            walls: walls.is_some(),
            membrane: membrane.is_some(),
            network: network.is_some(),
        };
        if let Some(mesh) = pores {
            put(Kind::Pores, vtk::mesh(&mesh))?;
        }
        if let Some(mesh) = grid {
            put(Kind::Grid, vtk::mesh(&mesh))?;
        }
        if let Some(bytes) = walls {
            put(Kind::Walls, bytes)?;
        }
        if let Some(bytes) = membrane {
            put(Kind::Membrane, bytes)?;
        }
        if let Some([throats, edges]) = network {
            put(Kind::Throats, throats)?;
            put(Kind::Edges, edges)?;
        }
        self.written.frames.push(frame);
        self.write_series().map_err(|e| (self.path.join("vtk"), e))
    }

    fn write_series(&self) -> io::Result<()> {
        for kind in KINDS {
            let files: Vec<(f64, String)> = (self.written.frames.iter().enumerate())
                .filter(|(_, frame)| kind.is_in(frame, self.network))
                .map(|(k, frame)| (frame.time, kind.file(k)))
                .collect();
            let path = self.path.join("vtk").join(kind.series());
            if files.is_empty() {
                match fs::remove_file(&path) {
                    Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
                    _ => continue,
                }
            }
            let text = vtk::series(files.iter().map(|(time, file)| (*time, file.as_str())));
            replace(&path, text.as_bytes())?;
        }
        Ok(())
    }

    fn forget_later_frames(&self) -> io::Result<()> {
        let known: Vec<String> = (self.written.frames.iter().enumerate())
            .flat_map(|(k, _)| KINDS.map(|kind| kind.file(k)))
            .collect();
        for entry in fs::read_dir(self.path.join("vtk"))? {
            let entry = entry?;
            let name = entry.file_name().to_string_lossy().into_owned();
            let ours = KINDS.iter().any(|kind| kind.owns(&name));
            if ours && !known.contains(&name) {
                fs::remove_file(entry.path())?;
            }
        }
        Ok(())
    }
}

/// The name of the table of a field.
fn table_of(field: &Field) -> String {
    format!("field-{}.csv", field.name)
}

/// All series of frames.
const KINDS: [Kind; 8] = [
    Kind::Grains,
    Kind::Contacts,
    Kind::Pores,
    Kind::Grid,
    Kind::Walls,
    Kind::Membrane,
    Kind::Throats,
    Kind::Edges,
];

/// The state at the last checkpoint of the run in the folder `path`; nothing is changed there.
///
/// # Errors
/// When there is no run, or its checkpoint is damaged.
pub fn last_state(path: &Path) -> Result<State, FolderError> {
    let shown = path.display();
    let case_text = fs::read_to_string(path.join("case.toml"))
        .map_err(|e| FolderError(format!("{shown} holds no run: cannot read case.toml: {}", reason(&e))))?;
    let checkpoint = path.join("checkpoint");
    Checkpoint::read(&checkpoint, &case_text)
        .map(|read| read.state)
        .map_err(|e| FolderError(format!("cannot read {}: {e}", checkpoint.display())))
}

/// A series of frames.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Grains,
    Contacts,
    Pores,
    Grid,
    Walls,
    Membrane,
    Throats,
    Edges,
}

impl Kind {
    fn parts(self) -> (&'static str, &'static str) {
        match self {
            Kind::Grains => ("grains_", ".vtp"),
            Kind::Contacts => ("contacts_", ".vtp"),
            Kind::Pores => ("pores_", ".vtu"),
            Kind::Grid => ("grid_", ".vtu"),
            Kind::Walls => ("walls_", ".vtp"),
            Kind::Membrane => ("membrane_", ".vtp"),
            Kind::Throats => ("throats_", ".vtp"),
            Kind::Edges => ("edges_", ".vtp"),
        }
    }

    fn is_in(self, frame: &Frame, network: bool) -> bool {
        match self {
            Kind::Grains => true,
            Kind::Contacts => network,
            Kind::Pores => frame.pores,
            Kind::Grid => frame.grid,
            Kind::Walls => frame.walls,
            Kind::Membrane => frame.membrane,
            Kind::Throats | Kind::Edges => frame.network,
        }
    }

    fn file(self, number: usize) -> String {
        let (start, end) = self.parts();
        format!("{start}{number:06}{end}")
    }

    fn owns(self, name: &str) -> bool {
        let (start, end) = self.parts();
        name.strip_prefix(start)
            .and_then(|rest| rest.strip_suffix(end))
            .is_some_and(|digits| digits.parse::<u64>().is_ok())
    }

    fn series(self) -> &'static str {
        match self {
            Kind::Grains => "grains.pvd",
            Kind::Contacts => "contacts.pvd",
            Kind::Pores => "pores.pvd",
            Kind::Grid => "grid.pvd",
            Kind::Walls => "walls.pvd",
            Kind::Membrane => "membrane.pvd",
            Kind::Throats => "throats.pvd",
            Kind::Edges => "edges.pvd",
        }
    }
}

/// Locks the run in the folder `path` against other processes, until the file is closed.
fn lock(path: &Path) -> Result<File, FolderError> {
    let (file, shown) = (path.join("case.toml"), path.display());
    let held = File::open(&file)
        .map_err(|e| FolderError(format!("cannot read {}: {}", file.display(), reason(&e))))?;
    match held.try_lock() {
        Err(TryLockError::WouldBlock) => Err(FolderError(format!(
            "{shown} belongs to a run that is going on: wait for it, or stop it first"
        ))),
        // A file system without locks is no reason to refuse.
        _ => Ok(held),
    }
}

/// Copies a file that the case names into the folder of its run; nothing is overwritten.
fn keep(from: &Path, to: &Path) -> Result<(), FolderError> {
    let failed =
        |path: &Path, e: &io::Error| FolderError(format!("cannot copy {}: {}", path.display(), reason(e)));
    let bytes = fs::read(from).map_err(|e| failed(from, &e))?;
    match fs::read(to) {
        Ok(there) if there == bytes => Ok(()),
        Ok(_) => Err(failed(to, &io::ErrorKind::AlreadyExists.into())),
        Err(_) => replace(to, &bytes).map_err(|e| failed(to, &e)),
    }
}

/// Whether a run was killed here before its first checkpoint: there is nothing to lose.
fn never_began(path: &Path) -> bool {
    let signed = fs::read_to_string(path.join("case.toml")).is_ok_and(|text| text.starts_with(SIGNATURE));
    signed && !path.join("checkpoint").exists()
}

fn measures(watches: &[Watch]) -> Vec<Measure> {
    let mut all: Vec<Measure> = watches.iter().flat_map(|w| w.measures.iter().copied()).collect();
    all.sort();
    all.dedup();
    all
}

fn heads(measures: &[Measure], names: &Names) -> Vec<String> {
    let first = ["stage", "step [-]", "time [s]"].map(str::to_owned);
    first.into_iter().chain(measures.iter().flat_map(|m| m.columns(names))).collect()
}

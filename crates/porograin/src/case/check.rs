//! Checks of a case that need no grains: ranges of numbers, and tables that contradict each other.

mod water;

use super::{Case, CaseError, FaceTable, StageWater, nearest};
use crate::boundary::{Signal, Solid, Water};
use crate::contact::{Law, Restitution};
use crate::field;
use crate::model::{Flow, TimeStep};
use crate::output::curve::{CURVES, Curve};
use crate::output::plot;
use crate::pores::PointWater;
use crate::walls::Motion;
use crate::watch::Every;

/// Boxes beyond these lengths [m] would have volumes and conductances that a number cannot hold.
const LENGTHS: std::ops::RangeInclusive<f64> = 1e-30..=1e30;

/// A range a number has to be in.
#[derive(Clone, Copy)]
pub(super) enum Range {
    Positive,
    NotNegative,
    Part,
    Share,
    Poisson,
    Angle,
    Between,
}

impl Case {
    /// All numbers are numbers.
    pub(super) fn finite(&self) -> Result<(), CaseError> {
        match self.source.not_finite() {
            Some(path) => self.refuse(&path, format!("`{path}` is not a finite number")),
            None => Ok(()),
        }
    }

    /// Everything that can be said against the case without making the grains.
    pub(super) fn check(&self) -> Result<(), CaseError> {
        for (k, name) in ["x", "y", "z"].into_iter().enumerate() {
            let path = format!("domain.size.{k}");
            self.number(&path, self.domain.size[k], Range::Positive)
                .map_err(|e| CaseError { sentence: format!("{} along {name}", e.sentence), ..e })?;
            if !LENGTHS.contains(&self.domain.size[k]) {
                let (least, most) = (LENGTHS.start(), LENGTHS.end());
                let sentence = format!("the box is not between {least:e} m and {most:e} m long along {name}");
                return Err(self.source.fault(&path, sentence));
            }
        }
        self.check_packing()?;
        self.law("contact", &self.contact)?;
        self.check_materials()?;
        self.check_regions()?;
        self.optional("damping", self.damping, Range::Part)?;
        self.time_step("time-step", &self.time_step)?;
        self.faces("face", &self.face)?;
        if let Some(rule) = &self.cell {
            self.cell_rule("cell", rule)?;
        }
        if let Some(fluid) = &self.fluid {
            self.number("fluid.viscosity", fluid.viscosity, Range::Positive)?;
            self.number("fluid.density", fluid.density, Range::Positive)?;
            self.optional("fluid.bulk-modulus", fluid.bulk_modulus, Range::Positive)?;
            self.flow("fluid.flow", &fluid.flow)?;
        }
        self.check_discs()?;
        self.signals("gravity", &self.gravity)?;
        self.check_stages()?;
        for (k, watch) in self.watch.iter().enumerate() {
            self.every(&format!("watch.{k}.every"), &watch.every)?;
        }
        self.fields()?;
        if let Some(every) = &self.output.vtk {
            self.every("output.vtk", every)?;
        }
        self.plots()?;
        self.number("output.checkpoint", self.output.checkpoint, Range::NotNegative)
    }

    /// Discs live in a plane, and the pores between them are no tetrahedra.
    fn check_discs(&self) -> Result<(), CaseError> {
        if !self.domain.discs {
            return Ok(());
        }
        for (k, stage) in self.stage.iter().enumerate() {
            let model = self.model(k, 0.0);
            let place = |key: &str, own: bool| if own { format!("stage.{k}.{key}") } else { key.to_owned() };
            if self.gravity_of(k)[1] != Signal::Constant(0.0) {
                return self.refuse(
                    &place("gravity", stage.gravity.is_some()),
                    "discs move in the plane of x and z: `gravity` must have no part along y",
                );
            }
            if let Some(Flow::Pores(_)) = model.fluid.map(|fluid| fluid.flow) {
                let own = matches!(&stage.fluid, Some(StageWater::Other(liquid)) if liquid.flow.is_some());
                return Err(self
                    .source
                    .fault(
                        &place("fluid", own),
                        "pores are made by spheres, but `domain.discs` asks for discs",
                    )
                    .hint("compute the flow on a grid: flow = { darcy = {} }"));
            }
        }
        Ok(())
    }

    fn check_stages(&self) -> Result<(), CaseError> {
        if self.stage.is_empty() {
            return self.refuse("stage", "the case has no stage: there is nothing to do");
        }
        for (k, stage) in self.stage.iter().enumerate() {
            let at = |key: &str| format!("stage.{k}.{key}");
            if let Some(first) = self.stage[..k].iter().position(|other| other.name == stage.name) {
                return self.refuse(
                    &at("name"),
                    format!("stages {} and {} are both called `{}`", first + 1, k + 1, stage.name),
                );
            }
            if let Some(law) = &stage.contact {
                self.law(&at("contact"), law)?;
            }
            self.optional(&at("friction"), stage.friction, Range::Angle)?;
            self.optional(&at("damping"), stage.damping, Range::Part)?;
            if let Some(gravity) = &stage.gravity {
                self.signals(&at("gravity"), gravity)?;
            }
            self.faces(&at("face"), &stage.face)?;
            if let Some(rule) = &stage.cell {
                self.cell_rule(&at("cell"), rule)?;
            }
            if let Some(step) = &stage.time_step {
                self.time_step(&at("time-step"), step)?;
            }
            match &stage.fluid {
                Some(StageWater::Present(true)) | Some(StageWater::Other(_)) if self.fluid.is_none() => {
                    return self.refuse(
                        &at("fluid"),
                        format!("the stage `{}` wants water, but the case has no [fluid]", stage.name),
                    );
                }
                Some(StageWater::Other(liquid)) => {
                    self.optional(&at("fluid.viscosity"), liquid.viscosity, Range::Positive)?;
                    self.optional(&at("fluid.density"), liquid.density, Range::Positive)?;
                    self.optional(&at("fluid.bulk-modulus"), liquid.bulk_modulus, Range::Positive)?;
                    if let Some(flow) = &liquid.flow {
                        self.flow(&at("fluid.flow"), flow)?;
                    }
                }
                _ => {}
            }
            self.until(k)?;
            self.rain(k)?;
            self.growth(k)?;
            self.sealed(k)?;
            self.glue(k)?;
            self.water_in_periods(k)?;
            self.membrane(k)?;
            self.inflow(k)?;
            if stage.consolidation && self.model(k, 0.0).fluid.is_none() {
                return self.refuse(
                    &at("consolidation"),
                    format!("the stage `{}` is dry: there is no consolidation to compare", stage.name),
                );
            }
        }
        Ok(())
    }

    fn until(&self, k: usize) -> Result<(), CaseError> {
        let at = |key: &str| format!("stage.{k}.until.{key}");
        let name = &self.stage[k].name;
        let until = &self.stage[k].until;
        self.optional(&at("time"), until.time, Range::Positive)?;
        self.optional(&at("unbalanced"), until.unbalanced, Range::Positive)?;
        self.optional(&at("stress-error"), until.stress_error, Range::Positive)?;
        self.optional(&at("max-time"), until.max_time, Range::Positive)?;
        if until.time.is_none() && until.steps.is_none() && !until.waits() {
            return Err(self
                .source
                .fault(&format!("stage.{k}.until"), format!("the stage `{name}` never ends"))
                .hint("give time, steps, unbalanced or stress-error"));
        }
        if let Some(compact) = self.stage[k].compact {
            let place = |key: &str| format!("stage.{k}.compact.{key}");
            self.number(&place("porosity"), compact.porosity, Range::Between)?;
            self.number(&place("factor"), compact.factor, Range::Between)?;
            if !until.waits() || until.time.is_some() || until.steps.is_some() {
                return Err(self
                    .source
                    .fault(
                        &format!("stage.{k}.until"),
                        format!(
                            "the stage `{name}` compacts to a porosity, so that it must wait for rest, not for a time or a \
                             number of steps"
                        ),
                    )
                    .hint("until = { unbalanced = 1e-2, stress-error = 0.02, max-steps = 500000 }, say"));
            }
        }
        let servo = |face: &crate::boundary::Face| matches!(face.solid, Solid::Servo { .. });
        let model = self.model(k, 0.0);
        let held = model.cell.stress.given().next().is_some();
        let grows = self.stage[k].grow.is_some_and(|grow| grow.stress.is_some());
        let pushed = model.walls.iter().any(|wall| matches!(wall.motion, Motion::Servo { .. }));
        if until.stress_error.is_some() && !held && !grows && !pushed && !model.faces.iter().any(servo) {
            return self.refuse(
                &at("stress-error"),
                format!("the stage `{name}` waits for the stress of servo walls, but no face has one"),
            );
        }
        Ok(())
    }

    /// An inflow needs a grid, and an opening unless the water is compressible.
    fn inflow(&self, k: usize) -> Result<(), CaseError> {
        let model = self.model(k, 0.0);
        let Some(fluid) = &model.fluid else { return Ok(()) };
        let source = match &fluid.flow {
            Flow::Pores(pores) => pores.point.iter().any(|p| matches!(p.water, PointWater::Source(_))),
            Flow::Darcy(_) => false,
        };
        if !source && !model.faces.iter().any(|face| matches!(face.water, Water::Inflow(_))) {
            return Ok(());
        }
        let name = &self.stage[k].name;
        if fluid.bulk_modulus.is_none() && !model.has_pressure() {
            let sentence = format!(
                "in the stage `{name}` water comes in at a given rate, but it is incompressible and no face has a pressure"
            );
            return Err(self
                .source
                .fault(&format!("stage.{k}"), sentence)
                .hint("give another face water = { pressure = 0.0 }"));
        }
        Ok(())
    }

    /// Incompressible water in a box without an opening lets no wall move.
    fn sealed(&self, k: usize) -> Result<(), CaseError> {
        let model = self.model(k, 0.0);
        let Some(fluid) = &model.fluid else { return Ok(()) };
        if fluid.bulk_modulus.is_some() || model.has_pressure() {
            return Ok(());
        }
        for (index, face) in model.faces.iter().enumerate() {
            let name = crate::boundary::FACE_NAMES[index];
            let path = || {
                [format!("stage.{k}.face"), "face".into()]
                    .into_iter()
                    .flat_map(|table| [name, "sides", "all"].map(|key| format!("{table}.{key}.solid")))
                    .find(|path| self.source.has(path))
                    .unwrap_or(format!("stage.{k}"))
            };
            let moves = match &face.solid {
                Solid::Fixed => false,
                Solid::Servo { .. } => true,
                Solid::Moving { velocity } => velocity[index / 2] != Signal::Constant(0.0),
            };
            if moves {
                return Err(self
                    .source
                    .fault(
                        &path(),
                        format!(
                            "in the stage `{}` the {name} wall moves, but the water is incompressible and every face \
                             is sealed",
                            self.stage[k].name
                        ),
                    )
                    .hint("give a face water = { pressure = 0.0 }, or fix the wall"));
            }
        }
        Ok(())
    }

    /// Fields have names of their own, and places.
    fn fields(&self) -> Result<(), CaseError> {
        for (k, field) in self.field.iter().enumerate() {
            let at = |key: &str| format!("field.{k}.{key}");
            let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
            if field.name.is_empty() || !field.name.chars().all(plain) {
                let sentence =
                    format!("a field is called by one word of letters and digits, not `{}`", field.name);
                return self.refuse(&at("name"), sentence);
            }
            if self.field[..k].iter().any(|other| other.name == field.name) {
                return self.refuse(&at("name"), format!("two fields are called `{}`", field.name));
            }
            let counts = field.at.counts();
            let count = counts.iter().fold(1, |all: usize, &count| all.saturating_mul(count));
            if !(1..=field::MOST).contains(&count) {
                let sentence = format!(
                    "the field `{}` has {count} places, but it takes 1 to {}",
                    field.name,
                    field::MOST
                );
                return self.refuse(&at("at"), sentence);
            }
            self.every(&at("every"), &field.every)?;
        }
        Ok(())
    }

    fn plots(&self) -> Result<(), CaseError> {
        let columns = plot::columns(&self.watch, &self.names());
        let known = |path: &str, word: &str, noun: &str, all: &[&str]| {
            if all.contains(&word) {
                return Ok(());
            }
            let guess = nearest(word, all.iter().copied());
            let guess = guess.map_or(String::new(), |near| format!("did you mean {near}? "));
            Err(self
                .source
                .fault(path, format!("{noun} `{word}`"))
                .hint(format!("{guess}there is: {}", all.join(", "))))
        };
        let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
        let stages: Vec<&str> = self.stage.iter().map(|s| s.name.as_str()).collect();
        for (k, plot) in self.plot.iter().enumerate() {
            let at = |key: &str| format!("plot.{k}.{key}");
            let name = plot.file.strip_suffix(".svg").unwrap_or_default();
            if name.is_empty() || name.contains(['/', '\\']) || plot.file == "consolidation.svg" {
                return self.refuse(
                    &at("file"),
                    format!("a picture is called by a name such as \"curves.svg\", not \"{}\"", plot.file),
                );
            }
            if plot.y.is_empty() == plot.curves.is_empty() {
                return self.refuse(&at("y"), "a plot draws columns `y`, or `curves`: give one of the two");
            }
            for (j, name) in plot.curves.iter().enumerate() {
                let path = at(&format!("curves.{j}"));
                known(&path, name, "there is no curve", &CURVES)?;
                if let Some(curve) = Curve::named(name)
                    && curve.columns.iter().any(|column| !columns.contains(&column.as_str()))
                {
                    let measure = curve.measure.name();
                    return Err(self
                        .source
                        .fault(&path, format!("no watch measures the curve `{name}`"))
                        .hint(format!("a watch needs the measure `{measure}`")));
                }
            }
            known(&at("x"), &plot.x, "no watch measures the column", &columns)?;
            for (j, column) in plot.y.iter().enumerate() {
                known(&at(&format!("y.{j}")), column, "no watch measures the column", &columns)?;
            }
            for (j, stage) in plot.stage.iter().enumerate() {
                known(&at(&format!("stage.{j}")), stage, "there is no stage", &stages)?;
            }
        }
        Ok(())
    }

    fn faces(&self, table: &str, faces: &FaceTable) -> Result<(), CaseError> {
        self.faces_are_walled(table, faces)?;
        for (key, rule, _) in faces.rules() {
            let at = |inner: &str| format!("{table}.{key}.{inner}");
            self.optional(&at("friction"), rule.friction, Range::Angle)?;
            match &rule.solid {
                Some(Solid::Servo { stress, mass, speed }) => {
                    self.signal_in_time(&at("solid.servo.stress"), stress)?;
                    self.optional(&at("solid.servo.mass"), *mass, Range::Positive)?;
                    self.optional(&at("solid.servo.speed"), *speed, Range::Positive)?;
                }
                Some(Solid::Moving { velocity }) => {
                    self.signals(&at("solid.moving.velocity"), velocity)?;
                }
                Some(Solid::Fixed) | None => {}
            }
            match &rule.water {
                Some(Water::Pressure(signal)) => self.signal(&at("water.pressure"), signal)?,
                Some(Water::Inflow(signal)) => self.signal(&at("water.inflow"), signal)?,
                Some(Water::Sealed) | None => {}
            }
        }
        Ok(())
    }

    pub(super) fn signals(&self, path: &str, signals: &[Signal; 3]) -> Result<(), CaseError> {
        let mut axes = signals.iter().enumerate();
        axes.try_for_each(|(axis, signal)| self.signal_in_time(&format!("{path}.{axis}"), signal))
    }

    /// Walls and cells move as a whole: what they do is the same everywhere.
    pub(super) fn signal_in_time(&self, path: &str, signal: &Signal) -> Result<(), CaseError> {
        if signal.varies_in_space() {
            return self.refuse(
                path,
                "walls and cells move as a whole: only t may stand in this formula, not x, y or z",
            );
        }
        let first = signal.at(0.0);
        if !first.is_finite() {
            let sentence =
                format!("the formula has no finite value at t = 0, where the stage begins: it gives {first}");
            return self.refuse(path, sentence);
        }
        self.signal(path, signal)
    }

    pub(super) fn signal(&self, path: &str, signal: &Signal) -> Result<(), CaseError> {
        match signal {
            Signal::Constant(_) | Signal::Expression(_) => Ok(()),
            Signal::Ramp { start, end, .. } if end < start => self.refuse(
                &format!("{path}.ramp"),
                format!("the ramp ends at {end} s, before it starts at {start} s"),
            ),
            Signal::Ramp { .. } => Ok(()),
            Signal::Sine { period, .. } => {
                self.number(&format!("{path}.sine.period"), *period, Range::Positive)
            }
            Signal::Table(points) => {
                let path = format!("{path}.table");
                if points.is_empty() {
                    return self.refuse(&path, "the table has no point");
                }
                match points.windows(2).find(|w| w[1][0] <= w[0][0]) {
                    Some(w) => self.refuse(
                        &path,
                        format!("the times of the table must rise, but {} s follows {} s", w[1][0], w[0][0]),
                    ),
                    None => Ok(()),
                }
            }
        }
    }

    pub(super) fn law(&self, path: &str, law: &Law) -> Result<(), CaseError> {
        let (path, restitution, rolling, capillary) = match law {
            Law::Linear(linear) => {
                let path = format!("{path}.linear");
                self.number(&format!("{path}.stiffness-ratio"), linear.stiffness_ratio, Range::NotNegative)?;
                if let Some(adhesion) = linear.adhesion {
                    let at = |key: &str| format!("{path}.adhesion.{key}");
                    self.number(&at("tension"), adhesion.tension, Range::NotNegative)?;
                    self.number(&at("cohesion"), adhesion.cohesion, Range::NotNegative)?;
                }
                (path, linear.restitution, linear.rolling, linear.capillary)
            }
            Law::HertzMindlin(hertz) => {
                let path = format!("{path}.hertz-mindlin");
                self.number(&format!("{path}.poisson"), hertz.poisson, Range::Poisson)?;
                (path, hertz.restitution, hertz.rolling, hertz.capillary)
            }
        };
        let at = |key: &str| format!("{path}.{key}");
        self.number(&at("young"), law.young(), Range::Positive)?;
        self.number(&at("friction"), law.friction(), Range::Angle)?;
        self.optional(&at("restitution"), restitution.map(Restitution::coefficient), Range::Share)?;
        if let Some(rolling) = rolling {
            self.number(&at("rolling.friction"), rolling.friction, Range::NotNegative)?;
            self.number(&at("rolling.stiffness"), rolling.stiffness, Range::NotNegative)?;
            self.number(&at("rolling.twist-friction"), rolling.twist_friction, Range::NotNegative)?;
            self.number(&at("rolling.twist-stiffness"), rolling.twist_stiffness, Range::NotNegative)?;
        }
        if let Some(capillary) = capillary {
            self.number(&at("capillary.volume"), capillary.volume, Range::Positive)?;
            self.number(&at("capillary.surface-tension"), capillary.surface_tension, Range::NotNegative)?;
            self.number(&at("capillary.contact-angle"), capillary.contact_angle, Range::Angle)?;
        }
        Ok(())
    }

    fn time_step(&self, path: &str, step: &TimeStep) -> Result<(), CaseError> {
        match step {
            TimeStep::Automatic { safety } => {
                let path = format!("{path}.automatic.safety");
                self.number(&path, *safety, Range::Positive)?;
                if *safety > 1.0 {
                    return self.refuse(&path, format!("`safety` must be at most 1, not {safety}"));
                }
                Ok(())
            }
            TimeStep::Fixed(dt) => self.number(&format!("{path}.fixed"), *dt, Range::Positive),
        }
    }

    fn every(&self, path: &str, every: &Every) -> Result<(), CaseError> {
        match every {
            Every::Seconds(seconds) => self.number(&format!("{path}.seconds"), *seconds, Range::Positive),
            Every::Steps(0) => self.refuse(&format!("{path}.steps"), "`steps` must be at least 1, not 0"),
            Every::Steps(_) => Ok(()),
        }
    }

    pub(super) fn optional(&self, path: &str, value: Option<f64>, range: Range) -> Result<(), CaseError> {
        value.map_or(Ok(()), |value| self.number(path, value, range))
    }

    pub(super) fn number(&self, path: &str, value: f64, range: Range) -> Result<(), CaseError> {
        let (fits, words) = match range {
            Range::Positive => (value > 0.0, "greater than 0"),
            Range::NotNegative => (value >= 0.0, "0 or greater"),
            Range::Part => ((0.0..1.0).contains(&value), "at least 0 and less than 1"),
            Range::Share => (value > 0.0 && value <= 1.0, "greater than 0 and at most 1"),
            Range::Poisson => (value > -1.0 && value <= 0.5, "greater than -1 and at most 0.5"),
            Range::Between => (value > 0.0 && value < 1.0, "greater than 0 and less than 1"),
            Range::Angle => ((0.0..90.0).contains(&value), "an angle from 0 to less than 90 degrees"),
        };
        if fits {
            return Ok(());
        }
        let key = path.rsplit('.').find(|k| k.parse::<usize>().is_err()).unwrap_or(path);
        self.refuse(path, format!("`{key}` must be {words}, not {value}"))
    }

    pub(super) fn refuse(&self, path: &str, sentence: impl Into<String>) -> Result<(), CaseError> {
        Err(self.source.fault(path, sentence))
    }
}

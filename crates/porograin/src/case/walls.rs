//! Walls that a case adds to those at the faces of its box.

use super::check::Range;
use super::{Case, CaseError, reason};
use crate::grains::Grains;
use crate::walls::motion::{self, Servoed};
use crate::walls::{self, Mesh, MeshError, Motion, Shape, Wall, stl};
use glam::DVec3;
use serde::Deserialize;
use std::path::Path;
use std::sync::Arc;

/// A wall.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct WallTable {
    /// A short name, used in outputs and by the stages.
    pub name: String,
    /// What it looks like and where it is at the start.
    pub shape: ShapeTable,
    /// How it moves.
    #[serde(default = "fixed")]
    pub motion: Motion,
    /// Friction angle with the grains [degrees].
    #[serde(default)]
    pub friction: f64,
    /// Whether it is there.
    #[serde(default = "present")]
    pub present: bool,
    /// Whether the grains that touch it when this begins stick to it.
    #[serde(default)]
    pub glue: bool,
}

fn fixed() -> Motion {
    Motion::Fixed
}

fn present() -> bool {
    true
}

/// The choice of shapes; lengths in m.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub enum ShapeTable {
    /// An endless plane, grains on the side its normal points to.
    Plane {
        /// On it.
        point: [f64; 3],
        /// Of any length.
        normal: [f64; 3],
    },
    /// A flat plate, a parallelogram.
    Rectangle {
        /// Where the edges begin.
        corner: [f64; 3],
        /// From there to two other corners.
        edges: [[f64; 3]; 2],
    },
    /// A flat round plate.
    Disc {
        /// Its middle.
        centre: [f64; 3],
        /// Of any length.
        normal: [f64; 3],
        /// Of the rim.
        radius: f64,
    },
    /// A tube, for grains inside and outside.
    Cylinder {
        /// On the axis, where the tube begins.
        point: [f64; 3],
        /// Of any length.
        axis: [f64; 3],
        /// From the axis to the surface.
        radius: f64,
        /// Along the axis; left out: endless in both directions.
        length: Option<f64>,
    },
    /// The six sides of a box along the axes, for grains inside and outside.
    Box {
        /// Low corner.
        lower: [f64; 3],
        /// High corner.
        upper: [f64; 3],
    },
    /// The triangles of an STL file.
    Stl {
        /// Counts from the folder of the case.
        file: String,
        /// One unit of the file [m].
        #[serde(default = "metre")]
        scale: f64,
        /// Where the origin of the file is.
        #[serde(default)]
        origin: [f64; 3],
    },
}

fn metre() -> f64 {
    1.0
}

/// Names of the shapes as case files spell them, and what they are.
pub const SHAPES: [(&str, &str); 6] = [
    ("plane", "an endless plane, grains on the side its normal points to"),
    ("rectangle", "a flat plate, a parallelogram"),
    ("disc", "a flat round plate"),
    ("cylinder", "a tube, for grains inside and outside"),
    ("box", "the six sides of a box, for grains inside and outside"),
    ("stl", "the triangles of an STL file"),
];

/// What a stage changes about a wall.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct WallRule {
    /// Another motion, complete.
    pub motion: Option<Motion>,
    /// Another friction angle [degrees].
    pub friction: Option<f64>,
    /// Whether it is there during the stage.
    pub present: Option<bool>,
    /// Whether the grains that touch it when this begins stick to it.
    pub glue: Option<bool>,
}

impl WallTable {
    /// The file it is read from, if it is.
    pub(super) fn file(&self) -> Option<&str> {
        match &self.shape {
            ShapeTable::Stl { file, .. } => Some(file),
            _ => None,
        }
    }
}

impl Case {
    /// The walls as they are in stage `k`.
    pub(super) fn walls_in(&self, k: usize) -> Vec<Wall> {
        let mut all: Vec<Wall> = (self.wall.iter().zip(&self.shapes))
            .map(|(table, shape)| {
                let rule = self.stage[k].wall.get(&table.name).cloned().unwrap_or_default();
                Wall {
                    name: table.name.as_str().into(),
                    shape: shape.clone(),
                    motion: rule.motion.unwrap_or_else(|| table.motion.clone()),
                    friction: rule.friction.unwrap_or(table.friction),
                    present: rule.present.unwrap_or(table.present),
                    glue: rule.glue.unwrap_or(table.glue),
                    first: 0,
                }
            })
            .collect();
        walls::number(&mut all);
        all
    }

    /// Their names, in order.
    pub fn wall_names(&self) -> Vec<String> {
        self.wall.iter().map(|wall| wall.name.clone()).collect()
    }

    /// Makes the surfaces of the walls.
    pub(super) fn make_shapes(&self) -> Result<Vec<Shape>, CaseError> {
        self.wall.iter().enumerate().map(|(k, wall)| self.make_shape(k, wall)).collect()
    }

    fn make_shape(&self, k: usize, wall: &WallTable) -> Result<Shape, CaseError> {
        let at = |kind: &str, key: &str| format!("wall.{k}.shape.{kind}.{key}");
        let unit = |kind: &str, key: &str, v: &[f64; 3]| {
            DVec3::from_array(*v).try_normalize().ok_or_else(|| {
                let sentence = format!("the {key} of the wall `{}` has no direction: it is zero", wall.name);
                self.source.fault(&at(kind, key), sentence)
            })
        };
        let surface = |kind: &str, key: &str, mesh: Result<Mesh, MeshError>| match mesh {
            Ok(mesh) => Ok(Shape::Mesh(Arc::new(mesh))),
            Err(_) => {
                let sentence = format!("the wall `{}` has a side without area", wall.name);
                Err(self.source.fault(&at(kind, key), sentence))
            }
        };
        Ok(match &wall.shape {
            ShapeTable::Plane { point, normal } => {
                Shape::Plane { point: (*point).into(), normal: unit("plane", "normal", normal)? }
            }
            ShapeTable::Rectangle { corner, edges } => {
                let [a, b] = edges.map(DVec3::from_array);
                return surface("rectangle", "edges", Mesh::rectangle((*corner).into(), a, b));
            }
            ShapeTable::Disc { centre, normal, radius } => {
                self.number(&at("disc", "radius"), *radius, Range::Positive)?;
                let normal = unit("disc", "normal", normal)?;
                Shape::Disc { centre: (*centre).into(), normal, radius: *radius }
            }
            ShapeTable::Cylinder { point, axis, radius, length } => {
                self.number(&at("cylinder", "radius"), *radius, Range::Positive)?;
                self.optional(&at("cylinder", "length"), *length, Range::Positive)?;
                let axis = unit("cylinder", "axis", axis)?;
                Shape::Cylinder { point: (*point).into(), axis, radius: *radius, length: *length }
            }
            ShapeTable::Box { lower, upper } => {
                if let Some(axis) = (0..3).find(|&axis| lower[axis] >= upper[axis]) {
                    let sentence = format!(
                        "the box `{}` is inside out along {}: its upper corner must lie above its lower one",
                        wall.name,
                        ["x", "y", "z"][axis]
                    );
                    return Err(self.source.fault(&at("box", "upper"), sentence));
                }
                return surface("box", "upper", Mesh::cuboid((*lower).into(), (*upper).into()));
            }
            ShapeTable::Stl { file, scale, origin } => {
                self.number(&at("stl", "scale"), *scale, Range::Positive)?;
                let path = self.whereabouts(file);
                let fault = |what: String| {
                    let sentence =
                        format!("cannot read the wall `{}` from {}: {what}", wall.name, path.display());
                    self.source.fault(&at("stl", "file"), sentence)
                };
                let bytes = std::fs::read(&path).map_err(|e| fault(reason(&e)))?;
                let mut triangles = stl::read(&bytes).map_err(|e| fault(e.to_string()))?;
                let origin = DVec3::from_array(*origin);
                triangles.iter_mut().flatten().for_each(|x| *x = origin + *scale * *x);
                Shape::Mesh(Arc::new(Mesh::new(&triangles).map_err(|e| fault(e.to_string()))?))
            }
        })
    }

    /// What can be said against the walls before their shapes are made.
    pub(super) fn check_walls(&self) -> Result<(), CaseError> {
        for (k, wall) in self.wall.iter().enumerate() {
            let at = |key: &str| format!("wall.{k}.{key}");
            if wall.name.is_empty() || wall.name.contains(|c: char| c.is_whitespace() || ",.[]".contains(c)) {
                return self.refuse(&at("name"), "a wall needs a name of one word, without dots and commas");
            }
            if self.wall[..k].iter().any(|other| other.name == wall.name) {
                return self.refuse(&at("name"), format!("two walls are called `{}`", wall.name));
            }
            if let ShapeTable::Stl { file, .. } = &wall.shape {
                // A run keeps a copy of each, by its name.
                let name = |file: &str| Path::new(file).file_name().map(|name| name.to_owned());
                let mut others = self.files().map(|(other, _)| other);
                if let Some(other) = others.find(|other| *other != file && name(other) == name(file)) {
                    return self.refuse(
                        &at("shape.stl.file"),
                        format!(
                            "{file} and {other} have one name, but a run keeps a copy of both: rename one"
                        ),
                    );
                }
            }
            self.number(&at("friction"), wall.friction, Range::Angle)?;
            self.wall_motion(&at("motion"), &wall.motion)?;
        }
        for (k, stage) in self.stage.iter().enumerate() {
            for (name, rule) in &stage.wall {
                let path = format!("stage.{k}.wall.{name}");
                if !self.wall.iter().any(|wall| wall.name == *name) {
                    let names: Vec<&str> = self.wall.iter().map(|wall| wall.name.as_str()).collect();
                    let error = self.source.fault(&path, format!("there is no wall `{name}`"));
                    return Err(match names[..] {
                        [] => error.hint("a wall is added with [[wall]]"),
                        _ => error.hint(format!("there is: {}", names.join(", "))),
                    });
                }
                self.optional(&format!("{path}.friction"), rule.friction, Range::Angle)?;
                if let Some(motion) = &rule.motion {
                    self.wall_motion(&format!("{path}.motion"), motion)?;
                }
            }
        }
        Ok(())
    }

    fn wall_motion(&self, path: &str, motion: &Motion) -> Result<(), CaseError> {
        let direction = |key: &str, v: &[f64; 3]| match DVec3::from_array(*v).try_normalize() {
            Some(_) => Ok(()),
            None => self.refuse(&format!("{path}.{key}"), format!("`{key}` has no direction: it is zero")),
        };
        match motion {
            Motion::Fixed => Ok(()),
            Motion::Moving { velocity } => self.signals(&format!("{path}.moving.velocity"), velocity),
            Motion::Rotating { axis, rate, .. } => {
                direction("rotating.axis", axis)?;
                self.signal_in_time(&format!("{path}.rotating.rate"), rate)
            }
            Motion::Servo { along, load, area, mass, speed } => {
                direction("servo.along", along)?;
                self.optional(&format!("{path}.servo.area"), *area, Range::Positive)?;
                self.optional(&format!("{path}.servo.mass"), *mass, Range::Positive)?;
                self.optional(&format!("{path}.servo.speed"), *speed, Range::Positive)?;
                let (Servoed::Force(signal) | Servoed::Stress(signal)) = load;
                self.signal_in_time(&format!("{path}.servo.load"), signal)
            }
        }
    }

    /// What can be said against the walls once they have shapes.
    pub(super) fn check_shapes(&self) -> Result<(), CaseError> {
        let lengthwise = |axis: usize, why: &str| {
            let sides = |(k, shape): (usize, &Shape)| {
                if shape.is_endless_along(DVec3::AXES[axis]) {
                    return Ok(());
                }
                let name = &self.wall[k].name;
                let along = ["x", "y", "z"][axis];
                self.refuse(
                    &format!("wall.{k}.shape"),
                    format!(
                        "{why}, so the wall `{name}` must be endless along {along}: a plane or a cylinder"
                    ),
                )
            };
            self.shapes.iter().enumerate().try_for_each(sides)
        };
        for axis in (0..3).filter(|&axis| self.domain.periodic.0[axis]) {
            lengthwise(axis, "the domain repeats")?;
        }
        if self.domain.discs {
            lengthwise(1, "discs are as thick as the box")?;
        }
        for k in 0..self.stage.len() {
            for (index, wall) in self.walls_in(k).iter().enumerate() {
                let Motion::Servo { load: Servoed::Stress(_), .. } = &wall.motion else { continue };
                if motion::area(wall).is_none_or(|area| area == 0.0) {
                    return Err(self
                        .source
                        .fault(
                            &format!("wall.{index}"),
                            format!(
                                "a stress needs an area, and the wall `{}` has none across the servo",
                                wall.name
                            ),
                        )
                        .hint("rectangles, discs and open surfaces of an STL file have one; give `area`, or load = { force = … }"));
                }
            }
            let stage = &self.stage[k];
            if !self.wall.is_empty() && self.model(k, 0.0).fluid.is_some() {
                return self.refuse(
                    "wall",
                    format!(
                        "the stage `{}` has water, which knows the walls at the six faces only: leave the others out",
                        stage.name
                    ),
                );
            }
            if !self.wall.is_empty() && (stage.cell.is_some() || self.cell.is_some()) {
                return self.refuse("wall", "walls stay as they are when the cell deforms: leave [cell] out");
            }
        }
        Ok(())
    }

    /// Grains that stick move with their wall: no water may push them, and no cell carry them.
    pub(super) fn glue(&self, k: usize) -> Result<(), CaseError> {
        let model = self.model(k, 0.0);
        if !model.faces.iter().any(|face| face.glue) && !model.walls.iter().any(|wall| wall.glue) {
            return Ok(());
        }
        let what = if model.fluid.is_some() {
            "has water, which takes all grains to be free"
        } else if self.cell.is_some() || self.stage[k].cell.is_some() {
            "has a cell that deforms, which carries all grains along"
        } else {
            return Ok(());
        };
        let name = &self.stage[k].name;
        Err(self
            .source
            .fault(
                &format!("stage.{k}"),
                format!("grains are glued to a wall, but the stage `{name}` {what}"),
            )
            .hint("leave `glue` out, or give the stage glue = false"))
    }

    /// A membrane holds dry spheres in a box.
    pub(super) fn membrane(&self, k: usize) -> Result<(), CaseError> {
        let stage = &self.stage[k];
        let (path, membrane) = match (&stage.membrane, &self.membrane) {
            (Some(membrane), _) => (format!("stage.{k}.membrane"), membrane),
            (None, Some(membrane)) => ("membrane".to_owned(), membrane),
            (None, None) => return Ok(()),
        };
        self.signal_in_time(&format!("{path}.stress"), &membrane.stress)?;
        self.optional(&format!("{path}.probe"), membrane.probe, Range::Positive)?;
        if membrane.renew == 0 {
            return self.refuse(&format!("{path}.renew"), "`renew` must be at least 1 step, not 0");
        }
        let what = if self.model(k, 0.0).fluid.is_some() {
            format!("the stage `{}` has water", stage.name)
        } else if self.domain.periodic.0 != [false; 3] {
            "the domain is periodic".to_owned()
        } else if self.domain.discs {
            "`domain.discs` asks for discs".to_owned()
        } else {
            return Ok(());
        };
        self.refuse(&path, format!("a membrane goes around dry spheres in a box, but {what}"))
    }

    /// No grain may be on the wrong side of a wall, or deep in one.
    pub(super) fn clear_of_walls(&self, grains: &Grains) -> Result<(), CaseError> {
        let walls = self.walls_in(0);
        for (k, wall) in walls.iter().enumerate().filter(|(_, wall)| wall.present) {
            for (i, (&x, &radius)) in grains.position.iter().zip(&grains.radius).enumerate() {
                let what = if wall.shape.beyond(x).is_some_and(|by| by > 0.0) {
                    "lies beyond"
                } else if wall.shape.depth(x, radius).is_some_and(|depth| depth > 0.5 * radius) {
                    "lies deep in"
                } else {
                    continue;
                };
                return self.refuse(
                    &format!("wall.{k}"),
                    format!(
                        "grain {} at ({:.4e}, {:.4e}, {:.4e}) {what} the wall `{}`",
                        grains.id[i], x.x, x.y, x.z, wall.name
                    ),
                );
            }
        }
        Ok(())
    }
}

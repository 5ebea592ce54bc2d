//! Fields: pressure and velocity of the water at places that a case names, again and again.

use crate::measure::Sensor;
use crate::watch::{Every, Snapshot};
use glam::DVec3;
use serde::Deserialize;

/// Places to tell of, and when.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Field {
    /// A short name: the numbers go into `field-NAME.csv`.
    pub name: String,
    /// Where.
    pub at: Places,
    /// When.
    pub every: Every,
}

/// Places in space.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Places {
    /// One by one [m].
    Points(Vec<[f64; 3]>),
    /// Evenly along a line, both ends included.
    Line(Line),
    /// A grid on a parallelogram, its edges included.
    Plane(Plane),
    /// A grid in a box, its sides included.
    Grid(Grid),
}

/// Their names as case files spell them, and what they are.
pub const PLACES: [(&str, &str); 4] = [
    ("points", "places one by one"),
    ("line", "places evenly along a line, both ends included"),
    ("plane", "a grid of places on a parallelogram"),
    ("grid", "a grid of places in a box"),
];

/// A line.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// One end [m].
    pub from: [f64; 3],
    /// The other [m].
    pub to: [f64; 3],
    /// How many places.
    pub count: usize,
}

/// A parallelogram.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plane {
    /// A corner [m].
    pub corner: [f64; 3],
    /// The edges from there [m].
    pub edges: [[f64; 3]; 2],
    /// How many places along each.
    pub count: [usize; 2],
}

/// A box.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// Low corner [m].
    pub from: [f64; 3],
    /// High corner [m].
    pub to: [f64; 3],
    /// How many places along x, y and z.
    pub count: [usize; 3],
}

/// Most places a field may have.
pub const MOST: usize = 1_000_000;

impl Places {
    /// How many there are along each direction.
    pub fn counts(&self) -> Vec<usize> {
        match self {
            Places::Points(points) => vec![points.len()],
            Places::Line(line) => vec![line.count],
            Places::Plane(plane) => plane.count.to_vec(),
            Places::Grid(grid) => grid.count.to_vec(),
        }
    }

    /// All of them, the first direction fastest [m].
    pub fn all(&self) -> Vec<DVec3> {
        let grid = |corner: DVec3, edges: &[DVec3]| {
            let mut places = vec![corner];
            for (&edge, count) in edges.iter().zip(self.counts()) {
                let part = |k: usize| if count > 1 { k as f64 / (count - 1) as f64 } else { 0.0 };
                places = (0..count)
                    .flat_map(|k| places.iter().map(move |&x| x + part(k) * edge).collect::<Vec<_>>())
                    .collect();
            }
            places
        };
        let vector = DVec3::from_array;
        match self {
            Places::Points(points) => points.iter().copied().map(vector).collect(),
            Places::Line(line) => grid(vector(line.from), &[vector(line.to) - vector(line.from)]),
            Places::Plane(plane) => grid(vector(plane.corner), &plane.edges.map(vector)),
            Places::Grid(Grid { from, to, .. }) => {
                let size = vector(*to) - vector(*from);
                grid(vector(*from), &DVec3::AXES.map(|axis| axis * size))
            }
        }
    }
}

/// Heads of the columns, with units, after that of the stage.
pub const HEADS: [&str; 8] = [
    "time [s]",
    "x [m]",
    "y [m]",
    "z [m]",
    "pressure [Pa]",
    "velocity_x [m/s]",
    "velocity_y [m/s]",
    "velocity_z [m/s]",
];

impl Field {
    /// One row per place: pressure and velocity there are empty where there is no water to ask. `None` in a dry stage.
    pub fn rows(&self, now: &Snapshot) -> Option<Vec<[Option<f64>; HEADS.len()]>> {
        if let Some(flow) = now.coarse_flow() {
            return Some(self.ask(now, |x| flow.at(x).map(|found| (found.pressure, found.velocity))));
        }
        let (_, pressure) = now.pores()?;
        let (beside, mut room) = (now.beside()?, Vec::new());
        let site = now.site(&beside)?;
        let walk = now.walk(&beside, &mut room);
        let velocity = now.pore_flow(&site)?.velocity(&site, &walk);
        let mut sensor = Sensor::new(&site, pressure);
        Some(self.ask(now, |x| {
            let found = sensor.at(x)?;
            let u = velocity[found.pore] + walk.gradient * found.offset;
            Some((found.pressure + now.macroscopic(x), u))
        }))
    }

    /// The rows of what is found at each place: pressure and velocity.
    fn ask(
        &self,
        now: &Snapshot,
        mut at: impl FnMut(DVec3) -> Option<(f64, DVec3)>,
    ) -> Vec<[Option<f64>; HEADS.len()]> {
        let row = |x: DVec3| {
            let [a, b, c, d] = [now.state.time, x.x, x.y, x.z].map(Some);
            let [p, u, v, w] = at(x).map_or([None; 4], |(p, u)| [p, u.x, u.y, u.z].map(Some));
            [a, b, c, d, p, u, v, w]
        };
        self.at.all().into_iter().map(row).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_run_from_end_to_end() {
        let line = Places::Line(Line { from: [0.0; 3], to: [0.0, 0.0, 2.0], count: 3 });
        assert_eq!(line.all(), [0.0, 1.0, 2.0].map(|z| DVec3::new(0.0, 0.0, z)));
        let edges = [[1.0, 0.0, 0.0], [0.0, 1.0, 1.0]];
        let plane = Places::Plane(Plane { corner: [0.5; 3], edges, count: [2, 2] }).all();
        let corners = [[0.5; 3], [1.5, 0.5, 0.5], [0.5, 1.5, 1.5], [1.5; 3]];
        assert_eq!(plane, corners.map(DVec3::from_array));
        let grid = Places::Grid(Grid { from: [0.0; 3], to: [1.0, 2.0, 3.0], count: [2, 1, 4] }).all();
        assert_eq!((grid.len(), grid[1], grid[7]), (8, DVec3::X, DVec3::new(1.0, 0.0, 3.0)));
    }
}

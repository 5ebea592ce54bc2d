//! The files for ParaView, read back: what `porograin permeability --vtk` writes of pores, throats and Voronoi edges.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Grains that leave room between them, in a box or a period of edge 1.
const GRAINS: &str =
    "x,y,z,r\n0.3,0.2,0.4,0.2\n0.7,0.3,0.8,0.15\n0.35,0.72,0.7,0.22\n0.8,0.8,0.3,0.18\n0.7,0.25,0.2,0.12\n";

/// One array of a file, with its numbers per entry.
#[derive(Debug, Clone)]
struct Array {
    components: usize,
    values: Vec<f64>,
}

impl Array {
    fn vectors(&self) -> Vec<[f64; 3]> {
        assert_eq!(self.components, 3);
        self.values.chunks(3).map(|v| [v[0], v[1], v[2]]).collect()
    }
}

/// Every array of a file with raw appended data, by name.
fn arrays(path: &Path) -> BTreeMap<String, Array> {
    let bytes = std::fs::read(path).unwrap();
    let mark = b"<AppendedData encoding=\"raw\">\n_";
    let start = bytes.windows(mark.len()).position(|w| w == mark).unwrap() + mark.len();
    let head = String::from_utf8(bytes[..start].to_vec()).unwrap();
    let attribute = |tag: &str, name: &str| {
        let rest = tag.split_once(&format!("{name}=\"")).unwrap().1;
        rest.split_once('"').unwrap().0.to_owned()
    };
    let mut found = BTreeMap::new();
    for tag in head.split("<DataArray ").skip(1) {
        let from = start + attribute(tag, "offset").parse::<usize>().unwrap();
        let length = u64::from_le_bytes(bytes[from..from + 8].try_into().unwrap()) as usize;
        let data = &bytes[from + 8..from + 8 + length];
        let values = match attribute(tag, "type").as_str() {
            "Float64" => data.chunks(8).map(|b| f64::from_le_bytes(b.try_into().unwrap())).collect(),
            "Int64" => data.chunks(8).map(|b| i64::from_le_bytes(b.try_into().unwrap()) as f64).collect(),
            "UInt32" => {
                data.chunks(4).map(|b| f64::from(u32::from_le_bytes(b.try_into().unwrap()))).collect()
            }
            "UInt8" => data.iter().map(|&b| f64::from(b)).collect(),
            other => panic!("{other}"),
        };
        let components = attribute(tag, "NumberOfComponents").parse().unwrap();
        found.insert(attribute(tag, "Name"), Array { components, values });
    }
    assert!(found.values().all(|array| array.values.iter().all(|x| x.is_finite())), "{}", path.display());
    found
}

/// Corners of each cell.
fn cells(file: &BTreeMap<String, Array>) -> Vec<Vec<[f64; 3]>> {
    let points = file["position"].vectors();
    let corners: Vec<usize> = file["connectivity"].values.iter().map(|&k| k as usize).collect();
    let mut from = 0;
    let mut take = |&end: &f64| {
        let cell = corners[from..end as usize].iter().map(|&k| points[k]).collect();
        from = end as usize;
        cell
    };
    file["offsets"].values.iter().map(&mut take).collect()
}

fn permeability(name: &str, arguments: &[&str]) -> (PathBuf, serde_json::Value) {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("vtk").join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("grains.csv"), GRAINS).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_porograin"))
        .args(["permeability", "grains.csv", "--json", "--vtk", "flow"])
        .args(arguments)
        .current_dir(&folder)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8(output.stderr).unwrap());
    (folder, serde_json::from_slice(&output.stdout).unwrap())
}

fn less(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| a[k] - b[k])
}

/// The greatest distance of two corners along an axis.
fn widest(cell: &[[f64; 3]]) -> f64 {
    let extent = |axis: usize| {
        let values = cell.iter().map(|x| x[axis]);
        values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min)
    };
    (0..3).map(extent).fold(0.0, f64::max)
}

/// The flux of every edge times the way it goes, along z: over the volume, the flux per area of the sample.
fn through(file: &BTreeMap<String, Array>) -> f64 {
    let flux = &file["flux [m3/s]"].values;
    cells(file).iter().zip(flux).map(|(edge, q)| q * less(edge[1], edge[0])[2]).sum()
}

fn close(a: f64, b: f64) -> bool {
    (a / b - 1.0).abs() < 1e-9
}

#[test]
fn between_walls_pores_fill_the_box_and_edges_carry_the_flow() {
    let (folder, found) = permeability("box", &["--box", "0,0,0,1,1,1"]);
    let read = |name: &str| arrays(&folder.join("flow").join(name));
    let pores = read("pores.vtu");
    let count = found["pores"].as_u64().unwrap() as usize;
    assert_eq!((pores["types"].values.len(), pores["velocity [m/s]"].vectors().len()), (count, count));
    // Tetrahedra, wedges at walls, boxes along edges and in corners.
    let corners = |kind: f64| match kind as u32 {
        10 => 4,
        13 => 6,
        12 => 8,
        other => panic!("cell type {other}"),
    };
    let shapes = cells(&pores);
    for (cell, &kind) in shapes.iter().zip(&pores["types"].values) {
        assert_eq!(cell.len(), corners(kind));
        assert!(cell.iter().flatten().all(|x| (-1e-12..=1.0 + 1e-12).contains(x)), "{cell:?}");
    }
    assert_eq!(pores["types"].values.iter().filter(|&&kind| kind == 12.0).count() % 2, 0);
    let (throats, edges) = (read("throats.vtp"), read("edges.vtp"));
    let polygons = cells(&throats);
    let links = found["throats"].as_u64().unwrap() - found["merged"].as_u64().unwrap();
    assert_eq!((polygons.len() as u64, cells(&edges).len() as u64), (links, links));
    assert!(polygons.iter().all(|polygon| (3..=4).contains(&polygon.len())));
    assert!(polygons.iter().flatten().flatten().all(|x| (-1e-12..=1.0 + 1e-12).contains(x)));
    assert!(throats["conductance [m3/(Pa s)]"].values.iter().all(|&g| g >= 0.0));
    assert_eq!(throats["flux [m3/s]"].values, edges["flux [m3/s]"].values);
    let inflow = found["inflow"].as_f64().unwrap();
    assert!(close(through(&edges), inflow), "{} {inflow}", through(&edges));
    assert_eq!(read("grains.vtp")["fluid velocity [m/s]"].vectors().len(), 5);
}

#[test]
fn nothing_is_stretched_across_a_period() {
    let lattice = "1,0,0,0.3,0.9,0.1,-0.2,0.4,0.95";
    let (folder, found) = permeability("period", &["--lattice", lattice, "--slope", "3"]);
    let read = |name: &str| arrays(&folder.join("flow").join(name));
    let (pores, throats, edges) = (read("pores.vtu"), read("throats.vtp"), read("edges.vtp"));
    assert!(pores["types"].values.iter().all(|&kind| kind == 10.0));
    // With five grains a pore is nearly as large as the period, but all of them together are exactly one period.
    let volume: f64 = (cells(&pores).iter())
        .map(|cell| {
            let [b, c, d] = [1, 2, 3].map(|k| less(cell[k], cell[0]));
            let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
            cross.iter().zip(d).map(|(n, d)| n * d).sum::<f64>() / 6.0
        })
        .inspect(|volume| assert!(*volume > 0.0))
        .sum();
    assert!(close(volume, found["volume"].as_f64().unwrap()), "{volume}");
    let mean = found["mean_velocity"].as_array().unwrap()[2].as_f64().unwrap();
    assert!(close(through(&edges), mean * volume), "{} {}", through(&edges), mean * volume);
    // An edge is the shortest way between two places as far from their grains as any.
    assert!(
        cells(&edges).iter().all(|edge| widest(edge) < 0.5),
        "{:?}",
        cells(&edges).iter().map(|e| widest(e)).fold(0.0, f64::max)
    );
    assert!(cells(&throats).iter().all(|polygon| polygon.len() == 3 && widest(polygon) < 1.2));
}

#[test]
fn places_are_told_pressure_and_velocity() {
    let (folder, _) = permeability("without", &["--box", "0,0,0,1,1,1"]);
    std::fs::write(folder.join("places.csv"), "x,y,z\n0.5,0.5,0\n0.5,0.5,1\n0.5,0.5,2\n").unwrap();
    let run = |region: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_porograin"))
            .args(["permeability", "grains.csv", "--at", "places.csv", "--fields", "f.csv"])
            .args(region)
            .current_dir(&folder)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", String::from_utf8(output.stderr).unwrap());
        std::fs::read_to_string(folder.join("f.csv")).unwrap()
    };
    let text = run(&["--box", "0,0,0,1,1,1"]);
    let rows: Vec<Vec<Option<f64>>> =
        text.lines().skip(1).map(|line| line.split(',').map(|x| x.parse().ok()).collect()).collect();
    // Open faces at 1 and 0 Pa; beyond them nothing. The planes of the grains miss an imposed pressure by a little.
    assert!((rows[0][3].unwrap() - 1.0).abs() < 0.1 && rows[1][3].unwrap().abs() < 0.1, "{text}");
    assert!(rows[0][6].unwrap() > 0.0 && rows[2][3..].iter().all(Option::is_none), "{text}");
    assert!(text.starts_with("x [m],y [m],z [m],pressure [Pa],velocity_x [m/s]"), "{text}");
    // A period further the pressure has fallen by the slope.
    let text = run(&["--period", "1,1,1", "--slope", "3", "--axis", "all"]);
    let value = |line: usize, column: usize| -> f64 {
        text.lines().nth(line).unwrap().split(',').nth(column).unwrap().parse().unwrap()
    };
    for (column, fall) in [(3, 0.0), (7, 0.0), (11, 3.0)] {
        let fell = value(1, column) - value(2, column);
        assert!((fell - fall).abs() < 1e-9, "{column}: {fell}");
    }
}

/// Grains of two materials pressed between two plates of a periodic cell, and the sample's own numbers.
const PRESSED: &str = r#"
title = "two plates"
gravity = [0.0, 0.0, -9.81]
[domain]
size = [0.01, 0.01, 0.012]
periodic = "xy"
[grains]
packing = { cloud = { count = 120, spread = 0.2, seed = 1, porosity = 0.7 } }
density = 2600.0
[material.glass]
part = 0.5
[material.steel]
part = 0.5
[contact.linear]
young = 1e6
stiffness-ratio = 0.5
friction = 10.0
[face.top]
solid = { servo = { stress = 1000.0 } }
[[stage]]
name = "press"
until = { steps = 8000 }
[[watch]]
measures = ["stress-tensor", "contacts", "size"]
every = { steps = 1000 }
[output]
network = true
"#;

/// Contacts are lines with their forces: what they carry is the stress of the sample, and each grain knows how many it has.
#[test]
fn contacts_carry_the_stress_of_the_sample() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("vtk").join("pressed");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("case.toml"), PRESSED).unwrap();
    let run = ["run", "case.toml", "--out", "out", "--quiet"];
    let status =
        Command::new(env!("CARGO_BIN_EXE_porograin")).args(run).current_dir(&folder).status().unwrap();
    assert!(status.success());
    let history = std::fs::read_to_string(folder.join("out/history.csv")).unwrap();
    let mut lines = history.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let (heads, row) = (lines.next().unwrap(), lines.next_back().unwrap());
    let value = |name: &str| -> f64 {
        let column = heads.iter().position(|head| head.starts_with(&format!("{name} ["))).unwrap();
        row[column].parse().unwrap()
    };
    let (contacts, grains) = (
        arrays(&folder.join("out/vtk/contacts_000000.vtp")),
        arrays(&folder.join("out/vtk/grains_000000.vtp")),
    );
    let lines = cells(&contacts);
    // A pair that has just parted is no contact any more.
    assert!(lines.len() as f64 <= value("contacts") && lines.len() as f64 > 0.98 * value("contacts"));
    let volume = value("size_x") * value("size_y") * value("size_z");
    let forces = contacts["force [N]"].vectors();
    for (a, letter) in ["x", "y", "z"].into_iter().enumerate() {
        for (b, other) in ["x", "y", "z"].into_iter().enumerate() {
            let carried: f64 =
                lines.iter().zip(&forces).map(|(line, force)| force[a] * (line[1][b] - line[0][b])).sum();
            let asked = value(&format!("stress_tensor_{letter}{other}"));
            assert!(
                (carried / volume - asked).abs() < 1e-9 * 1000.0,
                "{letter}{other} {:e} {asked}",
                carried / volume
            );
        }
    }
    for (k, (line, force)) in lines.iter().zip(&forces).enumerate() {
        let along: Vec<f64> = (0..3).map(|c| line[1][c] - line[0][c]).collect();
        let length = along.iter().map(|x| x * x).sum::<f64>().sqrt();
        let normal: f64 = (0..3).map(|c| force[c] * along[c] / length).sum();
        let (n, t) = (contacts["normal force [N]"].values[k], contacts["tangential force [N]"].values[k]);
        assert!((n - normal).abs() < 1e-12 && n >= 0.0 && t <= n * 10f64.to_radians().tan() * (1.0 + 1e-9));
        assert!(length < 2.6e-3 && contacts["overlap [m]"].values[k] >= 0.0, "{length}");
    }
    let mean = grains["contacts"].values.iter().sum::<f64>() / 120.0;
    assert!((mean - value("coordination")).abs() < 1e-12, "{mean}");
    let carrying = grains["carries load"].values.iter().filter(|&&carries| carries == 1.0).count();
    assert_eq!(carrying as f64, 120.0 - value("rattlers"));
    let steel = grains["material"].values.iter().filter(|&&material| material == 1.0).count();
    assert!((40..80).contains(&steel), "{steel}");
}

/// Grains on a lattice in a membrane.
const WRAPPED: &str = r#"
title = "a wrapped lump"
[domain]
size = [0.02, 0.02, 0.02]
[grains]
packing = { lattice = { count = [6, 6, 6], radius = 1.5e-3 } }
density = 2600.0
[contact.linear]
young = 1e6
stiffness-ratio = 0.5
friction = 10.0
[[stage]]
name = "press"
membrane = { stress = { ramp = { from = 100.0, to = 200.0, end = 1e-9 } }, probe = 3e-3 }
until = { steps = 300 }
[[watch]]
measures = ["membrane"]
every = { steps = 100 }
"#;

/// The triangles of a membrane close around the volume that the measure tells, with their normals outwards.
#[test]
fn a_membrane_is_drawn_around_its_volume() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("vtk").join("wrapped");
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("case.toml"), WRAPPED).unwrap();
    let run = ["run", "case.toml", "--out", "out", "--quiet"];
    let status =
        Command::new(env!("CARGO_BIN_EXE_porograin")).args(run).current_dir(&folder).status().unwrap();
    assert!(status.success());
    let history = std::fs::read_to_string(folder.join("out/history.csv")).unwrap();
    let last: Vec<f64> =
        history.lines().last().unwrap().split(',').skip(3).map(|cell| cell.parse().unwrap()).collect();
    let drawn = arrays(&folder.join("out/vtk/membrane_000000.vtp"));
    let triangles = cells(&drawn);
    let cross = |a: [f64; 3], b: [f64; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let (mut area, mut volume) = (0.0, 0.0);
    for t in &triangles {
        let side = |k: usize| [0, 1, 2].map(|c| t[k][c] - t[0][c]);
        let normal = cross(side(1), side(2));
        area += 0.5 * normal.iter().map(|n| n * n).sum::<f64>().sqrt();
        volume += (0..3).map(|c| t[0][c] * normal[c]).sum::<f64>() / 6.0;
    }
    assert!(
        (area / last[0] - 1.0).abs() < 1e-9 && (volume / last[1] - 1.0).abs() < 1e-9,
        "{area} {volume} {last:?}"
    );
    assert_eq!(drawn["stress [Pa]"].values, vec![200.0; triangles.len()]);
}

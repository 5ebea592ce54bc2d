//! `porograin list` and `porograin new`: the examples are inside the program.

use crate::{Failure, Outcome};
use porograin::case::{PACKINGS, REGIONS, SHAPES, nearest, reason};
use porograin::field::PLACES;
use porograin::pores::conductance::CONDUCTANCES;
use porograin::watch::Measure;
use std::io::Write as _;
use std::path::PathBuf;

/// An example: its name, one line about it, its files.
struct Example {
    name: &'static str,
    about: &'static str,
    files: &'static [(&'static str, &'static str)],
}

const EXAMPLES: &[Example] = &[
    Example {
        name: "01-oedometer",
        about: "saturated grains under a piston: consolidation against Terzaghi's theory (case.toml, quick.toml)",
        files: &[
            ("case.toml", include_str!("../../examples/01-oedometer/case.toml")),
            ("quick.toml", include_str!("../../examples/01-oedometer/quick.toml")),
            ("README.md", include_str!("../../examples/01-oedometer/README.md")),
            ("consolidation.svg", include_str!("../../examples/01-oedometer/consolidation.svg")),
        ],
    },
    Example {
        name: "02-nine-spheres",
        about: "water flows through eight spheres in a cube and a ninth between them: forces against Catalano (2012)",
        files: &[
            ("case.toml", include_str!("../../examples/02-nine-spheres/case.toml")),
            ("eight.csv", include_str!("../../examples/02-nine-spheres/eight.csv")),
            ("nine.csv", include_str!("../../examples/02-nine-spheres/nine.csv")),
            ("README.md", include_str!("../../examples/02-nine-spheres/README.md")),
            ("nine-spheres.svg", include_str!("../../examples/02-nine-spheres/nine-spheres.svg")),
        ],
    },
    Example {
        name: "03-bidisperse-permeability",
        about: "permeability of beads of two sizes against their mass ratio, periodic (case.toml) and walled (walled.toml)",
        files: &[
            ("case.toml", include_str!("../../examples/03-bidisperse-permeability/case.toml")),
            ("walled.toml", include_str!("../../examples/03-bidisperse-permeability/walled.toml")),
            ("README.md", include_str!("../../examples/03-bidisperse-permeability/README.md")),
            ("permeability.svg", include_str!("../../examples/03-bidisperse-permeability/permeability.svg")),
        ],
    },
    Example {
        name: "04-seabed-pressure",
        about: "the pressure in a bed of grains under a standing wave, a formula of place and time, against theory",
        files: &[
            ("case.toml", include_str!("../../examples/04-seabed-pressure/case.toml")),
            ("README.md", include_str!("../../examples/04-seabed-pressure/README.md")),
            ("seabed.svg", include_str!("../../examples/04-seabed-pressure/seabed.svg")),
        ],
    },
    Example {
        name: "05-viscous-oedometer",
        about: "the same in water so thick that steps must be implicit (case.toml, quick.toml)",
        files: &[
            ("case.toml", include_str!("../../examples/05-viscous-oedometer/case.toml")),
            ("quick.toml", include_str!("../../examples/05-viscous-oedometer/quick.toml")),
            ("README.md", include_str!("../../examples/05-viscous-oedometer/README.md")),
            ("consolidation.svg", include_str!("../../examples/05-viscous-oedometer/consolidation.svg")),
        ],
    },
    Example {
        name: "06-floating-grains",
        about: "grains float in the stream of a pressure gradient in a periodic cell: hindered settling after Richardson and Zaki",
        files: &[
            ("case.toml", include_str!("../../examples/06-floating-grains/case.toml")),
            ("README.md", include_str!("../../examples/06-floating-grains/README.md")),
            ("discharge.svg", include_str!("../../examples/06-floating-grains/discharge.svg")),
        ],
    },
    Example {
        name: "10-collision",
        about: "two grains collide: momentum and restitution",
        files: &[
            ("case.toml", include_str!("../../examples/10-collision/case.toml")),
            ("grains.csv", include_str!("../../examples/10-collision/grains.csv")),
            ("README.md", include_str!("../../examples/10-collision/README.md")),
            ("energy.svg", include_str!("../../examples/10-collision/energy.svg")),
        ],
    },
    Example {
        name: "11-sliding-to-rolling",
        about: "a sphere thrown along a floor slides until it rolls",
        files: &[
            ("case.toml", include_str!("../../examples/11-sliding-to-rolling/case.toml")),
            ("grain.csv", include_str!("../../examples/11-sliding-to-rolling/grain.csv")),
            ("README.md", include_str!("../../examples/11-sliding-to-rolling/README.md")),
            ("speed.svg", include_str!("../../examples/11-sliding-to-rolling/speed.svg")),
        ],
    },
    Example {
        name: "12-heap",
        about: "a tube full of grains is lifted: a heap and its angle of repose",
        files: &[
            ("case.toml", include_str!("../../examples/12-heap/case.toml")),
            ("README.md", include_str!("../../examples/12-heap/README.md")),
            ("heap.svg", include_str!("../../examples/12-heap/heap.svg")),
        ],
    },
    Example {
        name: "13-triaxial",
        about: "triaxial compression of a dense (case.toml) and a loose sample (loose.toml): peak, dilation, one critical state",
        files: &[
            ("case.toml", include_str!("../../examples/13-triaxial/case.toml")),
            ("loose.toml", include_str!("../../examples/13-triaxial/loose.toml")),
            ("cell-dense.toml", include_str!("../../examples/13-triaxial/cell-dense.toml")),
            ("cell-loose.toml", include_str!("../../examples/13-triaxial/cell-loose.toml")),
            ("cell.svg", include_str!("../../examples/13-triaxial/cell.svg")),
            ("README.md", include_str!("../../examples/13-triaxial/README.md")),
            ("curves.svg", include_str!("../../examples/13-triaxial/curves.svg")),
        ],
    },
    Example {
        name: "14-inclined-flow",
        about: "dry grains flow down a rough plane (case.toml); the friction law mu(I) of a sheared sample (shear.toml)",
        files: &[
            ("case.toml", include_str!("../../examples/14-inclined-flow/case.toml")),
            ("shear.toml", include_str!("../../examples/14-inclined-flow/shear.toml")),
            ("README.md", include_str!("../../examples/14-inclined-flow/README.md")),
            ("flow.svg", include_str!("../../examples/14-inclined-flow/flow.svg")),
        ],
    },
    Example {
        name: "15-oedometer-unload",
        about: "a dry sample is loaded and unloaded: a small load (case.toml), a large one (large.toml)",
        files: &[
            ("case.toml", include_str!("../../examples/15-oedometer-unload/case.toml")),
            ("large.toml", include_str!("../../examples/15-oedometer-unload/large.toml")),
            ("README.md", include_str!("../../examples/15-oedometer-unload/README.md")),
            ("small.svg", include_str!("../../examples/15-oedometer-unload/small.svg")),
            ("large.svg", include_str!("../../examples/15-oedometer-unload/large.svg")),
        ],
    },
    Example {
        name: "16-silo",
        about: "a silo with a hole in its floor runs out at Beverloo's rate: walls from an STL file, a cylinder, a lid",
        files: &[
            ("case.toml", include_str!("../../examples/16-silo/case.toml")),
            ("floor.stl", include_str!("../../examples/16-silo/floor.stl")),
            ("README.md", include_str!("../../examples/16-silo/README.md")),
            ("rate.svg", include_str!("../../examples/16-silo/rate.svg")),
        ],
    },
    Example {
        name: "17-simple-shear",
        about: "a periodic sample without walls is sheared under constant normal stress: peak, dilation, critical state",
        files: &[
            ("case.toml", include_str!("../../examples/17-simple-shear/case.toml")),
            ("README.md", include_str!("../../examples/17-simple-shear/README.md")),
            ("shear.svg", include_str!("../../examples/17-simple-shear/shear.svg")),
        ],
    },
    Example {
        name: "18-frictionless",
        about: "isotropic compression without friction: six contacts per grain, solid fraction 0.64",
        files: &[
            ("case.toml", include_str!("../../examples/18-frictionless/case.toml")),
            ("README.md", include_str!("../../examples/18-frictionless/README.md")),
            ("jamming.svg", include_str!("../../examples/18-frictionless/jamming.svg")),
        ],
    },
    Example {
        name: "19-pluviation",
        about: "grains rain into a box and settle: porosity against the height of fall and the rate",
        files: &[
            ("case.toml", include_str!("../../examples/19-pluviation/case.toml")),
            ("README.md", include_str!("../../examples/19-pluviation/README.md")),
            ("pluviation.svg", include_str!("../../examples/19-pluviation/pluviation.svg")),
        ],
    },
    Example {
        name: "20-seepage-column",
        about: "50 discs in water on a grid settle, and swell as water is pushed in from below (Goodarzi et al. 2013)",
        files: &[
            ("case.toml", include_str!("../../examples/20-seepage-column/case.toml")),
            ("column.csv", include_str!("../../examples/20-seepage-column/column.csv")),
            ("README.md", include_str!("../../examples/20-seepage-column/README.md")),
            ("uplift.svg", include_str!("../../examples/20-seepage-column/uplift.svg")),
            ("pressure.svg", include_str!("../../examples/20-seepage-column/pressure.svg")),
        ],
    },
    Example {
        name: "21-pores-or-darcy",
        about: "one consolidation pore by pore (case.toml) and on a grid (darcy.toml)",
        files: &[
            ("case.toml", include_str!("../../examples/21-pores-or-darcy/case.toml")),
            ("darcy.toml", include_str!("../../examples/21-pores-or-darcy/darcy.toml")),
            ("README.md", include_str!("../../examples/21-pores-or-darcy/README.md")),
            ("pores-or-darcy.svg", include_str!("../../examples/21-pores-or-darcy/pores-or-darcy.svg")),
        ],
    },
    Example {
        name: "22-quicksand",
        about: "water pushed up through a bed carries more and more of its weight, then all: the bed floats",
        files: &[
            ("case.toml", include_str!("../../examples/22-quicksand/case.toml")),
            ("README.md", include_str!("../../examples/22-quicksand/README.md")),
            ("quicksand.svg", include_str!("../../examples/22-quicksand/quicksand.svg")),
        ],
    },
    Example {
        name: "23-membrane-triaxial",
        about: "triaxial compression in a flexible membrane between two plates (case.toml), and between walls (rigid.toml)",
        files: &[
            ("case.toml", include_str!("../../examples/23-membrane-triaxial/case.toml")),
            ("rigid.toml", include_str!("../../examples/23-membrane-triaxial/rigid.toml")),
            ("README.md", include_str!("../../examples/23-membrane-triaxial/README.md")),
            ("curves.svg", include_str!("../../examples/23-membrane-triaxial/curves.svg")),
        ],
    },
    Example {
        name: "24-wave-speed",
        about: "a small pulse runs along and across a column of grains: its speed against that of the measured modulus",
        files: &[
            ("case.toml", include_str!("../../examples/24-wave-speed/case.toml")),
            ("README.md", include_str!("../../examples/24-wave-speed/README.md")),
            ("pulse.svg", include_str!("../../examples/24-wave-speed/pulse.svg")),
        ],
    },
    Example {
        name: "25-energy-budget",
        about: "grains are thrown together and sheared: where the energy goes, and that none is missing",
        files: &[
            ("case.toml", include_str!("../../examples/25-energy-budget/case.toml")),
            ("README.md", include_str!("../../examples/25-energy-budget/README.md")),
            ("energy.svg", include_str!("../../examples/25-energy-budget/energy.svg")),
            ("lost.svg", include_str!("../../examples/25-energy-budget/lost.svg")),
        ],
    },
];

/// What a case can choose from besides packings and measures: headings, and names with what they are.
const CHOICES: &[(&str, &[(&str, &str)])] = &[
    (
        "gradings of a cloud",
        &[
            ("uniform", "radii uniform within mean (1 ± spread)"),
            ("normal", "radii normal, cut at three deviations"),
            ("log-normal", "radii log-normal about their median, cut at three deviations"),
            ("sieve", "a table of diameters and passing mass"),
        ],
    ),
    (
        "arrangements of a lattice",
        &[
            ("simple-cubic", "6 contacts, porosity 0.476"),
            ("body-centred", "8 contacts, porosity 0.320"),
            ("face-centred", "12 contacts, porosity 0.260"),
            ("hexagonal-close", "12 contacts, porosity 0.260"),
        ],
    ),
    (
        "contact laws",
        &[
            ("linear", "linear springs with Coulomb friction"),
            ("hertz-mindlin", "springs of elastic spheres with Coulomb friction"),
        ],
    ),
    (
        "boundary rules, solid",
        &[
            ("fixed", "the wall stays where it is"),
            ("moving", "the wall moves at a given velocity"),
            ("servo", "the wall is a piston pressed by a given stress"),
        ],
    ),
    (
        "motions of walls",
        &[
            ("fixed", "the wall stays where it is"),
            ("moving", "it moves at a given velocity"),
            ("rotating", "it turns about an axis at a given rate"),
            ("servo", "it is pushed along a direction by a given force or stress"),
        ],
    ),
    (
        "boundary rules, water",
        &[
            ("sealed", "no flow through the face"),
            ("pressure", "the excess pressure is given"),
            ("inflow", "what comes in per area is given"),
        ],
    ),
    (
        "rules of points in the water",
        &[("pressure", "the excess pressure is given"), ("source", "what comes in is given")],
    ),
    (
        "boundary rules, slip",
        &[("symmetry", "the wall is a mirror for the water"), ("no-slip", "the water sticks to the wall")],
    ),
    (
        "flows",
        &[
            ("pores", "pore by pore: a finite volume method on the triangulation of the grains"),
            ("darcy", "Darcy's law on a grid coarser than the grains"),
        ],
    ),
    ("conductances", &CONDUCTANCES),
    (
        "couplings",
        &[
            ("reciprocal", "forces and volume rates from one set of coefficients"),
            ("geometric", "volume rates of the tetrahedra, forces by wetted surface, for comparison"),
        ],
    ),
    (
        "steps of the water",
        &[
            ("auto", "implicit where the water would shorten an explicit step more than three times"),
            ("explicit", "from the velocities before the step"),
            ("implicit", "together with the velocities after the step"),
        ],
    ),
    (
        "solvers",
        &[
            ("auto", "by size"),
            ("cholesky", "sparse factorisation"),
            ("cg", "conjugate gradients"),
            ("gauss-seidel", "sweeps, the baseline of the thesis: slow"),
        ],
    ),
    (
        "actions on trouble",
        &[("ignore", "nothing"), ("warn", "say so, once in a stage"), ("stop", "say so and stop the run")],
    ),
    (
        "signs of trouble",
        &[
            ("outside", "the centre of a grain leaves the box"),
            ("deep-overlap", "a contact overlaps by half the smaller radius"),
            ("long-step", "a fixed time step is longer than the stability limit"),
            ("servo", "a servo wall or a held stress of the cell is off when its stage ends"),
        ],
    ),
    (
        "signals",
        &[
            ("ramp", "from one value to another between two times"),
            ("sine", "around a mean"),
            ("table", "straight lines between given points"),
        ],
    ),
];

/// `porograin list`.
pub fn list() -> Outcome {
    let examples: Vec<(&str, &str)> = EXAMPLES.iter().map(|e| (e.name, e.about)).collect();
    section("examples", &examples);
    section("packings", &PACKINGS);
    section("shapes of walls", &SHAPES);
    section("shapes of regions", &REGIONS);
    section("places of fields", &PLACES);
    for (heading, choices) in CHOICES {
        section(heading, choices);
    }
    let names: Vec<String> = Measure::ALL.iter().map(|m| m.name()).collect();
    let measures: Vec<(&str, &str)> =
        names.iter().zip(Measure::ALL).map(|(name, m)| (name.as_str(), m.describe())).collect();
    section("measures", &measures);
    Ok(None)
}

fn section(heading: &str, entries: &[(&str, &str)]) {
    // Whoever reads may have seen enough.
    let mut out = std::io::stdout();
    let _ = writeln!(out, "{heading}:");
    for (name, about) in entries {
        let _ = writeln!(out, "  {name:<18} {about}");
    }
}

/// `porograin new`: writes the files of an example; nothing is overwritten.
pub fn new(name: &str, folder: Option<PathBuf>) -> Outcome {
    let Some(example) =
        EXAMPLES.iter().find(|e| e.name == name || e.name.split_once('-').is_some_and(|p| p.1 == name))
    else {
        let names: Vec<&str> = EXAMPLES.iter().map(|e| e.name).collect();
        let guess = nearest(name, names.iter().copied());
        let guess = guess.map_or(String::new(), |near| format!("did you mean {near}? "));
        return Err(Failure::Input(format!(
            "there is no example `{name}`\n  = {guess}there is: {}",
            names.join(", ")
        )));
    };
    let folder = folder.unwrap_or_else(|| PathBuf::from(example.name));
    let shown = folder.display();
    if let Some((file, _)) = example.files.iter().find(|(file, _)| folder.join(file).exists()) {
        return Err(Failure::Input(format!("{shown}/{file} is there already: name another folder")));
    }
    let write = || -> std::io::Result<()> {
        std::fs::create_dir_all(&folder)?;
        example.files.iter().try_for_each(|(file, text)| std::fs::write(folder.join(file), text))
    };
    write().map_err(|e| Failure::Input(format!("cannot write into {shown}: {}", reason(&e))))?;
    say!("{}\nrun it with: porograin run {shown}/{}", example.about, example.files[0].0);
    Ok(None)
}

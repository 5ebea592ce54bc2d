//! Materials: which grains are made of what, and the laws between two of them.

use super::check::Range;
use super::{Case, CaseError};
use crate::contact::{Law, PairLaw, WALL};
use crate::grains::Grains;
use crate::rain::Kind;
use serde::Deserialize;

/// What some of the grains are made of.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Material {
    /// Part of the grains, by number; the grains are picked at random, always the same ones.
    pub part: f64,
    /// Of the solid [kg/m³]; by default that of `[grains]`.
    pub density: Option<f64>,
}

/// The law between two materials, or between one and the walls.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Pair {
    /// Their names; `"wall"` stands for the walls.
    pub between: [String; 2],
    /// The law, complete.
    pub contact: Law,
}

/// The walls, as the name of a material.
const WALLS: &str = "wall";

impl Case {
    /// The number of a material: its place in the order of the alphabet.
    fn material_number(&self, name: &str) -> Option<u16> {
        if name == WALLS {
            return Some(WALL);
        }
        self.material.keys().position(|key| key == name).map(|k| k as u16)
    }

    /// The laws between materials.
    pub(super) fn pair_laws(&self) -> Vec<PairLaw> {
        // Names were checked when the case was read.
        let law = |pair: &Pair| {
            let [a, b] = pair.between.each_ref().map(|name| self.material_number(name));
            Some(PairLaw { between: [a?, b?], law: pair.contact.clone() })
        };
        self.pair.iter().filter_map(law).collect()
    }

    /// Gives every grain its material, and the mass that goes with it.
    pub(super) fn assign_materials(&self, grains: &mut Grains) {
        if self.material.is_empty() {
            return;
        }
        let mut order: Vec<usize> = (0..grains.len()).collect();
        order.sort_unstable_by_key(|&k| scattered(grains.id[k]));
        let mut until = 0.0;
        let mut first = 0;
        for (number, material) in self.material.values().enumerate() {
            until += material.part;
            let end = ((until * grains.len() as f64).round() as usize).clamp(first, grains.len());
            for &k in &order[first..end] {
                grains.material[k] = number as u16;
                if let Some(density) = material.density {
                    grains.mass[k] = density * grains.shape.volume(grains.radius[k]);
                }
            }
            first = end;
        }
    }

    /// What grains that come in later are made of.
    pub(super) fn kinds(&self) -> Vec<Kind> {
        let density = self.grains.density;
        if self.material.is_empty() {
            return vec![Kind { part: 1.0, density }];
        }
        let of =
            |material: &Material| Kind { part: material.part, density: material.density.unwrap_or(density) };
        self.material.values().map(of).collect()
    }

    pub(super) fn check_materials(&self) -> Result<(), CaseError> {
        for (name, material) in &self.material {
            let at = |key: &str| format!("material.{name}.{key}");
            if name == WALLS {
                return self.refuse(
                    &format!("material.{name}"),
                    "`wall` stands for the walls: call it something else",
                );
            }
            self.number(&at("part"), material.part, Range::Share)?;
            self.optional(&at("density"), material.density, Range::Positive)?;
        }
        let sum: f64 = self.material.values().map(|material| material.part).sum();
        if !self.material.is_empty() && (sum - 1.0).abs() > 1e-9 {
            return self.refuse("material", format!("the parts of the materials add up to {sum}, not to 1"));
        }
        for (k, pair) in self.pair.iter().enumerate() {
            let at = |key: &str| format!("pair.{k}.{key}");
            for name in &pair.between {
                if self.material_number(name).is_none() {
                    let known: Vec<&str> = self.material.keys().map(String::as_str).collect();
                    return Err(self
                        .source
                        .fault(&at("between"), format!("there is no material `{name}`"))
                        .hint(format!("the case has {} and wall", known.join(", "))));
                }
            }
            if pair.between.iter().all(|name| name == WALLS) {
                return self.refuse(&at("between"), "walls do not touch walls");
            }
            let same = |other: &Pair| {
                let [a, b] = &pair.between;
                other.between == pair.between || other.between == [b.clone(), a.clone()]
            };
            if self.pair[..k].iter().any(same) {
                let [a, b] = &pair.between;
                return self.refuse(&at("between"), format!("`{a}` and `{b}` have a law already"));
            }
            self.law(&at("contact"), &pair.contact)?;
        }
        Ok(())
    }
}

/// A number without any order in it (the finaliser of `SplitMix64`).
fn scattered(id: u32) -> u64 {
    let mut x = u64::from(id).wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    x = (x ^ (x >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    x ^ (x >> 31)
}

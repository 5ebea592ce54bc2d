//! Compaction to a given porosity: friction is lowered until the grains give way so far.
//!
//! Frictional grains come to rest at a porosity that depends on their friction. Whenever the sample rests and is still too
//! loose, the friction between grains is multiplied by a factor and some contacts slip; once it is dense enough the friction of the
//! stage is back at once, so that the sample stays as it is (after the procedure of Chareyre for the open-source code Yade).

use serde::{Deserialize, Serialize};

/// What a stage is to reach.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Compact {
    /// Void part of the box at the end of the stage [-].
    pub porosity: f64,
    /// What friction is multiplied by whenever the sample rests, more than 0 and less than 1.
    #[serde(default = "step")]
    pub factor: f64,
}

fn step() -> f64 {
    0.9
}

/// How far a compaction has come.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Compaction {
    /// Friction angle between grains over that of the stage [-].
    pub friction: f64,
    /// Lowest it has been.
    pub lowest: f64,
    /// Whether the porosity is reached.
    pub reached: bool,
}

impl Default for Compaction {
    fn default() -> Self {
        Compaction { friction: 1.0, lowest: 1.0, reached: false }
    }
}

/// Below this part of the stage's friction nothing is left to give way.
const FRICTIONLESS: f64 = 1e-4;

impl Compaction {
    /// Whether the sample rests too loose with hardly any friction left.
    pub fn is_stuck(&self) -> bool {
        !self.reached && self.friction < FRICTIONLESS
    }

    /// Takes note of the porosity, and of whether the sample rests.
    pub fn look(&mut self, rule: &Compact, porosity: f64, rests: bool) {
        if self.reached {
            return;
        }
        if porosity <= rule.porosity {
            self.reached = true;
            self.friction = 1.0;
        } else if rests {
            self.friction *= rule.factor;
            self.lowest = self.friction;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_falls_at_rest_and_comes_back() {
        let (rule, mut now) = (Compact { porosity: 0.4, factor: 0.5 }, Compaction::default());
        now.look(&rule, 0.45, false);
        assert_eq!(now, Compaction::default());
        now.look(&rule, 0.44, true);
        now.look(&rule, 0.43, true);
        assert_eq!((now.friction, now.reached), (0.25, false));
        now.look(&rule, 0.399, false);
        assert_eq!(now, Compaction { friction: 1.0, lowest: 0.25, reached: true });
        // What happens later changes nothing.
        now.look(&rule, 0.41, true);
        assert_eq!(now.friction, 1.0);
    }
}

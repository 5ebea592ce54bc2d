//! From springs to a contact law: sliding under Coulomb's rule, and what a law may have besides.

use super::{Adhesion, Bond, Capillary, ContactLaw, Memory, More, PairLoad, Rolling, Stiffness, Touch};
use glam::DVec3;

/// The elastic part of a law: a spring along the normal and its tangents.
pub trait Spring: Send + Sync {
    /// Pressing force of the spring [N].
    fn force(&self, touch: &Touch) -> f64;

    /// Tangent stiffnesses.
    fn stiffness(&self, touch: &Touch) -> Stiffness;

    /// Energy of the normal spring [J].
    fn energy(&self, touch: &Touch) -> f64;

    /// What the law has besides springs and friction.
    fn extras(&self) -> Extras;

    /// What is left of the shear force after the last step because the tangent stiffness fell [-].
    #[inline(always)]
    fn unloaded(&self, _touch: &Touch, _dt: f64) -> f64 {
        1.0
    }
}

/// What a law may have besides springs and friction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Extras {
    /// Ratio of the viscous damping to the critical one [-].
    pub restitution: Option<f64>,
    /// Bonds with a strength.
    pub adhesion: Option<Adhesion>,
    /// Resistance to rolling and twisting.
    pub rolling: Option<Rolling>,
    /// Liquid bridges.
    pub capillary: Option<Capillary>,
}

impl Extras {
    /// Whether there is nothing besides.
    pub fn is_empty(&self) -> bool {
        *self == Extras::default()
    }
}

/// Springs and Coulomb friction, and nothing else: the law of the fast pass.
#[derive(Clone, Copy, Debug)]
pub struct Plain<'a, S>(pub &'a S);

impl<S: Spring> ContactLaw for Plain<'_, S> {
    /// `F = F_s - F_n n`; the shear force grows by `k_t v_t dt` and is cut at `F_n tan(phi)`. No tension.
    #[inline(always)]
    fn load(&self, touch: &Touch, memory: &mut Memory, dt: f64) -> PairLoad {
        let pressing = self.0.force(touch);
        let trial =
            self.0.unloaded(touch, dt) * memory.shear + self.0.stiffness(touch).shear * dt * touch.sliding();
        memory.shear = cut(trial, touch.friction * pressing);
        PairLoad { force: memory.shear - pressing * touch.normal, moment: DVec3::ZERO }
    }

    #[inline(always)]
    fn stiffness(&self, touch: &Touch) -> Stiffness {
        self.0.stiffness(touch)
    }

    fn energy(&self, touch: &Touch, memory: &Memory) -> f64 {
        self.0.energy(touch) + stored(memory.shear.length_squared(), self.0.stiffness(touch).shear)
    }
}

/// A law with everything it has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Full<'a, S>(pub &'a S);

impl<S: Spring> Full<'_, S> {
    /// The gap up to which the law acts between grains no larger than `radius` [m].
    pub fn reach(&self, radius: f64) -> f64 {
        let extras = self.0.extras();
        let touch = Touch::prospective([radius; 2], 0.0, 1.0);
        // The bond of the smaller of two grains stretches less than that of two large ones.
        let stretch = |a: Adhesion| a.strength(&touch)[0] / self.0.stiffness(&touch).normal;
        extras.adhesion.map_or(0.0, stretch).max(extras.capillary.map_or(0.0, |c| c.rupture(&touch)))
    }

    /// Energy along the normal, of the spring, the bond and the bridge [J]: of all that [`load`](ContactLaw::load) presses with besides
    /// dampers. The budget of the energy and the accounts of contacts rely on it.
    #[inline]
    pub fn pressed(&self, touch: &Touch, more: &More) -> f64 {
        let spring = if self.springs(touch, more) { self.0.energy(touch) } else { 0.0 };
        let bridge = self.0.extras().capillary.filter(|_| more.bridge);
        spring + bridge.map_or(0.0, |capillary| capillary.energy(touch))
    }

    /// Whether the springs act, pressed or held by a bond.
    #[inline]
    fn springs(&self, touch: &Touch, more: &More) -> bool {
        touch.overlap > 0.0 || self.0.extras().adhesion.is_some() && more.bond == Bond::Whole
    }
}

impl<S: Spring> ContactLaw for Full<'_, S> {
    /// Dampers `c = 2 zeta sqrt(k m)` beside both springs, `m` the reduced mass; without a bond they neither pull nor leave
    /// the friction cone. Bonds hold or break, then moments give way, then the bridge pulls.
    #[inline]
    fn load(&self, touch: &Touch, memory: &mut Memory, dt: f64) -> PairLoad {
        let extras = self.0.extras();
        if extras.is_empty() {
            return Plain(self.0).load(touch, memory, dt);
        }
        let stiffness = self.stiffness(touch);
        let (sliding, leaving) = (touch.sliding(), touch.velocity.dot(touch.normal));
        let more = &mut memory.more;
        let normal = self.0.force(touch) - stiffness.normal_damper * leaving;
        let trial = self.0.unloaded(touch, dt) * memory.shear + stiffness.shear * dt * sliding;
        let mut pressing = if touch.overlap > 0.0 { normal.max(0.0) } else { 0.0 };
        let mut cap = touch.friction * pressing;
        if let Some(adhesion) = extras.adhesion {
            if adhesion.renew && more.bond == Bond::None {
                more.bond = Bond::Whole;
            }
            if more.bond == Bond::Whole {
                let [tension, cohesion] = adhesion.strength(touch);
                let held = touch.friction * normal.max(0.0) + cohesion;
                if -normal > tension || trial.length_squared() > held * held {
                    more.bond = Bond::Broken;
                } else {
                    (pressing, cap) = (normal, held);
                }
            }
        }
        memory.shear = cut(trial, cap);
        let shear = cut(memory.shear + stiffness.shear_damper * sliding, cap);
        let mut load = PairLoad { force: shear - pressing * touch.normal, moment: DVec3::ZERO };
        if let Some(rolling) = extras.rolling {
            let [roll, twist] = rolling.caps(touch, pressing.max(0.0));
            let twisting = touch.spin.dot(touch.normal);
            let rolls = touch.spin - twisting * touch.normal;
            more.roll = cut(more.roll + stiffness.roll * dt * rolls, roll);
            more.twist = (more.twist + stiffness.twist * dt * twisting).clamp(-twist, twist);
            load.moment = more.roll + more.twist * touch.normal;
        }
        if let Some(capillary) = extras.capillary {
            more.bridge = touch.overlap > 0.0 || more.bridge && -touch.overlap < capillary.rupture(touch);
            if more.bridge {
                load.force += capillary.pull(touch) * touch.normal;
            }
        }
        load
    }

    #[inline]
    fn stiffness(&self, touch: &Touch) -> Stiffness {
        let mut stiffness = self.0.stiffness(touch);
        let extras = self.0.extras();
        if let Some(ratio) = extras.restitution {
            stiffness.normal_damper = 2.0 * ratio * (stiffness.normal * touch.mass).sqrt();
            stiffness.shear_damper = 2.0 * ratio * (stiffness.shear * touch.mass).sqrt();
        }
        if let Some(rolling) = extras.rolling {
            [stiffness.roll, stiffness.twist] = rolling.stiffnesses(touch, &stiffness);
        }
        stiffness
    }

    fn energy(&self, touch: &Touch, memory: &Memory) -> f64 {
        let (stiffness, more) = (self.stiffness(touch), &memory.more);
        let mut energy = self.pressed(touch, more);
        if self.springs(touch, more) {
            energy += stored(memory.shear.length_squared(), stiffness.shear);
            energy += stored(more.roll.length_squared(), stiffness.roll);
            energy += stored(more.twist * more.twist, stiffness.twist);
        }
        energy
    }

    #[inline]
    fn holds(&self, touch: &Touch, memory: &Memory) -> bool {
        let more = &memory.more;
        self.springs(touch, more) || self.0.extras().capillary.is_some() && more.bridge
    }
}

/// The vector, shortened to `cap` if it is longer.
#[inline(always)]
fn cut(trial: DVec3, cap: f64) -> DVec3 {
    let size = trial.length_squared();
    trial * if size > cap * cap { cap / size.sqrt() } else { 1.0 }
}

/// Energy of a spring that carries a force of this squared size; without a spring there is no force.
fn stored(squared: f64, stiffness: f64) -> f64 {
    if stiffness > 0.0 { 0.5 * squared / stiffness } else { 0.0 }
}

//! From springs to a contact law: sliding under Coulomb's rule, and what a law may have besides.

use super::{ContactLaw, Memory, PairLoad, Stiffness, Touch};
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
    pub fn reach(&self, _radius: f64) -> f64 {
        0.0
    }
}

impl<S: Spring> ContactLaw for Full<'_, S> {
    /// Dampers `c = 2 zeta sqrt(k m)` beside both springs, `m` the reduced mass; together they neither pull nor leave
    /// the friction cone.
    #[inline]
    fn load(&self, touch: &Touch, memory: &mut Memory, dt: f64) -> PairLoad {
        let extras = self.0.extras();
        if extras.is_empty() {
            return Plain(self.0).load(touch, memory, dt);
        }
        let stiffness = self.stiffness(touch);
        let leaving = touch.velocity.dot(touch.normal);
        let sliding = touch.sliding();
        let pressing = (self.0.force(touch) - stiffness.normal_damper * leaving).max(0.0);
        let cap = touch.friction * pressing;
        memory.shear = cut(self.0.unloaded(touch, dt) * memory.shear + stiffness.shear * dt * sliding, cap);
        let shear = cut(memory.shear + stiffness.shear_damper * sliding, cap);
        PairLoad { force: shear - pressing * touch.normal, moment: DVec3::ZERO }
    }

    #[inline]
    fn stiffness(&self, touch: &Touch) -> Stiffness {
        let mut stiffness = self.0.stiffness(touch);
        if let Some(ratio) = self.0.extras().restitution {
            stiffness.normal_damper = 2.0 * ratio * (stiffness.normal * touch.mass).sqrt();
            stiffness.shear_damper = 2.0 * ratio * (stiffness.shear * touch.mass).sqrt();
        }
        stiffness
    }

    fn energy(&self, touch: &Touch, memory: &Memory) -> f64 {
        Plain(self.0).energy(touch, memory)
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

//! Regulators put together for the papers' figures.

use crate::control::{Addc, Measured, PaperB, Pi, SpeedController};

/// A fixed PI regulator to which the adaptation joins at a cycle: 0 for always, `usize::MAX` for never.
pub(in crate::workflow::reproduce) struct Joining {
    fixed: Pi,
    adaptive: Addc,
    joins_at: usize,
    cycle: usize,
    output: f64,
    /// Inertia over the model's, where the estimate is settled, and the proportional gain, after each cycle.
    pub(crate) ratios: Vec<f64>,
    pub(crate) proportional: Vec<f64>,
}

impl Joining {
    pub(crate) fn new(fixed: Pi, adaptive: Addc, joins_at: usize) -> Self {
        Self {
            fixed,
            adaptive,
            joins_at,
            cycle: 0,
            output: 0.0,
            ratios: Vec::new(),
            proportional: Vec::new(),
        }
    }

    const fn joined(&self) -> bool {
        self.cycle >= self.joins_at
    }
}

impl SpeedController for Joining {
    fn id(&self) -> &'static str {
        "joining"
    }

    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64 {
        if !self.joined() {
            return self.fixed.step(reference_rad_s, now, period_s);
        }
        if self.cycle == self.joins_at && self.cycle > 0 {
            self.adaptive.reset(now, self.output);
        }
        self.adaptive.step(reference_rad_s, now, period_s)
    }

    fn applied(&mut self, output: f64) {
        let pi = if self.joined() {
            self.adaptive.applied(output);
            let ratio = self.adaptive.inertia_ratio();
            let settled = self.adaptive.is_settled();
            self.ratios.push(if settled { ratio } else { f64::NAN });
            self.adaptive.pi()
        } else {
            self.fixed.applied(output);
            self.ratios.push(f64::NAN);
            &self.fixed
        };
        self.proportional.push(pi.gains().proportional);
        self.output = output;
        self.cycle += 1;
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        self.fixed.reset(now, output);
        self.adaptive.reset(now, output);
        self.output = output;
    }

    fn explain(&self) -> Vec<String> {
        if self.joined() {
            self.adaptive.explain()
        } else {
            self.fixed.explain()
        }
    }
}

/// Paper B's regulator on a motor with a back-EMF: the voltage that holds the reference at no load is added to its own.
pub(in crate::workflow::reproduce) struct WithBackEmf {
    inner: PaperB,
    back_emf_v_s_per_rad: f64,
    fed_forward_v: f64,
}

impl WithBackEmf {
    pub(crate) const fn new(inner: PaperB, back_emf_v_s_per_rad: f64) -> Self {
        Self {
            inner,
            back_emf_v_s_per_rad,
            fed_forward_v: 0.0,
        }
    }
}

impl SpeedController for WithBackEmf {
    fn id(&self) -> &'static str {
        self.inner.id()
    }

    fn step(&mut self, reference_rad_s: f64, now: &Measured, period_s: f64) -> f64 {
        self.fed_forward_v = self.back_emf_v_s_per_rad * reference_rad_s;
        self.fed_forward_v + self.inner.step(reference_rad_s, now, period_s)
    }

    fn applied(&mut self, output: f64) {
        self.inner.applied(output - self.fed_forward_v);
    }

    fn reset(&mut self, now: &Measured, output: f64) {
        self.fed_forward_v = self.back_emf_v_s_per_rad * now.speed_rad_s;
        self.inner.reset(now, output - self.fed_forward_v);
    }

    fn explain(&self) -> Vec<String> {
        let mut said = self.inner.explain();
        said.push(format!(
            "the back-EMF of the reference is fed forward: {:.1} V",
            self.fed_forward_v
        ));
        said
    }
}

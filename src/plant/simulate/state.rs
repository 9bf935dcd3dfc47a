//! What a simulation carries from step to step.

/// States that all effects of one model may have together.
pub(super) const MOST_STATES: usize = 6;

/// State of motor and effects.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    pub current_a: f64,
    pub speed_rad_s: f64,
    pub angle_rad: f64,
    pub(super) own: [f64; MOST_STATES],
    pub(super) mode: Mode,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Mode {
    #[default]
    Undecided,
    Stuck,
    Forward,
    Backward,
}

impl Mode {
    pub(super) const fn sign(self) -> f64 {
        match self {
            Self::Forward => 1.0,
            Self::Backward => -1.0,
            Self::Stuck | Self::Undecided => 0.0,
        }
    }
}

impl State {
    pub fn at(current_a: f64, speed_rad_s: f64) -> Self {
        Self {
            current_a,
            speed_rad_s,
            ..Self::default()
        }
    }

    /// The same state with the states of the effects at these values, as a winding that is warm already.
    #[must_use]
    pub fn with_effects(mut self, own: &[f64]) -> Self {
        for (state, value) in self.own.iter_mut().zip(own) {
            *state = *value;
        }
        self
    }

    /// Moves by what was measured, where that is a number; the mode of motion follows from it.
    pub(super) fn anchor(&mut self, change_a: f64, change_rad_s: f64) {
        if change_a.is_finite() {
            self.current_a += change_a;
        }
        if change_rad_s.is_finite() && change_rad_s != 0.0 {
            self.speed_rad_s += change_rad_s;
            self.mode = Mode::Undecided;
        }
    }

    /// The states of the effects, one effect after the other.
    pub fn own(&self) -> &[f64] {
        &self.own
    }

    /// Direction of motion: one forward, minus one backward, zero at rest.
    pub fn direction(&self) -> f64 {
        match self.mode {
            Mode::Undecided if self.speed_rad_s != 0.0 => self.speed_rad_s.signum(),
            mode => mode.sign(),
        }
    }
}

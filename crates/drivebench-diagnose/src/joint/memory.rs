//! Unknown torque that depends on the past of the speed beyond its present value, as columns: what fades with time (functions of
//! the speed behind first-order lags), what stays until the speed comes back (play operators: Visintin, *Differential Models of
//! Hysteresis*, Springer 1994), and friction that rises while the shaft is slow.

use super::tangent::Tangent;
use drivebench_model::numerics::statistics::median_step;
use drivebench_model::plant::{Instant, Scenario, Terms};

/// Shares of the largest speed: middles of hat functions, besides the one at rest (all of them add up to a constant).
const HATS: [f64; 4] = [-1.0, -0.5, 0.5, 1.0];
/// Half of the play, as shares of the largest speed.
const PLAYS: [f64; 2] = [0.1, 0.3];
/// Half of the range of speed that counts as slow, as a share of the largest speed.
const SLOW: f64 = 0.1;

enum Memory {
    /// Hat function about this share of the largest speed, behind a lag, minus the function.
    Fading(f64),
    /// Speed behind a play of this half-width, minus the speed; both as shares of the largest speed.
    Play(f64),
    /// Friction in proportion to the lagged share of the time at which the shaft is slow.
    Dwell,
}

/// A torque with memory, and its state.
struct Past {
    memory: Memory,
    most_rad_s: f64,
    time_constant_s: f64,
    size_n_m: f64,
}

impl Past {
    /// What the state follows.
    fn followed(&self, share: f64) -> f64 {
        match self.memory {
            Memory::Fading(middle) => (1.0 - 2.0 * (share - middle).abs()).max(0.0),
            Memory::Play(_) => share,
            Memory::Dwell => (1.0 - share.abs() / SLOW).max(0.0),
        }
    }
}

impl Terms for Past {
    fn torque_n_m(&self, at: &Instant, own: &[f64]) -> f64 {
        let share = at.speed_rad_s / self.most_rad_s;
        self.size_n_m
            * match self.memory {
                Memory::Dwell if share == 0.0 => 0.0,
                Memory::Dwell => own[0].copysign(share),
                _ => own[0] - self.followed(share),
            }
    }

    fn states(&self) -> usize {
        1
    }

    fn advance(&self, at: &Instant, own: &mut [f64], interval_s: f64) {
        let to = self.followed(at.speed_rad_s / self.most_rad_s);
        own[0] = match self.memory {
            Memory::Play(half) => own[0].clamp(to - half, to + half),
            _ => to + (own[0] - to) * (-interval_s / self.time_constant_s).exp(),
        };
    }
}

/// Columns of torques of this size over the past of a speed up to `most_rad_s`.
pub(super) fn torque_over_the_past(
    scenario: &Scenario,
    most_rad_s: f64,
    size_n_m: f64,
) -> Vec<Tangent> {
    let times = &scenario.sample_time_s;
    let length_s = times.last().map_or(0.0, |last_s| last_s - scenario.begin_s());
    // A lag of few samples is none, and one of more than the run fades nowhere in it.
    let (short_s, long_s) = (10.0 * median_step(times), length_s / 6.0);
    let middle_s = (short_s * long_s).sqrt();
    let past = |memory, time_constant_s| {
        Tangent::Terms(Box::new(Past { memory, most_rad_s, time_constant_s, size_n_m }))
    };
    let fading = HATS.into_iter().flat_map(|middle| {
        [short_s, middle_s, long_s].map(|lag_s| past(Memory::Fading(middle), lag_s))
    });
    let plays = PLAYS.map(|half| past(Memory::Play(half), long_s));
    let dwells = [middle_s, long_s].map(|lag_s| past(Memory::Dwell, lag_s));
    fading.chain(plays).chain(dwells).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Torque after each of these speeds, each held for ten time constants.
    fn after<const N: usize>(memory: Memory, speeds_rad_s: [f64; N]) -> [f64; N] {
        let past = Past { memory, most_rad_s: 100.0, time_constant_s: 0.2, size_n_m: 1.0 };
        let mut own = [0.0];
        speeds_rad_s.map(|speed_rad_s| {
            let at = Instant { speed_rad_s, ..Instant::default() };
            past.advance(&at, &mut own, 2.0);
            past.torque_n_m(&at, &own)
        })
    }

    #[test]
    fn only_a_play_remembers_for_ever_and_a_slow_shaft_gathers_friction() {
        for (name, torques, expected) in [
            ("fading", after(Memory::Fading(1.0), [100.0, 50.0, -80.0]), [0.0; 3]),
            ("play", after(Memory::Play(0.1), [60.0, 45.0, 20.0]), [-0.1, 0.05, 0.1]),
            ("dwell", after(Memory::Dwell, [-0.01, 50.0, -5.0]), [-1.0, 0.0, -0.5]),
        ] {
            for (torque, expected) in torques.into_iter().zip(expected) {
                assert!((torque - expected).abs() < 2e-3, "{name}: {torques:?}");
            }
        }
    }

    #[test]
    fn what_fades_is_the_difference_to_what_came_before() {
        let past = Past {
            memory: Memory::Fading(1.0),
            most_rad_s: 100.0,
            time_constant_s: 0.2,
            size_n_m: 3.0,
        };
        let at = Instant { speed_rad_s: 100.0, ..Instant::default() };
        let mut own = [0.0];
        past.advance(&at, &mut own, 0.2);
        assert!((past.torque_n_m(&at, &own) + 3.0 * (-1.0_f64).exp()).abs() < 1e-12);
    }
}

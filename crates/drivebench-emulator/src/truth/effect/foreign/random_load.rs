//! A random load torque: an Ornstein-Uhlenbeck process.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::{Acts, HiddenKind, Mechanism, Moment, NotNegative, Positive};

pub(in super::super) const KIND: HiddenKind = HiddenKind {
    id: "random_load",
    names: &[],
    parameters: &[
        // Standard deviation.
        NotNegative.of("std_n_m", "N.m", 0.06, 0.06..0.12),
        // Correlation time.
        Positive.of("correlation_s", "s", 0.05, 0.15..0.4),
    ],
    mystery: Some(|dice| {
        vec![dice.size(0.03, 0.08) * dice.rated_torque_n_m, dice.between(0.03, 0.2)]
    }),
    acts: Acts::Inside(|values, site| {
        let mut rng = ChaCha8Rng::seed_from_u64(site.seed);
        // Stream of the generator; sensor noise and tolerances have their own.
        rng.set_stream(3);
        Box::new(OrnsteinUhlenbeck {
            std_n_m: values[0],
            correlation_s: values[1],
            torque_n_m: 0.0,
            rng,
        })
    }),
};

/// Ornstein-Uhlenbeck process by its exact discretisation (Gillespie, Phys. Rev. E 54, 1996).
struct OrnsteinUhlenbeck {
    std_n_m: f64,
    correlation_s: f64,
    torque_n_m: f64,
    rng: ChaCha8Rng,
}

impl Mechanism for OrnsteinUhlenbeck {
    fn load_torque_n_m(&self, _at: &Moment) -> f64 {
        self.torque_n_m
    }

    fn advance(&mut self, step_s: f64, _at: &Moment, _put_out_v: f64) {
        let decay = (-step_s / self.correlation_s).exp();
        let normal: f64 = self.rng.sample(StandardNormal);
        self.torque_n_m =
            decay * self.torque_n_m + self.std_n_m * (1.0 - decay * decay).sqrt() * normal;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn has_the_stated_spread_and_memory() {
        let mut load = KIND.mechanism(&[0.02, 0.05]);
        let step = 1e-3;
        let torque: Vec<f64> = (0..400_000)
            .map(|_| {
                load.advance(step, &Moment::default(), 0.0);
                load.load_torque_n_m(&Moment::default())
            })
            .collect();
        let n = torque.len() as f64;
        let mean_square = torque.iter().map(|t| t * t).sum::<f64>() / n;
        let lag = 50;
        let product = torque.iter().zip(&torque[lag..]).map(|(a, b)| a * b).sum::<f64>() / n;
        // 400 s hold 4000 independent values of the square: 1 of 45 is its standard error.
        assert!((mean_square.sqrt() / 0.02 - 1.0).abs() < 0.05);
        assert!((product / mean_square - (-1.0_f64).exp()).abs() < 0.1);
    }
}

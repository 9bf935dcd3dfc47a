//! The default sequence: rich enough to identify the motor and to separate the effects of the catalogue.

use super::{Dither, Prbs, Ramp, Segment, Sine, Standstill, Steps};

/// Standstill, bipolar steps over the full range with dither, a slow ramp through zero, a five-level pseudo-random part
/// of both signs, a slow sine through zero, standstill.
///
/// `voltage_v` is the greatest voltage, dither included; `slew_v_per_s` the slew limit of the program (300 to 500 for a motor
/// of 0.0045 kg.m2). The sequence lasts 12 s, longer under a slow slew limit. Another seed gives another run of the same
/// kind, for the hold-out.
pub fn rich(voltage_v: f64, slew_v_per_s: f64, seed: u64) -> Vec<Segment> {
    let dither_v = (0.2 * voltage_v).min(5.0);
    let full_v = voltage_v - dither_v;
    // Long enough to arrive at the level and to stay on it for a while.
    let hold_s = (full_v / slew_v_per_s + 0.15).max(0.3);
    let levels_v = [1.0, 0.0, -1.0, 0.0, 0.5, -0.5, 0.0].map(|share| share * full_v);
    let random_v = 0.5 * voltage_v;
    let clock_s = (0.5 * random_v / slew_v_per_s).max(0.04);
    let (standstill_s, ramp_s, sine_s) = (0.5, 2.0, 2.5);
    let other_s = levels_v.len() as f64 * hold_s + 2.0 * standstill_s + ramp_s + sine_s;
    let ramp_v = 0.25 * voltage_v;
    let rest = Segment::Standstill(Standstill { seconds: standstill_s });
    vec![
        rest.clone(),
        Segment::Steps(Steps {
            levels_v: levels_v.to_vec(),
            hold_s,
            dither: Some(Dither {
                amplitude_v: dither_v,
                // The dither must have time to change sign under the slew limit.
                clock_s: (2.4 * dither_v / slew_v_per_s).clamp(0.02, 0.05),
                seed,
            }),
        }),
        Segment::Ramp(Ramp { from_v: -ramp_v, to_v: ramp_v, seconds: ramp_s, dither: None }),
        Segment::Prbs(Prbs {
            amplitude_v: random_v,
            clock_s,
            // The whole lasts 12 s; a slow slew limit makes it longer, for eight changes at least.
            seconds: (12.0 - other_s).max(2.0).max(8.0 * clock_s),
            seed: seed.wrapping_add(1),
            offset_v: 0.0,
            levels: 5,
        }),
        Segment::Sine(Sine {
            amplitude_v: (0.5 * voltage_v).min(12.0),
            frequency_hz: 1.0 / sine_s,
            seconds: sine_s,
        }),
        rest,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::excitation::Program;
    use crate::sample::Demand;

    fn program(voltage_v: f64, slew_v_per_s: f64, seed: u64) -> Program {
        Program::new(&rich(voltage_v, slew_v_per_s, seed), slew_v_per_s).unwrap()
    }

    fn volts(program: &Program) -> Vec<f64> {
        let volts =
            |tick: u32| Demand::from(program.value_at(f64::from(tick) * 0.01)).voltage_v().unwrap();
        (0..1200).map(volts).collect()
    }

    #[test]
    fn it_follows_the_recipe_whatever_the_range() {
        for (voltage_v, slew_v_per_s) in [(24.0, 400.0), (48.0, 300.0), (110.0, 400.0), (5.0, 50.0)]
        {
            let program = program(voltage_v, slew_v_per_s, 1);
            assert!((program.duration_s() - 12.0).abs() < 1e-9);
            assert!(program.peak_v() <= voltage_v * (1.0 + 1e-12));
            assert!(program.peak_v() > 0.9 * voltage_v);
            let corners = program.polyline();
            assert!(corners.last().unwrap().1.abs() < 1e-9, "{corners:?}");
            // Pieces of no length have no slope.
            let is_steep = |pair: &[(f64, f64)]| {
                let most_v = slew_v_per_s * (pair[1].0 - pair[0].0);
                (pair[1].1 - pair[0].1).abs() > most_v * (1.0 + 1e-6) + 1e-9
            };
            assert!(!corners.windows(2).any(is_steep));
            let all = volts(&program);
            assert!(all[..40].iter().all(|volts| *volts == 0.0));
            let [ups, downs] = [1.0, -1.0].map(|sign| all.iter().filter(move |v| **v * sign > 0.0));
            assert!(ups.count() > 360 && downs.count() > 360);
        }
        // A slow slew limit makes it longer and refuses nothing.
        for slew_v_per_s in [100.0, 10.0, 1.0] {
            let slow = program(110.0, slew_v_per_s, 1);
            assert!(slow.duration_s() > 12.0 && slow.peak_v() > 99.0);
        }
    }

    #[test]
    fn another_seed_is_another_run() {
        let at = |seed| volts(&program(24.0, 400.0, seed));
        assert_eq!(at(1), at(1));
        let (one, two) = (at(1), at(2));
        let differ = one.iter().zip(&two).filter(|(a, b)| (*a - *b).abs() > 1e-9).count();
        assert!(differ > 300, "{differ} of 1200 instants differ");
    }

    /// ZK-22FC (110 V, 5.7 A), stepped finely, the voltage held for 10 ms as a 100 Hz host does.
    #[test]
    fn the_paper_motor_stays_under_four_times_its_rated_current() {
        let (r_ohm, l_h, ke, j_kg_m2, mc_n_m) = (1.1, 0.0099, 0.3538, 0.0045, 0.455);
        for seed in 0..5 {
            let (mut i, mut w, mut peak_a): (f64, f64, f64) = (0.0, 0.0, 0.0);
            for u in volts(&program(110.0, 400.0, seed)) {
                for _ in 0..200 {
                    let (torque, friction) = (ke * i, mc_n_m * (w / 0.5).tanh());
                    i += 5e-5 * (u - r_ohm * i - ke * w) / l_h;
                    w += 5e-5 * (torque - friction) / j_kg_m2;
                    peak_a = peak_a.max(i.abs());
                }
            }
            assert!((5.7..4.0 * 5.7).contains(&peak_a), "seed {seed}: {peak_a} A");
        }
    }
}

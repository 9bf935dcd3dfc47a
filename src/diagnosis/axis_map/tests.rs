use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::plant::testing::record;
use crate::plant::{ActiveEffect, Motor, effect};

/// Steps over the whole speed range with a binary dither on top, after a standstill.
fn rich(seed: u64, until_s: f64) -> Vec<(f64, f64)> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut events = vec![(0.0, 0.0)];
    let (mut at_s, mut hold_s, mut level) = (0.3, 0.3, 0.0);
    while at_s < until_s {
        if at_s >= hold_s {
            level = rng.random_range(-90.0..90.0);
            hold_s += rng.random_range(0.3..1.2);
        }
        events.push((at_s, level + if rng.random_bool(0.5) { 5.0 } else { -5.0 }));
        at_s += 0.001 * f64::from(rng.random_range(20..50_u16));
    }
    events
}

fn run(settings: &str, values: &[f64], seed: u64, period_s: f64, until_s: f64) -> Scenario {
    let mut truth = Model::baseline(Motor::zk_22fc());
    if !settings.is_empty() {
        let table: toml::Table = settings.parse().unwrap();
        let id = if table.contains_key("axis") {
            "table"
        } else {
            "custom"
        };
        let (effect, _) = effect::define(id, &table).unwrap();
        let values = values.iter().copied().map(Some).collect();
        truth.effects.push(ActiveEffect { effect, values });
    }
    record(&truth, rich(seed, until_s), period_s, until_s, seed)
}

fn maps(scenario: &Scenario) -> Vec<AxisMap> {
    let noise = NoiseFloor::from_standstill(scenario).unwrap();
    axis_map(&Model::baseline(Motor::zk_22fc()), scenario, &noise).unwrap()
}

const TORQUE: &str = "equation = \"torque\"\nparameters = [\"a\"]\nexpression = ";

#[test]
fn probe_everything() {
    let t = |e: &str| format!("{TORQUE}\"{e}\"");
    let v = |e: &str| t(e).replace("torque", "voltage");
    let cases = [
        ("none", String::new(), 0.0),
        ("bump", t("a*exp(-((w-118)/15)^2)"), 0.18),
        ("line", t("a*sin(2*pi*4.62*t)"), 0.1),
        ("fan", t("a*abs(w)*w"), 2e-6),
        ("viscous", t("a*w"), 5e-4),
        ("eccentric", t("a*sin(theta)"), 0.12),
        ("cog8", t("a*sin(8*theta)"), 0.12),
        ("drop", v("a*tanh(i/0.05)"), 1.0),
        ("warm", v("a*t*i"), 0.03),
    ];
    for period in [0.001, 0.01] {
        for (name, settings, size) in &cases {
            let until = if period < 0.005 { 12.0 } else { 24.0 };
            let s = run(settings, &[*size], 7, period, until);
            let begin = std::time::Instant::now();
            let m = maps(&s);
            println!("== {name} {period} {:?}", begin.elapsed());
            for m in m.iter().take(4) {
                println!(
                    "  {} {} {:.3} nres {:?} {}",
                    m.equation, m.axis, m.r2, m.error_over_noise, m.sentence
                );
            }
            if *name == "bump" {
                println!("{:.3?}\n{:.3?}\n{:.3?}", m[0].knots, m[0].values, m[0].std);
            }
        }
    }
}

#[test]
fn probe_data() {
    let Ok(folder) = std::env::var("DRIVEBENCH_DATA") else {
        return;
    };
    for set in 1..=12 {
        for part in ["train", "holdout"] {
            let path = format!("{folder}/hidden-effects/set{set:02}_{part}.csv");
            let loaded = crate::recording::open_run(path.as_ref(), None).unwrap();
            let s = Scenario::from_run(&loaded.run).unwrap();
            let begin = std::time::Instant::now();
            let m = maps(&s);
            println!("== {set} {part} {:?}", begin.elapsed());
            for m in m.iter().take(4) {
                println!(
                    "  {} {} {:.3} nres {:?} {}",
                    m.equation, m.axis, m.r2, m.error_over_noise, m.sentence
                );
            }
            if set == 12 {
                println!("{:.3?}\n{:.3?}\n{:.3?}", m[0].knots, m[0].values, m[0].std);
            }
        }
    }
}

//! 95 % intervals cover the truth: counted over seeded records of random motors.
#![expect(
    clippy::unwrap_used,
    reason = "helpers of an integration test are test code"
)]

#[path = "coverage/record.rs"]
mod record;

use drivebench::identification::noise::NoiseFloor;
use drivebench::identification::online::{Online, OnlineConfig};
use drivebench::identification::{output_error, start, weak_form};
use drivebench::plant::{Model, Motor, Scenario};
use drivebench::sample::{ParameterEstimate, Run, Verdict};
use rayon::prelude::*;
use record::{Sampling, Trajectory};

const KEYS: [&str; 5] = [
    "resistance_ohm",
    "inductance_h",
    "back_emf_v_s_per_rad",
    "inertia_kg_m2",
    "load_torque_n_m",
];

fn schemes() -> Vec<(&'static str, fn(&Run, &[f64; 5]) -> Vec<ParameterEstimate>)> {
    vec![
        ("output-error", |run, _| {
            let scenario = Scenario::from_run(run).unwrap();
            let model = start::complete(&Model::baseline(Motor::new("?")), &scenario).unwrap();
            let noise = NoiseFloor::from_standstill(&scenario).unwrap();
            output_error::fit(&[model], &scenario, &noise)
                .unwrap()
                .parameters
        }),
        ("weak-form", |run, _| {
            let scenario = Scenario::from_run(run).unwrap();
            weak_form::fit(&Model::baseline(Motor::new("?")), &scenario)
                .unwrap()
                .into_iter()
                .flat_map(|b| b.parameters)
                .collect()
        }),
        ("scheme 3", |run, _| online(run, None).estimates()),
        ("scheme 2", |run, truth| {
            online(run, Some(truth[2])).scheme_2()
        }),
    ]
}

fn online(run: &Run, kt: Option<f64>) -> Online {
    let mut online = Online::new(OnlineConfig {
        torque_n_m_per_a: kt,
        ..OnlineConfig::default()
    });
    for sample in run.samples() {
        online.push(&sample);
    }
    online
}

#[test]
#[ignore]
fn explore() {
    let env = |name: &str, default: u64| {
        std::env::var(name)
            .ok()
            .and_then(|v| v.parse().ok())
            .unwrap_or(default)
    };
    let (base, motors, seeds) = (env("BASE", 1000), env("MOTORS", 40), env("SEEDS", 5));
    let only = std::env::var("SCHEME").unwrap_or_default();
    let verbose = std::env::var("VERBOSE").is_ok();
    let all = [
        Sampling::Regular,
        Sampling::Jittered,
        Sampling::Quantised,
        Sampling::Fast,
    ];
    for sampling in all {
        if env("FAST", 1) == 0 && sampling == Sampling::Fast {
            continue;
        }
        if std::env::var("SAMPLING").is_ok_and(|s| s != format!("{sampling:?}")) {
            continue;
        }
        let trajectories: Vec<Trajectory> = (0..motors)
            .into_par_iter()
            .map(|m| {
                let mut t = Trajectory::random(base + m, sampling, 5.0);
                t.scale_noise(
                    env("NOISE", 100) as f64 / 100.0,
                    env("NOISEW", env("NOISE", 100)) as f64 / 100.0,
                );
                t
            })
            .collect();
        for (name, scheme) in schemes() {
            if !name.starts_with(only.as_str()) {
                continue;
            }
            let begin = std::time::Instant::now();
            let found: Vec<(usize, Vec<ParameterEstimate>)> = (0..motors * seeds)
                .into_par_iter()
                .filter(|k| {
                    env("ONLY", k / seeds) == k / seeds && env("SEED", k % seeds) == k % seeds
                })
                .map(|k| {
                    let t = (k / seeds) as usize;
                    (
                        t,
                        scheme(&trajectories[t].run(77 + k), &trajectories[t].truth),
                    )
                })
                .collect();
            println!("{sampling:?} {name} {:.1} s", begin.elapsed().as_secs_f64());
            for (j, key) in KEYS.iter().enumerate() {
                let mut z: Vec<(usize, f64, f64)> = Vec::new();
                let (mut settled, mut none, mut wrong) = (0, 0, 0);
                for (t, estimates) in &found {
                    let Some(e) = estimates.iter().find(|e| e.key == *key) else {
                        continue;
                    };
                    match (e.value, e.std) {
                        (Some(v), Some(s)) => {
                            let truth = trajectories[*t].truth[j];
                            z.push((*t, (v - truth) / s, s / truth));
                            if e.verdict == Verdict::Settled {
                                settled += 1;
                                wrong += i32::from((v - truth).abs() > 2.6 * s);
                            }
                        }
                        _ => none += 1,
                    }
                }
                if z.is_empty() && none == 0 {
                    continue;
                }
                let n = z.len() as f64;
                let inside = z.iter().filter(|z| z.1.abs() < 1.96).count() as f64;
                let rms = (z.iter().map(|z| z.1 * z.1).sum::<f64>() / n).sqrt();
                let mut rel: Vec<f64> = z.iter().map(|z| z.2).collect();
                rel.sort_by(f64::total_cmp);
                let median = rel.get(rel.len() / 2).copied().unwrap_or(f64::NAN);
                println!(
                    "  {key:22} n {n:4} none {none:4} settled {settled:4} (>2.6s: {wrong:3}) covered {:5.1} % rms z {rms:5.2} mean z {:5.2} med std {:.2e}",
                    100.0 * inside / n,
                    z.iter().map(|z| z.1).sum::<f64>() / n,
                    median
                );
                if std::env::var("SEEDZ").is_ok() {
                    let list: Vec<String> = z.iter().map(|z| format!("{:.1}", z.1)).collect();
                    println!("      {}", list.join(" "));
                }
                if verbose {
                    for t in 0..trajectories.len() {
                        let own: Vec<f64> = z.iter().filter(|z| z.0 == t).map(|z| z.1).collect();
                        let rms =
                            (own.iter().map(|z| z * z).sum::<f64>() / own.len() as f64).sqrt();
                        if rms > 1.8 {
                            let mean = own.iter().sum::<f64>() / own.len() as f64;
                            println!(
                                "      {t} {} rms {rms:.2} mean {mean:.2} std {:.1e}",
                                trajectories[t].describe(),
                                z.iter().find(|z| z.0 == t).unwrap().2
                            );
                        }
                    }
                }
            }
        }
    }
}

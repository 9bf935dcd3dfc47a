//! Scheme 1 as `identify` calls it.
#![cfg(test)]

use super::*;
use crate::plant::testing::record;
use crate::plant::{Motor, MotorKey};
use crate::sample::{Channel, Origin, Verdict};

fn levels() -> Vec<(f64, f64)> {
    let levels = [30.0, 60.0, 20.0, -30.0, -60.0, -20.0, 40.0, 10.0, 50.0];
    std::iter::once((0.0, 0.0))
        .chain((0..80).map(|k| {
            (
                0.5 + 0.07 * f64::from(k),
                levels[k as usize * 4 % levels.len()],
            )
        }))
        .collect()
}

fn run_of(scenario: &Scenario) -> Run {
    let mut run = Run::new(scenario.name.clone(), scenario.sample_time_s.clone()).unwrap();
    let held = scenario.sample_time_s.iter().map(|time_s| {
        let next = scenario
            .events
            .partition_point(|event| event.0 <= *time_s + 1e-9);
        scenario.events[next.max(1) - 1].1
    });
    run.set_column(Channel::Voltage, held.collect(), Origin::Unknown)
        .unwrap();
    run.set_column(
        Channel::Speed,
        scenario.speed_rad_s.clone(),
        Origin::Measured,
    )
    .unwrap();
    run
}

fn identify(id: &str, run: &Run, model: &Model) -> Result<Identified, IdentifyError> {
    let scenario = Scenario::from_run(run).unwrap();
    let data = Data {
        run,
        scenario: &scenario,
        model,
    };
    find(id).unwrap().identify(&data)
}

fn only_resistance() -> Model {
    Model::baseline(Motor::new("m").with(MotorKey::Resistance, 1.1))
}

#[test]
fn look() {
    for period_s in [0.002, 0.005, 0.01] {
        let scenario = record(
            &Model::baseline(Motor::zk_22fc()),
            levels(),
            period_s,
            6.2,
            3,
        );
        for id in ["1", "1-exact", "1-iv", "2-rectangle"] {
            println!("--- {period_s} {id}");
            match identify(id, &run_of(&scenario), &only_resistance()) {
                Ok(found) => {
                    for p in found.parameters {
                        println!(
                            "{} {:?} {:?} {:?} {:?}",
                            p.key, p.value, p.std, p.verdict, p.reason
                        )
                    }
                }
                Err(error) => println!("{error}"),
            }
        }
    }
}

//! Public records of real machines: what the diagnosis says of each that is at hand. The records are not part of the
//! program; where they come from stands beside each.

use std::path::Path;

use serde::Serialize;

use crate::diagnosis::{Diagnosis, Evidence, diagnose};
use crate::identification::speed_from_angle;
use crate::plant::{Model, Motor, MotorKey, Scenario};
use crate::recording::{ColumnMap, open_run};

/// A record: its file, which column is what, and the model that its publishers start from.
struct Record {
    machine: &'static str,
    source: &'static str,
    file: &'static str,
    map: &'static str,
    inertia: f64,
    friction: f64,
    effects: &'static [&'static str],
}

const RECORDS: [Record; 2] = [
    Record {
        machine: "linear axis: direct-current motor, ball screw and carriage of 95 kg (force and position; N, m and kg stand for N.m, rad and kg.m2)",
        source: "EMPS benchmark of Janot, Gautier and Brunot, 2019; its model: mass, Coulomb and viscous friction, offset",
        file: "emps/DATA_EMPS.csv",
        map: "time_s=t_s,torque_n_m=force_N,angle_rad=qm_m",
        inertia: 95.0,
        friction: 20.0,
        effects: &["viscous_friction", "constant_load"],
    },
    Record {
        machine: "propeller on a thrust stand (torque and optical speed)",
        source: "github.com/bhabas/sar_simulation, random throttle steps of 2023-12-16; a linear model to begin with",
        file: "sar_bldc/time_constant_2023-12-16.csv",
        map: "time_s=Time (s),torque_n_m=Torque (N·m),speed_rad_s=Motor Optical Speed (rad/s)",
        inertia: 1e-5,
        friction: 1e-3,
        effects: &["viscous_friction"],
    },
];

/// What the diagnosis says of one record.
#[derive(Clone, Debug, Serialize)]
pub struct RecordAnswer {
    pub machine: &'static str,
    pub source: &'static str,
    pub file: &'static str,
    /// The diagnosis' own sentence, or why there is none.
    pub sentence: String,
    pub effects: Vec<&'static str>,
    pub holdout_before: Option<f64>,
    pub holdout_after: Option<f64>,
}

/// Every record whose file is in `folder`.
pub fn records(folder: &Path) -> Vec<RecordAnswer> {
    let at_hand = |record: &&Record| folder.join(record.file).is_file();
    let records = RECORDS.iter().filter(at_hand);
    records.map(|record| answer(record, folder)).collect()
}

/// The files that are looked for.
pub fn files() -> impl Iterator<Item = &'static str> {
    RECORDS.iter().map(|record| record.file)
}

fn answer(record: &Record, folder: &Path) -> RecordAnswer {
    let empty = RecordAnswer {
        machine: record.machine,
        source: record.source,
        file: record.file,
        sentence: String::new(),
        effects: Vec::new(),
        holdout_before: None,
        holdout_after: None,
    };
    match diagnosis(record, folder) {
        Err(sentence) => RecordAnswer { sentence, ..empty },
        Ok(found) => RecordAnswer {
            sentence: found.sentence,
            effects: found.effects,
            holdout_before: Some(found.holdout_before),
            holdout_after: Some(found.holdout_after),
            ..empty
        },
    }
}

fn diagnosis(record: &Record, folder: &Path) -> Result<Diagnosis, String> {
    let map: ColumnMap = record.map.parse().map_err(|error| format!("{error}"))?;
    let loaded =
        open_run(&folder.join(record.file), Some(&map)).map_err(|error| error.to_string())?;
    let run = speed_from_angle::complete(&loaded.run).map_err(|error| error.to_string())?;
    let run = Scenario::from_run(&run).map_err(|error| error.to_string())?;
    let motor = Motor::new("machine")
        .with(MotorKey::Inertia, record.inertia)
        .with(MotorKey::LoadTorque, record.friction);
    let mut model = Model::baseline(motor);
    for id in record.effects {
        model = model.with_effect(id).map_err(|error| error.to_string())?;
    }
    diagnose(&model, Evidence::new(run, None, None)).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::effect;

    #[test]
    fn every_record_can_be_mapped_and_its_model_is_of_the_catalogue() {
        for record in &RECORDS {
            assert!(record.map.parse::<ColumnMap>().is_ok(), "{}", record.map);
            assert!(record.effects.iter().all(|id| effect::find(id).is_some()));
        }
    }

    #[test]
    fn a_record_that_is_broken_is_said_to_be_and_one_that_is_away_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        assert!(records(folder.path()).is_empty());
        let file = folder.path().join(RECORDS[0].file);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(&file, "t_s,qm_m\n0,0\n").unwrap();
        let [found] = &records(folder.path())[..] else {
            panic!("one record is at hand");
        };
        assert!(found.effects.is_empty() && found.holdout_after.is_none());
        assert!(found.sentence.contains("force_N"), "{}", found.sentence);
    }
}

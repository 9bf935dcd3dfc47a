//! On-line identification on exactly the rows that are recorded, so that a replay of the file is the live run again.

use super::runner::{Excitation, LiveEstimator};
use crate::identification::online::{Online, OnlineConfig};
use crate::plant::MotorKey;
use crate::recording::{CommandRow, Layout, Row, RowOrder};
use crate::sample::{Channel, ParameterEstimate, Run, Sample};

/// The on-line estimators behind the row order of the record.
pub struct LiveOnline {
    order: RowOrder,
    rows: Vec<Row>,
    online: Online,
}

impl LiveOnline {
    /// `layout` has to be the recorder's: what is not recorded cannot be replayed.
    pub fn new(layout: Layout, config: OnlineConfig) -> Self {
        Self {
            order: RowOrder::new(layout),
            rows: Vec::new(),
            online: Online::new(config),
        }
    }

    pub const fn online(&self) -> &Online {
        &self.online
    }
}

impl LiveEstimator for LiveOnline {
    fn command(&mut self, command: &CommandRow) {
        self.order.command(*command);
    }

    fn push(&mut self, sample: &Sample) {
        self.order.sample(sample, &mut self.rows);
        for row in self.rows.drain(..) {
            self.online
                .push(&as_sample(row.time_s, |channel| row.get(channel)));
        }
    }

    fn estimates(&self) -> Vec<ParameterEstimate> {
        self.online.estimates()
    }

    fn excitation(&self) -> Excitation {
        // The mechanical line is linear in Kt/J and Mc/J: what carries them carries J and Mc.
        const KEYS: [MotorKey; 5] = [
            MotorKey::Resistance,
            MotorKey::Inductance,
            MotorKey::BackEmf,
            MotorKey::Inertia,
            MotorKey::LoadTorque,
        ];
        let shares = self.online.excitation();
        KEYS.map(MotorKey::key).into_iter().zip(shares).collect()
    }
}

/// The on-line estimators over a recorded run: the same arithmetic in the same order as in the live run.
pub fn replay(run: &Run, config: OnlineConfig) -> Online {
    let mut online = Online::new(config);
    for (row, &time_s) in run.time_s().iter().enumerate() {
        let cell = |channel| run.column(channel).map(|cells: &[f64]| cells[row]);
        online.push(&as_sample(time_s, |channel| {
            cell(channel).filter(|value| value.is_finite())
        }));
    }
    online
}

fn as_sample(time_s: f64, cell: impl Fn(Channel) -> Option<f64>) -> Sample {
    let mut sample = Sample::at(time_s);
    for channel in Channel::ALL {
        if let Some(value) = cell(channel) {
            sample.set(channel, value);
        }
    }
    sample
}

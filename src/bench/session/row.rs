//! Rows of the record: the sample at its instant, and the command at the instant from which the drive applied it.

use std::collections::VecDeque;

use super::Action;
use crate::sample::{Channel, Command, Demand, Sample};

/// Commands that may be on their way at once; a drive that reports an older one has lost its place.
const REMEMBERED: usize = 64;

/// One row of the record. Times are drive times where the drive has a clock.
#[derive(Clone, Debug, PartialEq)]
pub enum Row {
    /// The drive applied command `seq` at `time_s`; it holds until the next row of this kind.
    Applied {
        time_s: f64,
        seq: u64,
        demand: Demand,
    },
    /// A sample, with the command from this instant on where the drive does not say when it applied it.
    Sample {
        sample: Box<Sample>,
        demand: Option<Demand>,
    },
}

/// Pairs what was sent with what the drive says it applied, and keeps time strictly increasing.
#[derive(Clone, Debug, Default)]
pub(super) struct Stamper {
    sent: VecDeque<Command>,
    applied_seq: Option<u64>,
    last_time_s: Option<f64>,
}

impl Stamper {
    pub(super) fn sent(&mut self, command: Command) {
        if self.sent.len() == REMEMBERED {
            self.sent.pop_front();
        }
        self.sent.push_back(command);
    }

    /// Appends the rows of one sample. A sample whose time does not advance is not a row: it is an old one.
    pub(super) fn rows(&mut self, sample: &Sample, actions: &mut Vec<Action>) {
        let mut demand = None;
        match sample.applied {
            Some(applied) if self.applied_seq != Some(applied.seq) => {
                self.applied_seq = Some(applied.seq);
                let known = self.sent.iter().find(|command| command.seq == applied.seq);
                if let Some(command) = known {
                    if self.advances(applied.time_s) && applied.time_s < sample.time_s {
                        self.last_time_s = Some(applied.time_s);
                        actions.push(Action::Record(Row::Applied {
                            time_s: applied.time_s,
                            seq: applied.seq,
                            demand: command.demand,
                        }));
                    } else {
                        demand = Some(command.demand);
                    }
                }
            }
            Some(_) => {}
            // The write goes before the read in every exchange, so the command holds at the sample's instant.
            None => demand = self.sent.back().map(|command| command.demand),
        }
        if self.advances(sample.time_s) {
            self.last_time_s = Some(sample.time_s);
            let mut sample = Box::new(sample.clone());
            if let Some(volts) = demand.and_then(Demand::voltage_v) {
                sample.set(Channel::VoltageCmd, volts);
            }
            actions.push(Action::Record(Row::Sample { sample, demand }));
        }
    }

    fn advances(&self, time_s: f64) -> bool {
        time_s.is_finite() && self.last_time_s.is_none_or(|last_s| time_s > last_s)
    }
}

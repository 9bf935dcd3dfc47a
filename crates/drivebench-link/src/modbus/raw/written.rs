//! What a write of registers has done: its acknowledgement, and what the registers read back.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use serde::Serialize;

use super::{RawClient, WriteFunction, read_batch};
use crate::cell_bus::ReadRequest;
use crate::link::{LinkError, Result};
use crate::timing::wait_until;
use crate::waiting::now;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum WriteOutcome {
    /// The registers read back what was written.
    Confirmed,
    /// Acknowledged, and the registers hold something else.
    Differs,
    /// Acknowledged or accepted, and the unit does not give these registers.
    Unreadable,
    /// Accepted (exception 05), and not carried out within the time that was allowed: it may still act.
    Pending,
    /// Refused, or nothing is known.
    Unconfirmed,
}

/// A write and what followed it.
#[derive(Debug)]
pub struct Written {
    pub acknowledged: Result<()>,
    pub after: Result<Vec<u16>>,
    pub outcome: WriteOutcome,
    /// How long the registers were read again after the unit had accepted the write, s; `None`: it did not only accept it.
    pub accepted_s: Option<f64>,
}

impl RawClient {
    /// The registers now, proven to be current.
    pub fn read_back(&mut self, address: u16, count: u16) -> Result<Vec<u16>> {
        let request = ReadRequest::holding(address, count);
        let batch = read_batch(self, &[request], 1, &AtomicBool::new(false));
        batch.reads.into_iter().next().map_or(Ok(Vec::new()), |read| read.values)
    }

    /// Writes once and reads back. A write that the unit has accepted and not finished is waited for: five times the time of a
    /// reply, from 2 to 30 s.
    pub fn write_and_read_back(
        &mut self,
        function: WriteFunction,
        address: u16,
        values: &[u16],
    ) -> Written {
        let count = u16::try_from(values.len()).unwrap_or(u16::MAX);
        let acknowledged = self.write(function, address, values);
        let is_accepted = matches!(acknowledged, Err(LinkError::Exception { code: 5, .. }));
        let mut after = self.read_back(address, count);
        let began = now();
        let longest = 5 * self.allowed();
        let limit = began + longest.clamp(Duration::from_secs(2), Duration::from_secs(30));
        // A unit that still acts may give the value before, or be busy.
        let still_acts = |after: &Result<Vec<u16>>| match after {
            Ok(after) => after != values,
            Err(error) => matches!(error, LinkError::Exception { code: 5 | 6, .. }),
        };
        while is_accepted && still_acts(&after) && now() < limit {
            wait_until(now() + Duration::from_millis(50));
            after = self.read_back(address, count);
        }
        let accepted_s = is_accepted.then(|| now().saturating_duration_since(began).as_secs_f64());
        let outcome = outcome(&acknowledged, &after, values);
        Written { acknowledged, after, outcome, accepted_s }
    }
}

fn outcome(acknowledged: &Result<()>, after: &Result<Vec<u16>>, values: &[u16]) -> WriteOutcome {
    let is_accepted = matches!(acknowledged, Err(LinkError::Exception { code: 5, .. }));
    let is_refused = matches!(acknowledged, Err(LinkError::Exception { .. })) && !is_accepted;
    match after {
        Ok(after) if after == values && !is_refused => WriteOutcome::Confirmed,
        Ok(_) if acknowledged.is_ok() => WriteOutcome::Differs,
        Ok(_) if is_accepted => WriteOutcome::Pending,
        // A gateway that does not reach the unit states nothing of its registers.
        Err(LinkError::Exception { code, .. })
            if (acknowledged.is_ok() || is_accepted) && !matches!(code, 10 | 11) =>
        {
            WriteOutcome::Unreadable
        }
        _ => WriteOutcome::Unconfirmed,
    }
}

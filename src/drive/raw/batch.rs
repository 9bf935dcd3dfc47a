//! Several reads, perhaps again and again, whose last values are handed out only when they are vouched for.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::super::guard::now;
use super::super::link::LinkError;
use super::super::register_bus::ReadRequest;
use super::RawClient;

/// Times that doubtful values are asked for again, each between two proofs.
const CAREFUL_ATTEMPTS: usize = 3;

/// One read of the last round.
#[derive(Debug)]
pub struct Read {
    pub request: ReadRequest,
    pub values: Result<Vec<u16>, LinkError>,
}

/// What a batch gave.
#[derive(Debug, Default)]
pub struct Batch {
    /// The last round, in the order asked.
    pub reads: Vec<Read>,
    /// Reads that were answered, of all rounds; those that were repeated for safety are not among them.
    pub answered: u64,
    pub asked: u64,
    /// Time of all rounds without the proofs, s.
    pub elapsed_s: f64,
    /// Round trips of the answered reads, ascending.
    pub round_trips: Vec<Duration>,
    /// Raised flag: not all rounds were done.
    pub is_interrupted: bool,
}

impl Batch {
    /// Answered reads per second.
    pub fn rate_hz(&self) -> Option<f64> {
        (self.answered > 0 && self.elapsed_s > 0.0).then(|| self.answered as f64 / self.elapsed_s)
    }

    /// The round trip that this share did not exceed, s.
    pub fn quantile_s(&self, share: f64) -> Option<f64> {
        let last = self.round_trips.len().checked_sub(1)?;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a share of a length is an index"
        )]
        let index = (share.clamp(0.0, 1.0) * last as f64).round() as usize;
        self.round_trips.get(index).map(Duration::as_secs_f64)
    }

    pub fn is_all_answered(&self) -> bool {
        self.answered == self.asked && self.reads.iter().all(|read| read.values.is_ok())
    }
}

/// Reads each request once a round. A round ends early when `stop` is raised or the port is gone.
///
/// RTU cannot tell a late or second reply to an equal request from the right one. So the last round has a proof between
/// reads that could be confused and one at its end. What is not vouched for is asked for again, read by read, each behind
/// a proof of its own that makes its reply unmistakable, whatever lies around it; or it ends as an error.
pub fn read_batch(
    client: &mut RawClient,
    requests: &[ReadRequest],
    rounds: u64,
    stop: &AtomicBool,
) -> Batch {
    let mut batch = Batch::default();
    let mut round_trips = Vec::new();
    let begun = now();
    let mut proving = Duration::ZERO;
    let mut vouched = vec![false; requests.len()];
    for round in 0..rounds {
        let anomalies = client.proof.anomalies;
        let is_last = round + 1 == rounds;
        for (index, request) in requests.iter().enumerate() {
            if is_last && client.could_confuse(*request) {
                let before = now();
                // A line that cannot be proven shows in the read itself and in the proof at the end.
                let _ = client.vouch();
                proving += now().duration_since(before);
            }
            let values = client.read(*request);
            vouched[index] = client.proof.vouched;
            batch.asked += 1;
            if let Err(gone @ LinkError::Gone { .. }) = &values {
                // Nothing of this round can be vouched for, and what was not asked any more is missing as well.
                let none = |request: &ReadRequest| Read {
                    request: *request,
                    values: Err(gone.clone()),
                };
                batch.reads = requests.iter().map(none).collect();
                batch.asked = rounds * requests.len() as u64;
                batch.elapsed_s = elapsed_s(begun + proving);
                batch.round_trips = sorted(round_trips);
                return batch;
            }
            if values.is_ok() {
                batch.answered += 1;
                round_trips.push(client.last_round_trip());
            }
            let read = Read {
                request: *request,
                values,
            };
            match batch.reads.get_mut(index) {
                Some(old) => *old = read,
                None => batch.reads.push(read),
            }
        }
        batch.is_interrupted = !is_last && stop.load(Ordering::Acquire);
        if is_last || batch.is_interrupted {
            batch.elapsed_s = elapsed_s(begun + proving);
            vouch_for(client, &mut batch, &vouched, anomalies);
            break;
        }
    }
    batch.round_trips = sorted(round_trips);
    batch
}

fn elapsed_s(since: Instant) -> f64 {
    let elapsed = now().saturating_duration_since(since);
    elapsed.as_secs_f64()
}

fn sorted(mut round_trips: Vec<Duration>) -> Vec<Duration> {
    round_trips.sort_unstable();
    round_trips
}

/// Proves that the round was in step, or asks again for what it gave and for what only old replies came.
fn vouch_for(client: &mut RawClient, batch: &mut Batch, vouched: &[bool], anomalies: u64) {
    let is_answer = |read: &Read| matches!(read.values, Ok(_) | Err(LinkError::Exception { .. }));
    let is_late = |read: &Read| matches!(read.values, Err(LinkError::Stale { .. }));
    let reads = || batch.reads.iter().zip(vouched);
    let has_late = reads().any(|(read, _)| is_late(read));
    let doubtful = reads().any(|(read, vouched)| is_answer(read) && !vouched);
    if doubtful && !has_late {
        let proof = client.vouch();
        if matches!(proof, Ok(true)) && client.proof.anomalies == anomalies {
            return;
        }
    }
    for (read, vouched) in batch.reads.iter_mut().zip(vouched) {
        let asks = if is_answer(read) {
            !vouched
        } else {
            // A unit that answers one request late has answered this one as well.
            has_late && matches!(&read.values, Err(error) if error.is_transient())
        };
        if !asks {
            continue;
        }
        let was_answered = read.values.is_ok();
        if was_answered {
            client.withdraw();
        }
        read.values = careful(client, read.request);
        batch.answered += u64::from(!was_answered && read.values.is_ok());
    }
}

fn careful(client: &mut RawClient, request: ReadRequest) -> Result<Vec<u16>, LinkError> {
    let mut last = None;
    for _ in 0..CAREFUL_ATTEMPTS {
        let values = client
            .prove_for(request)
            .and_then(|()| client.read(request));
        match &values {
            Ok(_) | Err(LinkError::Exception { .. }) if client.proof.vouched => return values,
            Ok(_) => client.withdraw(),
            Err(LinkError::Exception { .. }) => {}
            Err(error) if error.is_transient() => last = values.err(),
            Err(_) => return values,
        }
    }
    Err(last.unwrap_or_else(|| {
        LinkError::Corrupt(
            client.name.clone(),
            format!(
                "the reply for {} registers at {} cannot be vouched for: replies come out of step",
                request.count, request.address
            ),
        )
    }))
}

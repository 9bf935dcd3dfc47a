//! How it is proven that the line is in step: RTU has no transaction number, so a reply that fits may be that to an
//! equal request before it. A probe whose reply fits nothing else shows that a unit which answers in order has
//! answered everything older.
//!
//! ```text
//! anomaly -> suspect -> [silence, probe] up to 6 times -> in step | refused
//! end of a batch -> probe: nothing else on the line? -> its values stand, else they are asked for again
//! ```

use std::time::Duration;

use super::super::link::LinkError;
use super::super::modbus::RegisterTable;
use super::super::reply::FrameKind;
use super::client::RawClient;
use super::request::{MOST_READ, ReadRequest};

/// Probes of one resynchronisation.
const PROBES: usize = 6;
/// Silence after which an adapter has handed over all it had (the latency timer of FTDI is 16 ms).
const QUIET: Duration = Duration::from_millis(20);

/// What makes a probe unmistakable. The order is that of trial: a read can harm nobody, but function code 08 makes some
/// servers deaf (libmodbus 3.1 takes its data for the next request), so it comes last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Method {
    /// A read of so many registers as no request since the last proof has asked for.
    Length,
    /// A read of the other table: whatever is answered carries the other function code.
    OtherTable,
    /// Function code 08 with a number that comes back.
    Nonce,
    /// Nothing came for a whole timeout: weaker, for units that answer no probe.
    Silence,
}

/// What a probe has shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Shown {
    /// It was answered: nothing older can come.
    InStep,
    /// Nothing at all came.
    Nothing,
    /// Something came that proves nothing.
    Unclear,
    /// There is no probe of this kind here.
    Unusable,
}

impl RawClient {
    /// Whether everything since the last proof was answered in step: true when a probe came back and nothing beside it.
    /// After false the line is in step again.
    pub fn vouch(&mut self) -> Result<bool, LinkError> {
        if self.kind == FrameKind::Tcp || !self.heard {
            return Ok(true);
        }
        let before = self.anomalies;
        self.drain()?;
        if !self.suspect {
            let method = self.method.unwrap_or(Method::Length);
            if self.probe(method)? == Shown::InStep {
                self.method = Some(method);
            } else {
                self.suspect = true;
            }
        }
        if self.suspect {
            self.resynchronise()?;
            return Ok(false);
        }
        self.proven();
        Ok(self.anomalies == before)
    }

    /// Whether a late or second reply to a request since the last proof could be taken for the reply to this one.
    pub fn could_confuse(&self, request: ReadRequest) -> bool {
        self.since_proof
            .iter()
            .any(|sent| sent.function == request.function() && sent.count == request.count)
    }

    /// Answers that were taken turn out to be doubtful: they are counted as stale.
    pub fn withdraw(&mut self, answers: u64) {
        self.counters.withdraw(answers);
    }

    /// Silence and probes until the line is in step.
    pub(super) fn resynchronise(&mut self) -> Result<(), LinkError> {
        self.counters.resynchronisations += 1;
        let quiet = QUIET.max(self.gap);
        if !self.heard {
            // Nobody is known to be there; what may still come is found by the proof after the first answer.
            self.calm(quiet)?;
            self.suspect = false;
            return Ok(());
        }
        let mut method = self.method.unwrap_or(Method::Length);
        let mut silent = 0;
        for _ in 0..PROBES {
            self.calm(quiet)?;
            self.suspect = false;
            let shown = self.probe(method)?;
            match shown {
                Shown::InStep if !self.suspect => {
                    self.method = Some(method);
                    self.proven();
                    return Ok(());
                }
                // In step, but something older came with it: once more, now that it is gone.
                Shown::InStep => self.method = Some(method),
                Shown::Nothing | Shown::Unclear | Shown::Unusable => {
                    silent = if shown == Shown::Unclear {
                        0
                    } else {
                        silent + 1
                    };
                    method = match method {
                        Method::Length => Method::OtherTable,
                        Method::OtherTable => Method::Nonce,
                        Method::Nonce | Method::Silence if silent >= 3 => Method::Silence,
                        Method::Nonce | Method::Silence => Method::Length,
                    };
                }
            }
        }
        self.suspect = true;
        Err(LinkError::Corrupt {
            link: self.name.clone(),
            reason: format!(
                "the line is out of step: none of {PROBES} probes came back without older replies"
            ),
        })
    }

    fn proven(&mut self) {
        self.suspect = false;
        // The probe stays remembered: the next one must differ from it.
        let last = self.since_proof.pop_back();
        self.since_proof.clear();
        if let Some(mut probe) = last {
            probe.is_answered = true;
            self.since_proof.push_back(probe);
        }
    }

    fn calm(&mut self, quiet: Duration) -> Result<(), LinkError> {
        if self.silence(quiet)? {
            return Ok(());
        }
        Err(LinkError::Corrupt {
            link: self.name.clone(),
            reason: "the line is never silent: something talks all the time".to_owned(),
        })
    }

    fn probe(&mut self, method: Method) -> Result<Shown, LinkError> {
        let (pdu, count) = match method {
            Method::Length => match self.length_code() {
                Some(read) => (read.pdu(), read.count),
                None => return Ok(Shown::Unusable),
            },
            Method::OtherTable => {
                let read = self.other_table();
                (read.pdu(), read.count)
            }
            Method::Nonce => {
                self.nonce = self.nonce.wrapping_mul(25_173).wrapping_add(13_849);
                let [high, low] = self.nonce.to_be_bytes();
                ([8, 0, 0, high, low], 0)
            }
            Method::Silence => {
                let anomalies = self.anomalies;
                let silent = self.silence(self.timeout)?;
                return Ok(if silent && self.anomalies == anomalies {
                    Shown::InStep
                } else {
                    Shown::Unclear
                });
            }
        };
        // An exception carries no length, so it is only clear where no older request may still be refused.
        let all_answered = self.since_proof.iter().all(|sent| sent.is_answered);
        self.counters.probes += 1;
        match self.transact(&pdu, count, self.timeout, || "the probe".to_owned()) {
            Ok(()) => Ok(Shown::InStep),
            Err(LinkError::Exception { .. }) => Ok(match method {
                Method::Length if all_answered => Shown::InStep,
                Method::OtherTable => Shown::InStep,
                _ => Shown::Unclear,
            }),
            Err(LinkError::Timeout { .. }) => Ok(Shown::Nothing),
            Err(error) if error.is_transient() => Ok(Shown::Unclear),
            Err(error) => Err(error),
        }
    }

    /// A read at a place that has been read, with a length of its own: shorter if possible, for every unit has those
    /// registers.
    fn length_code(&self) -> Option<ReadRequest> {
        let known = self.known?;
        let function = known.function();
        let is_free = |count: &u16| {
            !self
                .since_proof
                .iter()
                .any(|sent| sent.function == function && sent.count == *count)
        };
        let most = MOST_READ.min(u16::MAX - known.address);
        let shorter = (1..known.count).rev();
        let count = shorter.chain(known.count + 1..=most).find(is_free)?;
        Some(ReadRequest { count, ..known })
    }

    fn other_table(&self) -> ReadRequest {
        let (table, address) = match self.known {
            Some(known) if known.table == RegisterTable::Input => {
                (RegisterTable::Holding, known.address)
            }
            Some(known) => (RegisterTable::Input, known.address),
            None => (RegisterTable::Input, 0),
        };
        // The next probe gets another length, so that a late reply to this one is not taken for its own.
        let count = 1 + u16::try_from(self.counters.probes % 2).unwrap_or(0);
        ReadRequest {
            table,
            address,
            count,
        }
    }
}

//! The trait of every link to a drive, and its statistics: the outcome of every request, and round-trip times.

use std::fmt;

use serde::Serialize;

use super::burst::Burst;
use super::command_times::CommandTimes;
pub use super::link_error::LinkError;
pub(crate) use super::link_error::Result;
use super::register_map::Quantity;
use super::transaction::{LineCounts, StopRequest};
use super::unexpected::Unexpected;
use drivebench_model::numerics::count::whole;
use drivebench_model::sample::{Command, Demand, Sample};
use drivebench_model::text::number;

/// Identity of a drive, as it reports it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Identity {
    pub vendor: String,
    pub product: String,
    pub serial_number: String,
    pub firmware: String,
    pub protocol_version: u16,
    /// Whether the drive reports that it is software; everything else counts as hardware.
    pub is_emulator: bool,
    /// Command silence after which the drive itself stops the motor, s; `None`: no watchdog that we can read.
    pub watchdog_s: Option<f64>,
    /// The drive's own limits as read back; they bound the commands.
    pub current_limit_a: Option<f64>,
    pub voltage_limit_v: Option<f64>,
    /// Where the drive states none it is left out, as in the runs before it could.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub motor: Option<StatedMotor>,
}

/// The motor as the drive states it, between two lines; `None`: not stated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct StatedMotor {
    pub resistance_ohm: Option<f64>,
    pub inductance_h: Option<f64>,
    pub back_emf_v_s_per_rad: Option<f64>,
    /// The same in the drive's own memory, as of a phase.
    #[serde(skip)]
    pub stored: [Option<f64>; 3],
}

impl StatedMotor {
    /// From the values of a profile; `None` where there is none. A value of zero is none.
    pub fn of(
        value: impl Fn(Quantity) -> Option<f64>,
        stored: impl Fn(Quantity) -> Option<f64>,
    ) -> Option<Self> {
        let of = [Quantity::MotorResistance, Quantity::MotorInductance, Quantity::MotorBackEmf];
        // Of a float with 24 bits, six digits are its own.
        let all = of.map(|quantity| value(quantity).filter(|value| *value > 0.0));
        let [resistance_ohm, inductance_h, back_emf_v_s_per_rad] =
            all.map(|value| value.map(|value| number::with_digits(value, 6)));
        all.iter().any(Option::is_some).then(|| Self {
            resistance_ohm,
            inductance_h,
            back_emf_v_s_per_rad,
            stored: of.map(stored),
        })
    }
}

impl Identity {
    /// Serial number, firmware, protocol and kind; what is missing is named.
    pub fn plate(&self) -> String {
        let told = |text: &str| {
            let text = text.trim();
            if text.is_empty() { "not reported" } else { text }.to_owned()
        };
        // Only our own drive has a protocol with a number.
        let protocol = match self.protocol_version {
            0 => String::new(),
            version => format!(", protocol {version}"),
        };
        format!(
            "serial {}, firmware {}{protocol}, {}",
            told(&self.serial_number),
            told(&self.firmware),
            if self.is_emulator { "emulator" } else { "hardware" }
        )
    }

    pub fn name(&self) -> String {
        drive_name(&self.vendor, &self.product)
    }

    pub fn sentence(&self) -> String {
        format!("{}, {}", self.name(), self.plate())
    }
}

/// Vendor and product; where the product begins with its vendor, that once.
pub fn drive_name(vendor: &str, product: &str) -> String {
    let name = if product.starts_with(vendor) {
        product.to_owned()
    } else {
        format!("{vendor} {product}")
    };
    name.trim().to_owned()
}

/// Every exchange ends in exactly one of these classes; the sum is `sent`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LinkStatistics {
    pub sent: u64,
    pub ok: u64,
    pub timeout: u64,
    /// Bytes without a valid frame came.
    pub crc: u64,
    /// Only replies to earlier requests came, late or repeated; or the reply could not be attributed afterwards.
    pub stale: u64,
    /// A reply to no request of ours: wrong unit, function or length.
    pub mismatch: u64,
    pub exception: u64,
    /// The transport failed (unplugged, peer gone).
    pub aborted: u64,
}

impl LinkStatistics {
    /// The accounting invariant: nothing that was sent is unaccounted for.
    pub const fn balances(&self) -> bool {
        let failed = self.timeout + self.crc + self.stale + self.mismatch + self.exception;
        self.sent == self.ok + failed + self.aborted
    }

    pub const fn lost(&self) -> u64 {
        self.sent - self.ok
    }

    /// Counts one request that was sent.
    pub(super) const fn settle<T>(&mut self, result: &Result<T>) {
        self.sent += 1;
        *match result {
            Ok(_) => &mut self.ok,
            Err(
                LinkError::Timeout { .. } | LinkError::Unexpected { what: Unexpected::Echo, .. },
            ) => &mut self.timeout,
            Err(
                LinkError::Corrupt { .. }
                | LinkError::Unexpected {
                    what: Unexpected::Ascii | Unexpected::Incomplete { .. },
                    ..
                },
            ) => &mut self.crc,
            Err(LinkError::Stale { .. } | LinkError::Unproven { .. }) => &mut self.stale,
            Err(
                LinkError::Mismatch { .. }
                | LinkError::Unexpected { .. }
                | LinkError::Version { .. }
                | LinkError::Identity { .. }
                | LinkError::Refused { .. }
                | LinkError::Unstopped { .. }
                | LinkError::Sequence { .. },
            ) => &mut self.mismatch,
            Err(LinkError::Exception { .. }) => &mut self.exception,
            Err(LinkError::Gone { .. } | LinkError::Open { .. }) => &mut self.aborted,
        } += 1;
    }

    /// An accepted reply has become doubtful.
    pub(super) const fn withdraw(&mut self) {
        self.ok -= 1;
        self.stale += 1;
    }
}

/// Buckets per doubling of the round-trip time: 9 % wide.
const PER_DOUBLING: f64 = 8.0;
/// From 1 us to 16 s.
const BUCKETS: usize = 8 * 24;

/// Histogram of round-trip times with logarithmic buckets; bounded memory however long the run.
#[derive(Clone, Debug)]
pub struct RoundTrips {
    counts: [u64; BUCKETS],
    total: u64,
    longest_s: f64,
}

impl Default for RoundTrips {
    fn default() -> Self {
        Self { counts: [0; BUCKETS], total: 0, longest_s: 0.0 }
    }
}

impl RoundTrips {
    pub fn add(&mut self, round_trip_s: f64) {
        let bucket = whole((round_trip_s * 1e6).log2() * PER_DOUBLING);
        self.counts[bucket.min(BUCKETS - 1)] += 1;
        self.total += 1;
        self.longest_s = self.longest_s.max(round_trip_s);
    }

    pub const fn count(&self) -> u64 {
        self.total
    }

    pub const fn longest_s(&self) -> f64 {
        self.longest_s
    }

    /// Quantile of the round-trip times, s, within 5 %; `None` without any.
    pub fn quantile_s(&self, share: f64) -> Option<f64> {
        let rank = share.clamp(0.0, 1.0) * self.total as f64;
        let mut below = 0;
        let bucket = self.counts.iter().position(|count| {
            below += count;
            below > 0 && below as f64 >= rank
        })?;
        let centre_us = ((bucket as f64 + 0.5) / PER_DOUBLING).exp2();
        Some((centre_us * 1e-6).min(self.longest_s))
    }

    /// The buckets that are not empty: upper bound in us, and how many round trips fell into each.
    pub fn histogram_us(&self) -> Vec<(f64, u64)> {
        self.counts
            .iter()
            .enumerate()
            .filter(|(_, count)| **count > 0)
            .map(|(bucket, count)| {
                let bound_us = ((bucket as f64 + 1.0) / PER_DOUBLING).exp2();
                ((10.0 * bound_us).round() / 10.0, *count)
            })
            .collect()
    }

    pub fn p50_s(&self) -> Option<f64> {
        self.quantile_s(0.5)
    }

    pub fn p99_s(&self) -> Option<f64> {
        self.quantile_s(0.99)
    }
}

#[derive(Clone, Debug, Default)]
pub(super) struct Tally {
    pub(super) statistics: LinkStatistics,
    pub(super) round_trips: RoundTrips,
}

impl Tally {
    /// Counts one request that was sent, in the class of its outcome.
    pub(super) fn settle<T>(&mut self, result: &Result<T>, round_trip_s: f64) {
        self.statistics.settle(result);
        if result.is_ok() {
            self.round_trips.add(round_trip_s);
        }
    }
}

/// What a link is called in messages and manifests: `/dev/ttyUSB0`, `tcp:host:502`, `sim:`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LinkName(pub String);

impl fmt::Display for LinkName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Link to a drive: blocking, owned by one thread, every call bounded by an absolute deadline.
pub trait DriveLink: Send {
    fn name(&self) -> LinkName;

    /// Reads identity and limits of the drive; checks the protocol version.
    fn identify(&mut self) -> Result<Identity>;

    /// Sends one command and returns the sample that the drive took after applying it.
    fn exchange(&mut self, command: Command) -> Result<Sample>;

    /// Bounds every further exchange, resynchronisation included, by this time, s; infinite: unbounded. A stop outside an exchange is
    /// not bounded.
    fn bound(&mut self, _left_s: f64) {}

    /// Flags that announce a stop, on which silences, probes and retries of a bounded exchange are given up at once.
    fn stop_request(&mut self) -> Option<&mut StopRequest> {
        None
    }

    /// Commands zero output, repeated until confirmed or until the attempts are used up.
    fn stop(&mut self) -> Result<()>;

    /// Identity by reads only: settings that `identify` writes to the drive are not written.
    fn recognise(&mut self) -> Result<Identity> {
        self.identify()
    }

    /// The state when it was identified, before any command; `None` where the drive reports its state only in
    /// reply to a command.
    fn found(&self) -> Option<Sample> {
        None
    }

    /// With the output off: writes zero to the set-points that can be read back and compares. Sentence on the result; `None`: there are
    /// none.
    fn compare_set_points(&mut self) -> Result<Option<Result<String, String>>> {
        Ok(None)
    }

    /// As `stop`, but first sets to zero a reference that another master may have left.
    fn bring_to_rest(&mut self) -> Result<()> {
        self.stop()
    }

    /// Whether the set-point of the last exchange was sent; on a line in doubt an exchange may end before.
    fn has_sent_command(&self) -> bool {
        true
    }

    /// Whether the drive reports that its output is off. Where it does not, an acknowledged stop is not a confirmed one.
    fn confirms_stop(&self) -> bool {
        true
    }

    /// Longest time to follow a command.
    fn command_times(&self) -> CommandTimes {
        CommandTimes::default()
    }

    /// Closes the port so that it can be opened again; every later call fails with `Gone`.
    fn close(&mut self) {}

    fn statistics(&self) -> LinkStatistics;

    /// Shortest cycle that this link carries at its baud rate, s; `None` when not limited by a line.
    fn shortest_cycle_s(&self) -> Option<f64>;

    /// Times from request to reply; `None` where no wire is involved.
    fn round_trips(&self) -> Option<&RoundTrips> {
        None
    }

    /// Counts of bytes and frames on the line; `None` without a line.
    fn line(&self) -> Option<LineCounts> {
        None
    }

    /// The drive's burst capture, if it has one; known after `identify`.
    fn burst(&mut self) -> Option<&mut dyn Burst> {
        None
    }

    /// The demand with which this drive runs at zero: the quantity that it can be commanded in.
    fn zero(&self) -> Demand {
        Demand::Voltage(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_facts_of_a_drive_are_named() {
        let mut identity =
            Identity { product: "Acme 40".to_owned(), is_emulator: true, ..Identity::default() };
        let sentence = "Acme 40, serial not reported, firmware not reported, emulator";
        assert_eq!(identity.sentence(), sentence);
        identity.serial_number = "17".to_owned();
        identity.protocol_version = 3;
        let plate = "serial 17, firmware not reported, protocol 3, emulator";
        assert_eq!(identity.plate(), plate);
        // The drive in memory is named with one colon.
        let error = LinkError::Refused("sim:".to_owned(), "no".to_owned());
        assert_eq!(error.to_string(), "sim: not sent: no");
    }

    #[test]
    fn quantiles_are_right_within_a_bucket() {
        let mut trips = RoundTrips::default();
        assert_eq!(trips.p50_s(), None);
        for k in 1..=1000 {
            trips.add(f64::from(k) * 1e-5);
        }
        for (found_s, expected_s) in
            [(trips.p50_s(), 5e-3), (trips.p99_s(), 9.9e-3), (trips.quantile_s(0.0), 1e-5)]
        {
            assert!((found_s.unwrap() / expected_s - 1.0).abs() < 0.06);
        }
        assert!((trips.longest_s() - 0.01).abs() < 1e-12);
        let histogram = trips.histogram_us();
        assert_eq!(histogram.iter().map(|(_, count)| count).sum::<u64>(), 1000);
        assert!(histogram.is_sorted_by(|a, b| a.0 < b.0) && histogram[0].0 > 10.0);
        // Times outside of the range are counted at its ends.
        trips.add(0.0);
        trips.add(1e9);
        assert_eq!(trips.count(), 1002);
        assert!(trips.quantile_s(1.0).unwrap() > 1.0);
    }
}

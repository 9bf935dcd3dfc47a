//! Readings of a drive: schedule of the reads, and values in units; an impossible value is `None`.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::budget::joint_block;
use crate::cell_bus::{CellBus, Span};
use crate::exceptions::Requested;
use crate::link::{LinkError, Result};
use crate::register_map::{
    PollRate, Quantity, ReadBlock, RegisterMap, SetPoint, plan_reads, product_of,
};
use crate::timeline::{ClockMap, DriveClock};
use drivebench_model::sample::Channel;

/// The bus of the drive, for one call.
pub(super) type Bus<'a> = &'a mut dyn CellBus;

/// One signal as it was last read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Reading {
    /// In the profile's unit; `None` for the code "not available" or an impossible value.
    pub(super) value: Option<f64>,
    pub(super) pattern: Option<u32>,
    pub(super) span: Span,
}

/// Last reading of a position counter.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Position {
    raw: f64,
    counts: f64,
    at_s: f64,
}

/// A write that goes out together with a read.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Joined {
    pub(super) at: usize,
    pub(super) cells: Vec<u16>,
}

/// All signals, by position in the map.
pub(super) struct Readings {
    map: Arc<RegisterMap>,
    fast: Vec<ReadBlock>,
    slow: Vec<ReadBlock>,
    /// The slow block whose turn it is, and when.
    next_slow: usize,
    slow_due_s: f64,
    last: Vec<Reading>,
    /// Positions that begin again somewhere, followed over that: by position in the map, the last raw number and how far it
    /// was when it was read, counts.
    positions: BTreeMap<usize, Position>,
    /// Signs of the values that are counted in the direction of another signal.
    directions: BTreeMap<usize, f64>,
    /// The latest voltages of the supply, in the unit of their signal; NaN before.
    supply: [f64; 3],
    /// Values that were no value: an invalid code, out of the valid range, not finite.
    pub(super) rejected: u64,
}

impl Readings {
    pub(super) fn new(map: Arc<RegisterMap>) -> Self {
        Self {
            fast: plan_reads(&map, PollRate::Fast),
            slow: plan_reads(&map, PollRate::Slow),
            next_slow: 0,
            slow_due_s: f64::NEG_INFINITY,
            last: vec![Reading::default(); map.signals.len()],
            positions: BTreeMap::new(),
            directions: BTreeMap::new(),
            supply: [f64::NAN; 3],
            rejected: 0,
            map,
        }
    }

    pub(super) fn fast(&self) -> &[ReadBlock] {
        &self.fast
    }

    pub(super) fn get(&self, name: &str) -> Option<Reading> {
        self.last.get(self.map.index(name)?).copied()
    }

    /// The bits of a signal and the time of their request, s.
    pub(super) fn status(&self, name: &str) -> Option<(u32, f64)> {
        let reading = self.get(name)?;
        Some((reading.pattern?, reading.span.asked_s))
    }

    pub(super) fn at(&self, index: usize) -> Reading {
        self.last.get(index).copied().unwrap_or_default()
    }

    /// Everything, as at connect.
    pub(super) fn read_all(&mut self, bus: Bus<'_>) -> Result<()> {
        // Factors first: the others are scaled with them.
        for block in plan_reads(&self.map, PollRate::Once) {
            self.read(bus, &block)?;
        }
        for block in self.slow.clone() {
            self.read(bus, &block)?;
        }
        self.read_fast(bus, None).map(drop)
    }

    /// Every fast block, the joinable one in one transaction with the write that is given; from the first request to the
    /// last reply, and when the write was carried out.
    pub(super) fn read_fast(
        &mut self,
        bus: Bus<'_>,
        mut joined: Option<&Joined>,
    ) -> Result<(Option<Span>, Option<Span>)> {
        let (mut whole, mut both) = (None, None);
        for at in self.in_order(joined.is_some()) {
            let block = self.fast[at].clone();
            let write = joined.take();
            let (span, written) = self.read_with(bus, &block, write)?;
            if write.is_some() {
                both = Some(written);
            }
            // From the first request out to the last reply in.
            whole = Some(Span {
                asked_s: whole.map_or(span.asked_s, |first: Span| first.asked_s),
                ..span
            });
        }
        Ok((whole, both))
    }

    /// The fast block that function code 23 can read: it has holding registers only.
    pub(super) fn joinable(&self) -> Option<usize> {
        joint_block(&self.map, &self.fast)
    }

    /// Positions of the fast blocks as they are read: a write goes out first.
    fn in_order(&self, is_joined: bool) -> Vec<usize> {
        let first = self.joinable().filter(|_| is_joined);
        let rest = (0..self.fast.len()).filter(|at| Some(*at) != first);
        first.into_iter().chain(rest).collect()
    }

    /// One slow block, if it is time for one.
    pub(super) fn read_slow(&mut self, bus: Bus<'_>) -> Result<()> {
        let now_s = bus.now_s();
        let Some(block) = self.slow.get(self.next_slow).cloned() else { return Ok(()) };
        if now_s < self.slow_due_s {
            return Ok(());
        }
        self.next_slow = (self.next_slow + 1) % self.slow.len();
        self.slow_due_s = now_s + 1.0 / (self.map.rates.slow_hz * self.slow.len() as f64);
        self.read(bus, &block)
    }

    /// Reads all slow signals now.
    pub(super) fn read_now(&mut self, bus: Bus<'_>, quantity: Quantity) -> Result<()> {
        let signals = &self.map.signals;
        let holds = |block: &&ReadBlock| {
            block.signals.iter().any(|index| signals[*index].keys.quantity == quantity)
        };
        self.slow.iter().find(holds).cloned().map_or(Ok(()), |block| self.read(bus, &block))
    }

    fn read(&mut self, bus: Bus<'_>, block: &ReadBlock) -> Result<()> {
        self.read_with(bus, block, None).map(drop)
    }

    fn read_with(
        &mut self,
        bus: Bus<'_>,
        block: &ReadBlock,
        joined: Option<&Joined>,
    ) -> Result<(Span, Span)> {
        let point = joined.and_then(|joined| Some((self.map.set_points.get(joined.at)?, joined)));
        let read = match point {
            Some((point, joined)) => bus.read_write(point.put(&joined.cells), block.read),
            None => bus.read(block.read),
        };
        let read = read.map_err(|error| {
            let signals = block.signals.iter().map(|index| &self.map.signals[*index]);
            let written = point.map(|(point, _)| (point.name.as_str(), point.line));
            let places: Vec<_> =
                written.into_iter().chain(signals.map(|s| (s.name.as_str(), s.line))).collect();
            in_profile(error, &self.map, &places)
        })?;
        for index in &block.signals {
            let raw = |name: &str| self.get(name)?.pattern;
            let Some(location) = self.map.signals[*index].placed(raw) else { continue };
            let offset = block.read.offset_of(&location);
            let pattern = read.cells.get(offset..).and_then(|tail| location.layout.pattern(tail));
            let value = pattern.and_then(|pattern| self.value(*index, pattern));
            let value = match (value, pattern) {
                (Some(_), Some(pattern)) => {
                    self.unwrapped(*index, pattern, read.span.middle_s()).or(value)
                }
                _ => value,
            };
            self.rejected += u64::from(value.is_none());
            let is_supply = self.map.signals[*index].channel.is_some_and(|c| c.0 == Channel::Bus);
            if let Some(volts) = value.filter(|_| is_supply) {
                self.supply = [self.supply[1], self.supply[2], volts];
            }
            self.last[*index] = Reading { value, pattern, span: read.span };
        }
        self.compute(&block.signals, read.span);
        Ok((read.span, read.written))
    }

    /// Computes what depends on signals that were just read.
    fn compute(&mut self, read: &[usize], span: Span) {
        let map = Arc::clone(&self.map);
        for (index, signal) in map.signals.iter().enumerate() {
            let Some(formula) = &signal.formula else { continue };
            if formula.of.iter().any(|input| read.contains(input)) {
                let mut value = formula.value(|input| self.last[input].value);
                if let Some(signal) = formula.direction {
                    value =
                        value.zip(self.direction(index, signal)).map(|(value, sign)| sign * value);
                }
                self.last[index] = Reading { value, pattern: None, span };
            }
        }
    }

    /// Sign of the value at `index`, which is counted in the direction of `signal`; `None` where that has changed since the last read.
    fn direction(&mut self, index: usize, signal: usize) -> Option<f64> {
        let now = self.last[signal].value?;
        let before = self.directions.get(&index).copied().unwrap_or(now);
        let sign = if now == 0.0 { before } else { now }.signum();
        self.directions.insert(index, sign);
        (sign * before >= 0.0).then_some(sign)
    }

    fn value(&self, index: usize, pattern: u32) -> Option<f64> {
        let signal = &self.map.signals[index];
        signal.read(signal.location.layout, pattern, self.factor(&signal.numbers.scale_by)).value()
    }

    /// A position over the place where its counter begins again: the nearest to where the speed that was read last has taken
    /// it since. `None`: it does not begin again.
    fn unwrapped(&mut self, index: usize, pattern: u32, at_s: f64) -> Option<f64> {
        let signal = &self.map.signals[index];
        let span = signal.wraps_at?;
        let raw = signal.location.layout.number(pattern);
        let factor = self.factor(&signal.numbers.scale_by)?;
        let counts = self.positions.get(&index).map_or(raw, |last| {
            let moved = self.speed_rad_s().zip(signal.channel).map(|(speed, (_, si))| {
                speed * (at_s - last.at_s) / (si * signal.numbers.scale * factor)
            });
            let step = raw - last.raw;
            let turns = ((step - moved.unwrap_or(0.0)) / span).round();
            last.counts + step - turns * span
        });
        let position = Position { raw, counts, at_s };
        let value = signal.numbers.value(counts, factor);
        self.positions.insert(index, position);
        Some(value)
    }

    /// Of the shaft, as last read, rad/s.
    fn speed_rad_s(&self) -> Option<f64> {
        let signal = self.map.of_quantity(Quantity::ShaftSpeed)?;
        let (_, si) = signal.channel?;
        Some(self.get(&signal.name)?.value? * si)
    }

    /// What one unit of a set-point is in SI; of a duty by the largest of the latest voltages of the supply: a line without a check sum
    /// may lose a digit, and a tenth of the supply would be ten times the duty.
    pub(super) fn demand_si(&self, point: &SetPoint) -> Option<f64> {
        let percent_v = || {
            let bus = self.map.of_channel(Channel::Bus)?;
            let (_, si) = bus.channel?;
            // While the supply is not read, none of the latest holds.
            self.get(&bus.name)?.value?;
            Some(0.01 * si * self.supply.into_iter().fold(f64::NAN, f64::max))
        };
        let is_duty = point.keys.quantity == Quantity::Duty;
        point.si.or_else(|| percent_v().filter(|volts| is_duty && *volts > 0.0))
    }

    /// Product of the signals that a value is scaled with; `None` while one is not known.
    pub(super) fn factor(&self, scale_by: &[String]) -> Option<f64> {
        product_of(scale_by, |name| self.get(name)?.value)
    }
}

/// Adds the signals of the profile to an exception.
pub(super) fn in_profile(
    error: LinkError,
    map: &RegisterMap,
    places: &[(&str, usize)],
) -> LinkError {
    let LinkError::Exception { link, request, code, name, requested } = error else { return error };
    let places: Vec<String> =
        places.iter().map(|(name, line)| format!("{name} in line {line}")).collect();
    LinkError::Exception {
        link,
        request: format!("{request} (profile {}: {})", map.device.id, places.join(", ")),
        code,
        name,
        requested: Requested { is_of_profile: true, ..requested },
    }
}

pub(super) struct Clock {
    signal: usize,
    /// How far its counts are shifted up.
    shift: u32,
    /// One count of the shifted counter, s, and one of its own.
    count_s: f64,
    resolution_s: f64,
    counter: DriveClock,
    /// Host time of the first reading, s. The axis begins there, so that commands and events with a host time only are at most
    /// the drift of the two clocks beside the samples.
    origin_s: Option<f64>,
    map: ClockMap,
    /// Of the last reading, s.
    half_width_s: f64,
}

impl Clock {
    pub(super) fn of(map: &RegisterMap) -> Option<Self> {
        let signal = map.signals.iter().position(|signal| {
            signal.keys.quantity == Quantity::Clock && signal.keys.poll == PollRate::Fast
        })?;
        let resolution_s = map.signals[signal].clock_count_s()?;
        // The counter is followed as one of so many counts to the turn, whatever its width; a narrower one is shifted up to it.
        let counter = &map.signals[signal];
        let bits = counter.keys.wraps_at.map(|counts| counts.ilog2());
        let shift = 32 - bits.unwrap_or(counter.location.layout.width().into());
        Some(Self {
            signal,
            shift,
            count_s: resolution_s * 0.5_f64.powi(shift.cast_signed()),
            resolution_s,
            counter: DriveClock::default(),
            origin_s: None,
            map: ClockMap::default(),
            half_width_s: 0.5 * resolution_s,
        })
    }

    /// Drive time of the counter as it was read last, s; at the first reading that of the host. Within a count it follows the
    /// host's clock, as well as the exchange does and the offset of both clocks is known.
    pub(super) fn follow(&mut self, readings: &Readings) -> f64 {
        let reading = readings.at(self.signal);
        let span = reading.span;
        // The link ended before it was read for the first time.
        let raw = reading.pattern.unwrap_or_default() << self.shift;
        // What [`DriveClock`] takes a count for, s.
        let counts = self.count_s / 1e-6;
        let half_count_s = 0.5 * self.resolution_s;
        let origin_s = *self.origin_s.get_or_insert(span.middle_s() - half_count_s);
        let count_s = origin_s + self.counter.follow(raw, span.middle_s() / counts) * counts;
        self.map.observe(span, count_s + half_count_s);
        // An offset is the mean of marks that each are off by up to half of a count.
        let offset_s = half_count_s / (self.map.marks() as f64).sqrt();
        self.half_width_s = half_count_s.min(span.half_width_s() + offset_s);
        self.of_host_s(span.middle_s()).clamp(count_s, count_s + self.resolution_s)
    }

    pub(super) const fn half_width_s(&self) -> f64 {
        self.half_width_s
    }

    /// A host time on the drive's clock, s; before the first reading of it, the host's own.
    pub(super) fn of_host_s(&self, host_s: f64) -> f64 {
        self.map.offset_s(host_s).map_or(host_s, |offset_s| host_s + offset_s)
    }
}

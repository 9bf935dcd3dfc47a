//! What was read of a drive: which registers when, and what they say in units. What cannot be a value is none.

use std::sync::Arc;

use crate::drive::link::LinkError;
use crate::drive::register_bus::RegisterBus;
use crate::drive::register_map::{PollRate, Quantity, ReadBlock, RegisterMap, plan_reads};

/// One signal as it was last read.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Reading {
    /// In the profile's unit; `None` for a code that says so, or a value that cannot be.
    pub(super) value: Option<f64>,
    pub(super) pattern: Option<u32>,
    /// When its request went out, s.
    pub(super) read_s: f64,
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
            rejected: 0,
            map,
        }
    }

    pub(super) fn fast(&self) -> &[ReadBlock] {
        &self.fast
    }

    pub(super) fn get(&self, name: &str) -> Option<Reading> {
        let at = self
            .map
            .signals
            .iter()
            .position(|signal| signal.name == name)?;
        self.last.get(at).copied()
    }

    pub(super) fn at(&self, index: usize) -> Reading {
        self.last.get(index).copied().unwrap_or_default()
    }

    /// Everything, as at connect.
    pub(super) fn read_all(&mut self, bus: &mut dyn RegisterBus) -> Result<(), LinkError> {
        // Factors first: the others are scaled with them.
        for block in plan_reads(&self.map, PollRate::Once) {
            self.read(bus, &block)?;
        }
        for block in self.slow.clone() {
            self.read(bus, &block)?;
        }
        self.read_fast(bus)
    }

    pub(super) fn read_fast(&mut self, bus: &mut dyn RegisterBus) -> Result<(), LinkError> {
        for at in 0..self.fast.len() {
            let block = self.fast[at].clone();
            self.read(bus, &block)?;
        }
        Ok(())
    }

    /// One slow block, if it is time for one.
    pub(super) fn read_slow(&mut self, bus: &mut dyn RegisterBus) -> Result<(), LinkError> {
        let now_s = bus.now_s();
        let Some(block) = self.slow.get(self.next_slow).cloned() else {
            return Ok(());
        };
        if now_s < self.slow_due_s {
            return Ok(());
        }
        self.next_slow = (self.next_slow + 1) % self.slow.len();
        self.slow_due_s = now_s + 1.0 / (self.map.rates.slow_hz * self.slow.len() as f64);
        self.read(bus, &block)
    }

    /// What is otherwise read now and then, now.
    pub(super) fn read_now(
        &mut self,
        bus: &mut dyn RegisterBus,
        quantity: Quantity,
    ) -> Result<(), LinkError> {
        let signals = &self.map.signals;
        let holds = |block: &&ReadBlock| {
            let mut indices = block.signals.iter();
            indices.any(|index| signals[*index].quantity == quantity)
        };
        match self.slow.iter().find(holds).cloned() {
            Some(block) => self.read(bus, &block),
            None => Ok(()),
        }
    }

    fn read(&mut self, bus: &mut dyn RegisterBus, block: &ReadBlock) -> Result<(), LinkError> {
        let read = bus
            .read(block.table, block.address, block.count)
            .map_err(|error| {
                let signals = block.signals.iter().map(|index| &self.map.signals[*index]);
                let places: Vec<_> = signals.map(|s| (s.name.as_str(), s.line)).collect();
                in_profile(error, &self.map, &places)
            })?;
        for index in &block.signals {
            let location = self.map.signals[*index].location;
            let offset = usize::from(location.address - block.address);
            let pattern = read
                .words
                .get(offset..)
                .and_then(|tail| location.layout.pattern(tail));
            let value = pattern.and_then(|pattern| self.value(*index, pattern));
            self.rejected += u64::from(value.is_none());
            self.last[*index] = Reading {
                value,
                pattern,
                read_s: read.asked_s,
            };
        }
        Ok(())
    }

    fn value(&self, index: usize, pattern: u32) -> Option<f64> {
        let signal = &self.map.signals[index];
        if signal.invalid.contains(&pattern) {
            return None;
        }
        let factor = self.factor(&signal.numbers.scale_by)?;
        let value = signal
            .numbers
            .value(signal.location.layout.number(pattern), factor);
        let valid = |value: &f64| {
            signal
                .valid
                .is_none_or(|[low, high]| (low..=high).contains(value))
        };
        Some(value).filter(|value| value.is_finite()).filter(valid)
    }

    /// Product of the signals that a value is scaled with; `None` while one is not known.
    pub(super) fn factor(&self, scale_by: &[String]) -> Option<f64> {
        scale_by
            .iter()
            .map(|name| self.get(name).and_then(|reading| reading.value))
            .product()
    }
}

/// An exception says what of the profile it is about.
pub(super) fn in_profile(
    error: LinkError,
    map: &RegisterMap,
    places: &[(&str, usize)],
) -> LinkError {
    let LinkError::Exception {
        link,
        request,
        code,
        name,
    } = error
    else {
        return error;
    };
    let places: Vec<String> = places
        .iter()
        .map(|(name, line)| format!("{name} in line {line}"))
        .collect();
    LinkError::Exception {
        link,
        request: format!(
            "{request} (profile {}: {})",
            map.device.id,
            places.join(", ")
        ),
        code,
        name,
    }
}

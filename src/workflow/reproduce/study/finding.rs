//! What was said of each effect of the catalogue, beside what is so.

use serde::Serialize;

use super::judge::twin_of;
use super::parameters::INTERVAL_SIGMAS;
use super::truth::Truth;
use crate::diagnosis::{Candidate, Diagnosis, Status};
use crate::sample::ParameterEstimate;

/// One effect of the catalogue in one set.
#[derive(Clone, Debug, Serialize)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "a line of a sheet with a column for each question, not the state of something"
)]
pub struct Finding {
    pub effect: &'static str,
    pub there: bool,
    /// In the unit of its first parameter, an amplitude for waves, at the reference condition.
    pub true_size: Option<f64>,
    pub probability: f64,
    pub status: Status,
    pub upper_bound: Option<f64>,
    pub detectable: Option<f64>,
    pub named: bool,
    /// It is named, with another number of waves than what is there has.
    pub of_other_order: bool,
    /// As it was estimated, with its 95 % interval.
    pub size: Option<f64>,
    pub interval_95: Option<[f64; 2]>,
    /// Another right name of the same thing is named: no size of its own then has a truth.
    pub other_name: Option<&'static str>,
    /// Its twin is named in its place; of a false name: its twin is there.
    pub twin: bool,
    /// The answer says that it cannot be told from what is named; of a false name: from what is there.
    pub left_open: bool,
}

impl Finding {
    /// Whether it is there and named.
    pub const fn is_recalled(&self) -> bool {
        self.there && self.named && !self.of_other_order
    }

    /// Whether it is named and not there, or another wave is there.
    pub const fn is_false(&self) -> bool {
        self.named && (!self.there || self.of_other_order)
    }

    /// Whether it is there, and neither it nor another name of the same thing is named.
    pub const fn is_missed(&self) -> bool {
        self.there && !self.is_recalled() && self.other_name.is_none()
    }

    /// Whether it was called ruled out with a bound below `share` of its true size.
    pub fn is_ruled_out_below(&self, share: f64) -> bool {
        let sizes = self.upper_bound.zip(self.true_size);
        let is_below = sizes.is_some_and(|(bound, size)| bound < share * size.abs());
        self.is_missed() && self.status == Status::RuledOut && is_below
    }

    /// Whether its size was said to be one that would have shown, and it was not named.
    pub fn should_have_shown(&self) -> bool {
        let sizes = self.detectable.zip(self.true_size);
        self.is_missed() && sizes.is_some_and(|(least, size)| least < size.abs())
    }

    /// Whether "at most" holds of what is there and was not named; none where there is no bound.
    pub fn bound_holds(&self) -> Option<bool> {
        let (bound, size) = self.upper_bound.zip(self.true_size)?;
        (self.is_missed()).then_some(bound >= size.abs())
    }

    /// Whether the interval of a right name holds its size.
    pub fn interval_holds(&self) -> Option<bool> {
        let ([low, high], size) = self.interval_95.zip(self.true_size)?;
        (self.is_recalled()).then_some((low..=high).contains(&size))
    }

    /// Error of the size of a right name, as a share of it; negative where it is too small.
    pub fn size_error(&self) -> Option<f64> {
        let (found, size) = self.size.zip(self.true_size)?;
        (self.is_recalled()).then(|| found / size - 1.0)
    }
}

/// Every effect that was weighed; `orders` are the waves in a turn of what is named.
pub(super) fn findings(
    truths: &[Truth],
    orders: &[(&'static str, f64)],
    diagnosis: &Diagnosis,
) -> Vec<Finding> {
    let of = |candidate| Finding::of(candidate, truths, orders, diagnosis);
    diagnosis.candidates.iter().map(of).collect()
}

impl Finding {
    fn of(
        candidate: &Candidate,
        truths: &[Truth],
        orders: &[(&'static str, f64)],
        diagnosis: &Diagnosis,
    ) -> Self {
        let id = candidate.effect;
        let named = &diagnosis.effects;
        let is_named = named.contains(&id);
        let is_there = |id: &str| truths.iter().any(|truth| truth.is(id));
        let own: Vec<&Truth> = truths.iter().filter(|truth| truth.is(id)).collect();
        // What was named as a wave of one order is held against that one.
        let waves: Vec<f64> = (orders.iter().filter(|(other, _)| *other == id))
            .map(|(_, order)| *order)
            .collect();
        let has_order = |truth: &&&Truth| {
            let close = |order: f64| waves.iter().any(|found| (found - order).abs() < 0.5);
            truth.order.is_none_or(close)
        };
        let meant: Vec<&Truth> = own.iter().filter(has_order).copied().collect();
        // Of one thing under two names neither size is the whole of it.
        let mut names = own.iter().flat_map(|truth| &truth.names).map(|name| name.0);
        let other_name = names.find(|name| *name != id && named.contains(name));
        let twin = twin_of(id);
        let mut open = diagnosis.confusable.iter();
        let (size, interval_95) = estimate(&candidate.parameters);
        Self {
            effect: id,
            there: !own.is_empty(),
            true_size: true_size(if meant.is_empty() { &own } else { &meant }, id)
                .filter(|_| other_name.is_none()),
            probability: candidate.probability,
            status: candidate.status,
            upper_bound: candidate.upper_bound,
            detectable: candidate.detectable,
            named: is_named,
            of_other_order: is_named && !own.is_empty() && meant.is_empty(),
            size,
            interval_95,
            other_name: names
                .filter(|_| !is_named)
                .find(|name| named.contains(name)),
            twin: twin.is_some_and(|twin| {
                if is_named {
                    own.is_empty() && is_there(twin)
                } else {
                    named.contains(&twin)
                }
            }),
            left_open: open.any(|[first, rival]| {
                if is_named {
                    *first == id && own.is_empty() && is_there(rival)
                } else {
                    *rival == id
                }
            }),
        }
    }
}

impl Truth {
    fn is(&self, id: &str) -> bool {
        self.names.iter().any(|(name, _)| *name == id)
    }
}

/// Of one kind the sum, of waves of several orders the largest.
fn true_size(truths: &[&Truth], id: &str) -> Option<f64> {
    let mut sizes = truths.iter().map(|truth| {
        let mut own = truth.names.iter().filter(|(name, _)| *name == id);
        own.next().and_then(|(_, size)| *size)
    });
    let are_waves = truths.iter().any(|truth| truth.order.is_some());
    let first = sizes.next()??;
    Some(sizes.flatten().fold(
        first,
        |all, size| {
            if are_waves { all.max(size) } else { all + size }
        },
    ))
}

/// Size and 95 % interval of the first parameter, or of the amplitude of the first two.
fn estimate(parameters: &[ParameterEstimate]) -> (Option<f64>, Option<[f64; 2]>) {
    let Some(first) = parameters.first() else {
        return (None, None);
    };
    let is_wave = first.key.contains(".sin_");
    let (true, Some(second)) = (is_wave, parameters.get(1)) else {
        return (first.value, first.interval_95());
    };
    let Some((sine, cosine)) = first.value.zip(second.value) else {
        return (None, None);
    };
    let size = sine.hypot(cosine);
    let half = (first.std.zip(second.std))
        .map(|(of_sine, of_cosine)| (sine * of_sine).hypot(cosine * of_cosine) / size)
        .map(|std| INTERVAL_SIGMAS * std);
    (Some(size), half.map(|half| [size - half, size + half]))
}

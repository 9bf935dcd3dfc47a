//! Frequency response of a model for comparison with the measured one: the current and speed of its free run under the voltage of
//! the record pass the same estimator (best linear approximation; Pintelon and Schoukens 2012, chapter 4), so that no effect of
//! the model is linearised.
//!
//! ```text
//! Scenario, model -> free run -> Scenario of the model -> the same stretches, the same estimator -> Departure
//! ```

use serde::Serialize;

use super::{
    FrequencyResponse, FrequencyResponseError, Mode, ModeKind, Pathway, PathwayResponse,
    ResponsePoint, continued, frequency_response, response_over,
};
use crate::noise::NoiseFloor;
use crate::output_error::{FitError, predict};
use drivebench_model::plant::{Model, Scenario};
use drivebench_model::text::number::significant;

/// A band in which model and measurement differ by more than the intervals.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Departure {
    pub pathway: Pathway,
    pub from_hz: f64,
    pub to_hz: f64,
    /// Where the model is farthest off.
    pub at_hz: f64,
    /// Model over measurement there, and the phase of the model less the measured one.
    pub magnitude_db: f64,
    pub phase_deg: f64,
}

impl Departure {
    pub fn sentence(&self) -> String {
        let [from, to, at] = [self.from_hz, self.to_hz, self.at_hz].map(|hz| significant(hz, 3));
        format!(
            "{}: from {from} to {to} Hz the model is up to {:+.1} dB and {:+.0} degrees off (at {at} Hz)",
            self.pathway.name(),
            self.magnitude_db,
            self.phase_deg
        )
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Compared {
    #[serde(flatten)]
    pub measured: FrequencyResponse,
    pub model: Option<FrequencyResponse>,
    /// None without a model.
    pub departures: Vec<Departure>,
}

/// The scenarios with current and speed of the model's free run, of which only the initial state is fitted.
pub fn of_model(model: &Model, scenarios: &[Scenario]) -> Result<Vec<Scenario>, FitError> {
    let simulated = |scenario: &Scenario| {
        let noise = NoiseFloor::from_standstill(scenario)
            .unwrap_or_else(|| NoiseFloor::from_spread(scenario));
        let found = predict(model, scenario, &noise)?.trajectory;
        // With the gaps of the measurement.
        let with_gaps = |measured: &[f64], model: &[f64]| {
            let mut model = model.to_vec();
            for (value, measured) in model.iter_mut().zip(measured) {
                if !measured.is_finite() {
                    *value = f64::NAN;
                }
            }
            model
        };
        Ok(Scenario {
            current_a: with_gaps(&scenario.current_a, &found.current_a),
            speed_rad_s: with_gaps(&scenario.speed_rad_s, &found.speed_rad_s),
            ..scenario.clone()
        })
    };
    scenarios.iter().map(simulated).collect()
}

/// The response of `scenarios`, and that of `model`, which are the simulated scenarios.
pub fn compared(
    scenarios: &[Scenario],
    model: Option<&[Scenario]>,
) -> Result<Compared, FrequencyResponseError> {
    let mut measured = frequency_response(scenarios)?;
    measured.cautions.extend(disagreements(scenarios)?);
    let model = model.map(|model| response_over(model, scenarios)).transpose()?;
    let departures = model.as_ref().map_or_else(Vec::new, |model| departures(&measured, model));
    Ok(Compared { measured, model, departures })
}

impl Compared {
    /// Measured resonances of the mechanics that the model does not have, as of an elastic coupling.
    pub fn missing_resonances(&self) -> Vec<Mode> {
        let Some(model) = &self.model else { return Vec::new() };
        let is_of_mechanics = |mode: &&Mode| {
            mode.kind == ModeKind::Resonance && mode.pathway == Pathway::CurrentToSpeed
        };
        let is_same = |one: &Mode, other: &Mode| {
            one.kind == other.kind
                && one.pathway == other.pathway
                && (one.frequency_hz / other.frequency_hz).ln().abs() < 0.1
        };
        let departs = |mode: &Mode| {
            let mut own = self.departures.iter();
            own.any(|band| (band.from_hz..=band.to_hz).contains(&mode.frequency_hz))
        };
        let measured = self.measured.modes.iter().filter(is_of_mechanics);
        measured
            .filter(|mode| departs(mode) && !model.modes.iter().any(|own| is_same(own, mode)))
            .copied()
            .collect()
    }
}

/// Runs with another response than the first one, over which no mean may be taken.
fn disagreements(scenarios: &[Scenario]) -> Result<Vec<String>, FrequencyResponseError> {
    let [first, others @ ..] = scenarios else { return Ok(Vec::new()) };
    let mut sentences = Vec::new();
    if others.is_empty() {
        return Ok(sentences);
    }
    let of_first = frequency_response(std::slice::from_ref(first))?;
    for other in others {
        let mut own = frequency_response(std::slice::from_ref(other))?;
        for pathway in &mut own.pathways {
            pathway.points.retain(|point| point.is_carried);
        }
        let differs = departures(&of_first, &own);
        let widest =
            differs.iter().max_by(|a, b| (a.to_hz / a.from_hz).total_cmp(&(b.to_hz / b.from_hz)));
        sentences.extend(widest.map(|band| {
            let [from, to] = [band.from_hz, band.to_hz].map(|hz| significant(hz, 3));
            format!(
                "from {from} to {to} Hz ({}) two runs differ by more than their intervals: are they of one machine in one state? The \
                 response is a mean of both ({} and {})",
                band.pathway.name(),
                first.name,
                other.name
            )
        }));
    }
    Ok(sentences)
}

fn departures(measured: &FrequencyResponse, model: &FrequencyResponse) -> Vec<Departure> {
    // Lines of more than one estimate, which are independent of each other.
    let lines_hz = 22.0 * measured.used_s.recip() * measured.stretches as f64;
    let own = measured.pathways.iter().filter_map(|own| {
        let other = model.pathways.iter().find(|other| other.pathway == own.pathway)?;
        Some(bands(own, other, lines_hz))
    });
    own.flatten().collect()
}

/// The measured point, how far the model is off in half widths, and by how much.
struct Off {
    at: usize,
    half_widths: f64,
    departure: Departure,
}

fn bands(measured: &PathwayResponse, model: &PathwayResponse, lines_hz: f64) -> Vec<Departure> {
    let points = &measured.points;
    let all = points.iter().enumerate().filter(|(_, own)| own.is_carried);
    let off: Vec<Off> = all
        .filter_map(|(at, own)| off(at, measured.pathway, own, &model.points))
        .filter(|off| off.half_widths > 1.0)
        .collect();
    // Two points inside of their intervals do not end a band.
    let found = off.chunk_by(|a, b| b.at - a.at <= 3).filter_map(|piece| {
        let farthest = piece.iter().max_by(|a, b| a.half_widths.total_cmp(&b.half_widths))?;
        let (first, last) = (piece.first()?, piece.last()?);
        let (from_hz, to_hz) = (points[first.at].frequency_hz, points[last.at].frequency_hz);
        let is_wide = piece.len() >= 3 && to_hz - from_hz >= lines_hz;
        // A band is described where its magnitude is farthest off.
        let largest = piece.iter().max_by(|a, b| {
            let size = |off: &Off| off.departure.magnitude_db.abs();
            size(a).total_cmp(&size(b))
        })?;
        // By chance a point is off this far alone.
        (is_wide && farthest.half_widths >= 2.0).then_some(Departure {
            from_hz,
            to_hz,
            ..largest.departure
        })
    });
    found.collect()
}

/// Magnitude, phase in degrees and half width at a frequency, between the two points about it where none is at it: records of
/// other lengths have other frequencies.
fn at_frequency(points: &[ResponsePoint], hertz: f64) -> Option<(f64, f64, f64)> {
    let place = points.partition_point(|point| point.frequency_hz < hertz);
    let above = points.get(place)?;
    let below =
        if above.frequency_hz <= hertz { above } else { points.get(place.checked_sub(1)?)? };
    let span = (above.frequency_hz / below.frequency_hz).ln();
    if span > 0.06 {
        return None;
    }
    let share = if span > 0.0 { (hertz / below.frequency_hz).ln() / span } else { 0.0 };
    let between = |of: fn(&ResponsePoint) -> f64| of(below) + share * (of(above) - of(below));
    let magnitude = between(|point| point.magnitude.ln()).exp();
    Some((magnitude, between(|point| point.phase_deg), below.half_width().max(above.half_width())))
}

fn off(at: usize, pathway: Pathway, own: &ResponsePoint, model: &[ResponsePoint]) -> Option<Off> {
    let (other_magnitude, other_phase_deg, other_half) = at_frequency(model, own.frequency_hz)?;
    let half_width = own.half_width().hypot(other_half);
    let magnitude = (other_magnitude / own.magnitude).ln();
    let phase_deg = continued(other_phase_deg - own.phase_deg, Some(0.0));
    let size = magnitude.abs().max(phase_deg.to_radians().abs());
    // Less, as a share of the magnitude or an angle in radians, is of no consequence.
    (size.is_finite() && size >= 0.05).then(|| Off {
        at,
        half_widths: size / half_width,
        departure: Departure {
            pathway,
            from_hz: own.frequency_hz,
            to_hz: own.frequency_hz,
            at_hz: own.frequency_hz,
            magnitude_db: 20.0 * magnitude * std::f64::consts::LOG10_E,
            phase_deg,
        },
    })
}

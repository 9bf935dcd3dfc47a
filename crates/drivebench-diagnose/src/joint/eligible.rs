//! Eligible effects and rows: which effects a run can judge at all, and which of its rows count.

use std::f64::consts::TAU;

use crate::mechanical::{depends_on_drive, start_of};
use drivebench_identify::balance::has_both_power_flows;
use drivebench_identify::claims::lacks_current;
use drivebench_identify::noise::noise_in_motion;
use drivebench_identify::speed_from_angle;
use drivebench_model::numerics::statistics::{extent, finite};
use drivebench_model::plant::effect::TermKind;
use drivebench_model::plant::{
    Effect, Enters, Input, Instant, ParameterSpec, Scenario, State, Terms, starts_from_rest,
};
use drivebench_model::sample::Channel;

/// Periods that the angle must cover before a wave over it is eligible: less is a slope.
const LEAST_TRAVEL_PERIODS: f64 = 2.0;

/// Why a run cannot judge an effect at all; `None` where it can. A voltage drives through every equation.
pub(crate) fn why_not(effect: &dyn Effect, scenario: &Scenario) -> Option<&'static str> {
    let guess = effect.parameters().iter().map(ParameterSpec::guess);
    let terms = effect.terms(&guess.collect::<Vec<f64>>());
    let acts_at_restarts = terms.path().restart_delay_s > 0.0;
    if acts_at_restarts && starts_from_rest(&scenario.events, scenario.scales.rest_s()).len() < 2 {
        return Some("the run starts from rest once at most: there it is a start delay");
    }
    if lacks_current(scenario) {
        return why_not_without_current(effect, scenario);
    }
    if scenario.input == Input::Voltage {
        return None;
    }
    let why_not = match effect.card().enters {
        Enters::Voltage => Some("no voltage drives the run, and it acts in the voltage balance"),
        Enters::Path => Some(
            "it acts between motor and measurement: a run without a voltage does not distinguish it",
        ),
        Enters::Both if scenario.input == Input::Torque => {
            Some("it acts through the current, which the run does not have")
        }
        Enters::Both | Enters::Torque => None,
    };
    if why_not.is_some() {
        return why_not;
    }
    if terms.coupling().is_some() {
        return Some("a second inertia is no term of the torque balance: record the voltage too");
    }
    if effect.parameters().is_empty() {
        return Some("it has no parameter of its own");
    }
    let times = scenario.sample_time_s.windows(2).zip(&scenario.speed_rad_s);
    let energies_j =
        times.map(|(times, speed)| scenario.input_at(times[0]) * speed * (times[1] - times[0]));
    if is_friction_of_drive(effect, &*terms) && !has_both_power_flows(energies_j) {
        return Some(
            "power flows one way only in this run: friction in proportion to the load is then a common factor of inertia and \
             friction; record braking too",
        );
    }
    if !effect.card().needs_angle {
        return None;
    }
    let orders = effect
        .parameters()
        .iter()
        .find(|spec| spec.key == "order")
        .map_or(&[1.0][..], |spec| spec.shapes);
    let least = least_periods(effect, scenario);
    if !orders.iter().any(|order| travels(scenario, *order, least)) {
        return Some(if least < LEAST_TRAVEL_PERIODS {
            "the shaft moves through less than a quarter of a turn"
        } else {
            "the shaft moves through less than two periods of it"
        });
    }
    let mut orders = orders.iter();
    let is_resolved = orders.any(|order| resolves_wave(effect, scenario, *order));
    (!is_resolved).then_some("the shaft turns through it from one sample to the next")
}

/// What a record of voltage and speed cannot show: it determines `L/R`, `R J/Kt` and `Ke + R B/Kt`, and no current.
fn why_not_without_current(effect: &dyn Effect, scenario: &Scenario) -> Option<&'static str> {
    let offsets = [TermKind::TorqueOffset, TermKind::VoltageOffset].map(TermKind::id);
    let (lowest, most) = extent(finite(&scenario.speed_rad_s));
    let turns_both_ways = most.min(-lowest) > 0.05 * most.max(-lowest);
    let is_over_current = |spec: &ParameterSpec| {
        spec.unit == "ohm"
            || spec.unit.split(['/', '(', '.', ' ']).any(|unit| unit.starts_with('A'))
    };
    if effect.card().id == TermKind::Drag.id() {
        Some(
            "without a current a torque in proportion to the speed is a part of Ke: record the current",
        )
    } else if effect.card().id == TermKind::LateCurrent.id()
        || effect.parameters().iter().any(is_over_current)
    {
        Some("its size is in proportion to the current, which was not recorded")
    } else if offsets.contains(&effect.card().id) && !turns_both_ways {
        Some(
            "the shaft turns one way only, and no current was recorded: there it is a part of the friction",
        )
    } else {
        None
    }
}

/// Whether the effect is friction that grows with the driving torque.
fn is_friction_of_drive(effect: &dyn Effect, terms: &dyn Terms) -> bool {
    let at =
        Instant { current_a: 1.0, speed_rad_s: 1.0, torque_n_m_per_a: 1.0, ..Instant::default() };
    depends_on_drive(effect) && terms.friction_n_m(&at) != 0.0
}

/// Whether a run resolves a wave of so many periods per turn: every run that a voltage drives counts.
pub(super) fn resolves_wave(
    effect: &dyn Effect,
    scenario: &Scenario,
    periods_per_turn: f64,
) -> bool {
    let least = least_periods(effect, scenario);
    scenario.input == Input::Voltage
        || (travels(scenario, periods_per_turn, least) && resolves(scenario, periods_per_turn))
}

/// Periods of an effect over the angle that the angle must cover; a quarter of one whose order is known, over an angle that is
/// measured: an arm does not turn round, and a slope bends over a quarter of a turn.
fn least_periods(effect: &dyn Effect, scenario: &Scenario) -> f64 {
    let mut specs = effect.parameters().iter();
    if scenario.angle.is_empty() || specs.any(|spec| spec.key == "order") {
        LEAST_TRAVEL_PERIODS
    } else {
        0.25
    }
}

/// Whether the angle moved through so many periods: far enough to tell a wave from a slope.
fn travels(scenario: &Scenario, periods_per_turn: f64, least: f64) -> bool {
    let (lowest, most) = extent(scenario.shaft_angle().iter().map(|point| point.1));
    (most - lowest) * periods_per_turn >= least * TAU
}

/// Whether a tenth of the samples are closer than a quarter of a period of the wave.
fn resolves(scenario: &Scenario, periods_per_turn: f64) -> bool {
    let angles = scenario.shaft_angle();
    let pairs = angles.windows(2);
    let mut steps: Vec<f64> = pairs.map(|pair| (pair[1].1 - pair[0].1).abs()).collect();
    // What the noise of a resting shaft adds up to is no motion: less than 0.02 of the longest step.
    let moves = 0.02 * steps.iter().fold(0.0, |most, step| f64::max(most, *step));
    steps.retain(|step| *step > moves);
    let close = steps.iter().filter(|step| **step * periods_per_turn < 0.25 * TAU);
    close.count() as f64 >= 0.1 * steps.len() as f64
}

/// Largest share of the noise of the speeds in the mean square of their rate: it attenuates the inertia by as much. At 4 % lags and
/// steps were named beside two hidden effects (an axis at 1 kHz).
const NOISE_OF_RATE: f64 = 0.01;

/// The shortest interval between speeds, in powers of two of the period, over which their noise is a small part of their rate.
fn quiet_interval_s(scenario: &Scenario) -> f64 {
    let known = |sample: &usize| scenario.speed_rad_s[*sample].is_finite();
    let samples: Vec<usize> = (0..scenario.samples()).filter(known).collect();
    let noise = noise_in_motion(&scenario.speed_rad_s);
    let point =
        |at: usize| (scenario.sample_time_s[samples[at]], scenario.speed_rad_s[samples[at]]);
    let is_quiet = |step: &usize| {
        let changes = (*step..samples.len()).step_by(*step).map(|at| {
            let (from, to) = (point(at - step), point(at));
            (to.1 - from.1).powi(2)
        });
        let (sum, count) = changes.fold((0.0, 0.0), |sum, change| (sum.0 + change, sum.1 + 1.0));
        2.0 * noise * noise * count <= NOISE_OF_RATE * sum
    };
    let steps = (0..16).map(|power| 1_usize << power).take_while(|step| 100 * step < samples.len());
    let found = steps.clone().find(is_quiet).or_else(|| steps.last());
    found.filter(|step| *step > 1).map_or(0.0, |step| step as f64 * scenario.mean_period_s())
}

/// Initial state of each run: the fitted one for the first, rest for a hold-out, the measured one for the others.
pub(super) fn starts(runs: &[Scenario], held_out: usize, first: State) -> Vec<State> {
    let start = |(number, run): (usize, &Scenario)| {
        if run.input != Input::Voltage {
            start_of(run)
        } else if number == 0 {
            first
        } else if number == held_out {
            State::default()
        } else {
            let known = |value: f64| if value.is_finite() { value } else { 0.0 };
            let [current_a, speed_rad_s] = run.begins_with();
            State::at(known(current_a), known(speed_rad_s))
        }
    };
    runs.iter().enumerate().map(start).collect()
}

/// The run with the rows that are used. A measured current is held from halfway to its neighbours, not from its own instant. Speeds
/// derived from the angle are thinned until no two share an angle sample, whose error would otherwise count as motion. The torque
/// keeps every value, because its impulse between two speeds counts.
pub(super) fn prepared(scenario: &Scenario, noise_is_known: bool) -> Scenario {
    let mut prepared = scenario.clone();
    if scenario.input == Input::Voltage {
        return prepared;
    }
    if scenario.input_channel == Channel::Current {
        let events = &scenario.events;
        for (event, pair) in prepared.events[1..].iter_mut().zip(events.windows(2)) {
            event.0 = 0.5 * (pair[0].0 + pair[1].0);
        }
    }
    let span = speed_from_angle::span(scenario);
    // Where the noise is not known speeds are as far apart as the windows of the balance: faster, the frame and the drive's own
    // loops would decide.
    let is_own = noise_is_known && span.is_none();
    let least_s = if is_own { 0.0 } else { 0.03 };
    let apart_s = quiet_interval_s(scenario).max(least_s);
    let (mut next_s, mut skip) = (f64::NEG_INFINITY, 0);
    let is_used = |sample: &usize| {
        let time_s = scenario.sample_time_s[*sample];
        if !scenario.speed_rad_s[*sample].is_finite() {
            return false;
        }
        if time_s < next_s || skip > 0 {
            skip -= usize::from(skip > 0);
            return false;
        }
        // Slack for stamps that are rounded.
        next_s = time_s + (1.0 - 1e-6) * apart_s;
        skip = span.map_or(0, |span| span - 1);
        true
    };
    let used: Vec<usize> = (0..scenario.samples()).filter(is_used).collect();
    let cells = |of: &[f64]| -> Vec<f64> {
        used.iter().filter_map(|sample| of.get(*sample).copied()).collect()
    };
    prepared.angle = scenario.shaft_angle().into_owned();
    prepared.sample_time_s = cells(&scenario.sample_time_s);
    prepared.current_a = cells(&scenario.current_a);
    prepared.speed_rad_s = cells(&scenario.speed_rad_s);
    prepared.time_half_width_s = cells(&scenario.time_half_width_s);
    prepared.scored = 0..used.len();
    prepared
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kit::{nameplate, record};
    use drivebench_model::plant::effect;

    #[test]
    fn without_a_current_what_is_in_proportion_to_it_stays_open() {
        let mut run = record(&nameplate(), 0, 1);
        let check = |ids: &[&str], run: &Scenario, is_open: bool| {
            for id in ids {
                let found = why_not(effect::find(id).unwrap(), run);
                assert_eq!(found.is_some(), is_open, "{id}: {found:?}");
            }
        };
        let of_current = [
            "viscous_friction",
            "supply_sag",
            "flux_saturation",
            "inductance_saturation",
            "winding_heating",
            "discontinuous_conduction",
            "current_filter",
            "current_offset",
        ];
        let others = ["stribeck_friction", "quadratic_load", "command_delay", "speed_filter"];
        let offsets = ["constant_load", "voltage_offset"];
        check(&[&of_current[..], &others, &offsets].concat(), &run, false);
        run.current_a.fill(f64::NAN);
        check(&of_current, &run, true);
        check(&[&others[..], &offsets].concat(), &run, false);
        // One way: a constant torque is a part of the friction.
        run.speed_rad_s.iter_mut().for_each(|speed| *speed = speed.abs());
        check(&offsets, &run, true);
        check(&others, &run, false);
    }
}

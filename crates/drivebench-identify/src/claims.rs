//! Claims that a run supports, given where its signals come from.
//!
//! A commanded voltage is not the armature's, a supply current is not the armature's, and what a
//! drive computes from its own settings only repeats them. A value keeps its figure; its verdict and reason say how far
//! it may be believed.

use super::stamps;
use drivebench_model::numerics::statistics::{largest, median};
use drivebench_model::plant::effect::VOLTAGE_DROP;
use drivebench_model::plant::{Input, MotorKey, Scenario};
use drivebench_model::sample::{Channel, Origin, ParameterEstimate, Run, Side, Verdict};
use drivebench_model::signal;

/// Share of the bus voltage at the terminals from which the duty cycle counts as one, of the rows that must have it,
/// and of the largest voltage from which a row counts.
const FULL_DUTY: f64 = 0.97;
const NEARLY_ALWAYS: f64 = 0.99;
const ENERGISED: f64 = 0.02;
/// Difference of measured and commanded voltage, as a share of the largest command, that counts as agreement.
const AGREES: f64 = 0.01;
/// Rows below which nothing is said about agreement.
const FEWEST_ROWS: usize = 20;

/// Limits the verdicts to what the origins of the signals allow; returns what the reader has to know.
pub fn limit(parameters: &mut [ParameterEstimate], run: &Run, scenario: &Scenario) -> Vec<String> {
    if let Some(half_width_s) = scenario.typical_half_width_s() {
        stamps::refuse(parameters, half_width_s);
    }
    without_current(parameters, scenario);
    let mut notes = Vec::new();
    for claim in claims(run, scenario) {
        let touched = |p: &&mut ParameterEstimate| claim.keys.contains(&p.key.as_str());
        let mut found = false;
        for parameter in parameters.iter_mut().filter(touched) {
            claim.apply(parameter);
            found |= parameter.value.is_some();
        }
        // A claim that touches nothing that was found need not be read.
        notes.extend(found.then_some(claim.reason));
    }
    notes
}

/// Without a current no excitation tells resistance, inductance, inertia and torques apart, which is another thing than a run that
/// does not excite them: only L/R, R J/(Ke Kt) and R Mc/Kt stand in the equations of voltage and speed. Where none of them is
/// given none has a value, of the motor or of an effect.
pub fn without_current(parameters: &mut [ParameterEstimate], scenario: &Scenario) {
    let has_current = scenario.current_a.iter().any(|current| current.is_finite());
    if scenario.input != Input::Voltage || has_current {
        return;
    }
    let back_emf = MotorKey::BackEmf.key();
    for own in parameters.iter_mut().filter(|own| own.key == back_emf) {
        let reason = "without a current it includes viscous friction: it is Ke + R B/Kt";
        lower(own, Verdict::Searching, reason);
    }
    if !has_no_scale(parameters, scenario) {
        return;
    }
    let is_found =
        |own: &&mut ParameterEstimate| is_tied(own.unit) && own.verdict != Verdict::Fixed;
    for own in parameters.iter_mut().filter(is_found) {
        let reason = "without a current no run tells resistance, inductance, inertia and load torque apart: voltage and speed hold \
                      only L/R, R J and R Mc; measure the current, or fix one of them in the model file";
        *own = ParameterEstimate::not_observable(&own.key, own.unit, reason);
    }
}

/// Whether the run has no current, and no resistance, inductance, inertia or torque is given that would take its place.
pub fn has_no_scale(parameters: &[ParameterEstimate], scenario: &Scenario) -> bool {
    let has_current = scenario.current_a.iter().any(|current| current.is_finite());
    let is_given = |own: &ParameterEstimate| {
        let is_of_motor = MotorKey::from_key(&own.key).is_some();
        is_of_motor && is_tied(own.unit) && own.verdict == Verdict::Fixed
    };
    scenario.input == Input::Voltage && !has_current && !parameters.iter().any(is_given)
}

/// Whether figures in this unit have no value where [`has_no_scale`].
pub fn is_tied(unit: &str) -> bool {
    match unit {
        "ohm" | "H" | "kg.m2" => true,
        "N.m/A" => false,
        unit => unit.starts_with("N.m"),
    }
}

/// How far a claim goes.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Weight {
    /// The value stands, with a remark.
    Remark,
    /// It cannot be called settled.
    Dependent,
    /// It is no value of the motor.
    Wrong,
}

struct Claim {
    keys: Vec<&'static str>,
    weight: Weight,
    reason: String,
}

impl Claim {
    fn new(keys: &[MotorKey], weight: Weight, reason: impl Into<String>) -> Self {
        Self {
            keys: keys.iter().map(|key| key.key()).collect(),
            weight,
            reason: reason.into(),
        }
    }

    fn apply(&self, parameter: &mut ParameterEstimate) {
        match self.weight {
            Weight::Remark => {
                if parameter.value.is_some() && parameter.verdict != Verdict::Fixed {
                    parameter.reason.get_or_insert_with(|| self.reason.clone());
                }
            }
            Weight::Dependent => lower(parameter, Verdict::Searching, &self.reason),
            Weight::Wrong => lower(parameter, Verdict::Invalid, &self.reason),
        }
    }
}

/// Only ever downward: settled, searching, invalid. What has no value, or is given, stays as it is.
pub(super) fn lower(parameter: &mut ParameterEstimate, to: Verdict, reason: &str) {
    let lowers = match parameter.verdict {
        Verdict::Settled => true,
        Verdict::Searching => to == Verdict::Invalid,
        Verdict::NotObservable | Verdict::Invalid | Verdict::Fixed => false,
    };
    if lowers {
        parameter.verdict = to;
        parameter.reason = Some(reason.to_owned());
    }
}

fn claims(run: &Run, scenario: &Scenario) -> Vec<Claim> {
    let mut claims = Vec::new();
    let has_current = run.column(Channel::Current).is_some();
    match scenario.input {
        Input::Voltage => {
            claims.extend(of_voltage(run, scenario.input_channel));
            if has_current {
                claims.extend(of_current(run, &MotorKey::ALL));
            }
        }
        Input::Current => claims.extend(of_current(run, &MECHANICAL)),
        Input::Torque => claims.extend(of_torque(run)),
    }
    claims.extend(of_speed(run, scenario.input));
    claims
}

const MECHANICAL: [MotorKey; 2] = [MotorKey::Inertia, MotorKey::LoadTorque];
/// With Kt taken equal to Ke, what is wrong in Ke is wrong in every torque.
pub(super) const OF_BACK_EMF: [MotorKey; 4] = [
    MotorKey::BackEmf,
    MotorKey::TorqueConstant,
    MotorKey::Inertia,
    MotorKey::LoadTorque,
];

fn of_voltage(run: &Run, channel: Channel) -> Option<Claim> {
    let key = channel.key();
    if run.side(channel) == Some(Side::Supply) && !full_duty(run) {
        let reason = format!(
            "{key} is the voltage of the supply, not of the motor: the duty cycle stands between them"
        );
        return Some(Claim::new(&MotorKey::ALL, Weight::Wrong, reason));
    }
    let reason = match run.origin(channel) {
        Origin::Estimated => format!(
            "the resistance includes what the drive's own estimate of {key} leaves out of its switches"
        ),
        Origin::Commanded if !measured_agrees(run, channel) => {
            "the resistance includes the drive's own drops \
             (switches, dead time, cable): the voltage is commanded, not measured at the terminals"
                .to_owned()
        }
        _ => return None,
    };
    let mut claim = Claim::new(&[MotorKey::Resistance], Weight::Remark, reason);
    claim.keys.push(VOLTAGE_DROP);
    Some(claim)
}

fn of_current(run: &Run, keys: &[MotorKey]) -> Option<Claim> {
    let (weight, reason) = match run.origin(Channel::Current) {
        _ if run.side(Channel::Current) == Some(Side::Supply) && !full_duty(run) => (
            Weight::Wrong,
            "current_a is the current of the supply, not of the armature: below full duty the motor carries more",
        ),
        Origin::Commanded => (
            Weight::Dependent,
            "current_a is commanded, not measured: the drive's current loop and its limits stand between",
        ),
        Origin::Estimated => (
            Weight::Dependent,
            "current_a is the drive's own estimate, so the value rests on the drive's model of the motor",
        ),
        Origin::Measured | Origin::Derived | Origin::Unknown => return None,
    };
    Some(Claim::new(keys, weight, reason))
}

fn of_torque(run: &Run) -> Option<Claim> {
    let how = match run.origin(Channel::Torque) {
        Origin::Estimated => {
            "the drive's own estimate, current times the torque constant it is set to"
        }
        Origin::Commanded => "commanded, in the torque constant that the drive is set to",
        Origin::Measured | Origin::Derived | Origin::Unknown => return None,
    };
    let reason = format!(
        "torque_n_m is {how}: inertia and load torque share that scale (their ratio does not)"
    );
    Some(Claim::new(&MECHANICAL, Weight::Dependent, reason))
}

fn of_speed(run: &Run, input: Input) -> Option<Claim> {
    let (keys, weight, reason): (&[MotorKey], _, _) = match run.origin(Channel::Speed) {
        Origin::Estimated if input == Input::Voltage => (
            &OF_BACK_EMF,
            Weight::Dependent,
            "speed_rad_s is the drive's own estimate, computed with the back-EMF constant that the drive is set to: the \
             value is not independent of that setting",
        ),
        Origin::Estimated => (
            &MECHANICAL,
            Weight::Dependent,
            "speed_rad_s is the drive's own estimate: its filter and its settings are in the value",
        ),
        Origin::Commanded => (
            &OF_BACK_EMF,
            Weight::Wrong,
            "speed_rad_s is commanded, not measured: what the shaft did is not known",
        ),
        Origin::Measured | Origin::Derived | Origin::Unknown => return None,
    };
    Some(Claim::new(keys, weight, reason))
}

/// Whether the bus stands at the terminals whenever the motor is energised.
fn full_duty(run: &Run) -> bool {
    let (Some(bus), Some(voltage)) = (run.column(Channel::Bus), run.column(Channel::Voltage))
    else {
        return false;
    };
    if run.side(Channel::Voltage) == Some(Side::Supply) {
        return false;
    }
    let largest = largest(voltage);
    let energised: Vec<bool> = bus
        .iter()
        .zip(voltage)
        .filter(|(bus, u)| bus.is_finite() && u.abs() > ENERGISED * largest)
        .map(|(bus, u)| u.abs() > FULL_DUTY * bus)
        .collect();
    let full = energised.iter().filter(|full| **full).count();
    energised.len() >= FEWEST_ROWS && full as f64 >= NEARLY_ALWAYS * energised.len() as f64
}

/// Whether a voltage measured at the terminals shows the command, so that nothing of it is lost in the drive.
fn measured_agrees(run: &Run, command: Channel) -> bool {
    let terminal = run.side(Channel::Voltage) != Some(Side::Supply);
    if command == Channel::Voltage || run.origin(Channel::Voltage) != Origin::Measured || !terminal
    {
        return false;
    }
    let commands: Vec<(f64, f64)> = run.points(command).collect();
    let largest = commands.iter().fold(0.0_f64, |most, c| most.max(c.1.abs()));
    let differences: Vec<f64> = run
        .points(Channel::Voltage)
        .filter_map(|(time_s, measured)| {
            let held = signal::held(&commands, time_s)?;
            // In the direction of the voltage: a drop lessens its size.
            (held.abs() > ENERGISED * largest).then(|| (held - measured) * held.signum())
        })
        .collect();
    let lost = median(&differences);
    differences.len() >= FEWEST_ROWS && lost.abs() < AGREES * largest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;
    use crate::verdict::judge;
    use drivebench_model::plant::Slot;

    #[test]
    fn what_no_run_tells_without_a_current_is_not_called_not_excited() {
        let mut run = run(Origin::Measured);
        let said = |run: &Run, verdict: Verdict| {
            let keys = [MotorKey::Resistance, MotorKey::BackEmf, MotorKey::Inertia];
            let reason = "the run does not excite it";
            let mut found =
                keys.map(|key| ParameterEstimate::not_observable(key.key(), key.unit(), reason));
            found[0].verdict = verdict;
            limit(&mut found, run, &Scenario::from_run(run).unwrap());
            found.map(|parameter| parameter.reason.unwrap())
        };
        let open = Verdict::NotObservable;
        let all = said(&run, open);
        assert!(all.iter().all(|reason| reason.contains("does not excite")));
        put(&mut run, Channel::Current, vec![f64::NAN; ROWS]);
        let [resistance, back_emf, inertia] = said(&run, open);
        assert!(resistance.contains("R J and R Mc"), "{resistance}");
        assert_eq!(inertia, resistance);
        assert!(back_emf.contains("does not excite"));
        // One that is given tells the others, where they are excited.
        assert!(said(&run, Verdict::Fixed)[2].contains("does not excite"));
    }

    const ROWS: usize = 100;

    /// Voltage (and its measurement), current and speed; what they hold does not matter to a claim.
    fn run(origin: Origin) -> Run {
        let square = |size: f64| -> Vec<f64> {
            let level = |k: usize| {
                if (k / 25).is_multiple_of(2) {
                    size
                } else {
                    -size
                }
            };
            (0..ROWS).map(level).collect()
        };
        let columns = [
            (Channel::Voltage, square(24.0)),
            (Channel::Current, square(2.0)),
            (Channel::Speed, square(50.0)),
        ];
        let mut run = run_of(every(0.01, 1.0), columns);
        run.set_origin(Channel::Voltage, origin);
        run
    }

    fn settled() -> Vec<ParameterEstimate> {
        let settled = |key: MotorKey| judge(&Slot::Motor(key), 1.0, Some(0.001), 0.01);
        KEYS.map(settled).to_vec()
    }

    /// Verdicts of R, L, Ke, J, Mc, and the notes.
    fn limited(run: &Run) -> (Vec<ParameterEstimate>, Vec<String>) {
        let mut parameters = settled();
        let notes = limit(&mut parameters, run, &Scenario::from_run(run).unwrap());
        (parameters, notes)
    }

    fn verdicts(parameters: &[ParameterEstimate]) -> Vec<Verdict> {
        parameters.iter().map(|p| p.verdict).collect()
    }

    #[test]
    fn measured_at_the_terminals_everything_may_be_claimed() {
        for origin in [Origin::Measured, Origin::Unknown] {
            let (parameters, notes) = limited(&run(origin));
            assert_eq!(parameters, settled());
            assert!(notes.is_empty(), "{notes:?}");
        }
    }

    #[test]
    fn a_commanded_voltage_puts_the_drives_drops_into_the_resistance() {
        let (parameters, notes) = limited(&run(Origin::Commanded));
        assert_eq!(verdicts(&parameters), [Verdict::Settled; 5]);
        let reason = parameters[0].reason.as_deref().unwrap();
        assert!(reason.contains("drive's own drops"), "{reason}");
        assert!(parameters[1..].iter().all(|p| p.reason.is_none()));
        assert_eq!(notes.len(), 1);
    }

    #[test]
    fn a_measurement_that_agrees_clears_the_command_and_one_with_a_drop_does_not() {
        for (drop_v, clear) in [(0.0, true), (1.5, false)] {
            let mut run = run(Origin::Measured);
            let measured: Vec<f64> = run.column(Channel::Voltage).unwrap().to_vec();
            let command = measured.iter().map(|u| u + drop_v * u.signum()).collect();
            run.set_column(Channel::VoltageCmd, command, Origin::Commanded)
                .unwrap();
            let (_, notes) = limited(&run);
            assert_eq!(notes.is_empty(), clear, "{drop_v}: {notes:?}");
        }
    }

    #[test]
    fn a_supply_current_gives_no_parameter_but_at_full_duty() {
        let mut supply = run(Origin::Measured);
        supply.set_side(Channel::Current, Side::Supply);
        let (parameters, notes) = limited(&supply);
        assert_eq!(verdicts(&parameters), [Verdict::Invalid; 5]);
        assert!(parameters.iter().all(|p| p.value == Some(1.0)));
        assert!(notes[0].contains("supply"), "{notes:?}");
        put(&mut supply, Channel::Bus, vec![24.2; ROWS]);
        assert_eq!(verdicts(&limited(&supply).0), [Verdict::Settled; 5]);
        put(&mut supply, Channel::Bus, vec![48.0; ROWS]);
        assert_eq!(verdicts(&limited(&supply).0), [Verdict::Invalid; 5]);
    }

    #[test]
    fn a_supply_voltage_is_not_the_motors() {
        let mut supply = run(Origin::Measured);
        supply.set_side(Channel::Voltage, Side::Supply);
        assert_eq!(verdicts(&limited(&supply).0), [Verdict::Invalid; 5]);
    }

    #[test]
    fn what_the_drive_computes_is_not_independent() {
        use Verdict::{Searching, Settled};
        let mut observed = run(Origin::Measured);
        observed.set_origin(Channel::Speed, Origin::Estimated);
        let (parameters, notes) = limited(&observed);
        let expected = [Settled, Settled, Searching, Searching, Searching];
        assert_eq!(verdicts(&parameters), expected);
        assert!(notes[0].contains("not independent"), "{notes:?}");

        let columns = [Channel::Torque, Channel::Speed].map(|channel| (channel, vec![1.0; ROWS]));
        let mut torque = run_of(every(0.01, 1.0), columns);
        torque.set_origin(Channel::Torque, Origin::Estimated);
        let (parameters, _) = limited(&torque);
        let expected = [Settled, Settled, Settled, Searching, Searching];
        assert_eq!(verdicts(&parameters), expected);
    }

    #[test]
    fn verdicts_only_go_down_and_given_values_stay() {
        let mut supply = run(Origin::Measured);
        supply.set_side(Channel::Current, Side::Supply);
        let mut parameters = settled();
        parameters[0].verdict = Verdict::Fixed;
        parameters[1] = ParameterEstimate::not_observable("inductance_h", "H", "too slow");
        let before = parameters.clone();
        let scenario = Scenario::from_run(&supply).unwrap();
        limit(&mut parameters, &supply, &scenario);
        assert_eq!(parameters[..2], before[..2]);
        assert_eq!(parameters[2].verdict, Verdict::Invalid);
    }
}

//! Limits of verdicts by the origin of the signals: measured, commanded or computed by the drive, at the motor or at the supply.
//!
//! A commanded voltage and a supply current are not those of the armature, and a quantity that a drive computes from its settings
//! is not independent of them. The values stay; verdicts and reasons change.

use super::stamps;
use super::verdict::refuse;
use drivebench_model::numerics::statistics::{largest, median};
use drivebench_model::plant::effect::VOLTAGE_DROP;
use drivebench_model::plant::{Input, MotorKey, Scenario};
use drivebench_model::sample::{Channel, Origin, ParameterEstimate, Reason, Run, Side, Verdict};
use drivebench_model::signal;

/// Whether a voltage is more than 2 % of the largest: the motor is energised.
fn is_energised(voltage_v: f64, largest_v: f64) -> bool {
    voltage_v.abs() > 0.02 * largest_v
}

/// Limits the verdicts to what the origins of the signals allow; returns the reasons.
pub fn limit(parameters: &mut [ParameterEstimate], run: &Run, scenario: &Scenario) -> Vec<String> {
    if let Some(half_width_s) = scenario.typical_half_width_s() {
        stamps::refuse(parameters, half_width_s);
    }
    without_current(parameters, scenario);
    let mut notes = Vec::new();
    for claim in claims(run, scenario) {
        let is_limited = |p: &&mut ParameterEstimate| claim.keys.contains(&p.key.as_str());
        let mut has_value = false;
        for parameter in parameters.iter_mut().filter(is_limited) {
            claim.apply(parameter);
            has_value |= parameter.value.is_some();
        }
        notes.extend(has_value.then_some(claim.reason));
    }
    notes
}

/// Structural identifiability (Ljung 1999, section 4.6) without a current: the equations of voltage and speed contain only L/R,
/// R J/(Ke Kt) and R Mc/Kt, so that no excitation separates resistance, inductance, inertia and torques. Unless one of them is
/// given none has a value, of the motor or of an effect.
pub fn without_current(parameters: &mut [ParameterEstimate], scenario: &Scenario) {
    if !lacks_current(scenario) {
        return;
    }
    let back_emf = MotorKey::BackEmf.key();
    for parameter in parameters.iter_mut().filter(|parameter| parameter.key == back_emf) {
        let reason = "without a current it includes viscous friction: it is Ke + R B/Kt";
        parameter.unsettle(Reason::SignalMissing, reason);
    }
    if !has_no_scale(parameters, scenario) {
        return;
    }
    let is_estimated =
        |own: &&mut ParameterEstimate| is_tied(own.unit) && own.verdict != Verdict::Fixed;
    for parameter in parameters.iter_mut().filter(is_estimated) {
        let reason = "without a current no run separates resistance, inductance, inertia and load torque: voltage and speed determine \
                      only L/R, R J and R Mc; measure the current, or fix one of them in the model file";
        refuse(parameter, Reason::SignalMissing, reason);
    }
}

/// Whether the run has no current, and no resistance, inductance, inertia or torque is given, of the motor or of an effect.
pub fn has_no_scale(parameters: &[ParameterEstimate], scenario: &Scenario) -> bool {
    let is_given = |own: &ParameterEstimate| {
        is_tied(own.unit) && own.verdict == Verdict::Fixed && own.value != Some(0.0)
    };
    lacks_current(scenario) && !parameters.iter().any(is_given)
}

/// Whether a voltage drives the run and no current was measured.
pub fn lacks_current(scenario: &Scenario) -> bool {
    let has_current = scenario.current_a.iter().any(|current| current.is_finite());
    scenario.input == Input::Voltage && !has_current
}

/// Whether figures in this unit have no value where [`has_no_scale`].
pub fn is_tied(unit: &str) -> bool {
    match unit {
        "ohm" | "H" | "kg.m2" | "A" | "1/A2" | "1/(A2.s)" => true,
        "N.m/A" => false,
        unit => unit.starts_with("N.m"),
    }
}

/// Consequence for a value.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Weight {
    /// A reason is added.
    Remark,
    /// It is not settled.
    Dependent,
    /// It is not a value of the motor: invalid.
    Wrong,
}

struct Claim {
    keys: Vec<&'static str>,
    weight: Weight,
    reason: String,
}

impl Claim {
    fn new(keys: &[MotorKey], weight: Weight, reason: impl Into<String>) -> Self {
        Self { keys: keys.iter().map(|key| key.key()).collect(), weight, reason: reason.into() }
    }

    /// Changes a verdict only downward: settled, searching, invalid. A parameter without a value, or a given one, stays.
    fn apply(&self, parameter: &mut ParameterEstimate) {
        match self.weight {
            Weight::Remark => {
                if parameter.value.is_some() && parameter.verdict != Verdict::Fixed {
                    parameter.code.get_or_insert(Reason::SignalOrigin);
                    parameter.reason.get_or_insert_with(|| self.reason.clone());
                }
            }
            Weight::Dependent => parameter.unsettle(Reason::SignalOrigin, &*self.reason),
            Weight::Wrong => {
                if matches!(parameter.verdict, Verdict::Settled | Verdict::Searching) {
                    parameter.set(Verdict::Invalid, Reason::SignalOrigin, &*self.reason);
                }
            }
        }
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
/// With Kt equal to Ke, an error of Ke is one of every torque.
pub(super) const OF_BACK_EMF: [MotorKey; 4] =
    [MotorKey::BackEmf, MotorKey::TorqueConstant, MotorKey::Inertia, MotorKey::LoadTorque];

fn of_voltage(run: &Run, channel: Channel) -> Option<Claim> {
    let key = channel.key();
    if run.side(channel) == Some(Side::Supply) && !full_duty(run) {
        let reason = format!(
            "{key} is the voltage of the supply, not of the motor: they differ by the duty cycle"
        );
        return Some(Claim::new(&MotorKey::ALL, Weight::Wrong, reason));
    }
    let reason = match run.origin(channel) {
        Origin::Estimated => format!(
            "the resistance includes the drops of the drive's switches that its estimate of {key} neglects"
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
            "current_a is commanded, not measured: the current loop of the drive and its limits make a difference",
        ),
        Origin::Estimated => (
            Weight::Dependent,
            "current_a is the drive's own estimate, so the value depends on the drive's model of the motor",
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
            "speed_rad_s is the drive's own estimate: the value depends on its filter and its settings",
        ),
        Origin::Commanded => (
            &OF_BACK_EMF,
            Weight::Wrong,
            "speed_rad_s is commanded, not measured: the speed of the shaft is not known",
        ),
        Origin::Measured | Origin::Derived | Origin::Unknown => return None,
    };
    Some(Claim::new(keys, weight, reason))
}

/// Whether the terminals have the bus voltage whenever the motor is energised.
fn full_duty(run: &Run) -> bool {
    let terminal = run.side(Channel::Voltage) != Some(Side::Supply);
    let voltage = run.column(Channel::Voltage).filter(|_| terminal);
    let Some((bus, voltage)) = run.column(Channel::Bus).zip(voltage) else { return false };
    let largest = largest(voltage);
    let rows = bus.iter().zip(voltage);
    let energised = rows.filter(|(bus, u)| bus.is_finite() && is_energised(**u, largest));
    let full = energised.clone().filter(|(bus, u)| u.abs() > 0.97 * **bus);
    let (full, count) = (full.count(), energised.count());
    count >= 20 && full as f64 >= 0.99 * count as f64
}

/// Whether a voltage measured at the terminals agrees with the command, so that the drive has no drop.
fn measured_agrees(run: &Run, command: Channel) -> bool {
    let terminal = run.side(Channel::Voltage) != Some(Side::Supply);
    if command == Channel::Voltage || run.origin(Channel::Voltage) != Origin::Measured || !terminal
    {
        return false;
    }
    let commands: Vec<(f64, f64)> = run.points(command).collect();
    let largest = largest(commands.iter().map(|command| command.1));
    let difference = |(time_s, measured): (f64, f64)| {
        let command = signal::held(&commands, time_s)?;
        // A drop reduces the magnitude of the voltage.
        is_energised(command, largest).then(|| (command - measured) * command.signum())
    };
    let differences: Vec<f64> = run.points(Channel::Voltage).filter_map(difference).collect();
    let drop = median(&differences);
    differences.len() >= 20 && drop.abs() < 0.01 * largest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;
    use crate::verdict::{judge, unknown};
    use drivebench_model::plant::Slot;

    /// Voltage, current and speed in 100 rows; their values do not matter.
    fn run(origin: Origin) -> Run {
        let square = |size: f64| (0..100).map(|k: usize| [size, -size][k / 25 % 2]).collect();
        let columns = [
            (Channel::Voltage, square(24.0)),
            (Channel::Current, square(2.0)),
            (Channel::Speed, square(50.0)),
        ];
        let mut run = run_of(every(0.01, 1.0), columns);
        run.set_origin(Channel::Voltage, origin);
        run
    }

    fn of_supply(channel: Channel) -> Run {
        let mut supply = run(Origin::Measured);
        supply.set_side(channel, Side::Supply);
        supply
    }

    fn settled() -> Vec<ParameterEstimate> {
        let settled = |key: MotorKey| judge(&Slot::Motor(key), 1.0, Some(0.001), 0.01);
        KEYS.map(settled).to_vec()
    }

    /// R, L, Ke, J, Mc, and the notes.
    fn limited(run: &Run) -> (Vec<ParameterEstimate>, Vec<String>) {
        let mut parameters = settled();
        let notes = limit(&mut parameters, run, &Scenario::from_run(run).unwrap());
        (parameters, notes)
    }

    #[test]
    fn verdicts_and_notes_follow_the_origins() {
        use Verdict::{Invalid, Searching, Settled};
        let (all, none) = ([Settled; 5], [Invalid; 5]);
        let estimated = |mut run: Run, channel| {
            run.set_origin(channel, Origin::Estimated);
            run
        };
        let with_bus = |bus_v: f64| {
            let mut run = of_supply(Channel::Current);
            put(&mut run, Channel::Bus, vec![bus_v; 100]);
            run
        };
        let with_drop = |drop_v: f64| {
            let mut run = run(Origin::Measured);
            let measured = run.column(Channel::Voltage).unwrap().iter();
            let command = measured.map(|u| u + drop_v * u.signum()).collect();
            run.set_column(Channel::VoltageCmd, command, Origin::Commanded).unwrap();
            run
        };
        let columns = [Channel::Torque, Channel::Speed].map(|name| (name, vec![1.0; 100]));
        let torque = estimated(run_of(every(0.01, 1.0), columns), Channel::Torque);
        let speed = estimated(run(Origin::Measured), Channel::Speed);
        let of_speed = [Settled, Settled, Searching, Searching, Searching];
        let of_torque = [Settled, Settled, Settled, Searching, Searching];
        for (name, run, verdicts, note) in [
            ("measured", run(Origin::Measured), all, ""),
            ("unknown", run(Origin::Unknown), all, ""),
            ("commanded", run(Origin::Commanded), all, "own drops"),
            ("measured without a drop", with_drop(0.0), all, ""),
            ("measured with a drop", with_drop(1.5), all, "own drops"),
            ("supply", of_supply(Channel::Current), none, "supply"),
            ("full duty", with_bus(24.2), all, ""),
            ("half duty", with_bus(48.0), none, "supply"),
            ("supply", of_supply(Channel::Voltage), none, "supply"),
            ("speed", speed, of_speed, "not independent"),
            ("torque", torque, of_torque, "torque constant it is"),
        ] {
            let (parameters, notes) = limited(&run);
            let found: Vec<Verdict> = parameters.iter().map(|p| p.verdict).collect();
            assert_eq!(found, verdicts, "{name}: {notes:?}");
            assert!(parameters.iter().all(|p| p.value == Some(1.0)), "{name}");
            assert_eq!(notes.len(), usize::from(!note.is_empty()), "{name}: {notes:?}");
            assert!(notes.iter().all(|own| own.contains(note)), "{name}: {notes:?}");
        }
        let (parameters, _) = limited(&run(Origin::Commanded));
        assert_says(&parameters[0], &["drive's own drops"]);
        assert_eq!(parameters[1..], settled()[1..]);
    }

    #[test]
    fn verdicts_only_go_down_and_given_values_stay() {
        let supply = of_supply(Channel::Current);
        let mut parameters = settled();
        parameters[0].verdict = Verdict::Fixed;
        parameters[1] = unknown(MotorKey::Inductance, Reason::SampledTooSlowly, "too slow");
        let before = parameters.clone();
        limit(&mut parameters, &supply, &Scenario::from_run(&supply).unwrap());
        assert_eq!(parameters[..2], before[..2]);
        assert_eq!(parameters[2].verdict, Verdict::Invalid);
    }

    #[test]
    fn without_a_current_no_excitation_gives_the_scale() {
        let mut run = run(Origin::Measured);
        let reasons = |run: &Run, verdict: Verdict| {
            let keys = [MotorKey::Resistance, MotorKey::BackEmf, MotorKey::Inertia];
            let reason = "the run does not excite it";
            let mut found = keys.map(|key| unknown(key, Reason::NotExcited, reason));
            found[0].verdict = verdict;
            limit(&mut found, run, &Scenario::from_run(run).unwrap());
            found.map(|parameter| parameter.reason.unwrap())
        };
        let open = Verdict::NotObservable;
        assert!(reasons(&run, open).iter().all(|reason| reason.contains("does not excite")));
        put(&mut run, Channel::Current, vec![f64::NAN; 100]);
        let [resistance, back_emf, inertia] = reasons(&run, open);
        assert!(resistance.contains("R J and R Mc"), "{resistance}");
        assert_eq!(inertia, resistance);
        assert!(back_emf.contains("does not excite"));
        // One that is given determines the others, where they are excited.
        assert!(reasons(&run, Verdict::Fixed)[2].contains("does not excite"));
    }
}

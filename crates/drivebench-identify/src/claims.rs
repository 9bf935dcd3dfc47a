//! Claims that a run supports, given where its signals come from.
//!
//! A commanded voltage is not the armature's, a supply current is not the armature's, and what a drive computes from its own
//! settings only repeats them. A value keeps its figure; its verdict and reason limit what it stands for.

use super::stamps;
use super::verdict::refuse;
use drivebench_model::numerics::statistics::{largest, median};
use drivebench_model::plant::effect::VOLTAGE_DROP;
use drivebench_model::plant::{Input, MotorKey, Scenario};
use drivebench_model::sample::{Channel, Origin, ParameterEstimate, Run, Side, Verdict};
use drivebench_model::signal;

/// Share of the largest voltage from which a row counts as energised, and the fewest such rows that show anything.
const ENERGISED: f64 = 0.02;
const FEWEST_ROWS: usize = 20;

/// Limits the verdicts to what the origins of the signals allow; returns the reasons.
pub fn limit(parameters: &mut [ParameterEstimate], run: &Run, scenario: &Scenario) -> Vec<String> {
    if let Some(half_width_s) = scenario.typical_half_width_s() {
        stamps::refuse(parameters, half_width_s);
    }
    without_current(parameters, scenario);
    let mut notes = Vec::new();
    for claim in claims(run, scenario) {
        let concerned = |p: &&mut ParameterEstimate| claim.keys.contains(&p.key.as_str());
        let mut found = false;
        for parameter in parameters.iter_mut().filter(concerned) {
            claim.apply(parameter);
            found |= parameter.value.is_some();
        }
        // A claim on nothing that was found is left out.
        notes.extend(found.then_some(claim.reason));
    }
    notes
}

/// Without a current no excitation separates resistance, inductance, inertia and torques, which is another thing than a run that
/// does not excite them: only L/R, R J/(Ke Kt) and R Mc/Kt stand in the equations of voltage and speed. Where none of them is
/// given none has a value, of the motor or of an effect.
pub fn without_current(parameters: &mut [ParameterEstimate], scenario: &Scenario) {
    if !lacks_current(scenario) {
        return;
    }
    let back_emf = MotorKey::BackEmf.key();
    for own in parameters.iter_mut().filter(|own| own.key == back_emf) {
        let reason = "without a current it includes viscous friction: it is Ke + R B/Kt";
        own.unsettle(reason);
    }
    if !has_no_scale(parameters, scenario) {
        return;
    }
    let is_found =
        |own: &&mut ParameterEstimate| is_tied(own.unit) && own.verdict != Verdict::Fixed;
    for own in parameters.iter_mut().filter(is_found) {
        let reason = "without a current no run tells resistance, inductance, inertia and load torque apart: voltage and speed hold \
                      only L/R, R J and R Mc; measure the current, or fix one of them in the model file";
        refuse(own, reason);
    }
}

/// Whether the run has no current, and no resistance, inductance, inertia or torque is given that would take its place.
pub fn has_no_scale(parameters: &[ParameterEstimate], scenario: &Scenario) -> bool {
    let is_given = |own: &ParameterEstimate| {
        let is_of_motor = MotorKey::from_key(&own.key).is_some();
        is_of_motor && is_tied(own.unit) && own.verdict == Verdict::Fixed
    };
    lacks_current(scenario) && !parameters.iter().any(is_given)
}

fn lacks_current(scenario: &Scenario) -> bool {
    let has_current = scenario.current_a.iter().any(|current| current.is_finite());
    scenario.input == Input::Voltage && !has_current
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
        Self { keys: keys.iter().map(|key| key.key()).collect(), weight, reason: reason.into() }
    }

    /// Only ever downward: settled, searching, invalid. What has no value, or is given, stays as it is.
    fn apply(&self, parameter: &mut ParameterEstimate) {
        match self.weight {
            Weight::Remark => {
                if parameter.value.is_some() && parameter.verdict != Verdict::Fixed {
                    parameter.reason.get_or_insert_with(|| self.reason.clone());
                }
            }
            Weight::Dependent => parameter.unsettle(&*self.reason),
            Weight::Wrong => {
                if matches!(parameter.verdict, Verdict::Settled | Verdict::Searching) {
                    parameter.verdict = Verdict::Invalid;
                    parameter.reason = Some(self.reason.clone());
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
/// With Kt taken equal to Ke, what is wrong in Ke is wrong in every torque.
pub(super) const OF_BACK_EMF: [MotorKey; 4] =
    [MotorKey::BackEmf, MotorKey::TorqueConstant, MotorKey::Inertia, MotorKey::LoadTorque];

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
    let terminal = run.side(Channel::Voltage) != Some(Side::Supply);
    let voltage = run.column(Channel::Voltage).filter(|_| terminal);
    let Some((bus, voltage)) = run.column(Channel::Bus).zip(voltage) else {
        return false;
    };
    let largest = largest(voltage);
    let rows = bus.iter().zip(voltage);
    let energised = rows.filter(|(bus, u)| bus.is_finite() && u.abs() > ENERGISED * largest);
    let full = energised.clone().filter(|(bus, u)| u.abs() > 0.97 * **bus);
    let (full, count) = (full.count(), energised.count());
    count >= FEWEST_ROWS && full as f64 >= 0.99 * count as f64
}

/// Whether a voltage measured at the terminals shows the command, so that nothing of it is lost in the drive.
fn measured_agrees(run: &Run, command: Channel) -> bool {
    let terminal = run.side(Channel::Voltage) != Some(Side::Supply);
    if command == Channel::Voltage || run.origin(Channel::Voltage) != Origin::Measured || !terminal
    {
        return false;
    }
    let commands: Vec<(f64, f64)> = run.points(command).collect();
    let largest = largest(commands.iter().map(|command| command.1));
    let differences: Vec<f64> = run
        .points(Channel::Voltage)
        .filter_map(|(time_s, measured)| {
            let held = signal::held(&commands, time_s)?;
            // In the direction of the voltage: a drop lessens its size.
            (held.abs() > ENERGISED * largest).then(|| (held - measured) * held.signum())
        })
        .collect();
    let lost = median(&differences);
    differences.len() >= FEWEST_ROWS && lost.abs() < 0.01 * largest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::*;
    use crate::verdict::judge;
    use drivebench_model::plant::Slot;

    const ROWS: usize = 100;

    /// Voltage, current and speed; what they hold does not matter to a claim.
    fn run(origin: Origin) -> Run {
        let square = |size: f64| (0..ROWS).map(|k| [size, -size][k / 25 % 2]).collect();
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
        let estimated_speed = || {
            let mut run = run(Origin::Measured);
            run.set_origin(Channel::Speed, Origin::Estimated);
            run
        };
        let with_bus = |bus_v: f64| {
            let mut run = of_supply(Channel::Current);
            put(&mut run, Channel::Bus, vec![bus_v; ROWS]);
            run
        };
        let with_drop = |drop_v: f64| {
            let mut run = run(Origin::Measured);
            let measured = run.column(Channel::Voltage).unwrap().iter();
            let command = measured.map(|u| u + drop_v * u.signum()).collect();
            run.set_column(Channel::VoltageCmd, command, Origin::Commanded).unwrap();
            run
        };
        let torque = || {
            let columns = [Channel::Torque, Channel::Speed].map(|own| (own, vec![1.0; ROWS]));
            let mut run = run_of(every(0.01, 1.0), columns);
            run.set_origin(Channel::Torque, Origin::Estimated);
            run
        };
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
            ("speed", estimated_speed(), of_speed, "not independent"),
            ("torque", torque(), of_torque, "torque constant it is"),
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
        parameters[1] = ParameterEstimate::not_observable("inductance_h", "H", "too slow");
        let before = parameters.clone();
        let scenario = Scenario::from_run(&supply).unwrap();
        limit(&mut parameters, &supply, &scenario);
        assert_eq!(parameters[..2], before[..2]);
        assert_eq!(parameters[2].verdict, Verdict::Invalid);
    }

    #[test]
    fn without_a_current_the_scale_is_open_whatever_the_excitation() {
        let mut run = run(Origin::Measured);
        let reasons = |run: &Run, verdict: Verdict| {
            let keys = [MotorKey::Resistance, MotorKey::BackEmf, MotorKey::Inertia];
            let reason = "the run does not excite it";
            let mut found =
                keys.map(|key| ParameterEstimate::not_observable(key.key(), key.unit(), reason));
            found[0].verdict = verdict;
            limit(&mut found, run, &Scenario::from_run(run).unwrap());
            found.map(|parameter| parameter.reason.unwrap())
        };
        let open = Verdict::NotObservable;
        let all = reasons(&run, open);
        assert!(all.iter().all(|reason| reason.contains("does not excite")));
        put(&mut run, Channel::Current, vec![f64::NAN; ROWS]);
        let [resistance, back_emf, inertia] = reasons(&run, open);
        assert!(resistance.contains("R J and R Mc"), "{resistance}");
        assert_eq!(inertia, resistance);
        assert!(back_emf.contains("does not excite"));
        // One that is given determines the others, where they are excited.
        assert!(reasons(&run, Verdict::Fixed)[2].contains("does not excite"));
    }
}

//! The nameplate compared with the identified motor.

use drivebench_identify::nameplate::{
    Comparison, NameplateCause, NameplateDoubt, NameplateFinding, Row, RowFinding,
};
use drivebench_model::text::number::{significant, with_std};

pub fn nameplate(found: &Comparison) -> String {
    let fits = match found.finding() {
        NameplateFinding::Doubted => found.doubt.as_ref().map_or_else(String::new, doubt),
        NameplateFinding::NotJudged => "not judged: none of its values was identified".to_owned(),
        NameplateFinding::Fits => "fits".to_owned(),
        NameplateFinding::FitsInPart => {
            let open: Vec<&str> = found.open().collect();
            format!("fits, except for values that were not identified: {}", open.join(", "))
        }
        NameplateFinding::DoesNotFit => "does NOT fit".to_owned(),
    };
    format!("nameplate {fits} (within {:.0} % and the uncertainty)", 100.0 * found.tolerance)
}

/// Reason for which differences are not attributed to the nameplate.
pub fn doubt(found: &NameplateDoubt) -> String {
    match found {
        NameplateDoubt::ModelMisses { times_noise } => format!(
            "not judged: the residual of the five-parameter model is {times_noise:.1} times the noise, and what it misses may \
             bias these values; drivebench diagnose names it"
        ),
        NameplateDoubt::NotCompared { message } => format!(
            "not judged: the five-parameter model cannot be compared with this run ({message})"
        ),
    }
}

/// One key of the nameplate with the value that was found.
pub fn row(row: &Row) -> String {
    let (name, unit) = (row.key, row.unit);
    let found = || with_std(row.found.unwrap_or(f64::NAN), row.std);
    let given = || significant(row.nameplate.unwrap_or(f64::NAN), 4);
    let finding = row.finding();
    match finding {
        RowFinding::Fits | RowFinding::Differs | RowFinding::NotJudged => {
            let times = row.ratio.map_or_else(String::new, |ratio| match ratio {
                ratio if ratio >= 2.0 => format!(": {ratio:.1} times the nameplate"),
                ratio if ratio <= 0.5 => format!(": 1/{:.1} of the nameplate", 1.0 / ratio),
                ratio => format!(": {:+.0} %", 100.0 * (ratio - 1.0)),
            });
            let misfit = if finding == RowFinding::Differs { ", does not fit" } else { "" };
            format!("{name}: found {} {unit}, nameplate {} {unit}{times}{misfit}", found(), given())
        }
        RowFinding::NotIdentified => format!(
            "{name}: nameplate {} {unit}, not identified ({})",
            given(),
            row.reason.as_deref().unwrap_or("not estimated")
        ),
        RowFinding::NotOnNameplate => {
            format!("{name}: found {} {unit}, not on the nameplate", found())
        }
    }
}

pub fn cause(cause: &NameplateCause) -> String {
    let words = match cause {
        NameplateCause::RpmForRadPerS => "speed in r/min taken for rad/s (factor 9.55)",
        NameplateCause::RadPerSForRpm => "speed in rad/s taken for r/min (factor 1/9.55)",
        NameplateCause::RadPerSForTurnsPerS => {
            "speed in rad/s taken for turns per second (factor 6.28)"
        }
        NameplateCause::TurnsPerSForRadPerS => {
            "speed in turns per second taken for rad/s (factor 1/6.28)"
        }
        NameplateCause::PulsesHalf => {
            "encoder pulses per turn set to half of the true number, or edges counted twice"
        }
        NameplateCause::LinesForEdges => {
            "encoder pulses per turn: lines given, quadrature edges counted (factor 4)"
        }
        NameplateCause::PulsesTwice => "encoder pulses per turn set to twice the true number",
        NameplateCause::EdgesForLines => {
            "encoder pulses per turn: edges given, lines counted (factor 1/4)"
        }
        NameplateCause::SpeedTenTimes => "speed scaling ten times too large",
        NameplateCause::SpeedTenth => "speed scaling ten times too small",
        NameplateCause::SpeedScale { factor } => {
            return format!(
                "speed sensor reads {factor:.2} times the true speed (pulses per turn, gain), or a gear"
            );
        }
        NameplateCause::CurrentScale { factor } => {
            return format!(
                "current sensor reads {factor:.2} times the true current (gain, unit, shunt)"
            );
        }
        NameplateCause::VoltageScale { factor } => {
            return format!(
                "voltage is {factor:.2} times that at the motor (scaling of the command, supply)"
            );
        }
        NameplateCause::WarmWinding { kelvin } => {
            return format!(
                "winding temperature: copper gains 39 % per 100 K, this is {kelvin:.0} K; or leads and brushes"
            );
        }
        NameplateCause::Contacts => "resistance of leads, brushes or contacts; or another winding",
        NameplateCause::OtherWinding => {
            "another winding, or a resistance on the nameplate that includes more than the armature"
        }
        NameplateCause::LoadInertia => {
            "a load on the shaft (or none), or a nameplate that gives the rotor alone"
        }
        NameplateCause::Friction => {
            "friction of load, bearings or brake differs from the nameplate"
        }
        NameplateCause::Saturation => {
            "saturation, another method of measuring the inductance, or another winding"
        }
        NameplateCause::LoadOnShaft => {
            "the load on the shaft: winding and back-EMF fit the nameplate"
        }
        NameplateCause::AnotherMotor => {
            "another motor than the one on the nameplate: no single sensor factor explains the differences"
        }
    };
    words.to_owned()
}

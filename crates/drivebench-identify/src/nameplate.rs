//! Comparison of the identified motor with its nameplate, and possible causes of the differences.
//!
//! ```text
//! nameplate, estimates --> rows (fits | differs | open) --> causes: unit of the speed, pulses, sensor gain,
//!                                                                   temperature, load, another motor
//! ```

use std::f64::consts::PI;

use serde::Serialize;

use drivebench_model::plant::{Motor, MotorKey};
use drivebench_model::sample::ParameterEstimate;
use drivebench_model::text::number::{significant, with_std};

/// Relative tolerance of catalogues, load and temperature of the winding included.
const CATALOGUE_TOLERANCE: f64 = 0.3;
/// End of the sentence of a value that differs.
const MISFIT: &str = ", does not fit";

/// The parameters of a nameplate, in the order of its rows.
pub(super) const KEYS: [MotorKey; 5] = [
    MotorKey::Resistance,
    MotorKey::Inductance,
    MotorKey::BackEmf,
    MotorKey::Inertia,
    MotorKey::LoadTorque,
];

/// Whether one value fits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fits {
    Yes,
    No,
    /// Not observable, or not on the nameplate.
    NotTold,
}

/// One key of the nameplate with its estimate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    pub key: &'static str,
    pub unit: &'static str,
    pub nameplate: Option<f64>,
    pub found: Option<f64>,
    pub std: Option<f64>,
    /// Found over nameplate.
    pub ratio: Option<f64>,
    pub fits: Fits,
    pub sentence: String,
}

/// The whole nameplate.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// No observable value differs.
    pub fits: bool,
    /// Relative tolerance in addition to the uncertainty.
    pub tolerance: f64,
    pub rows: Vec<Row>,
    /// Possible causes of the differences.
    pub causes: Vec<String>,
    /// Reason for which differences are not attributed to the nameplate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub doubt: Option<String>,
}

impl Comparison {
    /// Sentences of the values that do not fit.
    pub fn differences(&self) -> impl Iterator<Item = &str> {
        let differing = self.rows.iter().filter(|row| row.fits == Fits::No);
        differing.map(|row| row.sentence.as_str())
    }

    /// Withdraws the differences: the estimates may be biased by an effect that the model lacks.
    pub fn doubt(&mut self, reason: String) {
        for row in self.rows.iter_mut().filter(|row| row.fits == Fits::No) {
            row.fits = Fits::NotTold;
            row.sentence = row.sentence.replace(MISFIT, "");
        }
        self.fits = true;
        self.causes.clear();
        self.doubt = Some(reason);
    }

    /// Whether it fits.
    pub fn verdict(&self) -> String {
        let judged = self.rows.iter().any(|row| row.fits != Fits::NotTold);
        let open: Vec<&str> = self
            .rows
            .iter()
            .filter(|row| row.fits == Fits::NotTold && row.nameplate.is_some())
            .map(|row| row.key)
            .collect();
        let fits_in_part =
            format!("fits, except for values that were not identified: {}", open.join(", "));
        format!(
            "nameplate {} (within {:.0} % and the uncertainty)",
            match (&self.doubt, judged, self.fits) {
                (Some(doubt), ..) => doubt,
                (None, false, _) => "not judged: none of its values was identified",
                (None, true, true) if open.is_empty() => "fits",
                (None, true, true) => &fits_in_part,
                (None, true, false) => "does NOT fit",
            },
            100.0 * self.tolerance
        )
    }
}

/// Compares the values of the nameplate with the estimates; a key that neither has is left out.
pub fn compare(nameplate: &Motor, found: &[ParameterEstimate]) -> Comparison {
    let rows: Vec<Row> =
        KEYS.into_iter().filter_map(|key| row(key, nameplate.get(key), found)).collect();
    let fits = rows.iter().all(|row| row.fits != Fits::No);
    let causes = if fits { Vec::new() } else { causes(&rows) };
    Comparison { fits, tolerance: CATALOGUE_TOLERANCE, rows, causes, doubt: None }
}

fn row(key: MotorKey, nameplate: Option<f64>, found: &[ParameterEstimate]) -> Option<Row> {
    let estimate = ParameterEstimate::find(found, key.key());
    let (value, std) = estimate.and_then(ParameterEstimate::carried).unzip();
    let std = std.flatten();
    if nameplate.is_none() && value.is_none() {
        return None;
    }
    let unit = key.unit();
    let ratio =
        nameplate.filter(|plate| *plate > 0.0).zip(value).map(|(plate, value)| value / plate);
    let fits = match (nameplate, value) {
        (Some(plate), Some(value)) => {
            let margin = 2.0 * std.unwrap_or(0.0);
            let most = 1.0 + CATALOGUE_TOLERANCE;
            let differs = value + margin < plate / most || value - margin > plate * most;
            if differs { Fits::No } else { Fits::Yes }
        }
        _ => Fits::NotTold,
    };
    let name = key.key();
    let sentence = match (nameplate, value) {
        (Some(plate), Some(value)) => {
            let times = ratio.map_or_else(String::new, |ratio| match ratio {
                ratio if ratio >= 2.0 => format!(": {ratio:.1} times the nameplate"),
                ratio if ratio <= 0.5 => format!(": 1/{:.1} of the nameplate", 1.0 / ratio),
                ratio => format!(": {:+.0} %", 100.0 * (ratio - 1.0)),
            });
            let misfit = if fits == Fits::No { MISFIT } else { "" };
            format!(
                "{name}: found {} {unit}, nameplate {} {unit}{times}{misfit}",
                with_std(value, std),
                significant(plate, 4)
            )
        }
        (Some(plate), None) => {
            let reason = estimate.and_then(|estimate| estimate.reason.as_deref());
            format!(
                "{name}: nameplate {} {unit}, not identified ({})",
                significant(plate, 4),
                reason.unwrap_or("not estimated")
            )
        }
        (None, value) => format!(
            "{name}: found {} {unit}, not on the nameplate",
            with_std(value.unwrap_or(f64::NAN), std)
        ),
    };
    Some(Row { key: name, unit, nameplate, found: value, std, ratio, fits, sentence })
}

/// Cause, exponents of a wrong scale factor of one sensor in R, L, Ke, J, Mc, and the index of the key whose ratio gives the factor.
/// The torque constant is that of the back-EMF, so that a wrong speed is also an error of the torques.
type Pattern = (fn(f64) -> String, [i32; 5], usize);

/// A speed measured as `c` times the true one: Ke/c, J/c^2, Mc/c. A current as `c` times: R/c, L/c, J c, Mc c.
/// A voltage as `c` times: R c, L c, Ke c, and with it J c, Mc c.
const PATTERNS: [Pattern; 3] = [
    (speed_cause, [0, 0, -1, -2, -1], 2),
    (current_cause, [-1, -1, 0, 1, 1], 0),
    (voltage_cause, [1, 1, 1, 1, 1], 2),
];

fn speed_cause(factor: f64) -> String {
    let per_minute = 60.0 / (2.0 * PI);
    let known = [
        (per_minute, "speed in r/min taken for rad/s (factor 9.55)"),
        (1.0 / per_minute, "speed in rad/s taken for r/min (factor 1/9.55)"),
        (2.0 * PI, "speed in rad/s taken for turns per second (factor 6.28)"),
        (1.0 / (2.0 * PI), "speed in turns per second taken for rad/s (factor 1/6.28)"),
        (2.0, "encoder pulses per turn set to half of the true number, or edges counted twice"),
        (4.0, "encoder pulses per turn: lines given, quadrature edges counted (factor 4)"),
        (0.5, "encoder pulses per turn set to twice the true number"),
        (0.25, "encoder pulses per turn: edges given, lines counted (factor 1/4)"),
        (10.0, "speed scaling ten times too large"),
        (0.1, "speed scaling ten times too small"),
    ];
    let is_known = |known: &&(f64, &str)| (factor / known.0).ln().abs() < 0.15;
    match known.iter().find(is_known) {
        Some((_, text)) => (*text).to_owned(),
        None => format!(
            "speed sensor reads {factor:.2} times the true speed (pulses per turn, gain), or a gear"
        ),
    }
}

fn current_cause(factor: f64) -> String {
    format!("current sensor reads {factor:.2} times the true current (gain, unit, shunt)")
}

fn voltage_cause(factor: f64) -> String {
    format!("voltage is {factor:.2} times that at the motor (scaling of the command, supply)")
}

fn causes(rows: &[Row]) -> Vec<String> {
    let ratio = |key: MotorKey| rows.iter().find(|row| row.key == key.key())?.ratio;
    let misfits = || rows.iter().filter(|row| row.fits == Fits::No);
    let differs = |key: MotorKey| misfits().any(|row| row.key == key.key());
    let count = misfits().count();
    let causes: Vec<String> =
        PATTERNS.iter().filter_map(|pattern| explained(pattern, &ratio)).collect();
    if !causes.is_empty() {
        return causes;
    }
    let cause = if count == 1 && differs(MotorKey::Resistance) {
        let rise_k = ratio(MotorKey::Resistance).map_or(0.0, |ratio| (ratio - 1.0) / 0.0039);
        // No winding is more than 130 K warmer than that of the nameplate.
        if (0.0..=130.0).contains(&rise_k) {
            return vec![format!(
                "winding temperature: copper gains 39 % per 100 K, this is {rise_k:.0} K; or leads and brushes"
            )];
        }
        if rise_k > 130.0 {
            "resistance of leads, brushes or contacts; or another winding"
        } else {
            "another winding, or a resistance on the nameplate that includes more than the armature"
        }
    } else if count == 1 && differs(MotorKey::Inertia) {
        "a load on the shaft (or none), or a nameplate that gives the rotor alone"
    } else if count == 1 && differs(MotorKey::LoadTorque) {
        "friction of load, bearings or brake differs from the nameplate"
    } else if count == 1 && differs(MotorKey::Inductance) {
        "saturation, another method of measuring the inductance, or another winding"
    } else if !KEYS[..3].iter().any(|key| differs(*key)) {
        "the load on the shaft: winding and back-EMF fit the nameplate"
    } else {
        "another motor than the one on the nameplate: no single sensor factor explains the differences"
    };
    vec![cause.to_owned()]
}

/// The cause of a pattern, if one factor explains all known ratios within the tolerance of catalogues.
fn explained(
    (cause, powers, reference): &Pattern,
    ratio: &impl Fn(MotorKey) -> Option<f64>,
) -> Option<String> {
    let tolerance = CATALOGUE_TOLERANCE.ln_1p();
    let factor = ratio(KEYS[*reference])?.powf(1.0 / f64::from(powers[*reference]));
    // A factor within the tolerance is not a cause.
    if factor.ln().abs() < tolerance {
        return None;
    }
    let mut explained = 0;
    for (key, power) in KEYS.into_iter().zip(*powers) {
        let Some(found) = ratio(key) else {
            continue;
        };
        // Friction and load are the least certain values of a nameplate.
        let is_load = key == MotorKey::LoadTorque;
        let share = if is_load { 2.0 } else { 1.0 };
        if (found.ln() - f64::from(power) * factor.ln()).abs() > share * tolerance {
            return None;
        }
        explained += usize::from(power != 0);
    }
    // The reference alone is not a pattern.
    (explained >= 2).then(|| cause(factor))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The values of the nameplate times these factors, each known to 1 %.
    fn estimates(factors: [f64; 5]) -> Vec<ParameterEstimate> {
        let nameplate = Motor::zk_22fc();
        let found = |(key, factor): (MotorKey, f64)| {
            let value = factor * nameplate.get(key).unwrap();
            ParameterEstimate::found(key.key(), key.unit(), value, 0.01 * value, None)
        };
        KEYS.into_iter().zip(factors).map(found).collect()
    }

    fn scaled(factors: [f64; 5]) -> Comparison {
        compare(&Motor::zk_22fc(), &estimates(factors))
    }

    #[test]
    fn differences_and_their_causes_follow_from_the_factors() {
        let found = scaled([1.2, 0.8, 1.05, 0.9, 1.3]);
        assert!(found.fits && found.causes.is_empty(), "{}", found.verdict());
        let found = scaled([1.34, 1.0, 1.0, 1.0, 1.0]);
        let differences: Vec<&str> = found.differences().collect();
        let has_both = differences[0].contains("1.474") && differences[0].contains("1.100");
        assert!(!found.fits && differences.len() == 1 && has_both, "{differences:?}");
        let c: f64 = 9.549;
        for (factors, cause) in [
            ([1.34, 1.0, 1.0, 1.0, 1.0], "87 K"),
            ([1.0, 1.0, 1.0 / c, 1.0 / (c * c), 1.0 / c], "r/min"),
            ([1.1, 0.9, 4.0, 16.0, 4.0], "edges given"),
            ([0.5, 0.5, 1.0, 2.0, 2.0], "current sensor reads 2.00"),
            ([3.0, 3.0, 3.0, 3.0, 3.0], "voltage is 3.00"),
            ([1.8, 0.1, 0.14, 0.0044, 0.022], "another motor"),
            ([1.0, 1.0, 1.0, 10.0, 3.0], "load on the shaft"),
            ([1.0, 1.0, 1.0, 10.0, 1.0], "a load on the shaft"),
            ([2.0, 1.0, 1.0, 1.0, 1.0], "leads"),
        ] {
            let causes = scaled(factors).causes;
            assert!(causes[0].contains(cause), "{cause}: {causes:?}");
        }
    }

    #[test]
    fn a_value_that_is_not_observable_is_not_compared() {
        let mut found = estimates([1.0; 5]);
        found[1] = ParameterEstimate::not_observable("inductance_h", "H", "period too long");
        let mut nameplate = Motor::zk_22fc();
        nameplate.clear(MotorKey::LoadTorque);
        let comparison = compare(&nameplate, &found);
        assert!(comparison.fits);
        assert_eq!(comparison.rows[1].fits, Fits::NotTold);
        assert!(comparison.rows[1].sentence.contains("period too long"));
        assert!(comparison.rows[4].sentence.contains("not on the nameplate"));
    }
}

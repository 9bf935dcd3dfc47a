//! Comparison of the identified motor with its nameplate, and possible causes of the differences.
//!
//! ```text
//! nameplate, estimates --> rows (fits | differs | open) --> causes: unit of the speed, pulses, sensor gain,
//!                                                                   temperature, load, another motor
//! ```

use std::f64::consts::TAU;

use serde::Serialize;

use super::belief::{KEYS, Range, Scaled, Settings, nearest};
use super::temperature::COPPER_PER_K;
use drivebench_model::findings;
use drivebench_model::plant::{Motor, MotorKey};
use drivebench_model::sample::ParameterEstimate;
use drivebench_model::units::rpm_from_rad_s;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fits {
    Yes,
    No,
    /// Not observable, or not on the nameplate.
    NotTold,
}

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
    /// Why the data do not carry it.
    #[serde(skip)]
    pub reason: Option<String>,
}

findings! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum RowFinding {
        Fits = "fits",
        Differs = "differs",
        /// Both values are there, and the comparison is not trusted.
        NotJudged = "not_judged",
        NotIdentified = "not_identified",
        NotOnNameplate = "not_on_nameplate",
    }
}

impl Row {
    pub const fn finding(&self) -> RowFinding {
        match (self.nameplate, self.found, self.fits) {
            (None, ..) => RowFinding::NotOnNameplate,
            (_, None, _) => RowFinding::NotIdentified,
            (.., Fits::Yes) => RowFinding::Fits,
            (.., Fits::No) => RowFinding::Differs,
            (.., Fits::NotTold) => RowFinding::NotJudged,
        }
    }
}

findings! {
    /// What would explain the differences.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub enum NameplateCause {
        RpmForRadPerS = "speed_in_rpm_taken_for_rad_s",
        RadPerSForRpm = "speed_in_rad_s_taken_for_rpm",
        RadPerSForTurnsPerS = "speed_in_rad_s_taken_for_turns_per_s",
        TurnsPerSForRadPerS = "speed_in_turns_per_s_taken_for_rad_s",
        PulsesHalf = "pulses_given_as_half",
        LinesForEdges = "lines_given_edges_counted",
        PulsesTwice = "pulses_given_as_twice",
        EdgesForLines = "edges_given_lines_counted",
        SpeedTenTimes = "speed_ten_times_too_large",
        SpeedTenth = "speed_ten_times_too_small",
        SpeedScale { factor: f64 } = "speed_scale",
        CurrentScale { factor: f64 } = "current_scale",
        VoltageScale { factor: f64 } = "voltage_scale",
        WarmWinding { kelvin: f64 } = "winding_temperature",
        Contacts = "leads_brushes_or_contacts",
        OtherWinding = "other_winding_or_resistance_of_more",
        LoadInertia = "load_on_the_shaft",
        Friction = "friction_not_as_expected",
        Saturation = "saturation_or_other_winding",
        LoadOnShaft = "only_the_load_differs",
        AnotherMotor = "another_motor",
    }
}

findings! {
    /// Why differences are no fault of the nameplate.
    #[derive(Clone, Debug, PartialEq)]
    pub enum NameplateDoubt {
        /// The five-parameter model leaves so many times the noise.
        ModelMisses { times_noise: f64 } = "model_misses_something",
        /// It cannot be held against the run, with the message.
        NotCompared { message: String } = "model_not_comparable",
    }
}

findings! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum NameplateFinding {
        Fits = "nameplate_fits",
        /// But for what was not identified.
        FitsInPart = "nameplate_fits_in_part",
        DoesNotFit = "nameplate_does_not_fit",
        NotJudged = "nameplate_not_judged",
        Doubted = "nameplate_doubted",
    }
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// No observable value differs.
    pub fits: bool,
    /// Relative tolerance in addition to the uncertainty.
    pub tolerance: f64,
    pub rows: Vec<Row>,
    #[serde(rename = "cause_codes")]
    pub causes: Vec<NameplateCause>,
    #[serde(rename = "doubt_code", skip_serializing_if = "Option::is_none")]
    pub doubt: Option<NameplateDoubt>,
}

impl Comparison {
    pub fn differences(&self) -> impl Iterator<Item = &Row> {
        self.rows.iter().filter(|row| row.fits == Fits::No)
    }

    /// Withdraws the differences: the estimates may be biased by an effect that the model lacks.
    pub fn doubt(&mut self, doubt: NameplateDoubt) {
        for row in self.rows.iter_mut().filter(|row| row.fits == Fits::No) {
            row.fits = Fits::NotTold;
        }
        self.fits = true;
        self.causes.clear();
        self.doubt = Some(doubt);
    }

    /// Keys of the plate that are not compared.
    pub fn open(&self) -> impl Iterator<Item = &'static str> {
        let open = |row: &&Row| row.fits == Fits::NotTold && row.nameplate.is_some();
        self.rows.iter().filter(open).map(|row| row.key)
    }

    pub fn finding(&self) -> NameplateFinding {
        let judged = self.rows.iter().any(|row| row.fits != Fits::NotTold);
        match (judged, self.fits) {
            _ if self.doubt.is_some() => NameplateFinding::Doubted,
            (false, _) => NameplateFinding::NotJudged,
            (true, false) => NameplateFinding::DoesNotFit,
            (true, true) if self.open().next().is_none() => NameplateFinding::Fits,
            (true, true) => NameplateFinding::FitsInPart,
        }
    }
}

/// Compares the values of the nameplate with the estimates; a key that neither has is left out.
pub fn compare(nameplate: &Motor, found: &[ParameterEstimate]) -> Comparison {
    let rows: Vec<Row> =
        KEYS.into_iter().filter_map(|key| row(key, nameplate.get(key), found)).collect();
    let fits = rows.iter().all(|row| row.fits != Fits::No);
    let causes = if fits { Vec::new() } else { causes(&rows) };
    Comparison { fits, tolerance: Settings::CATALOGUE, rows, causes, doubt: None }
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
            let most = 1.0 + Settings::CATALOGUE;
            let catalogue = Range::new(plate / most, plate * most);
            let differs = catalogue.gap(Range::around(value, margin)) > 0.0;
            if differs { Fits::No } else { Fits::Yes }
        }
        _ => Fits::NotTold,
    };
    let reason = estimate.and_then(|estimate| estimate.reason.clone());
    Some(Row { key: key.key(), unit, nameplate, found: value, std, ratio, fits, reason })
}

fn speed_cause(factor: f64) -> NameplateCause {
    let per_minute = rpm_from_rad_s(1.0);
    let known = [
        (per_minute, NameplateCause::RpmForRadPerS),
        (1.0 / per_minute, NameplateCause::RadPerSForRpm),
        (TAU, NameplateCause::RadPerSForTurnsPerS),
        (1.0 / TAU, NameplateCause::TurnsPerSForRadPerS),
        (2.0, NameplateCause::PulsesHalf),
        (4.0, NameplateCause::LinesForEdges),
        (0.5, NameplateCause::PulsesTwice),
        (0.25, NameplateCause::EdgesForLines),
        (10.0, NameplateCause::SpeedTenTimes),
        (0.1, NameplateCause::SpeedTenth),
    ];
    nearest(factor, &known, Settings::UNIT)
        .map_or(NameplateCause::SpeedScale { factor }, |(_, cause)| cause)
}

fn causes(rows: &[Row]) -> Vec<NameplateCause> {
    let ratio = |key: MotorKey| rows.iter().find(|row| row.key == key.key())?.ratio;
    let misfits = || rows.iter().filter(|row| row.fits == Fits::No);
    let differs = |key: MotorKey| misfits().any(|row| row.key == key.key());
    let only = |key: MotorKey| misfits().count() == 1 && differs(key);
    let causes: Vec<_> = Scaled::ALL.into_iter().filter_map(|own| explained(own, ratio)).collect();
    if !causes.is_empty() {
        return causes;
    }
    vec![if only(MotorKey::Resistance) {
        let kelvin = ratio(MotorKey::Resistance).map_or(0.0, |ratio| (ratio - 1.0) / COPPER_PER_K);
        // No winding is more than 130 K warmer than that of the nameplate.
        if (0.0..=130.0).contains(&kelvin) {
            NameplateCause::WarmWinding { kelvin }
        } else if kelvin > 130.0 {
            NameplateCause::Contacts
        } else {
            NameplateCause::OtherWinding
        }
    } else if only(MotorKey::Inertia) {
        NameplateCause::LoadInertia
    } else if only(MotorKey::LoadTorque) {
        NameplateCause::Friction
    } else if only(MotorKey::Inductance) {
        NameplateCause::Saturation
    } else if !KEYS[..3].iter().any(|key| differs(*key)) {
        NameplateCause::LoadOnShaft
    } else {
        NameplateCause::AnotherMotor
    }]
}

/// The cause, if one factor of a sensor explains all known ratios within the tolerance of catalogues.
fn explained(
    scaled: Scaled,
    ratio: impl Fn(MotorKey) -> Option<f64> + Copy,
) -> Option<NameplateCause> {
    let tolerance = Settings::CATALOGUE.ln_1p();
    let factor = scaled.factor(ratio)?;
    // Friction and load are the least certain values of a nameplate.
    let within = |key| if key == MotorKey::LoadTorque { 2.0 * tolerance } else { tolerance };
    // A factor within the tolerance is not a cause, and one parameter alone not a pattern.
    if factor.ln().abs() < tolerance || scaled.explains(factor, ratio, within)? < 2 {
        return None;
    }
    Some(match scaled {
        Scaled::Speed => speed_cause(factor),
        Scaled::Current => NameplateCause::CurrentScale { factor },
        Scaled::Voltage => NameplateCause::VoltageScale { factor },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verdict;
    use drivebench_model::sample::Reason;

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
        assert_eq!((found.finding(), &found.causes[..]), (NameplateFinding::Fits, &[][..]));
        let found = scaled([1.34, 1.0, 1.0, 1.0, 1.0]);
        let differences: Vec<&Row> = found.differences().collect();
        assert!(!found.fits && differences.len() == 1, "{differences:?}");
        assert_eq!(differences[0].finding(), RowFinding::Differs);
        let c: f64 = 9.549;
        for (factors, cause) in [
            ([1.34, 1.0, 1.0, 1.0, 1.0], "winding_temperature"),
            ([1.0, 1.0, 1.0 / c, 1.0 / (c * c), 1.0 / c], "speed_in_rpm_taken_for_rad_s"),
            ([1.1, 0.9, 4.0, 16.0, 4.0], "edges_given_lines_counted"),
            ([0.5, 0.5, 1.0, 2.0, 2.0], "current_scale"),
            ([3.0, 3.0, 3.0, 3.0, 3.0], "voltage_scale"),
            ([1.8, 0.1, 0.14, 0.0044, 0.022], "another_motor"),
            ([1.0, 1.0, 1.0, 10.0, 3.0], "only_the_load_differs"),
            ([1.0, 1.0, 1.0, 10.0, 1.0], "load_on_the_shaft"),
            ([2.0, 1.0, 1.0, 1.0, 1.0], "leads_brushes_or_contacts"),
        ] {
            let causes = scaled(factors).causes;
            assert_eq!(causes[0].code(), cause, "{causes:?}");
        }
    }

    #[test]
    fn a_value_that_is_not_observable_is_not_compared() {
        let mut found = estimates([1.0; 5]);
        found[1] =
            verdict::unknown(MotorKey::Inductance, Reason::SampledTooSlowly, "period too long");
        let mut nameplate = Motor::zk_22fc();
        nameplate.clear(MotorKey::LoadTorque);
        let comparison = compare(&nameplate, &found);
        assert!(comparison.fits);
        assert_eq!(comparison.rows[1].fits, Fits::NotTold);
        assert_eq!(comparison.rows[1].reason.as_deref(), Some("period too long"));
        assert_eq!(comparison.rows[1].finding(), RowFinding::NotIdentified);
        assert_eq!(comparison.rows[4].finding(), RowFinding::NotOnNameplate);
    }
}

//! Limits of what runs can show.

use drivebench_diagnose::{
    Limit, LongRun, RepeatUnknown, SearchedPart, SetAside, TrivialPrediction, Unjudged, WhyOpen,
};
use drivebench_identify::balance::Derivation;
use drivebench_model::sample::TWO_SIDED_95;
use drivebench_model::text::number::{significant, with_std};

pub fn limit(limit: &Limit) -> String {
    match limit {
        Limit::RunsSetAside(aside) => set_aside(aside),
        Limit::HoldoutStill => format!("{HOLDOUT_STILL}: no effect is named by it"),
        Limit::SignalUnjudged { signal, why } => {
            let (key, other) = match *signal {
                "current" => ("current_a", "speed"),
                _ => ("speed_rad_s", "current"),
            };
            let why = unjudged(why);
            format!(
                "the {signal} ({key}) is not used: {why}; errors, verdict and sizes depend on the {other} alone, and an effect that \
                shows only in the {signal} is not detected"
            )
        }
        Limit::PartSearched { parts, rest_confirms } => {
            let parts: Vec<String> = parts.iter().map(searched).collect();
            let rest =
                if *rest_confirms { "; the part after them is the confirming run" } else { "" };
            parts.join("; ") + rest
        }
        Limit::StampsOffset { offset_s, known_s } => {
            let side = if *offset_s < 0.0 { "before" } else { "after" };
            format!(
                "the commands act {:.2} ms {side} the stamps of the host, which are known to {:.2} ms: this is a part of every \
                 model of the runs",
                1e3 * offset_s.abs(),
                1e3 * known_s
            )
        }
        Limit::OffsetOfRun { run, offset_s } => {
            let side = if *offset_s < 0.0 { "earlier" } else { "later" };
            let ms = 1e3 * offset_s.abs();
            format!("commands of {run} act {ms:.2} ms {side} than in the fitted run: taken out")
        }
        Limit::TorqueBalance { derivation: of } => {
            format!("errors are those of the torque balance ({})", derivation(of))
        }
        Limit::ConstantDrop { drop_v, std_v } => {
            let (value, most) = (with_std(*drop_v, *std_v), drop_v.abs() + TWO_SIDED_95 * std_v);
            // As a size may be zero.
            if drop_v.abs() > 2.58 * std_v {
                format!(
                    "the voltage balance has {value} V against the current whatever its size: brushes, switches or dead time. It is in no torque, so that it is not among the effects that these runs name"
                )
            } else {
                format!("the voltage balance has no constant drop: at most {} V", significant(most, 2))
            }
        }
        Limit::LostRows { expected, most, highest } => format!(
            "the commands of the hold-out are not known everywhere (rows are missing, or the voltage changed at an unknown instant \
             between two rows): this alone causes an error of about {expected:.1} times the noise, and up to {most:.1} is allowed \
             for; an error below {highest:.1} times the noise may be due to it alone"
        ),
        Limit::NothingRuledOut(why) => format!("nothing is ruled out: {}", why_open(*why)),
        Limit::RepeatUnknown(why) => {
            let why: &str = match why {
                RepeatUnknown::NotFollowed => "the model cannot be linearised along both runs",
                RepeatUnknown::RowsLost => "too many rows were lost",
                RepeatUnknown::Failed(message) => message,
            };
            format!("whether this machine repeats is not known: {why}")
        }
        Limit::NoNoiseFloor => {
            "the run does not begin with a standstill at zero input (20 samples are needed): no noise floor is known, so \
             that an error cannot be distinguished from noise; errors are shown relative to the voltage or driving torque instead"
                .to_owned()
        }
        Limit::NoOtherRun { share } => format!(
            "no other run is held out: the {} of the run are, with the same day and excitation",
            last_part(*share)
        ),
        Limit::NotMeasured { signal } => format!(
            "no {signal} was measured: errors of the voltage equation and of the torque equation cannot be separated"
        ),
        Limit::FewWindows { equation, usable, needed, length_s } => format!(
            "{equation} equation: {usable} usable windows of {:.0} ms, at least {needed} are needed to locate its error: \
             record a longer run{}",
            1e3 * length_s,
            if *equation == "torque" { " in which the shaft turns" } else { "" }
        ),
        Limit::NoAngle => {
            "no angle was measured: it is integrated from the speed and drifts, so that an error that follows the angle \
             may not be detected"
                .to_owned()
        }
    }
}

/// Of a hold-out in which neither speed nor current changes.
pub(super) const HOLDOUT_STILL: &str = "the held-out part stands still or runs steadily";

/// The part of a run that is held out.
pub fn last_part(share: f64) -> String {
    format!("last {:.0} %", 100.0 * share)
}

pub fn set_aside(aside: &SetAside) -> String {
    format!(
        "{} {} set aside: {} happens once in a run or counts from its first command, and has no common fit to several runs; the \
        diagnosis is of {} without the later runs, which have to be diagnosed separately",
        aside.later.join(" and "),
        if aside.later.len() > 1 { "are" } else { "is" },
        aside.effects.join(" and "),
        aside.first,
    )
}

fn unjudged(why: &Unjudged) -> String {
    match why {
        Unjudged::OnlyInHoldout => "it was measured in the hold-out only".to_owned(),
        Unjudged::NotInHoldout => "it was not measured in the hold-out, which decides".to_owned(),
        Unjudged::Constant => "it is the same throughout the run".to_owned(),
        Unjudged::FewAtRest { samples, needed } => format!(
            "its noise is not known, because it has {samples} samples in the leading standstill and {needed} are needed"
        ),
        Unjudged::FewRepeated { needed } => format!(
            "its noise is not known, because the repeated runs have fewer than {needed} samples of it at the same instants"
        ),
        Unjudged::NothingLeft => "the fitted baseline has no residual in it".to_owned(),
    }
}

fn searched(part: &SearchedPart) -> String {
    let SearchedPart { run, from_s, to_s, whole_s, rows, of_rows } = part;
    let run: &str = match run {
        LongRun::Fit => "the fit run",
        LongRun::Holdout => "the hold-out",
        LongRun::Repeat => "the repeated run",
        LongRun::Only => "the run",
        LongRun::Named(name) => name,
    };
    let origin = if *from_s > 0.0 {
        format!("; times of events count from {from_s:.2} s of it")
    } else {
        String::new()
    };
    format!(
        "only {from_s:.0} to {to_s:.0} s of the {whole_s:.0} s of {run} were searched: {rows} of {of_rows} rows{origin}"
    )
}

pub(super) const fn why_open(why: WhyOpen) -> &'static str {
    match why {
        WhyOpen::SearchCut => {
            "the search reached its limit of work before the set of effects was stable"
        }
        WhyOpen::FarFromNoise => {
            "the residuals of the best model are several times the noise, so that its bounds do not hold"
        }
        WhyOpen::OtherShapes => "an error is left, and only some of its shapes were tried",
        WhyOpen::DependsOnPast => "a torque of unknown form depends on the past of the speed",
    }
}

/// How the rows of a torque balance are computed.
pub fn derivation(of: &Derivation) -> String {
    match of {
        Derivation::WeakForm { window_s, dead_zone_rad_s } => format!(
            "weak form: windows of {:.0} ms with the test function (1 - s^2)^4, without differentiation; windows with \
             speeds below {dead_zone_rad_s:.3} rad/s left out",
            1e3 * window_s,
        ),
        Derivation::BetweenSteps { most_s, dead_zone_rad_s } => format!(
            "integrals over at most {:.0} ms between two steps of the commanded current, without differentiation; speeds below \
             {dead_zone_rad_s:.3} rad/s left out",
            1e3 * most_s,
        ),
        Derivation::InverseDynamics { processing, then_hz, one_in } => processing.sentence_with(
            &format!("then at {then_hz:.3} Hz, as for one row in {one_in}; every row in motion"),
        ),
    }
}

/// A prediction that is as good as the fitted model.
pub fn trivial(found: &TrivialPrediction) -> String {
    match found {
        TrivialPrediction::Mean { signal, unit, error, own } => format!(
            "the fitted model has an error of {own:.3} {unit} in the {signal} of the hold-out, its mean value one of {error:.3} {unit}"
        ),
        TrivialPrediction::LastValue { signal, unit, error, own } => format!(
            "the fitted model has an error of {own:.3} {unit} in the {signal} of the hold-out, the last value of the fitted part one \
            of {error:.3} {unit}"
        ),
        TrivialPrediction::Lag { error, own, gain_rad_s_per_v, time_constant_s } => format!(
            "the fitted model has an error of {own:.3} rad/s in the speed of the hold-out, a first-order lag of \
            {gain_rad_s_per_v:.3} rad/s/V and {time_constant_s:.3} s one of {error:.3} rad/s"
        ),
    }
}

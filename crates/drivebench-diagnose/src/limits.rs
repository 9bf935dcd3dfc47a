//! Limits of a set of runs, and why.

use drivebench_identify::balance::Derivation;
use drivebench_model::findings;

findings! {
    #[derive(Clone, Debug, PartialEq)]
    pub enum Limit {
        RunsSetAside(SetAside) = "runs_set_aside",
        /// No effect is named where neither speed nor current of the hold-out changes.
        HoldoutStill = "holdout_still",
        /// A measured signal is not judged.
        SignalUnjudged { signal: &'static str, why: Unjudged } = "signal_not_judged",
        /// Only parts of long runs were searched; whether the rest confirms the answer.
        PartSearched { parts: Vec<SearchedPart>, rest_confirms: bool } = "only_part_searched",
        /// By how much commands act later than the stamps of the host, s, and the deviation of what was known of it beforehand.
        StampsOffset { offset_s: f64, known_s: f64 } = "offset_of_stamps",
        /// By how much the commands of a run act later than those of the fitted run, against their stamps.
        OffsetOfRun { run: String, offset_s: f64 } = "offset_of_a_run",
        TorqueBalance { derivation: Derivation } = "errors_of_torque_balance",
        /// Voltage against the current whatever its size, with its standard deviation, V: of a run that a current drives.
        ConstantDrop { drop_v: f64, std_v: f64 } = "constant_voltage_drop",
        /// Mean and largest error by the commands of lost rows, in units of the noise; the highest error
        /// that they alone may cause.
        LostRows { expected: f64, most: f64, highest: f64 } = "lost_rows",
        NothingRuledOut(WhyOpen) = "nothing_ruled_out",
        RepeatUnknown(RepeatUnknown) = "repeatability_unknown",
        NoNoiseFloor = "no_noise_floor",
        /// The held-out part is this share of the run itself.
        NoOtherRun { share: f64 } = "no_other_run_held_out",
        NotMeasured { signal: &'static str } = "signal_not_measured",
        FewWindows { equation: &'static str, usable: usize, needed: usize, length_s: f64 } = "too_few_windows",
        /// An error that depends on the angle may not be detected.
        NoAngle = "angle_not_measured",
    }
}

/// Runs after the first one that cannot be fitted with these effects.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SetAside {
    pub later: Vec<String>,
    pub effects: Vec<&'static str>,
    pub first: String,
}

/// Why a measured signal is not judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unjudged {
    OnlyInHoldout,
    NotInHoldout,
    Constant,
    FewAtRest { samples: usize, needed: usize },
    FewRepeated { needed: usize },
    NothingLeft,
}

/// The part of a long run that was searched, in seconds and rows from its begin.
#[derive(Clone, Debug, PartialEq)]
pub struct SearchedPart {
    pub run: LongRun,
    pub from_s: f64,
    pub to_s: f64,
    pub whole_s: f64,
    pub rows: usize,
    pub of_rows: usize,
}

/// Which run it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LongRun {
    Fit,
    Holdout,
    Repeat,
    /// The only one, a part of which is held out.
    Only,
    /// One of several that are fitted.
    Named(String),
}

findings! {
    /// Why no effect is ruled out.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum WhyOpen {
        SearchCut = "search_ended_by_budget",
        /// The error of the best model is several times the noise, so that its bounds do not hold.
        FarFromNoise = "several_times_the_noise_left",
        /// A torque over the past of the speed, of no known form: it explains what a lag or a filter would.
        DependsOnPast = "depends_on_the_past",
        /// An error is left, and only some of its shapes were tried.
        OtherShapes = "other_shapes_not_tried",
    }
}

/// Why it is not known whether a machine repeats.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RepeatUnknown {
    NotFollowed,
    RowsLost,
    /// A fit failed, with its message.
    Failed(String),
}

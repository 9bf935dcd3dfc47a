//! Faults of data: codes with the figures that show them.

use drivebench_model::findings;
use drivebench_model::plant::MotorKey;
use drivebench_model::sample::Channel;
use serde::Serialize;

#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Fault {
    Signal(SignalFault),
    Column(ColumnFault),
    Unit(UnitFault),
}

findings! {
    /// Faults of single signals. A pair is the least and the largest value; a share counts from 0 to 1.
    #[derive(Clone, Debug, PartialEq)]
    pub enum SignalFault {
        AtRest { duration_s: f64, levels: Vec<Level> } = "nothing_changes_at_rest",
        OperatingPoint { duration_s: f64, levels: Vec<Level> } = "one_operating_point",
        CurrentConstant { level_a: f64, rows: usize, voltage: &'static str, volts: [f64; 2] } = "current_not_measured",
        /// No current flows under a stated voltage while the shaft runs out.
        CoastDown { speeds_rad_s: [f64; 2], volts: f64 } = "terminals_open",
        CoastDownInside { rows: usize, from_s: f64, level_a: f64 } = "terminals_open_for_a_while",
        SpeedConstant { level_rad_s: f64, rows: usize } = "speed_not_measured",
        /// A speed of zero, although resistance and inductance leave this share of the voltage unexplained.
        SpeedZero { unexplained: f64 } = "speed_zero_while_the_shaft_turns",
        SpeedDead { from_s: f64, to_s: f64, unexplained: f64 } = "speed_sensor_dead",
        ShaftAtRest { duration_s: f64, noise_rad_s: f64 } = "shaft_does_not_turn",
        /// One of `count` wild values, and its neighbours.
        Outlier { key: &'static str, at_s: f64, value: f64, neighbours: [f64; 2], count: usize, of: usize } = "outlier",
        /// The size of the jump, in counts of its step where they are a whole number of bits, and the values of the first.
        CounterOverflows { key: &'static str, jump: f64, counts: Option<f64>, rows: usize, at_s: f64, values: [f64; 2] } = "counter_overflows",
        SignLost { key: &'static str, values: [f64; 2], voltage: &'static str, rows: usize } = "sign_lost",
        VoltageSignLost { voltage: &'static str, speeds_rad_s: [f64; 2], rows: usize } = "sign_of_the_voltage_lost",
        Froze { key: &'static str, value: f64, rows: usize, from_s: f64, to_s: f64 } = "signal_froze",
        HeldLikeACommand { key: &'static str, jumps: usize, largest: f64 } = "held_like_a_command",
        CutOff { key: &'static str, levels: Vec<f64>, rows: usize, share: f64, plateaus: usize } = "cut_off_at_a_limit",
    }
}

/// The level of a signal that does not change; no noise where it is the same in every cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    pub signal: &'static str,
    pub unit: &'static str,
    pub mean: f64,
    pub noise: Option<f64>,
}

findings! {
    /// Faults of the assignment of columns, by the balances of voltage and torque.
    #[derive(Clone, Debug, PartialEq)]
    pub enum ColumnFault {
        SignReversed(Mapping) = "sign_reversed",
        Exchanged(Mapping) = "columns_exchanged",
        /// A coefficient that no motor has, and the shares of voltage and current that stay unexplained.
        Impossible { coefficient: (MotorKey, f64), left: [f64; 2] } = "no_motor_has_these_values",
        OfSupply { voltage: &'static str, volts: [f64; 2], coefficient: (MotorKey, f64) } = "voltage_of_the_supply",
    }
}

/// Another assignment of columns, which explains what the given one does not.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapping {
    /// Columns given for voltage, current and speed.
    pub keys: [&'static str; 3],
    /// Which of them are voltage, current and speed.
    pub place: [usize; 3],
    /// Which of the three has the other sign.
    pub reversed: Option<usize>,
    /// A coefficient that no motor has, by the given assignment.
    pub impossible: Option<(MotorKey, f64)>,
    /// Shares of voltage and current that stay unexplained, by the given assignment and by this one.
    pub left: [[f64; 2]; 2],
}

findings! {
    /// Units that cannot be, or hardly. `over_angle` is the integral of the speed over the change of the angle.
    #[derive(Clone, Debug, PartialEq)]
    pub enum UnitFault {
        OtherUnit { key: &'static str, seems: &'static str, instead: &'static str, factor: f64, evidence: Evidence } = "other_unit",
        OtherTimeUnit { unit: &'static str, factor: f64, over_angle: f64 } = "time_in_another_unit",
        SpeedAndAngle { unit: &'static str, to_rad: f64, over_angle: f64 } = "speed_and_angle_in_other_units",
        Angle { unit: &'static str, to_rad: f64, over_angle: f64 } = "angle_in_another_unit",
        AngleReversed { over_angle: f64 } = "angle_counts_backward",
        /// The pole pairs that the speed may be electrical by.
        AngleDisagrees { over_angle: f64, pole_pairs: Option<f64> } = "speed_and_angle_disagree",
        /// The armature has a time constant L/R that none has; so many of the unit are a second.
        Armature { unit: &'static str, factor: f64, period_s: f64, time_constant_s: f64 } = "time_constant_of_no_armature",
        OtherBasis { evidence: Evidence, basis: Basis } = "other_basis_than_the_model",
        /// Back-EMF constant over that of the model, of the same winding.
        Gear { evidence: Evidence, ratio: f64 } = "gear_in_between",
        Volts { key: &'static str, volts: f64 } = "voltage_implausibly_large",
        Amperes { amperes: f64, volts: f64 } = "current_implausibly_large",
        /// Whether the angle is its integral, and the back-EMF constant, V.s/rad.
        Fast { rad_s: f64, by_angle: bool, back_emf: Option<f64> } = "speed_implausibly_large",
        Header { target: String, header: String, unit: &'static str, factor: &'static str } = "header_names_another_unit",
    }
}

/// What a unit shows against. Those of a model are back-EMF constants and resistances, found and of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Evidence {
    Angle { over_angle: f64 },
    Model { back_emf: (f64, f64), resistance: Option<(f64, f64)> },
    Torque { n_m_per_a: f64, back_emf: f64 },
}

/// What a column may have been given for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Basis {
    LineForPhase,
    PhaseForLine,
    PeakForRms,
    RmsForPeak,
    TwoPolePairs,
    ThreePolePairs,
    EdgesForLines,
    LinesForEdges,
}

/// Cells that are no measurement and are taken as missing.
#[derive(Clone, Debug, PartialEq)]
pub enum Masked {
    /// A value that stands for a missing one, in so many rows of all; least and largest of the others.
    Code {
        channel: Channel,
        value: f64,
        rows: usize,
        of: usize,
        first_s: f64,
        others: (f64, f64),
    },
    TelemetryFroze {
        channels: Vec<Channel>,
        stretches: usize,
        longest_s: f64,
        from_s: f64,
        rows: usize,
    },
    SampledAndHeld {
        channel: Channel,
        every_s: f64,
        period_s: f64,
        cells: usize,
    },
}

//! Why a column is taken, what speaks against it, what is missing, what is left out: codes with figures.

use super::known::Quantity;
use drivebench_model::findings;
use drivebench_model::plant::MotorKey;

findings! {
    /// Why a column is taken for a quantity. A share counts from 0 to 1; `left`: shares of voltage and current unexplained.
    #[derive(Clone, Debug, PartialEq)]
    pub enum Reason {
        Symbol { header: String, quantity: Quantity } = "usual_symbol",
        OfProgram { header: String, quantity: Quantity, tool: &'static str } = "column_of_a_program",
        Named { header: String, quantity: Quantity } = "named_by_its_header",
        NameUnknown = "name_unknown",
        /// As it stands in the table of known columns.
        Note(&'static str) = "note",
        Unit(&'static str) = "unit_stated",
        UnitOf(Quantity) = "unit_of_another_quantity",
        SensorVoltage = "voltage_of_a_sensor",
        Effective = "effective_value",
        Reaches(f64) = "largest_value",
        ShareOf { supply: String } = "share_of_the_supply",
        Electrical = "electrical_speed",
        TakesSign { command: String } = "sign_of_a_command",
        /// What both balances leave; with the other column `None` where no motor has its coefficients.
        BetterThan { header: String, left: f64, by_other: Option<f64> } = "balances_hold_better",
        BalanceHolds { resistance: f64, back_emf: f64, left: [f64; 2] } = "balance_of_voltages_holds",
        Reversed { coefficient: (MotorKey, f64), left: [f64; 2] } = "sign_reversed",
        ReactionTorque = "torque_of_the_reaction",
        OverAngle { over_angle: f64, units: Vec<&'static str> } = "derivative_of_the_angle",
        PolePairs { over_angle: f64, pairs: f64 } = "pole_pairs_by_the_angle",
        Rises { share: f64, step: f64 } = "rises",
        Clocks = "cells_are_clocks",
        OnlyClock = "only_clock",
        Period(f64) = "period_stated",
        Stamps(&'static str) = "unit_by_the_stamps",
        UsualPeriod { unit: &'static str, period_ms: f64 } = "unit_by_the_period",
        OthersRise(Vec<String>) = "others_rise_too",
    }
}

findings! {
    /// What speaks against a column, its unit or its sign.
    #[derive(Clone, Debug, PartialEq)]
    pub enum Doubt {
        Rival { header: String } = "another_column_fits_as_well",
        OtherMotor(Vec<String>) = "another_motor",
        Impossible { coefficient: (MotorKey, f64) } = "no_motor_has_these_values",
        NoWork = "no_work_shows_the_sign",
        NotOfSupply = "changes_unlike_a_supply",
        Command = "command_of_no_quantity",
        Percent = "taken_as_per_cent",
        TakenAsSi = "taken_as_si",
        Braking = "sign_wrong_in_braking",
        TakenAsRpm { reaches: f64 } = "taken_as_rpm",
        SpeedUnit { unit: &'static str, reaches: f64 } = "unit_of_the_speed_open",
        /// Integral of the speed over the change of the angle, as it stands and in the stated units.
        OverAngle { over_angle: f64, in_units: f64 } = "speed_and_angle_disagree",
        Period = "period_unknown",
        AnyRising = "any_quantity_that_rises",
        NoUsualPeriod { step: f64 } = "no_usual_period",
        /// The unit that is taken and the others, with their periods in ms.
        TimeUnit { units: Vec<(&'static str, f64)> } = "unit_of_the_time_open",
    }
}

findings! {
    #[derive(Clone, Debug, PartialEq)]
    pub enum Missing {
        Time = "no_time",
        TimeWithoutNumbers { header: String } = "time_without_numbers",
        NoClock { header: String, rising: f64, falling: f64 } = "time_does_not_rise",
        Speed = "no_speed",
        Input = "no_input",
        OwnHeader { target: &'static str, header: String, count: usize } = "equal_headers",
    }
}

findings! {
    /// Why a column is left out; `source` as it would stand in the map.
    #[derive(Clone, Debug, PartialEq)]
    pub enum Unused {
        Angle { source: String } = "speed_serves_alone",
        Torque { source: String, reasons: Vec<Reason> } = "calculated_from_the_current",
        SupplyVoltage { header: String, volts: [f64; 2] } = "only_sags",
        OfSupply { header: String, quantity: Quantity, reasons: Vec<Reason> } = "of_the_supply",
        Constant { header: String } = "never_changes",
        Other { source: String } = "another_was_taken",
    }
}

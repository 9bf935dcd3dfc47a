//! The likely map of a foreign log: why each column is taken, the doubts about it, what is missing, what is left out.

use drivebench_bench::column_proposal::{Doubt, Missing, Quantity, Reason, Unused};
use drivebench_model::text::number::{percent, shortest, significant};

use super::sanity::{RAD_S_PER_RPM, gives};

const fn quantity(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::Time => "the time",
        Quantity::Index => "the number of the row",
        Quantity::Voltage => "the voltage of the motor",
        Quantity::VoltageCommand => "the voltage command",
        Quantity::SupplyVoltage => "the supply voltage",
        Quantity::Duty => "the duty of the bridge",
        Quantity::Command => "a command",
        Quantity::Current => "the current of the motor",
        Quantity::SupplyCurrent => "the supply current",
        Quantity::Speed => "the speed",
        Quantity::ElectricalSpeed => "the electrical speed",
        Quantity::SpeedReference => "the speed reference",
        Quantity::Angle => "the angle",
        Quantity::Torque => "the torque",
        Quantity::Channel => "a channel",
        Quantity::Other => "a quantity that identification does not need",
    }
}

fn share(share: f64) -> String {
    percent(100.0 * share)
}

fn left([voltage, current]: [f64; 2]) -> String {
    format!("{} of the voltage and {} of the current unexplained", share(voltage), share(current))
}

fn over(over_angle: f64) -> String {
    format!("its integral is {} times the change of the angle", shortest(over_angle, 4))
}

fn period((unit, period_ms): &(&str, f64)) -> String {
    format!("{unit} (a period of {} ms)", shortest(*period_ms, 4))
}

pub fn reason(reason: &Reason) -> String {
    match reason {
        Reason::Symbol { header, quantity: of } => {
            format!("{header:?} is a usual symbol of {}", quantity(*of))
        }
        Reason::OfProgram { header, quantity: of, tool } => {
            format!("{header:?} is {} in a log of {tool}", quantity(*of))
        }
        Reason::Named { header, quantity: of } => {
            format!("the header {header:?} names {}", quantity(*of))
        }
        Reason::NameUnknown => "its name is unknown".to_owned(),
        Reason::Note(note) => (*note).to_owned(),
        Reason::Unit(unit) => format!("in {unit}"),
        Reason::UnitOf(of) => format!("its unit is that of {}, whatever its name", quantity(*of)),
        Reason::SensorVoltage => "the column is the voltage of a sensor".to_owned(),
        Reason::Effective => {
            "an effective value: the amplitude of a sine is 1.414214 times as large".to_owned()
        }
        Reason::Reaches(most) => format!("its largest value is {}", shortest(*most, 3)),
        Reason::ShareOf { supply } => {
            format!("a bridge applies this share of its supply, {supply:?}")
        }
        Reason::Electrical => {
            "the speed of the shaft is the electrical speed over the pole pairs".to_owned()
        }
        Reason::TakesSign { command } => {
            format!("it is never negative while {command:?} has both signs, and takes that sign")
        }
        Reason::BetterThan { header, left, by_other } => {
            let other = by_other.map_or_else(|| "they hold for no motor".to_owned(), share);
            format!(
                "with it both balances leave {} unexplained, with {header:?} {other}",
                share(*left)
            )
        }
        Reason::BalanceHolds { resistance, back_emf, left: own } => format!(
            "u = R i + L di/dt + Ke w holds with R {} and Ke {} in the units of the map and leaves {}",
            significant(*resistance, 3),
            significant(*back_emf, 3),
            left(*own)
        ),
        Reason::Reversed { coefficient, left: own } => format!(
            "its sign is reversed: as it stands, the balances give {}, which no motor has; now they leave {}",
            gives(coefficient),
            left(*own)
        ),
        Reason::ReactionTorque => {
            "its sign is reversed: as it stands, the shaft drives the motor all the time; a sensor of the reaction torque has that sign".to_owned()
        }
        Reason::OverAngle { over_angle, units } if units.is_empty() => over(*over_angle),
        Reason::OverAngle { over_angle, units } => {
            format!("{}, so that it is in {}", over(*over_angle), units.join(" or "))
        }
        Reason::PolePairs { over_angle, pairs } => {
            format!("{}: {pairs} pole pairs, or the ratio of a gear", over(*over_angle))
        }
        Reason::Rises { share: of, step } => {
            format!("it rises in {} of the rows, mostly by {}", share(*of), shortest(*step, 4))
        }
        Reason::Clocks => "its cells are clocks, which are read as seconds".to_owned(),
        Reason::OnlyClock => "no other column is a clock".to_owned(),
        Reason::Period(period_s) => format!("the row of units gives {period_s} s from row to row"),
        Reason::Stamps(unit) => format!("its values are {unit}"),
        Reason::UsualPeriod { unit, period_ms } => {
            format!("no unit is written; taken as {}", period(&(unit, *period_ms)))
        }
        Reason::OthersRise(headers) => format!("{} rises too", headers.join(", ")),
    }
}

pub fn doubt(doubt: &Doubt) -> String {
    match doubt {
        Doubt::Rival { header } => {
            format!("{header:?} may be it as well; the balances do not decide")
        }
        Doubt::OtherMotor(headers) => {
            format!("the file holds another motor too: {}", headers.join(", "))
        }
        Doubt::Impossible { coefficient } => format!(
            "the balances of voltage, current and speed give {}, which no motor has, in either sign",
            gives(coefficient)
        ),
        Doubt::NoWork => {
            "speed and torque do not show its sign: the work of the record is near zero".to_owned()
        }
        Doubt::NotOfSupply => {
            "its name is that of a supply, and it changes like the voltage of a motor".to_owned()
        }
        Doubt::Command => {
            "it is a command without a unit: only the program of the drive defines it".to_owned()
        }
        Doubt::Percent => "no unit is written: taken as per cent".to_owned(),
        Doubt::TakenAsSi => "no unit is written: taken as SI".to_owned(),
        Doubt::Braking => "its sign is wrong while the drive brakes".to_owned(),
        Doubt::TakenAsRpm { reaches } => format!(
            "no unit is written; it reaches {}: taken as r/min, since few motors turn at so many rad/s",
            shortest(*reaches, 4)
        ),
        Doubt::SpeedUnit { unit, reaches } => format!(
            "no unit is written, and the balances hold in any: taken as {unit} (it reaches {}); in r/min write *{RAD_S_PER_RPM} instead",
            shortest(*reaches, 4)
        ),
        Doubt::OverAngle { over_angle, in_units } => format!(
            "{}, {} times what their units give: an electrical speed, another side of a gear, or a wrong unit",
            over(*over_angle),
            shortest(*in_units, 4)
        ),
        Doubt::Period => "the file does not contain the time from row to row".to_owned(),
        Doubt::AnyRising => "it may be any quantity that rises".to_owned(),
        Doubt::NoUsualPeriod { step } => format!(
            "no unit is written, and steps of {} are no usual period in s, ms or us",
            shortest(*step, 4)
        ),
        Doubt::TimeUnit { units } => {
            let units: Vec<String> = units.iter().map(period).collect();
            format!("no unit is written: taken as {}", units.join(", and not as "))
        }
    }
}

pub fn missing(missing: &Missing) -> String {
    match missing {
        Missing::Time => {
            "a time (no column has its name, and none rises from row to row)".to_owned()
        }
        Missing::TimeWithoutNumbers { header } => format!("a time ({header:?} holds no numbers)"),
        Missing::NoClock { header, rising, falling } => format!(
            "a time ({header:?} is no clock: {} of its steps rise and {} fall)",
            share(*rising),
            share(*falling)
        ),
        Missing::Speed => "a speed or an angle of the shaft".to_owned(),
        Missing::Input => "a voltage at the motor, its current, or a torque".to_owned(),
        Missing::OwnHeader { target, header, count } => format!(
            "a header of its own for {target}: {count} columns are called {header:?}; rename them in the file"
        ),
    }
}

pub fn unused(unused: &Unused) -> String {
    match unused {
        Unused::Angle { source } => format!("{source}: the speed serves alone"),
        Unused::Torque { source, reasons } => format!("{source}: {}", all(reasons)),
        Unused::SupplyVoltage { header, volts: [least, most] } => format!(
            "{header:?} stays between {} and {} V whatever the motor does: it is the voltage of the supply, not of the motor",
            shortest(*least, 4),
            shortest(*most, 4)
        ),
        Unused::OfSupply { header, quantity: of, reasons } => {
            let why = match of {
                Quantity::SupplyCurrent => {
                    "it is the current of the supply, not of the motor: the bridge chops between them"
                }
                _ => "it is the voltage of the supply, not of the motor",
            };
            let notes =
                if reasons.is_empty() { String::new() } else { format!("; {}", all(reasons)) };
            format!("{header:?}: {why}{notes}")
        }
        Unused::Constant { header } => format!("{header:?} never changes"),
        Unused::Other { source } => format!("{source}: another column is taken"),
    }
}

pub fn all(reasons: &[Reason]) -> String {
    reasons.iter().map(reason).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_model::plant::MotorKey;

    #[test]
    fn a_finding_has_its_figures() {
        let (header, left) = ("fan".to_owned(), [0.01, 0.02]);
        let coefficient = (MotorKey::Resistance, -1.2);
        let units = vec![("ms", 2.0), ("us", 0.002)];
        for (sentence, part) in [
            (
                reason(&Reason::BetterThan { header, left: 0.04, by_other: None }),
                "leave 4.0 % unexplained, with \"fan\" they hold for no motor",
            ),
            (
                reason(&Reason::Reversed { coefficient, left }),
                "a resistance of -1.200e0, which no motor has; now they leave 1.0 % of the voltage",
            ),
            (doubt(&Doubt::TimeUnit { units }), "ms (a period of 2 ms), and not as us (a period"),
        ] {
            assert!(sentence.contains(part), "{sentence}");
        }
    }
}

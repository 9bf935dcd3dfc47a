//! What is wrong with the rows and the input of a record.

use drivebench_identify::lost_rows::LostRows;
use drivebench_identify::speed_lag::FoundLag;
use drivebench_identify::voltage_departure::Departure;
use drivebench_model::plant::Scenario;
use drivebench_model::sample::SpeedLag;

/// The missing rows of a record: their count, position and treatment.
pub fn lost_rows(found: &LostRows) -> String {
    let [from_s, to_s] = found.longest_s;
    let holes = match found.restarts {
        1 => "the long hole".to_owned(),
        _ => format!("{} long holes", found.restarts),
    };
    let restart = if found.restarts == 0 {
        String::new()
    } else {
        format!("; after {holes} every simulation restarts from the measurement")
    };
    let known = if found.estimated_s > 0.0 {
        format!(
            "for {:.3} s ({:.1} % of the run) it is estimated from the neighbouring rows and from the current, with an \
             uncertainty; elsewhere the neighbouring rows determine it",
            found.estimated_s,
            100.0 * found.estimated_share
        )
    } else {
        "the neighbouring rows determine it".to_owned()
    };
    format!(
        "{}: {} of {} rows of {} are missing ({:.1} %), the longest time without {:.3} s from {from_s:.3} s on: the input is not \
         recorded there; {known}{restart}",
        found.run,
        counted(found.lost),
        counted(found.of),
        found.input.key(),
        100.0 * found.lost as f64 / found.of as f64,
        to_s - from_s,
    )
}

/// The changes of the command that the drive did not confirm; none where it confirmed all within the record.
pub fn unconfirmed(scenario: &Scenario) -> Option<String> {
    let last_s = *scenario.sample_time_s.last()?;
    let holes = scenario.unknown_input.iter();
    let of_commands = holes.filter(|hole| hole.is_unconfirmed() && hole.from_s < last_s);
    let lengths_s: Vec<f64> = of_commands.map(|hole| hole.to_s.min(last_s) - hole.from_s).collect();
    let count = lengths_s.len();
    let commands =
        if count == 1 { "1 change of the command was" } else { "changes of the command were" };
    let number = if count == 1 { String::new() } else { format!("{count} ") };
    (count > 0).then(|| {
        format!(
            "{}: {number}{commands} not confirmed by the drive, and acted at an unknown time: {:.3} s are not compared, and every \
             simulation restarts from the measurement after them",
            scenario.name,
            lengths_s.iter().sum::<f64>()
        )
    })
}

/// The lag of the measured speed that is a part of every model of a run; `found` by its angle, else stated by the profile.
pub fn speed_lag(lag: SpeedLag, found: Option<&FoundLag>) -> String {
    let ms = |seconds: f64| 1e3 * seconds;
    let of = found.map_or_else(
        || format!("has a filter of {:.1} ms by the drive's profile", ms(lag.filter_s)),
        |found| {
            format!(
                "is {:.1} \u{b1} {:.1} ms later than the measured angle: a filter of {:.1} ms and a delay of {:.1} ms",
                ms(lag.total_s()),
                ms(found.std_s),
                ms(lag.filter_s),
                ms(lag.delay_s)
            )
        },
    );
    format!("the measured speed {of}; this is a part of every model of the run")
}

/// A stated filter that a record does not support.
pub fn no_speed_lag(stated: SpeedLag) -> String {
    format!(
        "the drive's profile states a filter of {:.1} ms for the speed, and the model follows the run better without it: it is left out",
        1e3 * stated.filter_s
    )
}

/// The drive's own ramp of the voltage, which a record supports or not.
pub fn ramp(ramp_v_per_s: f64, is_supported: bool) -> String {
    let ramp = format!("the drive's profile states a ramp of the voltage of {ramp_v_per_s:.0} V/s");
    if is_supported {
        format!("{ramp}; this is a part of every model of the run")
    } else {
        format!("{ramp}, and the model follows the run better without it: it is left out")
    }
}

/// A number with separators of thousands.
fn counted(number: usize) -> String {
    let digits = number.to_string();
    let mut out = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

pub fn departure(found: &Departure) -> String {
    format!(
        "the measured voltage is not the commanded one in {:.1} % of the rows (by up to {:.1} V): the drive limited it (current \
         limit, bus voltage, a ramp of its own)",
        100.0 * found.share,
        found.largest_v
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivebench_model::sample::Channel;

    #[test]
    fn lost_rows_have_count_share_and_the_longest_hole() {
        let found = LostRows {
            run: "a".to_owned(),
            input: Channel::Voltage,
            lost: 6_000,
            of: 1_234_567,
            longest_s: [3.0, 3.4],
            estimated_s: 0.0,
            estimated_share: 0.0,
            restarts: 1,
        };
        assert_eq!(
            lost_rows(&found),
            "a: 6,000 of 1,234,567 rows of voltage_v are missing (0.5 %), the longest time without 0.400 s from 3.000 s on: \
             the input is not recorded there; the neighbouring rows determine it; after the long hole every simulation \
             restarts from the measurement"
        );
    }
}

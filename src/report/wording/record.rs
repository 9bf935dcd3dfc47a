//! What is wrong with the rows and the input of a record.

use drivebench_identify::lost_rows::LostRows;
use drivebench_identify::voltage_departure::Departure;

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

/// The measured voltage beside the commanded one.
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

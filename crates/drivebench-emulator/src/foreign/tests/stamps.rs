//! When a sample was taken: silences of the line, several blocks, the drive's own clock, one transaction a cycle, counts.

use super::*;

const REFERENCE: Reference<'static> = speed_ref(900.0);
const CHANGED: [f64; 2] = [400.0, 401.0];
/// All of its fast signals in one request.
pub(super) const ONE_BLOCK: (&str, &str) =
    ("max_read = 16\nmax_write = 16\nmax_hole = 7", "max_read = 64\nmax_write = 16\nmax_hole = 64");
/// The servo amplifier's first signal.
const FIRST: &str = "[signals.enabled]";

fn servo(changes: Changes<'_>) -> Table {
    Table::identified("epulse50-dc", changes)
}

/// What its own clock shows, in front of the first signal.
fn with_clock(kind: &str, unit: &str, scale: &str) -> String {
    format!(
        "[signals.uptime]\naddress = 0x1219\ntype = \"{kind}\"\nunit = \"{unit}\"\nscale = {scale}\nquantity = \"clock\"\npoll = \"fast\"\n\n{FIRST}"
    )
}

#[test]
fn a_silence_before_a_read_moves_no_stamp() {
    // The last of the fast blocks ends the exchange: the half-width holds the truth.
    let half_width_s = |changes: Changes<'_>, silence_s: f64| {
        let mut table = servo(changes);
        table.drive(REFERENCE, 0.2);
        table.link.bus_mut().keep_silence(silence_s);
        let mut half_s = f64::NAN;
        for _ in 0..20 {
            let sample = table.run(REFERENCE).unwrap();
            let offset_s = (sample.time_s - table.far().time_s()).abs();
            half_s = sample.time_half_width_s.unwrap();
            assert!(offset_s <= half_s, "{silence_s}: {offset_s} {half_s}");
        }
        half_s
    };
    for silence_s in [0.0, 0.02, 0.3] {
        half_width_s(&[], silence_s);
    }
    let of_one_block = |silence_s| half_width_s(&[ONE_BLOCK], silence_s);
    let (without, behind) = (of_one_block(0.0), of_one_block(0.08));
    assert!((without - behind).abs() < 1e-9, "{without} {behind}");
    assert!(without < 0.01, "{without}");
}

#[test]
fn a_set_point_is_applied_within_its_own_write() {
    let mut table = servo(&[]);
    table.drive(REFERENCE, 0.2);
    table.link.bus_mut().keep_silence(0.2);
    let sample = table.run(speed_ref(CHANGED[0])).unwrap();
    let applied_s = sample.applied.unwrap().time_s;
    let write_s = table.link.bus().wire_s(8, 8).unwrap();
    let since_s = applied_s - table.time_s;
    assert!((0.0..=write_s).contains(&since_s), "{since_s} {write_s}");
    assert!(sample.time_s - applied_s > 0.19, "the silence lies between");
}

#[test]
fn the_drive_s_clock_stamps_the_samples_over_its_turns() {
    for (kind, unit, scale, count_s, pauses) in [
        ("u16", "ms", "1.0", 1e-3, 8),
        ("u16", "us", "100.0", 1e-4, 2),
        ("u32", "us", "1.0", 1e-6, 1),
        ("u32", "s", "0.001", 1e-3, 1),
    ] {
        let mut table = servo(&[ONE_BLOCK, (FIRST, &with_clock(kind, unit, scale))]);
        table.pass(1.7);
        let first = table.rest();
        // The axis begins at the host's time, within the first reading.
        let reading_s = first.host_time_s.unwrap() - first.time_s;
        assert!((0.0..0.02).contains(&reading_s), "{reading_s}");
        let began_s = table.far().time_s() - first.time_s;
        // A u16 of 0.1 ms comes round every 6.6 s, one of 1 ms every 65.5 s.
        for _ in 0..pauses {
            table.pass(9.3);
            for _ in 0..3 {
                let sample = table.rest();
                let off_s = sample.time_s + began_s - table.far().time_s();
                // The count is cut off in both, and each stamp lies somewhere within its own.
                assert!(off_s.abs() < 2.01 * count_s, "{kind} {unit}: {off_s}");
                let half_s = sample.time_half_width_s.unwrap();
                assert!(half_s <= 0.5 * count_s + 1e-12, "{unit}: {half_s}");
            }
        }
    }
}

#[test]
fn commands_are_on_the_drives_clock_behind_a_silence() {
    let mut table = servo(&[ONE_BLOCK, (FIRST, &with_clock("u32", "us", "1.0"))]);
    let first = table.rest();
    let began_s = table.far().time_s() - first.time_s;
    table.enable(REFERENCE);
    table.link.bus_mut().keep_silence(0.05);
    for k in 0..40 {
        let sample = table.run(speed_ref(CHANGED[k % 2])).unwrap();
        let off_s = sample.time_s + began_s - table.far().time_s();
        assert!(off_s.abs() < 2e-6, "{off_s}");
        let before_s = sample.time_s - sample.applied.unwrap().time_s;
        assert!((0.05..0.08).contains(&before_s), "{before_s}");
    }
}

/// The servo amplifier at 19200 baud, with or without function code 23.
fn at_19200(functions: &str) -> Table {
    let mut table = servo(&[
        ("functions = [3, 6, 16]", functions),
        ("baud = 115200", "baud = 19200"),
        ONE_BLOCK,
    ]);
    table.enable(REFERENCE);
    table
}

/// Cycles a second where each begins when the last has ended, and each has a new reference.
fn cycles_hz(table: &mut Table) -> f64 {
    table.period_s = 0.0;
    let (began_s, cycles) = (table.now_s(), 200);
    for k in 0..cycles {
        table.run(speed_ref(CHANGED[k % 2])).unwrap();
    }
    cycles as f64 / (table.now_s() - began_s)
}

#[test]
fn one_transaction_a_cycle_is_faster_than_two() {
    let mut two = at_19200("functions = [3, 6, 16]");
    let mut one = at_19200("functions = [3, 6, 16, 23]");
    let predicted = |table: &Table| table.link.shortest_cycle_s().unwrap().recip();
    let (promised_two, promised_one) = (predicted(&two), predicted(&one));
    let (by_two, by_one) = (cycles_hz(&mut two), cycles_hz(&mut one));
    println!("write and read {by_two:.1} Hz, both in one {by_one:.1} Hz");
    assert!(by_one > 1.15 * by_two, "{by_one} {by_two}");
    for (promised, found) in [(promised_two, by_two), (promised_one, by_one)] {
        assert!((promised / found - 1.0).abs() < 0.05, "{promised} {found}");
    }
    // The drive writes first and reads then, at one instant of its own.
    let sample = one.run(speed_ref(700.0)).unwrap();
    assert_eq!(one.written("speed_ref"), Some(700));
    assert_eq!(sample.applied.unwrap().time_s.to_bits(), sample.time_s.to_bits());
}

/// The position of an encoder, in front of the first signal.
fn with_position(kind: &str, keys: &str) -> String {
    format!(
        "[signals.position]\naddress = 0x1240\ntype = \"{kind}\"\nunit = \"counts\"\n{keys}quantity = \"angle\"\norigin = \"measured\"\npoll = \"fast\"\n\n{FIRST}"
    )
}

#[test]
fn encoder_counts_are_unwrapped_angle_and_speed() {
    let device = ("kind = \"dc\"", "kind = \"dc\"\ncounts_per_turn = 4096");
    let speed = (
        "type = \"i16\"\nunit = \"rpm\"\nquantity = \"shaft_speed\"",
        "type = \"i32\"\nunit = \"counts/s\"\nquantity = \"shaft_speed\"",
    );
    for (kind, wraps) in [("u16", ""), ("i16", ""), ("u32", ""), ("u16", "wraps_at = 4096\n")] {
        let position = with_position(kind, wraps);
        let mut table = servo(&[device, speed, (FIRST, &position)]);
        let mut last = table.drive(REFERENCE, 0.1);
        for k in 0..400 {
            // Both ways, some twenty turns of a u16 and three hundred of the shaft.
            let rpm = if k < 150 { 900.0 } else { -900.0 };
            let sample = table.run(speed_ref(rpm)).unwrap();
            let angle = sample.get(Channel::Angle).unwrap();
            let true_rad_s = table.speed_rad_s();
            let speed_rad_s = sample.get(Channel::Speed).unwrap();
            let is_steady = k == 149 || k == 399;
            let off_rad_s = speed_rad_s - true_rad_s;
            assert!(!is_steady || off_rad_s.abs() < 3.0, "{off_rad_s}");
            let step_s = sample.time_s - last.time_s;
            let turned = 0.5 * (speed_rad_s + last.get(Channel::Speed).unwrap()) * step_s;
            let off = angle - last.get(Channel::Angle).unwrap() - turned;
            assert!(off.abs() < 0.8, "{kind} {wraps}: {off} of {turned}");
            last = sample;
        }
    }
}

#[test]
fn a_position_that_turns_too_far_between_two_reads_is_refused() {
    let turns = with_position("u16", "counts_per_turn = 4096\nwraps_at = 4096\n");
    let changes: Changes<'_> = &[
        (FIRST, &turns),
        ("quantity = \"shaft_speed\"\norigin = \"measured\"", "quantity = \"other\""),
        ("unit = \"rpm\"", "unit = \"\""),
        ("[missing]", "[missing]\nspeed_rad_s = \"only the position\""),
        ("[rates]", "[limits]\nspeed_rpm = 3000\n\n[rates]"),
    ];
    let text = changed(DriveProfile::text("epulse50-dc").unwrap(), changes);
    let refused = DriveProfile::parse("x", &text).unwrap_err();
    assert_contains(&refused, "the direction is ambiguous (expected less than 50 %");
}

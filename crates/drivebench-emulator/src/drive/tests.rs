use firmware_protocol::modbus::{Exception, RegisterBank};
use firmware_protocol::registers as r;
use firmware_protocol::{CaptureControl, CaptureState};

use super::*;
use crate::config::{LimitsConfig, OutputOff};

fn plain() -> EmulatorConfig {
    let mut config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
    config.tolerance = 0.0;
    config
}

fn drive() -> SoftDrive {
    limited(|_| {})
}

fn limited(change: impl FnOnce(&mut LimitsConfig)) -> SoftDrive {
    let mut config = plain();
    change(&mut config.limits);
    SoftDrive::new(&config, 1)
}

fn speed_rad_s(drive: &SoftDrive) -> f64 {
    drive.plant().speed_rad_s()
}

fn send(drive: &mut SoftDrive, seq: u16, control: Control) {
    drive.command(DriveCommand { seq, control });
}

/// Keeps the drive fed with one control for `time_s`.
fn hold(drive: &mut SoftDrive, control: Control, time_s: f64) {
    let end = drive.time_s() + time_s;
    while drive.time_s() < end {
        send(drive, 7, control);
        drive.advance_to((drive.time_s() + 0.01).min(end));
    }
}

#[test]
fn the_state_machine_is_the_table() {
    use Control::{Disable, ResetFault, Stop, Voltage};
    use State::{Disabled, Fault as Faulted, Ready, Running};
    let table = [
        (Disabled, Disable, Disabled),
        (Disabled, Stop, Ready),
        (Disabled, ResetFault, Disabled),
        (Disabled, Voltage(5.0), Running),
        (Ready, Disable, Disabled),
        (Ready, Stop, Ready),
        (Ready, ResetFault, Disabled),
        (Ready, Voltage(5.0), Running),
        (Running, Disable, Disabled),
        (Running, Stop, Ready),
        (Running, ResetFault, Disabled),
        (Running, Voltage(5.0), Running),
        (Faulted, Disable, Faulted),
        (Faulted, Stop, Faulted),
        (Faulted, ResetFault, Disabled),
        (Faulted, Voltage(5.0), Faulted),
    ];
    for (from, control, to) in table {
        let mut drive = drive();
        match from {
            Disabled => {}
            Ready => send(&mut drive, 1, Stop),
            Running => send(&mut drive, 1, Voltage(1.0)),
            Faulted => {
                send(&mut drive, 1, Voltage(1.0));
                drive.advance_to(1.0);
            }
        }
        assert_eq!(drive.state(), from);
        send(&mut drive, 2, control);
        assert_eq!(drive.state(), to, "{from:?} {control:?}");
        let energised = drive.telemetry().voltage_cmd_v.abs() > 0.0;
        assert_eq!(energised, to == Running, "{from:?} {control:?}");
        assert_eq!(drive.telemetry().seq, 2, "echoed even where it has no effect");
    }
}

#[test]
fn the_watchdog_stops_the_motor_and_stays_latched() {
    let mut drive = drive();
    hold(&mut drive, Control::Voltage(60.0), 1.0);
    assert!(speed_rad_s(&drive) > 150.0);
    let silent_from = drive.time_s();
    // Reading is not a sign of life.
    while drive.time_s() < silent_from + 0.495 {
        let next = drive.time_s() + 0.005;
        drive.advance_to(next);
        drive.telemetry();
    }
    assert_eq!(drive.state(), State::Running);
    drive.advance_to(silent_from + 0.501);
    let telemetry = drive.telemetry();
    assert_eq!(telemetry.status.state(), Some(State::Fault));
    assert_eq!(telemetry.fault, Fault::Watchdog);
    assert!(telemetry.status.has(Status::WATCHDOG));
    drive.advance_to(silent_from + 2.0);
    assert!(speed_rad_s(&drive) == 0.0, "stopped without the host");
    hold(&mut drive, Control::Voltage(60.0), 0.1);
    assert!(speed_rad_s(&drive) == 0.0, "no restart without a reset");
    send(&mut drive, 8, Control::ResetFault);
    drive.advance_to(drive.time_s() + 0.1);
    assert!(speed_rad_s(&drive) == 0.0, "no restart without a new set-point");
    hold(&mut drive, Control::Voltage(60.0), 0.1);
    assert!(speed_rad_s(&drive) > 1.0);
    assert!(!drive.telemetry().status.has(Status::WATCHDOG));
}

#[test]
fn a_command_is_stamped_with_the_tick_that_applied_it() {
    let mut drive = drive();
    drive.advance_to(0.010_02);
    send(&mut drive, 300, Control::Voltage(12.0));
    let telemetry = drive.telemetry();
    assert_eq!((telemetry.seq, telemetry.applied_us, telemetry.time_us), (300, 10_050, 10_050));
    assert!((telemetry.voltage_cmd_v - 12.0).abs() < 1e-12);
    let off_v = telemetry.voltage_v - 12.0;
    assert!(off_v.abs() < 0.1, "sampled after it was applied");
    assert!(telemetry.status.has(Status::COMMAND_APPLIED));
    drive.advance_to(0.020);
    let later = drive.telemetry();
    assert_eq!((later.applied_us, later.time_us), (10_050, 20_000));
    assert!(!later.status.has(Status::COMMAND_APPLIED));
    // 9.95 ms of 12 V at a shaft held by nothing: compare with the armature's exponential, speed still low.
    assert!(later.current_a > 5.0);
}

#[test]
fn the_drive_time_counter_wraps_and_time_never_goes_back() {
    assert_eq!(micros(85_899_345), u32::MAX - 45); // 4,294,967,250 us
    assert_eq!(micros(85_899_346), 4); // 4,294,967,300 us
    let mut drive = drive();
    drive.advance_to(0.5);
    drive.advance_to(0.2);
    assert!((drive.time_s() - 0.5).abs() < 1e-9);
}

#[test]
fn current_and_voltage_stay_within_their_limits() {
    let mut drive = drive();
    let mut limited = false;
    for control in [110.0, -110.0, 0.0].map(Control::Voltage) {
        for _ in 0..500 {
            send(&mut drive, 1, control);
            drive.advance_to(drive.time_s() + 0.001);
            assert!(drive.plant().current_a().abs() < 11.4 * 1.001);
            limited |= drive.telemetry().status.has(Status::CURRENT_LIMIT);
        }
    }
    assert!(limited);
    hold(&mut drive, Control::Voltage(30.0), 1.0);
    assert!(!drive.telemetry().status.has(Status::CURRENT_LIMIT));
    let mut drive = self::limited(|limits| limits.speed_limit_rad_s = 1000.0);
    hold(&mut drive, Control::Voltage(500.0), 3.0);
    let telemetry = drive.telemetry();
    assert!((telemetry.voltage_cmd_v - 120.0).abs() < 1e-12);
    assert!(telemetry.status.has(Status::VOLTAGE_LIMIT));
}

#[test]
fn a_hot_winding_trips() {
    let mut config = EmulatorConfig::embedded("zk-22fc-warming").unwrap();
    config.motor.load_torque_n_m = 100.0;
    config.limits.winding_limit_c = 60.0;
    let mut drive = SoftDrive::new(&config, 1);
    // 2e-3/0.00393 K/(A2.s): 35 K take 0.85 s at 9 A.
    hold(&mut drive, Control::Current(9.0), 0.7);
    assert_eq!(drive.fault(), Fault::None);
    hold(&mut drive, Control::Current(9.0), 0.3);
    assert_eq!(drive.fault(), Fault::OverTemperature);
}

#[test]
fn the_inner_loops_reach_their_set_points() {
    let mut config = plain();
    config.tolerance = 0.1;
    let mut drive = SoftDrive::new(&config, 4);
    hold(&mut drive, Control::Current(3.0), 0.03);
    assert!((drive.plant().current_a() - 3.0).abs() < 0.1);
    for speed in [120.0, -80.0] {
        hold(&mut drive, Control::Speed(speed), 2.0);
        assert!((speed_rad_s(&drive) - speed).abs() < 0.5, "{speed}");
    }
    // A loop takes over from a voltage at the speed that is there.
    hold(&mut drive, Control::Voltage(60.0), 1.0);
    let speed = speed_rad_s(&drive);
    for _ in 0..2000 {
        send(&mut drive, 1, Control::Speed(speed));
        assert!((speed_rad_s(&drive) - speed).abs() < 0.1);
    }
    let mut drive = self::drive();
    let mut highest = 0.0_f64;
    for _ in 0..40_000 {
        send(&mut drive, 1, Control::Speed(250.0));
        highest = highest.max(speed_rad_s(&drive));
    }
    assert!(speed_rad_s(&drive) > 249.0 && highest < 1.1 * 250.0, "{highest}");
}

#[test]
fn repeated_commands_do_not_change_the_inner_loops() {
    let (mut once, mut often) = (drive(), drive());
    send(&mut once, 1, Control::Current(3.0));
    for _ in 0..=400 {
        send(&mut often, 2, Control::Current(3.0));
    }
    once.advance_to(often.time_s());
    let currents = [once.plant().current_a(), often.plant().current_a()];
    assert_eq!(currents[0].to_bits(), currents[1].to_bits(), "{currents:?}");
}

#[test]
fn the_size_of_the_time_steps_makes_no_difference() {
    let (mut fine, mut coarse) = (drive(), drive());
    for drive in [&mut fine, &mut coarse] {
        send(drive, 1, Control::Voltage(24.0));
    }
    for step in 1..=1900 {
        fine.advance_to(f64::from(step) * 1e-4);
    }
    coarse.advance_to(0.19);
    let [fine, coarse] = [fine, coarse].map(|mut drive| drive.telemetry().to_registers());
    assert_eq!(fine, coarse);
}

#[test]
fn registers_refuse_what_the_table_forbids() {
    let mut drive = drive();
    let refused = |result: Result<(), Exception>, expected| assert_eq!(result, Err(expected));
    for (address, count) in [(16, 1), (0, 17), (250, 100)] {
        refused(drive.read(address, &mut vec![0; count]), Exception::IllegalAddress);
    }
    for (address, words) in [(0, &[1][..]), (32, &[1, 3, 0, 0, 0]), (34, &[1]), (64, &[0])] {
        refused(drive.write(address, words), Exception::IllegalAddress);
    }
    for (address, words) in [(33, &[6][..]), (73, &[19]), (73, &[5001]), (32, &[1, 3, 0x8000, 0])] {
        refused(drive.write(address, words), Exception::IllegalValue);
    }
    assert_eq!(drive.state(), State::Disabled);
    assert_eq!(drive.telemetry().seq, 0, "nothing of it had an effect");
}

#[test]
fn a_fault_stays_while_its_cause_is_there() {
    let mut drive = limited(|limits| {
        (limits.speed_limit_rad_s, limits.output_off) = (100.0, OutputOff::Open);
    });
    while drive.state() != State::Fault {
        send(&mut drive, 1, Control::Voltage(60.0));
    }
    send(&mut drive, 2, Control::ResetFault);
    assert!(speed_rad_s(&drive) > 100.0);
    assert_eq!(drive.fault(), Fault::OverSpeed, "still too fast");
    let next = drive.time_s() + 0.1;
    drive.advance_to(next);
    assert!(speed_rad_s(&drive) < 100.0);
    assert_eq!(drive.fault(), Fault::OverSpeed, "latched");
    send(&mut drive, 3, Control::ResetFault);
    assert_eq!(drive.state(), State::Disabled);
}

#[test]
fn the_control_word_alone_brings_no_old_set_point_back() {
    let mut drive = drive();
    send(&mut drive, 1, Control::Voltage(24.0));
    drive.advance_to(1.0);
    assert_eq!(drive.fault(), Fault::Watchdog);
    for word in [2, 3] {
        drive.write(r::CONTROL.address, &[word]).unwrap();
    }
    assert_eq!(drive.state(), State::Running);
    assert!(drive.telemetry().voltage_cmd_v == 0.0);
}

#[test]
fn only_reading_the_status_word_clears_its_command_mark() {
    let mut drive = drive();
    send(&mut drive, 1, Control::Voltage(5.0));
    let mut status = [0];
    drive.read(r::CURRENT.address, &mut [0]).unwrap();
    for expected in [true, false] {
        drive.read(r::STATUS.address, &mut status).unwrap();
        assert_eq!(Status(status[0]).has(Status::COMMAND_APPLIED), expected);
    }
}

/// A drive with one fault from half a second after its start on.
fn faulty(fault: &str) -> SoftDrive {
    let mut config = plain();
    config.faulty = vec![toml::from_str(&format!("{fault}\nfrom_s = 0.5")).unwrap()];
    SoftDrive::new(&config, 1)
}

#[test]
fn a_power_loss_resets_everything() {
    let mut drive = faulty("kind = \"power_lost\"\nfor_s = 0.2");
    let as_set_ms = drive.identity().watchdog_ms;
    assert!(drive.set_watchdog_ms(as_set_ms / 2));
    drive.control_capture(CaptureControl::Start);
    hold(&mut drive, Control::Voltage(20.0), 0.4);
    assert_eq!(drive.capture.state(), CaptureState::Recording);
    drive.advance_to(0.8);
    assert!(drive.is_powered());
    let after = drive.telemetry();
    assert_eq!((after.seq, after.status.state()), (0, Some(State::Disabled)));
    assert!(after.time_us < 200_000, "{}", after.time_us);
    assert_eq!(after.applied_us, 0);
    assert_eq!(drive.capture.state(), CaptureState::Empty);
    assert_eq!(drive.identity().watchdog_ms, as_set_ms);
    assert_eq!(drive.command_block, CommandBlock::default());
}

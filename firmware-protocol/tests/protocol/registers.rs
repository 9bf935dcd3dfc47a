//! The table's own consistency, and the typed views of its blocks.

use crate::support::identity;
use firmware_protocol::registers::{
    self, ANGLE, Access, BUS_VOLTAGE, CURRENT, Kind, SPEED, VOLTAGE, WriteError,
};
use firmware_protocol::{
    CaptureSample, CommandBlock, Control, DriveCommand, Fault, Identity, IdentityError, REGISTERS,
    Register, State, Status, Telemetry,
};

#[test]
fn rows_rise_without_overlap_and_are_found_at_each_word() {
    let mut owners = std::collections::HashMap::new();
    for register in REGISTERS {
        assert!(register.min >= register.kind.lowest() && register.max <= register.kind.highest());
        // What the reference slave in C takes for granted when it reads a written word.
        assert!(register.access == Access::Read || register.kind != Kind::I16, "{}", register.name);
        for copy in 0..register.repeat {
            for word in 0..u16::from(register.kind.words()) {
                let address = register.address + copy * register.stride + word;
                let before = owners.insert(address, register.name);
                assert_eq!(before, None, "{} at {address}", register.name);
                let (found, at) = registers::find(address).unwrap();
                assert_eq!((found.name, u16::from(at)), (register.name, word));
            }
        }
    }
    let free = (0..=u16::MAX).filter(|address| registers::find(*address).is_some());
    let found = free.count();
    assert_eq!(found, owners.len(), "an address without an owner is found");
    assert!(REGISTERS.is_sorted_by_key(|register| register.address));
    let names: std::collections::HashSet<_> = REGISTERS.iter().map(|r| r.name).collect();
    assert_eq!(names.len(), REGISTERS.len());
}

#[test]
fn values_saturate_round_and_say_when_they_are_missing() {
    for (register, value, raw) in [
        (VOLTAGE, 1e9, 32767),
        (VOLTAGE, -1e9, -32767),
        (VOLTAGE, f64::NEG_INFINITY, -32767),
        (CURRENT, 0.014_9, 1),
        (CURRENT, -0.015_1, -2),
        (SPEED, f64::NAN, -32768),
        (BUS_VOLTAGE, f64::NAN, 0xFFFF),
        (BUS_VOLTAGE, 1e9, 0xFFFE),
    ] {
        assert_eq!(register.encode(value), raw, "{} {value}", register.name);
    }
    assert!(SPEED.decode(-32768).is_nan());
    assert_eq!(BUS_VOLTAGE.decode(3).to_string(), "0.3");
}

#[test]
fn halves_of_a_step_cancel() {
    for sign in [-1.0, 1.0] {
        let halves = (1_u16..401).map(|step| sign * f64::from(step) / 200.0);
        let errors = halves.map(|current_a| CURRENT.decode(CURRENT.encode(current_a)) - current_a);
        let mean_a = errors.sum::<f64>() / 400.0;
        assert!(mean_a.abs() < 1e-4, "{mean_a}");
    }
}

#[test]
fn the_angle_wraps_by_its_span_and_never_saturates() {
    let angle = |radian| ANGLE.decode(ANGLE.encode(radian));
    let half = Telemetry::ANGLE_SPAN_RAD / 2.0;
    assert!((angle(half - 1.0) - (half - 1.0)).abs() < 1e-4);
    assert!((angle(half + 1.0) - (1.0 - half)).abs() < 1e-4);
    assert!((angle(-half - 1.0) - (half - 1.0)).abs() < 1e-4);
}

#[test]
fn a_control_word_alone_brings_no_old_set_point_back() {
    use Control::{Disable, Speed, Stop, Voltage};
    let command = |seq, control| Ok(DriveCommand { seq, control });
    let mut block = CommandBlock::default();
    let run = command(7, Voltage(12.0)).unwrap().to_registers();
    for (address, words, wanted, why) in [
        (32, &run[..], command(7, Voltage(12.0)), "a whole block"),
        (33, &[1], command(7, Stop), "stopped"),
        (33, &[3], command(7, Voltage(0.0)), "12 V are forgotten"),
        (34, &[0, 5000], command(7, Voltage(5.0)), "a set-point alone"),
        (33, &[5], command(7, Speed(0.0)), "5 V must not become 5 rad/s"),
        (34, &[0, 5000], command(7, Speed(5.0)), "a set-point alone"),
        (32, &[8], command(8, Speed(5.0)), "a new number alone keeps the rest"),
    ] {
        assert_eq!(block.write(address, words), wanted, "{why}");
    }
    block.forget();
    assert_eq!(block.write(34, &[0, 5000]), command(8, Disable));
    assert_eq!(block.registers(), [8, 0, 0, 0], "no set-point is kept while stopped");
    let half = registers::check_write(35, &[0, 0]);
    assert_eq!(half, Err(WriteError::HalfValue));
    let before = block;
    for (address, words) in [(31, &[0, 0][..]), (33, &[9]), (35, &[1])] {
        assert!(block.write(address, words).is_err());
        assert_eq!(block, before, "a refused write changes nothing");
    }
}

#[test]
fn identity_survives_and_a_stranger_is_named() {
    let block = identity().to_registers();
    assert_eq!(Identity::from_registers(&block), Ok(identity()));
    for (at, word, error) in
        [(0, 0x7777, IdentityError::Magic(0x7777)), (1, 2, IdentityError::Version(2))]
    {
        let mut stranger = block;
        stranger[at] = word;
        assert_eq!(Identity::from_registers(&stranger), Err(error));
    }
}

#[test]
fn codes_of_states_and_faults_are_their_positions() {
    for (code, fault) in (0..).zip(Fault::all()) {
        assert_eq!((fault.code(), Fault::from_code(code)), (code, fault));
    }
    assert_eq!(Fault::from_code(999).code(), 999);
    for state in State::ALL {
        let status = Status::new(*state).with(Status::EMULATOR, true);
        assert_eq!(status.state(), Some(*state));
    }
    assert_eq!(Status(4).state(), None);
}

#[test]
fn captured_samples_stand_in_the_window_as_the_table_says() {
    let sample = CaptureSample { voltage_v: 24.0, current_a: -2.0, speed_rad_s: 10.0 };
    assert_eq!(sample.to_registers(), [2400, 0xFF38, 500]);
    let back = CaptureSample::from_registers(&sample.to_registers());
    assert_eq!(back, sample);
    assert_eq!(registers::CAPTURE_WORDS, 127);
    let fits = |r: &Register| r.repeat == 1 || (r.access == Access::Read && r.kind == Kind::I16);
    assert!(REGISTERS.iter().all(fits));
}

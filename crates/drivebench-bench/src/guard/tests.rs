use proptest::prelude::*;

use super::*;
use crate::testing::{has, near, within};

const PERIOD_S: f64 = 0.01;

fn limits() -> Limits {
    Limits {
        travel_rad: Some(50.0),
        bus_min_v: Some(100.0),
        bus_max_v: Some(160.0),
        ..Limits::zk_22fc()
    }
}

fn with(change: impl FnOnce(&mut Limits)) -> Limits {
    let mut limits = limits();
    change(&mut limits);
    limits
}

fn guard_of(limits: Limits) -> Guard {
    Guard::new(limits, &Nameplate::zk_22fc(), None)
}

fn guard() -> Guard {
    guard_of(limits())
}

impl Guard {
    fn volts(&mut self, now_s: f64, wanted_v: f64) -> f64 {
        self.shape(now_s, Demand::Voltage(wanted_v)).demand.voltage_v().unwrap()
    }

    /// One cycle with a demanded voltage and its reply; the voltage that was sent, V.
    fn cycle(&mut self, now_s: f64, wanted_v: f64, reply: &Sample) -> f64 {
        self.tick(now_s);
        let volts = self.volts(now_s, wanted_v);
        self.watch(now_s, reply, true);
        volts
    }
}

fn at_rad_s(time_s: f64, speed_rad_s: f64) -> Sample {
    sample(time_s).with(Channel::Speed, speed_rad_s)
}

fn sample(time_s: f64) -> Sample {
    let mut sample = Sample::at(time_s)
        .with(Channel::Current, 1.0)
        .with(Channel::Speed, 10.0)
        .with(Channel::Voltage, 5.0)
        .with(Channel::Angle, 0.0)
        .with(Channel::Bus, 140.0);
    sample.state = Some(DriveState::Running);
    sample
}

/// A guard after some healthy cycles at 5 V.
fn running() -> (Guard, f64) {
    let mut guard = guard();
    let mut now_s = 0.0;
    guard.begin(now_s, &sample(now_s));
    for _ in 0..20 {
        now_s += PERIOD_S;
        assert_eq!(guard.tick(now_s), None);
        guard.shape(now_s, Demand::Voltage(5.0));
        assert_eq!(guard.watch(now_s, &sample(now_s), true), None);
    }
    (guard, now_s)
}

/// The trip after at most `cycles` cycles with `change` made to each sample.
fn trip_within(cycles: u32, change: impl Fn(&mut Sample)) -> Option<(u32, Trip)> {
    let (mut guard, mut now_s) = running();
    for cycle in 1..=cycles {
        now_s += PERIOD_S;
        let mut sample = sample(now_s);
        change(&mut sample);
        guard.cycle(now_s, 5.0, &sample);
        if let Some(trip) = guard.tripped() {
            return Some((cycle, trip.clone()));
        }
    }
    None
}

#[test]
fn every_fault_ends_the_run_in_time_with_its_reason() {
    use Channel::{Angle, Bus, Current, Speed, Voltage};
    use TripKind::{
        BusHigh, BusLow, ClockStuck, DriveFault, NotRunning, OverCurrent, OverSpeed, OverVoltage,
        SignalMissing, Travel,
    };
    type Case = (fn(&mut Sample), u32, u32, TripKind, &'static str);
    fn fault(sample: &mut Sample, code: u16, text: Option<&str>) {
        sample.state = Some(DriveState::Fault);
        sample.fault = Some(code);
        sample.fault_text = text.map(Into::into);
    }
    const LOST: &str = "communication loss (comm_loss): the drive's own watchdog has expired";
    let cases: [Case; 16] = [
        (|s| s.set(Current, 22.9), 1, 1, OverCurrent, "A, limit 22.8000 A"),
        (|s| s.set(Current, -22.9), 1, 1, OverCurrent, "A, limit 22.8000 A"),
        (|s| s.set(Speed, -367.0), 1, 1, OverSpeed, "rad/s, limit 366"),
        (|s| s.set(Voltage, 122.0), 1, 1, OverVoltage, "V, limit 121.0000 V"),
        (|s| s.set(Angle, 50.1), 1, 1, Travel, "rad, limit 50.0000 rad"),
        (|s| s.set(Bus, 99.0), 1, 1, BusLow, "V, limit 100.0000 V"),
        (|s| s.set(Bus, 161.0), 1, 1, BusHigh, "V, limit 160.0000 V"),
        (|s| fault(s, 0x12, None), 1, 1, DriveFault, "0x0012"),
        // 0 is no code.
        (|s| fault(s, 0, Some(LOST)), 1, 1, DriveFault, "reports a fault, communication loss"),
        (|s| fault(s, 0, None), 1, 1, DriveFault, "no code"),
        (|s| fault(s, 0x81, Some(LOST)), 1, 1, DriveFault, "code 0x0081: communication loss"),
        (|s| s.set(Current, f64::NAN), 3, 3, SignalMissing, "no current"),
        (|s| s.time_s = 0.2, 3, 3, ClockStuck, "drive time stays at 0.200 s"),
        (|s| s.time_s = f64::NAN, 3, 3, ClockStuck, "drive time stays"),
        (|s| s.state = Some(DriveState::Ready), 1, 7, NotRunning, "\"ready\""),
        (|s| s.state = Some(DriveState::Disabled), 1, 7, NotRunning, "\"disabled\""),
    ];
    for (change, least, most, kind, words) in cases {
        let (cycle, trip) = trip_within(20, change).unwrap_or_else(|| panic!("{words}: no trip"));
        assert_eq!(trip.kind, kind, "{trip:?}");
        assert!((least..=most).contains(&cycle), "{cycle}: {trip:?}");
        has(&trip.reason, words);
    }
    assert_eq!(trip_within(50, |sample| sample.set(Current, 22.7)), None);
}

#[test]
fn a_jump_of_the_drives_clock_is_a_restart() {
    // After a restart its counter is behind or ahead, by the time that it was on before.
    for jump_s in [-1.0, -0.13, 0.2, 1294.97, -2147.0, 2147.0] {
        let jumped = trip_within(9, |sample| sample.time_s += jump_s);
        let (cycle, trip) = jumped.unwrap_or_else(|| panic!("{jump_s} s is no restart"));
        assert_eq!((cycle, trip.kind), (1, TripKind::Restarted), "{jump_s}");
        has(&trip.reason, "switched off and on again");
    }
    // The largest jump by a delayed reply.
    assert_eq!(trip_within(9, |sample| sample.time_s += 0.09), None);
    // Both clocks continue while replies are lost.
    let (mut guard, now_s) = running();
    let later_s = now_s + 0.095;
    guard.tick(later_s);
    assert_eq!(guard.watch(later_s, &sample(later_s), true), None);
    assert!(!guard.is_of_a_restart(later_s, &sample(later_s)));
    assert!(guard.is_of_a_restart(later_s, &sample(later_s + 5.0)));
}

#[test]
fn a_drive_is_given_the_time_that_it_may_take_to_run() {
    let mut guard = guard().with_enable_time(4.0);
    guard.begin(0.0, &sample(0.0));
    let mut now_s = 0.0;
    while now_s < 10.0 && guard.tripped().is_none() {
        now_s += PERIOD_S;
        let mut sample = sample(now_s);
        sample.state = Some(DriveState::Ready);
        guard.cycle(now_s, 0.0, &sample);
    }
    assert_eq!(guard.tripped().unwrap().kind, TripKind::NotRunning);
    within(now_s, 4.0..4.1);
}

#[test]
fn silence_of_the_link_and_a_stall_of_the_host_are_distinct() {
    for (cycles, after_s, kind) in [
        (9, 0.02, TripKind::LinkSilence),
        (0, 5.0, TripKind::HostGap),
        (0, -1.0, TripKind::ClockStuck),
    ] {
        let (mut guard, mut now_s) = running();
        for _ in 0..cycles {
            now_s += PERIOD_S;
            assert_eq!(guard.tick(now_s), None);
        }
        assert_eq!(guard.tick(now_s + after_s).unwrap().kind, kind);
    }
}

#[test]
fn the_time_limit_counts_the_time_with_the_output_on_only() {
    let mut guard = guard_of(with(|limits| limits.time_s = 1.0));
    guard.begin(0.0, &sample(0.0));
    let mut on_cycles = 0;
    for cycle in 1..1000 {
        let now_s = f64::from(cycle) * PERIOD_S;
        if guard.tick(now_s).is_some() {
            break;
        }
        // On for half of the time.
        let is_on = cycle % 2 == 0;
        on_cycles += u32::from(is_on);
        guard.shape(now_s, if is_on { Demand::Voltage(1.0) } else { Demand::Disable });
        guard.watch(now_s, &sample(now_s), true);
    }
    assert_eq!(guard.tripped().unwrap().kind, TripKind::TimeLimit);
    assert!((100..=102).contains(&on_cycles), "{on_cycles}");
}

#[test]
fn a_voltage_step_is_capped_unless_the_drive_limits() {
    // 22.8 A times 1.1 ohm.
    for (drive_limit_a, first_v) in [(None, 25.08), (Some(100.0), 25.08), (Some(20.0), 60.0)] {
        let fast = with(|limits| limits.slew_v_per_s = 1e9);
        let mut guard = Guard::new(fast, &Nameplate::zk_22fc(), drive_limit_a);
        guard.begin(0.0, &sample(0.0));
        guard.watch(0.0, &at_rad_s(0.0, 0.0), true);
        let shaped = guard.shape(PERIOD_S, Demand::Voltage(60.0));
        near(shaped.demand.voltage_v().unwrap(), first_v, 1e-9);
        assert_eq!(shaped.causes.winding, drive_limit_a != Some(20.0));
    }
}

/// Voltages, V, when 60 V are reversed within a slew limit that allows it at once, and no reply comes after one with 10 rad/s.
fn unobserved(mut guard: Guard) -> Vec<f64> {
    guard.begin(0.0, &sample(0.0));
    guard.set_slew(Some(1e6));
    guard.shape(0.0, Demand::Voltage(60.0));
    guard.watch(0.001, &sample(0.0), true);
    let wanted_v = |cycle| if cycle < 4 { 60.0 } else { -60.0 };
    (1..12).map(|cycle| guard.volts(f64::from(cycle) * PERIOD_S, wanted_v(cycle))).collect()
}

#[test]
fn an_unobserved_shaft_is_braked_within_the_limit() {
    let winding_v = limits().current_a * 1.1;
    let measured_v = 0.3538 * 10.0;
    let known = unobserved(guard().with_period(PERIOD_S));
    near(known[2], measured_v + winding_v, 1e-9);
    // By now its back-EMF may be those 28 V, or more under a pulling load: the limit holds from there.
    let load_v = 1.1 * 0.455 / 0.3538;
    for volts in &known[3..] {
        near(*volts, measured_v + load_v, 1e-9);
    }
    // A repeated reading, with the same stamp, has no information on the present speed.
    let mut repeated = guard().with_period(PERIOD_S);
    repeated.watch(-PERIOD_S, &sample(-PERIOD_S), false);
    let repeats = |guard: &mut Guard, now_s| {
        guard.shape(now_s, Demand::Voltage(60.0));
        guard.watch(now_s, &sample(0.0), true);
    };
    repeated.begin(0.0, &sample(0.0));
    repeated.set_slew(Some(1e6));
    for cycle in 0..3 {
        repeats(&mut repeated, f64::from(cycle) * PERIOD_S);
    }
    near(repeated.volts(3.0 * PERIOD_S, -60.0), known[3], 1e-9);
    // Without the period an old speed remains valid, and twice the limit would flow.
    near(unobserved(guard())[3], measured_v - winding_v, 1e-9);
}

#[test]
fn after_coasting_the_voltage_begins_at_the_back_emf() {
    let (mut guard, now_s) = running();
    guard.shape(now_s + 0.01, Demand::Disable);
    guard.watch(now_s + 0.01, &at_rad_s(now_s + 0.01, 200.0), true);
    let shaped = guard.shape(now_s + 0.02, Demand::Voltage(0.0));
    near(shaped.demand.voltage_v().unwrap(), 200.0 * 0.3538, 4.0);
    assert!(shaped.causes.slew);
}

#[test]
fn at_rest_the_noise_of_the_speed_is_no_first_command() {
    // 1 % of 366 rad/s counts as at rest.
    for (speed_rad_s, first_v) in [(0.4, 0.0), (-3.6, 0.0), (-3.7, -3.7 * 0.3538)] {
        let mut guard = guard();
        guard.begin(0.0, &sample(0.0));
        guard.watch(0.0, &at_rad_s(0.0, speed_rad_s), true);
        near(guard.volts(0.0, 0.0), first_v, 1e-9);
    }
}

#[test]
fn travel_counts_from_the_first_angle() {
    let mut guard = guard();
    guard.begin(0.0, &sample(0.0).with(Channel::Angle, f64::NAN));
    for (time_s, angle_rad) in [(0.01, 7.0), (0.02, 56.9)] {
        guard.cycle(time_s, 5.0, &sample(time_s).with(Channel::Angle, angle_rad));
        assert_eq!(guard.tripped(), None, "{angle_rad}");
    }
    guard.cycle(0.03, 5.0, &sample(0.03).with(Channel::Angle, 57.1));
    assert_eq!(guard.tripped().unwrap().kind, TripKind::Travel);
}

#[test]
fn a_trip_stays_and_an_unknown_speed_is_no_rest() {
    let (mut guard, now_s) = running();
    guard.watch(now_s, &sample(now_s).with(Channel::Current, 30.0), true);
    assert_eq!(guard.shape(now_s, Demand::Voltage(5.0)).demand, Demand::Stop);
    // A second cause does not replace the first.
    guard.watch(now_s, &at_rad_s(now_s, 900.0), true);
    assert_eq!(guard.tripped().unwrap().kind, TripKind::OverCurrent);
    assert_eq!(guard.shape(now_s, Demand::Voltage(5.0)).demand, Demand::Stop);
    assert_eq!(guard.check_rest(&sample(now_s)), Err(RestError::State { state: "running" }));
    let mut rest = at_rad_s(now_s, 100.0);
    rest.state = Some(DriveState::Disabled);
    assert!(matches!(guard.check_rest(&rest), Err(RestError::Moving { .. })));
    rest.set(Channel::Speed, 0.1);
    rest.set(Channel::Current, 0.1);
    // A missing signal may have any value.
    for channel in [Channel::Speed, Channel::Current] {
        let unread = guard.check_rest(&rest.clone().with(channel, f64::NAN));
        assert_eq!(unread, Err(RestError::Unread { name: channel.name() }));
    }
    assert_eq!(guard.check_rest(&rest), Ok(()));
}

fn anything() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => -500.0..500.0f64,
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
        1 => Just(-1e300),
    ]
}

fn any_demand() -> impl Strategy<Value = Demand> {
    prop_oneof![
        8 => anything().prop_map(Demand::Voltage),
        1 => anything().prop_map(Demand::Current),
        1 => anything().prop_map(Demand::Speed),
        1 => Just(Demand::Disable),
    ]
}

/// `(cycle length, demand, current, speed, reply arrives)`.
fn any_cycle() -> impl Strategy<Value = (f64, Demand, f64, f64, bool)> {
    let plausible = prop_oneof![30 => -20.0..20.0f64, 1 => anything()];
    (
        prop_oneof![20 => Just(PERIOD_S), 1 => 0.0..0.2f64],
        any_demand(),
        plausible.clone(),
        plausible,
        prop::bool::weighted(0.9),
    )
}

proptest! {
    /// For every input: after a trip every command is zero output, and no command is ever beyond a limit.
    #[test]
    fn no_command_is_beyond_a_limit_and_none_energises_after_a_trip(
        cycles in prop::collection::vec(any_cycle(), 1..200),
    ) {
        let mut guard = guard().with_period(PERIOD_S);
        let limits = limits();
        let mut now_s = 0.0;
        let mut output_v: f64 = 0.0;
        guard.begin(now_s, &sample(now_s));
        for (step_s, demand, current, speed, arrives) in cycles {
            now_s += step_s;
            guard.tick(now_s);
            let was_tripped = guard.tripped().is_some();
            let shaped = guard.shape(now_s, demand);
            if was_tripped {
                prop_assert!(!shaped.demand.energises());
                continue;
            }
            match shaped.demand {
                Demand::Voltage(volts) => {
                    prop_assert!(volts.abs() <= limits.voltage_v);
                    let jump = (volts - output_v).abs();
                    // From off the output begins at the back-EMF, without a jump of the terminals.
                    let from_off = 0.3538 * 500.0;
                    let was_on = output_v.to_bits() != 0;
                    prop_assert!(
                        jump <= limits.slew_v_per_s * step_s.min(0.05) + 1e-9 || (!was_on && jump <= from_off),
                        "{jump} V in {step_s} s"
                    );
                    output_v = volts;
                }
                Demand::Current(amps) => {
                    prop_assert!(amps.abs() <= limits.current_a);
                    output_v = 0.0;
                }
                Demand::Speed(speed) => {
                    prop_assert!(speed.abs() <= limits.speed_rad_s);
                    output_v = 0.0;
                }
                _ => output_v = 0.0,
            }
            if demand != shaped.demand && !matches!(demand, Demand::Voltage(v) if v == 0.0) {
                prop_assert!(shaped.causes.any(), "a silent change of {demand:?} to {:?}", shaped.demand);
            }
            if arrives {
                let mut sample = sample(now_s);
                sample.set(Channel::Current, current);
                sample.set(Channel::Speed, speed);
                guard.watch(now_s, &sample, true);
                if current.abs() > limits.current_a && current.is_finite() {
                    prop_assert!(guard.tripped().is_some());
                }
            }
        }
    }
}

proptest! {
    /// Whatever speed is measured while stopping, old, absurd or none: the output only falls, and is zero when its time is over.
    #[test]
    fn no_speed_holds_the_output_up_while_stopping(
        volts in -100.0..100.0f64,
        speeds in prop::collection::vec(prop_oneof![
            4 => (-400.0..400.0f64).prop_map(Some),
            1 => Just(Some(f64::NAN)),
            1 => Just(Some(1e300)),
            1 => Just(None),
        ], 1..40),
        braking_w in prop_oneof![Just(None), Just(Some(0.0)), Just(Some(60.0))],
        falls in any::<bool>(),
    ) {
        let limits = Limits { braking_w, speed_rad_s: 1e9, ..limits() };
        let mut guard = guard_of(limits).with_period(PERIOD_S);
        guard.begin(0.0, &sample(0.0));
        let mut now_s = 0.0;
        let mut output_v = 0.0;
        for n in 0..100 {
            now_s += PERIOD_S;
            guard.tick(now_s);
            output_v = guard.volts(now_s, volts);
            let speed = if n < 99 { output_v / 0.3538 } else { 250.0 };
            guard.watch(now_s, &at_rad_s(now_s, speed), true);
        }
        guard.begin_stop(now_s);
        let by_s = now_s + guard.ramp_down_s();
        let mut measured = speeds.iter().cycle();
        let mut fall = 300.0_f64;
        while now_s < by_s {
            now_s += PERIOD_S;
            guard.tick(now_s);
            let next_v = guard.volts(now_s, 0.0);
            prop_assert!(next_v.abs() <= output_v.abs() + 1e-12 && next_v * output_v >= 0.0, "{output_v} {next_v}");
            output_v = next_v;
            fall -= 0.1;
            let speed = if falls { Some(fall) } else { *measured.next().unwrap() };
            guard.watch(now_s, &at_rad_s(now_s, speed.unwrap_or(f64::NAN)), false);
        }
        prop_assert!(output_v.abs() < 1e-9, "{output_v} V remain");
    }
}

#[test]
fn a_heavy_load_is_braked_within_the_limit() {
    let limits = with(|limits| (limits.current_a, limits.slew_v_per_s) = (10.0, 400.0));
    let mut guard = guard_of(limits).with_period(PERIOD_S);
    guard.begin(0.0, &sample(0.0));
    let (mut now_s, mut speed) = (0.0, 150.0);
    let mut most_a: f64 = 0.0;
    // Running at 150 rad/s with the current of the friction.
    for _ in 0..50 {
        now_s += PERIOD_S;
        guard.tick(now_s);
        guard.volts(now_s, 0.3538 * speed + 1.4);
        guard.watch(now_s, &at_rad_s(now_s, speed), false);
    }
    guard.begin_stop(now_s);
    let by_s = now_s + guard.ramp_down_s();
    while now_s < by_s {
        now_s += PERIOD_S;
        guard.tick(now_s);
        let amps = (guard.volts(now_s, 0.0) - 0.3538 * speed) / 1.1;
        most_a = most_a.max(amps.abs());
        // Twice the inertia of the nameplate.
        speed = (speed + (0.3538 * amps - 0.455) / 0.009 * PERIOD_S).max(0.0);
        guard.watch(now_s, &at_rad_s(now_s, speed), false);
    }
    within(speed, ..1.0);
    within(most_a, 9.0..10.5);
}

/// A guard that runs at this speed, with limits of its own.
fn at_speed(limits: Limits, speed_rad_s: f64) -> Guard {
    let mut guard = Guard::new(limits, &Nameplate::zk_22fc(), Some(0.0));
    guard.begin(0.0, &sample(0.0));
    guard.watch(0.0, &at_rad_s(0.0, speed_rad_s), true);
    guard
}

#[test]
fn a_supply_without_sink_holds_the_back_emf() {
    let one_way = with(|limits| limits.braking_w = Some(0.0));
    let mut guard = at_speed(one_way.clone(), 200.0);
    let emf = 0.3538 * 200.0;
    let shaped = guard.shape(0.01, Demand::Voltage(0.0));
    near(shaped.demand.voltage_v().unwrap(), emf, 0.1);
    assert!(shaped.causes.supply, "{shaped:?}");
    let shaped = guard.shape(0.02, Demand::Voltage(emf + 1.0));
    assert!(!shaped.causes.supply, "driving is free: {shaped:?}");
    assert!(guard.ramp_down_s() > at_speed(limits(), 0.0).ramp_down_s() + 2.0);
    // A reference of speed falls as friction brakes: 0.455 N.m on 0.0045 kg.m2.
    let mut guard = at_speed(one_way, 200.0);
    guard.shape(0.01, Demand::Speed(200.0));
    let Demand::Speed(next) = guard.shape(0.02, Demand::Speed(0.0)).demand else {
        panic!("a speed stays a speed");
    };
    near(200.0 - next, 1.01, 0.05);
}

#[test]
fn a_bridge_gets_no_demand_outside_its_quadrants() {
    use Demand::{Current, Speed, Voltage};
    let of = |quadrants, demand| {
        let shaped = at_speed(with(|limits| limits.quadrants = quadrants), 0.0).shape(0.04, demand);
        (shaped.demand, shaped.causes.quadrant)
    };
    for (quadrants, wanted, sent) in [
        (1, Voltage(-5.0), Voltage(0.0)),
        (1, Speed(-5.0), Speed(0.0)),
        (2, Current(-5.0), Current(0.0)),
        (2, Speed(-5.0), Speed(-5.0)),
        (4, Current(-5.0), Current(-5.0)),
    ] {
        assert_eq!(of(quadrants, wanted), (sent, wanted != sent));
    }
}

#[test]
fn a_lost_field_is_a_trip_of_its_own() {
    let watched = with(|limits| limits.field_min_a = Some(0.3));
    let lost = Some(TripKind::FieldLost);
    for (field_a, state, trip) in [
        (Some(1.0), DriveState::Running, None),
        (Some(0.1), DriveState::Running, lost),
        (Some(0.1), DriveState::Fault, lost),
        (None, DriveState::Fault, lost),
        // A slow reading that is still to be updated.
        (None, DriveState::Running, None),
    ] {
        let mut sample = sample(0.01);
        (sample.field_a, sample.state) = (field_a, Some(state));
        let mut guard = at_speed(watched.clone(), 10.0);
        let found = guard.watch(0.01, &sample, true).map(|trip| trip.kind);
        assert_eq!(found, trip, "{field_a:?} {state:?}");
    }
}

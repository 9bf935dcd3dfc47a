//! Both links of our own drive against drives that answer late, twice, damaged, in another's name, or not at all.

use std::time::Duration;

use firmware_protocol::stream::{ErrorCode, Message, Refusal};
use firmware_protocol::{DriveCommand, Telemetry};

use super::fake::{Asked, Fake, Language, Say, identity_block, rtu_frame, stream_frame};
use super::register_bus::RegisterTable;
use super::waiting::now;
use super::{DriveLink, DriveProfile, LinkError, ModbusLink, open_modbus, open_stream, stream};
use crate::sample::{Channel, Command, Demand, Sample};

/// Long enough for a loaded machine, where an answer is to be awaited.
const PATIENT_MS: f64 = 3000.0;
/// Short, where the answer does not come.
const BRIEF_MS: f64 = 150.0;

type Link = Box<dyn DriveLink>;

fn profile(deadline_ms: f64) -> DriveProfile {
    let mut profile = DriveProfile::named("own").unwrap();
    profile.link.deadline_ms = Some(deadline_ms);
    profile
}

fn modbus(fake: &Fake, deadline_ms: f64) -> ModbusLink {
    open_modbus(&fake.target, &profile(deadline_ms), now(), None).unwrap()
}

fn stream(fake: &Fake, deadline_ms: f64) -> Link {
    Box::new(open_stream(&fake.target, &profile(deadline_ms), now(), None).unwrap())
}

fn rtu(script: impl FnMut(Asked) -> Vec<Say> + Send + 'static) -> Fake {
    Fake::over_pty(Language::Rtu, identity_block(), script)
}

/// A drive that speaks the stream, and its link.
fn streaming(
    deadline_ms: f64,
    script: impl FnMut(Asked) -> Vec<Say> + Send + 'static,
) -> (Fake, Link) {
    let fake = Fake::over_pty(Language::Stream, identity_block(), script);
    let link = stream(&fake, deadline_ms);
    (fake, link)
}

fn honest(asked: Asked) -> Vec<Say> {
    vec![Say::Bytes(asked.honest)]
}

/// Answers command `number` as `script` says, everything else honestly.
fn at_command(
    number: usize,
    mut script: impl FnMut(Vec<u8>) -> Vec<Say> + Send + 'static,
) -> impl FnMut(Asked) -> Vec<Say> + Send + 'static {
    move |asked| {
        if asked.command == number {
            script(asked.honest)
        } else {
            honest(asked)
        }
    }
}

/// Says nothing to these commands.
fn silent_at(commands: std::ops::Range<usize>) -> impl FnMut(Asked) -> Vec<Say> + Send + 'static {
    move |asked| {
        if commands.contains(&asked.command) {
            Vec::new()
        } else {
            honest(asked)
        }
    }
}

/// The reply to command 3 comes with the answer to whatever is asked next, as of a device that was busy.
fn late_at_3() -> impl FnMut(Asked) -> Vec<Say> + Send + 'static {
    let mut held = None;
    move |asked| {
        if asked.command == 3 {
            held = Some(asked.honest);
            return Vec::new();
        }
        let late = held.take().map(Say::Bytes).into_iter();
        late.chain([Say::Bytes(asked.honest)]).collect()
    }
}

fn volts(seq: u64) -> Command {
    Command {
        seq,
        demand: Demand::Voltage(seq as f64 * 0.5),
    }
}

/// Every sample must be that of its own command: the toy's voltage and current tell which one it was.
fn is_its_own(sample: &Sample, seq: u64) -> bool {
    let near = |channel, value: f64| {
        let found = sample.get(channel);
        found.is_some_and(|found| (found - value).abs() < 1e-4)
    };
    sample.seq == Some(seq)
        && sample.applied.is_some_and(|applied| applied.seq == seq)
        && near(Channel::Voltage, seq as f64 * 0.5)
        && near(Channel::Current, seq as f64 * 0.01)
}

/// Ten exchanges; returns the errors by number. No wrong sample is ever delivered, and the books balance.
fn ten_exchanges(link: &mut dyn DriveLink) -> Vec<(u64, LinkError)> {
    let mut errors = Vec::new();
    for seq in 1..=10 {
        match link.exchange(volts(seq)) {
            Ok(sample) => assert!(is_its_own(&sample, seq), "{seq}: {sample:?}"),
            Err(error) => errors.push((seq, error)),
        }
        assert!(link.statistics().balances(), "{:?}", link.statistics());
    }
    errors
}

#[test]
fn identity_limits_and_time_origin_are_read() {
    let fake = rtu(honest);
    let mut link = modbus(&fake, PATIENT_MS);
    let identity = link.identify().unwrap();
    assert_eq!(identity.serial_number, "4711");
    assert_eq!([identity.vendor, identity.firmware], ["toy", "toy"]);
    assert!(
        !identity.is_emulator,
        "only the drive's own word makes it an emulator"
    );
    assert_eq!(identity.watchdog_s, Some(0.25));
    assert_eq!(identity.current_limit_a, Some(11.4));
    assert_eq!(identity.voltage_limit_v, None);
    // The toy's clock comes round on the seventh command.
    for seq in 1..=10 {
        let sample = link.exchange(volts(seq)).unwrap();
        let expected_s = seq as f64 * 0.01;
        assert!((sample.time_s - expected_s).abs() < 1e-9);
        let applied = sample.applied.unwrap();
        assert!((applied.time_s - (expected_s - 1e-4)).abs() < 1e-9);
    }
    assert_eq!(link.round_trips().unwrap().count(), link.statistics().ok);
    assert_eq!(link.statistics().lost(), 0);
}

#[test]
fn identity_and_time_origin_are_read_over_the_stream() {
    let over_tcp = Fake::over_tcp(Language::Stream, honest);
    let over_tcp = (stream(&over_tcp, PATIENT_MS), over_tcp);
    let (fake, link) = streaming(PATIENT_MS, honest);
    for (mut link, _fake) in [(link, fake), over_tcp] {
        let identity = link.identify().unwrap();
        assert_eq!(identity.serial_number, "4711");
        assert_eq!(identity.firmware, "2.3");
        assert_eq!(identity.watchdog_s, Some(0.25));
        let sample = link.exchange(volts(1)).unwrap();
        assert!((sample.time_s - 0.01).abs() < 1e-9);
        assert!(ten_exchanges(&mut *link).is_empty());
        assert_eq!(link.statistics().lost(), 0);
        assert_eq!(link.round_trips().unwrap().count(), 12);
    }
}

#[test]
fn another_version_and_another_map_are_refused() {
    let mut block = identity_block();
    let mut refused = |at: usize, word| {
        block[at] = word;
        let fake = Fake::over_pty(Language::Rtu, block, honest);
        modbus(&fake, PATIENT_MS).identify().unwrap_err()
    };
    let version = refused(1, 9);
    let is_nine = matches!(
        version,
        LinkError::Version {
            found: 9,
            expected: 1,
            ..
        }
    );
    assert!(is_nine, "{version}");
    let map = refused(0, 0);
    assert!(matches!(map, LinkError::Identity { .. }), "{map}");
}

#[test]
fn a_late_reply_never_becomes_the_next_value() {
    let fake = rtu(late_at_3());
    let mut link = modbus(&fake, BRIEF_MS);
    let errors = ten_exchanges(&mut link);
    assert!(
        matches!(errors[0], (3, LinkError::Timeout { .. })),
        "{errors:?}"
    );
    assert!(errors.len() <= 2, "{errors:?}");
    assert!(link.statistics().timeout >= 1);
}

#[test]
fn over_tcp_a_late_reply_is_dropped_by_its_transaction() {
    let fake = Fake::over_tcp(Language::Tcp, late_at_3());
    let errors = ten_exchanges(&mut modbus(&fake, BRIEF_MS));
    assert!(
        matches!(errors[..], [(3, LinkError::Timeout { .. })]),
        "{errors:?}"
    );
}

#[test]
fn late_and_repeated_answers_of_the_stream_never_become_a_value() {
    let mut held = None;
    let (_fake, mut link) = streaming(BRIEF_MS, move |asked| match asked.command {
        3 => {
            held = Some(asked.honest);
            Vec::new()
        }
        4 => vec![
            Say::Bytes(held.take().unwrap()),
            Say::Bytes(asked.honest.clone()),
            Say::Bytes(asked.honest),
        ],
        _ => honest(asked),
    });
    let errors = ten_exchanges(&mut *link);
    assert!(
        matches!(errors[..], [(3, LinkError::Timeout { .. })]),
        "{errors:?}"
    );
}

#[test]
fn a_drive_that_lags_by_one_reply_is_resynchronised() {
    // Every reply is held back until the next request, for six requests.
    let mut held: Option<Vec<u8>> = None;
    let mut count = 0;
    let fake = rtu(move |asked| {
        count += 1;
        if (4..10).contains(&count) {
            let before = held.replace(asked.honest);
            before.map(Say::Bytes).into_iter().collect()
        } else {
            honest(asked)
        }
    });
    let mut link = modbus(&fake, BRIEF_MS);
    let errors = ten_exchanges(&mut link);
    assert!(!errors.is_empty() && errors.len() <= 7, "{errors:?}");
    assert!(link.exchange(volts(11)).is_ok());
}

#[test]
fn a_reply_that_comes_after_the_deadline_is_waited_out() {
    let late = |reply| vec![Say::WaitMs(300), Say::Bytes(reply)];
    let fake = rtu(at_command(2, late));
    let errors = ten_exchanges(&mut modbus(&fake, BRIEF_MS));
    assert_eq!(errors[0].0, 2);
    assert!(errors.len() <= 3, "{errors:?}");
}

#[test]
fn a_reply_of_an_older_command_is_stale() {
    let mut old = Vec::new();
    let fake = rtu(move |asked| match asked.command {
        4 => {
            old.clone_from(&asked.honest);
            honest(asked)
        }
        5 => vec![Say::Bytes(old.clone())],
        _ => honest(asked),
    });
    let mut link = modbus(&fake, BRIEF_MS);
    let errors = ten_exchanges(&mut link);
    assert!(
        matches!(errors[..], [(5, LinkError::Stale { .. })]),
        "{errors:?}"
    );
    assert_eq!(link.statistics().stale, 1);
}

/// What is done to the reply to command 4 and costs no exchange; bytes that are dropped, and old frames that are counted.
#[test]
fn copies_garbage_and_pieces_cost_nothing() {
    type Case = (&'static str, fn(Vec<u8>) -> Vec<Say>, u64, u64);
    const GARBAGE: [u8; 6] = [0x01, 0x17, 0x20, 0xFF, 0x00, 0x55];
    let cases: [Case; 4] = [
        // The copy is dropped before the next request, or, where it comes after that, known by its number.
        (
            "twice",
            |r| vec![Say::Bytes(r.clone()), Say::Bytes(r)],
            37,
            1,
        ),
        (
            "garbage before",
            |r| vec![Say::Bytes(GARBAGE.to_vec()), Say::Bytes(r)],
            6,
            0,
        ),
        (
            "garbage behind",
            |r| vec![Say::Bytes(r), Say::Bytes(GARBAGE.to_vec())],
            6,
            0,
        ),
        (
            "in pieces",
            |mut r| {
                let rest = r.split_off(11);
                vec![Say::Bytes(r), Say::WaitMs(50), Say::Bytes(rest)]
            },
            0,
            0,
        ),
    ];
    for (name, script, dropped, stale) in cases {
        let fake = rtu(at_command(4, script));
        let mut link = modbus(&fake, PATIENT_MS);
        let errors = ten_exchanges(&mut link);
        assert!(errors.is_empty(), "{name}: {errors:?}");
        let line = link.line().unwrap();
        assert_eq!(
            (line.bytes_dropped, line.stale_frames),
            (dropped, stale),
            "{name}"
        );
    }
}

/// What becomes of a reply, and the class of the error that it costs.
type Damage = (&'static str, fn(Vec<u8>) -> Vec<u8>, fn(&LinkError) -> bool);

fn is_corrupt(error: &LinkError) -> bool {
    matches!(error, LinkError::Corrupt { .. })
}

fn is_mismatch(error: &LinkError) -> bool {
    matches!(error, LinkError::Mismatch { .. })
}

fn cut(mut reply: Vec<u8>) -> Vec<u8> {
    reply.truncate(20);
    reply
}

fn flipped(mut reply: Vec<u8>) -> Vec<u8> {
    reply[12] ^= 4;
    reply
}

#[test]
fn damage_and_foreign_frames_cost_their_cycle_and_have_their_class() {
    let without = |mut reply: Vec<u8>| {
        reply.remove(9);
        reply
    };
    let cases: [Damage; 5] = [
        ("truncated", cut, is_corrupt),
        ("one byte lost", without, is_corrupt),
        ("bit flipped", flipped, is_corrupt),
        (
            "other unit",
            |r| rtu_frame(2, &r[1..r.len() - 2]),
            is_mismatch,
        ),
        (
            "other function",
            |r| rtu_frame(1, &[&[3], &r[2..r.len() - 2]].concat()),
            is_mismatch,
        ),
    ];
    for (name, damage, class) in cases {
        let fake = rtu(at_command(4, move |reply| vec![Say::Bytes(damage(reply))]));
        let errors = ten_exchanges(&mut modbus(&fake, BRIEF_MS));
        assert_eq!(errors[0].0, 4, "{name}");
        assert!(class(&errors[0].1), "{name}: {}", errors[0].1);
        assert!(errors.len() <= 2, "{name}: {errors:?}");
    }
}

#[test]
fn damage_garbage_and_foreign_answers_of_the_stream_have_their_class() {
    let identity = |_| {
        stream_frame(
            4,
            0,
            Message::Identity(firmware_protocol::Identity::default()),
        )
    };
    let telemetry = |_| stream_frame(3, 0, Message::Telemetry(Telemetry::default()));
    let cases: [Damage; 5] = [
        ("bit flipped", flipped, is_corrupt),
        ("truncated", cut, is_corrupt),
        ("garbage instead", |_| vec![7; 30], is_corrupt),
        ("an identity instead", identity, is_mismatch),
        ("another number", telemetry, |e| {
            matches!(e, LinkError::Stale { .. })
        }),
    ];
    for (name, damage, class) in cases {
        let script = at_command(4, move |reply| vec![Say::Bytes(damage(reply))]);
        let (_fake, mut link) = streaming(BRIEF_MS, script);
        let errors = ten_exchanges(&mut *link);
        assert_eq!(errors[0].0, 4, "{name}");
        assert!(class(&errors[0].1), "{name}: {}", errors[0].1);
        // A frame without its end takes nothing with it.
        assert_eq!(errors.len(), 1, "{name}: {errors:?}");
    }
}

#[test]
fn a_refusal_has_its_name_and_the_link_lives_on() {
    let fake = rtu(at_command(4, |_| {
        vec![Say::Bytes(rtu_frame(1, &[0x97, 6]))]
    }));
    let refusal = Refusal {
        kind: 2,
        code: ErrorCode::NotSupported,
    };
    let (_fake, streaming) = streaming(
        PATIENT_MS,
        at_command(4, move |_| {
            vec![Say::Bytes(stream_frame(4, 0, Message::Error(refusal)))]
        }),
    );
    let modbus: Link = Box::new(modbus(&fake, PATIENT_MS));
    for (mut link, text) in [
        (modbus, "exception 0x06 device busy"),
        (streaming, "exception 0x04 not supported"),
    ] {
        let errors = ten_exchanges(&mut *link);
        let said: Vec<String> = errors.iter().map(|(_, error)| error.to_string()).collect();
        let (_, said) = said[0].split_once(": ").unwrap();
        assert_eq!(said, format!("the drive refused the command: {text}"));
        assert_eq!((errors.len(), link.statistics().exception), (1, 1));
    }
}

#[test]
fn silence_ends_at_the_deadline() {
    let fake = rtu(silent_at(3..usize::MAX));
    let (_fake, streaming) = streaming(BRIEF_MS, silent_at(3..usize::MAX));
    let modbus: Link = Box::new(modbus(&fake, BRIEF_MS));
    for (mut link, least_ms, told_ms) in [(modbus, 140, 140..3000), (streaming, 149, 150..151)] {
        link.exchange(volts(1)).unwrap();
        link.exchange(volts(2)).unwrap();
        let start = now();
        let error = link.exchange(volts(3)).unwrap_err();
        let took = start.elapsed();
        let is_told = |error: &LinkError| matches!(error, LinkError::Timeout { deadline_ms, .. } if told_ms.contains(deadline_ms));
        assert!(is_told(&error), "{error}");
        assert!(took >= Duration::from_millis(least_ms), "{took:?}");
        assert!(took < Duration::from_secs(3), "{took:?}");
        // One that is bounded tells the time that it had.
        link.bound(0.08);
        let error = link.exchange(volts(4)).unwrap_err();
        let is_told = matches!(error, LinkError::Timeout { deadline_ms, .. } if deadline_ms < 100);
        assert!(is_told, "{error}");
    }
}

#[test]
fn a_line_that_babbles_is_given_up_in_time() {
    let fake = rtu(|asked| {
        if asked.command < 2 {
            return honest(asked);
        }
        let babble = || [Say::Bytes(vec![0xA5; 64]), Say::WaitMs(1)];
        (0..3000).flat_map(|_| babble()).collect()
    });
    let mut link = modbus(&fake, BRIEF_MS);
    link.exchange(volts(1)).unwrap();
    for seq in 2..4 {
        let start = now();
        let error = link.exchange(volts(seq)).unwrap_err();
        assert!(is_corrupt(&error), "{error}");
        assert!(start.elapsed() < Duration::from_secs(3));
        assert!(link.statistics().balances());
    }
}

#[test]
fn a_peer_that_vanishes_is_noticed_at_once_and_for_good() {
    const FOREVER_MS: f64 = 20_000.0;
    let hang_up = || at_command(3, |_| vec![Say::HangUp]);
    let fakes = [
        rtu(hang_up()),
        Fake::over_tcp(Language::Tcp, hang_up()),
        Fake::over_pty(Language::Stream, identity_block(), hang_up()),
        Fake::over_tcp(Language::Stream, hang_up()),
    ];
    for (way, fake) in fakes.iter().enumerate() {
        let mut link: Link = if way < 2 {
            Box::new(modbus(fake, FOREVER_MS))
        } else {
            stream(fake, FOREVER_MS)
        };
        link.exchange(volts(1)).unwrap();
        link.exchange(volts(2)).unwrap();
        let start = now();
        for seq in 3..6 {
            let error = link.exchange(volts(seq)).unwrap_err();
            assert!(matches!(error, LinkError::Gone { .. }), "{way}: {error}");
            assert_eq!(link.has_sent_command(), seq == 3, "{way}");
        }
        assert!(matches!(link.stop(), Err(LinkError::Gone { .. })));
        assert!(start.elapsed() < Duration::from_secs(10));
        assert_eq!(link.statistics().aborted, 1, "{way}");
        assert!(link.statistics().balances());
    }
}

#[test]
fn a_stop_is_repeated_until_the_drive_has_it() {
    let fake = rtu(silent_at(2..4));
    let mut link = modbus(&fake, BRIEF_MS);
    link.exchange(volts(1)).unwrap();
    link.stop().unwrap();
    assert_eq!(link.statistics().timeout, 2);
    assert!(link.statistics().balances());
}

#[test]
fn raw_registers_are_read_and_a_wrong_address_is_an_exception() {
    let fake = rtu(honest);
    let mut link = modbus(&fake, PATIENT_MS);
    let words = link.read_registers(RegisterTable::Holding, 64, 2).unwrap();
    assert_eq!(words, [0x4442, 1]);
    let read = link.read_registers(RegisterTable::Input, 5000, 1);
    let written = link.write_registers(64, &[1]);
    for error in [read.unwrap_err(), written.unwrap_err()] {
        let is_address = matches!(error, LinkError::Exception { code: 2, .. });
        assert!(is_address, "{error}");
    }
}

#[test]
fn frames_of_the_stream_are_as_long_as_the_timing_says() {
    let command = Message::Command(DriveCommand::default());
    assert_eq!(stream_frame(1, 0, command).len(), stream::COMMAND_BYTES);
    let telemetry = Message::Telemetry(Telemetry::default());
    assert_eq!(stream_frame(1, 0, telemetry).len(), stream::TELEMETRY_BYTES);
}

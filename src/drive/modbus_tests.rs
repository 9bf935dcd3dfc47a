//! The link against drives that answer late, twice, damaged, in another's name, or not at all.

use std::time::Duration;

use firmware_protocol::modbus::rtu::{MAX_FRAME, encode_frame};

use super::*;
use crate::drive::fake::{Asked, Fake, Language, Say, identity_block};
use crate::drive::{DriveProfile, open_modbus};
use crate::sample::Channel;

/// Long enough for a loaded machine, where an answer is to be awaited.
const PATIENT_MS: f64 = 3000.0;
/// Short, where the answer does not come.
const BRIEF_MS: f64 = 150.0;

fn link(fake: &Fake, deadline_ms: f64) -> ModbusLink {
    let mut profile = DriveProfile::named("own").unwrap();
    profile.link.deadline_ms = Some(deadline_ms);
    open_modbus(&fake.target, &profile, now()).unwrap()
}

fn rtu(script: impl FnMut(Asked) -> Vec<Say> + Send + 'static) -> Fake {
    Fake::over_pty(Language::Rtu, identity_block(), script)
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

fn volts(seq: u64) -> Command {
    Command {
        seq,
        demand: Demand::Voltage(seq as f64 * 0.5),
    }
}

/// Every sample must be that of its own command: the toy's voltage and current tell which one it was.
fn is_its_own(sample: &Sample, seq: u64) -> bool {
    let near = |channel, value: f64| {
        sample
            .get(channel)
            .is_some_and(|found| (found - value).abs() < 0.006)
    };
    sample.seq == Some(seq)
        && sample.applied.is_some_and(|applied| applied.seq == seq)
        && near(Channel::Voltage, seq as f64 * 0.5)
        && near(Channel::Current, seq as f64 * 0.01)
}

/// Ten exchanges; returns the errors by number. No wrong sample is ever delivered, and the books balance.
fn ten_exchanges(link: &mut ModbusLink) -> Vec<(u64, LinkError)> {
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
    let mut link = link(&fake, PATIENT_MS);
    let identity = link.identify().unwrap();
    assert_eq!(identity.serial_number, "4711");
    assert_eq!(
        (identity.vendor.as_str(), identity.firmware.as_str()),
        ("toy", "toy")
    );
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
fn another_version_and_another_map_are_refused() {
    let mut block = identity_block();
    block[1] = 9;
    let fake = Fake::over_pty(Language::Rtu, block, honest);
    let error = link(&fake, PATIENT_MS).identify().unwrap_err();
    assert!(
        matches!(
            error,
            LinkError::Version {
                found: 9,
                expected: 1,
                ..
            }
        ),
        "{error}"
    );
    block[0] = 0;
    let fake = Fake::over_pty(Language::Rtu, block, honest);
    let error = link(&fake, PATIENT_MS).identify().unwrap_err();
    assert!(matches!(error, LinkError::Identity { .. }), "{error}");
}

#[test]
fn a_late_reply_never_becomes_the_next_value() {
    // The reply to command 3 comes with the answer to whatever is asked next, as of a device that was busy.
    let mut held = None;
    let fake = rtu(move |asked| {
        if asked.command == 3 {
            held = Some(asked.honest);
            return Vec::new();
        }
        held.take()
            .map(Say::Bytes)
            .into_iter()
            .chain([Say::Bytes(asked.honest)])
            .collect()
    });
    let mut link = link(&fake, BRIEF_MS);
    let errors = ten_exchanges(&mut link);
    assert!(
        matches!(errors[0], (3, LinkError::Timeout { .. })),
        "{errors:?}"
    );
    assert!(errors.len() <= 2, "{errors:?}");
    assert!(link.statistics().timeout >= 1);
}

#[test]
fn a_drive_that_lags_by_one_reply_is_resynchronised() {
    // Every reply is held back until the next request, for six requests.
    let mut held: Option<Vec<u8>> = None;
    let mut count = 0;
    let fake = rtu(move |asked| {
        count += 1;
        if (4..10).contains(&count) {
            held.replace(asked.honest)
                .map(Say::Bytes)
                .into_iter()
                .collect()
        } else {
            honest(asked)
        }
    });
    let mut link = link(&fake, BRIEF_MS);
    let errors = ten_exchanges(&mut link);
    assert!(!errors.is_empty() && errors.len() <= 7, "{errors:?}");
    assert!(link.exchange(volts(11)).is_ok());
}

#[test]
fn a_reply_that_comes_after_the_deadline_is_waited_out() {
    let fake = rtu(at_command(2, |reply| {
        vec![Say::WaitMs(300), Say::Bytes(reply)]
    }));
    let mut link = link(&fake, BRIEF_MS);
    let errors = ten_exchanges(&mut link);
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
    let mut link = link(&fake, BRIEF_MS);
    let errors = ten_exchanges(&mut link);
    assert_eq!(errors.len(), 1);
    assert!(
        matches!(errors[0], (5, LinkError::Stale { .. })),
        "{errors:?}"
    );
    assert_eq!(link.statistics().stale, 1);
}

#[test]
fn a_reply_that_comes_twice_is_taken_once() {
    let fake = rtu(at_command(4, |reply| {
        vec![Say::Bytes(reply.clone()), Say::Bytes(reply)]
    }));
    let mut link = link(&fake, PATIENT_MS);
    // The copy is dropped before the next request, or, where it comes after that, known by its number.
    assert!(ten_exchanges(&mut link).is_empty());
    assert_eq!(link.line().unwrap().stale_frames, 1);
}

#[test]
fn garbage_around_a_reply_costs_nothing() {
    let garbage = || Say::Bytes(vec![0x01, 0x17, 0x20, 0xFF, 0x00, 0x55]);
    for place in [0, 1] {
        let fake = rtu(at_command(4, move |reply| {
            let mut says = vec![Say::Bytes(reply)];
            says.insert(place, garbage());
            says
        }));
        let mut link = link(&fake, PATIENT_MS);
        let errors = ten_exchanges(&mut link);
        assert!(errors.is_empty(), "{place}: {errors:?}");
        assert_eq!(link.line().unwrap().bytes_dropped, 6);
    }
}

#[test]
fn a_reply_in_pieces_is_put_together() {
    let fake = rtu(at_command(4, |reply| {
        let (a, b) = reply.split_at(11);
        vec![
            Say::Bytes(a.to_vec()),
            Say::WaitMs(50),
            Say::Bytes(b.to_vec()),
        ]
    }));
    let mut link = link(&fake, PATIENT_MS);
    assert!(ten_exchanges(&mut link).is_empty());
}

#[test]
fn damage_and_foreign_frames_cost_their_cycle_and_have_their_class() {
    type Damage = fn(Vec<u8>) -> Vec<u8>;
    type Case = (&'static str, Damage, fn(&LinkError) -> bool);
    let cases: [Case; 5] = [
        (
            "truncated",
            |mut r| {
                r.truncate(20);
                r
            },
            |e| matches!(e, LinkError::Corrupt { .. }),
        ),
        (
            "one byte lost",
            |mut r| {
                r.remove(9);
                r
            },
            |e| matches!(e, LinkError::Corrupt { .. }),
        ),
        (
            "bit flipped",
            |mut r| {
                r[12] ^= 4;
                r
            },
            |e| matches!(e, LinkError::Corrupt { .. }),
        ),
        (
            "other unit",
            |r| reframe(2, &r[1..r.len() - 2]),
            |e| matches!(e, LinkError::Mismatch { .. }),
        ),
        (
            "other function",
            |r| reframe(1, &[&[3], &r[2..r.len() - 2]].concat()),
            |e| matches!(e, LinkError::Mismatch { .. }),
        ),
    ];
    for (name, damage, class) in cases {
        let fake = rtu(at_command(4, move |reply| vec![Say::Bytes(damage(reply))]));
        let mut link = link(&fake, BRIEF_MS);
        let errors = ten_exchanges(&mut link);
        assert_eq!(errors[0].0, 4, "{name}");
        assert!(class(&errors[0].1), "{name}: {}", errors[0].1);
        assert!(errors.len() <= 2, "{name}: {errors:?}");
    }
}

fn reframe(unit: u8, pdu: &[u8]) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let length = encode_frame(unit, pdu, &mut out);
    out[..length].to_vec()
}

#[test]
fn an_exception_has_its_name_and_the_link_lives_on() {
    let fake = rtu(at_command(4, |_| vec![Say::Bytes(reframe(1, &[0x97, 6]))]));
    let mut link = link(&fake, PATIENT_MS);
    let errors = ten_exchanges(&mut link);
    assert_eq!(errors.len(), 1);
    assert_eq!(
        errors[0].1.to_string().split_once(": ").unwrap().1,
        "the drive refused the command: exception 0x06 device busy"
    );
    assert_eq!(link.statistics().exception, 1);
}

#[test]
fn silence_ends_at_the_deadline() {
    let fake = rtu(|asked| {
        if asked.command > 2 {
            Vec::new()
        } else {
            honest(asked)
        }
    });
    let mut link = link(&fake, BRIEF_MS);
    link.exchange(volts(1)).unwrap();
    link.exchange(volts(2)).unwrap();
    let start = now();
    let error = link.exchange(volts(3)).unwrap_err();
    let took = start.elapsed();
    assert!(matches!(error, LinkError::Timeout { .. }), "{error}");
    assert!(took >= Duration::from_millis(140), "{took:?}");
    assert!(took < Duration::from_secs(3), "{took:?}");
}

#[test]
fn a_line_that_babbles_is_given_up_in_time() {
    let fake = rtu(|asked| {
        if asked.command < 2 {
            return honest(asked);
        }
        (0..3000)
            .flat_map(|_| [Say::Bytes(vec![0xA5; 64]), Say::WaitMs(1)])
            .collect()
    });
    let mut link = link(&fake, BRIEF_MS);
    link.exchange(volts(1)).unwrap();
    for seq in 2..4 {
        let start = now();
        let error = link.exchange(volts(seq)).unwrap_err();
        assert!(matches!(error, LinkError::Corrupt { .. }), "{error}");
        assert!(start.elapsed() < Duration::from_secs(3));
        assert!(link.statistics().balances());
    }
}

#[test]
fn a_peer_that_vanishes_is_noticed_at_once_and_for_good() {
    let hang_up = || at_command(3, |_| vec![Say::HangUp]);
    let fakes = [rtu(hang_up()), Fake::over_tcp(Language::Tcp, hang_up())];
    for fake in fakes {
        let mut link = link(&fake, 20_000.0);
        link.exchange(volts(1)).unwrap();
        link.exchange(volts(2)).unwrap();
        let start = now();
        for seq in 3..6 {
            let error = link.exchange(volts(seq)).unwrap_err();
            assert!(matches!(error, LinkError::Gone { .. }), "{error}");
        }
        assert!(matches!(link.stop(), Err(LinkError::Gone { .. })));
        assert!(start.elapsed() < Duration::from_secs(10));
        assert_eq!(link.statistics().aborted, 1);
        assert!(link.statistics().balances());
    }
}

#[test]
fn over_tcp_a_late_reply_is_dropped_by_its_transaction() {
    let mut held = None;
    let fake = Fake::over_tcp(Language::Tcp, move |asked| {
        if asked.command == 3 {
            held = Some(asked.honest);
            return Vec::new();
        }
        held.take()
            .map(Say::Bytes)
            .into_iter()
            .chain([Say::Bytes(asked.honest)])
            .collect()
    });
    let mut link = link(&fake, BRIEF_MS);
    let errors = ten_exchanges(&mut link);
    assert!(
        matches!(errors[..], [(3, LinkError::Timeout { .. })]),
        "{errors:?}"
    );
}

#[test]
fn a_stop_is_repeated_until_the_drive_has_it() {
    let fake = rtu(|asked| {
        if (2..4).contains(&asked.command) {
            Vec::new()
        } else {
            honest(asked)
        }
    });
    let mut link = link(&fake, BRIEF_MS);
    link.exchange(volts(1)).unwrap();
    link.stop().unwrap();
    assert_eq!(link.statistics().timeout, 2);
    assert!(link.statistics().balances());
}

#[test]
fn raw_registers_are_read_and_a_wrong_address_is_an_exception() {
    let fake = rtu(honest);
    let mut link = link(&fake, PATIENT_MS);
    let words = link.read_registers(RegisterTable::Holding, 64, 2).unwrap();
    assert_eq!(words, [0x4442, 1]);
    let error = link
        .read_registers(RegisterTable::Input, 5000, 1)
        .unwrap_err();
    assert!(
        matches!(error, LinkError::Exception { code: 2, .. }),
        "{error}"
    );
    let error = link.write_registers(64, &[1]).unwrap_err();
    assert!(
        matches!(error, LinkError::Exception { code: 2, .. }),
        "{error}"
    );
}

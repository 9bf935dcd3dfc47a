//! The stream against drives that answer late, twice, damaged, or not at all.

use super::*;
use crate::drive::fake::{Asked, Fake, Language, Say, identity_block, stream_frame};
use crate::drive::{DriveProfile, open_stream};
use crate::sample::Channel;

const PATIENT_MS: f64 = 3000.0;
const BRIEF_MS: f64 = 150.0;

fn link(fake: &Fake, deadline_ms: f64) -> StreamLink {
    let mut profile = DriveProfile::named("own").unwrap();
    profile.link.deadline_ms = Some(deadline_ms);
    open_stream(&fake.target, &profile, now()).unwrap()
}

fn honest(asked: Asked) -> Vec<Say> {
    vec![Say::Bytes(asked.honest)]
}

fn pty(script: impl FnMut(Asked) -> Vec<Say> + Send + 'static) -> Fake {
    Fake::over_pty(Language::Stream, identity_block(), script)
}

fn volts(seq: u64) -> Command {
    Command {
        seq,
        demand: Demand::Voltage(seq as f64 * 0.5),
    }
}

fn ten_exchanges(link: &mut StreamLink) -> Vec<(u64, LinkError)> {
    let mut errors = Vec::new();
    for seq in 1..=10 {
        match link.exchange(volts(seq)) {
            Ok(sample) => {
                assert_eq!(sample.applied.map(|applied| applied.seq), Some(seq));
                let voltage_v = sample.get(Channel::Voltage).unwrap();
                assert!((voltage_v - seq as f64 * 0.5).abs() < 1e-4);
            }
            Err(error) => errors.push((seq, error)),
        }
        assert!(link.statistics().balances(), "{:?}", link.statistics());
    }
    errors
}

#[test]
fn identity_and_time_origin_are_read() {
    for fake in [pty(honest), Fake::over_tcp(Language::Stream, honest)] {
        let mut link = link(&fake, PATIENT_MS);
        let identity = link.identify().unwrap();
        assert_eq!(identity.serial_number, "4711");
        assert_eq!(identity.firmware, "2.3");
        assert_eq!(identity.watchdog_s, Some(0.25));
        let sample = link.exchange(volts(1)).unwrap();
        assert!((sample.time_s - 0.01).abs() < 1e-9);
        assert!(ten_exchanges(&mut link).is_empty());
        assert_eq!(link.statistics().lost(), 0);
        assert_eq!(link.round_trips().unwrap().count(), 12);
    }
}

#[test]
fn late_and_repeated_answers_never_become_a_value() {
    let mut held = None;
    let fake = pty(move |asked| match asked.command {
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
    let errors = ten_exchanges(&mut link(&fake, BRIEF_MS));
    assert!(
        matches!(errors[..], [(3, LinkError::Timeout { .. })]),
        "{errors:?}"
    );
}

#[test]
fn damage_garbage_refusals_and_foreign_answers_have_their_class() {
    type Case = (&'static str, fn(Vec<u8>) -> Vec<u8>, fn(&LinkError) -> bool);
    let cases: [Case; 5] = [
        (
            "bit flipped",
            |mut a| {
                a[9] ^= 4;
                a
            },
            |e| matches!(e, LinkError::Corrupt { .. }),
        ),
        (
            "truncated",
            |mut a| {
                a.truncate(20);
                a
            },
            |e| matches!(e, LinkError::Corrupt { .. }),
        ),
        (
            "garbage instead",
            |_| vec![7; 30],
            |e| matches!(e, LinkError::Corrupt { .. }),
        ),
        (
            "an identity instead",
            |_| {
                stream_frame(
                    4,
                    0,
                    Message::Identity(firmware_protocol::Identity::default()),
                )
            },
            |e| matches!(e, LinkError::Mismatch { .. }),
        ),
        (
            "another number",
            |_| {
                stream_frame(
                    3,
                    0,
                    Message::Telemetry(firmware_protocol::Telemetry::default()),
                )
            },
            |e| matches!(e, LinkError::Stale { .. }),
        ),
    ];
    for (name, damage, class) in cases {
        let fake = pty(move |asked| {
            if asked.command == 4 {
                vec![Say::Bytes(damage(asked.honest))]
            } else {
                honest(asked)
            }
        });
        let errors = ten_exchanges(&mut link(&fake, BRIEF_MS));
        assert_eq!(errors[0].0, 4, "{name}");
        assert!(class(&errors[0].1), "{name}: {}", errors[0].1);
        // A frame without its end takes nothing with it.
        assert_eq!(errors.len(), 1, "{name}: {errors:?}");
    }
}

#[test]
fn a_refusal_is_an_exception_by_name() {
    let fake = pty(|asked| {
        if asked.command == 4 {
            let refusal = firmware_protocol::stream::Refusal {
                kind: 2,
                code: ErrorCode::NotSupported,
            };
            vec![Say::Bytes(stream_frame(4, 0, Message::Error(refusal)))]
        } else {
            honest(asked)
        }
    });
    let errors = ten_exchanges(&mut link(&fake, PATIENT_MS));
    assert!(
        matches!(
            errors[..],
            [(
                4,
                LinkError::Exception {
                    name: "not supported",
                    ..
                }
            )]
        ),
        "{errors:?}"
    );
}

#[test]
fn silence_ends_at_the_deadline() {
    let fake = pty(|asked| {
        if asked.command > 1 {
            Vec::new()
        } else {
            honest(asked)
        }
    });
    let mut link = link(&fake, BRIEF_MS);
    link.exchange(volts(1)).unwrap();
    let start = now();
    let error = link.exchange(volts(2)).unwrap_err();
    assert!(
        matches!(
            error,
            LinkError::Timeout {
                deadline_ms: 150,
                ..
            }
        ),
        "{error}"
    );
    assert!(start.elapsed() >= Duration::from_millis(149));
    assert!(start.elapsed() < Duration::from_secs(3));
}

#[test]
fn a_peer_that_vanishes_is_noticed_at_once_and_for_good() {
    let hang_up = |asked: Asked| {
        if asked.command == 2 {
            vec![Say::HangUp]
        } else {
            honest(asked)
        }
    };
    for fake in [pty(hang_up), Fake::over_tcp(Language::Stream, hang_up)] {
        let mut link = link(&fake, 20_000.0);
        link.exchange(volts(1)).unwrap();
        let start = now();
        for seq in 2..5 {
            let error = link.exchange(volts(seq)).unwrap_err();
            assert!(matches!(error, LinkError::Gone { .. }), "{error}");
        }
        assert!(start.elapsed() < Duration::from_secs(10));
        assert_eq!(link.statistics().aborted, 1);
    }
}

#[test]
fn frames_are_as_long_as_the_timing_says() {
    let command = Message::Command(DriveCommand::default());
    assert_eq!(stream_frame(1, 0, command).len(), COMMAND_BYTES);
    let telemetry = Message::Telemetry(firmware_protocol::Telemetry::default());
    assert_eq!(stream_frame(1, 0, telemetry).len(), TELEMETRY_BYTES);
}

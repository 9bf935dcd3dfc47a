//! What trials in real time and in virtual time share: which are made, several at once, and what is wrong with one.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::drive::Drive;
use super::fault::{Act, FAULTS, Fault, Subject, Way};
use super::judge::judge;
use super::motor::TRUTHS;

/// A fault in a way of running.
pub(crate) type Case = (&'static Fault, Way);

/// `NAME[/WAY]`: only this fault, in the ways that begin so.
pub(crate) fn picked() -> Option<String> {
    std::env::var("DRIVEBENCH_TRIAL").ok()
}

/// Every fault of a subject in every way in which it can happen, or what is picked of them.
pub(crate) fn cases(subject: Subject) -> Vec<Case> {
    let picked = picked();
    let picked = picked.as_deref();
    let picked = picked.map(|text| text.split_once('/').unwrap_or((text, "")));
    let of_subject = FAULTS.iter().filter(|fault| fault.subject() == subject);
    let cases = of_subject.flat_map(|fault| fault.ways().map(move |way| (fault, way)));
    let is_picked = |(fault, way): &Case| {
        picked
            .is_none_or(|(name, begin)| fault.name == name && format!("{way:?}").starts_with(begin))
    };
    cases.filter(is_picked).collect()
}

/// Works on all cases, so many at a time; what came of each, in the order in which they ended.
pub(crate) fn at_once<C: Sync, T: Send>(
    workers: usize,
    cases: &[C],
    work: impl Fn(&C) -> T + Sync,
) -> Vec<T> {
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                while let Some(case) = cases.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let came = work(case);
                    done.lock().expect("no trial panics").push(came);
                }
            });
        }
    });
    done.into_inner().expect("no trial panics")
}

/// When the fault was there: `done_s` where it was done to the program.
pub(crate) fn from_s(fault: &Fault, drive: &Drive, done_s: Option<f64>) -> Option<f64> {
    match fault.act {
        Act::Host(_) | Act::StopIgnored(_) => done_s,
        _ => drive.seen_s(),
    }
}

/// What is wrong by the drive's own log and by the exit status.
pub(crate) fn wrong(fault: &Fault, drive: &Drive, done_s: Option<f64>, status: i32) -> Vec<String> {
    let from_s = from_s(fault, drive, done_s);
    let mut wrong = judge(drive, fault.act, fault.class, from_s);
    if !fault.statuses.contains(&status) {
        wrong.push(format!("status {status} instead of {:?}", fault.statuses));
    }
    wrong
}

/// R, Ke and J in words, and what is wrong with them: what is settled has to hold the truth within so many standard
/// deviations. `found` gives the verdict, the value and its standard deviation.
pub(crate) fn hold_against_truth<'a>(
    sigmas: f64,
    found: impl Fn(&str) -> (&'a str, Option<f64>, Option<f64>),
) -> (Vec<String>, Vec<String>) {
    let (mut words, mut wrong) = (Vec::new(), Vec::new());
    for (key, truth) in TRUTHS {
        let (verdict, Some(value), Some(std)) = found(key) else {
            words.push(format!("{key} {}", found(key).0));
            continue;
        };
        let off = (value - truth) / std;
        let text = format!("{key} {verdict} {value:.5} +- {std:.5} ({off:+.1} sigma)");
        if verdict == "settled" && off.abs() > sigmas {
            wrong.push(format!("{text}: the truth is {truth}"));
        }
        words.push(text);
    }
    (words, wrong)
}

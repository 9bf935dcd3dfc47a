//! Whatever goes wrong, the motor is at zero within its budget by the log of a drive that this program does not know.
//!
//! Real binary, real pseudo-terminals, real time. `DRIVEBENCH_EVERYTHING` makes every fault happen in every way; else each
//! happens once, and every way of running is taken several times. They need a machine that keeps its deadlines, so they
//! are asked for by name (`-- --ignored`). `DRIVEBENCH_TRIAL=NAME[/WAY]` picks some by name.

mod line;
mod trial;

use std::io::Write;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use crate::witness::fault::{Act, Class, FAULTS, Fault, Way};
use trial::{Trial, trial};

/// Trials at once in each test function; they mostly wait.
const AT_ONCE: usize = 3;

/// One trial in so many may be counted apart.
const APART: usize = 5;

type Case = (&'static Fault, Way);

/// Every fault in one way, ways in turn; or all of both.
fn cases(wanted: impl Fn(&Fault) -> bool) -> Vec<Case> {
    if let Ok(picked) = std::env::var("DRIVEBENCH_TRIAL") {
        let (name, way) = picked.split_once('/').unwrap_or((&picked, ""));
        let ways = |fault: &'static Fault| {
            let possible = Way::ALL.into_iter().filter(|way| fault.happens(*way));
            possible
                .filter(|ways| format!("{ways:?}").starts_with(way))
                .map(move |way| (fault, way))
        };
        let named = FAULTS.iter().filter(|fault| fault.name == name);
        return named.filter(|fault| wanted(fault)).flat_map(ways).collect();
    }
    let everything = std::env::var_os("DRIVEBENCH_EVERYTHING").is_some();
    let mut cases = Vec::new();
    for fault in FAULTS.iter().filter(|fault| wanted(fault)) {
        let mut ways: Vec<Way> = Way::ALL.into_iter().filter(|w| fault.happens(*w)).collect();
        if !everything {
            // A whole `commission` takes three quarters of a minute; it is made once, where nothing is wrong.
            ways.retain(|way| fault.class != Class::GoesOn || *way != Way::Commission);
            ways = vec![ways[cases.len() % ways.len()]];
        }
        cases.extend(ways.into_iter().map(|way| (fault, way)));
    }
    cases
}

fn tell(text: &str) {
    // Past the capture of the test harness: what was tried again is to be seen.
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Makes the trials, a few at once, and says of all that went wrong.
fn expect(cases: &[Case]) {
    let (next, done) = (AtomicUsize::new(0), Mutex::new(Vec::<Trial>::new()));
    std::thread::scope(|scope| {
        for _ in 0..AT_ONCE {
            scope.spawn(|| {
                while let Some((fault, way)) = cases.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let seed = fault.name.bytes().map(u64::from).sum();
                    let trial = trial(fault, *way, seed);
                    tell(&trial.to_string());
                    done.lock().expect("no trial panics").push(trial);
                }
            });
        }
    });
    let done = done.into_inner().expect("no trial panics");
    let apart = done.iter().filter(|t| t.is_counted_apart()).count();
    let repeated = done.iter().filter(|trial| trial.attempts > 1).count();
    let failed: Vec<String> = done
        .iter()
        .filter(|t| !t.passed() && !t.is_counted_apart())
        .map(Trial::to_string)
        .collect();
    tell(&format!(
        "{} trials, {repeated} of them repeated because this machine stood still, {apart} not judged for it, {} failed",
        done.len(),
        failed.len()
    ));
    assert!(failed.is_empty(), "{}", failed.join("\n"));
    assert!(
        apart * APART <= done.len(),
        "{apart} of {} trials could not be judged: this machine stands still too often",
        done.len()
    );
}

fn is_about_the_line(fault: &Fault) -> bool {
    fault.class == Class::GoesOn && !matches!(fault.act, Act::Host(_) | Act::Nothing)
}

fn is_about_the_host(fault: &Fault) -> bool {
    matches!(fault.act, Act::Host(_))
}

#[test]
#[ignore = "real time, on a quiet machine: cargo test --release --test live fault_trials -- --ignored"]
fn a_disturbed_line_bends_no_result() {
    expect(&cases(is_about_the_line));
}

#[test]
#[ignore = "real time, on a quiet machine: cargo test --release --test live fault_trials -- --ignored"]
fn every_way_out_of_the_program_ends_at_zero() {
    expect(&cases(is_about_the_host));
}

#[test]
#[ignore = "real time, on a quiet machine: cargo test --release --test live fault_trials -- --ignored"]
fn whatever_the_drive_does_it_ends_at_zero() {
    expect(&cases(|fault| {
        !is_about_the_line(fault) && !is_about_the_host(fault)
    }));
}

/// Each way of running to its own end.
#[test]
#[ignore = "real time, on a quiet machine: cargo test --release --test live fault_trials -- --ignored"]
fn every_way_of_running_ends_well_where_nothing_is_wrong() {
    let fault = FAULTS.iter().find(|fault| fault.act == Act::Nothing);
    let fault = fault.expect("it stands first");
    let cases: Vec<Case> = Way::ALL.into_iter().map(|way| (fault, way)).collect();
    expect(&cases);
}

#[test]
fn the_table_has_forty_faults_and_each_can_happen() {
    assert!(FAULTS.len() > 40);
    for fault in FAULTS {
        assert!(
            Way::ALL.into_iter().any(|way| fault.happens(way)),
            "{fault}"
        );
        let same = FAULTS.iter().filter(|other| other.name == fault.name);
        assert_eq!(same.count(), 1, "{fault}");
        assert!(!fault.statuses.is_empty(), "{fault}");
    }
}

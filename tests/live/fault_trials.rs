//! Whatever goes wrong, the motor is at zero within its budget by the log of a drive that this program does not know.
//!
//! Real binary, real pseudo-terminals, real time. `DRIVEBENCH_EVERYTHING` makes every fault happen in every way; else each
//! happens once, and every way of running is taken several times. They need a machine that keeps its deadlines, so they
//! are asked for by name (`-- --ignored`). `DRIVEBENCH_TRIAL=NAME[/WAY]` picks some by name.

mod line;
mod trial;

use std::io::Write;

use crate::witness::fault::{Act, Class, FAULTS, Subject, Way};
use crate::witness::trials::{self, Case};
use trial::{Trial, trial};

/// Trials at once in each test function; they mostly wait.
const AT_ONCE: usize = 3;

/// One trial in so many may be counted apart.
const APART: usize = 5;

/// Every fault in one way, ways in turn; or all of both.
fn cases(subject: Subject) -> Vec<Case> {
    let cases = trials::cases(subject);
    if trials::picked().is_some() || std::env::var_os("DRIVEBENCH_EVERYTHING").is_some() {
        return cases;
    }
    let mut few = Vec::new();
    for ways in cases.chunk_by(|(one, _), (next, _)| one.name == next.name) {
        // A whole `commission` takes three quarters of a minute; it is made once, where nothing is wrong.
        let is_short =
            |(fault, way): &&Case| fault.class != Class::GoesOn || *way != Way::Commission;
        let ways: Vec<&Case> = ways.iter().filter(is_short).collect();
        few.push(*ways[few.len() % ways.len()]);
    }
    few
}

fn tell(text: &str) {
    // Past the capture of the test harness: what was tried again has to be visible.
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Makes the trials, a few at once, and reports all that went wrong.
fn expect(cases: &[Case]) {
    let done = trials::at_once(AT_ONCE, cases, |(fault, way)| {
        let trial = trial(fault, *way, fault.name.bytes().map(u64::from).sum());
        tell(&trial.to_string());
        trial
    });
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

#[test]
#[ignore = "real time, on a quiet machine: cargo test --release --test live fault_trials -- --ignored"]
fn a_disturbed_line_bends_no_result() {
    expect(&cases(Subject::Line));
}

#[test]
#[ignore = "real time, on a quiet machine: cargo test --release --test live fault_trials -- --ignored"]
fn every_way_out_of_the_program_ends_at_zero() {
    expect(&cases(Subject::Host));
}

#[test]
#[ignore = "real time, on a quiet machine: cargo test --release --test live fault_trials -- --ignored"]
fn whatever_the_drive_does_it_ends_at_zero() {
    expect(&cases(Subject::Drive));
}

/// Each way of running to its own end.
#[test]
#[ignore = "real time, on a quiet machine: cargo test --release --test live fault_trials -- --ignored"]
fn every_way_of_running_ends_well_where_nothing_is_wrong() {
    let fault = FAULTS.iter().find(|fault| fault.act == Act::Nothing).expect("it stands first");
    let cases: Vec<Case> = Way::ALL.into_iter().map(|way| (fault, way)).collect();
    expect(&cases);
}

#[test]
fn the_table_has_forty_faults_and_each_can_happen() {
    assert!(FAULTS.len() > 40);
    for fault in FAULTS {
        assert!(fault.ways().next().is_some(), "{fault}");
        assert_eq!(FAULTS.iter().filter(|other| other.name == fault.name).count(), 1, "{fault}");
        assert!(!fault.statuses.is_empty(), "{fault}");
    }
}

//! What is said of a stop that the session did not see confirmed, after the link's own last attempt.

use super::*;
use crate::bench::session::Level;
use crate::drive::LinkError;

/// The notices of a run on a drive that fails from an exchange on, and of which the last stop ends like this.
fn said(from: u64, fault: Fault, stop_fails: Option<fn(String) -> LinkError>) -> Vec<Notice> {
    let mut drive = ScriptedDrive::new(0.01).with(from, u64::MAX, fault);
    drive.stop_fails = stop_fails;
    let summary = Scripted::new(drive, 0.0).run(None, |_| {});
    assert!(matches!(summary.outcome, Outcome::LinkLost { .. }));
    assert_eq!(summary.stop_error.is_some(), stop_fails.is_some());
    summary.notices
}

fn gone(link: String) -> LinkError {
    LinkError::Gone(link, "unplugged".to_owned())
}

fn disobeyed(link: String) -> LinkError {
    LinkError::Sequence {
        link,
        command: "stop",
        step: 1,
        steps: 1,
        reason: "the drive still reports that it runs".to_owned(),
    }
}

fn errors_with<'a>(notices: &'a [Notice], words: &str) -> Vec<&'a str> {
    notices
        .iter()
        .filter(|notice| notice.level == Level::Error && notice.text.contains(words))
        .map(|notice| notice.text.as_str())
        .collect()
}

#[test]
fn a_motor_that_nobody_could_stop_is_left_to_the_watchdog() {
    let notices = said(60, Fault::Gone, Some(gone));
    assert_eq!(errors_with(&notices, "NOT confirmed").len(), 1);
    assert_eq!(errors_with(&notices, "watchdog must have").len(), 1);
}

#[test]
fn a_stop_that_the_link_got_confirmed_in_the_end_is_no_matter_of_the_watchdog() {
    for fault in [Fault::Gone, Fault::IgnoresStop] {
        let notices = said(60, fault, None);
        assert_eq!(errors_with(&notices, "confirmed").len(), 0, "{notices:?}");
        let mut warnings = notices.iter().map(|notice| notice.text.as_str());
        assert!(warnings.any(|text| text.starts_with("the drive confirmed its stop only")));
    }
}

#[test]
fn of_a_drive_that_answers_or_never_ran_no_watchdog_is_claimed() {
    let answers = said(60, Fault::IgnoresStop, Some(disobeyed));
    let never_ran = said(0, Fault::Timeout, Some(gone));
    for (notices, why) in [
        (answers, "still reports that it runs"),
        (never_ran, "was not seen to run"),
    ] {
        let unconfirmed = errors_with(&notices, "NOT confirmed");
        assert_eq!(unconfirmed.len(), 1, "{notices:?}");
        assert!(unconfirmed[0].contains(why), "{unconfirmed:?}");
        assert!(errors_with(&notices, "watchdog").is_empty());
    }
}

//! States of a drive beside following: its keypad, its safe torque off, a lost supply, refusals, no word on its state.

use super::*;

const RUNNING: &str = "[state]\n";
/// The servo amplifier with the two states on further bits of its status word, and a fault on a fourth.
const WITH_STATES: &str = "[state]\n\
    remote = { signal = \"enabled\", mask = 0x02, equals = 0x02 }\n\
    sto = { signal = \"enabled\", mask = 0x04, not_equals = 0x00 }\n";

fn table() -> Table {
    Table::identified("epulse50-dc", &[(RUNNING, WITH_STATES)])
}

const REFERENCE: Reference<'static> = speed_ref(400.0);

#[test]
fn local_control_ends_a_run_and_blocks_set_points() {
    let mut table = table();
    assert_eq!(table.drive(REFERENCE, 0.5).hindrance, None);
    table.far().take_local(true);
    assert_eq!(table.run(REFERENCE).unwrap().hindrance, Some(Hindrance::LocalControl));
    // From here on whoever asks for a run gets nothing written, and is told why.
    for _ in 0..50 {
        let _ = table.run(REFERENCE);
        table.assert_stop_written();
    }
    assert_contains(&table.run(REFERENCE).unwrap_err(), "under local control");
    // Given back it runs only after somebody asked for zero first.
    table.far().take_local(false);
    for _ in 0..20 {
        assert_ne!(table.run(REFERENCE).unwrap().state, Some(DriveState::Running));
    }
    table.rest();
    table.enable(REFERENCE);
}

#[test]
fn a_register_without_a_number_gives_no_value_and_never_zero() {
    let mut table = Table::identified("leadshine-iem", &[("type = \"i32\"", "type = \"f32\"")]);
    let speed = |table: &mut Table| table.rest().get(Channel::Speed);
    assert!(speed(&mut table).is_some());
    table.far().withhold(true);
    assert_eq!(speed(&mut table), None);
    table.far().force("speed", Some(f32::INFINITY.to_bits()));
    assert_eq!(speed(&mut table), None);
    table.far().withhold(false);
    assert!(speed(&mut table).is_some());
}

#[test]
fn a_refusal_names_the_signal_and_its_line_in_the_profile() {
    let mut table = table();
    table.far().refuse(Some(2));
    let text = table.demand(Demand::Disable).unwrap_err();
    assert!(matches!(text, LinkError::Exception { code: 2, .. }));
    let profile = DriveProfile::text("epulse50-dc").unwrap();
    let line = 1 + profile.lines().position(|line| line.starts_with("[signals.enabled]")).unwrap();
    assert_contains(&text, &format!("profile epulse50-dc: enabled in line {line}"));
}

#[test]
fn a_busy_drive_is_polled_less_and_stopped_at_once() {
    let mut table = table();
    table.drive(REFERENCE, 0.5);
    table.period_s = 0.01;
    table.far().refuse(Some(6));
    let before = table.link.statistics().exception;
    for _ in 0..100 {
        assert!(matches!(table.run(REFERENCE).unwrap_err(), LinkError::Exception { code: 6, .. }));
    }
    let asked = table.link.statistics().exception - before;
    assert!((5..40).contains(&asked), "{asked} in 100 cycles");
    assert!(table.far().is_running());
    // A stop does not wait for the pause, and goes on where the drive answers again.
    table.far().refuse(None);
    table.demand(Demand::Stop).unwrap();
    assert_eq!(table.written("enable_word"), Some(0));
}

#[test]
fn a_drive_whose_supply_was_lost_is_brought_to_rest() {
    let mut table = Table::of(&profile_with("epulse50-dc", &[(RUNNING, WITH_STATES)]), None);
    let before = table.link.identify().unwrap();
    table.drive(REFERENCE, 0.5);
    table.link.bus_mut().lose(u32::MAX);
    for _ in 0..5 {
        assert!(table.run(REFERENCE).is_err());
    }
    table.far().switch_on_again();
    table.pass(5.0);
    table.link.bus_mut().lose(0);
    // The old link finds it at rest, and does not start it again.
    for _ in 0..20 {
        assert_ne!(table.run(REFERENCE).unwrap().state, Some(DriveState::Running));
        assert!(!table.far().is_running());
    }
    assert_eq!(table.link.recognise().unwrap(), before);
    table.link.bring_to_rest().unwrap();
    table.assert_stop_written();
    assert!(table.link.confirms_stop());
}

#[test]
fn recognising_a_drive_writes_nothing() {
    for name in foreign_names() {
        let mut table = Table::new(name);
        table.link.recognise().unwrap();
        assert!(table.far().written.is_empty(), "{name}");
        let tells = table.link.map().state("running").is_some();
        assert_eq!(table.link.confirms_stop(), tells, "{name}");
    }
}

#[test]
fn a_fault_code_is_read_at_once_with_its_text() {
    let codes = "[fault_codes]\n5 = \"overbraking\"\n\n[watchdog]";
    let mut table = Table::identified("schneider-atv312", &[("[watchdog]", codes)]);
    table.enable(speed_ref(900.0));
    table.far().trip();
    let sample = table.run(speed_ref(900.0)).unwrap();
    assert_eq!(sample.state, Some(DriveState::Fault));
    assert_eq!(sample.fault, Some(5));
    assert_eq!(sample.fault_text.as_deref(), Some("overbraking"));
    assert_eq!(table.written("speed_ref"), Some(0));
}

#[test]
fn the_watchdog_of_a_running_drive_is_left_as_it_is() {
    let time = |table: &mut Table| {
        table.link.identify().unwrap();
        let read = drivebench_link::ReadRequest::holding(0, 1);
        table.link.bus_mut().read(read).unwrap().cells[0]
    };
    let mut idle = Table::new("siemens-v20");
    assert_eq!(time(&mut idle), 1000);
    let mut runs = Table::identified("siemens-v20", &[]);
    runs.enable(speed_ref(10.0));
    runs.link.bus_mut().write(Put { function: 16, address: 0, cells: &[0] }).unwrap();
    assert_eq!(time(&mut runs), 0, "as somebody else has set it");
    runs.pass(60.0);
    assert!(runs.far().is_running(), "long after this host has gone");
}

/// A refresh would write again what was lost.
pub(super) const NO_REFRESH: (&str, &str) = ("refresh_ms = 100.0", "");

#[test]
fn an_unacknowledged_set_point_is_written_again() {
    let joint = ("functions = [3, 6, 16]", "functions = [3, 6, 16, 23]");
    for changes in [&[NO_REFRESH][..], &[NO_REFRESH, joint, stamps::ONE_BLOCK]] {
        let mut table = Table::running("epulse50-dc", changes, REFERENCE, 0.5);
        let before = table.written("speed_ref");
        table.link.bus_mut().lose_replies(1);
        let lost = table.run(speed_ref(700.0)).unwrap_err();
        assert!(lost.is_transient(), "{lost}");
        assert_ne!(table.written("speed_ref"), before);
        // The set-point of before the lost reply is written again: the drive must not keep the later one.
        table.run(REFERENCE).unwrap();
        assert_eq!(table.written("speed_ref"), before);
    }
}

/// The servo amplifier whose watchdog trips it and says so on a bit of its status word.
const TELLING_COMM_LOSS: (&str, &str) = (
    RUNNING,
    "[signals.fault_code]\naddress = 0x1300\ntype = \"u16\"\nquantity = \"fault_code\"\npoll = \"slow\"\n\n[state]\ncomm_loss = { signal = \"enabled\", mask = 0x08, equals = 0x08 }\n",
);

#[test]
fn an_expired_watchdog_is_named_and_code_zero_is_none() {
    let profile = profile_with("epulse50-dc", &[TELLING_COMM_LOSS]);
    let mut table = Table::of(&profile, Some(0.3)).known();
    table.drive(REFERENCE, 0.5);
    table.far().force("enabled", Some(0x08));
    let sample = table.run(REFERENCE).unwrap();
    assert_eq!(sample.state, Some(DriveState::Fault));
    assert_eq!(sample.fault, None);
    let text = Some("communication loss (comm_loss): the drive's own watchdog has expired");
    assert_eq!(sample.fault_text.as_deref(), text);
}

#[test]
fn a_fault_is_reported_although_the_stop_is_refused() {
    let mut table = Table::identified("schneider-atv312", &[]);
    let reference = speed_ref(900.0);
    table.enable(reference);
    table.far().trip();
    table.far().refuse_writes(Some(4));
    let sample = table.run(speed_ref(800.0)).unwrap();
    assert_eq!(sample.state, Some(DriveState::Fault));
    assert_eq!(sample.fault, Some(5), "with the first sight of the fault");
    assert_eq!(sample.applied, None, "it took no other set-point");
}

#[test]
fn a_busy_drive_is_the_reason_of_a_failed_enable() {
    let mut table = table();
    table.rest();
    table.far().refuse_writes(Some(6));
    let mut errors = (0..200).filter_map(|_| table.run(REFERENCE).err());
    let last = errors.find(|error| matches!(error, LinkError::Sequence { .. }));
    let text = last.unwrap().to_string();
    assert_contains(&text, "enable, step");
    assert_contains(&text, "exception 0x06");
}

/// The converter whose stop ends with a word behind a wait.
const WORD_BEHIND_A_WAIT: (&str, &str) = (
    "stop = [",
    "stop = [\n  { write = \"speed_ref\", value = 0 },\n  { wait = \"status\", mask = 0x0027, equals = 0x0021, within_ms = 5000 },\n",
);

#[test]
fn a_faulted_drive_gets_its_whole_stop_without_a_wait() {
    let profile = profile_with("schneider-atv312", &[WORD_BEHIND_A_WAIT]);
    let mut table = Table::of(&profile, None).known();
    let reference = speed_ref(900.0);
    table.enable(reference);
    let running = table.written("control_word");
    table.far().trip();
    table.run(reference).unwrap();
    let word = table.written("control_word");
    assert_ne!(word, running, "the word to run is taken back");
    assert_eq!(table.written("speed_ref"), Some(0));
    // The same without a session: a stop of a drive that went into fault before.
    let mut table = Table::of(&profile, None).known();
    table.enable(reference);
    table.far().trip();
    table.link.stop().unwrap();
    assert_eq!(table.written("control_word"), word);
}

#[test]
fn a_lost_acknowledgement_of_zero_delays_no_disable() {
    for lost in 1..=2 {
        let mut table = Table::running("epulse50-dc", &[NO_REFRESH], REFERENCE, 0.5);
        table.next_cycle();
        let began_s = table.now_s();
        table.link.bus_mut().lose_replies(lost);
        let (seq, demand) = (table.seq, Demand::Stop);
        let error = table.link.exchange(Command { seq, demand }).unwrap_err();
        assert!(error.is_transient(), "{error}");
        table.assert_stop_written();
        // Both writes and one deadline of 100 ms.
        let took_s = table.now_s() - began_s;
        let write_s = table.link.bus().wire_s(11, 8).unwrap();
        assert!(took_s < 0.1 + 2.0 * write_s, "{lost}: {took_s}");
        // Nothing was heard: it goes out again.
        assert_ne!(table.demand(Demand::Stop).unwrap().state, Some(DriveState::Running));
    }
}

#[test]
fn a_lost_stop_request_goes_out_again() {
    let mut table = Table::running("epulse50-dc", &[NO_REFRESH], REFERENCE, 0.5);
    table.link.bus_mut().lose(1);
    assert!(table.demand(Demand::Stop).unwrap_err().is_transient());
    // The first of both was lost, the second has come.
    table.demand(Demand::Stop).unwrap();
    table.assert_stop_written();
}

/// The motor controller, which does not tell whether it runs.
#[test]
fn a_refused_stop_goes_out_again_where_no_state_is_mapped() {
    let mut table = Table::running("roboteq-dc", &[], Some(("power_ref", 30.0)), 0.5);
    table.far().refuse_writes(Some(2));
    assert!(table.demand(Demand::Stop).is_err());
    table.far().refuse_writes(None);
    assert_ne!(table.demand(Demand::Stop).unwrap().state, Some(DriveState::Running));
    assert_eq!(table.written("power_ref"), Some(0));
}

#[test]
fn an_old_status_confirms_no_stop() {
    let wait = "{ wait = \"enabled\", mask = 1, equals = 0,";
    let no_wait = [(
        wait,
        "{ delay_ms = 1 },\n]\nquickstop = [\n  { wait = \"enabled\", mask = 1, equals = 0,",
    )];
    let mut table = Table::identified("epulse50-dc", &no_wait);
    table.rest();
    // Both words of the stop are acknowledged, and then the line is dead.
    table.link.bus_mut().lose_behind(2, u32::MAX);
    assert!(table.link.stop().unwrap_err().is_transient());
    table.link.bus_mut().lose(0);
    table.link.stop().unwrap();
    table.drive(REFERENCE, 0.5);
    table.link.bus_mut().lose(u32::MAX);
    assert!(table.link.stop().is_err());
    table.link.bus_mut().lose(0);
    for _ in 0..20 {
        let _ = table.run(REFERENCE);
        table.assert_stop_written();
        assert!(!table.link.has_sent_command());
    }
}

#[test]
fn a_set_point_of_another_master_is_named() {
    let readback = ("refresh_ms = 100.0", "readback = true");
    let mut table = Table::running("epulse50-dc", &[readback], REFERENCE, 3.0);
    let ours = table.written("speed_ref").unwrap();
    table.far().overwrite("speed_ref", ours / 2);
    let text = table.first_error(REFERENCE).to_string();
    assert_contains(&text, "somebody else writes it");
    assert!(!text.contains("ignores"), "{text}");
    assert_eq!(table.written("enable_word"), Some(0));
}

const READBACK: (&str, &str) = ("refresh_ms = 100.0", "readback = true");

/// Exception 05 (acknowledge) is no refusal: the cycle keeps its sample, and the value counts as held once it reads back.
#[test]
fn an_accepted_write_is_waited_for_and_costs_no_cycle() {
    for changes in [&[READBACK][..], &[]] {
        let mut table = Table::identified("epulse50-dc", changes);
        table.far().accept_writes_for(Some(0.1));
        table.drive(REFERENCE, 3.0);
        let faster = speed_ref(500.0);
        let applied = (0..40).map(|_| table.run(faster).unwrap().applied.is_some());
        let applied: Vec<bool> = applied.collect();
        assert!(applied[39], "{applied:?}");
        // Only a register that reads back shows when it was carried out.
        assert_eq!(!applied[0], !changes.is_empty(), "{applied:?}");
        let held = table.written("speed_ref");
        assert!(table.far().is_running());
        table.demand(Demand::Stop).unwrap();
        table.pass(0.2);
        for _ in 0..20 {
            table.rest();
        }
        assert_eq!(table.written("enable_word"), Some(0));
        assert_ne!(table.written("speed_ref"), held);
        assert!(!table.far().is_running());
    }
}

#[test]
fn an_accepted_write_that_is_not_carried_out_ends_the_run_with_that_reason() {
    let mut table = Table::running("epulse50-dc", &[READBACK], REFERENCE, 3.0);
    table.far().accept_writes_for(Some(1e6));
    let began_s = table.now_s();
    let text = table.first_error(speed_ref(500.0)).to_string();
    assert!((0.5..1.0).contains(&(table.now_s() - began_s)), "{text}");
    assert_contains(&text, "only accepted it (exception 05) and does not carry it out");
    assert!(!text.contains("refused"), "{text}");
    // An enable command is given up likewise, at its first write that reads back.
    let mut table = Table::identified("abb-dcs-gateway", &[]);
    table.far().accept_writes_for(Some(1e6));
    let text = table.first_error(speed_ref(100.0)).to_string();
    assert_contains(&text, "(exception 05) and has not carried it out for");
    assert!(!table.far().is_running());
}

/// An accepted zero that has not been carried out is no zero: a stop writes it again.
#[test]
fn a_stop_writes_again_what_was_only_accepted() {
    let mut table = Table::running("epulse50-dc", &[READBACK], REFERENCE, 3.0);
    table.far().accept_writes_for(Some(1e6));
    table.run(speed_ref(0.0)).unwrap();
    assert_ne!(table.written("speed_ref"), Some(0));
    table.far().accept_writes_for(None);
    table.link.stop().unwrap();
    assert_eq!(table.written("speed_ref"), Some(0));
    assert!(!table.far().is_running());
}

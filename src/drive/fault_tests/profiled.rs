//! The bus of a drive with a map of its own under the same faults: nothing in a plain read says which request it answers,
//! so every value here is made of the address and of the number of the request, and an old one shows.

use super::*;
use crate::drive::modbus::ModbusBus;
use crate::drive::register_bus::RegisterBus;
use crate::drive::register_map::RegisterMap;

/// Reads as a cycle makes them: two blocks that look alike, one that does not, the alike ones first.
const READS: [(u16, u16); 4] = [(100, 3), (200, 3), (300, 2), (400, 3)];
/// One request in so many is a write.
const WRITE_EVERY: u64 = 6;

/// The servo amplifier, which can be proven fresh by read lengths, or with a function code 8 or nothing of the kind.
fn map(resync: &str) -> RegisterMap {
    let text = DriveProfile::text("epulse50-dc").unwrap();
    let functions = "functions = [3, 6, 16]";
    assert!(text.contains("resync = \"length\"") && text.contains(functions));
    let text = text
        .replace("resync = \"length\"", &format!("resync = \"{resync}\""))
        .replace(functions, "functions = [3, 6, 8, 16]");
    RegisterMap::parse("epulse50-dc", &text).unwrap()
}

fn on_a_bus(resync: &str, faults: &[Fault], count: u64, seed: u64) -> Outcome {
    paused(|| {
        let mut settings = DriveProfile::named("epulse50-dc").unwrap().link;
        settings.deadline_ms = Some(12.0);
        let timing = LineTiming::serial(&settings, settings.baud, true);
        let times = Times {
            turnaround: Duration::from_micros(700),
            deadline: timing.allowed(8, 11),
        };
        let per_mille = if faults.is_empty() { 0 } else { PER_MILLE };
        let device = Stranger::new(Language::Rtu, faults, per_mille, times, seed);
        let device = Arc::new(Mutex::new(device));
        let link = modbus_link("virtual", &settings, &device);
        let mut bus = ModbusBus::new(link, &map(resync));
        let mut outcome = Outcome::default();
        for turn in 1..=count {
            let at = usize::try_from(turn).unwrap() % READS.len();
            let (address, words) = READS[at];
            outcome.judge(&device, || {
                if turn % WRITE_EVERY == 0 {
                    let value = u16::try_from(turn % 3000).unwrap();
                    return bus.write(6, 0x1026, &[value]).map(|_| true);
                }
                let read = bus.read(ReadRequest::holding(address, words))?;
                Ok(read.words == device.lock().unwrap().meant(address, words))
            });
        }
        let line = RegisterBus::line(&bus).unwrap();
        outcome.closed(&device, RegisterBus::statistics(&bus), &line)
    })
}

#[test]
fn an_honest_drive_costs_no_read() {
    for resync in ["fc08", "length", "none"] {
        let outcome = on_a_bus(resync, &[], 3000, 1);
        assert_eq!((outcome.wrong, outcome.statistics.lost()), (0, 0));
    }
}

/// Every kind of fault on many fresh lines: the first one of its kind is the hardest, nothing has been learned yet.
#[test]
fn the_first_fault_of_a_line_gives_no_wrong_value_either() {
    let lines = if everything() { 400 } else { 40 };
    for resync in ["fc08", "length"] {
        for fault in Fault::ALL {
            for seed in 0..lines {
                let outcome = on_a_bus(resync, &[fault], 100, seed);
                assert_eq!(outcome.wrong, 0, "{resync} {fault:?} {seed}: {outcome:?}");
            }
        }
    }
}

#[test]
fn mixed_faults_never_give_a_wrong_value_on_a_profiled_bus() {
    let count = if everything() { 2_000_000 } else { 100_000 };
    for resync in ["fc08", "length"] {
        let outcome = on_a_bus(resync, &Fault::ALL, count, 7);
        println!("{resync}: {outcome:?}");
        assert_eq!(outcome.wrong, 0, "{resync}: {outcome:?}");
        let share = outcome.tampered as f64 / outcome.statistics.sent as f64;
        assert!((0.03..0.05).contains(&share), "{outcome:?}");
        // A drive that answers late is deaf meanwhile, and a write is not repeated.
        assert!(outcome.collateral * 10 < outcome.tampered, "{outcome:?}");
    }
}

/// Without any proof of its own only silence keeps an old reply away: one that the drive holds back until it is asked
/// again cannot be told, and is left out here. Profiles say so where they have `resync = "none"`.
#[test]
fn with_silence_alone_all_faults_but_held_back_replies_are_told() {
    let count = if everything() { 1_000_000 } else { 50_000 };
    let held_back = [Fault::Late, Fault::LateTwoDeep];
    let faults: Vec<Fault> = Fault::ALL
        .into_iter()
        .filter(|fault| !held_back.contains(fault))
        .collect();
    let outcome = on_a_bus("none", &faults, count, 5);
    println!("none: {outcome:?}");
    assert_eq!(outcome.wrong, 0, "{outcome:?}");
}

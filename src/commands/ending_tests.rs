use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering;
use std::sync::mpsc::channel;
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::Duration;

use crate::commands::run::{RunDone, run};
use crate::runtime::controls::DrivePower;
use crate::runtime::ending::{Ended, alone, with_screen};
use crate::runtime::failure::TRIP;
use crate::runtime::{
    Controls, Failure, INTERNAL, INTERRUPTED, LINK, OpenRig, Recorded, Rig, RigOptions, ScreenEnd,
    ScreenReturn, Switches, Terminal, watched,
};
use crate::tui::Exit;
use drivebench_bench::{BenchFile, Outcome, SnapshotCell, VirtualClock};
use drivebench_emulator::{EmulatorConfig, Latency, MemoryLink, SoftDrive};
use drivebench_link::offer::Purpose;
use drivebench_link::{DriveLink, Identity, LinkError, LinkName, LinkStatistics};
use drivebench_model::sample::{Command, Demand, DriveState, Sample};

const SEQUENCE: &str = "\
[[sequence]]
standstill = { seconds = 0.3 }
[[sequence]]
steps = { levels_v = [40.0, 0.0], hold_s = 1.0 }
";

/// Called once while the motor is at speed, before an exchange.
type Hook = Box<dyn FnMut() + Send>;

/// The drive in memory, with a record of the demands and a hook that runs once while its motor turns.
struct RecordingLink {
    drive: Arc<Mutex<MemoryLink>>,
    demands: Arc<Mutex<Vec<Demand>>>,
    at_speed: Option<Hook>,
    /// Remaining exchanges at speed before the hook.
    before: u32,
}

impl DriveLink for RecordingLink {
    fn name(&self) -> LinkName {
        self.drive.lock().unwrap().name()
    }

    fn identify(&mut self) -> Result<Identity, LinkError> {
        self.drive.lock().unwrap().identify()
    }

    fn exchange(&mut self, command: Command) -> Result<Sample, LinkError> {
        if matches!(command.demand, Demand::Voltage(volts) if volts > 30.0) {
            self.before = self.before.saturating_sub(1);
            if self.before == 0
                && let Some(mut hook) = self.at_speed.take()
            {
                hook();
            }
        }
        self.demands.lock().unwrap().push(command.demand);
        self.drive.lock().unwrap().exchange(command)
    }

    fn stop(&mut self) -> Result<(), LinkError> {
        self.demands.lock().unwrap().push(Demand::Stop);
        self.drive.lock().unwrap().stop()
    }

    fn statistics(&self) -> LinkStatistics {
        self.drive.lock().unwrap().statistics()
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        None
    }
}

/// A bench in virtual time with a drive whose final state is read.
struct VirtualBench {
    out: tempfile::TempDir,
    drive: Arc<Mutex<MemoryLink>>,
    demands: Arc<Mutex<Vec<Demand>>>,
    clock: VirtualClock,
}

impl VirtualBench {
    fn new() -> Self {
        let config = EmulatorConfig::embedded("zk-22fc-plain").unwrap();
        let clock = VirtualClock::new();
        let drive = MemoryLink::new(SoftDrive::new(&config, 1), clock.clone(), Latency::default());
        Self {
            out: tempfile::tempdir().unwrap(),
            drive: Arc::new(Mutex::new(drive)),
            demands: Arc::default(),
            clock,
        }
    }

    fn runs(&self) -> std::path::PathBuf {
        self.out.path().join("runs")
    }

    fn options(&self) -> RigOptions {
        let text = include_str!("../../bench-configs/benches/zk-22fc-emulated.toml");
        let (head, _) = text.split_once("[[sequence]]").unwrap();
        let bench = BenchFile::parse("bench.toml", &format!("{head}{SEQUENCE}")).unwrap();
        RigOptions {
            bench,
            switches: Switches { out: self.runs(), headless: true, ..Switches::default() },
            escalate: false,
            mystery: false,
            words: String::new(),
            terminal: Terminal::default(),
        }
    }

    /// A rig over the drive, with an empty hook.
    fn rig(&self) -> Rig {
        let open = self.opener(|| ());
        open(self.options(), None, Purpose::Voltages).unwrap()
    }

    fn opener(&self, hook: impl FnMut() + Send + 'static) -> OpenRig {
        let link = RecordingLink {
            drive: Arc::clone(&self.drive),
            demands: Arc::clone(&self.demands),
            at_speed: Some(Box::new(hook)),
            before: 5,
        };
        let clock = self.clock.clone();
        Box::new(move |options, _, purpose| {
            Rig::with_link(options, purpose, Box::new(link), Box::new(clock))
        })
    }

    fn work(
        &self,
        hook: impl FnMut() + Send + 'static,
    ) -> impl FnOnce(&Controls) -> Result<RunDone, Failure> + Send + 'static {
        let (options, open) = (self.options(), self.opener(hook));
        move |controls| run(options, None, open, controls)
    }

    /// The drive reports off, without a fault, and not by its watchdog.
    #[track_caller]
    fn expect_stopped(&self) {
        let last = self.demands.lock().unwrap().last().copied();
        assert_eq!(last, Some(Demand::Stop));
        let mut drive = self.drive.lock().unwrap();
        let command = Command { seq: 1 << 20, demand: Demand::Disable };
        let sample = drive.exchange(command).unwrap();
        assert_ne!(sample.state, Some(DriveState::Running));
        assert_eq!(sample.fault.unwrap_or(0), 0, "{:?}", sample.fault_text);
    }
}

fn headless<T>(work: impl FnOnce(&Controls) -> Result<T, Failure>) -> Result<T, Failure> {
    let (listener, notices) = channel();
    let (controls, _ends) = Controls::new(SnapshotCell::with_notices(listener));
    alone(&Terminal::default(), controls, notices, work)
}

fn recorded(done: Result<RunDone, Failure>) -> Recorded {
    match done {
        Ok(RunDone::Run(whole)) => whole.recorded,
        Ok(RunDone::NotFound(ending)) => panic!("{ending:?}"),
        Err(failure) => panic!("{failure:?}"),
    }
}

#[test]
fn a_bench_that_panics_stops_its_drive_with_status_6() {
    let bench = VirtualBench::new();
    let failure = headless(bench.work(|| panic!("on purpose"))).map(|_| ()).unwrap_err();
    assert_eq!(failure.status, INTERNAL);
    let headline = failure.headline();
    assert!(headline.contains("(on purpose)"), "{headline}");
    assert!(headline.contains("the drive has confirmed its stop"), "{headline}");
    bench.expect_stopped();
}

#[test]
fn a_bench_that_panics_in_its_checks_stops_its_drive_too() {
    let bench = VirtualBench::new();
    let (controls, _ends) = Controls::new(SnapshotCell::default());
    let mut rig = bench.rig();
    rig.energises(&controls, 0.0);
    let unwound = catch_unwind(AssertUnwindSafe(move || {
        let command = Command { seq: 1, demand: Demand::Voltage(5.0) };
        rig.connection.link.exchange(command).unwrap();
        panic!("on purpose");
    }));
    assert!(unwound.is_err());
    assert_eq!(controls.drive.get(), DrivePower::Panicked(Ok(())));
    bench.expect_stopped();
}

/// The screen panics, or fails, while the motor turns; the drive is ramped down, and only then the run is over.
fn left_at_speed(
    show: impl FnOnce() -> io::Result<Exit> + Send + 'static,
) -> (VirtualBench, Result<Ended<RunDone>, Failure>) {
    let bench = VirtualBench::new();
    let (at_speed, is_at_speed) = channel();
    let (controls, ends) = Controls::new(SnapshotCell::default());
    let interrupted = Arc::clone(&controls.interrupted);
    let work = bench.work(move || {
        at_speed.send(()).unwrap();
        // Virtual time stands until the screen is gone.
        while !interrupted.load(Ordering::Acquire) {
            thread::yield_now();
        }
    });
    let ended = with_screen(
        &Terminal::default(),
        controls,
        &ends,
        None,
        move |_| {
            is_at_speed.recv().unwrap();
            show()
        },
        work,
    );
    (bench, ended)
}

/// The record of a run that was ended so, and the status of the command.
#[track_caller]
fn interrupted(bench: &VirtualBench, ended: Result<Ended<RunDone>, Failure>) -> Failure {
    bench.expect_stopped();
    let ended = ended.unwrap_or_else(|failure| panic!("{failure:?}"));
    let recorded = recorded(Ok(ended.work));
    assert_eq!(recorded.summary.outcome, Outcome::Interrupted);
    ended.screen.conclude(recorded.failure()).unwrap_err()
}

#[test]
fn a_screen_that_panics_ends_the_run_with_status_6() {
    let (bench, ended) = left_at_speed(|| panic!("on purpose"));
    let failure = interrupted(&bench, ended);
    assert_eq!(failure.status, INTERNAL);
    let headline = failure.headline();
    assert!(headline.contains("screen has panicked (on purpose)"), "{headline}");
    // Down a ramp: a second request would switch off at once.
    let demands = bench.demands.lock().unwrap();
    let volts = |demand: &Demand| match demand {
        Demand::Voltage(volts) => *volts,
        _ => 0.0,
    };
    let fast = demands.iter().rposition(|demand| volts(demand) > 39.0);
    let ramp = demands[fast.unwrap_or_default()..].iter();
    let ramp = ramp.filter(|demand| volts(demand) > 0.0 && volts(demand) < 39.0);
    assert!(ramp.count() > 3, "{demands:?}");
}

#[test]
fn a_terminal_that_is_gone_ends_the_run_with_status_130() {
    let (bench, ended) = left_at_speed(|| Err(io::Error::from_raw_os_error(5)));
    assert_eq!(interrupted(&bench, ended).status, INTERRUPTED);
}

/// As one that reads keys from a terminal that is just being closed: the work is over, and the screen is not.
#[test]
fn a_screen_that_does_not_return_is_abandoned() {
    let stuck = || -> io::Result<Exit> {
        loop {
            thread::sleep(Duration::from_secs(1));
        }
    };
    assert!(matches!(watched(stuck, || (), || true), Ok(ScreenReturn::Failed(_))));
}

#[test]
fn the_end_of_a_run_goes_before_that_of_its_screen() {
    let failure = |status| Failure::new(status, "a headline");
    let status =
        |left: ScreenEnd, run: Option<u8>| left.conclude(run.map(failure)).map_err(|f| f.status);
    let panicked = || ScreenEnd::Panicked(failure(INTERNAL));
    let gone = || ScreenEnd::Gone(failure(INTERRUPTED));
    let closed = || ScreenEnd::Screen(Exit::Interrupted);
    for (left, run, expected) in [
        (panicked(), Some(LINK), Err(LINK)),
        (gone(), Some(LINK), Err(LINK)),
        (panicked(), Some(TRIP), Err(TRIP)),
        (gone(), Some(TRIP), Err(TRIP)),
        (panicked(), Some(INTERRUPTED), Err(INTERNAL)),
        (panicked(), None, Err(INTERNAL)),
        (gone(), Some(INTERRUPTED), Err(INTERRUPTED)),
        (gone(), Some(INTERNAL), Err(INTERNAL)),
        (gone(), None, Err(INTERRUPTED)),
        (closed(), Some(INTERRUPTED), Err(INTERRUPTED)),
        (closed(), None, Ok(())),
    ] {
        let case = format!("{left:?} {run:?}");
        assert_eq!(status(left, run), expected, "{case}");
    }
}

#[test]
fn a_computer_that_was_suspended_ends_the_run_as_a_lost_link() {
    let bench = VirtualBench::new();
    let clock = bench.clock.clone();
    let demands = Arc::clone(&bench.demands);
    let before = Arc::new(Mutex::new(0));
    let mark = Arc::clone(&before);
    let done = headless(bench.work(move || {
        clock.suspend_s(30.0);
        *mark.lock().unwrap() = demands.lock().unwrap().len();
    }));
    let recorded = recorded(done);
    let failure = recorded.failure().unwrap();
    assert_eq!(failure.status, LINK);
    let headline = failure.headline();
    assert!(headline.contains("this computer was suspended for 30.0 s"), "{headline}");
    // The command that was being sent, then only stops.
    let demands = bench.demands.lock().unwrap();
    let after = &demands[*before.lock().unwrap() + 1..];
    assert!(!after.is_empty() && after.iter().all(|demand| *demand == Demand::Stop), "{after:?}");
    let notices = format!("{:?}", recorded.summary.notices);
    let events = std::fs::read_to_string(recorded.folder.events()).unwrap();
    for text in [&notices, &events] {
        for other in ["stood still", "silent"] {
            assert!(!text.contains(other), "{text}");
        }
        assert!(text.contains("suspended for 30.0 s"), "{text}");
    }
}

#[test]
fn a_later_run_finishes_without_a_disk() {
    let bench = VirtualBench::new();
    let (controls, _ends) = Controls::new(SnapshotCell::default());
    let mut rig = bench.rig();
    rig.check(&controls, false).unwrap();
    let first = rig.record("one", 1, &controls).unwrap();
    assert!(first.failure().is_none());
    std::fs::remove_dir_all(bench.runs()).unwrap();
    std::fs::write(bench.runs(), "a file stands in the way").unwrap();
    let mut second = rig.record("two", 2, &controls).unwrap();
    assert_eq!(second.summary.outcome, Outcome::Done);
    assert!(second.run_failure().is_none());
    let failure = second.failure().unwrap();
    assert_eq!(failure.status, INTERNAL);
    let headline = failure.headline();
    assert!(headline.contains("record could not be kept"), "{headline}");
    let loaded = second.load().unwrap();
    assert_eq!(loaded.run.rows() as u64, second.summary.rows);
    assert!(loaded.run.rows() > 100);
    // The folder of the first run is deleted too.
    assert_eq!(first.load().unwrap().run.rows() as u64, first.summary.rows);
    second.forget();
    assert!(second.load().is_err());
}

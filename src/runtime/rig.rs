//! The rig of a run on a live drive: link, clock, the emulator where it is ours, and the record of one run after the other.
//!
//! ```text
//! bench file + options -> Rig (link, clock, emulator if it is ours) -> check -> record -> run folder
//! ```

use std::fmt::Write as _;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use clap::Args;

use crate::runtime::controls::{Controls, DriveCell, DrivePower};
use crate::runtime::failure::{Failure, LINK, USAGE};
use crate::runtime::files::Recorded;
use crate::runtime::opening::{
    self, Reopener, Tap, announce, emulator_config, in_memory, now, on_a_line, serve, suited, tap,
    target, wired_profile,
};
use crate::runtime::output::Terminal;
use drivebench_bench::recording::{
    Event, Layout, Manifest, Record as _, Recorder, RunFolder, utc_stamp,
};
use drivebench_bench::{
    Bench, BenchFile, BenchFileError, CheckError, CheckOptions, CheckReport, Clock, CurrentsPilot,
    CurrentsSection, FirstMove, Guard, Level, LoopDelay, LostDrive, MonotonicClock, Nameplate,
    Notice, OnlineSettings, Outcome, Plan, PlanError, Port, RATE_CHECK, Reopened, RowEstimator,
    RunOptions, RunSummary, Session, Snapshot, SpeedPilot, Target, Waivers, check, layout,
    manifest, measure_delay, plan_run, reopen, run, stage_session,
};
use drivebench_emulator::{EmulatorConfig, Guise, ServerHandle, VirtualClock, mystery};
use drivebench_identify::escalation::Stage;
use drivebench_identify::online::OnlineConfig;
use drivebench_link::offer::{self, Purpose};
use drivebench_link::{DriveLink, DriveProfile, Identity, StopRequest, open_tapped};
use drivebench_model::excitation::Program;
use drivebench_model::numerics::count::whole;
use drivebench_model::plant::{Model, Motor};
use drivebench_model::sample::{Channel, Origin};

/// The name of the emulator's configuration in a bench file that hides it.
pub(crate) const MYSTERY: &str = "mystery";

/// Switches of every command that may energise a motor.
#[derive(Args, Clone, Debug, Default)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "switches of a command line, each independent of the others"
)]
pub(crate) struct Switches {
    /// Where run folders are made
    #[arg(long, value_name = "DIR", default_value = "runs")]
    pub out: PathBuf,
    /// No screen and no question: progress on stderr, the result on stdout, and the motor starts once the checks have passed.
    /// So too with --json, and where stdout is no terminal
    #[arg(long)]
    pub headless: bool,
    /// The drive is real and its shaft may turn: needed without a screen, and for the pulse of the checks
    #[arg(long)]
    pub hardware: bool,
    #[command(flatten)]
    pub waive: Waive,
    /// First clear a fault that the drive has latched, as after a killed host; then go on as without it: the motor turns
    #[arg(long)]
    pub reset_fault: bool,
    /// After a lost link: how long to look for the drive and bring it to rest, 0 (not at all) to 86400. Without it: the
    /// drive's watchdog time and 10 s; with a screen until Space, q or Ctrl-C ends the search
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    pub reopen_s: Option<f64>,
    /// Write what goes over the wire into a new capture file (pcap, for Wireshark)
    #[arg(long, value_name = "FILE")]
    pub tap: Option<PathBuf>,
    /// Write the samples of every run as columns too, samples.parquet next to samples.csv (a build with the feature parquet)
    #[arg(long)]
    pub parquet: bool,
}

/// Checks that may be waived, each by its own option. The waivers are recorded in the manifest, the log and the messages.
#[derive(Args, Clone, Copy, Debug, Default)]
#[expect(clippy::struct_field_names, reason = "the names of the options")]
pub(crate) struct Waive {
    /// Go on although the drive's watchdog is not proven: if this computer or the cable fails, perhaps nothing stops the
    /// motor; the waiver is recorded
    #[arg(long)]
    waive_watchdog: bool,
    /// Make no pulse before the first run: directions and nameplate stay unproven; the waiver is recorded
    #[arg(long)]
    waive_direction: bool,
    /// Go on although the pulse does not fit the nameplate; the waiver is recorded
    #[arg(long)]
    waive_plausibility: bool,
}

impl Waive {
    const fn waivers(self) -> Waivers {
        Waivers {
            watchdog: self.waive_watchdog,
            direction: self.waive_direction,
            plausibility: self.waive_plausibility,
        }
    }
}

/// The time of `--reopen-s`.
fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| "expected a number of seconds".to_owned())?;
    let is_allowed = (0.0..=86_400.0).contains(&seconds);
    is_allowed.then_some(seconds).ok_or_else(|| "allowed: 0 (off) to 86400 s".to_owned())
}

#[derive(Clone, Debug)]
pub(crate) struct RigOptions {
    pub bench: BenchFile,
    pub switches: Switches,
    /// The motor is to be found from small steps before anything is planned.
    pub escalate: bool,
    /// A hidden effect is requested, which only our own emulator has.
    pub mystery: bool,
    /// Bench, link and motor as options of the commands that follow.
    pub words: String,
    pub terminal: Terminal,
}

/// Opens a rig: [`Rig::open`], or a test's own.
pub(crate) type OpenRig =
    Box<dyn FnOnce(RigOptions, Option<u64>, Purpose) -> Result<Rig, Failure> + Send>;

/// A session that is ready to be recorded.
struct Planned {
    session: Session,
    motor: Option<Nameplate>,
    /// It continues a sequence that was started by hand.
    follows: bool,
    speed: Option<SpeedAbout>,
}

impl Planned {
    const fn of(session: Session, motor: Option<Nameplate>) -> Self {
        Self { session, motor, follows: false, speed: None }
    }
}

/// Data of a speed loop for its record.
pub(crate) struct SpeedAbout {
    /// The model that it was tuned on, as a model file.
    pub(crate) model: String,
    pub(crate) manifest: serde_json::Value,
}

/// An open drive with its clock, and the emulator's thread where it is ours.
///
/// Whatever unwinds through it, in the checks, in a run or between two, stops the drive.
pub(crate) struct Rig {
    /// As given, but for the bench, which changes with the motor that is found, and what is done once.
    pub(crate) options: RigOptions,
    pub(crate) bench: BenchFile,
    pub(crate) profile: DriveProfile,
    /// Its file, as it was read.
    profile_text: String,
    pub(crate) connection: Connection,
    /// A run has lost its drive: no run follows it, and the checks with their pulse need a new start of the program.
    lost: bool,
    /// The drive that has answered its checks, whether it has passed them or not.
    pub(crate) answered: Option<Identity>,
    pub(crate) last_seq: u64,
    /// There are records already, which are of no use without the run that follows.
    has_recorded: bool,
    pub(crate) check: Option<CheckReport>,
    pub(crate) escalates: bool,
    /// The motor of the bench file, whatever is found later.
    pub(crate) nameplate_motor: Motor,
    power: DriveCell,
}

pub(crate) struct Connection {
    pub(crate) link: Box<dyn DriveLink>,
    pub(crate) clock: Box<dyn Clock + Send>,
    /// Opens the link again; `None` for a drive in memory.
    pub(crate) reopener: Option<Reopener>,
    /// Dropping it completes the capture, so it outlives the link.
    pub(crate) tap: Tap,
    /// None on a real drive.
    pub(crate) emulator: Option<EmulatorConfig>,
    /// Dropping it ends the emulator, so it outlives the link.
    _server: Option<ServerHandle>,
}

impl Rig {
    /// Opens the link. The emulator is used only where the bench file or the command line names it.
    ///
    /// `run_seed`: one run of several is requested, for which the emulator draws other noise. A `purpose` for which the drive has
    /// not the signals is refused before anything is opened.
    pub(crate) fn open(
        mut options: RigOptions,
        run_seed: Option<u64>,
        purpose: Purpose,
    ) -> Result<Self, Failure> {
        let (profile, profile_text) = wired_profile(&mut options.bench)?;
        suited(&profile, purpose)?;
        if options.switches.headless {
            announce(&profile, &options.terminal);
        }
        let connection = Connection::of(&options, run_seed, &profile)?;
        Ok(Self::of(options, profile, profile_text, connection))
    }

    /// A rig over a link and a clock in virtual time.
    #[cfg(test)]
    pub(crate) fn with_link(
        mut options: RigOptions,
        purpose: Purpose,
        link: Box<dyn DriveLink>,
        clock: Box<dyn Clock + Send>,
    ) -> Result<Self, Failure> {
        let (profile, profile_text) = wired_profile(&mut options.bench)?;
        suited(&profile, purpose)?;
        let tap = Tap::create(None, &options.terminal)?;
        let connection =
            Connection { link, clock, reopener: None, tap, emulator: None, _server: None };
        Ok(Self::of(options, profile, profile_text, connection))
    }

    fn of(
        options: RigOptions,
        profile: DriveProfile,
        profile_text: String,
        connection: Connection,
    ) -> Self {
        let bench = options.bench.clone();
        Self {
            lost: false,
            answered: None,
            profile,
            profile_text,
            connection,
            last_seq: 0,
            has_recorded: false,
            check: None,
            escalates: options.escalate || bench.motor.is_unknown(),
            nameplate_motor: bench.motor.motor(),
            power: DriveCell::default(),
            options,
            bench,
        }
    }

    /// From here on the drive may be on, until what is returned is dropped.
    pub(crate) fn energises(&mut self, controls: &Controls, ramp_s: f64) {
        // The shaft comes to rest within 8 s after the output is zero, as session and checks allow it; checks, a burst and the
        // last exchanges take at most 5 s.
        let end_s = ramp_s + 8.0 + 5.0 + self.connection.link.command_times().stop_s;
        self.power = controls.drive.clone();
        self.power.set(DrivePower::MayBeOn { end_s });
    }

    /// The drive has confirmed that it stopped.
    pub(crate) fn is_confirmed_off(&self) {
        self.power.set(DrivePower::Off);
    }

    /// Identity, limits, link probe, watchdog proof, direction pulse, of which the last is not made where the shaft is to stay
    /// `at_rest`; the refusal is the first check that failed.
    pub(crate) fn check(
        &mut self,
        controls: &Controls,
        at_rest: bool,
    ) -> Result<CheckReport, Failure> {
        if self.escalates && self.bench.load.vertical {
            return Err(Failure::usage(
                "the small steps that find an unknown motor would let a vertical load fall",
                "give the motor's data in [motor], or take the load off",
            ));
        }
        if !at_rest && !self.has_recorded {
            self.can_record()?;
        }
        self.energises(controls, 0.0);
        let nameplate = self.bench.nameplate().filter(|_| !self.escalates);
        let flags = controls.stop_flags();
        let stopped = move || flags.iter().any(|flag| flag.load(Ordering::Acquire));
        let first_move = nameplate.as_ref().map(|nameplate| FirstMove {
            nameplate,
            profile: &self.profile,
            is_withheld: at_rest,
        });
        let options = CheckOptions {
            rate_hz: self.bench.link.rate_hz,
            // A screen shows SIM or HARDWARE, and a person starts by hand; without one the option is needed.
            hardware_allowed: self.options.switches.hardware || !self.options.switches.headless,
            hardware_confirmed: self.options.switches.hardware,
            waivers: self.options.switches.waive.waivers(),
            first_move,
            stopped: &stopped,
            reset_fault: std::mem::take(&mut self.options.switches.reset_fault),
        };
        let (link, clock) = (self.connection.link.as_mut(), self.connection.clock.as_mut());
        let report = check(link, clock, &self.bench.limits(), options);
        if matches!(report, Ok(_) | Err(CheckError::Stopped)) {
            self.is_confirmed_off();
        }
        let report = report.map_err(|error| {
            let reopener = self.connection.reopener.as_ref();
            Failure::from(error).with_remark(reopener.and_then(Reopener::other_reader).as_deref())
        })?;
        self.answered = Some(report.identity.clone());
        if controls.is_stopped() {
            return Err(Failure::interrupted("interrupted in the checks; nothing is energised"));
        }
        if let Some(item) = report.refusal() {
            // A rate that is too high for the baud rate is an error of usage; a rate that the link does not reach is one of the link.
            let status = if item.name == RATE_CHECK { USAGE } else { LINK };
            let failure = Failure::new(status, format!("{}: {}", item.name, item.text));
            return Err(failure.helped_by(item.help));
        }
        self.last_seq = report.last_seq;
        self.check = Some(report.clone());
        Ok(report)
    }

    /// Predicts the sequence with this seed; refuses it where a limit would be exceeded.
    pub(crate) fn plan(&self, seed: u64) -> Result<Plan, Failure> {
        let (nameplate, rate_hz) = (self.nameplate()?, self.bench.link.rate_hz);
        let plan = plan_run(&self.bench, seed, &nameplate, rate_hz, self.drive_current_limit_a())
            .map_err(|error| failed_plan(&self.bench.name, error))?;
        if let Some(refusal) = plan.refusals.first() {
            return Err(Failure::usage(format!("plan refused: {refusal}"), refusal.help()));
        }
        Ok(plan)
    }

    /// The motor for the plan: that of the bench file, or the one that was found.
    pub(crate) fn nameplate(&self) -> Result<Nameplate, Failure> {
        nameplate(&self.bench)
    }

    /// The drive's own limit, as read back by the check.
    pub(crate) fn drive_current_limit_a(&self) -> Option<f64> {
        self.check.as_ref()?.identity.current_limit_a
    }

    /// The drive can record bursts by itself.
    pub(crate) fn records_bursts(&mut self) -> bool {
        self.connection.link.burst().is_some()
    }

    fn program(&self, seed: u64) -> Result<Program, Failure> {
        let file = self.bench.name.clone();
        Ok(self.bench.program(seed).map_err(|error| BenchFileError::Sequence { file, error })?)
    }

    fn guard(&self, motor: &Nameplate) -> Guard {
        Guard::new(self.bench.limits(), motor, self.drive_current_limit_a())
            .with_period(self.bench.period_s())
    }

    /// Records one run into a new folder. The drive is at zero output on return, whatever happened.
    pub(crate) fn record(
        &mut self,
        name: &str,
        seed: u64,
        controls: &Controls,
    ) -> Result<Recorded, Failure> {
        let motor = self.nameplate()?;
        let guard = self.guard(&motor);
        let session = if let Some(currents) = &self.bench.currents {
            let silence_s = self.bench.limits().link_silence_s;
            Session::new(Box::new(CurrentsPilot::new(currents, Some(seed), silence_s)), guard)
        } else {
            let brake = self.bench.load.brake();
            let hold_v = brake.map_or(0.0, |brake| brake.hold_current_a * motor.resistance_ohm);
            Session::new(Box::new(self.program(seed)?), guard)
                .holding(hold_v)
                .with_burst_at(self.bench.runs.burst_at.map(|part| part - 1))
        };
        self.record_session(name, seed, Planned::of(session, Some(motor)), controls)
    }

    /// Records the search for an unknown motor by currents whose levels rise.
    pub(crate) fn record_search(
        &mut self,
        name: &str,
        section: &CurrentsSection,
        controls: &Controls,
    ) -> Result<Recorded, Failure> {
        let limits = self.bench.limits();
        let pilot = CurrentsPilot::new(section, None, limits.link_silence_s);
        let guard = Guard::for_unknown_motor(limits, None, 0.0).with_period(self.bench.period_s());
        let session = Session::new(Box::new(pilot), guard);
        self.record_session(name, self.bench.runs.fit, Planned::of(session, None), controls)
    }

    /// Measures the delay of a loop over this link, with the output off; `None` where the drive does not report it.
    pub(crate) fn measure_delay(
        &mut self,
        controls: &Controls,
    ) -> Result<Option<LoopDelay>, Failure> {
        let rate_hz = self.bench.link.rate_hz;
        self.energises(controls, 0.0);
        let (link, clock) = (self.connection.link.as_mut(), self.connection.clock.as_mut());
        let (delay, last_seq) = measure_delay(link, clock, rate_hz, self.last_seq)?;
        self.is_confirmed_off();
        self.last_seq = last_seq;
        Ok(delay)
    }

    /// Records one run of a speed loop; `about` goes into its manifest.
    pub(crate) fn record_loop(
        &mut self,
        name: &str,
        pilot: SpeedPilot,
        about: SpeedAbout,
        controls: &Controls,
    ) -> Result<Recorded, Failure> {
        let motor = self.nameplate()?;
        let session = Session::new(Box::new(pilot), self.guard(&motor));
        let run = Planned { speed: Some(about), ..Planned::of(session, Some(motor)) };
        self.record_session(name, self.bench.runs.fit, run, controls)
    }

    /// Records one stage of an escalation. The first one on a real motor is started by hand; the others `follow` it.
    pub(crate) fn record_stage(
        &mut self,
        name: &str,
        stage: &Stage,
        follows: bool,
        controls: &Controls,
    ) -> Result<Recorded, Failure> {
        let file = self.bench.name.clone();
        let session = stage_session(&self.bench, stage)
            .map_err(|error| Failure::from(BenchFileError::Sequence { file, error }))?;
        let run = Planned { follows, ..Planned::of(session, None) };
        self.record_session(name, self.bench.runs.fit, run, controls)
    }

    fn record_session(
        &mut self,
        name: &str,
        seed: u64,
        planned: Planned,
        controls: &Controls,
    ) -> Result<Recorded, Failure> {
        if self.lost {
            let headline = "the drive was lost in the run before: no run is started automatically";
            return Err(Failure::new(LINK, headline));
        }
        let unchecked = || Failure::internal("a run without a check before it");
        let report = self.check.clone().ok_or_else(unchecked)?;
        let target = Target::of(&report.identity);
        let session = planned
            .session
            .after_seq(self.last_seq)
            .with_rest(&report.rest)
            .with_brake(self.bench.load.brake())
            .with_watchdog(report.identity.watchdog_s)
            .with_waivers(report.waived.iter().map(|&name| name.to_owned()).collect());
        let mut manifest = self.manifest(name, seed, &report);
        let mut commands = vec![session.command_channel()];
        if let Some(about) = planned.speed {
            commands.insert(0, Channel::Reference);
            manifest.configs.insert("model".to_owned(), about.model);
            manifest.speed_loop = about.manifest;
        }
        for command in &commands {
            manifest.set_origin(*command, Origin::Commanded);
        }
        let mut layout = layout(&commands, &report.signals);
        if !self.connection.clock.is_real() {
            layout = layout.without_host_time();
        }
        let known = OnlineConfig::from_model(&Model::baseline(self.bench.motor.motor()));
        let sensors = self.profile.registers.as_ref().map_or(known.sensors, |map| map.sensors());
        let config = OnlineConfig { sensors, ..known };
        manifest
            .configs
            .insert(OnlineSettings::NAME.to_owned(), OnlineSettings::from(config).text());
        let mut recorder = self.recorder(name, &layout, &manifest)?;
        let mut online = RowEstimator::new(config);
        let sent_before = self.connection.link.statistics().sent;
        self.energises(controls, session.guard().ramp_down_s());
        if let Some(stop_request) = self.connection.link.stop_request() {
            *stop_request = StopRequest::watching(controls.stop_flags());
        }
        let mut summary = run(
            session,
            Bench {
                link: self.connection.link.as_mut(),
                clock: self.connection.clock.as_mut(),
                recorder: &mut recorder,
                estimator: Some(&mut online),
                intents: controls.intents(),
                interrupted: &controls.interrupted,
                snapshots: &controls.snapshots,
            },
            &RunOptions {
                name: name.to_owned(),
                target,
                rate_hz: self.bench.link.rate_hz,
                motor: planned.motor,
                // With a screen a real motor is started by hand, after a question.
                auto_start: target == Target::Sim
                    || self.options.switches.headless
                    || planned.follows,
            },
        );
        self.last_seq += summary.link.sent - sent_before + 1;
        self.note_other_reader(&mut summary, &mut recorder, controls);
        if summary.stop_error.is_none() {
            self.is_confirmed_off();
        }
        if summary.lost_its_drive() {
            self.lost = true;
            self.search_lost_drive(&mut summary, &mut recorder, controls);
        }
        summary.describe(&mut manifest);
        if let Some(report) = &summary.speed {
            manifest.speed_loop["delay_while_running"] = serde_json::json!(report.delay);
        }
        // The writer thread may still have been busy when the run ended: only now is every row counted.
        let kept = recorder.finish(&manifest);
        self.has_recorded = true;
        summary.rows = kept.status.rows as u64;
        summary.recorder_error.clone_from(&kept.status.error);
        let shown = Snapshot { rows: summary.rows, ..(*controls.snapshots.latest()).clone() };
        controls.snapshots.publish(shown);
        manifest.finished = true;
        manifest.rows = Some(kept.status.rows);
        let terminal = self.options.terminal.clone();
        let mut recorded = Recorded::new(kept, manifest, summary, online.result(), terminal);
        recorded.keep_capture(name);
        // Kept at once: what follows may be interrupted.
        recorded.write_result(&serde_json::json!({}));
        if self.options.switches.parquet {
            recorded.keep_parquet();
        }
        Ok(recorded)
    }

    /// The first move is made only where a folder for the record can be: one is made and removed again, where that of the
    /// runs is or would be.
    fn can_record(&self) -> Result<(), Failure> {
        let parent = self.options.switches.out.ancestors().find(|parent| parent.exists());
        let parent = parent.unwrap_or(Path::new("."));
        let made = RunFolder::create(parent, &utc_stamp(now()), &self.bench.name)?;
        std::fs::remove_dir(made.path()).map_err(|error| {
            Failure::new(USAGE, format!("{}: cannot remove: {error}", made.path().display()))
        })
    }

    /// A run whose record cannot be begun is refused, with nothing energised; one that follows others goes on in memory.
    fn recorder(
        &self,
        name: &str,
        layout: &Layout,
        manifest: &Manifest,
    ) -> Result<Recorder, Failure> {
        let sync_every = whole(self.bench.link.rate_hz.ceil());
        let made = RunFolder::create(&self.options.switches.out, &manifest.stamp, name)
            .and_then(|folder| Recorder::create(folder, layout.clone(), manifest, sync_every));
        match made {
            Err(error) if self.has_recorded => {
                let folder = RunFolder::unmade(&self.options.switches.out, &manifest.stamp, name);
                Ok(Recorder::without_disk(folder, layout.clone(), manifest, sync_every, &error)?)
            }
            made => Ok(made?),
        }
    }

    fn manifest(&self, name: &str, seed: u64, report: &CheckReport) -> Manifest {
        let link = self.connection.link.name();
        let mut manifest = manifest(&self.bench, seed, &link, report);
        name.clone_into(&mut manifest.name);
        manifest.stamp = utc_stamp(now());
        if let Some(emulator) = &self.connection.emulator {
            let text = toml::to_string(emulator).unwrap_or_default();
            manifest.configs.insert("emulator".to_owned(), text);
        }
        manifest.configs.insert("drive".to_owned(), self.profile_text.clone());
        manifest.configs.insert("drive_provenance".to_owned(), self.profile.provenance());
        for (channel, text) in offer::carried(&self.profile) {
            manifest.carried.insert(channel.key().to_owned(), text);
        }
        if let Some(map) = &self.profile.registers {
            let stated = map.sensors();
            manifest.speed_filter_s =
                Some(stated.speed.filter_s).filter(|filter_s| *filter_s > 0.0);
            manifest.averages_current = stated.averages_current;
            manifest.duty_ramp_per_s = map.duty_ramp_per_s();
        }
        for channel in Channel::ALL {
            if let Some(origin) = self.profile.signals.get(channel) {
                manifest.set_origin(channel, origin);
            }
            if let Some(side) = self.profile.sides.get(channel) {
                manifest.set_side(channel, side);
            }
        }
        manifest
    }

    /// Notes which other program has the port open, if replies were lost; after the drive has received its stop.
    fn note_other_reader(
        &self,
        summary: &mut RunSummary,
        recorder: &mut Recorder,
        controls: &Controls,
    ) {
        let reopener = self.connection.reopener.as_ref();
        let has_lost = summary.link.sent > summary.link.ok;
        let Some(text) = reopener.filter(|_| has_lost).and_then(Reopener::other_reader) else {
            return;
        };
        let time_s = self.connection.clock.now_s() + summary.end.drive_minus_host_s;
        let event = Event::new(time_s, None, "other_reader");
        recorder.event(event.with("text", text.as_str()));
        if let Outcome::LinkLost { reason } = &mut summary.outcome {
            *reason = format!("{reason}; {text}");
        }
        let notice = Notice { level: Level::Warning, text };
        let mut shown = (*controls.snapshots.latest()).clone();
        shown.notices.push(notice.clone());
        controls.snapshots.publish(shown);
        controls.snapshots.send(&notice);
        summary.notices.push(notice);
    }

    /// Looks for the drive again, brings it to rest and reports what was found; the run stays lost.
    pub(crate) fn search_lost_drive(
        &mut self,
        summary: &mut RunSummary,
        recorder: &mut Recorder,
        controls: &Controls,
    ) {
        let (Some(reopener), Some(check)) = (&self.connection.reopener, &self.check) else {
            return;
        };
        // With a screen the user ends the search. Without one: the time in which the drive's own watchdog stops it, and 10 s to
        // put a plug back.
        let default_s =
            self.options.switches.headless.then(|| check.identity.watchdog_s.unwrap_or(0.0) + 10.0);
        let limit_s = reopener.limit_s.or(default_s);
        if limit_s == Some(0.0) {
            return;
        }
        self.connection.link.close();
        let link = reopener.link.as_str();
        if self.options.switches.headless {
            let time = limit_s.map_or_else(String::new, |limit_s| format!(" for {limit_s:.1} s"));
            self.options
                .terminal
                .message(&format!("link lost: looking for {link} again{time}; Ctrl-C ends that"));
        }
        let (profile, tap) = (&self.profile, self.connection.tap.file());
        let (reopened, link) = reopen(
            LostDrive {
                clock: self.connection.clock.as_mut(),
                recorder,
                stopped: &|| controls.is_stopped(),
                intents: controls.intents(),
                snapshots: &controls.snapshots,
                link,
                before: &check.identity,
                end: summary.end,
                seq: self.last_seq,
                limit_s,
                seed: std::process::id().into(),
            },
            &mut || reopener.open(profile, tap),
        );
        if let Some(link) = link {
            self.connection.link = link;
            self.last_seq += 1;
        }
        if self.options.switches.headless {
            self.options.terminal.message(&self.reopening_text(&reopened));
        }
        if reopened.is_safe() {
            self.is_confirmed_off();
        }
        summary.reopened = Some(reopened);
    }

    /// What was found, with the profile's remark on a drive that has just been switched on.
    fn reopening_text(&self, reopened: &Reopened) -> String {
        let registers = self.profile.registers.as_ref();
        let inactive_s = registers.map_or(0.0, |map| map.watchdog.keys.boot_delay_s);
        let mut text = reopened.text.clone();
        if inactive_s > 0.0 && reopened.identity.is_some() {
            let _ = write!(
                text,
                "; if it was switched off, its watchdog is not active for {inactive_s} s"
            );
        }
        text
    }
}

impl Connection {
    fn of(
        options: &RigOptions,
        run_seed: Option<u64>,
        profile: &DriveProfile,
    ) -> Result<Self, Failure> {
        let bench = &options.bench;
        let guise = Guise::of(profile);
        let port = bench.port();
        let mut emulator = match &port {
            // The next experiment of a mystery is a bench file that names it, so that the same machine can be run again.
            Port::Emulator | Port::Sim | Port::SimRtu if bench.emulator.config == MYSTERY => {
                Some(mystery::draw(bench.emulator.seed).config)
            }
            Port::Emulator | Port::Sim | Port::SimRtu => {
                Some(emulator_config(&bench.emulator.config)?)
            }
            Port::Tcp(_) | Port::Serial(_) if !options.mystery => None,
            Port::Tcp(_) | Port::Serial(_) => {
                let port = &bench.link.port;
                return Err(Failure::usage(
                    format!(
                        "--mystery hides an effect in our own emulator, and the port is {port}"
                    ),
                    "give --port sim: or --port emulator; for another program's port, `drivebench emulate --mystery SEED`",
                ));
            }
        };
        if let (Some(config), Some(seed)) = (&mut emulator, run_seed) {
            config.day = seed.wrapping_sub(bench.runs.fit);
        }
        let tap = tap(options.switches.tap.as_deref(), &port, &options.terminal)?;
        let real = MonotonicClock::start();
        let (mut clock, mut server): (Box<dyn Clock + Send>, _) = (Box::new(real), None);
        let mut address = bench.link.port.clone();
        let open = |address: &str| {
            let target = target(address, bench)?;
            Ok::<_, Failure>(open_tapped(&target, profile, real.origin(), tap.file())?)
        };
        let link: Box<dyn DriveLink> = match (&port, &emulator) {
            (Port::Sim, Some(config)) if profile.link.protocol.has_memory_link() => {
                let time = VirtualClock::new();
                clock = Box::new(time.clone());
                in_memory(config, bench, guise.as_ref(), time)?
            }
            (Port::Sim | Port::SimRtu, Some(config)) => {
                let time = VirtualClock::new();
                clock = Box::new(time.clone());
                on_a_line(config, bench, guise.as_ref(), profile, time)?
            }
            (Port::Emulator, Some(config)) => {
                let (protocol, mut served) = (profile.link.protocol, config.clone());
                served.line.baud = bench.baud();
                let handle = serve(protocol, served, bench.emulator.seed, guise)?;
                if options.switches.headless {
                    options.terminal.message(&format!("software drive {}", handle.ready_line()));
                }
                address = opening::address(protocol, &handle);
                server = Some(handle);
                open(&address)?
            }
            (Port::Tcp(_) | Port::Serial(_), _) => open(&address)?,
            (Port::Sim | Port::SimRtu | Port::Emulator, None) => {
                return Err(Failure::internal("an emulator is requested and not configured"));
            }
        };
        let reopener = if port.is_virtual() {
            None
        } else {
            let target = target(&address, bench)?;
            Some(Reopener::of(&target, real.origin(), options.switches.reopen_s))
        };
        Ok(Self { link, clock, reopener, tap, _server: server, emulator })
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        if !std::thread::panicking() || self.lost {
            return;
        }
        // What has panicked may be the link itself, and nothing may unwind out of here.
        let link = &mut self.connection.link;
        let stopped = catch_unwind(AssertUnwindSafe(|| link.stop()));
        self.power.set(DrivePower::Panicked(match stopped {
            Ok(stopped) => stopped.map_err(|error| error.to_string()),
            Err(_) => Err("the link has panicked as well".to_owned()),
        }));
    }
}

/// Why a run of this bench cannot be predicted.
pub(crate) fn failed_plan(bench: &str, error: PlanError) -> Failure {
    match error {
        PlanError::Model(error) => error.into(),
        PlanError::Sequence(error) => {
            BenchFileError::Sequence { file: bench.to_owned(), error }.into()
        }
    }
}

/// The whole nameplate of a bench file.
pub(crate) fn nameplate(bench: &BenchFile) -> Result<Nameplate, Failure> {
    bench.nameplate().ok_or_else(|| {
        let key = bench.motor.missing().unwrap_or("a value");
        Failure::usage(
            format!("motor.{key} is left out: the motor is not known, so nothing can be planned"),
            "`drivebench run` and `commission` find it from small steps first; or complete [motor]",
        )
    })
}

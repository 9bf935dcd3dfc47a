//! The rig of a run on a live drive: link, clock, the emulator where it is ours, and the record of one run after the other.
//!
//! ```text
//! bench file + what was asked -> Rig (link, clock, emulator if it is ours) -> check -> record -> run folder
//! ```
//!
//! This file owns the wall clock (the stamp of run folders).

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;

use super::checks::Consent;
use super::failure::{Failure, INTERNAL, LINK, USAGE};
use super::opening::{emulator_config, in_memory, open, serve, suited, tap, target, wired_profile};
use super::recorded::Recorded;
use super::reopening::Reopener;
use super::strings::{DriveCell, DriveWord, Strings};
use super::tap::Tap;
use super::{output, seal};
use crate::bench::{
    Bench, BenchFile, BenchFileError, CheckReport, Clock, Guard, LiveOnline, LoopDelay,
    MonotonicClock, Nameplate, OnlineSettings, Plan, Port, Protocol, RunOptions, Session,
    SpeedPilot, Target, Waivers, layout, layout_with_reference, manifest, measure_delay, plan, run,
    stage_session,
};
use crate::drive::offer::{self, Purpose};
use crate::drive::{CutIn, DriveLink, DriveProfile};
use crate::emulator::{EmulatorConfig, Guise, ServerHandle, VirtualClock, mystery};
use crate::identification::escalation::Stage;
use crate::identification::online::OnlineConfig;
use crate::numerics::count::whole;
use crate::plant::{Model, Motor};
use crate::recording::{Layout, Manifest, Recorder, RunFolder, utc_stamp};
use crate::sample::{Channel, Origin};

/// What stands for the emulator's configuration in a bench file that hides it.
pub(crate) const MYSTERY: &str = "mystery";

/// What checks, a burst or the last words over a link may take beside the times of the drive itself, s.
const EXCHANGES_S: f64 = 5.0;
/// The shaft's way to rest after the output has reached zero, as session and checks allow it, s.
const TO_REST_S: f64 = 8.0;

/// What is asked of a rig.
#[derive(Clone, Debug)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "switches of a command line, each independent of the others"
)]
pub struct RigOptions {
    pub bench: BenchFile,
    /// Where run folders are made.
    pub out: PathBuf,
    /// Nobody looks at a screen.
    pub headless: bool,
    /// The drive is real and its shaft may turn, in so many words.
    pub hardware: bool,
    /// The motor is to be found from small steps before anything is planned.
    pub escalate: bool,
    pub waivers: Waivers,
    pub reset_fault: bool,
    /// How long to look for a drive that was lost, s; `None`: as long as seems right.
    pub reopen_s: Option<f64>,
    /// Where the capture of the wire goes.
    pub tap: Option<PathBuf>,
    /// A mystery was asked for, which only our own emulator has.
    pub mystery: bool,
}

/// How a rig is come by: [`Rig::open`], or a test's own.
pub type OpenRig = Box<dyn FnOnce(RigOptions, Option<u64>, Purpose) -> Result<Rig, Failure> + Send>;

/// A session that is ready to be recorded.
struct Planned {
    session: Session,
    motor: Option<Nameplate>,
    /// It goes on with what was started by hand before.
    follows: bool,
    speed: Option<SpeedAbout>,
}

/// What the record says about a speed loop.
pub(crate) struct SpeedAbout {
    /// The model that it was tuned on, as a model file.
    pub(crate) model: String,
    pub(crate) manifest: serde_json::Value,
}

/// An open drive with its clock, and the emulator's thread where it is ours.
///
/// Whatever unwinds through it, in the checks, in a run or between two, leaves the drive told to stop.
#[expect(
    clippy::struct_excessive_bools,
    reason = "each is a fact of its own about the rig"
)]
pub struct Rig {
    pub(crate) bench: BenchFile,
    pub(crate) profile: DriveProfile,
    /// Its file, as it was read.
    profile_text: String,
    pub(crate) link: Box<dyn DriveLink>,
    /// A run has lost its drive: none follows it, and the checks with their pulse are for whoever starts the program anew.
    lost: bool,
    /// Opens the link again; `None` for a drive in memory.
    pub(crate) reopener: Option<Reopener>,
    /// Dropping it completes the capture, so it outlives the link.
    pub(crate) tap: Tap,
    pub(crate) clock: Box<dyn Clock + Send>,
    pub(crate) last_seq: u64,
    /// There are runs of it already, which are worth nothing without the one that follows.
    has_recorded: bool,
    pub(crate) check: Option<CheckReport>,
    pub(crate) consent: Consent,
    pub(crate) headless: bool,
    /// The motor is to be found from small steps before anything is planned.
    pub(crate) escalates: bool,
    /// What the bench file says about the motor, whatever is found later.
    pub(crate) plate: Motor,
    out: PathBuf,
    /// None where the truth is not to be told.
    pub(crate) emulator: Option<EmulatorConfig>,
    /// Told whether the drive may be on.
    word: DriveCell,
    /// Dropping it ends the emulator, so it outlives the link.
    _server: Option<ServerHandle>,
}

/// A way to a drive that is open.
struct Opened {
    link: Box<dyn DriveLink>,
    clock: Box<dyn Clock + Send>,
    reopener: Option<Reopener>,
    tap: Tap,
    server: Option<ServerHandle>,
    emulator: Option<EmulatorConfig>,
}

impl Rig {
    /// Opens the link. The emulator is used only where the bench file or the command line names it.
    ///
    /// `run_seed` where one run of several is asked for: the emulator then has another day.
    /// What the drive's signals cannot carry of the `purpose` is refused before anything is opened.
    pub fn open(
        mut options: RigOptions,
        run_seed: Option<u64>,
        purpose: Purpose,
    ) -> Result<Self, Failure> {
        let (profile, profile_text) = wired_profile(&mut options.bench)?;
        suited(&profile, purpose, options.headless)?;
        let opened = Opened::of(&options, run_seed, &profile)?;
        Ok(Self::of(options, profile, profile_text, opened))
    }

    /// A rig over a link and a clock that are there already, as a test in virtual time has them; `reopener` opens the link
    /// anew after a run that has lost it.
    pub fn with_link(
        mut options: RigOptions,
        purpose: Purpose,
        link: Box<dyn DriveLink>,
        clock: Box<dyn Clock + Send>,
        reopener: Option<Reopener>,
    ) -> Result<Self, Failure> {
        let (profile, profile_text) = wired_profile(&mut options.bench)?;
        suited(&profile, purpose, false)?;
        let opened = Opened {
            link,
            clock,
            reopener,
            tap: Tap::create(None)?,
            server: None,
            emulator: None,
        };
        Ok(Self::of(options, profile, profile_text, opened))
    }

    fn of(
        options: RigOptions,
        profile: DriveProfile,
        profile_text: String,
        opened: Opened,
    ) -> Self {
        let bench = options.bench;
        Self {
            lost: false,
            reopener: opened.reopener,
            profile,
            profile_text,
            link: opened.link,
            tap: opened.tap,
            clock: opened.clock,
            last_seq: 0,
            has_recorded: false,
            check: None,
            consent: Consent {
                // A person at a screen sees SIM or HARDWARE and starts by hand; without one the word is needed.
                hardware: options.hardware || !options.headless,
                hardware_said: options.hardware,
                waivers: options.waivers,
                reset_fault: options.reset_fault,
            },
            headless: options.headless,
            escalates: options.escalate || bench.motor.is_unknown(),
            plate: bench.motor.motor(),
            out: options.out,
            emulator: opened.emulator,
            word: DriveCell::default(),
            _server: opened.server,
            bench,
        }
    }

    /// From here on the drive may be on, until what is returned is dropped.
    pub(crate) fn energises(&mut self, strings: &Strings, ramp_s: f64) {
        let end_s = ramp_s + TO_REST_S + EXCHANGES_S + self.link.command_times().stop_s;
        self.word = strings.drive.clone();
        self.word.set(DriveWord::MayBeOn { end_s });
    }

    /// The drive was told to stop, and nothing more is asked of it for now.
    pub(crate) fn rests(&self) {
        self.word.set(DriveWord::Off);
    }

    /// Nobody looks at a screen.
    pub(crate) const fn is_headless(&self) -> bool {
        self.headless
    }

    /// Predicts the sequence with this seed and refuses what would be too much.
    pub(crate) fn plan(&self, seed: u64) -> Result<Plan, Failure> {
        let program = self.program(seed)?;
        let plan = plan(
            &program,
            &self.nameplate()?,
            &self.bench.limits(),
            self.bench.link.rate_hz,
            self.drive_current_limit_a(),
        )?;
        match plan.refusals.first() {
            Some(refusal) => Err(Failure::with_help(
                USAGE,
                format!("plan refused: {refusal}"),
                refusal.help(),
            )),
            None => Ok(plan),
        }
    }

    /// The motor that is planned with: of the bench file, or as it was found.
    pub(crate) fn nameplate(&self) -> Result<Nameplate, Failure> {
        nameplate(&self.bench)
    }

    /// The drive's own limit, as read back by the check.
    pub(crate) fn drive_current_limit_a(&self) -> Option<f64> {
        self.check
            .as_ref()
            .and_then(|check| check.identity.current_limit_a)
    }

    /// The drive can record bursts by itself.
    pub(crate) fn records_bursts(&mut self) -> bool {
        self.link.burst().is_some()
    }

    fn program(&self, seed: u64) -> Result<crate::excitation::Program, Failure> {
        let file = self.bench.name.clone();
        self.bench
            .program(seed)
            .map_err(|error| BenchFileError::Sequence { file, error }.into())
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
        strings: &Strings,
    ) -> Result<Recorded, Failure> {
        let motor = self.nameplate()?;
        let guard = self.guard(&motor);
        let brake = self.bench.load.brake();
        let hold_v = brake.map_or(0.0, |brake| brake.hold_current_a * motor.resistance_ohm);
        let session = Session::holding(Box::new(self.program(seed)?), guard, hold_v)
            .with_burst_at(self.bench.runs.burst_at.map(|part| part - 1));
        let run = Planned {
            session,
            motor: Some(motor),
            follows: false,
            speed: None,
        };
        self.record_session(name, seed, run, strings)
    }

    /// Measures the delay of a loop over this link, with the output off; `None` where the drive does not tell.
    pub(crate) fn measure_delay(
        &mut self,
        strings: &Strings,
    ) -> Result<Option<LoopDelay>, Failure> {
        let rate_hz = self.bench.link.rate_hz;
        self.energises(strings, 0.0);
        let measured = measure_delay(
            self.link.as_mut(),
            self.clock.as_mut(),
            rate_hz,
            self.last_seq,
        );
        self.rests();
        let (delay, last_seq) = measured?;
        self.last_seq = last_seq;
        Ok(delay)
    }

    /// Records one run of a speed loop; `about` goes into its manifest.
    pub(crate) fn record_loop(
        &mut self,
        name: &str,
        pilot: SpeedPilot,
        about: SpeedAbout,
        strings: &Strings,
    ) -> Result<Recorded, Failure> {
        let motor = self.nameplate()?;
        let guard = self.guard(&motor);
        let run = Planned {
            session: Session::with_pilot(Box::new(pilot), guard),
            motor: Some(motor),
            follows: false,
            speed: Some(about),
        };
        self.record_session(name, self.bench.runs.fit, run, strings)
    }

    /// Records one stage of an escalation. The first one beside a real motor is started by hand; the others `follow` it.
    pub(crate) fn record_stage(
        &mut self,
        name: &str,
        stage: &Stage,
        follows: bool,
        strings: &Strings,
    ) -> Result<Recorded, Failure> {
        let file = self.bench.name.clone();
        let session = stage_session(&self.bench, stage)
            .map_err(|error| Failure::from(BenchFileError::Sequence { file, error }))?;
        let run = Planned {
            session,
            motor: None,
            follows,
            speed: None,
        };
        self.record_session(name, self.bench.runs.fit, run, strings)
    }

    fn record_session(
        &mut self,
        name: &str,
        seed: u64,
        planned: Planned,
        strings: &Strings,
    ) -> Result<Recorded, Failure> {
        let Planned {
            session,
            motor,
            follows,
            speed,
        } = planned;
        if self.lost {
            let headline =
                "the drive was lost in the run before: nothing is started again by itself";
            return Err(Failure::new(LINK, headline));
        }
        let report = self
            .check
            .clone()
            .ok_or_else(|| Failure::new(INTERNAL, "a run without a check before it"))?;
        let target = Target::of(&report.identity);
        let session = session
            .after_seq(self.last_seq)
            .with_rest(&report.rest)
            .with_brake(self.bench.load.brake())
            .with_waivers(report.waived.iter().map(|&name| name.to_owned()).collect());
        let mut manifest = self.manifest(name, seed, &report);
        let mut layout = match &speed {
            Some(about) => {
                manifest.set_origin(Channel::Reference, Origin::Commanded);
                manifest
                    .configs
                    .insert("model".to_owned(), about.model.clone());
                manifest.speed_loop = about.manifest.clone();
                layout_with_reference(&report.signals)
            }
            None => layout(&report.signals),
        };
        if !self.clock.is_real() {
            layout = layout.without_host_time();
        }
        let config = OnlineConfig::from_model(&Model::baseline(self.bench.motor.motor()));
        manifest.configs.insert(
            OnlineSettings::NAME.to_owned(),
            OnlineSettings::from(config).text(),
        );
        let mut recorder = self.recorder(name, &layout, &manifest)?;
        let mut online = LiveOnline::new(layout, config);
        let sent_before = self.link.statistics().sent;
        self.energises(strings, session.guard().ramp_down_s());
        if let Some(cut_in) = self.link.cut_in() {
            let flags = [&strings.interrupted, &strings.stop_requested];
            *cut_in = CutIn::watching(flags.map(Arc::clone));
        }
        let mut summary = run(
            session,
            Bench {
                link: self.link.as_mut(),
                clock: self.clock.as_mut(),
                recorder: &mut recorder,
                estimator: Some(&mut online),
                intents: strings.intents(),
                interrupted: &strings.interrupted,
                snapshots: &strings.snapshots,
            },
            &RunOptions {
                name: name.to_owned(),
                target,
                rate_hz: self.bench.link.rate_hz,
                motor,
                // Beside a screen a real motor is started by hand, after a question.
                auto_start: target == Target::Sim || self.headless || follows,
            },
        );
        self.last_seq += summary.link.sent - sent_before + 1;
        self.rests();
        if summary.lost_its_drive() {
            self.lost = true;
            self.get_back(&mut summary, &mut recorder, strings);
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
        manifest.finished = true;
        manifest.rows = Some(kept.status.rows);
        let mut recorded = Recorded::new(kept, manifest, summary, online.result());
        recorded.keep_capture(name);
        // Kept at once: whoever goes on with this run may be interrupted.
        recorded.write_result(&serde_json::json!({}));
        Ok(recorded)
    }

    /// A run whose record cannot be begun is refused, with nothing energised; one that follows others goes on in memory.
    fn recorder(
        &self,
        name: &str,
        layout: &Layout,
        manifest: &Manifest,
    ) -> Result<Recorder, Failure> {
        let sync_every = whole(self.bench.link.rate_hz.ceil());
        let made = RunFolder::create(&self.out, &manifest.stamp, name)
            .and_then(|folder| Recorder::create(folder, layout.clone(), manifest, sync_every));
        match made {
            Err(error) if self.has_recorded => {
                let folder = RunFolder::unmade(&self.out, &manifest.stamp, name);
                let layout = layout.clone();
                Ok(Recorder::without_disk(
                    folder, layout, manifest, sync_every, &error,
                )?)
            }
            made => Ok(made?),
        }
    }

    fn manifest(&self, name: &str, seed: u64, report: &CheckReport) -> Manifest {
        let link = self.link.name();
        let mut manifest = manifest(&self.bench, seed, &link, report);
        name.clone_into(&mut manifest.name);
        manifest.stamp = utc_stamp(now());
        if let Some(emulator) = &self.emulator {
            let text = toml::to_string(emulator).unwrap_or_default();
            manifest.configs.insert("emulator".to_owned(), text);
        }
        let configs = &mut manifest.configs;
        configs.insert("drive".to_owned(), self.profile_text.clone());
        configs.insert("drive_provenance".to_owned(), self.profile.provenance());
        for (channel, text) in offer::carried(&self.profile) {
            manifest.carried.insert(channel.key().to_owned(), text);
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
}

impl Opened {
    fn of(
        options: &RigOptions,
        run_seed: Option<u64>,
        profile: &DriveProfile,
    ) -> Result<Self, Failure> {
        let bench = &options.bench;
        let guise = Guise::of(profile);
        let port = bench.port();
        // The next experiment of a mystery is a bench file that names it, so that the same machine can be run again.
        let mystery = (bench.emulator.config == MYSTERY
            && matches!(port, Port::Emulator | Port::Sim))
        .then(|| mystery::draw(bench.emulator.seed));
        let mut emulator = match (&port, &mystery) {
            (Port::Emulator | Port::Sim, Some(mystery)) => Some(mystery.config.clone()),
            (Port::Emulator | Port::Sim, None) => Some(emulator_config(&bench.emulator.config)?),
            (Port::Tcp(_) | Port::Serial(_), _) if !options.mystery => None,
            (Port::Tcp(_) | Port::Serial(_), _) => {
                return Err(Failure::with_help(
                    USAGE,
                    format!(
                        "--mystery hides an effect in our own emulator, and the port is {}",
                        bench.link.port
                    ),
                    "give --port sim: or --port emulator; for another program's port, `drivebench emulate --mystery SEED`",
                ));
            }
        };
        if let (Some(config), Some(seed)) = (&mut emulator, run_seed) {
            config.day = seed.wrapping_sub(bench.runs.fit);
        }
        if let Some(mystery) = &mystery {
            std::fs::create_dir_all(&options.out).map_err(|error| {
                Failure::new(USAGE, format!("{}: {error}", options.out.display()))
            })?;
            seal::seal(mystery, &options.out.join(seal::sealed_name(mystery.seed)))?;
        }
        let tap = tap(options.tap.as_deref(), &port)?;
        let real = MonotonicClock::start();
        let (mut clock, mut server): (Box<dyn Clock + Send>, _) = (Box::new(real), None);
        let mut address = bench.link.port.clone();
        let link: Box<dyn DriveLink> = match (&port, &emulator) {
            (Port::Sim, Some(config)) => {
                let time = VirtualClock::new();
                clock = Box::new(time.clone());
                in_memory(config, bench, guise.as_ref(), time)
            }
            (Port::Emulator, Some(config)) => {
                let handle = serve(config, bench, guise)?;
                if options.headless {
                    output::message(&format!("software drive {}", handle.ready_line()));
                }
                address = match bench.link.protocol {
                    Protocol::ModbusTcp => format!("tcp:{}", handle.address()),
                    Protocol::ModbusRtu | Protocol::Stream => handle.address().to_owned(),
                };
                server = Some(handle);
                open(&address, bench, profile, real.origin(), &tap)?
            }
            (Port::Tcp(_) | Port::Serial(_), _) => {
                open(&address, bench, profile, real.origin(), &tap)?
            }
            (Port::Sim | Port::Emulator, None) => {
                return Err(Failure::new(
                    INTERNAL,
                    "an emulator was asked for and not configured",
                ));
            }
        };
        let reopener = if port == Port::Sim {
            None
        } else {
            let target = target(&address, bench)?;
            Some(Reopener::of(&target, real.origin(), options.reopen_s))
        };
        Ok(Self {
            link,
            clock,
            reopener,
            tap,
            server,
            // What a seal is on stays out of manifest, result and report.
            emulator: emulator.filter(|_| mystery.is_none()),
        })
    }
}

impl Drop for Rig {
    fn drop(&mut self) {
        if !std::thread::panicking() || self.lost {
            return;
        }
        // What has panicked may be the link itself, and nothing may unwind out of here.
        let link = &mut self.link;
        let stopped = catch_unwind(AssertUnwindSafe(|| link.stop()));
        self.word.set(DriveWord::Panicked(match stopped {
            Ok(told) => told.map_err(|error| error.to_string()),
            Err(_) => Err("the link has panicked as well".to_owned()),
        }));
    }
}

#[expect(
    clippy::disallowed_methods,
    reason = "the stamp of a run folder is wall-clock time"
)]
pub(crate) fn now() -> jiff::Timestamp {
    jiff::Timestamp::now()
}

/// The whole nameplate of a bench file.
pub(crate) fn nameplate(bench: &BenchFile) -> Result<Nameplate, Failure> {
    bench.nameplate().ok_or_else(|| {
        let key = bench.motor.missing().unwrap_or("a value");
        Failure::with_help(
            USAGE,
            format!("motor.{key} is left out: the motor is not known, so nothing can be planned"),
            "`drivebench run` and `commission` find it from small steps first; or complete [motor]",
        )
    })
}

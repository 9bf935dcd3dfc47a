//! A run on a live drive: opens the link that a bench file names, and records one run after the other.
//!
//! ```text
//! bench file + overrides -> Rig (link, clock, emulator if it is ours) -> check -> record -> run folder
//! ```
//!
//! This file owns the wall clock (the stamp of run folders) and the signals.

use std::path::PathBuf;

use clap::Args;

use super::data::read_text;
use super::failure::{Failure, INTERNAL, LINK, USAGE};
use super::live_checks::{Consent, Waive};
use super::live_link::{
    emulator_config, in_memory, open, serve, suited, tap, target, wired_profile,
};
use super::live_reopen::{Reopener, seconds};
pub(super) use super::live_strings::Strings;
use super::recorded::{Recorded, keep_capture};
use super::wire::Tap;
use super::{output, reveal};
use crate::bench::{
    Bench, BenchFile, BenchFileError, CheckReport, Clock, Guard, LiveOnline, LoopDelay,
    MonotonicClock, Nameplate, OnlineSettings, Plan, Port, Protocol, RunOptions, Session,
    SpeedPilot, Target, layout, layout_with_reference, manifest, measure_delay, plan, run,
    stage_session,
};
use crate::drive::offer::{self, Purpose};
use crate::drive::{CutIn, DriveLink, DriveProfile};
use crate::emulator::{EmulatorConfig, Guise, ServerHandle, VirtualClock, mystery};
use crate::identification::escalation::Stage;
use crate::identification::online::OnlineConfig;
use crate::numerics::count::whole;
use crate::plant::{Model, Motor};
use crate::recording::{Manifest, Recorder, RunFolder, utc_stamp};
use crate::sample::{Channel, Origin};

/// What stands for the emulator's configuration in a bench file that hides it.
const MYSTERY: &str = "mystery";

/// Options of every command that may energise a motor.
#[derive(Args, Clone, Debug)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "switches of a command line, each independent of the others"
)]
pub(super) struct LiveArguments {
    /// Bench file; without it the embedded one: the emulated ZK-22FC with a hidden effect
    pub(super) bench: Option<PathBuf>,
    /// Serial port, tcp:HOST:PORT, sim: (in memory, virtual time) or emulator; overrides the bench file
    #[arg(long, value_name = "PORT")]
    port: Option<String>,
    /// Motor of the software drive: an embedded name (zk-22fc-plain, ...) or a file; counts with the ports emulator and sim:
    /// only, which it does not choose
    #[arg(long, value_name = "EMULATOR")]
    emulator: Option<String>,
    /// Seed of the software drive: draws the specimen and the sensor noise
    #[arg(long)]
    seed: Option<u64>,
    /// Hide an effect that this number draws in the emulated motor; the truth is sealed into the folder of runs
    #[arg(long, value_name = "SEED", conflicts_with_all = ["emulator", "seed"])]
    mystery: Option<u64>,
    /// Where run folders are made
    #[arg(long, value_name = "DIR", default_value = "runs")]
    out: PathBuf,
    /// No screen and no question: progress on stderr, the result on stdout, and the motor starts once the checks have passed.
    /// So too with --json, and where stdout is no terminal
    #[arg(long)]
    headless: bool,
    /// The drive is real and its shaft may turn: needed without a screen, and for the pulse of the checks
    #[arg(long)]
    hardware: bool,
    /// Set by commands that have [`super::escalate::UnknownMotor`].
    #[arg(skip)]
    pub(super) escalate: bool,
    #[command(flatten)]
    waive: Waive,
    /// First clear a fault that the drive has latched, as after a killed host; then go on as without it: the motor turns
    #[arg(long)]
    reset_fault: bool,
    /// After a lost link: how long to look for the drive and bring it to rest, 0 (not at all) to 86400. Without it: the
    /// drive's watchdog time and 10 s; beside a screen until Space, q or Ctrl-C ends the search
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    reopen_s: Option<f64>,
    /// Write what goes over the wire into a new capture file (pcap, for Wireshark)
    #[arg(long, value_name = "FILE")]
    tap: Option<PathBuf>,
    /// Print JSON; as with --headless there is no question before the motor starts
    #[arg(long)]
    pub(super) json: bool,
}

impl LiveArguments {
    /// Without a terminal, and for JSON, there is no screen.
    pub(super) fn is_headless(&self) -> bool {
        use std::io::IsTerminal;
        self.headless || self.json || !std::io::stdout().is_terminal()
    }

    /// The bench file with the command line's overrides.
    pub(super) fn bench(&self) -> Result<BenchFile, Failure> {
        let mut bench = match &self.bench {
            Some(path) => BenchFile::parse(&path.display().to_string(), &read_text(path)?)?,
            None => BenchFile::embedded_default(),
        };
        if let Some(port) = &self.port {
            Port::parse(port).ok_or_else(|| {
                let headline = format!("--port {port:?} is not a port");
                Failure::with_help(
                    USAGE,
                    headline,
                    "a serial port, tcp:HOST:PORT, sim: or emulator",
                )
            })?;
            bench.link.port.clone_from(port);
        }
        if let Some(emulator) = &self.emulator {
            bench.emulator.config.clone_from(emulator);
        }
        if let Some(seed) = self.seed.or(self.mystery) {
            bench.emulator.seed = seed;
        }
        if self.mystery.is_some() {
            MYSTERY.clone_into(&mut bench.emulator.config);
        }
        Ok(bench)
    }
}

/// A session that is ready to be recorded.
struct Planned {
    session: Session,
    motor: Option<Nameplate>,
    /// It goes on with what was started by hand before.
    follows: bool,
    speed: Option<SpeedAbout>,
}

/// What the record says about a speed loop.
pub(super) struct SpeedAbout {
    /// The model that it was tuned on, as a model file.
    pub(super) model: String,
    pub(super) manifest: serde_json::Value,
}

/// An open drive with its clock, and the emulator's thread where it is ours.
pub(super) struct Rig {
    pub(super) bench: BenchFile,
    pub(super) profile: DriveProfile,
    /// Its file, as it was read.
    profile_text: String,
    pub(super) link: Box<dyn DriveLink>,
    /// A run has lost its drive: none follows it, and the checks with their pulse are for whoever starts the program anew.
    lost: bool,
    /// Opens the link again; `None` for a drive in memory.
    pub(super) reopener: Option<Reopener>,
    /// Dropping it completes the capture, so it outlives the link.
    pub(super) tap: Tap,
    pub(super) clock: Box<dyn Clock + Send>,
    pub(super) last_seq: u64,
    pub(super) check: Option<CheckReport>,
    pub(super) consent: Consent,
    pub(super) headless: bool,
    /// The motor is to be found from small steps before anything is planned.
    pub(super) escalates: bool,
    /// What the bench file says about the motor, whatever is found later.
    pub(super) plate: Motor,
    out: PathBuf,
    /// None where the truth is not to be told.
    pub(super) emulator: Option<EmulatorConfig>,
    /// Dropping it ends the emulator, so it outlives the link.
    _server: Option<ServerHandle>,
}

impl Rig {
    /// Opens the link. The emulator is used only where the bench file or the command line names it.
    ///
    /// `run_seed` where one run of several is asked for: the emulator then has another day.
    /// What the drive's signals cannot carry of the `purpose` is refused before anything is opened.
    pub(super) fn open(
        arguments: &LiveArguments,
        run_seed: Option<u64>,
        purpose: Purpose,
    ) -> Result<Self, Failure> {
        let mut bench = arguments.bench()?;
        let (profile, profile_text) = wired_profile(&mut bench)?;
        let guise = Guise::of(&profile);
        suited(&profile, purpose, arguments.is_headless())?;
        let port = bench.port();
        // The next experiment of a mystery is a bench file that names it, so that the same machine can be run again.
        let mystery = (bench.emulator.config == MYSTERY
            && matches!(port, Port::Emulator | Port::Sim))
        .then(|| mystery::draw(bench.emulator.seed));
        let mut emulator = match (&port, &mystery) {
            (Port::Emulator | Port::Sim, Some(mystery)) => Some(mystery.config.clone()),
            (Port::Emulator | Port::Sim, None) => Some(emulator_config(&bench.emulator.config)?),
            (Port::Tcp(_) | Port::Serial(_), _) if arguments.mystery.is_none() => None,
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
            std::fs::create_dir_all(&arguments.out).map_err(|error| {
                Failure::new(USAGE, format!("{}: {error}", arguments.out.display()))
            })?;
            reveal::seal(
                mystery,
                &arguments.out.join(reveal::sealed_name(mystery.seed)),
            )?;
        }
        let tap = tap(arguments.tap.as_deref(), &port)?;
        let real = MonotonicClock::start();
        let (mut clock, mut server): (Box<dyn Clock + Send>, _) = (Box::new(real), None);
        let mut address = bench.link.port.clone();
        let link: Box<dyn DriveLink> = match (&port, &emulator) {
            (Port::Sim, Some(config)) => {
                let time = VirtualClock::new();
                clock = Box::new(time.clone());
                in_memory(config, &bench, guise.as_ref(), time)
            }
            (Port::Emulator, Some(config)) => {
                let handle = serve(config, &bench, guise)?;
                if arguments.is_headless() {
                    output::message(&format!("software drive {}", handle.ready_line()));
                }
                address = match bench.link.protocol {
                    Protocol::ModbusTcp => format!("tcp:{}", handle.address()),
                    Protocol::ModbusRtu | Protocol::Stream => handle.address().to_owned(),
                };
                server = Some(handle);
                open(&address, &bench, &profile, real.origin(), &tap)?
            }
            (Port::Tcp(_) | Port::Serial(_), _) => {
                open(&address, &bench, &profile, real.origin(), &tap)?
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
            let target = target(&address, &bench)?;
            Some(Reopener::of(&target, real.origin(), arguments.reopen_s))
        };
        Ok(Self {
            lost: false,
            reopener,
            profile,
            profile_text,
            link,
            tap,
            clock,
            last_seq: 0,
            check: None,
            consent: Consent {
                // A person at a screen sees SIM or HARDWARE and starts by hand; without one the word is needed.
                hardware: arguments.hardware || !arguments.is_headless(),
                hardware_said: arguments.hardware,
                waivers: arguments.waive.waivers(),
                reset_fault: arguments.reset_fault,
            },
            headless: arguments.is_headless(),
            escalates: arguments.escalate || bench.motor.is_unknown(),
            plate: bench.motor.motor(),
            out: arguments.out.clone(),
            // What a seal is on stays out of manifest, result and report.
            emulator: emulator.filter(|_| mystery.is_none()),
            _server: server,
            bench,
        })
    }

    /// Nobody looks at a screen.
    pub(super) const fn is_headless(&self) -> bool {
        self.headless
    }

    /// Predicts the sequence with this seed and refuses what would be too much.
    pub(super) fn plan(&self, seed: u64) -> Result<Plan, Failure> {
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
    pub(super) fn nameplate(&self) -> Result<Nameplate, Failure> {
        nameplate(&self.bench)
    }

    /// The drive's own limit, as read back by the check.
    pub(super) fn drive_current_limit_a(&self) -> Option<f64> {
        self.check
            .as_ref()
            .and_then(|check| check.identity.current_limit_a)
    }

    /// The drive can record bursts by itself.
    pub(super) fn records_bursts(&mut self) -> bool {
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
    pub(super) fn record(
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
    pub(super) fn measure_delay(&mut self) -> Result<Option<LoopDelay>, Failure> {
        let rate_hz = self.bench.link.rate_hz;
        let (delay, last_seq) = measure_delay(
            self.link.as_mut(),
            self.clock.as_mut(),
            rate_hz,
            self.last_seq,
        )?;
        self.last_seq = last_seq;
        Ok(delay)
    }

    /// Records one run of a speed loop; `about` goes into its manifest.
    pub(super) fn record_loop(
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
    pub(super) fn record_stage(
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
        let folder = RunFolder::create(&self.out, &manifest.stamp, name)?;
        let sync_every = whole(self.bench.link.rate_hz.ceil());
        let mut recorder = Recorder::create(folder.clone(), layout.clone(), &manifest, sync_every)?;
        let mut online = LiveOnline::new(layout, config);
        let sent_before = self.link.statistics().sent;
        if let Some(cut_in) = self.link.cut_in() {
            let flags = [&strings.interrupted, &strings.stop_requested];
            *cut_in = CutIn::watching(flags.map(std::sync::Arc::clone));
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
        if summary.lost_its_drive() {
            self.lost = true;
            self.get_back(&mut summary, &mut recorder, strings);
        }
        summary.describe(&mut manifest);
        if let Some(report) = &summary.speed {
            manifest.speed_loop["delay_while_running"] = serde_json::json!(report.delay);
        }
        // The writer thread may still have been busy when the run ended: only now is every row counted.
        summary.rows = recorder.finish(&manifest)?.rows as u64;
        if let Some(capture) = &summary.capture {
            keep_capture(&folder, name, capture)?;
        }
        let recorded = Recorded {
            folder,
            summary,
            online: online.result(),
        };
        // Kept at once: whoever goes on with this run may be interrupted.
        recorded.write_result(&serde_json::json!({}))?;
        Ok(recorded)
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

#[expect(
    clippy::disallowed_methods,
    reason = "the stamp of a run folder is wall-clock time"
)]
pub(super) fn now() -> jiff::Timestamp {
    jiff::Timestamp::now()
}

/// The whole nameplate of a bench file.
pub(super) fn nameplate(bench: &BenchFile) -> Result<Nameplate, Failure> {
    bench.nameplate().ok_or_else(|| {
        let key = bench.motor.missing().unwrap_or("a value");
        Failure::with_help(
            USAGE,
            format!("motor.{key} is left out: the motor is not known, so nothing can be planned"),
            "`drivebench run` and `commission` find it from small steps first; or complete [motor]",
        )
    })
}

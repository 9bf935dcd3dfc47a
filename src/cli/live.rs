//! What the command line says of every run on a live drive.

use std::path::PathBuf;

use clap::Args;

use super::data::read_text;
use super::failure::{Failure, USAGE};
use crate::app::{Audience, MYSTERY, RigOptions};
use crate::bench::{BenchFile, Port, Waivers};
use crate::workflow::ProgressCell;

/// Longest time that may be asked for, s: a day.
const MOST_S: f64 = 86_400.0;

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

    /// Who looks at the run.
    pub(super) fn audience(&self, progress: Option<ProgressCell>) -> Audience {
        if self.is_headless() {
            Audience::Headless
        } else {
            Audience::Screen(progress)
        }
    }

    /// What is asked of the rig.
    pub(super) fn options(&self, escalate: bool) -> Result<RigOptions, Failure> {
        Ok(RigOptions {
            bench: self.bench()?,
            out: self.out.clone(),
            headless: self.is_headless(),
            hardware: self.hardware,
            escalate,
            waivers: self.waive.waivers(),
            reset_fault: self.reset_fault,
            reopen_s: self.reopen_s,
            tap: self.tap.clone(),
            mystery: self.mystery.is_some(),
        })
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

/// Checks that may be gone without, each by its own word. What is waived stands in the manifest, the log and the messages.
#[derive(Args, Clone, Copy, Debug)]
#[expect(clippy::struct_field_names, reason = "the words of the command line")]
pub(super) struct Waive {
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
    pub(super) const fn waivers(self) -> Waivers {
        Waivers {
            watchdog: self.waive_watchdog,
            direction: self.waive_direction,
            plausibility: self.waive_plausibility,
        }
    }
}

/// The time of `--reopen-s`.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text
        .parse()
        .map_err(|_| "expected a number of seconds".to_owned())?;
    if (0.0..=MOST_S).contains(&seconds) {
        Ok(seconds)
    } else {
        Err(format!("allowed: 0 (off) to {MOST_S} s"))
    }
}

/// For commands that find a motor of which nothing is known.
#[derive(clap::Args, Clone, Copy, Debug)]
pub(super) struct UnknownMotor {
    /// Find the motor from small steps first and compare it with its nameplate; the sequence runs only if it suits the
    /// motor that was found (motor.unknown = true in the bench file makes it smaller instead)
    #[arg(long)]
    pub(super) escalate: bool,
}

//! Arguments that commands have in common: runs with their columns, a line to a unit, a run on a live drive.

use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use clap::Args;
use clap::builder::{PathBufValueParser, PossibleValuesParser, TypedValueParser};

use crate::commands::evidence::{EvidenceFiles, Judging, Prepared, prepare};
use crate::commands::map::map_help;
use crate::report::wording::sanity as words;
use crate::runtime::{
    Audience, Failure, Form, MYSTERY, RigOptions, Switches, Tap, Terminal, load, opening, output,
    read_text, require_parquet,
};
use crate::workflow::ProgressCell;
use drivebench_bench::recording::{ColumnMap, LoadedRun, MissingValues, ReadOptions, resolved};
use drivebench_bench::{BenchFile, EMBEDDED_NAME, Port};
use drivebench_identify::sanity;
use drivebench_link::{Framing, Protocol, RawClient, RawSettings, Target, standard_gap_s};
use drivebench_model::sample::{Channel, Origin, Run, Side};

/// A run on the command line; `runs/latest` is the folder that it names now.
pub(super) fn run_path() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().map(|path| resolved(&path))
}

/// How the lines and cells of a foreign file are read.
#[derive(Args, Clone, Debug, Default)]
pub(super) struct TextArguments {
    /// Lines before the header row of a foreign CSV; without it the header row is found
    #[arg(long, value_name = "LINES", value_parser = clap::value_parser!(u16))]
    skip: Option<u16>,
    /// Cells that stand for a missing value, as empty ones and NaN do: '#N/A,ERR,-9999'
    #[arg(long, value_name = "CELL,...")]
    missing: Option<MissingValues>,
}

impl TextArguments {
    pub(super) fn options(&self) -> ReadOptions<'_> {
        let skip = self.skip.map(usize::from);
        ReadOptions { skip, missing: self.missing.as_ref(), ..ReadOptions::default() }
    }

    /// The options as they are given, for the commands that follow; each with a space before it.
    pub(super) fn words(&self) -> String {
        let skip = self.skip.map(|lines| option_words(("skip", &lines.to_string())));
        let missing = self.missing.as_ref().map(ToString::to_string);
        skip.into_iter().chain(missing.map(|cells| option_words(("missing", &cells)))).collect()
    }
}

/// How a foreign file is read.
#[derive(Args, Clone, Debug, Default)]
pub(super) struct FileArguments {
    /// Columns of a foreign CSV: 'target=header[*factor][+offset],...', as time_s=t,speed_rad_s=rpm*0.104719755; a factor may be
    /// a column (voltage_v=duty*bus_v) or sign(COLUMN), the sign of the last nonzero command, for a speed without sign
    /// (speed_rad_s=rpm*0.104719755*sign(duty)); a date and a clock in two columns are time_s=Date+Time
    #[arg(long, value_name = "MAP")]
    map: Option<String>,
    #[command(flatten)]
    text: TextArguments,
}

impl FileArguments {
    pub(super) fn map(&self) -> Result<Option<ColumnMap>, Failure> {
        Ok(self.map.as_deref().map(str::parse).transpose()?)
    }

    pub(super) fn options<'a>(&'a self, map: Option<&'a ColumnMap>) -> ReadOptions<'a> {
        ReadOptions { map, ..self.text.options() }
    }

    /// The options as they are given, for the commands that follow; each with a space before it.
    fn words(&self) -> String {
        let map = self.map.as_deref().map(|map| option_words(("map", map)));
        map.unwrap_or_default() + &self.text.words()
    }
}

fn option_words((name, text): (&str, &str)) -> String {
    format!(" --{name} {}", output::quoted_word(text))
}

/// How foreign columns are read, and where they come from.
#[derive(Args, Clone, Debug, Default)]
pub(super) struct MapArguments {
    #[command(flatten)]
    file: FileArguments,
    /// Another map for the hold-out and the confirming run
    #[arg(long, value_name = "MAP")]
    map_holdout: Option<String>,
    /// Where signals come from, as voltage_v=commanded,current_a=supply: measured, estimated, commanded; terminal, supply
    #[arg(long, value_name = "KEY=WORD,...")]
    origin: Option<Provenance>,
}

impl MapArguments {
    /// Whether columns are named at all.
    pub(super) const fn is_given(&self) -> bool {
        self.file.map.is_some()
    }

    /// The options as they are given here, for the commands that follow; each with a space before it.
    pub(super) fn words(&self) -> String {
        let holdout = self.map_holdout.as_deref().map(|map| option_words(("map-holdout", map)));
        self.file.words() + &holdout.unwrap_or_default()
    }

    /// Opens the run with its map; the origins of the command line override those of a manifest.
    pub(super) fn load(&self, path: &Path, terminal: &Terminal) -> Result<LoadedRun, Failure> {
        self.load_with(path, self.file.map()?.as_ref(), terminal)
    }

    fn load_with(
        &self,
        path: &Path,
        map: Option<&ColumnMap>,
        terminal: &Terminal,
    ) -> Result<LoadedRun, Failure> {
        // A header that names another unit than its target's, with no factor in the map.
        let finding = map.map(ColumnMap::items).unwrap_or_default().iter().find_map(|item| {
            sanity::of_header(item.target.map_or("time_s", Channel::key), &item.header, item.scaled)
        });
        if let Some(finding) = finding {
            let (headline, help) =
                (words::fault(&finding.fault), words::help(&finding.fault, words::MAP));
            return Err(Failure::usage(headline, help));
        }
        let options = self.file.options(map);
        let mut loaded = load(path, options, terminal).map_err(|failure| match map {
            None => failure.helped_by(map_help(path, options)),
            Some(_) => failure,
        })?;
        if let Some(provenance) = &self.origin {
            provenance.apply(&mut loaded.run);
        }
        Ok(loaded)
    }
}

/// Where the signals of a file come from, as the user states it.
#[derive(Clone, Debug, Default, PartialEq)]
struct Provenance {
    origins: Vec<(Channel, Origin)>,
    sides: Vec<(Channel, Side)>,
}

impl FromStr for Provenance {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut provenance = Self::default();
        for item in text.split(',').map(str::trim).filter(|i| !i.is_empty()) {
            let (key, value) = item
                .split_once('=')
                .ok_or_else(|| format!("{item:?} is not of the form KEY=WORD"))?;
            let (key, value) = (key.trim(), value.trim());
            let channel = Channel::from_key(key).ok_or_else(|| {
                let keys = Channel::ALL.map(Channel::key).join(", ");
                format!("unknown signal {key:?} (allowed: {keys})")
            })?;
            let origin = Origin::ALL.into_iter().find(|origin| origin.name() == value);
            let side = Side::ALL.into_iter().find(|side| side.name() == value);
            let has_sides =
                matches!(channel, Channel::Voltage | Channel::VoltageCmd | Channel::Current);
            match (origin, side) {
                (Some(origin), _) => provenance.origins.push((channel, origin)),
                (None, Some(side)) if has_sides => provenance.sides.push((channel, side)),
                (None, Some(_)) => {
                    return Err(format!(
                        "{item:?}: only a voltage or a current is of the terminal or the supply side"
                    ));
                }
                (None, None) => {
                    let origins = Origin::ALL.map(Origin::name).join(", ");
                    let sides = Side::ALL.map(Side::name).join(", ");
                    return Err(format!(
                        "{item:?}: {value:?} is not allowed (allowed: {origins}, {sides})"
                    ));
                }
            }
        }
        Ok(provenance)
    }
}

impl Provenance {
    fn apply(&self, run: &mut Run) {
        for &(channel, origin) in &self.origins {
            run.set_origin(channel, origin);
        }
        for &(channel, side) in &self.sides {
            run.set_side(channel, side);
        }
    }
}

/// Fit run, hold-out and confirming run of a command, and the model that they judge.
#[derive(Args, Clone, Debug)]
pub(super) struct EvidenceArguments {
    /// Another run, not used in the fit; without it the last 40 % of RUN are held out, more where the shaft stands still
    #[arg(long, value_name = "RUN2", value_parser = run_path())]
    holdout: Option<PathBuf>,
    /// A third run, used neither to fit nor to select: the diagnosis is repeated on it, and the headline error is from it
    #[arg(long, value_name = "RUN3", value_parser = run_path())]
    confirm: Option<PathBuf>,
    /// A later run of the same machine, as the recommended one: fitted together with RUN; may be repeated
    #[arg(long = "with", value_name = "RUN4", value_parser = run_path())]
    later: Vec<PathBuf>,
    #[command(flatten)]
    map: MapArguments,
}

/// A second run where one is allowed: refused, with the options for further runs.
#[derive(Args, Clone, Debug)]
pub(super) struct MoreRuns {
    #[arg(hide = true, value_name = "ANOTHER")]
    more: Vec<PathBuf>,
}

impl MoreRuns {
    pub(super) fn refuse(&self) -> Result<(), Failure> {
        self.more.first().map_or(Ok(()), |second| {
            let headline = format!("one run is expected, and another is given: {}", second.display());
            let help = "give a hold-out run with --holdout, a run to fit too with --with, a confirming run with --confirm, models with --model";
            Err(Failure::usage(headline, help))
        })
    }
}

/// The model as it is given, with a space before it.
pub(super) fn model_words(model: Option<&Path>) -> String {
    model.map_or_else(String::new, |model| format!(" --model {}", output::quoted(model)))
}

impl EvidenceArguments {
    /// The maps alone.
    pub(super) fn map_words(&self) -> String {
        self.map.words()
    }

    /// The options as they are given here, for the commands that follow; each with a space before it.
    pub(super) fn words(&self) -> String {
        let runs = [("holdout", &self.holdout), ("confirm", &self.confirm)];
        let judging = runs.into_iter().filter_map(|(name, path)| Some((name, path.as_ref()?)));
        let run = |(name, path): (&str, &PathBuf)| format!(" --{name} {}", output::quoted(path));
        let later: String = self.later.iter().map(|path| run(("with", path))).collect();
        judging.map(run).collect::<String>() + &self.map.words() + &later
    }

    /// The command that diagnoses this run with these options.
    pub(super) fn diagnose(&self, run: &Path, model: Option<&Path>) -> String {
        let (run, model) = (output::quoted(run), model_words(model));
        format!("drivebench diagnose {run}{model}{}", self.words())
    }

    /// Opens the runs; with every channel where a screen may show them.
    pub(super) fn prepare(
        &self,
        run: &Path,
        model: Option<&Path>,
        judging: Judging,
        for_screen: bool,
        terminal: &Terminal,
    ) -> Result<Prepared, Failure> {
        let files = EvidenceFiles {
            terminal,
            run,
            model,
            holdout: self.holdout.as_deref(),
            confirm: self.confirm.as_deref(),
            later: &self.later,
            for_screen,
        };
        let load = |path: &Path, is_other: bool| {
            let other_map = self.map.map_holdout.as_deref().filter(|_| is_other);
            let map = other_map.map_or_else(|| self.map.file.map(), |map| Ok(Some(map.parse()?)));
            self.map.load_with(path, map?.as_ref(), terminal)
        };
        prepare(files, load, judging)
    }
}

/// Options of the commands that talk to any Modbus unit.
#[derive(Args, Clone, Debug)]
pub(super) struct WireArguments {
    /// Serial port (Modbus RTU), or tcp:HOST:PORT
    #[arg(long, value_name = "PORT", conflicts_with = "host")]
    port: Option<String>,
    /// Address of a Modbus TCP server, or of a serial converter
    #[arg(long, value_name = "HOST:PORT")]
    host: Option<String>,
    /// Frames of Modbus RTU over TCP, as transparent serial converters carry them
    #[arg(long)]
    rtu_over_tcp: bool,
    /// Baud rate of a serial port
    #[arg(long, value_name = "BAUD", default_value_t = 115_200, value_parser = clap::value_parser!(u32).range(1..))]
    baud: u32,
    /// Characters of a serial port: 8N1, 8E1, 8O1 or 8N2
    #[arg(long, value_name = "FRAMING", default_value = "8N1", value_parser = framing)]
    framing: Framing,
    /// Address of the unit on the line, 1 to 247; over Modbus TCP 0 to 255
    #[arg(long, value_name = "UNIT", default_value_t = 1)]
    unit: u8,
    /// Time for one reply
    #[arg(long, value_name = "MS", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..=60_000))]
    timeout_ms: u64,
    /// Silence before a request over a serial line; without it that of the standard for the baud rate
    #[arg(long, value_name = "US", value_parser = clap::value_parser!(u64).range(..=1_000_000))]
    gap_us: Option<u64>,
    /// The same in ms; 0 for a unit that needs no silence between frames
    #[arg(long, value_name = "MS", conflicts_with = "gap_us", value_parser = gap_ms)]
    gap: Option<f64>,
    /// Write what goes over the wire into a new capture file (pcap, for Wireshark)
    #[arg(long, value_name = "FILE")]
    tap: Option<PathBuf>,
}

pub(super) fn framing(text: &str) -> Result<Framing, String> {
    match text.to_ascii_uppercase().as_str() {
        "8N1" => Ok(Framing::EightNoneOne),
        "8E1" => Ok(Framing::EightEvenOne),
        "8O1" => Ok(Framing::EightOddOne),
        "8N2" => Ok(Framing::EightNoneTwo),
        _ => Err("expected 8N1, 8E1, 8O1 or 8N2".to_owned()),
    }
}

fn gap_ms(text: &str) -> Result<f64, String> {
    let ms = text.parse().ok();
    ms.filter(|ms| (0.0..=1000.0).contains(ms))
        .ok_or_else(|| format!("{text:?} is not a number of ms from 0 to 1000"))
}

impl WireArguments {
    pub(super) fn target(&self) -> Result<Target, Failure> {
        let text = match (&self.port, &self.host) {
            (Some(port), _) => port.clone(),
            (None, Some(host)) => format!("tcp:{}", host.strip_prefix("tcp:").unwrap_or(host)),
            (None, None) => {
                return Err(Failure::usage(
                    "no port is given",
                    "give --port PATH or --host HOST:PORT; `drivebench ports` lists what is plugged in",
                ));
            }
        };
        let target = text.parse()?;
        check_unit(&target, Some(self.unit), self.rtu_over_tcp)?;
        Ok(target)
    }

    pub(super) fn settings(&self) -> RawSettings {
        let gap = self.gap.map(|ms| Duration::from_secs_f64(ms * 1e-3));
        RawSettings {
            baud: self.baud,
            framing: self.framing,
            unit: self.unit,
            timeout: Duration::from_millis(self.timeout_ms),
            gap: gap.or(self.gap_us.map(Duration::from_micros)),
            rtu_over_tcp: self.rtu_over_tcp,
        }
    }

    pub(super) fn tap(&self, terminal: &Terminal) -> Result<Tap, Failure> {
        Tap::create(self.tap.as_deref(), terminal)
    }

    pub(super) fn open(&self, tap: &Tap, terminal: &Terminal) -> Result<RawClient, Failure> {
        open_line(&self.target()?, &self.settings(), tap, terminal)
    }
}

/// RTU over TCP needs a network, and only Modbus TCP has units beyond those of a serial line.
pub(super) fn check_unit(
    target: &Target,
    unit: Option<u8>,
    rtu_over_tcp: bool,
) -> Result<(), Failure> {
    let is_serial = matches!(target, Target::Serial { .. });
    if is_serial && rtu_over_tcp {
        return Err(Failure::usage(
            format!("--rtu-over-tcp is for a network, and {target} is a serial port"),
            "give --host HOST:PORT, or leave --rtu-over-tcp out",
        ));
    }
    match unit {
        Some(unit) if (is_serial || rtu_over_tcp) && !(1..=247).contains(&unit) => {
            Err(Failure::usage(
                format!("--unit {unit} is no address of a unit on a serial line"),
                "1 to 247; 0 and 248 to 255 exist over Modbus TCP only",
            ))
        }
        _ => Ok(()),
    }
}

/// A line with these settings; a silence below that of the standard is the user's choice, with a warning.
pub(super) fn open_line(
    target: &Target,
    settings: &RawSettings,
    tap: &Tap,
    terminal: &Terminal,
) -> Result<RawClient, Failure> {
    let client = RawClient::open(target, settings, tap.file())?;
    if let (Some(gap), Target::Serial { baud, .. }) = (settings.gap, target) {
        let (baud, framing) = (baud.unwrap_or(settings.baud), settings.framing);
        let (gap_s, standard_s) = (gap.as_secs_f64(), standard_gap_s(baud, framing));
        if gap_s < standard_s {
            terminal.message(&format!(
                "warning: {} ms of silence before a request is below the standard's {:.2} ms at {baud} {}: a unit that separates frames by silence may read two as one",
                1e3 * gap_s,
                1e3 * standard_s,
                framing.name()
            ));
        }
    }
    Ok(client)
}

/// Options of every command that may energise a motor.
#[derive(Args, Clone, Debug)]
pub(super) struct LiveArguments {
    /// Bench file; without it the embedded one: the emulated ZK-22FC with a hidden effect
    pub(super) bench: Option<PathBuf>,
    /// Serial port, tcp:HOST:PORT, sim: (in memory, virtual time), sim:rtu (the same over Modbus RTU) or emulator; overrides the bench file
    #[arg(long, value_name = "PORT")]
    pub(super) port: Option<String>,
    /// Frames of Modbus RTU over TCP, as transparent serial converters carry them; as link.protocol = "modbus-rtu-over-tcp"
    #[arg(long)]
    rtu_over_tcp: bool,
    /// Motor of the software drive: an embedded name (zk-22fc-plain, ...) or a file; only with --port emulator or sim:, which
    /// it does not select
    #[arg(long, value_name = "EMULATOR")]
    emulator: Option<String>,
    /// Seed of the software drive: draws the specimen and the sensor noise
    #[arg(long)]
    seed: Option<u64>,
    /// Hide an effect in the emulated motor, drawn from this seed; `commission` shows it at the end
    #[arg(long, value_name = "SEED", conflicts_with_all = ["emulator", "seed"])]
    mystery: Option<u64>,
    #[command(flatten)]
    switches: Switches,
    /// Print the whole result; without it at most 100 columns and 30 lines
    #[arg(long)]
    full: bool,
    /// Print JSON; as with --headless there is no question before the motor starts
    #[arg(long)]
    pub(super) json: bool,
}

impl LiveArguments {
    /// Without a terminal, and for JSON, there is no screen.
    pub(super) fn is_headless(&self) -> bool {
        use std::io::IsTerminal;
        self.switches.headless || self.json || !std::io::stdout().is_terminal()
    }

    pub(super) const fn form(&self) -> Form {
        Form { full: self.full, json: self.json }
    }

    pub(super) fn audience(&self, progress: Option<ProgressCell>) -> Audience {
        if self.is_headless() { Audience::Headless } else { Audience::Screen(progress) }
    }

    pub(super) fn options(
        &self,
        escalate: bool,
        terminal: &Terminal,
    ) -> Result<RigOptions, Failure> {
        if self.switches.parquet {
            require_parquet()?;
        }
        Ok(RigOptions {
            bench: self.bench_file()?,
            switches: Switches { headless: self.is_headless(), ..self.switches.clone() },
            escalate,
            mystery: self.mystery.is_some(),
            words: self.words(),
            terminal: terminal.clone(),
        })
    }

    /// Bench, link and motor as they are given here, for the commands that follow; each with a space before it.
    pub(super) fn words(&self) -> String {
        let option = |name: &str, value: Option<String>| {
            value.map(|value| format!("--{name} {}", output::quoted_word(&value)))
        };
        let switch = |name: &str, is_set: bool| is_set.then(|| format!("--{name}"));
        let given = [
            self.bench.as_deref().map(output::quoted),
            option("port", self.port.clone()),
            switch("rtu-over-tcp", self.rtu_over_tcp),
            option("emulator", self.emulator.clone()),
            option("seed", self.seed.map(|seed| seed.to_string())),
            option("mystery", self.mystery.map(|seed| seed.to_string())),
            switch("headless", self.switches.headless),
            switch("hardware", self.switches.hardware),
        ];
        given.into_iter().flatten().flat_map(|option| [" ".to_owned(), option]).collect()
    }

    /// Name and text of the bench file, for messages about errors in it; no text of the embedded one.
    pub(super) fn source(&self) -> Result<(String, String), Failure> {
        Ok(match &self.bench {
            Some(path) => (path.display().to_string(), read_text(path)?),
            None => (EMBEDDED_NAME.to_owned(), String::new()),
        })
    }

    /// The bench file with the command line's overrides.
    fn bench_file(&self) -> Result<BenchFile, Failure> {
        let mut bench = match &self.bench {
            Some(path) => opening::bench_file(path)?,
            None => BenchFile::embedded_default(),
        };
        if let Some(port) = &self.port {
            if Port::parse(port).is_none() {
                let headline = format!("--port {port:?} is not a port");
                let help = "a serial port, tcp:HOST:PORT, sim:, sim:rtu or emulator";
                return Err(Failure::usage(headline, help));
            }
            bench.link.port.clone_from(port);
        }
        if self.rtu_over_tcp {
            bench.link.protocol = Protocol::ModbusRtuOverTcp;
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

/// The parser of an option with one of these values, each by its name.
pub(super) fn by_name<T: Copy + Send + Sync + 'static, const N: usize>(
    all: [T; N],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    let named = move |text: String| all.into_iter().find(|value| name(*value) == text);
    PossibleValuesParser::new(all.map(name))
        .try_map(move |text| named(text).ok_or("it is not the name of a value"))
}

/// Part I of N of the work.
pub(super) fn shard(text: &str) -> Result<(u64, u64), String> {
    text.split_once('/')
        .and_then(|(part, of)| Some((part.parse().ok()?, of.parse().ok()?)))
        .filter(|(part, of)| (1..=*of).contains(part))
        .ok_or_else(|| "expected I/N with 1 <= I <= N, as 2/4".to_owned())
}

/// Option of the commands that can identify an unknown motor.
#[derive(clap::Args, Clone, Copy, Debug)]
pub(super) struct UnknownMotor {
    /// Find the motor from small steps first and compare it with its nameplate; the sequence runs only if it suits the
    /// motor that was found (motor.unknown = true in the bench file makes it smaller instead). With [currents] in the bench file: find it from
    /// small currents, and fit the sequence to it
    #[arg(long)]
    pub(super) escalate: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn origin_and_side_are_read_and_wrong_ones_named() {
        let provenance: Provenance =
            "voltage_v=commanded, current_a=supply,current_a=measured".parse().unwrap();
        let mut run = Run::new("r", vec![0.0, 1.0]).unwrap();
        run.set_column(Channel::Current, vec![1.0, 2.0], Origin::Unknown).unwrap();
        provenance.apply(&mut run);
        assert_eq!(run.origin(Channel::Voltage), Origin::Commanded);
        assert_eq!(
            crate::commands::evidence::signals(&run),
            json!({ "current_a": { "origin": "measured", "side": "supply" } })
        );
        for (text, part) in [
            ("volts=measured", "unknown signal"),
            ("voltage_v", "KEY=WORD"),
            ("voltage_v=guessed", "allowed: measured"),
            ("speed_rad_s=supply", "only a voltage or a current"),
        ] {
            let error = text.parse::<Provenance>().unwrap_err();
            assert!(error.contains(part), "{text}: {error}");
        }
    }
}

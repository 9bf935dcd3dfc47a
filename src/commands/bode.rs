//! `bode`: the frequency response of recorded runs and of a model, as card, table and picture.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::commands::arguments::{MapArguments, by_name, run_path};
use crate::commands::by_hand::show_response;
use crate::commands::evidence::{cautions, name_voltage};
use crate::commands::view::needs_terminal;
use crate::report::plot::standalone;
use crate::report::{Bars, Document, Tone, response_chart};
use crate::runtime::{Failure, Form, Terminal, output, quoted, quoted_word, read_model};
use drivebench_bench::recording::{LoadedRun, RunFile, RunFolder};
use drivebench_identify::frequency_response::{
    CARRIED, Compared, Departure, Mode, Pathway, PathwayResponse, ResponsePoint, compared, of_model,
};
use drivebench_model::plant::{Model, Scenario};
use drivebench_model::sample::Channel;
use drivebench_model::text::number::significant;

/// Frequency response of recorded runs: magnitude, phase, coherence; resonances with their damping; that of a model
#[derive(clap::Args)]
#[command(after_help = "Examples:
  drivebench bode runs/latest
  drivebench bode runs/a --model model.toml --svg bode.svg     where model and measurement differ
  drivebench bode runs/a runs/b --csv bode.csv                 of one machine, evaluated together
A chirp about an offset excites best: bench-configs/benches/zk-22fc-frequency-response.toml.")]
pub(super) struct Arguments {
    /// Run folders, samples.csv, or any CSV with --map, all of one machine
    #[arg(required = true, value_parser = run_path())]
    runs: Vec<PathBuf>,
    /// Model file; without it that of the first run's folder
    #[arg(long, value_parser = run_path())]
    model: Option<PathBuf>,
    /// From which signal to which; without it current-to-speed if it has a resonance, else the first with sufficient coherence
    #[arg(long, value_parser = by_name(Pathway::ALL, Pathway::key))]
    pathway: Option<Pathway>,
    #[command(flatten)]
    map: MapArguments,
    /// Write a row for each point and pathway; never overwritten
    #[arg(long, value_name = "FILE.csv")]
    csv: Option<PathBuf>,
    /// Write a picture: magnitude, phase, coherence, and those of the model; never overwritten
    #[arg(long, value_name = "FILE.svg")]
    svg: Option<PathBuf>,
    /// Show it on the screen
    #[arg(long, conflicts_with = "json")]
    screen: bool,
    #[command(flatten)]
    form: Form,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    output::refuse_existing(&arguments.csv, "--csv")?;
    output::refuse_existing(&arguments.svg, "--svg")?;
    if arguments.screen {
        needs_terminal("--screen", "leave --screen out: the result is printed as text")?;
    }
    let attended = (terminal.endable()?, terminal.progress("bode"));
    let found = Bode::of(arguments, terminal)?;
    let pathway = found.shown(arguments.pathway)?;
    if let Some(path) = &arguments.csv {
        terminal.file(path, &found.csv()?)?;
    }
    if let Some(path) = &arguments.svg {
        terminal.file(path, &found.svg(pathway)?)?;
    }
    // From here on a screen uses the terminal and handles the signals.
    drop(attended);
    if arguments.screen {
        show_response(found.title(), found.compared.clone(), Some(pathway), terminal)?;
    }
    terminal.document(&found, arguments.form, &found.document(pathway, arguments))?;
    found.check()
}

/// The response of the runs, as `bode --json` prints it.
#[derive(Serialize)]
pub(crate) struct Bode {
    runs: Vec<String>,
    /// File of the model; null where there is none.
    model_from: Option<String>,
    #[serde(flatten)]
    pub(crate) compared: Compared,
    notes: Vec<String>,
}

impl Bode {
    fn of(arguments: &Arguments, terminal: &Terminal) -> Result<Self, Failure> {
        terminal.stage("reads the runs", 0);
        let loaded = arguments.runs.iter().map(|path| arguments.map.load(path, terminal));
        let loaded = loaded.collect::<Result<Vec<LoadedRun>, Failure>>()?;
        let (mut notes, mut of_runs) = (Vec::new(), Vec::new());
        let mut scenarios = Vec::new();
        for loaded in &loaded {
            let run = &loaded.run;
            let scenario = Scenario::from_run(run)?;
            name_voltage(run, &scenario, terminal);
            notes.extend(run.notes.iter().cloned());
            let mut found = cautions(run, &scenario);
            if run.points(Channel::Reference).next().is_some() {
                found.push(format!(
                    "{}: recorded in a closed loop: disturbances of the speed act on the voltage too, and bias the response towards the inverse of the controller",
                    run.name
                ));
            }
            terminal.warn(&found);
            of_runs.extend(found);
            scenarios.push(scenario);
        }
        let model = model(arguments.model.as_deref(), loaded.first(), terminal)?;
        let (model_from, model) = model.unzip();
        terminal.stage("follows the model", 0);
        let predicted = model.map(|model| of_model(&model, &scenarios)).transpose()?;
        terminal.stage("estimates the response", 0);
        let mut compared = compared(&scenarios, predicted.as_deref())?;
        compared.measured.cautions.extend(of_runs);
        Ok(Self {
            runs: loaded.iter().map(|loaded| loaded.run.name.clone()).collect(),
            model_from: model_from.map(|path| path.display().to_string()),
            compared,
            notes,
        })
    }

    /// The requested pathway, else the default one.
    fn shown(&self, requested: Option<Pathway>) -> Result<Pathway, Failure> {
        let measured = &self.compared.measured;
        match requested {
            None => measured.telling().ok_or_else(|| {
                Failure::not_identifiable("neither current nor speed was measured", "map a column")
            }),
            Some(pathway) if measured.of(pathway).is_some() => Ok(pathway),
            Some(pathway) => {
                let available: Vec<_> =
                    measured.pathways.iter().map(|own| own.pathway.key()).collect();
                Err(Failure::usage(
                    format!(
                        "--pathway {}: one of its signals was not measured (measured: {})",
                        pathway.key(),
                        available.join(", ")
                    ),
                    "choose another pathway, or map the column with --map",
                ))
            }
        }
    }

    /// Fails where no frequency has sufficient coherence; checked after the result is printed.
    fn check(&self) -> Result<(), Failure> {
        let mut pathways = self.compared.measured.pathways.iter();
        if pathways.any(|response| !response.bands_hz().is_empty()) {
            return Ok(());
        }
        Err(Failure::not_identifiable(
            format!("no frequency has a coherence of {CARRIED} in these runs"),
            CHIRP,
        ))
    }

    fn document(&self, pathway: Pathway, arguments: &Arguments) -> Document {
        let measured = &self.compared.measured;
        let Some(own) = measured.of(pathway) else {
            return Document::of(Tone::Plain, "nothing", "was measured");
        };
        let bands = own.bands_hz();
        let tone = if bands.is_empty() { Tone::Attention } else { Tone::Good };
        let mut document = Document::of(tone, pathway.name(), self.headline(own, &bands));
        document.say("modes", self.other_modes(pathway), 2);
        document.say("carried", [self.band_sentence(own, &bands)], 1);
        document.say("rate", [measured.rate_sentence()], 1);
        let (model, farther) = self.model_sentences(pathway);
        document.say("model", model, 3);
        document.say("", farther, 0);
        document.say("caution", measured.cautions.iter().map(String::as_str), 1);
        let bars = self.bars(own);
        if !bars.is_empty() {
            let unit = format!("magnitude, dB of 1 {}, where it is carried", own.unit);
            document.bars("", Bars::new(bars, unit));
        }
        self.go_on(&mut document, bands.is_empty(), arguments);
        document
    }

    fn headline(&self, own: &PathwayResponse, bands: &[(f64, f64)]) -> String {
        let modes = self.compared.measured.modes_of(own.pathway);
        match (modes.as_slice(), bands) {
            (_, []) => "no frequency has sufficient coherence".to_owned(),
            ([], [(from, _), .., (_, to)] | [(from, to)]) => {
                format!("no resonance from {} to {} Hz", significant(*from, 3), significant(*to, 3))
            }
            (modes, _) => {
                let modes: Vec<String> = modes.iter().map(Mode::text).collect();
                modes.join("; ")
            }
        }
    }

    fn other_modes(&self, shown: Pathway) -> Vec<String> {
        let measured = &self.compared.measured;
        let others = Pathway::ALL.into_iter().filter(|own| *own != shown);
        others
            .filter_map(|pathway| {
                let modes: Vec<_> = measured.modes_of(pathway).iter().map(Mode::text).collect();
                (!modes.is_empty()).then(|| format!("{}: {}", pathway.name(), modes.join("; ")))
            })
            .collect()
    }

    fn band_sentence(&self, own: &PathwayResponse, bands: &[(f64, f64)]) -> String {
        let measured = &self.compared.measured;
        let [used, lowest] = [measured.used_s, measured.lowest_hz].map(|own| significant(own, 3));
        let stretches = match measured.stretches {
            1 => "one stretch".to_owned(),
            many => format!("{many} stretches"),
        };
        let listed: Vec<_> = bands
            .iter()
            .take(4)
            .map(|(from, to)| format!("{} to {} Hz", significant(*from, 3), significant(*to, 3)))
            .collect();
        let more = match bands.len() - listed.len() {
            0 => String::new(),
            more => format!(" and {more} bands more"),
        };
        let listed = if listed.is_empty() { "nothing".to_owned() } else { listed.join(", ") };
        let is_inside = |point: &&ResponsePoint| {
            let hertz = point.frequency_hz;
            bands.iter().any(|(from, to)| (*from..=*to).contains(&hertz))
        };
        let inside: Vec<&ResponsePoint> = own.points.iter().filter(is_inside).collect();
        let but = match inside.iter().filter(|point| !point.is_carried).count() {
            0 => String::new(),
            few => format!(" but for {few} of {} points", inside.len()),
        };
        format!(
            "{listed}{more}{but} (coherence {CARRIED} and more; {used} s in {stretches}, from {lowest} Hz on)"
        )
    }

    /// The model and its largest departure; the smaller departures, for the full text.
    fn model_sentences(&self, shown: Pathway) -> (Vec<String>, Vec<String>) {
        let Some(from) = &self.model_from else {
            return (vec!["none: give one with --model".to_owned()], Vec::new());
        };
        let modes = self.compared.model.as_ref().map(|model| model.modes_of(shown));
        let modes: Vec<_> = modes.iter().flatten().map(Mode::text).collect();
        let mut sentences = Vec::new();
        if !modes.is_empty() {
            sentences.push(format!("predicts {}", modes.join("; ")));
        }
        let all = &self.compared.departures;
        if all.is_empty() {
            sentences.push(format!(
                "{from}: within the confidence intervals wherever the coherence suffices"
            ));
            return (sentences, Vec::new());
        }
        sentences.extend(self.compared.missing_resonances().iter().map(|mode| {
            let at = significant(mode.frequency_hz, 3);
            format!("no resonance at {at} Hz: an elastic coupling would cause it")
        }));
        let mut bands: Vec<&Departure> = all.iter().collect();
        // The shown pathway first, and of each the largest departure.
        bands.sort_by(|a, b| {
            let is_other = |own: &Departure| own.pathway != shown;
            let sizes = b.magnitude_db.abs().total_cmp(&a.magnitude_db.abs());
            is_other(a).cmp(&is_other(b)).then(sizes)
        });
        let mut bands = bands.into_iter().map(Departure::sentence);
        sentences.extend(bands.next());
        (sentences, bands.collect())
    }

    /// A point of each of twelve intervals of the logarithmic axis, that of a mode where there is one. The shortest bar is 3 dB.
    fn bars(&self, own: &PathwayResponse) -> Vec<(String, f64, String)> {
        let carried: Vec<_> = own.points.iter().filter(|point| point.is_carried).collect();
        let (Some(first), Some(last)) = (carried.first(), carried.last()) else {
            return Vec::new();
        };
        let span = (last.frequency_hz / first.frequency_hz).ln().max(1e-9);
        let interval = |hertz: f64| {
            let share = (hertz / first.frequency_hz).ln() / span * 12.0;
            share.floor().min(11.0)
        };
        let is_same = |a: f64, b: f64| (interval(a) - interval(b)).abs() < 0.5;
        let modes = self.compared.measured.modes_of(own.pathway);
        let shown = carried.chunk_by(|a, b| is_same(a.frequency_hz, b.frequency_hz));
        let shown = shown.map(|points| {
            let hertz = points[0].frequency_hz;
            let mode = modes.iter().find(|mode| is_same(mode.frequency_hz, hertz));
            let point = mode.map_or(points[points.len() / 2], |mode| {
                let apart =
                    |point: &ResponsePoint| (point.frequency_hz / mode.frequency_hz).ln().abs();
                points.iter().min_by(|a, b| apart(a).total_cmp(&apart(b))).unwrap_or(&points[0])
            });
            (point, mode)
        });
        let shown: Vec<(&ResponsePoint, Option<&Mode>)> = shown.collect();
        let decibel = |point: &ResponsePoint| 20.0 * point.magnitude.log10();
        let least = shown.iter().map(|(point, _)| decibel(point)).fold(f64::INFINITY, f64::min);
        let bars = shown.into_iter().map(|(point, mode)| {
            let mode = mode.map_or_else(String::new, |mode| {
                let apart = (point.frequency_hz / mode.frequency_hz).ln().abs();
                let near = if apart > 0.01 { "near the " } else { "" };
                format!("{near}{}", mode.kind.name())
            });
            let name = format!("{:>7} Hz {mode}", significant(point.frequency_hz, 3));
            let value = decibel(point);
            (name.trim_end().to_owned(), value - least + 3.0, format!("{value:+.1}"))
        });
        bars.collect()
    }

    fn go_on(&self, document: &mut Document, is_empty: bool, arguments: &Arguments) {
        let (run, map) = (quoted(&arguments.runs[0]), arguments.map.words());
        if is_empty {
            document.say("record", [CHIRP], 1);
            document.go_on("drivebench run BENCH.toml");
            return;
        }
        match self.model_from.as_deref().map(quoted_word) {
            Some(model) if !self.compared.missing_resonances().is_empty() => document.go_on(format!(
                "drivebench add elastic_coupling --model {model} --run {run}{map} --output model2.toml"
            )),
            Some(model) if self.compared.departures.is_empty() => {
                document.go_on(format!("drivebench tune --model {model}"));
            }
            Some(model) => {
                document.go_on(format!("drivebench diagnose {run} --model {model}{map}"));
            }
            None => document.go_on(format!("drivebench diagnose {run}{map}")),
        }
    }

    /// Magnitude, phase and coherence of a pathway.
    fn svg(&self, pathway: Pathway) -> Result<String, Failure> {
        let chart = response_chart(&self.compared, pathway);
        let description = format!("frequency response, {}: {}", pathway.name(), self.title());
        match chart.svg(&description) {
            svg if svg.is_empty() => Err(Failure::not_identifiable(
                format!(
                    "{}: no frequency has sufficient coherence, nothing is drawn",
                    pathway.name()
                ),
                CHIRP,
            )),
            svg => Ok(standalone(&svg)),
        }
    }

    fn title(&self) -> String {
        let runs = self.runs.join(" and ");
        let model = self.model_from.as_ref();
        model.map_or_else(|| runs.clone(), |model| format!("{runs}; model: {model}"))
    }

    /// A row for each point of each pathway, with the measured values and the model's.
    fn csv(&self) -> Result<String, Failure> {
        let Compared { measured, model, .. } = &self.compared;
        let mut writer = csv::Writer::from_writer(Vec::new());
        let failed = |error: &dyn Display| Failure::internal(format!("the table: {error}"));
        for own in &measured.pathways {
            let predicted = model.as_ref().and_then(|model| model.of(own.pathway));
            let predicted = predicted.map_or(&[][..], |response| response.points.as_slice());
            for point in &own.points {
                let index =
                    predicted.partition_point(|other| other.frequency_hz < point.frequency_hz);
                let other = predicted.get(index);
                let other = other.filter(|other| other.frequency_hz <= point.frequency_hz);
                writer
                    .serialize(Row {
                        pathway: own.pathway.key(),
                        frequency_hz: point.frequency_hz,
                        magnitude_unit: own.unit,
                        magnitude: point.magnitude,
                        magnitude_low: point.magnitude_low,
                        magnitude_high: point.magnitude_high,
                        phase_rad: point.phase_deg.to_radians(),
                        phase_half_width_rad: point.phase_half_width_deg.to_radians(),
                        coherence: point.coherence,
                        is_carried: point.is_carried,
                        model_magnitude: other.map(|other| other.magnitude),
                        model_phase_rad: other.map(|other| other.phase_deg.to_radians()),
                    })
                    .map_err(|error| failed(&error))?;
            }
        }
        let bytes = writer.into_inner().map_err(|error| failed(&error))?;
        String::from_utf8(bytes).map_err(|error| failed(&error))
    }
}

/// An excitation with sufficient coherence, as written in a bench file.
const CHIRP: &str = "[[sequence]] chirp = { amplitude_v = 6.0, from_hz = 0.5, to_hz = 40.0, seconds = 30.0, offset_v = 20.0 } in the bench file, about an offset that keeps the shaft turning";

#[derive(Serialize)]
struct Row {
    pathway: &'static str,
    frequency_hz: f64,
    magnitude_unit: &'static str,
    magnitude: f64,
    magnitude_low: f64,
    magnitude_high: f64,
    phase_rad: f64,
    phase_half_width_rad: f64,
    coherence: f64,
    is_carried: bool,
    model_magnitude: Option<f64>,
    model_phase_rad: Option<f64>,
}

/// The model that is named, else the one in the run's folder, unless it is incomplete.
fn model(
    path: Option<&Path>,
    first: Option<&LoadedRun>,
    terminal: &Terminal,
) -> Result<Option<(PathBuf, Model)>, Failure> {
    if let Some(path) = path {
        let model = read_model(path)?.model;
        model.require_complete()?;
        return Ok(Some((path.to_owned(), model)));
    }
    let folder = first.and_then(|run| run.folder.as_ref());
    let path = folder.map(|folder| RunFolder::existing(folder).file(RunFile::Model));
    let Some(path) = path.filter(|path| path.exists()) else {
        return Ok(None);
    };
    let model = read_model(&path)?.model;
    if let Err(error) = model.require_complete() {
        terminal.message(&format!("{}: not shown: {error}", path.display()));
        return Ok(None);
    }
    Ok(Some((path, model)))
}

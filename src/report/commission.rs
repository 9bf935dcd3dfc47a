//! The report of a commission: what was missing, how the error fell, what the motor is, where the model still fails.

use super::failing;
use super::number::{self, percent, significant};
use super::page::{Cell, Page, Table, Tone};
use super::plot::{Band, Bar, BarChart, Panel, PanelPlot, Series, Style};
use super::{Context, Target, tables};
use crate::diagnosis::{
    Comparison, Diagnosis, DiagnosisVerdict, FailureLocation, HoldoutFrom, Rung, SignalComparison,
    Status,
};
use crate::identification::noise::{FloorSource, NoiseFloor};
use crate::plant::{Input, Model, Scenario, Trajectory, effect};
use crate::sample::ParameterEstimate;
use crate::units::rpm_from_rad_s;

/// Standard deviations within which 99 of 100 normal residuals lie.
const BAND_99: f64 = 2.576;
/// Places that are worth a line each.
const MOST_PLACES: usize = 4;

/// The run that is plotted (the confirming one where there is one) with the free runs of both models.
#[derive(Clone, Copy, Debug)]
pub struct ConfirmRun<'a> {
    pub scenario: &'a Scenario,
    pub before: &'a Trajectory,
    /// `None` where nothing was added.
    pub after: Option<&'a Trajectory>,
    pub noise: &'a NoiseFloor,
}

/// Everything that the page of a commission is made of.
#[derive(Clone, Debug)]
pub struct CommissionReport<'a> {
    pub title: &'a str,
    pub context: &'a Context,
    /// For comparison with what was identified.
    pub nameplate: Option<&'a Model>,
    /// Of the refitted baseline and of the model with what was added.
    pub parameters_before: &'a [ParameterEstimate],
    pub parameters_after: &'a [ParameterEstimate],
    pub before: &'a Comparison,
    /// `None` where nothing was added.
    pub after: Option<&'a Comparison>,
    pub diagnosis: &'a Diagnosis,
    /// Usually the diagnosis' own, longer where the commission went on.
    pub ladder: &'a [Rung],
    /// Errors before and after on the run that neither fitted nor selected: the headline.
    pub confirm: Option<&'a [Rung; 2]>,
    pub series: Option<ConfirmRun<'a>>,
    /// What the emulator really had, as sentences. Left out for hardware whatever is given.
    pub truth: &'a [String],
}

impl CommissionReport<'_> {
    /// `report.html`.
    pub fn html(&self) -> String {
        self.page().html()
    }

    /// The same for a terminal, the verdict first.
    pub fn text(&self) -> String {
        self.page().text()
    }

    /// The page itself, for callers that have more to add.
    pub fn page(&self) -> Page {
        let mut page = Page::new(self.title, self.subtitle());
        let (tone, word) = match self.diagnosis.verdict {
            DiagnosisVerdict::Effect if self.diagnosis.sufficient => (Tone::Good, "Effect found"),
            DiagnosisVerdict::Effect => (Tone::Attention, "Effect found, not sufficient"),
            DiagnosisVerdict::Ambiguous => (Tone::Attention, "Ambiguous"),
            DiagnosisVerdict::None => (Tone::Good, "Nothing missing"),
            DiagnosisVerdict::Unexplained => (Tone::Bad, "Unexplained"),
        };
        page.lead(tone, word, self.headline());
        self.ladder_section(&mut page);
        // Where nothing was added there is one model, not a model before and after.
        let (before, after) = if self.after.is_some() {
            (self.parameters_before, self.parameters_after)
        } else {
            (&[][..], self.parameters_before)
        };
        tables::parameter_section(&mut page, self.nameplate, before, after);
        self.effect_section(&mut page);
        self.next_section(&mut page);
        self.comparison_section(&mut page);
        self.where_section(&mut page);
        self.candidates_section(&mut page);
        if self.context.target == Target::Emulator && !self.truth.is_empty() {
            page.section("Truth of the emulator");
            page.paragraph(
                "Known only because the drive is software. The diagnosis did not see it.",
            );
            page.list(self.truth.to_vec());
        }
        tables::conditions(&mut page, self.context);
        page
    }

    fn subtitle(&self) -> String {
        let target = match self.context.target {
            Target::Unknown => String::new(),
            target => format!(" on {}", target.name()),
        };
        match self.context.run_folders.len() {
            0 => format!("Commission{target}"),
            1 => format!("Commission{target}, one run"),
            runs => format!("Commission{target}, {runs} runs"),
        }
    }

    fn headline(&self) -> String {
        let mut sentence = capitalised(&self.diagnosis.sentence);
        if let Some([before, after]) = self.confirm {
            let (old, new) = (
                significant(before.holdout_rmse, 3),
                significant(after.holdout_rmse, 3),
            );
            let unit = self.unit_of_error();
            let confirmed = if self.after.is_some() {
                format!(
                    ". On a run that neither fitted nor selected: {old} before, {new} after, in units of {unit}"
                )
            } else {
                format!(". On a run that neither fitted nor selected: {old}, in units of {unit}")
            };
            sentence.push_str(&confirmed);
        }
        sentence.push('.');
        sentence
    }

    /// Both comparisons with what their model is called; where nothing was added there is but one model.
    fn comparisons(&self) -> [(&'static str, Option<&Comparison>); 2] {
        let [before, after] = model_names(self.after.is_some());
        [(before, Some(self.before)), (after, self.after)]
    }

    fn unit_of_error(&self) -> &'static str {
        match self.diagnosis.noise_floor_from {
            FloorSource::None => "the baseline's residual",
            FloorSource::Standstill | FloorSource::Repeat => "the noise floor",
        }
    }

    fn ladder_section(&self, page: &mut Page) {
        page.section("Ladder of models");
        let source = match self.diagnosis.noise_floor_from {
            FloorSource::Standstill => "The noise floor is what the sensors show at rest.",
            FloorSource::Repeat => {
                "The noise floor is what two runs of the same excitation do not repeat."
            }
            FloorSource::None => {
                "No noise floor is known: one is the residual of the refitted baseline."
            }
        };
        let from = match self.diagnosis.holdout_from {
            HoldoutFrom::Run => "a run that the fit has not seen",
            HoldoutFrom::Split => "the last part of the run, which the fit has not seen",
        };
        page.paragraph(format!(
            "Error of the free run on {from}, in units of {}. {source}",
            self.unit_of_error()
        ));
        let floor_known = self.diagnosis.noise_floor_from != FloorSource::None;
        let chart = BarChart {
            axis: format!("held-out error, in units of {}", self.unit_of_error()),
            bars: self
                .ladder
                .iter()
                .map(|rung| Bar {
                    label: rung_name(rung),
                    value: rung.holdout_rmse,
                })
                .collect(),
            goal: floor_known.then(|| ("noise floor".to_owned(), 1.0)),
        };
        page.figure(
            chart.svg("held-out error of each model of the ladder"),
            "A perfect model ends at the noise floor.",
        );
        let rows = self.ladder.iter().enumerate().map(|(rung, model)| {
            let change = rung.checked_sub(1).map_or("-".to_owned(), |below| {
                percent(100.0 * (model.holdout_rmse / self.ladder[below].holdout_rmse - 1.0))
            });
            vec![
                Cell::text(rung.to_string()),
                Cell::text(rung_name(model)),
                Cell::text(significant(model.holdout_rmse, 3)),
                Cell::text(change),
            ]
        });
        page.table(Table {
            head: vec!["rung", "model", "held-out error", "change"],
            rows: rows.collect(),
        });
    }

    /// Card of each effect that was named.
    fn effect_section(&self, page: &mut Page) {
        let named: Vec<_> = self
            .diagnosis
            .effects
            .iter()
            .filter_map(|id| effect::find(id))
            .collect();
        if named.is_empty() {
            return;
        }
        page.section("What was found");
        for effect in named {
            let card = effect.card();
            page.paragraph(format!(
                "{} ({}): {}",
                capitalised(card.name),
                card.id,
                card.equation
            ));
            page.list(vec![
                format!("Possible causes: {}.", card.causes),
                format!("Looks like: {}.", card.looks_like),
                format!("Remedy: {}.", card.remedy),
            ]);
        }
        let rivals: Vec<String> = self
            .diagnosis
            .confusable
            .iter()
            .map(|[name, rival]| format!("{name} and {rival} cannot be told apart by these runs."))
            .collect();
        page.list(rivals);
    }

    /// The run that would tell what these do not.
    fn next_section(&self, page: &mut Page) {
        if let Some(next) = &self.diagnosis.next_experiment {
            page.section("Next run");
            page.paragraph(format!("{}.", capitalised(&next.sentence)));
        }
    }

    fn comparison_section(&self, page: &mut Page) {
        page.section("Model beside measurement");
        if let Some(run) = self.series {
            page.figure(
                plot(run).svg("measured and simulated current and speed over time"),
                format!(
                    "Free run of the model over {:?} from its {} alone. A line is broken where samples are missing.",
                    run.scenario.name,
                    input_name(run.scenario.input).0,
                ),
            );
        }
        let mut rows = Vec::new();
        for (name, unit, get) in SIGNALS {
            for (label, comparison) in self.comparisons() {
                if let Some(signal) = comparison.and_then(get) {
                    rows.push(signal_row(name, unit, label, &signal));
                }
            }
        }
        page.table(Table {
            head: vec![
                "signal",
                "model",
                "held-out fit",
                "held-out rms error",
                "noise floor",
                "training fit",
                "training rms error",
                "one-step rms error",
            ],
            rows,
        });
        page.list(
            self.comparisons()
                .into_iter()
                .filter_map(|(label, comparison)| {
                    let residual = comparison?.residual;
                    let white = if residual.white { "only noise is left" } else { "there is more than noise in it" };
                    Some(format!(
                        "Residual of the {label}: {white} ({:.0} % of the autocorrelation lags lie outside their 99 % band; 1 % \
                         is chance).",
                        100.0 * residual.autocorrelation_outside_99_percent
                    ))
                })
                .collect(),
        );
        let models: Vec<_> = self
            .comparisons()
            .into_iter()
            .filter_map(|(label, comparison)| Some((label, &comparison?.residual)))
            .collect();
        failing::lights(page, &models);
    }

    fn where_section(&self, page: &mut Page) {
        page.section("Where the model fails");
        for (label, comparison) in self.comparisons() {
            let Some(comparison) = comparison else {
                continue;
            };
            let label = capitalised(label);
            if comparison.locations.is_empty() {
                page.paragraph(format!(
                    "{label}: the error follows no speed, current, angle or time."
                ));
            } else {
                page.paragraph(format!("{label}:"));
                page.list(
                    comparison
                        .locations
                        .iter()
                        .take(MOST_PLACES)
                        .map(place)
                        .collect(),
                );
            }
            failing::balances(page, comparison);
            failing::map(page, comparison);
            page.list(
                comparison
                    .limits
                    .iter()
                    .map(|limit| capitalised(limit))
                    .collect(),
            );
        }
    }

    fn candidates_section(&self, page: &mut Page) {
        page.section("Effects that were tried");
        let rows = self.diagnosis.candidates.iter().map(|candidate| {
            let status = match candidate.status {
                Status::Supported => "supported",
                Status::Possible => "possible",
                Status::RuledOut => "ruled out",
                Status::NotExcited => "not excited",
            };
            // A size is worth showing only where the effect pays; else the evidence says what would have been seen.
            let paid = matches!(candidate.status, Status::Supported | Status::Possible);
            let parameters: Vec<String> = candidate
                .parameters
                .iter()
                .filter(|_| paid)
                .map(|p| {
                    let key = p.key.rsplit('.').next().unwrap_or(&p.key);
                    format!(
                        "{key} {} {} ({})",
                        number::estimate(p),
                        p.unit,
                        p.verdict.name()
                    )
                })
                .collect();
            vec![
                Cell::text(candidate.rank.to_string()),
                Cell::code(candidate.effect),
                Cell::text(status),
                Cell::text(format!(
                    "{} -> {}",
                    significant(candidate.holdout_before, 3),
                    significant(candidate.holdout_after, 3)
                )),
                Cell::text(format!(
                    "{} %",
                    number::fixed(candidate.explained_percent, 0)
                )),
                Cell::text(format!("{:.0} %", 100.0 * candidate.probability)),
                Cell::text(if parameters.is_empty() {
                    "-".to_owned()
                } else {
                    parameters.join("; ")
                })
                .with_note(capitalised(&candidate.evidence)),
            ]
        });
        page.table(Table {
            head: vec![
                "rank",
                "effect",
                "status",
                "held-out error",
                "explains",
                "ranks first",
                "size ± std, evidence",
            ],
            rows: rows.collect(),
        });
    }
}

type Get = fn(&Comparison) -> Option<SignalComparison>;
const SIGNALS: [(&str, &str, Get); 2] = [
    ("speed", "rad/s", |comparison| {
        comparison.signals.speed_rad_s
    }),
    ("current", "A", |comparison| comparison.signals.current_a),
];

fn signal_row(name: &str, unit: &str, label: &str, signal: &SignalComparison) -> Vec<Cell> {
    let figure = |value: f64| {
        let cell = Cell::text(format!("{} {unit}", significant(value, 3)));
        if unit == "rad/s" && value.is_finite() {
            cell.with_note(format!("{} r/min", significant(rpm_from_rad_s(value), 3)))
        } else {
            cell
        }
    };
    vec![
        Cell::text(name),
        Cell::text(label),
        Cell::text(percent(signal.holdout.fit_percent)),
        figure(signal.holdout.rmse),
        signal.noise_floor.map_or(Cell::text("not known"), figure),
        Cell::text(percent(signal.fit_percent)),
        figure(signal.rmse),
        figure(signal.one_step_rmse),
    ]
}

/// A place's sentence; r/min is added where it lies along the speed.
fn place(location: &FailureLocation) -> String {
    let sentence = capitalised(&location.sentence);
    if location.variable == "speed_rad_s" {
        format!(
            "{sentence} [{} to {} r/min]",
            number::fixed(rpm_from_rad_s(location.from), 0),
            number::fixed(rpm_from_rad_s(location.to), 0)
        )
    } else {
        sentence
    }
}

const fn model_names(changed: bool) -> [&'static str; 2] {
    if changed {
        ["model before", "model after"]
    } else {
        ["model", ""]
    }
}

fn rung_name(rung: &Rung) -> String {
    if rung.effects.is_empty() {
        "baseline".to_owned()
    } else {
        format!("baseline + {}", rung.effects.join(" + "))
    }
}

pub(super) fn capitalised(sentence: &str) -> String {
    let mut characters = sentence.chars();
    characters.next().map_or_else(String::new, |first| {
        first.to_uppercase().chain(characters).collect()
    })
}

const fn input_name(input: Input) -> (&'static str, &'static str) {
    match input {
        Input::Voltage => ("voltage", "V"),
        Input::Current => ("current as input", "A"),
        Input::Torque => ("torque as input", "N.m"),
    }
}

/// Input, both signals and both residuals over one time axis.
fn plot(run: ConfirmRun<'_>) -> PanelPlot {
    let scenario = run.scenario;
    let end_s = scenario.sample_time_s.last().copied().unwrap_or(0.0);
    let (name, unit) = input_name(scenario.input);
    let input = Series::held("command", Style::Command, &scenario.events, end_s);
    let current = signal_panels(
        run,
        "current",
        "A",
        &scenario.current_a,
        |t| &t.current_a,
        run.noise.current_a,
    );
    let speed = signal_panels(
        run,
        "speed",
        "rad/s",
        &scenario.speed_rad_s,
        |t| &t.speed_rad_s,
        run.noise.speed_rad_s,
    );
    let [current, current_residual] = current;
    let [speed, speed_residual] = speed;
    PanelPlot::default()
        .with(Panel::new(name, unit).with_height(90.0).with(input))
        .with(current)
        .with(speed.with_second_unit("r/min", rpm_from_rad_s(1.0)))
        .with(current_residual)
        .with(speed_residual.with_second_unit("r/min", rpm_from_rad_s(1.0)))
}

/// A signal with its models, and what they leave over.
fn signal_panels(
    run: ConfirmRun<'_>,
    name: &str,
    unit: &str,
    measured: &[f64],
    simulated: fn(&Trajectory) -> &Vec<f64>,
    noise: f64,
) -> [Panel; 2] {
    let time_s = &run.scenario.sample_time_s;
    let mut signal = Panel::new(name, unit).with(Series::sampled(
        "measured",
        Style::Measured,
        time_s,
        measured,
    ));
    let mut residual = Panel::new(format!("{name}, simulated - measured"), unit).with_height(110.0);
    // A signal that was not measured has nothing to be compared with.
    let seen = measured.iter().any(|value| value.is_finite());
    let [before, after] = model_names(run.after.is_some());
    let style = if run.after.is_some() {
        Style::Before
    } else {
        Style::After
    };
    let models = [
        (before, style, Some(run.before)),
        (after, Style::After, run.after),
    ];
    for (label, style, trajectory) in models {
        let Some(trajectory) = trajectory.filter(|_| seen) else {
            continue;
        };
        let values = simulated(trajectory);
        signal = signal.with(Series::sampled(label, style, time_s, values));
        let error: Vec<f64> = values
            .iter()
            .zip(measured)
            .map(|(model, truth)| model - truth)
            .collect();
        residual = residual.with(Series::sampled(label, style, time_s, &error));
    }
    if run.noise.source != FloorSource::None {
        residual = residual.with_band(Band {
            label: "99 % of the noise".to_owned(),
            from: -BAND_99 * noise,
            to: BAND_99 * noise,
        });
    }
    [signal, residual]
}

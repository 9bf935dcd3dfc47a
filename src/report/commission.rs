//! The report of a commission: what was missing, how the error fell, what the motor is, where the model still fails.

use super::card::Card;
use super::page::{Page, Table, Tone};
use super::plot::{MOST_POINTS, Panel, Style, TIME, bars, stacked};
use super::{Context, Target, comparison, findings, tables};
use crate::diagnosis::{Answer, Comparison, Diagnosis, EffectCurve, HoldoutFrom, Rung};
use crate::identification::noise::{FloorSource, NoiseFloor};
use crate::plant::{Input, Model, Scenario, Trajectory};
use crate::sample::ParameterEstimate;
use crate::text::lines::capitalised;
use crate::text::number::{fixed, percent};
use crate::units::rpm_from_rad_s;

/// Standard deviations within which 99 of 100 normal residuals lie.
const BAND_99: f64 = 2.576;

/// Parameters that a card shows whatever the room: those of the motor, and of an effect or two.
const MOST_PARAMETERS: usize = 8;

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
    /// What was done, as `Commission` or `Diagnosis`.
    pub kind: &'a str,
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
    /// The curve of each effect that was found; without one, that of the error.
    pub curves: &'a [EffectCurve],
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
        tables::about(&mut page, self.context);
        let answer = self.diagnosis.answer();
        let sentence = capitalised(&self.diagnosis.sentence);
        page.lead(tone(answer), answer.name(), self.headline(&sentence));
        let limits = self.diagnosis.limits.iter();
        page.list(limits.map(|limit| capitalised(limit)).collect());
        tables::data_notes(&mut page, self.context);
        self.ladder_section(&mut page);
        // Where nothing was added there is one model, not a model before and after.
        let (before, after) = if self.after.is_some() {
            (self.parameters_before, self.parameters_after)
        } else {
            (&[][..], self.parameters_before)
        };
        tables::parameter_section(&mut page, self.nameplate, before, after);
        findings::effects(&mut page, self.diagnosis, self.curves);
        self.comparison_section(&mut page);
        comparison::places(&mut page, &self.comparisons());
        findings::curves(&mut page, self.diagnosis);
        findings::candidates(&mut page, self.diagnosis);
        findings::next_run(&mut page, self.diagnosis);
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
            0 => format!("{}{target}", self.kind),
            1 => format!("{}{target}, one run", self.kind),
            runs => format!("{}{target}, {runs} runs", self.kind),
        }
    }

    /// A few lines of it for a terminal; what goes on from here is for the command to say.
    pub fn card(&self) -> Card {
        let (found, answer) = (self.diagnosis, self.diagnosis.answer());
        let headline = self.headline(found.after_name());
        let mut card = Card::new(tone(answer), answer.name(), &headline);
        let ladder = self.ladder.iter().enumerate().map(|(place, rung)| {
            let error = rung.holdout_rmse;
            (self.step_name(place, rung), error, fixed(error, 2))
        });
        let unit = format!("held-out error, in units of {}", self.unit_of_error());
        card.bars("ladder", ladder.collect(), &unit);
        let (before, after) = if self.after.is_some() {
            (self.parameters_before, self.parameters_after)
        } else {
            (&[][..], self.parameters_before)
        };
        let parameters = tables::of_card(self.nameplate, before, after);
        card.table("motor", parameters, tables::SPARE, MOST_PARAMETERS);
        comparison::on_card(&mut card, &self.comparisons());
        findings::on_card(&mut card, found);
        if self.context.target == Target::Emulator {
            card.say("truth", self.truth.iter().map(String::as_str), 1);
        }
        let next = found.next_experiment.as_ref();
        card.say("next run", next.map(|next| next.sentence.as_str()), 1);
        card
    }

    /// What a rung adds to the one above it.
    fn step_name(&self, place: usize, rung: &Rung) -> String {
        let above = place
            .checked_sub(1)
            .and_then(|above| self.ladder.get(above));
        let added = above.and_then(|above| {
            let mut effects = rung.effects.iter();
            effects.find(|effect| !above.effects.contains(effect))
        });
        added.map_or_else(|| rung_name(rung), |effect| format!("+ {effect}"))
    }

    fn headline(&self, sentence: &str) -> String {
        let Some([before, after]) = self.confirm else {
            return format!("{sentence}.");
        };
        let (old, new) = (fixed(before.holdout_rmse, 2), fixed(after.holdout_rmse, 2));
        let errors = if self.after.is_some() {
            format!("{old} before, {new} after")
        } else {
            old
        };
        format!(
            "{sentence}. On a run that neither fitted nor selected: {errors}, in units of {}.",
            self.unit_of_error()
        )
    }

    /// Both comparisons with what their model is called; where nothing was added there is but one model.
    fn comparisons(&self) -> [(&'static str, Option<&Comparison>); 2] {
        let [before, after] = model_names(self.after.is_some());
        [(before, Some(self.before)), (after, self.after)]
    }

    fn unit_of_error(&self) -> &'static str {
        self.diagnosis.noise_floor_from.unit()
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
        let ladder = self.ladder.iter();
        let ladder: Vec<_> = ladder
            .map(|rung| (rung_name(rung), rung.holdout_rmse))
            .collect();
        page.figure(
            bars(
                "held-out error of each model of the ladder",
                &format!("held-out error, in units of {}", self.unit_of_error()),
                &ladder,
                floor_known.then_some(("noise floor", 1.0)),
            ),
            if floor_known {
                "A perfect model of a record without holes ends at the noise floor."
            } else {
                "Where a perfect model would end is not known."
            },
        );
        let change = |rung: usize| {
            let errors = (
                self.ladder[rung].holdout_rmse,
                self.ladder[rung - 1].holdout_rmse,
            );
            percent(100.0 * (errors.0 / errors.1 - 1.0))
        };
        page.table(
            Table::of(self.ladder.iter().enumerate())
                .column("rung", |(rung, _)| rung.to_string())
                .column("model", |(_, model)| rung_name(model))
                .column("held-out error", |(_, model)| fixed(model.holdout_rmse, 2))
                .column("change", |(rung, _)| match rung {
                    0 => "-".to_owned(),
                    rung => change(*rung),
                }),
        );
    }

    fn comparison_section(&self, page: &mut Page) {
        page.section("Model beside measurement");
        if let Some(run) = self.series {
            traces(page, run);
        }
        comparison::figures(page, &self.comparisons());
    }
}

/// Measured and simulated signals and what the models leave over.
pub(super) fn traces(page: &mut Page, run: ConfirmRun<'_>) {
    page.figure(
        stacked(
            "measured and simulated current and speed over time",
            TIME,
            &panels(run),
            MOST_POINTS,
        ),
        format!(
            "Free run of the model over {:?} from its {} alone; time counts from the start of that run. A line is broken where \
             samples are missing.",
            run.scenario.name,
            input_name(run.scenario.input).0,
        ),
    );
}

const fn tone(answer: Answer) -> Tone {
    match answer {
        Answer::Unexplained => Tone::Bad,
        answer if answer.is_whole() => Tone::Good,
        _ => Tone::Attention,
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

const fn input_name(input: Input) -> (&'static str, &'static str) {
    match input {
        Input::Voltage => ("voltage", "V"),
        Input::Current => ("current as input", "A"),
        Input::Torque => ("torque as input", "N.m"),
    }
}

/// Input, both signals and both residuals over one time axis.
fn panels(run: ConfirmRun<'_>) -> [Panel; 5] {
    let (scenario, noise) = (run.scenario, run.noise);
    let start_s = scenario.begin_s();
    let since = |time: f64| time - start_s;
    let events: Vec<_> = (scenario.events.iter())
        .map(|(time, value)| (since(*time), *value))
        .collect();
    let time_s: Vec<f64> = scenario.sample_time_s.iter().copied().map(since).collect();
    let end_s = time_s.last().copied().unwrap_or(0.0);
    let (name, unit) = input_name(scenario.input);
    let input = Panel::new(name, unit).with_height(90.0);
    let r_min = |panel: Panel| panel.with_second_unit("r/min", rpm_from_rad_s(1.0));
    let [current, current_left] = signal_panels(
        run,
        &time_s,
        ("current", "A", noise.current_a),
        &scenario.current_a,
        |t| &t.current_a,
    );
    let [speed, speed_left] = signal_panels(
        run,
        &time_s,
        ("speed", "rad/s", noise.speed_rad_s),
        &scenario.speed_rad_s,
        |t| &t.speed_rad_s,
    );
    [
        input.held("command", &events, end_s),
        current,
        r_min(speed),
        current_left,
        r_min(speed_left),
    ]
}

/// A signal (name, unit, noise) with its models, and what they leave over.
fn signal_panels(
    run: ConfirmRun<'_>,
    time_s: &[f64],
    (name, unit, noise): (&str, &str, f64),
    measured: &[f64],
    simulated: fn(&Trajectory) -> &Vec<f64>,
) -> [Panel; 2] {
    let mut signal = Panel::new(name, unit).sampled("measured", Style::Measured, time_s, measured);
    let mut residual = Panel::new(format!("{name}, measured - model"), unit).with_height(110.0);
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
        signal = signal.sampled(label, style, time_s, values);
        let both = values.iter().zip(measured);
        let error: Vec<f64> = both.map(|(model, measured)| measured - model).collect();
        residual = residual.sampled(label, style, time_s, &error);
    }
    if run.noise.source != FloorSource::None {
        residual = residual.with_band("99 % of the noise", BAND_99 * noise);
    }
    [signal, residual]
}

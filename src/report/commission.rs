//! The report of a commission: what was missing, how the error fell, what the motor is, where the model still fails.

use super::card::Card;
use super::page::{Page, Table, Tone};
use super::plot::bars;
use super::traces::{ConfirmRun, model_names, traces};
use super::{Context, Target, comparison, findings, tables};
use drivebench_diagnose::{Answer, Comparison, Diagnosis, EffectCurve, HoldoutFrom, Rung};
use drivebench_identify::noise::FloorSource;
use drivebench_model::plant::Model;
use drivebench_model::sample::ParameterEstimate;
use drivebench_model::text::lines::capitalised;
use drivebench_model::text::number::{fixed, percent};

/// Parameters that a card shows whatever the room: those of the motor, and of an effect or two.
const MOST_PARAMETERS: usize = 8;

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
        comparison::on_card(&mut card, &self.comparisons(), self.heads());
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

    /// The comparisons are of the run that confirms, where there is one.
    const fn heads(&self) -> comparison::Heads {
        match self.confirm {
            Some(_) => comparison::CONFIRMING,
            None => comparison::HELD_OUT,
        }
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
        comparison::figures(page, &self.comparisons(), self.heads());
    }
}

const fn tone(answer: Answer) -> Tone {
    match answer {
        Answer::Unexplained => Tone::Bad,
        answer if answer.is_whole() => Tone::Good,
        _ => Tone::Attention,
    }
}

fn rung_name(rung: &Rung) -> String {
    if rung.effects.is_empty() {
        "baseline".to_owned()
    } else {
        format!("baseline + {}", rung.effects.join(" + "))
    }
}

//! The report of a commissioning: missing effects, fall of the error, parameters, where the model still fails.

use super::traces::{ConfirmRun, model_names, traces};
use super::wording::{self, diagnosis as words, limits};
use super::{Bars, Context, Document, Table, Target, Tone, comparison, findings, tables};
use drivebench_diagnose::{Answer, Comparison, Diagnosis, EffectCurve, HoldoutFrom, Rung};
use drivebench_identify::noise::FloorSource;
use drivebench_model::plant::Model;
use drivebench_model::text::number::{fixed, percent};

#[derive(Clone, Debug)]
pub struct CommissionReport<'a> {
    /// What was done, as `Commission` or `Diagnosis`.
    pub kind: &'a str,
    pub title: &'a str,
    pub context: &'a Context,
    /// For comparison with what was identified.
    pub nameplate: Option<&'a Model>,
    /// Of the refitted baseline and of the model with what was added, which is the same where nothing was.
    pub before: &'a Comparison,
    pub after: &'a Comparison,
    pub diagnosis: &'a Diagnosis,
    /// Errors before and after on the run that neither fitted nor selected: the headline.
    pub confirm: Option<&'a [Rung; 2]>,
    pub series: Option<&'a ConfirmRun>,
    /// The curve of each effect that was found; without one, that of the error.
    pub curves: &'a [EffectCurve],
    /// What the emulator really had, as sentences. Left out for hardware whatever is given.
    pub truth: &'a [String],
}

impl CommissionReport<'_> {
    pub fn document(&self) -> Document {
        let mut document = Document::new(self.title, self.subtitle());
        let found = self.diagnosis;
        tables::about(&mut document, self.context);
        let answer = found.answer();
        document.lead(tone(answer), words::answer(answer), self.headline());
        let limits = found.limits.iter().map(limits::limit);
        let equivalences = found.equivalences.iter().map(|own| (*own).to_owned());
        document.say("note", limits.chain(equivalences), 1);
        tables::data_notes(&mut document, self.context);
        self.ladder_section(&mut document);
        // Where nothing was added there is one model, not a model before and after.
        let (before, after) = (&found.baseline.parameters[..], &found.model.parameters[..]);
        let (before, after) = if self.is_changed() { (before, after) } else { (&[][..], before) };
        tables::parameter_section(&mut document, "motor", self.nameplate, before, after, 8);
        findings::effects(&mut document, found, self.curves);
        document.section("Model and measurement");
        if let Some(run) = self.series {
            traces(&mut document, run);
        }
        comparison::figures(&mut document, &self.comparisons(), self.heads());
        comparison::places(&mut document, &self.comparisons());
        findings::others(&mut document, found);
        findings::curves(&mut document, found);
        findings::candidates(&mut document, found);
        document.section("Next run");
        findings::next_run(&mut document, found.next_experiment.as_ref());
        if self.context.target == Target::Emulator && !self.truth.is_empty() {
            document.section("Truth of the emulator");
            document.paragraph(
                "Known only because the drive is software; the diagnosis does not use it.",
            );
            document.say("truth", self.truth.iter().map(String::as_str), 1);
        }
        tables::conditions(&mut document, self.context);
        document
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

    const fn is_changed(&self) -> bool {
        !self.diagnosis.effects.is_empty()
    }

    /// What a rung adds to the one above it.
    fn step_name(&self, index: usize, rung: &Rung) -> String {
        let above = index.checked_sub(1).and_then(|above| self.diagnosis.ladder.get(above));
        let added = above
            .and_then(|above| rung.effects.iter().find(|effect| !above.effects.contains(effect)));
        added.map_or_else(|| rung_name(rung), |effect| format!("+ {effect}"))
    }

    fn headline(&self) -> String {
        let sentence = words::after_name(self.diagnosis);
        let Some([before, after]) = self.confirm else {
            return format!("{sentence}.");
        };
        let (old, new) = (fixed(before.holdout_rmse, 2), fixed(after.holdout_rmse, 2));
        let errors = if self.is_changed() { format!("{old} before, {new} after") } else { old };
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
    fn comparisons(&self) -> Vec<comparison::Named<'_>> {
        let models = if self.is_changed() { 2 } else { 1 };
        let names = model_names(self.is_changed()).into_iter();
        names.zip([self.before, self.after]).take(models).collect()
    }

    fn unit_of_error(&self) -> &'static str {
        wording::unit(self.diagnosis.noise_floor_from)
    }

    fn ladder_section(&self, document: &mut Document) {
        document.section("Ladder of models");
        let source = match self.diagnosis.noise_floor_from {
            FloorSource::Standstill => "The noise floor is what the sensors show at rest.",
            FloorSource::Repeat => {
                "The noise floor is the difference of two runs of the same excitation."
            }
            FloorSource::None => {
                "No noise floor is known: one is the residual of the refitted baseline."
            }
        };
        let from = match self.diagnosis.holdout_from {
            HoldoutFrom::Run => "a run not used in the fit",
            HoldoutFrom::Split => "the last part of the run, not used in the fit",
        };
        document.paragraph(format!(
            "Error of the free run on {from}, in units of {}. {source}",
            self.unit_of_error()
        ));
        let floor_known = self.diagnosis.noise_floor_from != FloorSource::None;
        let rungs = &self.diagnosis.ladder;
        let ladder = rungs.iter().enumerate().map(|(index, rung)| {
            let error = rung.holdout_rmse;
            (self.step_name(index, rung), error, fixed(error, 2))
        });
        let caption = if floor_known {
            "A perfect model of a record without gaps ends at the noise floor."
        } else {
            "The error of a perfect model is not known."
        };
        let unit = format!("held-out error, in units of {}", self.unit_of_error());
        document.bars(
            "ladder",
            Bars {
                goal: floor_known.then_some(("noise floor", 1.0)),
                caption: caption.to_owned(),
                ..Bars::new(ladder.collect(), unit)
            },
        );
        let change = |rung: usize| {
            let errors = (rungs[rung].holdout_rmse, rungs[rung - 1].holdout_rmse);
            percent(100.0 * (errors.0 / errors.1 - 1.0))
        };
        document.table(
            Table::of(rungs.iter().enumerate())
                .column("rung", |(rung, _)| rung.to_string())
                .column("model", |(_, model)| rung_name(model))
                .column("held-out error", |(_, model)| fixed(model.holdout_rmse, 2))
                .column("change", |(rung, _)| match rung {
                    0 => "-".to_owned(),
                    rung => change(*rung),
                }),
        );
    }
}

pub const fn tone(answer: Answer) -> Tone {
    match answer {
        Answer::Unexplained | Answer::NotFitted => Tone::Bad,
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

//! Runs and models named on the command line.

use std::cell::OnceCell;
use std::path::{Path, PathBuf};

use clap::Args;

use super::failure::Failure;
use super::holdout::{self, Beside};
use super::provenance::Provenance;
use super::sanity_report::{self, Judging};
use super::{output, progress};
pub(super) use crate::app::files::{load, read_model, read_text};
use crate::diagnosis::{Evidence, HoldoutFrom};
use crate::identification::start;
use crate::plant::{Model, ModelFile, Motor, Scenario};
use crate::recording::{ColumnMap, LoadedRun};
use crate::sample::{Channel, Run};

/// How foreign columns are read.
#[derive(Args, Clone, Debug, Default)]
pub(super) struct MapArguments {
    /// Columns of a foreign CSV: 'target=header[*factor][+offset],...', as time_s=t,speed_rad_s=rpm*0.104719755; a factor may be
    /// a column (voltage_v=duty*bus_v) or sign(COLUMN), the last sign of a command that was not zero, for a speed without one
    /// (speed_rad_s=rpm*0.104719755*sign(duty))
    #[arg(long, value_name = "MAP")]
    #[expect(
        clippy::doc_markdown,
        reason = "the help in a terminal shows backticks as they are"
    )]
    pub(super) map: Option<String>,
    /// Another map for the hold-out and the confirming run
    #[arg(long, value_name = "MAP")]
    pub(super) map_holdout: Option<String>,
    /// Where signals come from, as voltage_v=commanded,current_a=supply: measured, estimated, commanded; terminal, supply
    #[arg(long, value_name = "KEY=WORD,...")]
    #[expect(
        clippy::doc_markdown,
        reason = "the help in a terminal shows backticks as they are"
    )]
    pub(super) origin: Option<Provenance>,
}

impl MapArguments {
    fn parse(text: Option<&String>) -> Result<Option<ColumnMap>, Failure> {
        let map = text.map(|text| text.parse::<ColumnMap>()).transpose()?;
        sanity_report::headers(map.as_ref())?;
        Ok(map)
    }

    /// Opens the run with its map; what the command line says of origins goes before what a manifest says.
    pub(super) fn load(&self, path: &Path) -> Result<LoadedRun, Failure> {
        self.load_with(path, self.map.as_ref())
    }

    /// The same for a hold-out or a confirming run.
    fn load_other(&self, path: &Path) -> Result<LoadedRun, Failure> {
        self.load_with(path, self.map_holdout.as_ref().or(self.map.as_ref()))
    }

    fn load_with(&self, path: &Path, map: Option<&String>) -> Result<LoadedRun, Failure> {
        let mut loaded = load(path, Self::parse(map)?.as_ref())?;
        if let Some(provenance) = &self.origin {
            provenance.apply(&mut loaded.run);
        }
        Ok(loaded)
    }
}

/// A model with the place it came from.
pub(super) struct ChosenModel {
    pub(super) file: ModelFile,
    pub(super) from: String,
}

/// The model file, else the run folder's, else the five-parameter baseline with values yet to be found.
pub(super) fn model(path: Option<&PathBuf>, run: &LoadedRun) -> Result<ChosenModel, Failure> {
    let in_folder = run
        .folder
        .as_ref()
        .map(|folder| folder.join("model.toml"))
        .filter(|file| file.exists());
    let Some(path) = path.cloned().or(in_folder) else {
        output::message("no model given: the five-parameter baseline is fitted to the run first");
        let file = ModelFile {
            model: Model::baseline(Motor::new("fitted")),
            ..ModelFile::default()
        };
        return Ok(ChosenModel {
            file,
            from: "baseline".to_owned(),
        });
    };
    Ok(ChosenModel {
        file: read_model(&path)?,
        from: path.display().to_string(),
    })
}

/// Fit run, hold-out and confirming run of a command, and the model that they judge.
#[derive(Args, Clone, Debug)]
pub(super) struct EvidenceArguments {
    /// Another run, which the fit has not seen; without it the last 40 % of RUN are held out
    #[arg(long, value_name = "RUN2")]
    pub(super) holdout: Option<PathBuf>,
    /// A third run, which has no part in the answer: the answer is repeated on it, and the headline error is from there
    #[arg(long, value_name = "RUN3")]
    pub(super) confirm: Option<PathBuf>,
    #[command(flatten)]
    pub(super) map: MapArguments,
}

/// What a screen or a page calls the data: runs that were set aside are not among them.
pub(super) struct About {
    /// The fitted run and what is held out, by the last part of their names.
    pub(super) title: String,
    /// The runs that are used, the one that is fitted first.
    pub(super) runs: Vec<PathBuf>,
    /// Whether something speaks against the hold-out that is used all the same.
    pub(super) holdout_objected: bool,
}

impl About {
    fn new(run: &Path, evidence: &Evidence, args: &EvidenceArguments, objected: bool) -> Self {
        let is_run = evidence.holdout_from == HoldoutFrom::Run;
        let holdout = args.holdout.as_deref().filter(|_| is_run);
        let confirm = args
            .confirm
            .as_deref()
            .filter(|_| evidence.confirm.is_some());
        let name = |path: &Path| {
            path.file_name()
                .map_or_else(String::new, |name| name.to_string_lossy().into_owned())
        };
        let used = [Some(run), holdout, confirm];
        Self {
            title: holdout.map_or_else(
                || format!("{}, last 40 % held out", name(run)),
                |holdout| format!("{}, held out {}", name(run), name(holdout)),
            ),
            runs: used.into_iter().flatten().map(Path::to_owned).collect(),
            holdout_objected: objected && is_run,
        }
    }
}

/// Everything that `compare`, `diagnose`, `add` and `remove` need.
pub(super) struct Prepared {
    pub(super) run: LoadedRun,
    pub(super) model: ChosenModel,
    pub(super) evidence: Evidence,
    pub(super) about: About,
}

/// Opens what the command names; data that it cannot judge end it.
pub(super) fn prepare(
    path: &Path,
    model_path: Option<&PathBuf>,
    args: &EvidenceArguments,
    judging: Judging,
) -> Result<Prepared, Failure> {
    progress::stage("reads the runs", 0);
    let mut run = args.map.load(path)?;
    let mut model = model(model_path, &run)?;
    let fit_run = Scenario::from_run(&run.run)?;
    let judging = if model.from == "baseline" {
        Judging::FitsFirst
    } else {
        judging
    };
    sanity_report::before_judging(&mut run.run, &fit_run, &model.file.model, judging)?;
    let cautions = holdout::cautions(&run.run, &fit_run);
    output::warn(&cautions);
    run.run.notes.extend(cautions);
    let mut others = Vec::new();
    let mut other = |path: Option<&PathBuf>| -> Result<Option<(LoadedRun, Scenario)>, Failure> {
        let Some(path) = path else { return Ok(None) };
        let loaded = args.map.load_other(path)?;
        let scenario = Scenario::from_run(&loaded.run)?;
        let cautions = holdout::cautions(&loaded.run, &scenario);
        output::warn(&cautions);
        others.extend(cautions);
        Ok(Some((loaded, scenario)))
    };
    name_voltage(&run.run, &fit_run);
    let limited = limited_note(&run.run);
    if let Some(note) = limited.filter(|_| fit_run.input_channel == Channel::VoltageCmd) {
        output::message(&note);
        run.run.notes.push(note);
    }
    progress::stage("finds where the fit starts", 0);
    model.file.model = start::complete(&model.file.model, &fit_run)?;
    let (holdout, confirm) = (other(args.holdout.as_ref())?, other(args.confirm.as_ref())?);
    run.run.notes.extend(others);
    let mut beside = Beside {
        model: &model.file.model,
        fitted: &fit_run,
        judging,
        fingerprint: OnceCell::new(),
    };
    let mut judge = |role, other: Option<_>, instead| {
        let judged = other.map(|other| beside.judge(role, other, instead, &mut run.run.notes));
        judged.unwrap_or_default()
    };
    let holdout = judge(
        "hold-out",
        holdout,
        "the last 40 % of the run are held out instead",
    );
    let confirm = judge("confirming run", confirm, "nothing is confirmed").used;
    let confirm = confirm
        .filter(|confirm| holdout::had_no_part(confirm, holdout.used.as_ref(), &mut run.run.notes));
    let evidence = Evidence::new(fit_run, holdout.used, confirm);
    let mut objected = holdout.objected;
    if judging == Judging::AsGiven {
        let own = args
            .holdout
            .as_deref()
            .filter(|_| evidence.holdout_from == HoldoutFrom::Run);
        let fitted = holdout::was_fitted_on(&model.file.history.fitted_on, path, own);
        objected |= fitted.is_some();
        output::warn(fitted.as_slice());
        run.run.notes.extend(fitted);
    }
    let about = About::new(path, &evidence, args, objected);
    Ok(Prepared {
        run,
        model,
        evidence,
        about,
    })
}

/// Names the column that serves as the voltage, where it is not the only one or not the first choice.
pub(super) fn name_voltage(run: &Run, scenario: &Scenario) {
    match scenario.input_channel {
        Channel::VoltageCmd => output::message("voltage_cmd_v serves as the voltage"),
        Channel::Voltage if run.column(Channel::VoltageCmd).is_some() => {
            output::message("voltage_v serves as the voltage, not the voltage_cmd_v beside it");
        }
        _ => {}
    }
}

/// Says how often the command was not what the motor had.
fn limited_note(run: &Run) -> Option<String> {
    let limited = run.limited_rows().len();
    (limited > 0).then(|| {
        let samples = run.points(Channel::Voltage).count();
        let instead = if samples == 0 {
            "what the motor had was not measured: smaller steps would leave the command in force"
        } else {
            "there the measured voltage serves"
        };
        format!("a limit of the drive held its output at {limited} samples; {instead}")
    })
}

//! The page of the program without a command: the procedure in one picture, the files of this folder, and the next step.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use crate::runtime::names_in;
use drivebench_bench::BenchFile;
use drivebench_bench::recording::{LATEST, RunFile, read_text};
use drivebench_model::plant::ModelFile;
use drivebench_model::text::shell::quoted_word;

/// The commands in their usual order, which returns from `add` to `compare` until only noise is left.
const PROCEDURE: &str = "  connect   ports, doctor       what is plugged in; does the line work?
  prepare   init, plan          the bench file; what will happen, before it does
  measure   run, identify       the motor turns; its parameters with uncertainties
  explain   compare, diagnose   where the model fails, and the missing effect <-.
  extend    add                 the effect joins the model: the error falls ----'
  use       tune, speed         a speed loop that adapts to the motor
  share     export              the model in other tools; report.html shows it all

`commission` does all steps by itself; `drivebench help` lists every command.
";

#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Found {
    benches: Vec<String>,
    /// Model files, with the effects in them.
    models: Vec<(String, Vec<String>)>,
    /// Folders of runs, the newest last.
    runs: Vec<Run>,
    /// Whether `runs/latest` names the newest.
    has_latest: bool,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Run {
    name: String,
    is_finished: bool,
    /// The effects of its model, where it has one.
    model: Option<Vec<String>>,
    has_report: bool,
}

/// The page for the folder that the program was called in.
pub(crate) fn page(folder: &Path) -> String {
    let found = Found::of(folder);
    let mut text = format!(
        "drivebench {}: identify a motor on line, and name the effect that its model lacks\n\n{PROCEDURE}",
        env!("CARGO_PKG_VERSION")
    );
    let _ = writeln!(text, "\nIn this folder");
    for line in found.lines() {
        let _ = writeln!(text, "  {line}");
    }
    let _ = writeln!(text, "\nNext");
    for (command, why) in found.next() {
        let _ = writeln!(text, "  {command}\n      {why}");
    }
    text
}

impl Found {
    fn of(folder: &Path) -> Self {
        let mut found = Self::default();
        for name in names_in(folder) {
            if Path::new(&name).extension().is_none_or(|ending| ending != "toml") {
                continue;
            }
            let Ok(text) = read_text(&folder.join(&name)) else {
                continue;
            };
            if BenchFile::parse(&name, &text).is_ok() {
                found.benches.push(name);
            } else if let Some(effects) = effects_of(&name, &text) {
                found.models.push((name, effects));
            }
        }
        let runs = folder.join("runs");
        for name in names_in(&runs) {
            let path = runs.join(&name);
            let Ok(manifest) = read_text(&path.join(RunFile::Manifest.name())) else {
                continue;
            };
            if path.is_symlink() {
                continue;
            }
            let manifest = serde_json::from_str::<serde_json::Value>(&manifest).unwrap_or_default();
            let model = read_text(&path.join(RunFile::Model.name())).ok();
            found.runs.push(Run {
                model: model.and_then(|text| effects_of(RunFile::Model.name(), &text)),
                is_finished: manifest["finished"] == true,
                has_report: path.join(RunFile::Report.name()).exists(),
                name,
            });
        }
        let latest = fs::read_link(runs.join(LATEST)).ok();
        // Runs of the same second are sorted by name, not by time: the link names the newest.
        let is_latest = |run: &Run| latest.as_deref() == Some(Path::new(&run.name));
        if let Some(index) = found.runs.iter().position(is_latest) {
            let newest = found.runs.remove(index);
            found.runs.push(newest);
            found.has_latest = true;
        }
        found
    }

    /// The files, one kind a line.
    fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if !self.benches.is_empty() {
            lines.push(format!("bench files: {}", self.benches.join(", ")));
        }
        for (name, effects) in &self.models {
            lines.push(format!("model: {name} ({})", with(effects)));
        }
        if let Some(newest) = self.runs.last() {
            let unfinished = if newest.is_finished { "" } else { ", unfinished" };
            let (count, name) = (self.runs.len(), &newest.name);
            lines.push(format!("runs: {count}, the newest {name}{unfinished}"));
            if let Some(effects) = &newest.model {
                lines.push(format!("its model: {}", with(effects)));
            }
        }
        if let Some(run) = self.runs.iter().rev().find(|run| run.has_report) {
            lines.push(format!("report: runs/{}/report.html", run.name));
        }
        if lines.is_empty() {
            lines.push("no bench file, model or run yet".to_owned());
        }
        lines
    }

    /// The next steps in their order: command and purpose.
    fn next(&self) -> Vec<(String, String)> {
        let step = |command: String, why: &str| (command, why.to_owned());
        let tuned = |model: String| {
            let why = "gains of a speed loop from the model, with reasons; then `drivebench speed`";
            step(format!("drivebench tune --model {}", quoted_word(&model)), why)
        };
        let mut models = self.models.iter().rev();
        if let Some((name, _)) = models.find(|(_, effects)| !effects.is_empty()) {
            return vec![tuned(name.clone())];
        }
        let modelled = self.runs.iter().rev().find(|run| run.model.is_some());
        match (modelled, self.runs.last(), self.benches.first()) {
            (Some(run), ..) => {
                let path = self.path(run);
                let effects = run.model.as_deref().unwrap_or_default();
                let model = format!("{path}/{}", RunFile::Model.name());
                let mut steps = vec![step(
                    format!("drivebench diagnose {}", quoted_word(&path)),
                    "which effect is still missing in its model, and the command that adds it",
                )];
                if !effects.is_empty() {
                    steps.insert(0, tuned(model));
                }
                steps
            }
            (None, Some(run), _) => vec![step(
                format!("drivebench identify {} --output model.toml", quoted_word(&self.path(run))),
                "the parameters of the motor, each with its uncertainty",
            )],
            (None, None, Some(bench)) => vec![
                step(
                    format!("drivebench plan {}", quoted_word(bench)),
                    "what will happen, and what the guard allows, before anything moves",
                ),
                step(
                    format!("drivebench commission {}", quoted_word(bench)),
                    "all steps on this bench",
                ),
            ],
            (None, None, None) => vec![
                step(
                    "drivebench commission".to_owned(),
                    "all steps on an emulated motor with a hidden effect: nothing real moves",
                ),
                step(
                    "drivebench doctor".to_owned(),
                    "what is plugged in, and what a real drive needs; nothing is written to it",
                ),
            ],
        }
    }

    /// A run as a command takes it: by its link where it is the newest.
    fn path(&self, run: &Run) -> String {
        let is_newest = self.runs.last() == Some(run);
        let name = if self.has_latest && is_newest { LATEST } else { &run.name };
        format!("runs/{name}")
    }
}

fn with(effects: &[String]) -> String {
    match effects {
        [] => "no effect beyond the baseline".to_owned(),
        effects => format!("with {}", effects.join(", ")),
    }
}

/// The effects of a model file; `None` where it is none.
fn effects_of(name: &str, text: &str) -> Option<Vec<String>> {
    // Any table parses as an empty model.
    let has_motor = text.lines().any(|line| line.trim() == "[motor]");
    let file = ModelFile::parse(name, text).ok().filter(|_| has_motor)?;
    Some(file.model.effect_ids().into_iter().map(str::to_owned).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(name: &str, model: Option<&[&str]>) -> Run {
        Run {
            name: name.to_owned(),
            is_finished: true,
            model: model.map(|ids| ids.iter().map(|id| (*id).to_owned()).collect()),
            has_report: false,
        }
    }

    fn first(found: &Found) -> String {
        found.next()[0].0.clone()
    }

    #[test]
    fn the_next_step_follows_from_the_files() {
        let mut found = Found::default();
        assert_eq!(first(&found), "drivebench commission");
        found.benches.push("b.toml".to_owned());
        assert_eq!(first(&found), "drivebench plan b.toml");
        found.runs.push(run("1-a", None));
        assert_eq!(first(&found), "drivebench identify runs/1-a --output model.toml");
        found.runs.push(run("2-b", Some(&[])));
        assert_eq!(first(&found), "drivebench diagnose runs/2-b");
        found.has_latest = true;
        assert_eq!(first(&found), "drivebench diagnose runs/latest");
        found.runs.push(run("3-c", None));
        assert_eq!(first(&found), "drivebench diagnose runs/2-b");
        found.runs.push(run("4-d", Some(&["cogging"])));
        assert_eq!(first(&found), "drivebench tune --model runs/latest/model.toml");
        found.models.push(("m.toml".to_owned(), vec!["cogging".to_owned()]));
        assert_eq!(first(&found), "drivebench tune --model m.toml");
    }
}

//! `map`: the likely `--map` of a foreign log, each column with its reasons and doubts.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::commands::arguments::TextArguments;
use crate::report::wording::{columns, json, sanity};
use crate::report::{Document, Tone};
use crate::runtime::{Failure, Form, REFUSED, Terminal, quoted, quoted_word};
use drivebench_bench::column_proposal::{
    Confidence, Item, Proposal, known_headers, numbers, propose,
};
use drivebench_bench::recording::{Preview, ReadOptions, preview};
use drivebench_model::config_text::help_for_unknown;

/// Propose which column of a foreign CSV is which quantity, with the reasons: the --map of the other commands
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  drivebench map log.csv\n  drivebench map vesc.csv --number POLE_PAIRS=7     a number that the file does not contain\n\nExit status: 0 with a map of which no part is unsure, 1 without one; the map is printed all the same, as far as it goes"
)]
pub(super) struct Arguments {
    /// CSV file of another program or of an instrument
    file: PathBuf,
    /// Numbers that the file does not contain, as the map names them: POLE_PAIRS=7,SUPPLY_V=24
    #[arg(long, value_name = "NAME=VALUE,...", value_parser = given_numbers)]
    number: Option<Given>,
    #[command(flatten)]
    text: TextArguments,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

type Given = BTreeMap<String, f64>;

fn given_numbers(text: &str) -> Result<Given, String> {
    let one = |item: &str| {
        let (name, value) = item
            .split_once('=')
            .ok_or_else(|| format!("{item:?} is not of the form NAME=VALUE"))?;
        let name = name.trim().to_ascii_uppercase();
        if !numbers().any(|known| known == name) {
            let help = help_for_unknown(&name, numbers());
            return Err(format!("unknown number {name:?}: {help}"));
        }
        let value = value.trim().parse::<f64>().ok();
        let value = value.filter(|value| value.is_finite() && value.abs() > 0.0);
        let value = value.ok_or_else(|| format!("{item:?}: expected a number other than 0"))?;
        Ok((name, value))
    };
    text.split(',').map(str::trim).filter(|item| !item.is_empty()).map(one).collect()
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let found = preview(&arguments.file, arguments.text.options(), known_headers)?;
    let proposal = propose(&found, arguments.number.as_ref().unwrap_or(&Given::new()));
    let mut value = json::map(&proposal);
    value["file"] = arguments.file.display().to_string().into();
    value["rows"] = found.rows.into();
    value["lines_before_headers"] = found.lines_before.into();
    let document = document(arguments, &found, &proposal);
    terminal.document(&value, Form::full(arguments.json), &document)?;
    if proposal.is_own || proposal.is_settled() {
        return Ok(());
    }
    let file = arguments.file.display();
    let (headline, help) = match &proposal.map {
        None => {
            let missing: Vec<String> = proposal.missing.iter().map(columns::missing).collect();
            (
                format!("{file}: no map, for it lacks {}", missing.join(", and ")),
                "name the columns with --map yourself, as far as the file has them",
            )
        }
        Some(_) => (
            format!("{file}: the map is unsure: {}", unsure(&proposal)),
            "settle what is doubted above, and give the map to the other commands",
        ),
    };
    Err(Failure::with_help(REFUSED, headline, help))
}

fn unsure(proposal: &Proposal) -> String {
    let is_unsure = |item: &&Item| item.hole.is_some() || item.confidence == Confidence::Unsure;
    let mut parts: Vec<String> = Vec::new();
    for item in proposal.items.iter().filter(is_unsure) {
        match &item.hole {
            Some(hole) => parts.push(format!("{} needs {}", item.target, hole.name)),
            None => parts.push(item.target.to_owned()),
        }
    }
    parts.extend(proposal.doubts.first().map(sanity::fault));
    parts.join(", ")
}

/// The way on where a foreign file is given without a map; `None` where its headers are those of this program.
pub(super) fn map_help(file: &Path, options: ReadOptions<'_>) -> Option<String> {
    // A pipe has been read.
    let found = file.is_file().then(|| preview(file, options, known_headers).ok()).flatten()?;
    let proposal = propose(&found, &Given::new());
    if proposal.is_own {
        return None;
    }
    let command = format!("`drivebench map {}` proposes which column is what", quoted(file));
    let is_sure = proposal.confidence() == Confidence::Sure;
    Some(match proposal.map.filter(|_| is_sure) {
        Some(map) => format!("{command}; it is sure of --map {}", quoted_word(&map)),
        None => command,
    })
}

fn document(arguments: &Arguments, found: &Preview, proposal: &Proposal) -> Document {
    let file = &arguments.file;
    let words = quoted(file) + &arguments.text.words();
    let tool = proposal.tool.map_or_else(String::new, |tool| format!(", a log of {tool}"));
    let size =
        format!("{}{tool}: {} rows, {} columns", file.display(), found.rows, found.headers.len());
    let (tone, verdict) = match (&proposal.map, proposal.confidence()) {
        _ if proposal.is_own => (Tone::Good, "no map needed"),
        (None, _) => (Tone::Bad, "no map"),
        (Some(_), Confidence::Sure) => (Tone::Good, "sure"),
        (Some(_), Confidence::Likely) => (Tone::Good, "likely"),
        (Some(_), Confidence::Unsure) => (Tone::Attention, "unsure"),
    };
    let mut document = Document::of(tone, verdict, size);
    if proposal.is_own {
        document.say("headers", ["they are those of this program"], 1);
        document.go_on(format!("drivebench identify {words}"));
        return document;
    }
    for item in &proposal.items {
        let hole = item.hole.as_ref().map(|hole| format!(" but for {}", hole.name));
        let confidence = item.confidence.code();
        let head =
            format!("{confidence}{}: {}={}", hole.unwrap_or_default(), item.target, item.source);
        let doubts = item.doubts.iter().map(|doubt| format!("but {}", columns::doubt(doubt)));
        let all = [head, columns::all(&item.reasons)].into_iter().chain(doubts);
        document.say(item.target.split('_').next().unwrap_or_default(), all, 1);
    }
    document.say("fill in", proposal.holes().map(|hole| format!("{}: {}", hole.name, hole.how)), 1);
    document.say("missing", proposal.missing.iter().map(columns::missing), 1);
    document.say("doubt", proposal.doubts.iter().map(sanity::fault), 1);
    document.say("left out", proposal.unused.iter().map(columns::unused), 1);
    let names: Vec<String> = proposal.holes().map(|hole| format!("{}=VALUE", hole.name)).collect();
    if !names.is_empty() {
        document.go_on(format!("drivebench map {words} --number {}", names.join(",")));
    }
    if let Some(map) = &proposal.map {
        document.go_on(format!("drivebench identify {words} --map {}", quoted_word(map)));
    }
    document
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_given_under_their_names() {
        let found = given_numbers("pole_pairs=7, SUPPLY_V=24").unwrap();
        assert_eq!(found["POLE_PAIRS"].to_bits(), 7f64.to_bits());
        assert_eq!(found.len(), 2);
        for (text, part) in [
            ("7", "NAME=VALUE"),
            ("POLE_PAIR=7", "did you mean `POLE_PAIRS`"),
            ("POLE_PAIRS=0", "other than 0"),
            ("POLE_PAIRS=x", "other than 0"),
        ] {
            let error = given_numbers(text).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }
}

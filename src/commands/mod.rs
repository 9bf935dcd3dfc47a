//! The command line: one file a command, with its arguments, order of work and result. Results go to stdout, messages to stderr.
//!
//! ```text
//! arguments -> order of work (runtime: rig, files, every way out) -> document or JSON -> exit status
//! ```

#![expect(
    clippy::struct_excessive_bools,
    clippy::doc_markdown,
    reason = "switches of a command line; the help in a terminal shows backticks as they are"
)]

mod add;
mod analyse;
mod arguments;
mod bode;
mod by_hand;
mod cards;
mod commission;
mod compare;
mod diagnose;
mod doctor;
mod effects;
mod emulate;
#[cfg(test)]
mod ending_tests;
mod evidence;
mod export;
mod front;
mod identify;
mod init;
mod map;
mod pages;
mod plan;
mod probe;
mod register_values;
mod registers;
mod replay;
mod report;
mod reproduce;
mod run;
mod shell;
mod simulate;
mod speed;
mod test;
mod tune;
mod view;

use std::path::Path;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{Parser, Subcommand};

use crate::runtime::{Failure, Terminal};
use crate::tui::Appearance;

const EXIT_STATUSES: &str = "\
Exit status:
  0    done and passed (any verdict of diagnose)
  1    done and not accepted: --min-fit, a refused effect, a drive that is not plausible, a replay that differs, a run
       of many that cannot be read
  2    usage or configuration, or more than plan or line allow
  3    link or device: no answer, another drive, a failed check, no --hardware, a locked or open motor
  4    safety trip
  5    not identified: nothing at all, or a key of --require
  6    internal error, or a record that could not be kept
  130  interrupted, after a safe stop";

/// Talks to a motor drive, identifies the motor on line, and names the physical effect its model is missing.
#[derive(Parser)]
#[command(name = "drivebench", version, after_help = EXIT_STATUSES)]
struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    /// Colours of screens: the terminal's sixteen, those for a white background, or none (as with NO_COLOR)
    #[arg(long, global = true, value_enum, value_name = "THEME")]
    theme: Option<Theme>,
    /// Screens take the mouse: the wheel zooms traces and scrolls, a click selects; text is then selected with Shift held
    #[arg(long, global = true)]
    mouse: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Theme {
    Colour,
    Light,
    Mono,
}

#[derive(Subcommand)]
enum Command {
    Commission(commission::Arguments),
    Emulate(emulate::Arguments),
    Init(init::Arguments),
    Ports(doctor::PortsArguments),
    Doctor(doctor::Arguments),
    Probe(probe::Arguments),
    Registers(registers::Arguments),
    Plan(plan::Arguments),
    Run(run::Arguments),
    Speed(speed::Arguments),
    Map(map::Arguments),
    Identify(identify::Arguments),
    Analyse(analyse::Arguments),
    Replay(replay::Arguments),
    Simulate(simulate::Arguments),
    Test(test::Arguments),
    Compare(compare::Arguments),
    View(view::Arguments),
    Bode(bode::Arguments),
    Diagnose(diagnose::Arguments),
    Add(add::AddArguments),
    Remove(add::Arguments),
    Effects(effects::Arguments),
    Tune(tune::Arguments),
    Export(export::Arguments),
    Report(report::Arguments),
    #[command(hide = true)]
    Reproduce(reproduce::Arguments),
    Completions(shell::Completions),
    Man(shell::Man),
}

pub fn main() -> ExitCode {
    program(execute)
}

/// Runs a program with the process's arguments: a usage error, like a failure, is printed as headline and help line.
pub fn program<A: Parser>(execute: impl FnOnce(A, &Terminal) -> Result<(), Failure>) -> ExitCode {
    let terminal = Terminal::default();
    let done = match A::try_parse() {
        Ok(arguments) => execute(arguments, &terminal),
        Err(error) if error.use_stderr() => Err(usage_failure(&error, A::command())),
        Err(error) => {
            // Help and version, perhaps into a pipe that is closed.
            let _ = error.print();
            Ok(())
        }
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            terminal.failure(&failure);
            ExitCode::from(failure.status)
        }
    }
}

fn execute(arguments: Arguments, terminal: &Terminal) -> Result<(), Failure> {
    if let Some(theme) = arguments.theme {
        crossterm::style::force_color_output(theme != Theme::Mono);
    }
    terminal.set_appearance(Appearance {
        is_light: arguments.theme == Some(Theme::Light),
        takes_mouse: arguments.mouse,
    });
    let Some(command) = arguments.command else {
        return terminal.text(&front::page(Path::new(".")));
    };
    match command {
        Command::Commission(arguments) => commission::execute(arguments, terminal),
        Command::Emulate(arguments) => emulate::execute(arguments, terminal),
        Command::Init(arguments) => init::execute(&arguments, terminal),
        Command::Ports(arguments) => doctor::execute_ports(&arguments, terminal),
        Command::Doctor(arguments) => doctor::execute(&arguments, terminal),
        Command::Probe(arguments) => probe::execute(&arguments, terminal),
        Command::Registers(arguments) => registers::execute(&arguments, terminal),
        Command::Plan(arguments) => plan::execute(&arguments, terminal),
        Command::Run(arguments) => run::execute(&arguments, terminal),
        Command::Speed(arguments) => speed::execute(arguments, terminal),
        Command::Map(arguments) => map::execute(&arguments, terminal),
        Command::Identify(arguments) => identify::execute(&arguments, terminal),
        Command::Analyse(arguments) => analyse::execute(&arguments, terminal),
        Command::Replay(arguments) => replay::execute(&arguments, terminal),
        Command::Simulate(arguments) => simulate::execute(&arguments, terminal),
        Command::Test(arguments) => test::execute(&arguments, terminal),
        Command::Compare(arguments) => compare::execute(&arguments, terminal),
        Command::View(arguments) => view::execute(&arguments, terminal),
        Command::Bode(arguments) => bode::execute(&arguments, terminal),
        Command::Diagnose(arguments) => diagnose::execute(&arguments, terminal),
        Command::Add(arguments) => add::execute_add(&arguments, terminal),
        Command::Remove(arguments) => add::execute_remove(&arguments, terminal),
        Command::Effects(arguments) => effects::execute(&arguments, terminal),
        Command::Tune(arguments) => tune::execute(&arguments, terminal),
        Command::Export(arguments) => export::execute(&arguments, terminal),
        Command::Report(arguments) => report::execute(&arguments, terminal),
        Command::Reproduce(arguments) => reproduce::execute(&arguments),
        Command::Completions(arguments) => shell::execute_completions(&arguments, terminal),
        Command::Man(arguments) => shell::execute_man(&arguments, terminal),
    }
}

/// The command of a program that these arguments begin with, and how it is called.
fn called(
    mut command: clap::Command,
    arguments: impl Iterator<Item = String>,
) -> (clap::Command, String) {
    let mut path = command.get_name().to_owned();
    for name in arguments {
        let Some(below) = command.find_subcommand(&name).cloned() else {
            break;
        };
        path = format!("{path} {name}");
        command = below;
    }
    (command, path)
}

/// The first example of the command on its help page, which may show other commands before it.
fn example(command: &clap::Command, path: &str) -> Option<String> {
    let text = command.get_after_help()?.to_string();
    let line = text.lines().map(str::trim).find(|line| line.starts_with(path))?;
    // A remark follows after two spaces.
    Some(line.split("  ").next().unwrap_or(line).to_owned())
}

/// clap's message as one headline and one help line, like every other error.
fn usage_failure(error: &clap::Error, program: clap::Command) -> Failure {
    let (command, path) = called(program, std::env::args().skip(1));
    let page = format!("see {path} --help");
    if error.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand {
        let below = command.get_subcommands().map(clap::Command::get_name);
        let below: Vec<&str> = below.filter(|name| *name != "help").collect();
        let headline = format!("{path}: no command is given (allowed: {})", below.join(", "));
        return Failure::usage(headline, page);
    }
    let text = error.render().to_string();
    let (mut headline, mut tip, mut usage) = (String::new(), None, None);
    for line in text.lines().map(str::trim).filter(|l| !l.is_empty()) {
        if let Some(found) = line.strip_prefix("tip: ") {
            // The tip on passing an option as a value is left out.
            tip = tip.or_else(|| found.contains("similar").then(|| suggestion(found)));
        } else if let Some(found) = line.strip_prefix("Usage: ") {
            usage = Some(found);
            break;
        } else if !line.starts_with("For more information") {
            // A headline that ends with a colon lists what is missing on the lines after it.
            let line = line.strip_prefix("error: ").unwrap_or(line);
            headline.push_str(if headline.is_empty() { "" } else { " " });
            headline.push_str(line);
        }
    }
    if let Some((head, allowed)) = headline.split_once(" [possible values: ") {
        headline = format!("{head} (allowed: {})", allowed.trim_end_matches(']'));
    }
    for (of_library, plain) in [
        ("invalid digit found in string", "expected a whole number from 0"),
        ("number too large to fit in target type", "it is too large"),
        ("invalid float literal", "expected a number"),
        ("cannot parse integer from empty string", "expected a whole number"),
        ("cannot parse float from empty string", "expected a number"),
        ("invalid socket address syntax", "expected ADDRESS:PORT, as 127.0.0.1:1502"),
    ] {
        headline = headline.replace(of_library, plain);
    }
    let unexpected = headline.strip_prefix("unexpected argument '");
    let is_option = unexpected.is_some_and(|argument| argument.starts_with('-'));
    let help = match (tip, usage) {
        (Some(tip), _) => tip,
        _ if is_option => page,
        (None, Some(usage)) if unexpected.is_some() && command.get_name() == "view" => {
            format!("give the hold-out run with --holdout RUN2; usage: {usage}")
        }
        (None, Some(usage)) if error.kind() == ErrorKind::MissingRequiredArgument => {
            let example = example(&command, &path).map(|text| format!("; for example `{text}`"));
            format!("usage: {usage}{}", example.unwrap_or_default())
        }
        (None, Some(usage)) if error.kind() != ErrorKind::InvalidSubcommand => {
            format!("usage: {usage}")
        }
        _ => page,
    };
    Failure::usage(headline, help)
}

/// clap's suggestion in the form of our other errors.
fn suggestion(tip: &str) -> String {
    let names: Vec<String> =
        tip.split('\'').skip(1).step_by(2).map(|name| format!("`{name}`")).collect();
    format!("did you mean {}?", names.join(" or "))
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[test]
    fn a_usage_error_names_the_help_page_of_its_own_command() {
        for (arguments, path) in [
            (&["probe", "--baud", "x"][..], "drivebench probe"),
            (&["registers", "write", "probe"], "drivebench registers write"),
            (&["--what"], "drivebench"),
        ] {
            let given = arguments.iter().map(|text| (*text).to_owned());
            assert_eq!(called(Arguments::command(), given).1, path, "{arguments:?}");
        }
    }

    #[test]
    fn every_command_that_needs_something_has_an_example() {
        let all = Arguments::command();
        for command in all.get_subcommands() {
            let needs = command.get_arguments().any(clap::Arg::is_required_set);
            let name = command.get_name();
            let shown = example(command, &format!("drivebench {name}"));
            assert!(!needs || shown.is_some(), "{name} has no example");
        }
    }
}

//! Effects stand in their catalogues alone: a new one is one file and one line in each, and the code that judges effects takes
//! what it needs from their cards.

use std::collections::BTreeSet;
use std::path::Path;

use drivebench::plant::effect::CATALOGUE;

use super::architecture::{is_test_file, root, rust_files};

/// Folders and files that may hold an id: the two catalogues, the machines of the study, and a torque map that is called
/// cogging as well.
const MAY_NAME_EFFECTS: [&str; 4] = [
    "src/core/plant/effect/",
    "src/core/plant/torque_map.rs",
    "src/emulator/",
    "src/workflow/reproduce/",
];

/// Catalogues, each with the constant that a file of an effect has for it.
const CATALOGUES: [(&str, &str); 2] = [
    ("src/core/plant/effect", "EFFECT"),
    ("src/emulator/truth/effect", "KIND"),
];

fn ids() -> BTreeSet<&'static str> {
    CATALOGUE.iter().map(|effect| effect.card().id).collect()
}

/// The texts in double quotes of a file, without those of comments and of its module of tests, with their lines.
fn literals(text: &str) -> Vec<(usize, String)> {
    let tests = text.find("#[cfg(test)]\nmod tests {");
    let text = &text[..tests.unwrap_or(text.len())];
    let mut found = Vec::new();
    let (mut line, mut rest) = (1, text.chars().peekable());
    while let Some(here) = rest.next() {
        match (here, rest.peek()) {
            ('\n', _) => line += 1,
            ('/', Some('/')) => while rest.next_if(|c| *c != '\n').is_some() {},
            ('\'', Some('"')) => {
                rest.next();
            }
            ('\'', Some('\\')) => {
                rest.next();
                rest.next();
            }
            ('"', _) => {
                let (begins, mut inside) = (line, String::new());
                while let Some(next) = rest.next().filter(|next| *next != '"') {
                    line += usize::from(next == '\n');
                    inside.push(next);
                    inside.extend((next == '\\').then(|| rest.next()).flatten());
                }
                found.push((begins, inside));
            }
            _ => {}
        }
    }
    found
}

/// Files and folders that only tests have, as their parents declare them.
fn only_for_tests(files: &[(String, String)]) -> Vec<String> {
    let modules = |(path, text): &(String, String)| {
        let path = Path::new(path);
        let folder = match path.file_stem().and_then(|stem| stem.to_str()) {
            Some("mod" | "lib") => path.with_file_name(""),
            _ => path.with_extension(""),
        };
        let declared = text.split("#[cfg(test)]\n").skip(1);
        let names = declared.filter_map(|rest| {
            let line = rest.lines().next()?.strip_suffix(';')?;
            line.split_once("mod ").map(|(_, name)| name)
        });
        let below = names.map(|name| folder.join(name).display().to_string());
        below.collect::<Vec<String>>()
    };
    files.iter().flat_map(modules).collect()
}

/// `cogging`, or a parameter as `cogging.order`.
fn is_of(literal: &str, ids: &BTreeSet<&str>) -> bool {
    let (first, _) = literal.split_once('.').unwrap_or((literal, ""));
    ids.contains(first)
}

#[test]
fn no_code_beside_the_catalogues_names_an_effect() {
    let (files, ids) = (rust_files(&["src"]), ids());
    let tests = only_for_tests(&files);
    assert!(tests.iter().any(|name| name == "src/bench/fault_trials"));
    let is_of_tests = |path: &str| {
        let mut folders = tests.iter();
        is_test_file(path)
            || folders.any(|own| {
                let rest = path.strip_prefix(own.as_str());
                rest.is_some_and(|rest| rest.starts_with(['/', '.']))
            })
    };
    let may = |path: &str| MAY_NAME_EFFECTS.iter().any(|own| path.starts_with(own));
    let checked = files
        .iter()
        .filter(|own| !may(&own.0) && !is_of_tests(&own.0));
    let found: Vec<String> = checked
        .flat_map(|(path, text)| {
            let named = literals(text).into_iter();
            let named = named.filter(|(_, literal)| is_of(literal, &ids));
            named.map(move |(line, literal)| format!("{path}:{line}: {literal:?}"))
        })
        .collect();
    let help = "put what is true of the effect into its card (src/core/plant/effect)";
    assert!(found.is_empty(), "{}\nhelp: {help}", found.join("\n"));
}

#[test]
fn the_check_of_ids_can_fail() {
    let ids = ids();
    for (text, named) in [
        ("let a = \"cogging\";", 1),
        ("let a = '\"';\nlet b = \"cogging.order\";", 1),
        ("// as \"cogging\"\nlet a = \"cogging torque\";", 0),
        ("let a = \"a \\\" cogging\";", 0),
        ("let a = 1;\n#[cfg(test)]\nmod tests {\n\"cogging\"", 0),
    ] {
        let all = literals(text).into_iter();
        let found = all.filter(|(_, literal)| is_of(literal, &ids));
        assert_eq!(found.count(), named, "{text}");
    }
}

#[test]
fn an_effect_is_one_file_and_one_line_in_each_catalogue() {
    let files = rust_files(&["src/core/plant/effect", "src/emulator/truth/effect"]);
    for (folder, constant) in CATALOGUES {
        let text_of = |name: &str| {
            let path = format!("{folder}/{name}.rs");
            let own = files.iter().find(|(own, _)| *own == path);
            &own.unwrap_or_else(|| panic!("{path} is missing below {:?}", root()))
                .1
        };
        let catalogue = text_of("mod");
        for id in ids() {
            let own = format!("id: \"{id}\"");
            assert_eq!(text_of(id).matches(&own).count(), 1, "{folder}/{id}.rs");
            let is_named = |word: &&str| *word == id;
            let words = |line: &str| {
                let words = line.split(|c: char| c != '_' && !c.is_alphanumeric());
                words.filter(is_named).count()
            };
            // The `mod` that the compiler asks for, and the line.
            let lines = catalogue.lines().filter(|line| words(line) > 0);
            let lines: Vec<&str> = lines.map(str::trim).collect();
            let [module, line] = lines[..] else {
                panic!("{folder}/mod.rs names {id} in {lines:?}");
            };
            assert!(module.ends_with(&format!("mod {id};")), "{module}");
            let line = line.trim_start_matches('&');
            assert_eq!(line, format!("{id}::{constant},"), "{folder}");
        }
    }
}

//! Effects stand in their catalogues alone: a new one is one file and one line in each, and the code that judges effects takes
//! what it needs from their cards.

use std::collections::BTreeSet;
use std::path::Path;

use drivebench::plant::effect::CATALOGUE;

use super::architecture::{is_test_file, root, rust_files};

/// Folders and files that may hold an id: the two catalogues, the machines of the study and of tests, and a torque map that is
/// called cogging as well.
const MAY_NAME_EFFECTS: [&str; 5] = [
    "crates/drivebench-model/src/plant/effect/",
    "crates/drivebench-model/src/plant/testing.rs",
    "crates/drivebench-model/src/plant/torque_map.rs",
    "crates/drivebench-emulator/src/",
    "crates/drivebench-studies/",
];

/// Catalogues, each with the constant that a file of an effect has for it.
const CATALOGUES: [(&str, &str); 2] = [
    ("crates/drivebench-model/src/plant/effect", "EFFECT"),
    ("crates/drivebench-emulator/src/truth/effect", "KIND"),
];

fn ids() -> BTreeSet<&'static str> {
    CATALOGUE.iter().map(|effect| effect.card().id).collect()
}

/// Lines of a file, but for comments and its module of tests, in which an id stands as text: `"cogging"`, or `"cogging.order"`.
fn lines_with_ids(text: &str) -> Vec<(usize, &str)> {
    let (code, _) = text.split_once("#[cfg(test)]\nmod tests {").unwrap_or((text, ""));
    let marks = ids().into_iter();
    let marks = marks.flat_map(|id| [format!("\"{id}\""), format!("\"{id}.")]);
    let marks: Vec<String> = marks.collect();
    let names = |line: &str| marks.iter().any(|mark| line.contains(mark));
    let lines = code.lines().map(str::trim).enumerate();
    let named = lines.filter(|(_, line)| !line.starts_with("//") && names(line));
    named.map(|(index, line)| (index + 1, line)).collect()
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

#[test]
fn no_code_beside_the_catalogues_names_an_effect() {
    let files = rust_files(&["src", "crates"]);
    let tests = only_for_tests(&files);
    assert!(tests.iter().any(|name| name == "crates/drivebench-bench/src/fault_trials"));
    let is_of_tests = |path: &str| {
        let below = |own: &String| path.strip_prefix(own.as_str());
        let mut below = tests.iter().filter_map(below);
        is_test_file(path) || below.any(|rest| rest.starts_with(['/', '.']))
    };
    let may = |path: &str| MAY_NAME_EFFECTS.iter().any(|own| path.starts_with(own));
    let checked = files.iter().filter(|own| !may(&own.0) && !is_of_tests(&own.0));
    let found: Vec<String> = checked
        .flat_map(|(path, text)| {
            let named = lines_with_ids(text).into_iter();
            named.map(move |(line, text)| format!("{path}:{line}: {text}"))
        })
        .collect();
    let help =
        "put what is true of the effect into its card (crates/drivebench-model/src/plant/effect)";
    assert!(found.is_empty(), "{}\nhelp: {help}", found.join("\n"));
    for (text, named) in [
        ("let a = \"cogging\";", 1),
        ("let b = \"cogging.order\";", 1),
        ("// as \"cogging\"\nlet a = \"cogging torque\";", 0),
        ("let a = 1;\n#[cfg(test)]\nmod tests {\n\"cogging\"", 0),
    ] {
        assert_eq!(lines_with_ids(text).len(), named, "{text}");
    }
}

#[test]
fn an_effect_is_one_file_and_one_line_in_each_catalogue() {
    let files = rust_files(&[
        "crates/drivebench-model/src/plant/effect",
        "crates/drivebench-emulator/src/truth/effect",
    ]);
    for (folder, constant) in CATALOGUES {
        let text_of = |name: &str| {
            let path = format!("{folder}/{name}.rs");
            let own = files.iter().find(|(own, _)| *own == path);
            &own.unwrap_or_else(|| panic!("{path} is missing below {:?}", root())).1
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

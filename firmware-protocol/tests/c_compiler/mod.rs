//! The system's C compiler, as the tests of the reference slave use it.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What must hold everywhere.
const STRICT: &[&str] = &[
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wpedantic",
    "-Wconversion",
    "-Wshadow",
    "-Wstrict-prototypes",
    "-Werror",
    "-O1",
    "-g",
];
/// What finds errors that no warning does; not every compiler has it.
const SANITIZED: &[&str] = &["-fsanitize=address,undefined", "-fno-sanitize-recover=all"];
const LIBRARY: &[&str] = &["drive_map.c", "drive_modbus.c", "drive_stream.c"];

/// The folder of the reference slave.
pub(crate) fn folder() -> PathBuf {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let inside = here.join("c");
    if inside.is_dir() { inside } else { here.join("firmware-protocol").join("c") }
}

/// Compiles the reference slave with a program of its folder into `out`.
#[track_caller]
pub(crate) fn build(program: &str, out: &Path) -> PathBuf {
    let compiler = std::env::var("CC").unwrap_or_else(|_| "cc".to_owned());
    let answers = Command::new(&compiler).arg("--version").output().is_ok();
    assert!(
        answers,
        "no C compiler {compiler:?}: the C reference slave is not tested (Rust links with one; install gcc or clang, or set CC)"
    );
    let sanitized = can_sanitize(&compiler, out);
    if !sanitized {
        aloud(&format!(
            "{compiler:?} has no address and undefined-behaviour sanitizer: the C reference slave is tested without"
        ));
    }
    let mut command = Command::new(&compiler);
    command.args(STRICT);
    if sanitized {
        command.args(SANITIZED);
    }
    let binary = out.join("program");
    let sources = LIBRARY.iter().copied().chain([program]);
    command
        .arg(format!("-I{}", folder().join("../include").display()))
        .args(sources.map(|name| folder().join(name)))
        .arg("-o")
        .arg(&binary);
    let output = command.output().expect("the compiler can be started");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}\n{said}");
    binary
}

/// Whether a program with sanitizers can be built and run.
fn can_sanitize(compiler: &str, out: &Path) -> bool {
    let (source, binary) = (out.join("probe.c"), out.join("probe"));
    std::fs::write(&source, "int main(void) { return 0; }\n").expect("the folder can be written");
    let built = Command::new(compiler).args(SANITIZED).arg(&source).arg("-o").arg(&binary).output();
    let built = built.is_ok_and(|output| output.status.success());
    built && Command::new(&binary).status().is_ok_and(|s| s.success())
}

/// Past the test harness, which keeps what `eprintln!` says to itself.
fn aloud(text: &str) {
    writeln!(std::io::stderr(), "{text}").expect("stderr is there");
}

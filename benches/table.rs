//! `docs/benchmarks.md` from the figures of the other benchmarks: `cargo bench` runs them all, this one last.
//!
//! ```text
//! target/criterion/GROUP/NAME/new/sample.json (iterations, times) -> least, median, spread -> one line of the table
//! ```

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use drivebench::plant::effect::CATALOGUE;
use serde_json::Value;

/// One line of the table.
struct Figure {
    id: String,
    what: String,
    target_ns: Option<f64>,
}

/// Id, target in nanoseconds (or `-`), what is measured.
const FIGURES: &str = "\
rls/guarded_4 | 40 | recursive least squares, guarded form, 4 parameters, one update
rls/guarded_2 | 20 | the same, 2 parameters
rls/plain_4 | - | plain reference form, 4 parameters, one update
rls/plain_2 | - | the same, 2 parameters
online/push | - | on-line identification (schemes 2 and 3), one sample
fit/output_error | - | output-error fit of five parameters, 12 s at 1 kHz
control/pi | 200 | speed controller, one cycle: PI
control/pi_with_feed_forward | 1000 | the same with feed-forward
control/addc | 200 | ADDC, with its identification
control/mrac | 1000 | MRAC
control/paper_b | 1000 | paper B
control/load_observer | 1000 | Kalman filter with load torque, feedback and integral
recording/row_out | 1000 | a row of twelve columns for `samples.csv`, as a run writes it
recording/run_out | 1000 | a row of a run of eight columns, written as a whole file
recording/run_in | 500 | a row of twelve columns of a `samples.csv`, read
recording/replay | 1000 | the same, read and through the on-line estimators (schemes 2 and 3); asserted: the memory does not grow
session/addc | 5000 | whole cycle of a session: guard, on-line identification, ADDC, record, snapshot
diagnose/nothing_missing | 500e6 | `diagnose` with a second run of 12 s, nothing missing
diagnose/stribeck_missing | 500e6 | the same, one effect missing
report/read_and_write | 2e9 | page of a run of a million rows with nine signals, read from its folder; asserted: below 8 MB
report/write | - | the same, the run in memory
screen/frame_80x24 | 1666e3 | a frame of the screen of a run, 80x24; 30 a second are 5 % of a core
screen/frame_200x50 | 1666e3 | the same, 200x50
free_run/baseline | 0.5e6 | free run of the baseline, 12 s at 1 kHz
free_run/baseline_stamped_commands | - | the same, every command applied at an instant of its own";

/// The heading of the comparison with other programs.
const BESIDE: &str = "## Beside others\n\n\
`.ci/performance/run.sh` measures all of this page and does the same work with others, in turn, in one run: the ratio of a\n\
round is taken before the median, so that a machine that becomes slower makes both slower.\n\n";

/// Effects with a second mass take four states.
const TWO_MASS: [&str; 2] = ["elastic_coupling", "backlash"];

fn figures() -> Vec<Figure> {
    let figure = |line: String| {
        let mut cells = line.split(" | ").map(str::to_owned);
        let mut cell = || cells.next().unwrap_or_default();
        let (id, target) = (cell(), cell());
        Figure { id, target_ns: target.parse().ok(), what: cell() }
    };
    let of_effect = CATALOGUE.iter().map(|effect| {
        let id = effect.card().id;
        let target = if TWO_MASS.contains(&id) { "4e6" } else { "2e6" };
        format!("free_run/{id} | {target} | free run with `{id}`")
    });
    FIGURES.lines().map(str::to_owned).chain(of_effect).map(figure).collect()
}

/// Nanoseconds for one element.
struct Measured {
    least: f64,
    median: f64,
    upper: f64,
}

/// Times of the latest measurement; `None` where it was not run.
fn measured(folder: &Path) -> Option<Measured> {
    let read = |name: &str| -> Option<Value> {
        serde_json::from_str(&fs::read_to_string(folder.join(name)).ok()?).ok()
    };
    let sample = read("sample.json")?;
    let numbers = |key: &str| -> Option<Vec<f64>> {
        sample[key].as_array()?.iter().map(Value::as_f64).collect()
    };
    let elements = read("benchmark.json")?["throughput"]["Elements"].as_f64().unwrap_or(1.0);
    let (iterations, times) = (numbers("iters")?, numbers("times")?);
    let both = times.iter().zip(&iterations);
    let mut each: Vec<f64> = both.map(|(time, count)| time / count / elements).collect();
    each.sort_by(f64::total_cmp);
    let quantile = |share: f64| {
        let last = each.len().checked_sub(1)?;
        let at = drivebench::numerics::count::whole((share * last as f64).round());
        each.get(at).copied()
    };
    Some(Measured { least: quantile(0.0)?, median: quantile(0.5)?, upper: quantile(0.95)? })
}

fn text(ns: f64) -> String {
    match ns {
        ns if ns < 1e3 => format!("{ns:.1} ns"),
        ns if ns < 1e6 => format!("{:.1} us", ns * 1e-3),
        ns => format!("{:.2} ms", ns * 1e-6),
    }
}

fn machine() -> String {
    let model = fs::read_to_string("/proc/cpuinfo").ok().and_then(|text| {
        let line = text.lines().find(|line| line.starts_with("model name"))?;
        Some(line.split(':').nth(1)?.trim().to_owned())
    });
    let cores = std::thread::available_parallelism().map_or(0, std::num::NonZero::get);
    format!(
        "{}, {cores} cores, {}-{}",
        model.unwrap_or_else(|| "unknown processor".to_owned()),
        std::env::consts::ARCH,
        std::env::consts::OS
    )
}

/// The page; a line of `before`, the present page, is kept where the same machine has no new figure.
fn table(measurements: &Path, before: &str) -> String {
    let mut out = format!(
        "# Benchmarks\n\n\
         `cargo bench` measures these figures and writes this page; `cargo bench --bench table` writes it again from the\n\
         latest measurements and keeps the others. Single figures: `cargo bench --bench hot_paths -- rls`.\n\n\
         Machine: {}. It is shared: the least time is nearest to the cost of the code; the median and\n\
         the 95 % quantile show the load by other work. For scale: one update with 4 and with 2 parameters took the computer\n\
         of paper A 8 and 3 ms.\n\n\
         | what | target | least | median | 95 % below | |\n|---|---|---|---|---|---|\n",
        machine()
    );
    let is_same = before.contains(&format!("Machine: {}. ", machine()));
    for figure in figures() {
        let limit =
            figure.target_ns.map_or_else(|| "-".to_owned(), |ns| format!("<= {}", text(ns)));
        let line = match measured(&measurements.join(&figure.id).join("new")) {
            None => {
                let begin = format!("| {} | {limit} |", figure.what);
                let kept = before.lines().filter(|_| is_same).find(|line| line.starts_with(&begin));
                kept.map_or_else(|| begin.clone() + " not measured | | | |", str::to_owned)
            }
            Some(found) => {
                let verdict = match figure.target_ns {
                    None => "",
                    Some(ns) if found.median <= ns => "reached",
                    Some(ns) if found.least <= ns => "reached by the least",
                    Some(_) => "missed",
                };
                format!(
                    "| {} | {limit} | {} | {} | {} | {verdict} |",
                    figure.what,
                    text(found.least),
                    text(found.median),
                    text(found.upper)
                )
            }
        };
        let _ = writeln!(out, "{line}");
    }
    let _ = write!(out, "\n{BESIDE}");
    let peers = fs::read_to_string(measurements.join("peers.txt")).ok();
    let kept = before.split_once(BESIDE).filter(|_| is_same);
    out.push_str(
        peers
            .as_deref()
            .or(kept.map(|(_, kept)| kept))
            .unwrap_or("Not measured on this machine.\n"),
    );
    out
}

fn main() {
    // `cargo test --benches` starts every benchmark as well: a test must not change a page of the documentation.
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let target =
        std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    let page = root.join("docs/benchmarks.md");
    let before = fs::read_to_string(&page).unwrap_or_default();
    match fs::write(&page, table(&target.join("criterion"), &before)) {
        Ok(()) => eprintln!("written: {}", page.display()),
        Err(error) => {
            eprintln!("{}: cannot write: {error}", page.display());
            std::process::exit(1);
        }
    }
}

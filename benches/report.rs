//! The page of a run of a million rows: read from its folder, and written.

use criterion::{Criterion, criterion_group, criterion_main};
use drivebench::recording::{Manifest, ReadOptions, RunFolder, open_run, write_run};
use drivebench::report::{Context, RunReport};
use drivebench::sample::{Channel, Origin, Run};

const ROWS: usize = 1_000_000;

/// A thousand seconds at 1 kHz: every signal moves, and every thousandth value is missing.
fn long_run() -> Run {
    let time_s = (0..ROWS).map(|k| 0.001 * k as f64 + 17.0).collect();
    let mut run = Run::new("long", time_s).expect("rising times");
    for (place, channel) in Channel::ALL.into_iter().take(9).enumerate() {
        let value = |k: usize| match k % 1000 {
            0 => f64::NAN,
            rest => (1e-3 * k as f64 * (1.0 + place as f64)).sin() + 1e-4 * rest as f64,
        };
        let origin = if channel.is_commanded() { Origin::Commanded } else { Origin::Measured };
        let values = (0..ROWS).map(value).collect();
        run.set_column(channel, values, origin).expect("one value to a row");
    }
    run
}

fn page(run: &Run) -> String {
    let report = RunReport {
        title: "a long run",
        context: &Context::default(),
        run,
        nameplate: None,
        parameters: &[],
        timing: &Vec::new(),
        early_end: None,
        last_seconds: None,
        speed_loop: None,
    };
    let html = report.document().html();
    assert!(html.len() < 8_000_000, "{} bytes", html.len());
    html
}

fn report(criterion: &mut Criterion) {
    let run = long_run();
    let root = tempfile::tempdir().expect("a temporary folder");
    let folder = RunFolder::create(root.path(), "20260131T120000Z", "long").expect("a new folder");
    let manifest = Manifest { rows: Some(ROWS), finished: true, ..Manifest::default() };
    folder.write_manifest(&manifest).expect("written");
    std::fs::write(folder.samples(), write_run(&run)).expect("written");
    eprintln!("page of {ROWS} rows: {} bytes", page(&run).len());

    let mut group = criterion.benchmark_group("report");
    group.bench_function("write", |bencher| bencher.iter(|| page(&run)));
    group.bench_function("read_and_write", |bencher| {
        bencher.iter(|| page(&open_run(folder.path(), ReadOptions::default()).expect("a run").run));
    });
    group.finish();
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10).configure_from_args();
    targets = report
}
criterion_main!(benches);

//! Time of one exchange over a line with the speed of a real one, through a pseudo-terminal: the baud rate is
//! the bound, and the excess is that of host, kernel and emulator.
//!
//! ```text
//! emulator (own thread, its characters, silences and 0.5 ms turnaround) <- pseudo-terminal <- link <- exchange after exchange
//! ```

use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use drivebench::drive::{DriveLink, DriveProfile, LineBudget, Protocol, Target, open};
use drivebench::emulator::{EmulatorConfig, Endpoint, ServerHandle, spawn};
use drivebench::sample::{Command, Demand};

const REPLY_MS: f64 = 0.5;

/// A link to an emulator of its own; the emulator ends with the handle.
#[expect(clippy::disallowed_methods, reason = "a real link runs in real time")]
fn connected(protocol: Protocol, baud: u32) -> (ServerHandle, Box<dyn DriveLink>, LineBudget) {
    let mut config = EmulatorConfig::embedded("zk-22fc-plain").expect("it is built in");
    config.line.baud = baud;
    config.line.turnaround_ms = REPLY_MS;
    let name = match protocol {
        Protocol::Stream => "own-stream",
        _ => "own",
    };
    let server = spawn(config, 1, protocol, Endpoint::temporary_pty()).expect("a pseudo-terminal");
    let mut profile = DriveProfile::named(name).expect("it is built in");
    profile.link.baud = baud;
    profile.link.reply_ms = REPLY_MS;
    let budget = LineBudget::of(&profile).expect("a serial line");
    let target: Target = server.address().parse().expect("a path");
    let mut link = open(&target, &profile, Instant::now()).expect("the emulator listens");
    link.identify().expect("the emulator answers");
    (server, link, budget)
}

fn exchanges(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("line");
    group
        .sample_size(50)
        .warm_up_time(Duration::from_secs(1))
        .measurement_time(Duration::from_secs(8));
    for (name, protocol, baud) in [
        ("rtu_115200", Protocol::ModbusRtu, 115_200),
        ("stream_921600", Protocol::Stream, 921_600),
        ("stream_115200", Protocol::Stream, 115_200),
    ] {
        let (_server, mut link, budget) = connected(protocol, baud);
        eprintln!("{name}: the line carries {:.1} exchanges a second", budget.rate_hz());
        let mut seq = 0;
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                seq += 1;
                let demand = Demand::Disable;
                link.exchange(Command { seq, demand })
            });
        });
        let counts = link.statistics();
        assert!(
            counts.lost() * 100 <= counts.sent,
            "{name}: {counts:?}: the figures are of another line"
        );
    }
    group.finish();
}

criterion_group!(benches, exchanges);
criterion_main!(benches);

//! The manifest of a run as it stands before the run begins.

use serde_json::json;

use super::bench_file::BenchFile;
use super::check::CheckReport;
use crate::recording::{Layout, Manifest};
use drivebench_link::LinkName;
use drivebench_model::sample::{Channel, Origin};

/// Columns of `samples.csv`: these commands, and the signals that the drive gives.
pub fn layout(commands: &[Channel], signals: &[Channel]) -> Layout {
    let measured = signals.iter().filter(|channel| !channel.is_commanded());
    let channels: Vec<Channel> = commands.iter().chain(measured).copied().collect();
    Layout::of_drive(&channels)
}

/// A manifest with the bench as used, the identity of the drive and the origin of each signal. The drive profile marks a
/// quantity that the drive computes instead of measuring (`Manifest::set_origin`).
pub fn manifest(
    bench: &BenchFile,
    run_seed: u64,
    link: &LinkName,
    report: &CheckReport,
) -> Manifest {
    let mut manifest = Manifest {
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        protocol_version: Some(report.identity.protocol_version),
        name: bench.name.clone(),
        seed: Some(run_seed),
        link: link.0.clone(),
        identity: json!(report.identity),
        host: json!({ "os": std::env::consts::OS, "architecture": std::env::consts::ARCH }),
        period_asked_s: Some(bench.period_s()),
        ..Manifest::default()
    };
    manifest.configs.insert("bench".to_owned(), bench.to_toml());
    for channel in report.signals.iter().filter(|channel| !channel.is_commanded()) {
        manifest.set_origin(*channel, Origin::Measured);
    }
    manifest.waivers = report.waived.iter().map(|&name| name.to_owned()).collect();
    manifest
}

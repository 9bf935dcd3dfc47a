//! The text of a new bench file: every value with its reason, in the order of the commented example.

use std::fmt::Write as _;

use super::{InitRequest, InitUse, Reasoned};
use crate::bench_file::{BenchFile, Port};
use crate::currents::CurrentsSection;
use crate::plan::Plan;
use drivebench_link::KickedBy;
use drivebench_model::excitation::Segment;
use drivebench_model::plant::MotorKey;
use drivebench_model::text::lines::{capitalised, wrapped};

/// Longest line, characters.
const WIDTH: usize = 118;

#[derive(Default)]
struct Page(String);

impl Page {
    fn comment(&mut self, text: &str) {
        for row in wrapped(text, WIDTH - 2) {
            self.line(&format!("# {row}"));
        }
    }

    fn line(&mut self, text: &str) {
        let _ = writeln!(self.0, "{text}");
    }

    /// A header after a blank line, under a comment; an empty one is none.
    fn section(&mut self, header: &str, comment: &str) {
        self.line("");
        if !comment.is_empty() {
            self.comment(comment);
        }
        self.line(header);
    }

    /// A value with its reason after it, or above it where the line would be too long.
    fn value(&mut self, key: &str, value: &str, reason: &str) {
        let one_line = format!("{key} = {value}  # {reason}");
        if one_line.len() <= WIDTH {
            self.line(&one_line);
        } else {
            self.comment(reason);
            self.line(&format!("{key} = {value}"));
        }
    }

    fn left_out(&mut self, key: &str, reason: &str) {
        self.comment(&format!("{key}: none. {}", capitalised(reason)));
    }
}

pub(super) fn text(
    request: &InitRequest<'_>,
    bench: &BenchFile,
    purpose: InitUse,
    reasons: &[Reasoned],
    remarks: &[String],
    plan: Option<&Plan>,
) -> String {
    let mut page = Page::default();
    page.comment(&format!(
        "Bench of {} on {}, made by `drivebench init` from the drive profile {:?} and the nameplate {}. Every value has its reason; bench-configs/benches/zk-22fc-emulated.toml explains every key.",
        bench.motor.name, request.profile.name, request.drive, request.motor_file
    ));
    for remark in remarks {
        page.comment(&format!("- {remark}"));
    }
    page.line(&format!("name = {:?}", bench.name));
    drive(&mut page, request, bench);
    link(&mut page, request, bench, reasons);
    motor(&mut page, request, bench);
    let comment = "Crossing one ends the run at zero output; nothing starts again by itself.";
    page.section("[limits]", comment);
    for (key, unit, _) in bench.limits.clone().rows() {
        let whole = format!("limits.{key}");
        let Some(found) = reason_of(reasons, &whole) else {
            continue;
        };
        match found.value {
            Some(value) => page.value(key, &number(value), &format!("{unit}: {}", found.reason)),
            None => page.left_out(key, &found.reason),
        }
    }
    speed(&mut page, bench, reasons);
    sequence(&mut page, bench, purpose, plan);
    if let Some(currents) = &bench.currents {
        let reason = reason_of(reasons, "currents").map_or("", |reason| &reason.reason);
        currents_section(&mut page, currents, reason);
    }
    page.0
}

fn reason_of<'a>(reasons: &'a [Reasoned], key: &str) -> Option<&'a Reasoned> {
    reasons.iter().find(|reason| reason.key == key)
}

fn drive(page: &mut Page, request: &InitRequest<'_>, bench: &BenchFile) {
    let profile = request.profile;
    page.section("[drive]", "");
    page.comment(&profile.provenance());
    let readback = &request.readback;
    if readback.is_offline {
        page.comment("The drive was not read (--offline): none of its own limits is known here.");
    } else {
        page.comment(&format!("Read back, nothing written: {}", readback.who));
    }
    let kick = match profile.watchdog.kicked_by {
        KickedBy::Command => "only commands count",
        KickedBy::Write => "any write counts",
        KickedBy::Any => "any message counts, reading too",
    };
    let map = profile.registers.as_deref();
    let set_s = map.and_then(|map| map.watchdog.set_s());
    let time = match (set_s, readback.watchdog_s, profile.watchdog.default_ms) {
        (Some(set_s), ..) => format!("{set_s} s (set at connect by the profile)"),
        (_, Some(time_s), _) if time_s > 0.0 => format!("{time_s} s (read back)"),
        (_, Some(_), _) => "off (read back)".to_owned(),
        (_, None, Some(default_ms)) => format!("{default_ms} ms as delivered, not read back"),
        (_, None, None) => "not known".to_owned(),
    };
    page.comment(&format!(
        "Its watchdog: {time}; {kick}. It is proven at zero output before anything moves, or needs --waive-watchdog."
    ));
    page.line(&format!("profile = {:?}", bench.drive.profile));
}

fn link(page: &mut Page, request: &InitRequest<'_>, bench: &BenchFile, reasons: &[Reasoned]) {
    page.section("[link]", "");
    let reason = match (bench.port(), request.port_reason) {
        (_, reason) if !reason.is_empty() => reason,
        (Port::Emulator, _) => "the software drive behind a pseudo-terminal, in real time",
        (Port::Sim, _) => "the software drive in memory, in virtual time",
        (Port::SimRtu, _) => "the software drive on a line in memory, in virtual time",
        (Port::Tcp(_) | Port::Serial(_), _) => "as given with --port",
    };
    page.value("port", &format!("{:?}", bench.link.port), reason);
    let protocol = format!("\"{}\"", bench.link.protocol);
    let why = "the profile's protocol for this kind of port";
    page.value("protocol", &protocol, why);
    let why = "bit/s; the profile's, unless --baud was given";
    page.value("baud", &bench.baud().to_string(), why);
    let why = "the profile's, unless --unit was given";
    page.value("unit", &bench.link.unit.to_string(), why);
    if let Some(rate) = reason_of(reasons, "link.rate_hz") {
        page.value("rate_hz", &number(bench.link.rate_hz), &format!("Hz: {}", rate.reason));
    }
    page.left_out(
        "deadline_ms",
        "the profile's, else wire time with silences, twice its reply_ms and 40 ms",
    );
}

fn motor(page: &mut Page, request: &InitRequest<'_>, bench: &BenchFile) {
    let motor = &bench.motor;
    let file = request.motor_file;
    page.section("[motor]", &format!("The nameplate, taken over from {file}."));
    page.line(&format!("name = {:?}", motor.name));
    if motor.unknown {
        page.value(
            "unknown",
            "true",
            "only the rated values are used: `run` finds the motor from small steps first",
        );
    }
    let (given, values) = (request.motor.values(), motor.values());
    for (key, meaning) in [
        ("rated_voltage_v", "V"),
        ("rated_current_a", "A"),
        ("rated_speed_rad_s", "rad/s"),
        ("resistance_ohm", "ohm, armature loop"),
        ("inductance_h", "H"),
        ("back_emf_v_s_per_rad", "V.s/rad; also the torque constant in N.m/A"),
        ("inertia_kg_m2", "kg.m2, load included"),
        ("load_torque_n_m", "N.m, Coulomb, always against the motion"),
    ] {
        let is_given = given.iter().any(|(known, _)| *known == key);
        match values.iter().find(|(known, _)| *known == key) {
            Some((_, value)) if !is_given => {
                let unit = meaning.split([',', ';']).next().unwrap_or_default();
                let meaning = format!("{unit}; as the drive states it, between two lines");
                page.value(key, &number(*value), &meaning);
            }
            Some((_, value)) => page.value(key, &number(*value), meaning),
            None => {
                let is_held = bench.currents.is_some() && key == MotorKey::Inductance.key();
                page.left_out(
                    key,
                    if is_held {
                        "not on the nameplate: no run shows it, because the drive controls the current"
                    } else {
                        "not on the nameplate: `run` finds it from small steps first"
                    },
                );
            }
        }
    }
}

fn speed(page: &mut Page, bench: &BenchFile, reasons: &[Reasoned]) {
    let Some(speed) = &bench.speed else {
        return;
    };
    page.section("[speed]", "What `drivebench speed` does, under the same limits.");
    let why = if speed.controller.id() == "pi" {
        "fixed gains: the parameters that others adapt to are not observable through the drive's own loop"
    } else {
        "gains follow the inertia that is identified on line"
    };
    page.value("controller", &format!("\"{}\"", speed.controller.id()), why);
    if let Some(lag_s) = speed.drive_lag_s {
        page.value(
            "drive_lag_s",
            &number(lag_s),
            "s in which the drive's own loop follows its reference. Not measured: a cautious guess, replace it by your measurement",
        );
    }
    let reason = reason_of(reasons, "speed.reference");
    let comment = reason.map(|reason| format!("Speeds in rad/s: {}.", reason.reason));
    for part in &speed.reference {
        page.section("[[speed.reference]]", comment.as_deref().unwrap_or_default());
        page.line(&inline(part));
    }
}

fn sequence(page: &mut Page, bench: &BenchFile, purpose: InitUse, plan: Option<&Plan>) {
    page.line("");
    if purpose == InitUse::SpeedLoop {
        page.comment("This drive takes no voltage: `run` and `commission` are refused on it, and only `speed` moves the motor.");
    }
    if let Some(plan) = plan {
        page.comment(&format!(
            "The excitation. `plan` predicts {:.1} s, at most {:.1} V, {:.1} A ({:.1} times rated), {:.0} rad/s.",
            plan.duration_s,
            plan.peak_voltage_v,
            plan.peak_current_a,
            plan.peak_current_ratio,
            plan.peak_speed_rad_s
        ));
    } else if purpose != InitUse::SpeedLoop {
        page.comment("The excitation, made to fit the motor once it has been found.");
    }
    for segment in &bench.sequence {
        let comment = match segment {
            Segment::Standstill(_) => "Noise floor and sensor offsets.",
            Segment::Steps(_) => {
                "Resistance, back-EMF and inertia; both signs separate friction from an offset."
            }
            Segment::Ramp(_) => "Slowly through zero: friction near standstill.",
            Segment::Prbs(_) => "Many levels: dynamics over a wide band.",
            Segment::Sine(_) => "Slowly through zero again, in both directions.",
            Segment::Chirp(_) => "Every frequency once: resonances.",
            Segment::Staircase(_) => "Level by level.",
            Segment::CoastDown(_) => "Output off.",
        };
        page.section("[[sequence]]", comment);
        page.line(&inline(segment));
    }
}

fn currents_section(page: &mut Page, currents: &CurrentsSection, reason: &str) {
    page.section("[currents]", &format!("{}.", capitalised(reason)));
    for (key, value, meaning) in [
        ("levels_a", format!("{:?}", currents.levels_a), "A, either sign"),
        ("turn_rad_s", format!("{:?}", currents.turn_rad_s), "rad/s at which the current reverses"),
        ("rest_s", number(currents.rest_s), "s at zero current at both ends: noise at rest"),
        ("seconds", number(currents.seconds), "s, without the rest"),
        ("longest_s", number(currents.longest_s), "s after which it reverses in any case"),
        ("coast_s", number(currents.coast_s), "s at zero current before every other reversal"),
        ("seed", currents.seed.to_string(), "of the order of levels and speeds"),
    ] {
        page.value(key, &value, meaning);
    }
}

/// The one key of a part with its table on one line.
fn inline<T: serde::Serialize>(part: &T) -> String {
    let value = toml::Value::try_from(part).ok();
    let entries = value.as_ref().and_then(toml::Value::as_table).into_iter().flatten();
    entries.map(|(key, value)| format!("{key} = {value}")).collect::<Vec<_>>().join("\n")
}

/// A number as a TOML float.
fn number(value: f64) -> String {
    format!("{value:?}")
}

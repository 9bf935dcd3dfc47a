//! `plan`: forecast of a sequence before anything is energised: the plan of the motor and that of the line.

use std::fmt::Write as _;
use std::path::PathBuf;

use serde::Serialize;

use crate::runtime::{Failure, Terminal, failed_plan, lines, read_text, wired_profile};
use drivebench_bench::{
    BenchFile, CurrentsSection, EMBEDDED_DEFAULT, EMBEDDED_NAME, EscalationPlan, Plan, PlanError,
    Port, Reference, plan_escalation, plan_run,
};
use drivebench_link::{DriveProfile, LineBudget, LostReply, offer};

/// Predict peak current, speed, travel, heat and duration of a bench file's sequence
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  drivebench plan bench-configs/benches/zk-22fc-emulated.toml\n\n\
A motor that is not known (motor.unknown = true, or values left out) is found from small steps first: then the plan shows the\n\
first of them and what follows; with [currents], the currents that rise. Where only load_torque_n_m is left out,\n\
the sequence is predicted without friction."
)]
pub(super) struct Arguments {
    /// Bench file; without it the embedded one
    bench: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: &Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let (file, source) = match &arguments.bench {
        Some(path) => (path.display().to_string(), read_text(path)?),
        None => (EMBEDDED_NAME.to_owned(), EMBEDDED_DEFAULT.to_owned()),
    };
    let found = forecast(&file, &source)?;
    terminal.result(&found, arguments.json, Forecast::text)?;
    let refusal = match &found {
        Forecast::Known(known) => known.plan.refusals.first(),
        Forecast::Unknown(_) => None,
    };
    refusal.map_or(Ok(()), |refusal| {
        Err(Failure::usage(format!("plan refused: {refusal}"), refusal.help()))
    })
}

fn unknown_text(unknown: &Unknown) -> String {
    if let Some(search) = &unknown.search {
        return format!(
            "the motor is not known: before the sequence it is found by currents that rise, {:?} A, and reverse at {:?} rad/s, for {:.0} s; \
             the sequence is then fitted to it\n",
            search.levels_a,
            search.turn_rad_s,
            search.duration_s()
        );
    }
    let mut text = "the motor is not known: before the sequence it is found from small steps, each as large as the one before allows\n".to_owned();
    if let Some(steps) = &unknown.escalation {
        let first = &steps.first;
        let _ = writeln!(
            text,
            "\nfirst stage ({}): up to {:.3} V, {:.1} V/s, {:.1} s; ends with {:.2} A or {:.2} rad/s",
            first.kind.name(),
            first.peak_v,
            first.slew_v_per_s,
            steps.duration_s,
            first.stop_current_a,
            first.stop_speed_rad_s
        );
        lines(&mut text, "then ", &steps.next);
        let _ = writeln!(
            text,
            "in every stage a run ends beyond {:.1} A, {:.0} rad/s, {:.0} V, or after {:.2} s without a reply. What the sequence does \
             is planned for the motor that was found, and made smaller where that is needed",
            steps.current_limit_a,
            steps.speed_limit_rad_s,
            steps.voltage_limit_v,
            steps.link_silence_s
        );
    }
    text
}

/// Text for a drive that takes no voltage command.
fn reference_text(reference: &ReferencePlan) -> String {
    format!(
        "this drive takes no voltage: only the reference of [speed] moves the motor, with `drivebench speed`: {:.1} s, up to {:.0} rad/s either way; \
         the limits are {:.0} rad/s, {:.1} A and {:.0} s. The current of the drive's own loop is not predicted\n",
        reference.duration_s,
        reference.peak_speed_rad_s,
        reference.speed_limit_rad_s,
        reference.current_limit_a,
        reference.time_limit_s
    )
}

fn sequence_text(plan: &Plan) -> String {
    let mut text = format!(
        "{:.1} s, {} rows, peak {:.1} A ({:.1} times rated), {:.0} rad/s, {:.0} V, copper loss {:.0} J\n\n",
        plan.duration_s,
        plan.rows,
        plan.peak_current_a,
        plan.peak_current_ratio,
        plan.peak_speed_rad_s,
        plan.peak_voltage_v,
        plan.copper_loss_j
    );
    let _ = writeln!(
        text,
        "{:<14} {:>7} {:>7} {:>8} {:>8} {:>9}",
        "segment", "from s", "to s", "peak V", "peak A", "rad/s"
    );
    for segment in &plan.segments {
        let _ = writeln!(
            text,
            "{:<14} {:>7.2} {:>7.2} {:>8.1} {:>8.1} {:>9.1}",
            segment.name,
            segment.start_s,
            segment.end_s,
            segment.peak_voltage_v,
            segment.peak_current_a,
            segment.peak_speed_rad_s
        );
    }
    let _ = writeln!(text);
    for parameter in &plan.parameters {
        let prospect = format!("{:?}", parameter.prospect).to_lowercase();
        let (key, reason) = (&parameter.key, &parameter.reason);
        let _ = writeln!(text, "{key:<24} {prospect:<14} {reason}");
    }
    text
}

/// The arithmetic of the line, a rate for each kind of adapter.
fn line_text(line: &LineBudget) -> String {
    let mut text = format!(
        "{} at {} baud: {} + {} bytes in {} request{} take {:.2} ms, silences {:.2} ms, the drive up to {:.2} ms\n",
        line.protocol.name(),
        line.baud,
        line.request_bytes,
        line.reply_bytes,
        line.exchanges,
        if line.exchanges == 1 { "" } else { "s" },
        line.wire_ms,
        line.gaps_ms,
        line.reply_ms
    );
    for rate in &line.rates {
        let _ = writeln!(text, "  {:<34} {:>6.0} Hz", rate.adapter, rate.rate_hz);
    }
    lines(&mut text, "", line.reply_text());
    text
}

#[derive(Serialize)]
#[serde(untagged)]
enum Forecast {
    /// The plan of the motor and that of the line.
    Known(Box<Known>),
    /// What is settled for a motor that is not known.
    Unknown(Box<Unknown>),
}

impl Forecast {
    fn text(&self) -> String {
        let (mut text, line, warnings) = match self {
            Self::Known(known) => {
                let reference = known.reference.as_ref().map(reference_text);
                let text = reference.unwrap_or_else(|| sequence_text(&known.plan));
                (text, &known.line, &known.plan.warnings)
            }
            Self::Unknown(unknown) => (unknown_text(unknown), &unknown.line, &unknown.warnings),
        };
        lines(&mut text, "\n", line.as_ref().map(line_text));
        lines(&mut text, "warning: ", warnings);
        text
    }
}

#[derive(Serialize)]
struct Known {
    #[serde(flatten)]
    plan: Plan,
    /// Of a drive that takes no voltage: the plan of the sequence then moves nothing. `null`: the sequence is what moves.
    reference: Option<ReferencePlan>,
    /// `null` where no serial line is involved.
    line: Option<LineBudget>,
}

#[derive(Serialize)]
struct Unknown {
    escalation: Option<EscalationPlan>,
    /// In its place for a drive that is commanded by current.
    #[serde(skip_serializing_if = "Option::is_none")]
    search: Option<CurrentsSection>,
    line: Option<LineBudget>,
    warnings: Vec<String>,
}

/// The reference of a speed run, and its limits.
#[derive(Serialize)]
struct ReferencePlan {
    duration_s: f64,
    peak_speed_rad_s: f64,
    speed_limit_rad_s: f64,
    current_limit_a: f64,
    time_limit_s: f64,
}

impl ReferencePlan {
    fn of(reference: &Reference, bench: &BenchFile) -> Self {
        let limits = bench.limits();
        Self {
            duration_s: reference.duration_s(),
            peak_speed_rad_s: reference.peak_rad_s(),
            speed_limit_rad_s: limits.speed_rad_s,
            current_limit_a: limits.current_a,
            time_limit_s: limits.time_s,
        }
    }
}

/// Predicts the sequence of the bench file `file` with the text `source`.
fn forecast(file: &str, source: &str) -> Result<Forecast, Failure> {
    let mut bench = BenchFile::parse(file, source)?;
    let (profile, _) = wired_profile(&mut bench)?;
    let line = match bench.port() {
        Port::Tcp(_) => None,
        Port::Emulator | Port::Sim | Port::SimRtu | Port::Serial(_) => LineBudget::of(&profile),
    };
    let requested_hz = bench.link.rate_hz;
    let rate_hz = requested_hz.min(line.as_ref().map_or(requested_hz, LineBudget::rate_hz));
    let mut warnings: Vec<String> =
        silence_warning(&bench, &profile, line.is_some()).into_iter().collect();
    // Without its friction a motor is still known well enough for a prediction; with less it is not.
    let assumed = bench.motor.without_friction();
    if let Some(assumed) = assumed.as_ref().filter(|_| !bench.motor.unknown) {
        bench.motor = assumed.into();
        warnings.push(
            "motor.load_torque_n_m is left out: 0 N.m is assumed, the friction is not known. The motor will draw more current and turn \
             slower than is predicted here, by its friction; `drivebench run` and `commission` find the motor from small \
             steps first"
                .to_owned(),
        );
    }
    let refusal = offer::refusal(&profile, bench.purpose());
    let nameplate = bench.nameplate().filter(|_| !bench.motor.unknown);
    let Some(nameplate) = nameplate else {
        // The first stage of its escalation, and what follows.
        if let Some(refusal) = refusal {
            let headline = format!(
                "the motor is not known, and small steps cannot find it with this drive: {refusal}"
            );
            return Err(Failure::usage(headline, "complete [motor]"));
        }
        let search = bench
            .currents
            .as_ref()
            .map(|_| CurrentsSection::search(&bench.motor, &bench.limits(), bench.period_s()));
        let escalation = if search.is_some() { Ok(None) } else { plan_escalation(&bench) };
        let escalation =
            escalation.map_err(|error| failed_plan(&bench.name, PlanError::Sequence(error)))?;
        warnings.extend(bench.motor.contradictions());
        return Ok(Forecast::Unknown(Box::new(Unknown { escalation, search, line, warnings })));
    };
    let mut plan = plan_run(&bench, bench.runs.fit, &nameplate, rate_hz, None)
        .map_err(|error| failed_plan(&bench.name, error))?;
    plan.warnings.extend(warnings);
    if rate_hz < requested_hz {
        plan.warnings.push(format!(
            "{requested_hz} Hz is requested, the line allows {rate_hz:.0} Hz: cycles will be missed, and the prospects above are \
             those of {rate_hz:.0} Hz"
        ));
    }
    plan.warnings.extend(bench.motor.contradictions());
    let mut reference = None;
    if let Some(speed) = bench.speed.as_ref().filter(|_| refusal.is_some()) {
        bench.check_speed(file, source)?;
        let found = bench.reference(speed).ok();
        reference = found.map(|found| ReferencePlan::of(&found, &bench));
    }
    Ok(Forecast::Known(Box::new(Known { plan, reference, line })))
}

/// A slow drive of which one lost reply takes longer than the silence that ends a run.
fn silence_warning(bench: &BenchFile, profile: &DriveProfile, is_line: bool) -> Option<String> {
    let limit_s = bench.limits().link_silence_s;
    let lost = LostReply::of(profile).filter(|lost| is_line && lost.total_s() > limit_s)?;
    let text = lost.text();
    Some(format!(
        "{text}; limits.link_silence_s is {limit_s} s, so that a single lost reply may end the run"
    ))
}

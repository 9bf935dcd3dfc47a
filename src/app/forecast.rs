//! Forecast of a sequence before anything is energised: the plan of the motor and that of the line.

use serde::Serialize;

use super::failure::Failure;
use super::opening::wired_profile;
use drivebench_bench::{
    BenchFile, BenchFileError, Foresight, Plan, Port, Reference, foresee, plan,
};
use drivebench_link::{DriveProfile, LineBudget, LostReply, offer};

/// What can be said of a bench file.
#[derive(Serialize)]
#[serde(untagged)]
pub(crate) enum Forecast {
    /// The plan of the motor and that of the line.
    Known(Box<Known>),
    /// What is settled for a motor that is not known.
    Unknown(Box<Unknown>),
}

#[derive(Serialize)]
pub(crate) struct Known {
    #[serde(flatten)]
    pub(crate) plan: Plan,
    /// Of a drive that takes no voltage: the plan of the sequence then moves nothing. `null`: the sequence is what moves.
    pub(crate) reference: Option<Forward>,
    /// `null` where no serial line is involved.
    pub(crate) line: Option<LineBudget>,
}

#[derive(Serialize)]
pub(crate) struct Unknown {
    pub(crate) escalation: Option<Foresight>,
    pub(crate) line: Option<LineBudget>,
    pub(crate) warnings: Vec<String>,
}

/// What the reference of a speed run asks for, and what bounds it.
#[derive(Serialize)]
pub(crate) struct Forward {
    pub(crate) duration_s: f64,
    pub(crate) peak_speed_rad_s: f64,
    pub(crate) speed_limit_rad_s: f64,
    pub(crate) current_limit_a: f64,
    pub(crate) time_limit_s: f64,
}

impl Forward {
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

/// Predicts what the bench file `file`, with the text `source`, asks for.
pub(crate) fn forecast(file: &str, source: &str) -> Result<Forecast, Failure> {
    let mut bench = BenchFile::parse(file, source)?;
    let in_file = |name: &str, error| BenchFileError::Sequence {
        file: name.to_owned(),
        error,
    };
    let program = bench.program(bench.runs.fit);
    let program = program.map_err(|error| in_file(&bench.name, error))?;
    let (profile, _) = wired_profile(&mut bench)?;
    let line = match bench.port() {
        Port::Tcp(_) => None,
        Port::Emulator | Port::Sim | Port::SimRtu | Port::Serial(_) => LineBudget::of(&profile),
    };
    let asked_hz = bench.link.rate_hz;
    let carried_hz = line.as_ref().map_or(asked_hz, LineBudget::rate_hz);
    let rate_hz = asked_hz.min(carried_hz);
    let mut warnings: Vec<String> = silence_warning(&bench, &profile, line.is_some())
        .into_iter()
        .collect();
    // Without its friction a motor is still known well enough for a prediction; with less it is not.
    let assumed = bench.motor.without_friction();
    if let Some(assumed) = assumed.as_ref().filter(|_| !bench.motor.unknown) {
        bench.motor = assumed.into();
        warnings.push(
            "motor.load_torque_n_m is left out: 0 N.m is assumed, the friction is not known. The motor will draw more current and turn \
             slower than is told here by as much as its friction asks for; `drivebench run` and `commission` find the motor from small \
             steps first"
                .to_owned(),
        );
    }
    let voltages = offer::refusal(&profile, offer::Purpose::Voltages);
    let nameplate = bench.nameplate().filter(|_| !bench.motor.unknown);
    let Some(nameplate) = nameplate else {
        // The first stage of its escalation, and what follows.
        if let Some(refusal) = voltages {
            let headline = format!(
                "the motor is not known, and small steps cannot find it with this drive: {refusal}"
            );
            return Err(Failure::usage(headline, "complete [motor]"));
        }
        let escalation = foresee(&bench).map_err(|error| in_file(&bench.name, error))?;
        warnings.extend(bench.motor.doubts());
        return Ok(Forecast::Unknown(Box::new(Unknown {
            escalation,
            line,
            warnings,
        })));
    };
    let mut plan = plan(&program, &nameplate, &bench.limits(), rate_hz, None)?;
    plan.warnings.extend(warnings);
    if rate_hz < asked_hz {
        plan.warnings.push(format!(
            "{asked_hz} Hz is asked, the line carries {rate_hz:.0} Hz: cycles will be missed, and the prospects above are \
             those of {rate_hz:.0} Hz"
        ));
    }
    plan.warnings.extend(bench.motor.doubts());
    let mut reference = None;
    if let Some(speed) = bench.speed.as_ref().filter(|_| voltages.is_some()) {
        bench.check_speed(file, source)?;
        let found = bench.reference(speed).ok();
        reference = found.map(|found| Forward::of(&found, &bench));
    }
    Ok(Forecast::Known(Box::new(Known {
        plan,
        reference,
        line,
    })))
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

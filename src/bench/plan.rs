//! The plan: what a sequence will do to the motor, predicted from the nameplate before anything is energised.

mod judge;
mod observe;
mod trace;

pub use observe::{Observability, Prospect};

use serde::Serialize;

use super::limits::{Limits, Nameplate};
use super::program::Program;
use super::timing::whole;
use crate::plant::ModelError;
use trace::Trace;

/// A limit that the prediction crosses.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Refusal {
    pub segment: String,
    /// What would be too much: `peak current`.
    pub quantity: &'static str,
    pub predicted: f64,
    pub limit: f64,
    pub unit: &'static str,
}

impl std::fmt::Display for Refusal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "segment {:?}: predicted {} {:.4} {}, limit {:.4} {}",
            self.segment, self.quantity, self.predicted, self.unit, self.limit, self.unit
        )
    }
}

impl Refusal {
    /// The next step.
    pub fn help(&self) -> &'static str {
        match self.quantity {
            "peak current" => "lower slew_v_per_s or the amplitudes of this segment",
            "peak speed" | "peak voltage" => "lower the voltages of this segment",
            judge::FALL => {
                "leave coast-down parts out: nothing holds a vertical load while the output is off"
            }
            judge::UNHELD => {
                "give load.hold_current_a, load.brake_release_s and load.brake_apply_s"
            }
            judge::REVERSE_V | judge::REVERSE_A => {
                "the converter goes one way only ([converter] quadrants of the drive's profile): use positive levels"
            }
            "travel" => "shorten this segment, or use smaller and symmetric voltages",
            _ => "shorten the sequence, or raise limits.time_s",
        }
    }
}

/// Extremes of one segment, magnitudes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SegmentPlan {
    pub name: String,
    pub start_s: f64,
    pub end_s: f64,
    pub peak_voltage_v: f64,
    pub peak_current_a: f64,
    pub peak_speed_rad_s: f64,
    /// Farthest from the angle at the start of the run, rad.
    pub travel_rad: f64,
    /// Most that braking gives back to the supply, W.
    pub peak_returned_w: f64,
}

/// The whole prediction.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    pub duration_s: f64,
    pub rows: u64,
    pub peak_voltage_v: f64,
    pub peak_current_a: f64,
    /// In rated currents.
    pub peak_current_ratio: f64,
    pub peak_speed_rad_s: f64,
    pub travel_rad: f64,
    /// Root mean square over the run: what heats the winding.
    pub rms_current_a: f64,
    /// Integral of the squared current, A2.s.
    pub i2t_a2_s: f64,
    /// Heat in the winding at its nameplate resistance, J.
    pub copper_loss_j: f64,
    /// Electrical energy drawn, J; what is fed back when braking is not subtracted.
    pub energy_j: f64,
    /// Electrical energy that braking gives back, J, and the most of it at once, W.
    pub returned_j: f64,
    pub peak_returned_w: f64,
    pub segments: Vec<SegmentPlan>,
    /// Empty: the plan may be run.
    pub refusals: Vec<Refusal>,
    pub warnings: Vec<String>,
    pub parameters: Vec<Observability>,
}

impl Plan {
    pub fn is_refused(&self) -> bool {
        !self.refusals.is_empty()
    }
}

/// Predicts `program` at `rate_hz` under the slew and voltage limits. The winding limit is left out on purpose: a plan
/// that needs it is one that draws too much.
pub fn plan(
    program: &dyn Program,
    motor: &Nameplate,
    limits: &Limits,
    rate_hz: f64,
    drive_current_limit_a: Option<f64>,
) -> Result<Plan, ModelError> {
    let trace = Trace::simulate(program, motor, limits, rate_hz)?;
    let mut segments: Vec<SegmentPlan> = Vec::new();
    let (mut i2t, mut energy, mut returned) = (0.0, 0.0, 0.0);
    for point in &trace.points {
        if segments.len() <= point.segment {
            segments.push(SegmentPlan {
                name: program.segment_name(point.segment).to_owned(),
                start_s: point.time_s,
                end_s: point.time_s,
                peak_voltage_v: 0.0,
                peak_current_a: 0.0,
                peak_speed_rad_s: 0.0,
                travel_rad: 0.0,
                peak_returned_w: 0.0,
            });
        }
        let returned_w = (-point.voltage_v * point.current_a).max(0.0);
        if let Some(segment) = segments.last_mut() {
            segment.end_s = point.time_s;
            grow(&mut segment.peak_voltage_v, point.voltage_v);
            grow(&mut segment.peak_current_a, point.current_a);
            grow(&mut segment.peak_speed_rad_s, point.speed_rad_s);
            grow(&mut segment.travel_rad, point.angle_rad);
            grow(&mut segment.peak_returned_w, returned_w);
        }
        i2t += point.current_a * point.current_a * trace.step_s;
        returned += returned_w * trace.step_s;
        energy += (point.voltage_v * point.current_a).max(0.0) * trace.step_s;
    }
    let peak = |of: fn(&SegmentPlan) -> f64| segments.iter().map(of).fold(0.0, f64::max);
    let duration_s = program.duration_s();
    let peak_current_a = peak(|segment| segment.peak_current_a);
    let rms_current_a = (i2t / duration_s.max(trace.step_s)).sqrt();
    let mut plan = Plan {
        duration_s,
        rows: whole((duration_s * rate_hz).ceil()) as u64,
        peak_voltage_v: peak(|segment| segment.peak_voltage_v),
        peak_current_a,
        peak_current_ratio: peak_current_a / motor.rated_current_a,
        peak_speed_rad_s: peak(|segment| segment.peak_speed_rad_s),
        travel_rad: peak(|segment| segment.travel_rad),
        rms_current_a,
        i2t_a2_s: i2t,
        copper_loss_j: motor.resistance_ohm * i2t,
        energy_j: energy,
        returned_j: returned,
        peak_returned_w: peak(|segment| segment.peak_returned_w),
        refusals: Vec::new(),
        warnings: Vec::new(),
        parameters: observe::parameters(&trace, motor, rate_hz),
        segments,
    };
    plan.refusals = refusals(&plan, limits, drive_current_limit_a);
    plan.refusals
        .extend(judge::refusals(&trace, &plan.segments, motor, limits));
    plan.warnings = judge::warnings(&trace, &plan, limits, rate_hz);
    if rms_current_a > motor.rated_current_a {
        plan.warnings.push(format!(
            "the effective current is {rms_current_a:.2} A, rated are {:.2} A: let the motor cool between runs",
            motor.rated_current_a
        ));
    }
    Ok(plan)
}

fn refusals(plan: &Plan, limits: &Limits, drive_current_limit_a: Option<f64>) -> Vec<Refusal> {
    // Where the drive would clip the voltage to hold its own limit, the run would not be the one that was planned.
    let current_a =
        drive_current_limit_a.map_or(limits.current_a, |amps| amps.min(limits.current_a));
    let mut refusals = Vec::new();
    for segment in &plan.segments {
        let checks = [
            (
                "peak voltage",
                segment.peak_voltage_v,
                Some(limits.voltage_v),
                "V",
            ),
            ("peak current", segment.peak_current_a, Some(current_a), "A"),
            (
                "peak speed",
                segment.peak_speed_rad_s,
                Some(limits.speed_rad_s),
                "rad/s",
            ),
            ("travel", segment.travel_rad, limits.travel_rad, "rad"),
            (
                "time with the output on",
                segment.end_s,
                Some(limits.time_s),
                "s",
            ),
        ];
        for (quantity, predicted, limit, unit) in checks {
            if let Some(limit) = limit
                && predicted > limit
            {
                refusals.push(Refusal {
                    segment: segment.name.clone(),
                    quantity,
                    predicted,
                    limit,
                    unit,
                });
            }
        }
    }
    refusals
}

fn grow(peak: &mut f64, value: f64) {
    *peak = peak.max(value.abs());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::bench_file::BenchFile;
    use crate::bench::testing::Wave;
    use crate::sample::Demand;

    fn limits() -> Limits {
        Limits::for_motor(&Nameplate::zk_22fc(), 100.0)
    }

    fn step(volts: f64, slew_v_per_s: f64) -> Plan {
        let program = Wave {
            duration_s: 1.0,
            demand: move |time_s: f64| Demand::Voltage(if time_s < 0.1 { 0.0 } else { volts }),
        };
        let limits = Limits {
            slew_v_per_s,
            ..limits()
        };
        plan(&program, &Nameplate::zk_22fc(), &limits, 100.0, None).unwrap()
    }

    #[test]
    fn a_full_voltage_step_draws_thirteen_times_the_rated_current_and_is_refused() {
        // PHYSICS.md section 5: 75 A, 13 times rated; 30 V still 21 A.
        let plan = step(110.0, 1e6);
        assert!(
            (70.0..80.0).contains(&plan.peak_current_a),
            "{}",
            plan.peak_current_a
        );
        assert!((plan.peak_current_ratio - 13.0).abs() < 0.5);
        let refusal = plan.refusals[0].to_string();
        assert!(
            refusal.contains("second half") || refusal.contains("first half"),
            "{refusal}"
        );
        assert!(
            refusal.contains("peak current") && refusal.contains("22.8"),
            "{refusal}"
        );
        let small = step(30.0, 1e6).peak_current_a;
        assert!((20.0..22.0).contains(&small), "{small}");
    }

    #[test]
    fn the_slew_limit_is_part_of_the_prediction() {
        let plan = step(100.0, 300.0);
        assert!(!plan.is_refused(), "{:?}", plan.refusals);
        // s R J/Ke^2 / R + Mc/Ke = 10.8 + 1.3 A
        assert!(
            (plan.peak_current_a - 12.1).abs() < 0.6,
            "{}",
            plan.peak_current_a
        );
    }

    #[test]
    fn the_embedded_bench_stays_under_every_limit_with_room_for_a_ten_percent_specimen() {
        let bench = BenchFile::embedded_default();
        for seed in [1, 2, 3] {
            let program = bench.program(seed).unwrap();
            let mut worst: f64 = 0.0;
            for (inertia, resistance, back_emf) in
                [(1.0, 1.0, 1.0), (1.1, 0.9, 0.9), (0.9, 0.9, 0.9)]
            {
                let mut motor = bench.nameplate().unwrap();
                motor.inertia_kg_m2 *= inertia;
                motor.resistance_ohm *= resistance;
                motor.back_emf_v_s_per_rad *= back_emf;
                let plan = plan(&program, &motor, &bench.limits(), 100.0, Some(11.4)).unwrap();
                assert!(!plan.is_refused(), "seed {seed}: {:?}", plan.refusals);
                worst = worst.max(plan.peak_current_a);
            }
            assert!(worst > 5.7, "{worst} A excites nothing");
        }
    }

    #[test]
    fn travel_time_and_the_drive_s_own_limit_are_checked_too() {
        let bench = BenchFile::embedded_default();
        let program = bench.program(1).unwrap();
        let tight = Limits {
            travel_rad: Some(10.0),
            time_s: 5.0,
            ..bench.limits()
        };
        let plan = plan(
            &program,
            &bench.nameplate().unwrap(),
            &tight,
            100.0,
            Some(3.0),
        )
        .unwrap();
        for quantity in ["travel", "time with the output on", "peak current"] {
            assert!(
                plan.refusals.iter().any(|r| r.quantity == quantity),
                "{quantity}"
            );
        }
    }

    #[test]
    fn a_coasting_motor_draws_no_current() {
        let program = Wave {
            duration_s: 2.0,
            demand: |time_s: f64| {
                if time_s < 1.0 {
                    Demand::Voltage(50.0)
                } else {
                    Demand::Disable
                }
            },
        };
        let plan = plan(&program, &Nameplate::zk_22fc(), &limits(), 100.0, None).unwrap();
        assert!(plan.segments[1].peak_current_a < 1e-9);
        assert!(plan.segments[1].peak_speed_rad_s > 100.0);
    }
}

//! Simulation of a speed loop in virtual time: motor, friction, limits, delay, noise; for predictions and comparisons.
//!
//! ```text
//! reference(t) -> controller -> limiter -> delay -> drive's current limit -> motor(t): inertia, load -> sensor, noise
//!                     ^---------------------------- samples ---------------------------------------------'
//! ```
//!
//! A machine without a back-EMF (`back_emf_v_s_per_rad` zero) is paper B's plant: an integrator behind a lag.

use super::limiter::limited as limited_by;
use super::{Limiter, Measured, SpeedController};
use drivebench_model::numerics::count::whole;
use drivebench_model::numerics::propagator::LinearPart;
use drivebench_model::plant::Coupling;

/// Integration steps of a period, at least; with a coupling, which is integrated by semi-implicit Euler steps, none of them
/// turns its oscillation by more than 0.03 rad.
const STEPS: usize = 20;

#[derive(Clone, Copy, Debug)]
pub struct TrialMachine {
    pub resistance_ohm: f64,
    pub inductance_h: f64,
    pub back_emf_v_s_per_rad: f64,
    pub torque_n_m_per_a: f64,
    /// Against the motion, N.m.
    pub friction_n_m: f64,
    pub viscous_n_m_s_per_rad: f64,
    /// Between motor and load; the inertia is that of both, the load torque acts on the load's side.
    pub coupling: Option<Coupling>,
    /// The drive lowers its voltage to hold this current, A.
    pub drive_current_limit_a: f64,
    pub period_s: f64,
    /// Whole periods from a sample to the instant at which its output is applied.
    pub delay_periods: usize,
    pub speed_noise_rad_s: f64,
    pub current_noise_a: f64,
}

/// One cycle of a trial, true values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrialPoint {
    pub time_s: f64,
    pub reference_rad_s: f64,
    pub speed_rad_s: f64,
    pub current_a: f64,
    /// Of the sensor, with noise.
    pub measured_rad_s: f64,
    /// After the controller's limiter.
    pub output_v: f64,
    /// The limiter or the drive's current limit held it.
    pub limited: bool,
}

/// A speed sensor that may be driven by the shaft's angle.
pub trait SpeedSensor {
    /// The shaft has reached an angle, rad; called many times per period, time and angle without gaps.
    fn turned(&mut self, _time_s: f64, _angle_rad: f64) {}

    /// The reading of this instant; `speed_rad_s` is the true speed.
    fn read(&mut self, time_s: f64, speed_rad_s: f64) -> f64;
}

/// The true speed.
struct Direct;

impl SpeedSensor for Direct {
    fn read(&mut self, _time_s: f64, speed_rad_s: f64) -> f64 {
        speed_rad_s
    }
}

/// White noise; a generator without a dependency keeps the published trials to the bit.
#[derive(Clone, Copy, Debug)]
struct Noise(u64);

impl Noise {
    /// About a unit normal: the sum of twelve even draws (Irwin and Hall).
    fn draw(&mut self) -> f64 {
        let sum: f64 = (0..12)
            .map(|_| {
                // xorshift64*, Vigna 2016.
                self.0 ^= self.0 >> 12;
                self.0 ^= self.0 << 25;
                self.0 ^= self.0 >> 27;
                let bits = self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11;
                bits as f64 / (1_u64 << 53) as f64
            })
            .sum();
        sum - 6.0
    }
}

/// A function of the time since the begin, s.
type OverTime<'a> = Box<dyn Fn(f64) -> f64 + 'a>;

/// A trial from standstill.
pub struct Trial<'a> {
    pub machine: TrialMachine,
    pub limiter: Limiter,
    /// The machine's noise is added to its reading.
    pub sensor: Box<dyn SpeedSensor>,
    /// Of the noise.
    pub seed: u64,
    reference_rad_s: OverTime<'a>,
    inertia_kg_m2: OverTime<'a>,
    load_n_m: OverTime<'a>,
}

impl<'a> Trial<'a> {
    /// A constant inertia, no load, and the true speed with the machine's noise.
    pub fn new(
        machine: TrialMachine,
        limiter: Limiter,
        inertia_kg_m2: f64,
        reference_rad_s: impl Fn(f64) -> f64 + 'a,
    ) -> Self {
        Self {
            machine,
            limiter,
            sensor: Box::new(Direct),
            seed: 1,
            reference_rad_s: Box::new(reference_rad_s),
            inertia_kg_m2: Box::new(move |_| inertia_kg_m2),
            load_n_m: Box::new(|_| 0.0),
        }
    }

    #[must_use]
    pub fn with_inertia(self, inertia_kg_m2: impl Fn(f64) -> f64 + 'a) -> Self {
        Self { inertia_kg_m2: Box::new(inertia_kg_m2), ..self }
    }

    /// A load against positive motion, N.m.
    #[must_use]
    pub fn with_load(self, load_n_m: impl Fn(f64) -> f64 + 'a) -> Self {
        Self { load_n_m: Box::new(load_n_m), ..self }
    }

    /// Runs a controller for the whole periods of `seconds`.
    pub fn run(mut self, controller: &mut dyn SpeedController, seconds: f64) -> Vec<TrialPoint> {
        let (machine, sensor) = (&self.machine, &mut *self.sensor);
        let cycles = whole((seconds / machine.period_s).round());
        let mut noise = Noise(self.seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
        let mut x = [0.0, 0.0];
        let mut load = Load::default();
        let mut angle_rad = 0.0;
        let mut pipe = std::collections::VecDeque::from(vec![0.0; machine.delay_periods]);
        let mut limited = false;
        let mut trace = Vec::with_capacity(cycles);
        for cycle in 0..cycles {
            let time_s = cycle as f64 * machine.period_s;
            let inertia = (self.inertia_kg_m2)(time_s);
            let now = Measured {
                speed_rad_s: sensor.read(time_s, x[1]) + machine.speed_noise_rad_s * noise.draw(),
                current_a: Some(x[0] + machine.current_noise_a * noise.draw()),
                angle_rad: Some(angle_rad),
                limited,
            };
            let reference_rad_s = (self.reference_rad_s)(time_s);
            controller.preview(&|ahead_s| (self.reference_rad_s)(time_s + ahead_s));
            let wanted = controller.step(reference_rad_s, &now, machine.period_s);
            let torque = machine.torque_n_m_per_a * x[0] - machine.friction_n_m * x[1].signum();
            let output = self.limiter.limit(wanted, now.speed_rad_s, torque / inertia);
            controller.applied(output);
            let mut point = TrialPoint {
                time_s,
                reference_rad_s,
                speed_rad_s: x[1],
                current_a: x[0],
                measured_rad_s: now.speed_rad_s,
                output_v: output,
                limited: limited_by(wanted, output) != 0.0,
            };
            pipe.push_back(output);
            let held = (pipe.pop_front().unwrap_or(output), inertia, (self.load_n_m)(time_s));
            let step_s = machine.step_s();
            let mut step = 0;
            limited = machine.advance(&mut x, &mut load, held, |from, to| {
                step += 1;
                angle_rad += 0.5 * step_s * (from + to);
                sensor.turned(time_s + f64::from(step) * step_s, angle_rad);
            });
            point.limited |= limited;
            trace.push(point);
        }
        trace
    }
}

/// The load behind a coupling: its speed, and the angle by which the motor is ahead.
#[derive(Clone, Copy, Debug, Default)]
struct Load {
    speed_rad_s: f64,
    twist_rad: f64,
}

/// Friction torque and speed after a step under Coulomb friction with sticking: a shaft that it would reverse stops, and one
/// at rest stays where the torque does not exceed it. `next`: the speed under a resisting torque.
fn with_friction(
    speed_rad_s: f64,
    drive_n_m: f64,
    friction_n_m: f64,
    next: impl Fn(f64) -> f64,
) -> (f64, f64) {
    // Without friction nothing holds a shaft that passes zero.
    let has_friction = friction_n_m > 0.0;
    let sticks = has_friction && speed_rad_s == 0.0 && drive_n_m.abs() <= friction_n_m;
    let direction = if speed_rad_s == 0.0 { drive_n_m } else { speed_rad_s }.signum();
    let resisting_n_m = friction_n_m * direction;
    let moved = next(resisting_n_m);
    let stops = has_friction && moved * direction < 0.0;
    (resisting_n_m, if sticks || stops { 0.0 } else { moved })
}

impl TrialMachine {
    fn steps(&self) -> usize {
        let natural = self.coupling.map_or(0.0, |coupling| coupling.frequency_hz);
        let turn = std::f64::consts::TAU * natural * self.period_s;
        STEPS.max(whole((turn / 0.03).min(1e5).ceil()))
    }

    fn step_s(&self) -> f64 {
        self.period_s / self.steps() as f64
    }

    /// One period under a held voltage, an inertia and a load; returns whether the drive's current limit held it. `moved`
    /// receives the speed before and after each step.
    fn advance(
        &self,
        x: &mut [f64; 2],
        load: &mut Load,
        (voltage_v, inertia, load_n_m): (f64, f64, f64),
        mut moved: impl FnMut(f64, f64),
    ) -> bool {
        let (r, l) = (self.resistance_ohm, self.inductance_h);
        let (ke, kt) = (self.back_emf_v_s_per_rad, self.torque_n_m_per_a);
        let (share, split) = self
            .coupling
            .map_or((0.0, 0.0), |coupling| (coupling.inertia_ratio, coupling.friction_split));
        let motor_inertia = (1.0 - share) * inertia;
        let step_s = self.step_s();
        let propagator = LinearPart::new(&[
            [-r / l, -ke / l],
            [kt / motor_inertia, -self.viscous_n_m_s_per_rad / motor_inertia],
        ])
        .over(step_s);
        let limit_a = self.drive_current_limit_a;
        let mut limited = false;
        for _ in 0..self.steps() {
            let [current, speed] = *x;
            // The drive cuts what would carry the current beyond its limit within the step.
            let hold_v = |amps: f64| r * amps + ke * speed + l * (amps - current) / step_s;
            let given_v = voltage_v.clamp(hold_v(-limit_a), hold_v(limit_a));
            limited |= (given_v - voltage_v).abs() > 1e-9;
            let taken_n_m = match &self.coupling {
                Some(coupling) => {
                    let shaft_n_m = shaft_torque(coupling, inertia, speed, load);
                    let drive_n_m = shaft_n_m - load_n_m;
                    let next = |friction_n_m: f64| {
                        load.speed_rad_s + step_s * (drive_n_m - friction_n_m) / (share * inertia)
                    };
                    let friction_n_m = split * self.friction_n_m;
                    load.speed_rad_s =
                        with_friction(load.speed_rad_s, drive_n_m, friction_n_m, next).1;
                    shaft_n_m
                }
                None => load_n_m,
            };
            let after = |friction_n_m: f64| {
                let resisting_n_m = taken_n_m + friction_n_m;
                propagator.apply(*x, [given_v / l, -resisting_n_m / motor_inertia])
            };
            let (friction_n_m, speed_after) = with_friction(
                speed,
                kt * current - taken_n_m,
                (1.0 - split) * self.friction_n_m,
                |friction_n_m| after(friction_n_m)[1],
            );
            *x = [after(friction_n_m)[0], speed_after];
            // With the speeds at the end of the step (semi-implicit): the oscillation neither gains nor loses energy.
            load.twist_rad += step_s * (speed_after - load.speed_rad_s);
            moved(speed, speed_after);
        }
        limited
    }
}

/// Torque from the motor to the load, N.m. f, r, zeta as in [`Coupling`]: `k = (2 pi f)^2 J r (1 - r)`, `d = 2 zeta 2 pi f J r
/// (1 - r)`.
fn shaft_torque(coupling: &Coupling, inertia: f64, speed_rad_s: f64, load: &Load) -> f64 {
    let w0 = std::f64::consts::TAU * coupling.frequency_hz;
    let reduced = inertia * coupling.inertia_ratio * (1.0 - coupling.inertia_ratio);
    let half_rad = 0.5 * coupling.gap_rad;
    let beyond_rad = load.twist_rad - load.twist_rad.clamp(-half_rad, half_rad);
    let spring = w0 * w0 * beyond_rad;
    reduced * (spring + 2.0 * coupling.damping_ratio * w0 * (speed_rad_s - load.speed_rad_s))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Fixed, assert_close, elastic, machine};
    use crate::{LinearPlant, PaperBPlant};

    /// Speeds under 12 V from standstill, without noise, delay, friction and limits.
    fn under_12_v(machine: TrialMachine, inertia_kg_m2: f64, seconds: f64) -> Vec<TrialPoint> {
        let machine = TrialMachine {
            friction_n_m: 0.0,
            drive_current_limit_a: 1e6,
            delay_periods: 0,
            ..machine
        };
        let limiter = Limiter { output: 1e3, current: None };
        let trial = Trial::new(machine, limiter, inertia_kg_m2, |_| 0.0);
        trial.run(&mut Fixed::new(12.0), seconds)
    }

    #[test]
    fn without_a_back_emf_it_is_paper_bs_plant() {
        let (ke, electrical_s, mechanical_s) = (0.926, 0.0034, 0.076);
        let machine = TrialMachine {
            resistance_ohm: 3.25,
            inductance_h: 3.25 * electrical_s,
            back_emf_v_s_per_rad: 0.0,
            torque_n_m_per_a: ke,
            period_s: 0.001,
            ..machine(0.0)
        };
        let trace = under_12_v(machine, mechanical_s * ke * ke / 3.25, 0.4);
        let (g, h) = PaperBPlant::new(0.001, electrical_s, mechanical_s, ke).state_space();
        let mut x = nalgebra::Vector2::zeros();
        for point in &trace {
            assert_close(point.speed_rad_s, x[0], 1e-9);
            x = g * x + h * 12.0;
        }
        assert!(trace[399].speed_rad_s > 60.0 && !trace[399].limited);
    }

    #[test]
    fn behind_a_coupling_it_moves_as_the_linear_plant_does() {
        let plant = LinearPlant::voltage(&elastic(0.4, 0.02), 0.0).unwrap();
        let coupling = plant.coupling().copied();
        let machine = TrialMachine { coupling, period_s: 0.002, ..machine(0.0) };
        let trace = under_12_v(machine, 0.0045, 0.6);
        let (phi, gamma) = plant.held_over(0.002);
        let mut x = nalgebra::Vector4::<f64>::zeros();
        for point in &trace {
            assert!((point.speed_rad_s - x[1]).abs() < 0.05, "{point:?} {x:?}");
            x = phi * x + gamma * 12.0;
        }
        // It oscillates on the way: the motor alone turns back.
        assert!(trace.windows(2).any(|pair| pair[1].speed_rad_s < pair[0].speed_rad_s - 0.05));
    }
}

//! The output stage: inner loops, supply limit and current limit, and what hides between set-point and voltage.

use firmware_protocol::Control;

use super::TICK_S;
use super::delay_line::DelayLine;
use crate::config::{LimitsConfig, OutputOff};
use crate::truth::{MotorTruth, Path, Plant, Terminals};

/// What the inverter does now, and which limit holds it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Output {
    pub(super) terminals: Terminals,
    /// Output voltage as the drive computes it, V; 0 while the terminals are open.
    pub(super) volts: f64,
    pub(super) current_limited: bool,
    pub(super) voltage_limited: bool,
}

impl Output {
    pub(super) const fn off(kind: OutputOff, bus_v: f64) -> Self {
        Self {
            terminals: match kind {
                OutputOff::ZeroVolt => Terminals::Voltage(0.0),
                OutputOff::Open => Terminals::Open { bus_v },
            },
            volts: 0.0,
            current_limited: false,
            voltage_limited: false,
        }
    }
}

/// Limits and inner loops. The loops are tuned on the nameplate, as in a real drive.
pub(super) struct OutputStage {
    current_limit_a: f64,
    bus_v: f64,
    speed_limit_rad_s: f64,
    output_off: OutputOff,
    late: DelayLine,
    offset_v: f64,
    current_gain: f64,
    current_integral_gain: f64,
    speed_gain: f64,
    speed_integral_gain: f64,
    /// Integrator of the current loop, V.
    current_integral_v: f64,
    /// Integrator of the speed loop, A.
    speed_integral_a: f64,
}

impl OutputStage {
    pub(super) fn new(limits: &LimitsConfig, nameplate: &MotorTruth, path: &Path) -> Self {
        // Bandwidths of the inner loops, rad/s: 200 Hz and 5 Hz.
        let (current_bandwidth, speed_bandwidth) = (1257.0, 31.4);
        let speed_gain = speed_bandwidth * nameplate.inertia_kg_m2 / nameplate.torque_constant();
        Self {
            current_limit_a: limits.current_limit_a,
            bus_v: limits.bus_v,
            speed_limit_rad_s: limits.speed_limit_rad_s,
            output_off: limits.output_off,
            late: DelayLine::new(path),
            offset_v: path.voltage_offset_v,
            current_gain: current_bandwidth * nameplate.inductance_h,
            current_integral_gain: current_bandwidth * nameplate.resistance_ohm,
            speed_gain,
            speed_integral_gain: speed_gain * speed_bandwidth / 4.0,
            current_integral_v: 0.0,
            speed_integral_a: 0.0,
        }
    }

    /// A loop begins: it takes over from what the machine does now.
    pub(super) fn restart(&mut self, plant: &Plant) {
        self.current_integral_v = plant.terminal_v();
        self.speed_integral_a = plant.current_a();
    }

    pub(super) fn output(&mut self, control: Option<Control>, plant: &Plant, tick: u64) -> Output {
        let acting = self.late.acting(control, tick);
        if acting.is_none()
            && let off = Output::off(self.output_off, self.bus_v)
            && let Terminals::Open { .. } = off.terminals
        {
            return off;
        }
        let wanted_v = acting.map_or(0.0, |acting| self.wanted_v(acting, plant));
        let mut output = self.limited(wanted_v, plant);
        // The drive reports its set-point, unless a limit is in force.
        if let Some(Control::Voltage(commanded_v)) = control
            && !output.current_limited
        {
            output.volts = commanded_v.clamp(-self.bus_v, self.bus_v);
        }
        if let (Some(_), Terminals::Voltage(volts)) = (control, &mut output.terminals) {
            *volts += self.offset_v;
        }
        output
    }

    fn wanted_v(&mut self, control: Control, plant: &Plant) -> f64 {
        match control {
            Control::Voltage(volts) => volts,
            Control::Current(amperes) => self.current_loop(amperes, plant),
            Control::Speed(speed) => {
                let amperes = self.speed_loop(speed, plant);
                self.current_loop(amperes, plant)
            }
            Control::Disable | Control::Stop | Control::ResetFault => 0.0,
        }
    }

    /// Supply limit first, then the chopping current limiter, which is bounded by the supply too.
    fn limited(&self, wanted_v: f64, plant: &Plant) -> Output {
        let supplied = wanted_v.clamp(-self.bus_v, self.bus_v);
        let lowest = plant.voltage_for_current(-self.current_limit_a, TICK_S);
        let highest = plant.voltage_for_current(self.current_limit_a, TICK_S);
        // Not `clamp`, which panics where a plant that has run away gives no numbers any more.
        let chopped = supplied.max(lowest).min(highest);
        let volts = chopped.clamp(-self.bus_v, self.bus_v);
        Output {
            terminals: Terminals::Voltage(volts),
            volts,
            current_limited: (chopped - supplied).abs() > 0.0,
            voltage_limited: (supplied - wanted_v).abs() > 0.0,
        }
    }

    /// PI with the pole of the armature cancelled; the integrator stands still at the supply limit.
    fn current_loop(&mut self, amperes: f64, plant: &Plant) -> f64 {
        let target = amperes.clamp(-self.current_limit_a, self.current_limit_a);
        let error = target - plant.current_a();
        let wanted = self.current_gain * error + self.current_integral_v;
        if wanted.abs() < self.bus_v || wanted * error < 0.0 {
            self.current_integral_v += self.current_integral_gain * TICK_S * error;
        }
        wanted
    }

    fn speed_loop(&mut self, speed: f64, plant: &Plant) -> f64 {
        let target = speed.clamp(-self.speed_limit_rad_s, self.speed_limit_rad_s);
        let error = target - plant.speed_rad_s();
        let wanted = self.speed_gain * error + self.speed_integral_a;
        if wanted.abs() < self.current_limit_a || wanted * error < 0.0 {
            self.speed_integral_a += self.speed_integral_gain * TICK_S * error;
        }
        wanted
    }
}

//! A machine with its loop, every regulator made for it, and a trial of one on the other.

use serde::Serialize;

use super::joining::WithBackEmf;
use crate::control::tuning::{Request, Tuning, tune};
use crate::control::{
    Actuator, Addc, AddcSettings, AntiWindup, Course, CurrentLimit, Direct, Holding, Limiter,
    LinearPlant, LoadObserving, LoadObservingSettings, LoopTiming, Mrac, MracScales, PaperB,
    PaperBPlant, PaperBSettings, Pi, SpeedController, SpeedSensor, TrialMachine, TrialPoint,
    trial_seen_by,
};
use crate::numerics::count::whole;
use crate::plant::{Model, MotorKey};

/// The models are written down in this program: what is made of them does not fail.
const FIXED: &str = "made from a model and settings that are written down here";

/// A regulator of the comparison.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    #[default]
    Pi,
    Addc,
    /// Not in the table: ADDC as paper A has it, without a watch for jumps.
    AddcForgetting,
    MracConnected,
    MracDisconnected,
    PaperB,
    LoadObserver,
}

impl Kind {
    /// Those of the table.
    pub const ALL: [Self; 6] = [
        Self::Pi,
        Self::Addc,
        Self::MracConnected,
        Self::MracDisconnected,
        Self::PaperB,
        Self::LoadObserver,
    ];

    pub const fn name(self) -> &'static str {
        match self {
            Self::Pi => "pi (fixed)",
            Self::Addc => "addc",
            Self::AddcForgetting => "addc, forgetting alone",
            Self::MracConnected => "mrac, always connected",
            Self::MracDisconnected => "mrac, disconnected in saturation",
            Self::PaperB => "paper-b",
            Self::LoadObserver => "load-observer",
        }
    }
}

/// A motor behind a voltage command, what its loop takes in time, and what its regulators are told.
#[derive(Clone, Debug)]
pub(in crate::workflow::reproduce) struct Bench {
    pub name: &'static str,
    /// What the regulators know; the truth of a trial may have another inertia.
    pub model: Model,
    pub timing: LoopTiming,
    pub current_limit_a: f64,
    pub voltage_limit_v: f64,
    pub speed_noise_rad_s: f64,
    pub current_noise_a: f64,
    /// Full speed of the adaptive rival's scales, rad/s.
    pub scale_rad_s: f64,
    /// Of ADDC's estimate, per sample.
    pub forgetting: f64,
    pub paper_b: PaperBSettings,
    pub observer: LoadObservingSettings,
}

impl Bench {
    pub(crate) fn value(&self, key: MotorKey) -> f64 {
        self.model.motor.get(key).expect(FIXED)
    }

    pub(crate) fn inertia(&self) -> f64 {
        self.value(MotorKey::Inertia)
    }

    /// The same with regulators that know of an inertia `ratio` times as large.
    pub(crate) fn with_inertia_ratio(&self, ratio: f64) -> Self {
        let mut bench = self.clone();
        let inertia = ratio * self.inertia();
        bench.model.motor.set(MotorKey::Inertia, inertia);
        bench
    }

    /// The motor of the model in its trial; the inertia comes with the course.
    pub(crate) fn machine(&self) -> TrialMachine {
        TrialMachine {
            resistance_ohm: self.value(MotorKey::Resistance),
            inductance_h: self.value(MotorKey::Inductance),
            back_emf_v_s_per_rad: self.value(MotorKey::BackEmf),
            torque_n_m_per_a: self.model.motor.torque_constant().expect(FIXED),
            friction_n_m: self.model.motor.get(MotorKey::LoadTorque).unwrap_or(0.0),
            viscous_n_m_s_per_rad: 0.0,
            drive_current_limit_a: 1.14 * self.current_limit_a,
            period_s: self.timing.period_s,
            delay_periods: whole(self.timing.delay_cycles().round()),
            speed_noise_rad_s: self.speed_noise_rad_s,
            current_noise_a: self.current_noise_a,
        }
    }

    pub(crate) fn limiter(&self) -> Limiter {
        Limiter {
            output: self.voltage_limit_v,
            current: Some(CurrentLimit {
                current_a: self.current_limit_a,
                resistance_ohm: self.value(MotorKey::Resistance),
                back_emf_v_s_per_rad: self.value(MotorKey::BackEmf),
                ahead_s: self.timing.dead_time_s(),
            }),
        }
    }

    pub(crate) fn plant(&self) -> LinearPlant {
        LinearPlant::voltage(&self.model, 0.0).expect(FIXED)
    }

    pub(crate) fn holding(&self) -> Holding {
        Holding::of(&self.model, Actuator::Voltage, 0.0)
    }

    /// Gains by the modulus optimum for an inertia `ratio` times the model's.
    pub(crate) fn tuning(&self, ratio: f64) -> Tuning {
        let plant = self.plant().with_inertia_ratio(ratio);
        tune(&plant, &self.timing, &Request::default()).expect(FIXED)
    }

    pub(crate) fn pi(&self) -> Pi {
        Pi::new(self.tuning(1.0).gains, AntiWindup::Hold, self.holding())
    }

    pub(crate) fn addc(&self) -> Addc {
        let settings = AddcSettings {
            forgetting: self.forgetting,
            ..AddcSettings::new(self.holding(), self.speed_noise_rad_s)
        };
        Addc::new(&self.model, &self.plant(), &self.timing, &settings).expect(FIXED)
    }

    pub(crate) fn mrac(&self, disconnects: bool) -> Mrac {
        let scales = MracScales {
            speed_rad_s: self.scale_rad_s,
            current_a: self.current_limit_a,
        };
        Mrac::new(&self.plant(), &self.timing, scales, disconnects).expect(FIXED)
    }

    /// Paper B's regulator with these settings.
    pub(crate) fn paper_b(&self, settings: PaperBSettings) -> PaperB {
        PaperB::new(self.paper_b_plant(), settings).expect(FIXED)
    }

    /// What paper B makes of this motor: its back-EMF left out.
    pub(crate) fn paper_b_plant(&self) -> PaperBPlant {
        let motor = &self.model.motor;
        PaperBPlant::new(
            self.timing.period_s,
            motor.electrical_time_constant_s().expect(FIXED),
            motor.mechanical_time_constant_s().expect(FIXED),
            self.value(MotorKey::BackEmf),
        )
    }

    pub(crate) fn controller(&self, kind: Kind) -> Box<dyn SpeedController> {
        match kind {
            Kind::Pi => Box::new(self.pi()),
            Kind::Addc => Box::new(self.addc()),
            Kind::AddcForgetting => Box::new(self.addc().by_forgetting_alone()),
            Kind::MracConnected => Box::new(self.mrac(false)),
            Kind::MracDisconnected => Box::new(self.mrac(true)),
            Kind::PaperB => Box::new(WithBackEmf::new(
                self.paper_b(self.paper_b),
                self.value(MotorKey::BackEmf),
            )),
            Kind::LoadObserver => Box::new(
                LoadObserving::new(&self.model, &self.plant(), &self.timing, &self.observer)
                    .expect(FIXED),
            ),
        }
    }
}

/// A function of the time, s.
type OverTime<'a> = Box<dyn Fn(f64) -> f64 + 'a>;

/// What a regulator is put through, from standstill.
pub(in crate::workflow::reproduce) struct Trial<'a> {
    pub machine: TrialMachine,
    pub limiter: Limiter,
    pub sensor: Box<dyn SpeedSensor>,
    /// Of the sensors' noise.
    pub seed: u64,
    reference_rad_s: OverTime<'a>,
    inertia_kg_m2: OverTime<'a>,
    load_n_m: OverTime<'a>,
}

impl<'a> Trial<'a> {
    /// On the machine of a bench as its regulators know it, on the true speed and the sensors' noise, without a load.
    pub(crate) fn of(bench: &Bench, reference_rad_s: impl Fn(f64) -> f64 + 'a) -> Self {
        let inertia = bench.inertia();
        Self {
            machine: bench.machine(),
            limiter: bench.limiter(),
            sensor: Box::new(Direct),
            seed: 1,
            reference_rad_s: Box::new(reference_rad_s),
            inertia_kg_m2: Box::new(move |_| inertia),
            load_n_m: Box::new(|_| 0.0),
        }
    }

    /// The inertia over that of the model.
    #[must_use]
    pub(crate) fn with_inertia_ratio(self, bench: &Bench, ratio: impl Fn(f64) -> f64 + 'a) -> Self {
        let inertia = bench.inertia();
        Self {
            inertia_kg_m2: Box::new(move |t| inertia * ratio(t)),
            ..self
        }
    }

    #[must_use]
    pub(crate) fn with_load(self, load_n_m: impl Fn(f64) -> f64 + 'a) -> Self {
        Self {
            load_n_m: Box::new(load_n_m),
            ..self
        }
    }

    pub(crate) fn run(
        mut self,
        controller: &mut dyn SpeedController,
        seconds: f64,
    ) -> Vec<TrialPoint> {
        let course = Course {
            reference_rad_s: &self.reference_rad_s,
            inertia_kg_m2: &self.inertia_kg_m2,
            load_n_m: &self.load_n_m,
        };
        trial_seen_by(
            &mut *self.sensor,
            &self.machine,
            &course,
            controller,
            &self.limiter,
            cycles(seconds, self.machine.period_s),
            self.seed,
        )
    }
}

/// Whole periods in a time.
pub(in crate::workflow::reproduce) fn cycles(seconds: f64, period_s: f64) -> usize {
    whole((seconds / period_s).round())
}

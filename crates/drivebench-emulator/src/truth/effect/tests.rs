use super::super::motor::zk_22fc;
use super::super::{Plant, Terminals};
use super::*;

fn hidden(id: &str, values: &[(&str, f64)]) -> HiddenEffect {
    HiddenEffect::new(id, values).unwrap()
}

#[test]
fn ids_and_keys_differ_and_the_usual_values_are_allowed() {
    for effect in CATALOGUE {
        let alike = CATALOGUE.iter().filter(|other| other.id == effect.id);
        assert_eq!(alike.count(), 1, "{}", effect.id);
        let any_is_studied = effect.parameters.iter().any(Parameter::is_studied);
        assert_eq!(any_is_studied, effect.is_studied(), "{}", effect.id);
    }
    for effect in HiddenEffect::one_of_each() {
        assert!(!effect.parameters().is_empty(), "{}", effect.id());
        assert_eq!(effect.refused(), None, "{}", effect.id());
    }
}

#[test]
fn a_mechanism_is_finite_and_a_loss_never_feeds() {
    let site = Site::of(&zk_22fc());
    for effect in HiddenEffect::one_of_each() {
        for mut mechanism in effect.mechanisms(&site) {
            for step in 0..4000 {
                let time_s = f64::from(step) * 1e-3;
                let at = Moment {
                    time_s,
                    current_a: 6.0 * (17.0 * time_s).cos(),
                    speed_rad_s: 300.0 * (10.0 * time_s).sin(),
                    angle_rad: 30.0 * (10.0 * time_s).cos(),
                    flux_factor: 1.0,
                    torque_n_m: 2.0 * (17.0 * time_s).cos(),
                };
                mechanism.advance(50e-6, &at, 60.0);
                assert!(mechanism.drag_torque_n_m(at.speed_rad_s).is_finite());
                assert!(mechanism.load_torque_n_m(&at).is_finite());
                assert!(mechanism.voltage_loss_v(at.current_a) * at.current_a >= 0.0);
                assert!(mechanism.friction_n_m(&at) >= 0.0);
                assert!(mechanism.resistance_factor() >= 1.0);
                assert!(mechanism.breakaway_extra_n_m() >= 0.0);
                for factor in [
                    mechanism.flux_factor(&at),
                    mechanism.inductance_factor(at.current_a),
                    mechanism.supply_factor(),
                ] {
                    assert!((0.5..=1.1).contains(&factor), "{}: {factor}", effect.id());
                }
            }
            assert!(mechanism.voltage_loss_v(0.0).abs() < 1e-12);
        }
    }
}

/// A machine after `levels`, each held for 0.25 s; the number of the steps in which it moved.
fn driven(hidden: &[HiddenEffect], levels: &[f64]) -> (Plant, usize) {
    let mut plant = Plant::new(zk_22fc(), hidden);
    let mut moved = 0;
    for &volts in levels {
        for _ in 0..5000 {
            plant.advance(Terminals::Voltage(volts), 50e-6);
            moved += usize::from(plant.speed_rad_s() != 0.0);
        }
    }
    (plant, moved)
}

#[test]
fn each_effect_changes_motion_or_path_and_no_machine_at_rest() {
    // Those of one direction, of time, and of the shaft angle where they are not odd about the start are not symmetric.
    let skewed = [
        "constant_load",
        "one_sided_load",
        "asymmetric_viscous",
        "torque_ripple",
        "eccentric_load",
        "shaker",
        "random_load",
        "messy",
    ];
    let levels = [30.0, -12.0, 60.0, -50.0, 4.0];
    let (plain, _) = driven(&[], &levels);
    let site = Site::of(&zk_22fc());
    for effect in HiddenEffect::one_of_each() {
        let id = effect.id();
        let effect = std::slice::from_ref(&effect);
        // Each torque here is below the Coulomb friction.
        let (rest, moved) = driven(effect, &[0.0; 4]);
        assert_eq!(moved, 0, "{id}");
        assert!(rest.current_a() == 0.0 && rest.angle_rad() == 0.0, "{id}");
        let (plant, _) = driven(effect, &levels);
        let differs = plant.angle_rad().to_bits() != plain.angle_rad().to_bits();
        let inside = !effect[0].mechanisms(&site).is_empty() || effect[0].is_shaft();
        assert_eq!(differs, inside, "{id}");
        let is_between = effect[0].path(&site) != Path::default();
        assert!(inside || is_between, "{id} does nothing");
        assert!(plant.speed_rad_s().is_finite(), "{id}");
        let (plus, _) = driven(effect, &[30.0, -12.0]);
        let (minus, _) = driven(effect, &[-30.0, 12.0]);
        let is_mirrored = (plus.speed_rad_s() + minus.speed_rad_s()).abs() < 1e-9;
        assert_eq!(is_mirrored, !skewed.contains(&id), "{id}");
    }
}

/// At a probe point each effect does what its key says, to the share by which its form differs from the host's.
#[test]
fn at_a_probe_point_the_size_is_that_of_the_key() {
    let motor = zk_22fc();
    let site = Site::of(&motor);
    let (amps, speed) = (motor.rated_current_a, motor.rated_speed_rad_s);
    let at = Moment {
        time_s: 10.0,
        current_a: amps,
        speed_rad_s: speed,
        angle_rad: std::f64::consts::FRAC_PI_2 / 7.0,
        flux_factor: 1.0,
        torque_n_m: 2.0,
    };
    let torque =
        |m: &dyn Mechanism| m.drag_torque_n_m(speed) + m.load_torque_n_m(&at) + m.friction_n_m(&at);
    let settled = |m: &mut dyn Mechanism| {
        for _ in 0..2000 {
            m.advance(50e-6, &at, 110.0);
        }
    };
    for effect in HiddenEffect::one_of_each() {
        let Some(mut mechanism) = effect.mechanism(&site) else { continue };
        settled(mechanism.as_mut());
        let m = mechanism.as_ref();
        let (found, stated, within) = match effect.id() {
            // At the scale of the thinning, twice the rated speed: asinh(1) of it.
            "viscous_friction" => {
                (m.drag_torque_n_m(-2.0 * speed), -4e-4 * speed * 1.762_747, 1e-6)
            }
            // At half the rated speed, where the power 1.95 shows.
            "quadratic_load" => {
                let half = speed / 2.0;
                (m.drag_torque_n_m(-half), -1.8e-6 * half * half * 2.0_f64.powf(0.05), 1e-9)
            }
            "stribeck_friction" | "exponential_stribeck" => {
                // At rest.
                let still = Moment { speed_rad_s: 0.0, ..at };
                (m.breakaway_extra_n_m() + m.friction_n_m(&still), 0.16, 1e-9)
            }
            "asymmetric_viscous" => (torque(m), 1e-4 * speed, 0.011),
            // 0.1 N.m, or a twentieth of 2 N.m.
            "constant_load" | "one_sided_load" | "harmonic_cogging" | "torque_ripple" => {
                (torque(m), 0.1, 1e-9)
            }
            // An eighth of a period: the second harmonic is at its top.
            "cogging" => {
                let at = Moment { angle_rad: 0.5 * at.angle_rad, ..at };
                (m.load_torque_n_m(&at), 0.1 * (0.5_f64.sqrt() + 0.1), 1e-9)
            }
            "eccentric_load" => {
                let x = at.angle_rad;
                (torque(m), 0.1 * x.sin() + 0.05 * x.cos(), 0.25)
            }
            // 0.1 s of a time constant of 0.3 s.
            "lagged_load" => (torque(m), 1.8e-6 * speed * speed * 0.2835, 1e-3),
            "lagged_drag" => (torque(m), 4e-4 * speed * 0.2835, 1e-3),
            "load_step" => (torque(m), 0.12, 1e-9),
            "friction_onset" => (torque(m), 4e-4 * speed, 1e-9),
            "inertia_change" => (m.inertia_factor(&at), 1.3, 1e-9),
            "voltage_drop" => (m.voltage_loss_v(-0.1), -1.2 * 0.5_f64.sqrt(), 1e-9),
            "supply_sag" => (110.0 * (1.0 - m.supply_factor()), 0.4 * amps, 1e-6),
            "winding_heating" => (m.resistance_factor() - 1.0, 2e-3 * amps * amps * 0.1, 0.01),
            "flux_saturation" => (m.flux_factor(&at), 1.0 / (1.0 + 4e-4 * amps * amps), 1e-9),
            "inductance_saturation" => {
                let stated = 1.0 / (1.0 + 5e-3 * amps * amps);
                (m.inductance_factor(amps), stated, 1e-9)
            }
            "field_change" => (m.flux_factor(&at) - 1.0, -5e-3 * 10.0, 0.085),
            "discontinuous_conduction" => (m.voltage_loss_v(0.5), 0.5, 0.01),
            "shaker" => (torque(m), 0.1 * (std::f64::consts::TAU * 46.0).sin(), 1e-9),
            "torque_bump" => (m.friction_n_m(&Moment { speed_rad_s: -95.0, ..at }), 0.12, 1e-9),
            // Has no size at a point; its own test counts its spread.
            "random_load" => continue,
            "soft_drop" => (m.voltage_loss_v(0.6), 3.0 * 1.0_f64.tanh(), 1e-9),
            "fan_three_halves" => (torque(m), 3e-5 * speed.powf(1.5), 1e-9),
            // 8 % of 2 N.m, and a ramp that has ended.
            "load_dependent_friction" | "load_ramp" => (torque(m), 0.16, 1e-9),
            other => (f64::NAN, 0.0, other.len() as f64),
        };
        let error = (found - stated).abs();
        let (id, most) = (effect.id(), within * stated.abs().max(1e-12));
        assert!(error <= most, "{id}: {found} instead of {stated}");
    }
}

#[test]
fn a_second_inertia_rings_at_its_frequency_and_settles() {
    for effect in HiddenEffect::one_of_each().into_iter().filter(HiddenEffect::is_shaft) {
        let (plant, _) = driven(&[effect], &[60.0; 12]);
        let (plain, _) = driven(&[], &[60.0; 12]);
        assert!((plant.speed_rad_s() - plain.speed_rad_s()).abs() < 1e-3);
        assert!((plant.current_a() - plain.current_a()).abs() < 1e-3);
    }
    // Locked electrically out of the way: the motor's side rings after a step of the torque.
    let mut motor = zk_22fc();
    (motor.load_torque_n_m, motor.back_emf_v_s_per_rad) = (0.0, 1e-6);
    motor.torque_n_m_per_a = Some(0.3538);
    let values = [
        ("frequency_hz", 22.0),
        ("inertia_ratio", 0.4),
        ("damping_ratio", 0.0),
        ("friction_split", 0.5),
    ];
    let mut plant = Plant::new(motor, &[hidden("elastic_coupling", &values)]);
    let mut acceleration = Vec::new();
    for _ in 0..40_000 {
        let before = plant.speed_rad_s();
        plant.advance(Terminals::Voltage(1.0), 50e-6);
        acceleration.push(plant.speed_rad_s() - before);
    }
    // After the current has settled: mean crossings of a swing about a constant.
    let tail = &acceleration[4000..];
    let mean = tail.iter().sum::<f64>() / tail.len() as f64;
    let rising: Vec<usize> =
        (1..tail.len()).filter(|&k| tail[k - 1] < mean && tail[k] >= mean).collect();
    let (first, last) = (rising[0], rising[rising.len() - 1]);
    let frequency = (rising.len() - 1) as f64 / ((last - first) as f64 * 50e-6);
    assert!((frequency - 22.0).abs() < 0.1, "{frequency}");
}

#[test]
fn a_value_that_an_effect_cannot_have_is_named() {
    for (id, values, refused) in [
        (
            "cogging",
            &[("order", 6.5), ("sin_n_m", 0.1), ("cos_n_m", 0.0)][..],
            Some(("order", 6.5, "a whole number, 1 to 400")),
        ),
        ("command_delay", &[("delay_s", 2.0)], Some(("delay_s", 2.0, "0 to 1 s"))),
        ("constant_load", &[("constant_n_m", -0.1)], None),
    ] {
        assert_eq!(hidden(id, values).refused(), refused, "{id}");
    }
    for values in [&[][..], &[("delay_s", 0.1), ("delay", 1.0)]] {
        assert_eq!(HiddenEffect::new("command_delay", values), None, "{values:?}");
    }
}

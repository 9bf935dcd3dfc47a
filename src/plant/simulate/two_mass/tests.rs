use super::super::tests::{model, scenario};
use super::super::{Plant, Trajectory};
use crate::numerics::count::whole;
use crate::plant::{Input, State};

/// Reversals, a creep through zero and holds at rest.
const EVENTS: [(f64, f64); 8] = [
    (0.0, 0.0),
    (0.05, 20.0),
    (0.25, -12.0),
    (0.5, 2.0),
    (0.6, -1.0),
    (0.7, 3.0),
    (0.8, 0.0),
    (0.95, -30.0),
];

fn run(effects: &[(&str, &[f64])], period_s: f64, until_s: f64) -> Trajectory {
    Plant::new(&model(effects), Input::Voltage)
        .unwrap()
        .simulate(
            &scenario(
                EVENTS.to_vec(),
                period_s,
                whole((until_s / period_s).round()) + 1,
            ),
            State::default(),
        )
}

/// Frequency, inertia ratio, damping ratio, friction split, gap.
type Values = [f64; 5];

fn coupled(values: &Values) -> Vec<(&'static str, Vec<f64>)> {
    let [f, r, zeta, split, gap] = *values;
    if gap == 0.0 {
        vec![("elastic_coupling", vec![f, r, zeta, split])]
    } else {
        vec![("backlash", vec![gap, f, r, zeta, split])]
    }
}

fn simulated(values: &Values, drag: f64, period_s: f64, until_s: f64) -> Trajectory {
    let drag_values = [drag];
    let owned = coupled(values);
    let mut effects: Vec<(&str, &[f64])> = owned
        .iter()
        .map(|(id, values)| (*id, &values[..]))
        .collect();
    if drag != 0.0 {
        effects.push(("viscous_friction", &drag_values));
    }
    run(&effects, period_s, until_s)
}

/// Independent formulation: small fourth-order Runge-Kutta steps, friction regularised over a very narrow band of
/// speed. Current and motor speed every millisecond.
fn reference(values: &Values, drag: f64, until_s: f64) -> Vec<(f64, f64)> {
    let (r, l, ke, j, mc) = (1.1, 0.0099, 0.3538, 0.0045, 0.455);
    let [f, share, zeta, split, gap] = *values;
    let (j1, j2) = (j * (1.0 - share), j * share);
    let k = (std::f64::consts::TAU * f).powi(2) * j * share * (1.0 - share);
    let d = 2.0 * zeta * (k * j * share * (1.0 - share)).sqrt();
    let per_sample = 500;
    let h = 1e-3 / f64::from(per_sample);
    let mut x = [0.0f64; 4];
    let mut out = vec![(0.0, 0.0)];
    let mut step = 0;
    while out.len() <= whole((until_s / 1e-3).round()) {
        let t = f64::from(step) * h;
        let u = EVENTS
            .iter()
            .rev()
            .find(|(at, _)| *at <= t + 1e-12)
            .unwrap()
            .1;
        let rates = |x: [f64; 4]| {
            let [i, w, w2, twist] = x;
            let z = twist - twist.clamp(-0.5 * gap, 0.5 * gap);
            let shaft = k * z + d * (w - w2);
            [
                (u - r * i - ke * w) / l,
                (ke * i - drag * w - (1.0 - split) * mc * (w / 1e-3).tanh() - shaft) / j1,
                (shaft - split * mc * (w2 / 1e-3).tanh()) / j2,
                w - w2,
            ]
        };
        let along = |k: [f64; 4], s: f64| [0, 1, 2, 3].map(|n| x[n] + s * k[n]);
        let k1 = rates(x);
        let k2 = rates(along(k1, h / 2.0));
        let k3 = rates(along(k2, h / 2.0));
        let k4 = rates(along(k3, h));
        x = [0, 1, 2, 3].map(|n| x[n] + h / 6.0 * (k1[n] + 2.0 * (k2[n] + k3[n]) + k4[n]));
        step += 1;
        if step % per_sample == 0 {
            out.push((x[0], x[1]));
        }
    }
    out
}

#[test]
fn it_agrees_with_tiny_regularised_steps() {
    for (values, drag) in [
        ([24.0, 0.55, 0.02, 0.5, 0.0], 0.0),
        ([48.0, 0.35, 0.1, 0.3, 0.0], 0.0),
        ([13.0, 0.7, 0.03, 0.8, 0.0], 4e-3),
        ([35.0, 0.5, 0.03, 0.4, 0.04], 0.0),
        ([55.0, 0.35, 0.05, 0.5, 0.08], 2e-3),
    ] {
        let out = simulated(&values, drag, 0.001, 1.1);
        let expected = reference(&values, drag, 1.1);
        let mut most = (0.0_f64, 0.0_f64);
        for (sample, (i, w)) in expected.iter().enumerate() {
            most.0 = most.0.max((out.current_a[sample] - i).abs());
            most.1 = most.1.max((out.speed_rad_s[sample] - w).abs());
        }
        assert!(
            most.0 < 0.01 && most.1 < 0.02,
            "{values:?} {drag}: {most:?}"
        );
    }
}

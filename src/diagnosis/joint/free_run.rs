//! Error of a free run that no model can foretell: of a load that wanders, and of a voltage that nobody knows.

use super::asked::prepared;
use super::columns::Around;
use super::follow::{Noise, P, Passage, predicted, stop};
use crate::plant::{Model, Scenario, State};

/// Root mean squares of current, A, and speed, rad/s, that the disturbance of a followed run makes where nothing leads the
/// model: what no model can foretell.
pub(super) fn wandering(run: &Around<'_>) -> [f64; 2] {
    carried(run, &run.noise, |_| [0.0; 2])
}

/// The same of what the holes of its record make: no model can foretell what nobody knows to have been commanded.
pub(super) fn unseen(run: &Around<'_>) -> [f64; 2] {
    let calm = Noise {
        disturbance_n_m: 0.0,
        input: 0.0,
        ..run.noise
    };
    carried(run, &calm, |passage| passage.unseen)
}

/// What the holes of a run make that the answer does not rest on; none where the model cannot be followed on it.
pub(in crate::diagnosis) fn unseen_in(
    run: &Scenario,
    model: &Model,
    noise: Noise,
    noise_is_known: bool,
) -> Option<[f64; 2]> {
    let run = prepared(run, noise_is_known);
    Around::new(model, &run, State::default(), noise).map(|run| unseen(&run))
}

/// What a free run carries of a disturbance and of what comes `fresh` with each passage.
fn carried(run: &Around<'_>, noise: &Noise, fresh: impl Fn(&Passage) -> [f64; 2]) -> [f64; 2] {
    let mut p: P = [[0.0; 4]; 4];
    p[2][2] = noise.disturbance_n_m.powi(2);
    p[3][3] = noise.input.powi(2);
    let mut squares = [0.0; 2];
    for (passage, forget) in run.follower.passages.iter().zip(&run.follower.forgets) {
        let fresh = fresh(passage);
        let passage = Passage {
            form: [0.0; 3],
            fresh,
            unseen: fresh,
            ..*passage
        };
        if passage.begins_again {
            p[0] = [0.0; 4];
            for row in &mut p {
                row[0] = 0.0;
            }
            stop(&mut p);
        }
        p = predicted(&p, &passage, &run.dynamics, noise, *forget);
        if passage.direction == 0.0 {
            stop(&mut p);
        }
        squares[0] += p[0][0];
        squares[1] += p[1][1];
    }
    let count = run.follower.passages.len().max(1) as f64;
    squares.map(|square: f64| (square / count).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnosis::joint::follow::QUIET;
    use crate::plant::Motor;
    use crate::plant::testing::record;

    #[test]
    fn a_free_run_carries_what_a_hole_hides_as_the_equations_do() {
        let model = Model::baseline(Motor::zk_22fc());
        let [known, other] = [20.0, 23.0].map(|hidden_v| {
            let events = vec![(0.0, 20.0), (0.5, hidden_v), (0.51, 20.0)];
            record(&model, events, 1e-2, 1.0, 3)
        });
        let mut scenario = known.clone();
        scenario.unknown_input = vec![crate::plant::UnknownInput {
            from_s: 0.5,
            to_s: 0.51,
            lost_rows: 1,
            mean: 20.0,
            beside: [0.0; 3],
            variance: 9.0,
            restart: None,
        }];
        let run = Around::new(&model, &scenario, State::default(), QUIET).unwrap();
        let rms = |a: &[f64], b: &[f64]| {
            let squares: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
            (squares / a.len() as f64).sqrt()
        };
        // Both records have the same noise: they differ by what the voltage made.
        let truth = [
            rms(&known.current_a, &other.current_a),
            rms(&known.speed_rad_s, &other.speed_rad_s),
        ];
        for (found, truth) in unseen(&run).into_iter().zip(truth) {
            assert!((found / truth - 1.0).abs() < 0.1, "{found}, not {truth}");
        }
        let whole = Around::new(&model, &known, State::default(), QUIET).unwrap();
        assert!(unseen(&whole).iter().all(|rms| *rms <= 0.0));
        // A load that wanders knows nothing of holes.
        let difference = wandering(&run)[0] / wandering(&whole)[0] - 1.0;
        assert!(difference.abs() < 1e-9, "{difference}");
    }
}

use super::{Card, Effect, Enters, ParameterSpec, Path, Terms};

/// Drive that lets every start from rest wait: it applies zero for a while after each.
pub(super) struct RestartDelay;

struct Wait(f64);

impl Effect for RestartDelay {
    fn card(&self) -> &'static Card {
        &Card {
            id: "restart_delay",
            name: "delay at each start",
            enters: Enters::Path,
            equation: "u = 0 for Td after every command that is not zero and follows 0.2 s of zero, then as commanded",
            causes: "a drive that enables its output stage, magnetises or releases a brake anew for each start from \
                     rest; a start delay that is set in its parameters. The drive's manual tells which",
            looks_like: "neither current nor speed for the same time after each start from rest; changes while it \
                         turns come at once",
            excite: "start from rest more than once in a run: with one start it is a start delay",
            remedy: "take the delay out of the drive's parameters; keep the output stage enabled between starts; \
                     count the time into the cycle",
            needs_angle: false,
        }
    }

    fn parameters(&self) -> &'static [ParameterSpec] {
        // A shape, as that of a start delay.
        const P: &[ParameterSpec] = &[ParameterSpec::shape(
            "delay_s",
            "s",
            (1e-4, 5.0),
            &[0.003, 0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7],
        )];
        P
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        Box::new(Wait(values[0]))
    }
}

impl Terms for Wait {
    fn path(&self) -> Path {
        Path {
            restart_delay_s: self.0,
            ..Path::default()
        }
    }
}

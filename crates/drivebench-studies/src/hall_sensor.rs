//! Speed sensor of paper B: Hall edges.

use drivebench::control::SpeedSensor;

/// Speed from Hall edges: the angle between two edges over the time between them, held until the next edge.
///
/// With p pole pairs there are 6 p edges per turn (paper B: 12). The reading is a mean over the last interval, so it is old
/// by half an interval when the edge comes and by up to one and a half before the next. Where the next edge is late, the
/// shaft cannot be faster than one edge in the time waited: the reading falls accordingly.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HallSensor {
    edge_rad: f64,
    last: Option<(f64, f64)>,
    edge: Option<Edge>,
    speed_rad_s: f64,
}

#[derive(Clone, Copy, Debug)]
struct Edge {
    time_s: f64,
    index: f64,
}

impl HallSensor {
    /// `edges_per_turn` above zero.
    pub(crate) fn new(edges_per_turn: f64) -> Self {
        Self {
            edge_rad: std::f64::consts::TAU / edges_per_turn,
            last: None,
            edge: None,
            speed_rad_s: 0.0,
        }
    }

    fn passes(&mut self, time_s: f64, index: f64) {
        // The same edge passed again is a reversal: its speed is not known from one edge.
        self.speed_rad_s = match self.edge {
            Some(edge) if (edge.index - index).abs() > 0.5 && time_s > edge.time_s => {
                (index - edge.index) * self.edge_rad / (time_s - edge.time_s)
            }
            _ => 0.0,
        };
        self.edge = Some(Edge { time_s, index });
    }
}

impl SpeedSensor for HallSensor {
    fn turned(&mut self, time_s: f64, angle_rad: f64) {
        // Edges lie between whole numbers, so that a shaft at angle zero is on none.
        let now = angle_rad / self.edge_rad - 0.5;
        let Some((last_s, last)) = self.last.replace((time_s, now)) else {
            return;
        };
        let at = |index: f64| last_s + (time_s - last_s) * (index - last) / (now - last);
        let (lowest, highest) = (last.min(now).floor() + 1.0, last.max(now).floor());
        // Downwards the edges come in the other order.
        let (mut index, step) = if now < last { (highest, -1.0) } else { (lowest, 1.0) };
        while (lowest..=highest).contains(&index) {
            self.passes(at(index), index);
            index += step;
        }
    }

    fn read(&mut self, time_s: f64, _speed_rad_s: f64) -> f64 {
        let Some(edge) = self.edge else {
            return 0.0;
        };
        // Infinite where the edge comes in this very instant.
        let most = self.edge_rad / (time_s - edge.time_s).max(0.0);
        self.speed_rad_s.clamp(-most, most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Readings every millisecond of a shaft at `angle(t)`, with its true time.
    fn readings(angle: impl Fn(f64) -> f64) -> Vec<(f64, f64)> {
        let mut hall = HallSensor::new(12.0);
        let mut found = Vec::new();
        for n in 0..20_000_u32 {
            let t = f64::from(n) * 5e-5;
            hall.turned(t, angle(t));
            if n % 20 == 0 {
                found.push((t, hall.read(t, f64::NAN)));
            }
        }
        found
    }

    #[test]
    fn at_constant_speed_either_way_the_edges_tell_it_exactly() {
        for speed in [80.0, -80.0, 3.0] {
            let found = readings(|t| speed * t);
            for (t, read) in found.iter().filter(|(t, _)| *t > 0.4) {
                assert!((read - speed).abs() < 1e-6 * speed.abs(), "{t} {read}");
            }
        }
    }

    #[test]
    fn under_acceleration_it_is_late_by_one_interval() {
        let rate = 100.0;
        let found = readings(|t| 50.0 * t + 0.5 * rate * t * t);
        let lag: Vec<f64> =
            found[500..].iter().map(|(t, read)| (50.0 + rate * t - read) / rate).collect();
        let mean = lag.iter().sum::<f64>() / lag.len() as f64;
        // About one interval in the mean: half of it within, half of it waiting.
        let interval_s = std::f64::consts::TAU / 12.0 / 125.0;
        assert!((mean / interval_s - 1.0).abs() < 0.1, "{mean}");
    }

    #[test]
    fn the_speed_of_a_stopped_shaft_decays() {
        let found = readings(|t| 50.0 * t.min(0.5));
        assert!(found[510].1 > 20.0);
        let last = found[999];
        assert!(last.1 > 0.0 && last.1 < 1.1, "{last:?}");
    }
}

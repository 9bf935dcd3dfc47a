//! Robust margins: the closed loops of one set of gains around the plant and each of its draws.

use std::cell::RefCell;

use super::{Draws, is_safe};
use crate::{LinearPlant, LoopShape, LoopTiming, Margins, PiGains};

/// A loop and, where its coupling has backlash, that of the motor alone within it, which only has to be stable.
pub(super) struct ClosedLoop {
    coupled: LoopShape,
    uncoupled: Option<LoopShape>,
}

impl ClosedLoop {
    fn new(plant: &LinearPlant, timing: &LoopTiming) -> Self {
        // Any gains: each request brings its own.
        let gains = PiGains {
            proportional: 0.0,
            integral_time_s: 1.0,
            reference_filter_s: 0.0,
            notch: None,
        };
        let shape = |plant: &LinearPlant| LoopShape::new(plant, timing, &gains);
        Self { coupled: shape(plant), uncoupled: plant.uncoupled().as_ref().map(shape) }
    }

    fn margins(&self, gains: &PiGains) -> Margins {
        let mut margins = self.coupled.with_gains(gains).margins();
        if let Some(uncoupled) = &self.uncoupled {
            margins.radius = margins.radius.max(uncoupled.with_gains(gains).radius());
        }
        margins
    }
}

pub(super) struct Loops {
    nominal: ClosedLoop,
    pub(super) draws: Vec<ClosedLoop>,
    /// Order in which draws are checked: the one that failed last comes first.
    order: RefCell<Vec<usize>>,
}

impl Loops {
    pub(super) fn new(plant: &LinearPlant, draws: &[LinearPlant], timing: &LoopTiming) -> Self {
        Self {
            nominal: ClosedLoop::new(plant, timing),
            draws: draws.iter().map(|plant| ClosedLoop::new(plant, timing)).collect(),
            order: RefCell::new((0..draws.len()).collect()),
        }
    }

    pub(super) fn nominal(&self, gains: &PiGains) -> LoopShape {
        self.nominal.coupled.with_gains(gains)
    }

    pub(super) fn margins(&self, gains: &PiGains) -> Margins {
        self.nominal.margins(gains)
    }

    /// Whether the plant and every draw of it have their margins.
    pub(super) fn hold(&self, gains: &PiGains) -> bool {
        let holds = |one: &ClosedLoop| is_safe(&one.margins(gains));
        if !holds(&self.nominal) {
            return false;
        }
        let mut order = self.order.borrow_mut();
        let fails = order.iter().position(|draw| !holds(&self.draws[*draw]));
        if let Some(index) = fails {
            order[..=index].rotate_right(1);
        }
        fails.is_none()
    }

    /// Margins over the draws, whose plants these are; `None` without any.
    pub(super) fn draws(&self, gains: &PiGains, plants: &[LinearPlant]) -> Option<Draws> {
        let all: Vec<Margins> = self.draws.iter().map(|draw| draw.margins(gains)).collect();
        let worst = all.iter().copied().reduce(|one, other| Margins {
            phase_margin_deg: one.phase_margin_deg.min(other.phase_margin_deg),
            gain_margin: one.gain_margin.min(other.gain_margin),
            crossover_rad_s: one.crossover_rad_s.min(other.crossover_rad_s),
            bandwidth_rad_s: one.bandwidth_rad_s.min(other.bandwidth_rad_s),
            radius: one.radius.max(other.radius),
        })?;
        let stable = all.iter().filter(|margins| margins.radius < 1.0).count();
        let mut hardest: Vec<usize> = (0..all.len()).collect();
        // Eight are kept, half of them with the least phase margin, half with the least gain margin.
        let least = |of: fn(&Margins) -> f64, order: &mut [usize]| {
            order.sort_by(|one, other| of(&all[*one]).total_cmp(&of(&all[*other])));
        };
        least(|margins| margins.phase_margin_deg, &mut hardest);
        let by_phase = hardest.len().min(4);
        least(|margins| margins.gain_margin, &mut hardest[by_phase..]);
        hardest.truncate(8);
        Some(Draws {
            count: all.len(),
            worst,
            stable_share: stable as f64 / all.len() as f64,
            hardest: hardest.iter().map(|draw| plants[*draw]).collect(),
        })
    }
}

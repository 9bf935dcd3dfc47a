//! The angle of the shaft and its harmonics.

use crate::numerics::count::whole;

/// An angle of the shaft, with its sine and cosine: effects use them many times at each instant.
#[derive(Clone, Copy, Debug)]
pub struct ShaftAngle {
    rad: f64,
    sin_cos: [f64; 2],
}

impl Default for ShaftAngle {
    fn default() -> Self {
        Self { rad: 0.0, sin_cos: [0.0, 1.0] }
    }
}

impl ShaftAngle {
    pub fn at(rad: f64) -> Self {
        Self { rad, sin_cos: rad.sin_cos().into() }
    }

    pub const fn rad(&self) -> f64 {
        self.rad
    }

    /// Sine and cosine of `order` times the angle: a whole order up to 200 as a power of `exp(i angle)` (de Moivre) by repeated
    /// squaring, whose rounding grows with the order.
    pub fn wave(&self, order: f64) -> [f64; 2] {
        let is_whole = order.fract() == 0.0 && (0.0..=200.0).contains(&order);
        if !is_whole {
            return (order * self.rad).sin_cos().into();
        }
        let (mut bits, mut power, mut wave) = (whole(order), self.sin_cos, [0.0, 1.0]);
        while bits > 0 {
            if bits % 2 == 1 {
                wave = of_sum(wave, power);
            }
            bits /= 2;
            if bits > 0 {
                power = of_sum(power, power);
            }
        }
        wave
    }

    /// The next higher harmonic after `wave`.
    pub fn next_wave(&self, wave: [f64; 2]) -> [f64; 2] {
        of_sum(wave, self.sin_cos)
    }
}

/// Sine and cosine of the sum of two angles (addition theorem).
fn of_sum([sin_a, cos_a]: [f64; 2], [sin_b, cos_b]: [f64; 2]) -> [f64; 2] {
    [sin_a * cos_b + cos_a * sin_b, cos_a * cos_b - sin_a * sin_b]
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn a_wave_is_the_sine_of_so_many_times_the_angle() {
        for rad in [-0.3, 0.0, 1.1, 12.5] {
            let angle = ShaftAngle::at(rad);
            for order in [0.0, 1.0, 2.0, 7.0, 24.0, 200.0, 201.0, 1000.0, 2.5, -3.0] {
                let wave = angle.wave(order);
                for (wave, order) in [(wave, order), (angle.next_wave(wave), order + 1.0)] {
                    let (sin, cos) = (order * rad).sin_cos();
                    let off = (wave[0] - sin).abs().max((wave[1] - cos).abs());
                    assert!(off < 1e-12, "{order} times {rad}: {off}");
                }
            }
        }
        assert!(ShaftAngle::at(f64::NAN).wave(3.0)[0].is_nan());
        let none = ShaftAngle::default();
        let bits = [none.rad(), none.wave(7.0)[0], none.wave(7.0)[1]].map(f64::to_bits);
        assert_eq!(bits, [0.0_f64, 0.0, 1.0].map(f64::to_bits));
    }
}

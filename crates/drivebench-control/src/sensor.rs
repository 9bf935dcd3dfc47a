//! Speed sensor of a simulated trial.

/// Turns the shaft's movement into the speed that the controller is told.
pub trait SpeedSensor {
    /// The shaft has reached an angle, rad; called many times per period, time and angle without gaps.
    fn turned(&mut self, _time_s: f64, _angle_rad: f64) {}

    /// The reading of this instant; `speed_rad_s` is the true speed.
    fn read(&mut self, time_s: f64, speed_rad_s: f64) -> f64;
}

/// The true speed.
#[derive(Clone, Copy, Debug, Default)]
pub struct Direct;

impl SpeedSensor for Direct {
    fn read(&mut self, _time_s: f64, speed_rad_s: f64) -> f64 {
        speed_rad_s
    }
}

//! Thresholds of belief. Shares are of the rated values, or of the limits where nothing is rated.

use super::Range;

pub struct Settings {
    /// Latency that is allowed, the later of the two: with it the drive's own filters and a late reply are no fault.
    pub latency_s: f64,
    pub latency_cycles: usize,
    /// Rows of a window where the drive stamps its samples, and at the most: a fault has to be found in time.
    pub stamped_rows: usize,
    pub most_rows: usize,
    /// Longest time between the two samples of a row, s: over a longer one a mean of the two says nothing.
    pub longest_row_s: f64,
    /// Consecutive windows that have to disagree: one may hold a disturbance.
    pub confirming_windows: usize,
    /// Factors by which any reading, or any value of the nameplate, may be off.
    pub any_factor: Range,
    /// The same for a warm winding, for the flux of another specimen, and for a voltage whose scale is proven.
    pub winding_factor: Range,
    pub flux_factor: Range,
    pub known_scale: Range,
    /// Relative tolerance of catalogues, load and temperature of the winding included.
    pub catalogue: f64,
    /// Logarithm of a ratio of back-EMF constants by which it still shows a unit: temperature moves it by some per cent.
    pub unit: f64,
    /// Constant voltage drop, share: brushes, bridge, offset.
    pub drop: f64,
    /// A current that counts as none, share: above the offset of a sensor, below the friction of any motor.
    pub idle_current: f64,
    /// A speed and a voltage that count as none, share: a drift and the vibration of a shaft are below it.
    pub rest: f64,
    /// A speed and a voltage that count as clearly some, share: above every drop.
    pub clear: f64,
    /// The least term of a balance whose sign can be judged, share: below it lie the drops of brushes.
    pub judged: f64,
    /// Part of a contradiction that may be left by what explains it, and of a change by what follows it.
    pub left: f64,
    /// Deviation of a controlled quantity from its set-point, and its change between two samples of a steady state, share.
    pub follows: f64,
    /// Change of its set-point in a steady state, share: a loop gives several volts for each ampere.
    pub steady_command: f64,
    /// Time within which a set-point is followed, s: of a current, and of a speed, with the unknown ramp of the drive.
    pub current_follows_s: f64,
    pub speed_follows_s: f64,
    /// Duration of a contradiction without a current, s: a drive may be slow to switch its output on.
    pub idle_s: f64,
    /// A current of zero while the shaft speeds up by this share within this time, s, more than any load pulls it.
    pub driven_speed: f64,
    pub driven_s: f64,
    /// From this share of the rated current, or of its own limit, on a drive may limit without reporting it.
    pub limiting_current: f64,
    /// Duration of a standstill, s, under a current that exceeds that of the nameplate's friction by this factor.
    pub standing_s: f64,
    pub standing_friction: f64,
    /// Readings equal to the bit while the back-EMF changes, and cycles of a runaway: three may be chance or latency.
    pub repeated: usize,
    /// Memory of the regression over both balances: time constant, s, and least rows.
    pub memory_s: f64,
    pub memory_rows: f64,
    /// Half-width of the interval of an estimate, in standard deviations.
    pub sigmas: f64,
    /// Standard deviations at rest beyond which something moves or flows: the largest of many samples of noise lies below.
    pub clear_std: f64,
    /// Noise of a row's voltage and torque, shares.
    pub voltage_noise: f64,
    pub torque_noise: f64,
    /// Prior standard deviations of the factors of flux, of friction, and of an unknown one.
    pub flux_std: f64,
    pub friction_std: f64,
    pub unknown_std: f64,
    /// Least probability of a run of equal readings, and its least length.
    pub repeat_chance: f64,
    pub fewest_repeats: usize,
    /// Readings at rest needed for the share of repeats.
    pub rest_readings: usize,
    /// A sensor with fewer repeats than this share has electrical noise, not only the vibration of a shaft.
    pub seldom_repeats: f64,
}

pub const SETTINGS: Settings = Settings {
    latency_s: 0.2,
    latency_cycles: 5,
    stamped_rows: 3,
    most_rows: 20,
    longest_row_s: 0.5,
    confirming_windows: 2,
    any_factor: Range::new(0.5, 2.0),
    winding_factor: Range::new(0.6, 1.5),
    flux_factor: Range::new(0.7, 1.4),
    known_scale: Range::new(0.85, 1.15),
    catalogue: 0.3,
    unit: 0.15,
    drop: 0.04,
    idle_current: 0.02,
    rest: 0.01,
    clear: 0.05,
    judged: 0.015,
    left: 0.25,
    follows: 0.1,
    steady_command: 0.03,
    current_follows_s: 0.4,
    speed_follows_s: 2.0,
    idle_s: 0.3,
    driven_speed: 0.08,
    driven_s: 0.4,
    limiting_current: 0.85,
    standing_s: 0.5,
    standing_friction: 1.7,
    repeated: 4,
    memory_s: 0.25,
    memory_rows: 10.0,
    sigmas: 3.0,
    clear_std: 6.0,
    voltage_noise: 0.005,
    torque_noise: 0.05,
    flux_std: 0.5,
    friction_std: 1.0,
    unknown_std: 10.0,
    repeat_chance: 1e-9,
    fewest_repeats: 8,
    rest_readings: 3,
    seldom_repeats: 0.35,
};

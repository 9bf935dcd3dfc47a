//! Thresholds of the plausibility watch. Shares are of the rated values, or of the limits where nothing is rated.

use super::history::Range;

pub(super) struct Settings {
    /// Commands and samples kept, at most.
    pub(super) commands: usize,
    pub(super) samples: usize,
    /// Latency that is allowed: the later of the two; with it the drive's own filters and a late reply are no fault.
    pub(super) latency_s: f64,
    pub(super) latency_cycles: usize,
    /// Rows of a window where the drive stamps its samples, and at the most: a fault has to be found in time.
    pub(super) stamped_rows: usize,
    pub(super) most_rows: usize,
    /// Consecutive windows that have to disagree: one may hold a disturbance.
    pub(super) confirming_windows: usize,
    /// Factors by which any reading, or any value of the nameplate, may be off.
    pub(super) any_factor: Range,
    /// The same for a warm winding and for the flux of another specimen.
    pub(super) winding_factor: Range,
    pub(super) flux_factor: Range,
    /// Constant voltage drop, share: brushes, bridge, offset.
    pub(super) drop: f64,
    /// A current and a speed that count as none, shares; a voltage that counts as a change.
    pub(super) idle_current: f64,
    pub(super) rest_speed: f64,
    pub(super) rest_voltage: f64,
    /// A voltage and a speed that count as clearly moved, shares.
    pub(super) moved_voltage: f64,
    pub(super) moved_speed: f64,
    /// A back-EMF that proves the encoder's direction, share.
    pub(super) proven_voltage: f64,
    /// Duration of a contradiction without a current, s: a drive may be slow to switch its output on.
    pub(super) idle_s: f64,
    /// Readings equal to the bit that count as frozen while the back-EMF changes.
    pub(super) frozen_readings: usize,
    /// A current of zero while the shaft speeds up by this share within this time, s.
    pub(super) driven_speed: f64,
    pub(super) driven_s: f64,
    /// From this share of the rated current, or of its own limit, on a drive may limit without reporting it.
    pub(super) limiting_current: f64,
    /// Duration of a standstill, s, under a current that exceeds that of the nameplate's friction by this factor.
    pub(super) standing_s: f64,
    pub(super) standing_friction: f64,
    /// Time within which a set-point is followed, s: of a current, and of a speed, with the unknown ramp of the drive.
    pub(super) current_follows_s: f64,
    pub(super) speed_follows_s: f64,
    /// Deviation of current or speed from the set-point that is allowed, share.
    pub(super) follows: f64,
    /// A voltage is stuck if its set-point has moved by this share, and the voltage by less than this part of that.
    pub(super) stuck_voltage: f64,
    pub(super) stuck_part: f64,
    /// Factors by which a voltage may be off whose scale is proven.
    pub(super) known_scale: Range,
    /// A runaway: cycles in which the speed grows against the torque, by this share of the speed limit and from this share
    /// beyond the reference.
    pub(super) runaway_cycles: usize,
    pub(super) runaway_growth: f64,
    pub(super) runaway_beyond: f64,
    /// Memory of the regression over both balances: time constant, s, and least rows.
    pub(super) memory_s: f64,
    pub(super) memory_rows: f64,
    /// Half-width of the interval of an estimate, in standard deviations.
    pub(super) sigmas: f64,
    /// Noise of a row's voltage and torque, shares.
    pub(super) voltage_noise: f64,
    pub(super) torque_noise: f64,
    /// Prior standard deviations: of the factor of the flux, of the drop (share), of the factor of friction, and of an unknown
    /// factor.
    pub(super) flux_std: f64,
    pub(super) drop_std: f64,
    pub(super) friction_std: f64,
    pub(super) unknown_std: f64,
    /// Longest time between the two samples of a row, s.
    pub(super) longest_row_s: f64,
    /// Between two samples voltage, current and command may move by these shares, and the measured voltage still counts as
    /// the one in force behind a drive's own current loop: such a loop follows a step within a part of a cycle, with several
    /// volts for each ampere.
    pub(super) steady_voltage: f64,
    pub(super) steady_current: f64,
    pub(super) steady_command: f64,
    /// Least probability of a run of equal readings, and its least length.
    pub(super) repeat_chance: f64,
    pub(super) fewest_repeats: usize,
    /// Readings at rest needed for the share of repeats.
    pub(super) rest_readings: usize,
    /// A sensor with fewer repeats than this share has electrical noise, not only the vibration of a shaft.
    pub(super) seldom_repeats: f64,
}

pub(super) const SETTINGS: Settings = Settings {
    commands: 128,
    samples: 64,
    latency_s: 0.2,
    latency_cycles: 5,
    stamped_rows: 3,
    most_rows: 20,
    confirming_windows: 2,
    any_factor: Range::new(0.5, 2.0),
    winding_factor: Range::new(0.6, 1.5),
    flux_factor: Range::new(0.7, 1.4),
    drop: 0.04,
    idle_current: 0.02,
    rest_speed: 0.01,
    rest_voltage: 0.01,
    moved_voltage: 0.015,
    moved_speed: 0.05,
    proven_voltage: 0.045,
    idle_s: 0.3,
    frozen_readings: 4,
    driven_speed: 0.08,
    driven_s: 0.4,
    limiting_current: 0.85,
    standing_s: 0.5,
    standing_friction: 1.7,
    current_follows_s: 0.4,
    speed_follows_s: 2.0,
    follows: 0.1,
    stuck_voltage: 0.06,
    stuck_part: 0.25,
    known_scale: Range::new(0.85, 1.15),
    runaway_cycles: 4,
    runaway_growth: 0.01,
    runaway_beyond: 0.05,
    memory_s: 0.25,
    memory_rows: 10.0,
    sigmas: 3.0,
    voltage_noise: 0.005,
    torque_noise: 0.05,
    flux_std: 0.5,
    drop_std: 0.02,
    friction_std: 1.0,
    unknown_std: 10.0,
    longest_row_s: 0.5,
    steady_voltage: 0.05,
    steady_current: 0.1,
    steady_command: 0.03,
    repeat_chance: 1e-9,
    fewest_repeats: 8,
    rest_readings: 3,
    seldom_repeats: 0.35,
};

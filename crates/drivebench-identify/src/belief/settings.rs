//! Thresholds of belief. Shares are of the rated values, or of the limits where nothing is rated.

use super::Range;

pub struct Settings;

impl Settings {
    /// Latency that is allowed, the later of the two: with it the drive's own filters and a late reply are no fault.
    pub const LATENCY_S: f64 = 0.2;
    pub const LATENCY_CYCLES: usize = 5;
    /// Rows of a window where the drive stamps its samples, and at the most: a fault has to be found in time.
    pub const STAMPED_ROWS: usize = 3;
    pub const MOST_ROWS: usize = 20;
    /// Consecutive windows that have to disagree: one may hold a disturbance.
    pub const CONFIRMING_WINDOWS: usize = 2;
    /// Factors by which any reading, or any value of the nameplate, may be off.
    pub const ANY_FACTOR: Range = Range::new(0.5, 2.0);
    /// The same for a warm winding, for the flux of another specimen, and for a voltage whose scale is proven.
    pub const WINDING_FACTOR: Range = Range::new(0.6, 1.5);
    pub const FLUX_FACTOR: Range = Range::new(0.7, 1.4);
    pub const KNOWN_SCALE: Range = Range::new(0.85, 1.15);
    /// Relative tolerance of catalogues, load and temperature of the winding included.
    pub const CATALOGUE: f64 = 0.3;
    /// Logarithm of a ratio of back-EMF constants by which it still shows a unit: temperature moves it by some per cent.
    pub const UNIT: f64 = 0.15;
    /// Constant voltage drop, share: brushes, bridge, offset.
    pub const DROP: f64 = 0.04;
    /// A current that counts as none, share: above the offset of a sensor, below the friction of any motor.
    pub const IDLE_CURRENT: f64 = 0.02;
    /// A speed and a voltage that count as none, share: a drift and the vibration of a shaft are below it.
    pub const REST: f64 = 0.01;
    /// A speed and a voltage that count as clearly some, share: above every drop.
    pub const CLEAR: f64 = 0.05;
    /// The least term of a balance whose sign can be judged, share: below it lie the drops of brushes.
    pub const JUDGED: f64 = 0.015;
    /// Of the range of a record's signal: a change that counts as one, and what is clearly away, which no noise and no drift is.
    pub const CHANGES: f64 = 0.1;
    pub const FAR: f64 = 0.2;
    /// Share of a contradiction that its explanation may leave unexplained, and of a change that its response may.
    pub const UNEXPLAINED: f64 = 0.25;
    /// Deviation of a controlled quantity from its set-point, and its change between two samples of a steady state, share.
    pub const FOLLOWS: f64 = 0.1;
    /// Duration of a contradiction without a current, s: a drive may be slow to switch its output on.
    pub const IDLE_S: f64 = 0.3;
    /// From this share of the rated current, or of its own limit, on a drive may limit without reporting it.
    pub const LIMITING_CURRENT: f64 = 0.85;
    /// Readings equal to the bit while the back-EMF changes, and cycles of a runaway: three may be chance or latency.
    pub const REPEATED: usize = 4;
    /// Half-width of the interval of an estimate, in standard deviations.
    pub const SIGMAS: f64 = 3.0;
    /// Standard deviations at rest beyond which something moves or flows: the largest of many samples of noise lies below.
    pub const CLEAR_STD: f64 = 6.0;
    /// Least length of a run of equal readings that is not by chance.
    pub const FEWEST_REPEATS: usize = 8;
}

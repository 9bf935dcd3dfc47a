//! Readings that contradict the balances, and which of them is wrong.

use super::{CHECK_CURRENT, CHECK_ENCODER, CHECK_SET_POINT, Plausibility, RepetitionStart};
use crate::trip::{Trip, TripKind};
use drivebench_identify::belief::{Plate, Range, Reading, Row, Settings, Window};

impl Plausibility {
    /// Faults by the voltage balance.
    pub(super) fn by_balance(&mut self) -> Option<Trip> {
        let plate = self.plate?;
        if let Some(trip) = self.by_factor(&plate) {
            return Some(trip);
        }
        if self.is_idle() {
            self.symptoms.misfits = 0;
            return self.idle(&plate);
        }
        self.symptoms.idle_since_s = None;
        let Some(window) = self.window(&plate, self.window_rows()) else {
            self.symptoms.misfits = 0;
            return None;
        };
        if let Some(trip) = self.frozen(&plate, &window) {
            return Some(trip);
        }
        let misfits = !self.waived && window.misfits(self.drop_v());
        if misfits || self.accelerates_against_current(&window) {
            self.symptoms.misfits += 1;
            let is_confirmed = self.symptoms.misfits >= Settings::CONFIRMING_WINDOWS;
            return is_confirmed.then(|| self.isolate(&plate, &window))?;
        }
        self.symptoms.misfits = 0;
        if window.fits(self.drop_v()) {
            let [volts, current, speed] = window.mean;
            let turns = speed.abs() > Settings::CLEAR * self.scale.volts;
            self.proven.direction |= turns && speed * volts > 0.0;
            self.symptoms.last_fit = Some((volts, current + speed));
        }
        None
    }

    /// A current that contradicts both balances.
    fn by_factor(&mut self, plate: &Plate) -> Option<Trip> {
        let row = *self.history.rows().back()?;
        if self.waived || row.limited || !row.exact || row.hides_acceleration() {
            return None;
        }
        let is_signed = self.proven.current_sign;
        let factor = self.proven.factor.as_mut()?.push(&row, is_signed, plate)?;
        // Both balances fit either sign; only one of them goes against the voltage.
        if factor < 0.0
            && let Some(window) = self.window(plate, Settings::STAMPED_ROWS)
            && window.mean[2] * window.mean[0] < 0.0
        {
            return Some(self.misread(TripKind::EncoderReversed, plate, &window));
        }
        let current = self.history.last().and_then(|last| last.current_a).unwrap_or(0.0);
        let kind =
            if factor < 0.0 { TripKind::CurrentReversed } else { TripKind::CurrentImplausible };
        let what = format!(
            "the measured current reads {factor:.2} times what voltage and acceleration require, 0.5 to 2 is allowed; now it is {current:.2} A; {CHECK_CURRENT}"
        );
        Some(self.trip(kind, (factor, 1.0), &what))
    }

    fn is_mirrored(&self, window: &Window, reading: Reading, least_share: f64) -> bool {
        window.is_mirrored(reading, least_share * self.scale.volts, self.rest_v())
    }

    /// The shaft gains or loses speed against its current and speed, and the opposite sign of one would fit.
    fn accelerates_against_current(&self, window: &Window) -> bool {
        let latest = || self.latest(Settings::STAMPED_ROWS);
        let gain: f64 = latest().map(|row| row.speed_change_rad_s).sum();
        if gain.abs() < self.rest_rad_s() || latest().any(Row::hides_acceleration) {
            return false;
        }
        let ([volts, current, speed], is_signed) = (window.mean, self.proven.current_sign);
        let drives = !is_signed || current * volts > 0.0;
        let encoder = drives
            && speed * volts < 0.0
            && gain * volts < 0.0
            && self.is_mirrored(window, Reading::Speed, Settings::JUDGED);
        // A braked shaft may lose speed under a current that drives it, where a load takes more.
        let least_share = if current * volts < 0.0 { Settings::JUDGED } else { Settings::DROP };
        let sensor = is_signed
            && speed * volts > 0.0
            && gain * current < 0.0
            && self.is_mirrored(window, Reading::Current, least_share);
        encoder || sensor
    }

    /// No current flows that would drive anything.
    fn is_idle(&self) -> bool {
        let rows = Settings::STAMPED_ROWS;
        self.history.rows().len() >= rows
            && self.latest(rows).all(|row| row.current_a.abs() < self.idle_a())
    }

    /// No current flows although the voltage is not that of the speed, or although the shaft is driven.
    fn idle(&mut self, plate: &Plate) -> Option<Trip> {
        let last = *self.history.last()?;
        let (speed, current) = (last.speed_rad_s?, last.current_a?);
        if let Some(trip) = self.driven_without_current(current, speed) {
            return Some(trip);
        }
        let mut window = self.window(plate, self.window_rows())?;
        window.current = Range::at(0.0);
        let [volts, _, emf] = window.mean;
        let is_frozen = self.speed.run() >= self.frozen_readings();
        // A coasting shaft is not driven, and a converter may not be able to brake it.
        let coasts = volts.abs() < emf.abs() && !is_frozen;
        let (any, flux) = (Settings::ANY_FACTOR, Settings::FLUX_FACTOR);
        if coasts || window.gap(any, flux, self.drop_v()) <= 0.0 {
            self.symptoms.idle_since_s = None;
            return None;
        }
        let for_s = last.time_s - *self.symptoms.idle_since_s.get_or_insert(last.time_s);
        let turns = speed.abs() >= self.rest_rad_s();
        if for_s < Settings::IDLE_S || turns && self.waived {
            return None;
        }
        let figures = format!(
            "{current:.3} A flow at {volts:.1} V and {speed:.1} rad/s for {for_s:.2} s, {} s are allowed",
            Settings::IDLE_S
        );
        let by_voltage = plate.steady_rad_s(volts, 0.0);
        let stalled = (current, volts / plate.resistance_ohm);
        let (kind, figures, what) = if turns {
            let kind = if is_frozen { TripKind::EncoderFrozen } else { TripKind::SpeedImplausible };
            let what = format!(
                "no current drives the shaft, so it should turn at about {by_voltage:.1} rad/s: {figures}; {CHECK_ENCODER}"
            );
            (kind, (speed, by_voltage), what)
        } else if last.voltage_v.is_some() {
            let what = format!(
                "the armature circuit is open, or the output is not on, or current and speed are both not measured: {figures}; check the motor's leads, its fuses and the drive's enable and release inputs"
            );
            (TripKind::OpenCircuit, stalled, what)
        } else {
            let what = format!(
                "the drive does not follow, or its output is not on, or the armature circuit is open (it reports no voltage to distinguish them): {figures}; {CHECK_SET_POINT}; check the motor's leads"
            );
            (TripKind::SetPointIgnored, stalled, what)
        };
        Some(self.trip(kind, figures, &what))
    }

    /// A shaft that speeds up with the voltage and without a current.
    fn driven_without_current(&self, current: f64, speed: f64) -> Option<Trip> {
        // More within 0.4 s than any load pulls the shaft.
        let (idle_a, most) = (self.idle_a(), 0.08 * self.scale.rad_s);
        let (mut seconds, mut gain) = (0.0, 0.0);
        for row in self.history.rows().iter().rev() {
            let volts = row.volts?.middle();
            let drives = volts * speed > 0.0 && volts.abs() > self.rest_v();
            seconds += row.seconds;
            if row.current_a.abs() > idle_a || !drives || seconds > 0.4 {
                break;
            }
            gain += row.speed_change_rad_s * speed.signum();
        }
        let what = format!(
            "{current:.3} A are measured while the voltage speeds the shaft up by {gain:.1} rad/s to {speed:.1} rad/s; without a current {most:.1} rad/s are allowed; {CHECK_CURRENT}"
        );
        (gain > most).then(|| self.trip(TripKind::CurrentStuck, (current, idle_a), &what))
    }

    /// A speed that repeats itself, while the back-EMF has changed or cannot be that of this speed.
    fn frozen(&mut self, plate: &Plate, window: &Window) -> Option<Trip> {
        let rows = self.window_rows();
        // The whole window must lie within the repetition.
        if self.speed.run() < rows {
            self.symptoms.frozen_windows = 0;
            return None;
        }
        let [volts, current, speed] = window.mean;
        let emf = volts - current;
        let readings = self.latest(rows).map(|row| plate.steady_v(row.ends().0, 0.0));
        let currents = Range::of(readings).unwrap_or(window.current);
        let start = RepetitionStart { emf, current, currents };
        let start = *self.symptoms.repetition.get_or_insert(start);
        if self.speed.run() < self.frozen_readings() {
            return None;
        }
        let idle_v = plate.steady_v(self.idle_a(), 0.0);
        // The drop of brushes and bridge appears with the current and changes its sign with it. A window in which the
        // current does both counts for either.
        let reverses = |from: Range, to: Range| from.high > idle_v && to.low < -idle_v;
        let turns = start.current.abs() < idle_v
            || reverses(start.currents, currents)
            || reverses(currents, start.currents);
        let drops_v = if turns { 2.0 * self.drop_v() } else { self.rest_v() };
        let by_winding_v = (1.0 - Settings::WINDING_FACTOR.low) * (current - start.current).abs();
        let tolerance_v = drops_v + by_winding_v + 0.5 * window.volts.width();
        // From the first back-EMF and from that of the measured speed: the first may be of a current in transit.
        let beyond = |other_v: f64| Settings::FLUX_FACTOR.low * (emf - other_v).abs() > tolerance_v;
        if window.fits(self.drop_v()) && !(beyond(start.emf) && beyond(speed)) {
            self.symptoms.frozen_windows = 0;
            return None;
        }
        self.symptoms.frozen_windows += 1;
        // A drive that does not stamp its samples may have read the speed some cycles ago.
        let needed =
            if self.is_exact() { 1 } else { self.cycles() } + self.history.speed_lag_rows();
        (self.symptoms.frozen_windows >= needed)
            .then(|| self.misread(TripKind::EncoderFrozen, plate, window))
    }

    /// Fault isolation: the reading that does not fit.
    pub(super) fn isolate(&mut self, plate: &Plate, window: &Window) -> Option<Trip> {
        let drop_v = self.drop_v();
        let [volts, current, speed] = window.mean;
        let is_ignored = self.symptoms.last_fit.is_some_and(|(last_v, response)| {
            let step = (volts - last_v).abs();
            step > 2.0 * drop_v && (current + speed - response).abs() < Settings::UNEXPLAINED * step
        });
        let last = *self.history.last()?;
        let drives_back = speed * volts < 0.0 && current * volts.signum() >= -drop_v;
        // A speed loop may have reversed the voltage too.
        let is_reversed = drives_back && window.with_speed_reversed().fits(drop_v)
            || self.is_mirrored(window, Reading::Speed, 2.0 * Settings::DROP);
        let turns = last.speed_rad_s?.abs() >= self.rest_rad_s();
        let kind = if self.speed.run() >= self.frozen_readings() {
            TripKind::EncoderFrozen
        } else if is_reversed {
            TripKind::EncoderReversed
        } else if self.proven.current_sign
            && self.is_mirrored(window, Reading::Current, Settings::JUDGED)
        {
            TripKind::CurrentReversed
        } else if let Some(trip) = self.swapped() {
            return Some(trip);
        } else if is_ignored && last.voltage_v.is_none() {
            let response = current + speed;
            let what = format!(
                "the set-point went to {volts:.1} V, current and speed are those of {response:.1} V as before; {CHECK_SET_POINT}"
            );
            return Some(self.trip(TripKind::SetPointIgnored, (response, volts), &what));
        } else if !turns {
            TripKind::EncoderFrozen
        } else if self.waived {
            self.symptoms.misfits = 0;
            return None;
        } else if speed.abs() >= current.abs() {
            TripKind::SpeedImplausible
        } else {
            TripKind::CurrentImplausible
        };
        Some(self.misread(kind, plate, window))
    }

    /// The speed, or else the current, that contradicts the balance.
    pub(super) fn misread(&self, kind: TripKind, plate: &Plate, window: &Window) -> Trip {
        use TripKind::{CurrentReversed, EncoderFrozen, EncoderReversed, SpeedImplausible};
        let (reading, name, other_name, unit, digits, per_unit, check) = match kind {
            EncoderFrozen | EncoderReversed | SpeedImplausible => {
                let per_unit = plate.back_emf_v_s_per_rad;
                (Reading::Speed, "speed", "current", "rad/s", 1, per_unit, CHECK_ENCODER)
            }
            _ => {
                let per_unit = plate.resistance_ohm;
                (Reading::Current, "current", "speed", "A", 2, per_unit, CHECK_CURRENT)
            }
        };
        let (own, other) = window.terms(reading);
        let (measured, by_voltage) = (own / per_unit, (window.mean[0] - other) / per_unit);
        let plausible = window.plausible(reading, self.drop_v());
        let (low, high) = (plausible.low / per_unit, plausible.high / per_unit);
        let how = match kind {
            EncoderFrozen => "stays at",
            EncoderReversed | CurrentReversed => "has the wrong sign:",
            _ => "is",
        };
        let ratio = measured / by_voltage;
        let scale = match kind {
            SpeedImplausible if ratio.is_finite() => {
                format!(
                    "; it reads {ratio:.2} times what it should (or Ke of the nameplate is off by as much)"
                )
            }
            _ => String::new(),
        };
        let what = format!(
            "the measured {name} {how} {measured:.digits$} {unit}, by voltage and {other_name} it is {by_voltage:.digits$} {unit}, {low:.digits$} to {high:.digits$} {unit} is plausible{scale}; {check}"
        );
        self.trip(kind, (measured, by_voltage), &what)
    }
}

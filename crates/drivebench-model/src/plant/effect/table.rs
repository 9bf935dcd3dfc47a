//! `table`: a learned piecewise linear curve over one axis, for an unidentified effect.

use crate::tabulated;
use std::f64::consts::TAU;

use super::definition::{
    Defined, DefinitionError, Layout, balance_of, interned, leaked, number_of, text_of, unknown_key,
};
use super::{
    Balance, Card, Effect, Enters, Formula, Instant, ParameterSpec, Place, SYMBOLS, Terms, Tree,
    torque, voltage,
};

/// The family's card: what `effects table` shows.
pub(super) const CARD: Card = Card {
    id: "table",
    name: "learned curve",
    // Its settings choose one of both.
    enters: Enters::Both,
    equation: "T or U = piecewise linear over speed, current, angle or time, constant beyond the ends",
    causes: "not known yet: the curve follows the data until the effect is identified",
    looks_like: "the error follows one axis, and no effect of the catalogue has this form",
    excite: "slowly over the whole range of the axis, both ways",
    remedy: "look for the cause by the form of the curve; compensate by feed-forward from the table",
    ..Card::PLAIN
};

tabulated! {
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Axis {
        Speed = ("speed_rad_s", "rad/s"),
        Current = ("current_a", "A"),
        Angle = ("angle_rad", "rad"),
        Time = ("time_s", "s"),
        Voltage = ("voltage_v", "V"),
    }
    /// Key in a model file and unit.
    const fn names(self) -> (&'static str, &'static str);
}

impl Axis {
    pub const fn key(self) -> &'static str {
        self.names().0
    }

    pub const fn unit(self) -> &'static str {
        self.names().1
    }

    pub fn from_key(key: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|axis| axis.key() == key)
    }

    /// Whether the curve goes on from its last knot to its first: a turn of the shaft.
    pub const fn is_periodic(self) -> bool {
        matches!(self, Self::Angle)
    }

    const fn of(self, at: &Instant) -> f64 {
        match self {
            Self::Speed => at.speed_rad_s,
            Self::Current => at.current_a,
            Self::Angle => at.angle.rad(),
            Self::Time => at.time_s,
            Self::Voltage => at.voltage_v,
        }
    }
}

/// Builds the effect from its settings; gives the values that stand there, too.
pub(super) fn define(id: &str, settings: &toml::Table) -> Defined {
    let balance = balance_of(settings)?;
    let axis = text_of(settings, "axis", Axis::Speed.key())?;
    let axis = Axis::from_key(axis).ok_or_else(|| {
        let known = Axis::ALL.map(Axis::key).join(", ");
        DefinitionError::new("axis", format!("axis {axis:?} is not known"), known)
    })?;
    let knots = list(settings, "knots")?.ok_or_else(|| {
        DefinitionError::new("id", "knots are missing", "as knots = [-100.0, 0.0, 100.0]")
    })?;
    check(axis, &knots)?;
    let mut values = vec![None; knots.len()];
    if let Some(given) = list(settings, "values")? {
        if given.len() != knots.len() {
            let message = format!("{} values for {} knots", given.len(), knots.len());
            let help = "one value for each knot, or none at all: they are fitted then";
            return Err(DefinitionError::new("values", message, help));
        }
        values = given.into_iter().map(Some).collect();
    }
    let known = ["id", "equation", "axis", "knots", "values", "value_1"];
    for (key, value) in settings {
        let number = key.strip_prefix("value_").and_then(|n| n.parse().ok());
        match number.and_then(|number: usize| values.get_mut(number.checked_sub(1)?)) {
            Some(cell) => *cell = Some(number_of(key, value)?),
            None if known[..5].contains(&key.as_str()) => {}
            None => return Err(unknown_key(key, &known)),
        }
    }
    let key = format!("{id}|{balance:?}|{axis:?}|{knots:?}");
    let effect = interned(&key, || {
        let value = |number| {
            let key = leaked(&format!("value_{number}"));
            ParameterSpec::coefficient(key, balance.unit(), 0.1)
        };
        let values: Vec<ParameterSpec> = (1..=knots.len()).map(value).collect();
        let card = Card {
            id: leaked(id),
            name: leaked(&format!("{} over {}", CARD.name, axis.key())),
            enters: balance.into(),
            needs_angle: axis == Axis::Angle,
            parameters: values.leak(),
            ..CARD
        };
        Box::new(Table { card, balance, axis, knots: knots.leak() })
    });
    Ok((effect, values))
}

fn list(settings: &toml::Table, key: &str) -> Result<Option<Vec<f64>>, DefinitionError> {
    let Some(value) = settings.get(key) else { return Ok(None) };
    let items = value.as_array().ok_or_else(|| {
        let message = format!("{key} is a {}, expected a list", value.type_str());
        DefinitionError::new(key, message, "a list of numbers, as [-100.0, 0.0, 100.0]")
    })?;
    items.iter().map(|item| number_of(key, item)).collect::<Result<_, _>>().map(Some)
}

fn check(axis: Axis, knots: &[f64]) -> Result<(), DefinitionError> {
    let refused = |message: String, help: &str| Err(DefinitionError::new("knots", message, help));
    if !(2..=64).contains(&knots.len()) {
        return refused(format!("{} knots", knots.len()), "2 to 64 are allowed");
    }
    if let Some([before, after, ..]) = knots.windows(2).find(|pair| pair[0] >= pair[1]) {
        let help = "knots must rise from one to the next";
        return refused(format!("knot {after} follows {before}"), help);
    }
    let (first, last) = (knots[0], knots[knots.len() - 1]);
    if axis.is_periodic() && !(first >= 0.0 && last < TAU) {
        let help = "angles lie from 0 to below 2 pi";
        return refused(format!("knots from {first} to {last} rad"), help);
    }
    Ok(())
}

struct Table {
    card: Card,
    balance: Balance,
    axis: Axis,
    knots: &'static [f64],
}

impl Effect for Table {
    fn card(&self) -> &Card {
        &self.card
    }

    fn formula(&self) -> Option<Vec<Formula>> {
        if self.axis.is_periodic() {
            return None;
        }
        // The mean of both ends, and half of each change of the slope times the distance from its knot.
        let value = |knot: usize| Tree::Name(SYMBOLS.len() + knot);
        let slope = |knot: usize| {
            let length = self.knots.get(knot + 1)? - self.knots[knot];
            Some(value(knot + 1).both('-', value(knot)).both('/', Tree::Number(length)))
        };
        let axis = Tree::Name(match self.axis {
            Axis::Voltage => 0,
            Axis::Current => 1,
            Axis::Speed => 2,
            Axis::Angle => 3,
            Axis::Time => 4,
        });
        let last = self.knots.len() - 1;
        let mut tree = value(0).both('+', value(last));
        for (knot, abscissa) in self.knots.iter().enumerate() {
            let zero = || Tree::Number(0.0);
            let before = knot.checked_sub(1).and_then(slope).unwrap_or_else(zero);
            let after = slope(knot).unwrap_or_else(zero);
            let distance = axis.clone().both('-', Tree::Number(*abscissa)).call("abs");
            tree = tree.both('+', after.both('-', before).both('*', distance));
        }
        Some(vec![Formula {
            place: match self.balance {
                Balance::Voltage => Place::Voltage,
                Balance::Torque => Place::Torque,
            },
            tree: Tree::Number(0.5).both('*', tree),
        }])
    }

    fn terms(&self, values: &[f64]) -> Box<dyn Terms> {
        let (axis, knots, values) = (self.axis, self.knots, values.to_vec());
        let curve = move |at: &Instant, []: [f64; 0]| {
            let [low, high] = weights(axis, knots, axis.of(at));
            low.1 * values[low.0] + high.1 * values[high.0]
        };
        match self.balance {
            Balance::Voltage => voltage(&[], curve),
            Balance::Torque => torque(&[], curve),
        }
    }

    fn settings(&self) -> Vec<(&'static str, toml::Value)> {
        let knots = self.knots.iter().copied().map(toml::Value::from).collect();
        vec![
            ("equation", self.balance.key().into()),
            ("axis", self.axis.key().into()),
            ("knots", toml::Value::Array(knots)),
        ]
    }

    fn layout(&self) -> Layout {
        Layout::List("values")
    }
}

/// The two knots around an abscissa and their weights: the hat functions (linear B-splines) that are not zero there.
pub fn weights(axis: Axis, knots: &[f64], abscissa: f64) -> [(usize, f64); 2] {
    let last = knots.len() - 1;
    let abscissa = if axis.is_periodic() { abscissa.rem_euclid(TAU) } else { abscissa };
    let after = knots.partition_point(|knot| *knot <= abscissa);
    let (low, high, share) = if after > 0 && after <= last {
        let (low, high) = (knots[after - 1], knots[after]);
        (after - 1, after, (abscissa - low) / (high - low))
    } else if axis.is_periodic() {
        // Between the last knot and the first, one turn on.
        let gap = knots[0] + TAU - knots[last];
        let from_last = (abscissa - knots[last]).rem_euclid(TAU);
        (last, 0, from_last / gap)
    } else if after == 0 {
        (0, 0, 0.0)
    } else {
        (last, last, 0.0)
    };
    // Without an abscissa there is no value.
    let share = if abscissa.is_nan() { f64::NAN } else { share };
    [(low, 1.0 - share), (high, share)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::ShaftAngle;
    fn table(text: &str) -> Defined {
        define("table", &text.parse::<toml::Table>().unwrap())
    }

    const SPEED: &str = "equation = \"torque\"\naxis = \"speed_rad_s\"\nknots = [-10.0, 0.0, 20]\n";

    #[test]
    fn a_curve_is_linear_between_knots_and_constant_or_periodic() {
        let turn = "equation = \"voltage\"\naxis = \"angle_rad\"\nknots = [1.0, 2.0, 5.0]\n";
        let speed = format!("{SPEED}values = [1.0, 0.0, 4]");
        let turn = format!("{turn}values = [10.0, 20.0, 50.0]");
        let curve = |text: &str| {
            let (effect, values) = table(text).unwrap();
            effect.terms(&values.into_iter().flatten().collect::<Vec<f64>>())
        };
        let (speed, turn) = (curve(&speed), curve(&turn));
        let at = |speed_rad_s: f64, angle_rad: f64| Instant {
            speed_rad_s,
            angle: ShaftAngle::at(angle_rad),
            ..Instant::default()
        };
        let speeds = [-50.0, -10.0, -5.0, 0.0, 5.0, 20.0, 30.0];
        let torques = [1.0, 1.0, 0.5, 0.0, 1.0, 4.0, 4.0];
        for (speed_rad_s, expected) in speeds.into_iter().zip(torques) {
            let sums = speed.sums(&at(speed_rad_s, 0.0), &[]);
            assert!((sums.torque_n_m - expected).abs() < 1e-12, "{speed_rad_s}");
            assert!(sums.voltage_v.abs() < 1e-300);
        }
        // From 5 to 1 + 2 pi the curve falls from 50 to 10.
        let gap = 1.0 + TAU - 5.0;
        let angles = [1.5, 5.0 + 0.25 * gap, 1.0 - 0.25 * gap, 1.0 + 3.0 * TAU, 1.5 - 2.0 * TAU];
        for (angle, expected) in angles.into_iter().zip([15.0, 40.0, 20.0, 10.0, 15.0]) {
            let sums = turn.sums(&at(0.0, angle), &[]);
            let off = (sums.voltage_v - expected).abs() + sums.torque_n_m.abs();
            assert!(off < 1e-9, "{angle}: {off}");
        }
        assert!(turn.voltage_v(&at(0.0, f64::NAN), &[]).is_nan());
    }

    #[test]
    fn the_same_settings_are_the_same_effect() {
        let (one, _) = table(SPEED).unwrap();
        let (same, values) = table(&format!("{SPEED}value_2 = 0.5")).unwrap();
        let (other, _) = table(&SPEED.replace("20", "21")).unwrap();
        assert!(std::ptr::addr_eq(one, same) && !std::ptr::addr_eq(one, other));
        assert_eq!(values, vec![None, Some(0.5), None]);
    }

    #[test]
    fn wrong_settings_are_named() {
        for (from, to, key, part) in [
            ("torque", "force", "equation", "force"),
            ("speed_rad_s", "speed", "axis", "speed"),
            ("[-10.0, 0.0, 20]", "[0.0]", "knots", "1 knots"),
            ("[-10.0, 0.0, 20]", "[0.0, 0.0]", "knots", "follows"),
            ("[-10.0, 0.0, 20]", "[0.0, nan]", "knots", "not allowed"),
            ("[-10.0, 0.0, 20]", "7", "knots", "expected a list"),
            ("axis =", "value_4 = 1.0\naxis =", "value_4", "unknown key"),
            ("axis =", "values = [1.0]\naxis =", "values", "1 values for 3"),
            ("speed_rad_s", "angle_rad", "knots", "rad"),
        ] {
            let error = table(&SPEED.replace(from, to)).err().unwrap();
            assert_eq!(error.key, key, "{error}");
            assert!(error.message.contains(part), "{error}");
        }
    }
}

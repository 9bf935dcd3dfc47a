//! Parameters of the baseline: a permanent-magnet DC motor with Coulomb friction (Leonhard, *Control of Electrical Drives*,
//! chapter 5).

use crate::tabulated;

tabulated! {
    /// A key of the `[motor]` table, with its unit.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
    pub enum MotorKey {
        Resistance = ["resistance_ohm", "ohm", "resistance"],
        Inductance = ["inductance_h", "H", "inductance"],
        BackEmf = ["back_emf_v_s_per_rad", "V.s/rad", "back-EMF constant"],
        TorqueConstant = ["torque_n_m_per_a", "N.m/A", "torque constant"],
        Inertia = ["inertia_kg_m2", "kg.m2", "inertia"],
        LoadTorque = ["load_torque_n_m", "N.m", "load torque"],
    }
    /// Key in a model file, unit and name.
    const fn row(self) -> [&'static str; 3];
}

impl MotorKey {
    pub const fn key(self) -> &'static str {
        self.row()[0]
    }

    pub const fn unit(self) -> &'static str {
        self.row()[1]
    }

    pub const fn name(self) -> &'static str {
        self.row()[2]
    }

    pub const fn is_electrical(self) -> bool {
        matches!(self, Self::Resistance | Self::Inductance | Self::BackEmf | Self::TorqueConstant)
    }

    pub fn from_key(key: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|known| known.key() == key)
    }
}

/// A motor with its load; a missing value is to be fitted (a missing torque constant is equal to the back-EMF constant).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Motor {
    pub name: String,
    values: [Option<f64>; MotorKey::ALL.len()],
}

impl Motor {
    pub fn new(name: impl Into<String>) -> Self {
        Self { name: name.into(), values: [None; MotorKey::ALL.len()] }
    }

    pub fn get(&self, key: MotorKey) -> Option<f64> {
        self.values[key as usize]
    }

    pub fn set(&mut self, key: MotorKey, value: f64) {
        self.values[key as usize] = Some(value);
    }

    pub fn clear(&mut self, key: MotorKey) {
        self.values[key as usize] = None;
    }

    #[must_use]
    pub fn with(mut self, key: MotorKey, value: f64) -> Self {
        self.set(key, value);
        self
    }

    /// Torque per ampere; equal to the back-EMF constant (SI, direct-current machine) unless given.
    pub fn torque_constant(&self) -> Option<f64> {
        self.get(MotorKey::TorqueConstant).or_else(|| self.get(MotorKey::BackEmf))
    }

    /// Electrical time constant L/R, s.
    pub fn electrical_time_constant_s(&self) -> Option<f64> {
        Some(self.get(MotorKey::Inductance)? / self.get(MotorKey::Resistance)?)
    }

    /// Mechanical time constant R J/(Ke Kt), s.
    pub fn mechanical_time_constant_s(&self) -> Option<f64> {
        let constants = self.get(MotorKey::BackEmf)? * self.torque_constant()?;
        Some(self.get(MotorKey::Resistance)? * self.get(MotorKey::Inertia)? / constants)
    }

    /// Motor of paper A with the values of its catalogue: the default of the emulator.
    pub fn zk_22fc() -> Self {
        Self::new("ZK-22FC")
            .with(MotorKey::Resistance, 1.1)
            .with(MotorKey::Inductance, 0.0099)
            .with(MotorKey::BackEmf, 0.3538)
            .with(MotorKey::Inertia, 0.0045)
            .with(MotorKey::LoadTorque, 0.455)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_constants_of_the_paper_motor() {
        let motor = Motor::zk_22fc();
        assert!((motor.electrical_time_constant_s().unwrap() - 0.009).abs() < 1e-12);
        // 37 ms with the catalogue inertia 0.00425; 39.5 ms with 0.0045.
        assert!((motor.mechanical_time_constant_s().unwrap() - 0.039_54).abs() < 1e-4);
    }
}

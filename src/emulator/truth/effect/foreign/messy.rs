use super::super::{Cogging, CommandDelay, SupplySag, ViscousFriction};
use super::{Hidden, HiddenEffect, RandomLoad, Site, hidden_effect};

hidden_effect! {
    /// What a real bench has besides: random torque, a little drag and cogging, a late command, a supply that gives way.
    Messy {
        /// 1: the sizes below; every size is multiplied by it.
        scale: NotNegative in "-",
    }
}

/// Shares of the rated torque.
const RANDOM_SHARE: f64 = 0.0075;
const DRAG_SHARE_AT_RATED_SPEED: f64 = 0.015;
const COGGING_SHARE: f64 = 0.015;
const COGGING_ORDER: f64 = 7.0;
const RANDOM_CORRELATION_S: f64 = 0.05;
const COMMAND_DELAY_S: f64 = 0.4e-3;
const SAG_OHM: f64 = 0.05;

impl Hidden for Messy {
    fn parts(&self, site: &Site) -> Vec<HiddenEffect> {
        let torque = self.scale * site.rated_torque_n_m();
        vec![
            HiddenEffect::RandomLoad(RandomLoad {
                std_n_m: RANDOM_SHARE * torque,
                correlation_s: RANDOM_CORRELATION_S,
            }),
            HiddenEffect::ViscousFriction(ViscousFriction {
                viscous_n_m_s_per_rad: DRAG_SHARE_AT_RATED_SPEED * torque
                    / site.motor.rated_speed_rad_s,
            }),
            HiddenEffect::Cogging(Cogging {
                order: COGGING_ORDER,
                sin_n_m: COGGING_SHARE * torque,
                cos_n_m: 0.0,
            }),
            HiddenEffect::CommandDelay(CommandDelay {
                delay_s: self.scale * COMMAND_DELAY_S,
            }),
            HiddenEffect::SupplySag(SupplySag {
                sag_ohm: self.scale * SAG_OHM,
            }),
        ]
    }
}

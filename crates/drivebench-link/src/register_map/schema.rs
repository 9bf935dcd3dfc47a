//! Keys of a profile file: strict types of single keys; `resolve.rs` checks how they combine.
//!
//! Signals and set-points repeat the keys that they share, because serde cannot combine `flatten` with `deny_unknown_fields`: a
//! misspelt key would pass unnoticed.

use std::collections::BTreeMap;

use serde::Deserialize;
use toml::Spanned;

use super::address::{BaseText, Formula};
use super::terms::{
    Converter, Device, Expiry, PollRate, Quantity, Rates, Resync, Sign, StoppedOnly,
    SupervisionKind, Unit,
};
use super::value::{Byte, Kind, Order};
use crate::settings::{Framing, KickedBy, Protocol, Trust, named};
use drivebench_model::sample::{Origin, Side};

named! {
    /// Which value of an alternating quantity the number is.
    pub enum Basis {
        Rms = "rms",
        Peak = "peak",
        Mean = "mean",
        Instantaneous = "instantaneous",
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ProfileFile {
    pub(super) schema: Spanned<u32>,
    pub(super) device: Device,
    pub(super) converter: Option<Spanned<Converter>>,
    pub(super) link: Spanned<LinkKeys>,
    #[serde(default)]
    pub(super) identity: Vec<Spanned<IdentityKeys>>,
    pub(super) signals: BTreeMap<String, Spanned<SignalKeys>>,
    /// Channel to what it is in SI, by the values of signals.
    #[serde(default)]
    pub(super) derived: BTreeMap<String, Spanned<DerivedKeys>>,
    #[serde(default)]
    pub(super) missing: BTreeMap<String, Spanned<String>>,
    pub(super) setpoints: BTreeMap<String, Spanned<SetPointKeys>>,
    pub(super) commands: CommandKeys,
    pub(super) state: BTreeMap<String, Spanned<ConditionKeys>>,
    /// What the numbers of the fault code mean, where the manual has them.
    #[serde(default)]
    pub(super) fault_codes: BTreeMap<String, String>,
    pub(super) watchdog: Spanned<WatchdogKeys>,
    #[serde(default)]
    pub(super) limits: LimitKeys,
    pub(super) rates: Spanned<Rates>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LinkKeys {
    pub(super) protocol: Protocol,
    pub(super) baud: u32,
    #[serde(default)]
    pub(super) framing: Framing,
    pub(super) unit: u8,
    #[serde(default)]
    pub(super) functions: Vec<u8>,
    pub(super) max_read: Option<u16>,
    pub(super) max_write: Option<u16>,
    #[serde(default)]
    pub(super) max_hole: u16,
    #[serde(default)]
    pub(super) exact_reads: Vec<(i64, u16)>,
    pub(super) address_base: Option<BaseText>,
    pub(super) address_formula: Option<Formula>,
    pub(super) reply_ms: f64,
    pub(super) gap_us: Option<f64>,
    pub(super) deadline_ms: Option<f64>,
    pub(super) resync: Option<Resync>,
    pub(super) nvm_cycles: Option<u32>,
    pub(super) lines: Option<LineKeys>,
}

/// `[link.lines]`: how a language of lines looks.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LineKeys {
    /// Of a request; default: a line feed.
    pub(super) end: Option<String>,
    /// ` *N` behind each line, N the exclusive or of all before it.
    #[serde(default)]
    pub(super) checksum: bool,
    /// Line that writes a number, line that reads it, its answer.
    pub(super) scratch: [String; 3],
    /// Acknowledges a written number.
    pub(super) ack: Option<String>,
    /// Whole lines by which the drive refuses.
    #[serde(default)]
    pub(super) errors: Vec<String>,
    /// Characters of a number at which the drive cuts it off.
    pub(super) cut_at: Option<usize>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct IdentityKeys {
    pub(super) signal: Option<String>,
    pub(super) mask: Option<u32>,
    pub(super) equals: Option<u32>,
    pub(super) one_of: Option<Vec<u32>>,
    pub(super) within: Option<[f64; 2]>,
    pub(super) object: Option<u8>,
    pub(super) contains: Option<String>,
}

/// `[signals.NAME]`: one value that is read.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SignalKeys {
    pub(super) address: Option<i64>,
    pub(super) parameter: Option<String>,
    pub(super) can: Option<[i64; 2]>,
    /// VESC: bit of the mask of its selected values.
    pub(super) field: Option<u8>,
    /// VESC: a command without parameters, and the byte of its reply, counted from the one behind the command.
    pub(super) reply: Option<[u16; 2]>,
    /// VESC: the same with the byte by the value of another signal.
    pub reply_by: Option<ReplyBy>,
    /// Lines: the request, its answer (default: one number), and which number of that.
    pub(super) request: Option<String>,
    pub(super) answer: Option<String>,
    pub(super) hole: Option<u16>,
    /// 3: holding, 4: input register.
    pub(super) function: Option<u8>,
    #[serde(rename = "type")]
    pub(super) kind: Kind,
    pub(super) word_order: Option<Order>,
    pub(super) byte_order: Option<Order>,
    pub(super) byte: Option<Byte>,
    /// `"3..5"`.
    pub(super) bits: Option<String>,
    pub(super) scale: Option<f64>,
    pub(super) offset: Option<f64>,
    #[serde(default)]
    pub(super) scale_by: Vec<String>,
    #[serde(default)]
    pub(super) unit: Unit,
    pub quantity: Quantity,
    pub poll: PollRate,
    /// In units; a value outside is missing.
    pub valid: Option<[f64; 2]>,
    /// Raw patterns that mean "not available".
    #[serde(default)]
    pub invalid: Vec<u32>,
    pub origin: Option<Origin>,
    pub signed: Option<bool>,
    pub filter_ms: Option<f64>,
    /// It is the mean since it was last read.
    #[serde(default)]
    pub since_last_read: bool,
    /// Its number was cut towards zero, not rounded.
    #[serde(default)]
    pub truncated: bool,
    pub update_ms: Option<f64>,
    pub basis: Option<Basis>,
    pub side: Option<Side>,
    /// By which an electrical frequency is divided.
    pub pole_pairs: Option<u8>,
    pub(super) counts_per_turn: Option<u32>,
    /// Counts after which a position or a clock begins again; default: all that its bits hold.
    pub wraps_at: Option<u32>,
    pub trust: Option<Trust>,
    pub note: Option<String>,
}

/// The byte of a reply whose layout depends on the firmware.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReplyBy {
    pub(super) command: u8,
    /// It decides by its raw number.
    pub(super) signal: String,
    /// Raw number of that signal to the byte.
    pub(super) bytes: BTreeMap<String, u16>,
}

/// `[derived]`: a channel that is computed, as an expression or as a table with one.
#[derive(Clone, Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum DerivedKeys {
    Expression(String),
    Whole(WholeDerived),
}

#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WholeDerived {
    pub(super) value: String,
    /// Default: derived.
    pub(super) origin: Option<Origin>,
    pub(super) side: Option<Side>,
    pub(super) filter_ms: Option<f64>,
    #[serde(default)]
    pub(super) since_last_read: bool,
    /// The value is counted in the direction of this signal, or of its last value that was not zero. A mean over a reversal is none.
    pub(super) direction: Option<String>,
}

impl SignalKeys {
    /// Of a channel that is computed.
    pub(super) fn derived(quantity: Quantity, unit: Unit, whole: &WholeDerived) -> Self {
        Self {
            kind: Kind::F32,
            unit,
            quantity,
            poll: PollRate::Fast,
            origin: Some(whole.origin.unwrap_or(Origin::Derived)),
            filter_ms: whole.filter_ms,
            since_last_read: whole.since_last_read,
            side: whole.side,
            ..Self::default()
        }
    }
}

/// `[setpoints.NAME]`: one value that is written.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetPointKeys {
    pub(super) address: Option<i64>,
    pub(super) parameter: Option<String>,
    pub(super) can: Option<[i64; 2]>,
    /// VESC: the command that takes the value.
    pub(super) command: Option<u8>,
    /// Lines: the line with `{}` in the place of the value, digits behind its point, and what acknowledges it.
    pub(super) request: Option<String>,
    pub(super) digits: Option<u8>,
    pub(super) answer: Option<String>,
    /// 6 or 16.
    pub(super) function: Option<u8>,
    #[serde(rename = "type")]
    pub(super) kind: Kind,
    pub(super) word_order: Option<Order>,
    pub(super) byte_order: Option<Order>,
    pub(super) scale: Option<f64>,
    pub(super) offset: Option<f64>,
    #[serde(default)]
    pub(super) scale_by: Vec<String>,
    #[serde(default)]
    pub(super) unit: Unit,
    pub quantity: Quantity,
    pub(super) pole_pairs: Option<u8>,
    pub(super) counts_per_turn: Option<u32>,
    pub limits: Option<[f64; 2]>,
    pub slew_per_s: Option<f64>,
    /// The drive's own ramp to the set-point, in its unit per second.
    pub ramp_per_s: Option<f64>,
    /// A smaller one is zero to the drive.
    pub smallest: Option<f64>,
    pub(super) refresh_ms: Option<f64>,
    #[serde(default)]
    pub readback: bool,
    #[serde(default)]
    pub nvm: bool,
    pub write_only_when: Option<StoppedOnly>,
    pub sign: Option<Sign>,
    pub trust: Option<Trust>,
    pub note: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CommandKeys {
    pub(super) enable: Vec<Spanned<StepKeys>>,
    pub(super) stop: Vec<Spanned<StepKeys>>,
    /// Empty where the drive has none; left out it is an error, so that it is not forgotten.
    pub(super) coast: Option<Vec<Spanned<StepKeys>>>,
    pub(super) reset: Option<Vec<Spanned<StepKeys>>>,
    #[serde(default)]
    pub(super) quickstop: Vec<Spanned<StepKeys>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StepKeys {
    pub(super) write: Option<String>,
    pub(super) value: Option<f64>,
    pub(super) mask: Option<u32>,
    pub(super) wait: Option<String>,
    pub(super) equals: Option<u32>,
    pub(super) within_ms: Option<f64>,
    pub(super) error: Option<String>,
    pub(super) delay_ms: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ConditionKeys {
    pub(super) signal: Option<String>,
    pub(super) mask: Option<u32>,
    pub(super) equals: Option<u32>,
    pub(super) not_equals: Option<u32>,
    /// Or the value of this signal is beyond a share of another one.
    pub(super) or: Option<String>,
    pub(super) beyond: Option<f64>,
    pub(super) of: Option<String>,
    pub(super) none: Option<String>,
}

/// `[watchdog]`: what watches over the host.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WatchdogKeys {
    pub kind: SupervisionKind,
    pub kicked_by: KickedBy,
    /// 0: off as delivered; left out: not known.
    pub default_ms: Option<f64>,
    #[serde(default)]
    pub on_expire: Expiry,
    #[serde(default)]
    pub auto_resume: bool,
    #[serde(default)]
    pub nvm: bool,
    pub(super) time: Option<WatchdogTime>,
    /// Written at connect and read back.
    pub set_ms: Option<f64>,
    #[serde(default)]
    pub boot_delay_s: f64,
    pub proof: Option<String>,
    pub note: Option<String>,
}

#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct WatchdogTime {
    pub(super) address: Option<i64>,
    pub(super) parameter: Option<String>,
    #[serde(rename = "type")]
    pub(super) kind: Option<Kind>,
    /// What one raw unit is, ms.
    pub(super) unit_ms: f64,
    /// What the drive takes, ms; default: all that the register holds.
    pub(super) range_ms: Option<[f64; 2]>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LimitKeys {
    pub(super) current_a: Option<f64>,
    pub(super) voltage_v: Option<f64>,
    pub(super) speed_rpm: Option<f64>,
    pub(super) field_min_a: Option<f64>,
}

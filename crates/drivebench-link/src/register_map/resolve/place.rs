//! Where a value lies in the drive, by the keys of its protocol: an address, a bit of the selected values, a byte of a reply.

use super::super::address::{Base, Numbering};
use super::super::facts::Location;
use super::super::schema::{LinkKeys, ReplyBy, SetPointKeys, SignalKeys};
use super::super::terms::{PollRate, Resync};
use super::super::value::{CellSize, Layout, Order};
use crate::cell_bus::CellTable;
use crate::framing::{PROOF_WRITE, fields_width};
use crate::settings::Protocol;

/// The key that is wrong, and why.
pub(super) type Wrong = (&'static str, String);

/// Where the values of one profile lie.
#[derive(Clone, Copy)]
pub(super) struct Places<'a> {
    pub(super) link: &'a LinkKeys,
    pub(super) numbering: Numbering,
    /// Lines of the profile: what is sent, and its answer.
    pub(super) lines: &'a [(String, String)],
}

/// What is sent for a signal, and its answer.
pub(super) fn signal_line(keys: &SignalKeys) -> Option<(String, String)> {
    Some((keys.request.clone()?, keys.answer.clone().unwrap_or_else(|| "{}".to_owned())))
}

/// The same of a set-point.
pub(super) fn set_point_line(keys: &SetPointKeys) -> Option<(String, String)> {
    Some((keys.request.clone()?, keys.answer.clone().unwrap_or_default()))
}

impl Places<'_> {
    const fn is_modbus(self) -> bool {
        self.link.protocol.is_modbus()
    }

    fn cell(self) -> CellSize {
        let words = self.is_modbus() || self.link.protocol == Protocol::Lines;
        if words { CellSize::Register } else { CellSize::Byte }
    }

    /// Position of a line of the profile.
    fn line(self, wanted: Option<&(String, String)>, layout: Layout) -> Result<u16, Wrong> {
        if layout.cells() != 2 {
            let message =
                "this type is not allowed (expected f32, i32 or u32 for a number of a line)";
            return Err(("type", message.to_owned()));
        }
        let at = self.lines.iter().position(|line| Some(line) == wanted);
        let at = at.and_then(|at| u16::try_from(at).ok()).filter(|at| *at < 64);
        at.ok_or_else(|| ("request", "request is missing".to_owned()))
    }

    /// The order where a profile gives none: the protocol's own.
    pub(super) fn order(self, given: Option<Order>) -> Order {
        given.unwrap_or(match self.link.protocol {
            Protocol::Dynamixel => Order::LowFirst,
            _ => Order::HighFirst,
        })
    }

    /// A signal's place, for a layout whose cells are not known yet.
    pub(super) fn signal(self, keys: &SignalKeys, layout: Layout) -> Result<Location, Wrong> {
        let layout = Layout { cell: self.cell(), ..layout };
        let given = (keys.field, keys.reply);
        let by = keys.reply_by.as_ref();
        if self.link.protocol == Protocol::Lines {
            let line = self.line(signal_line(keys).as_ref(), layout)?;
            let holes = self.lines[usize::from(line)].1.matches("{}").count();
            let hole = keys.hole.unwrap_or(0);
            if usize::from(hole) >= holes.min(8) {
                let message =
                    format!("hole {hole} is not allowed (the answer has {holes}, counted from 0)");
                return Err(("hole", message));
            }
            return Ok(Location { table: CellTable::Lines(1 << line), address: 2 * hole, layout });
        }
        if keys.request.is_some() {
            return Err(("request", "request is a key of protocol \"lines\"".to_owned()));
        }
        if self.link.protocol == Protocol::Vesc {
            let (table, address) = match (given, by) {
                ((Some(bit), None), None) => (field(bit, layout)?, 0),
                ((None, Some([command, at])), None) => {
                    (CellTable::Reply(byte("reply", command)?), at)
                }
                ((None, None), Some(by)) => (CellTable::Reply(by.command), first_place(by, keys)?),
                _ => {
                    return Err(("", "one of field, reply and reply_by is needed".to_owned()));
                }
            };
            return Ok(Location { table, address, layout });
        }
        if given != (None, None) || by.is_some() {
            let message = "field, reply and reply_by are keys of protocol \"vesc\"";
            return Err(("field", message.to_owned()));
        }
        let found = self.numbering.resolve(keys.address, keys.parameter.as_deref(), keys.can);
        let (address, is_input) = found.map_err(|message| ("address", message))?;
        if !self.is_modbus() {
            return Ok(Location { table: CellTable::Bytes, address, layout });
        }
        let function = keys.function.unwrap_or(match is_input {
            Some(true) => 4,
            None if !self.link.functions.contains(&3) => 4,
            _ => 3,
        });
        let table = match function {
            3 => CellTable::Holding,
            4 => CellTable::Input,
            _ => {
                let message = format!("function {function} is not allowed (expected 3 or 4)");
                return Err(("function", message));
            }
        };
        self.supports(function).map_err(|message| ("function", message))?;
        Ok(Location { table, address, layout })
    }

    /// A set-point's place, and the function or command that writes it.
    pub(super) fn set_point(
        self,
        keys: &SetPointKeys,
        layout: Layout,
    ) -> Result<(Location, u8), Wrong> {
        let layout = Layout { cell: self.cell(), ..layout };
        if self.link.protocol == Protocol::Lines {
            let line = self.line(set_point_line(keys).as_ref(), layout)?;
            let table = CellTable::Lines(1 << line);
            return Ok((Location { table, address: 2 * line, layout }, PROOF_WRITE));
        }
        if self.link.protocol == Protocol::Vesc {
            let command =
                keys.command.ok_or_else(|| ("command", "command is missing".to_owned()))?;
            // Addresses of its own for each command, which has up to four bytes.
            let (table, address) = (CellTable::Reply(command), 4 * u16::from(command));
            return Ok((Location { table, address, layout }, command));
        }
        if keys.command.is_some() {
            return Err(("command", "command is a key of protocol \"vesc\"".to_owned()));
        }
        let found = self.numbering.resolve(keys.address, keys.parameter.as_deref(), keys.can);
        let (address, is_input) = found.map_err(|message| ("address", message))?;
        if !self.is_modbus() {
            return Ok((Location { table: CellTable::Bytes, address, layout }, PROOF_WRITE));
        }
        if is_input == Some(true) {
            return Err(("address", "an input register cannot be written".to_owned()));
        }
        let registers = layout.cells();
        let single = registers == 1 && self.link.functions.contains(&6);
        let function = keys.function.unwrap_or(if single { 6 } else { 16 });
        if function != 16 && !(function == 6 && registers == 1) {
            let message =
                format!("function {function} is not allowed (expected 6 for one register, or 16)");
            return Err(("function", message));
        }
        self.supports(function).map_err(|message| ("function", message))?;
        Ok((Location { table: CellTable::Holding, address, layout }, function))
    }

    /// The place of a watchdog's time.
    pub(super) fn time(self, address: u16, layout: Layout) -> Location {
        let table = if self.is_modbus() { CellTable::Holding } else { CellTable::Bytes };
        Location { table, address, layout: Layout { cell: self.cell(), ..layout } }
    }

    fn supports(self, function: u8) -> Result<(), String> {
        let known = &self.link.functions;
        if known.contains(&function) {
            return Ok(());
        }
        Err(format!(
            "the drive does not support function code {function} (link.functions has {known:?})"
        ))
    }
}

fn field(bit: u8, layout: Layout) -> Result<CellTable, Wrong> {
    // Bits that select a value; those above carry the number of a request.
    let mask = 1_u32.checked_shl(bit.into()).filter(|mask| fields_width(*mask) > 0);
    let mask =
        mask.ok_or_else(|| ("field", format!("field {bit} is not allowed (expected 0 to 21)")))?;
    let (has, needs) = (fields_width(mask), layout.cells());
    if has != needs {
        return Err(("type", format!("field {bit} has {has} bytes, and the type {needs}")));
    }
    Ok(CellTable::Fields(mask))
}

fn first_place(by: &ReplyBy, keys: &SignalKeys) -> Result<u16, Wrong> {
    if keys.poll != PollRate::Once {
        let message = "a signal with reply_by is read once (expected poll = \"once\")";
        return Err(("poll", message.to_owned()));
    }
    if let Some(key) = by.bytes.keys().find(|key| key.parse::<u32>().is_err()) {
        let message = format!("bytes: {key:?} is not allowed (expected a whole number of 32 bits)");
        return Err(("reply_by", message));
    }
    let first = by.bytes.values().min().copied();
    let message = "bytes is empty (expected { VALUE = BYTE }, a value of the signal that decides)";
    first.ok_or_else(|| ("reply_by", message.to_owned()))
}

fn byte(key: &'static str, number: u16) -> Result<u8, Wrong> {
    u8::try_from(number)
        .map_err(|_| (key, format!("command {number} is not allowed (expected 0 to 255)")))
}

/// The settings of the register maps of Modbus: there all are needed, and elsewhere they mean nothing.
pub(super) struct Requests {
    pub(super) max_read: u16,
    pub(super) max_write: u16,
    pub(super) base: Base,
    pub(super) resync: Resync,
}

impl Requests {
    /// Most bytes of one read or write of a control table: what fits a packet of the smallest servos.
    const MOST_BYTES: u16 = 64;

    pub(super) fn of(link: &LinkKeys) -> Result<Self, Wrong> {
        let resync = match link.protocol {
            Protocol::Vesc => Resync::Tid,
            Protocol::Dynamixel => Resync::Length,
            Protocol::Lines => Resync::None,
            _ => link.resync.ok_or_else(|| missing("resync"))?,
        };
        if !link.protocol.is_modbus() {
            for (key, is_there) in [
                ("functions", !link.functions.is_empty()),
                ("address_base", link.address_base.is_some()),
                ("address_formula", link.address_formula.is_some()),
                ("resync", link.resync.is_some()),
            ] {
                if is_there {
                    let protocol = link.protocol;
                    return Err((key, format!("{key} means nothing to protocol \"{protocol}\"")));
                }
            }
            let most = Self::MOST_BYTES;
            let (max_read, max_write) =
                (link.max_read.unwrap_or(most), link.max_write.unwrap_or(most));
            return Ok(Self { max_read, max_write, base: Base::Zero, resync });
        }
        let base = link.address_base.as_ref().ok_or_else(|| missing("address_base"))?;
        let base = base.base().ok_or_else(|| {
            let message = "this address_base is not allowed (expected 0, 1 or \"4x1\")";
            ("address_base", message.to_owned())
        })?;
        for function in &link.functions {
            if !super::FUNCTIONS.contains(function) {
                let message = format!("function code {function} is not one of Modbus");
                return Err(("functions", message));
            }
        }
        if !link.functions.contains(&3) && !link.functions.contains(&4) {
            return Err(("functions", "neither 3 nor 4 is there: nothing can be read".to_owned()));
        }
        let within = |key, value: Option<u16>, most| {
            let value = value.ok_or_else(|| missing(key))?;
            let message = || format!("{key} {value} is not allowed (expected 1 to {most})");
            (1..=most).contains(&value).then_some(value).ok_or_else(|| (key, message()))
        };
        let max_read = within("max_read", link.max_read, 125)?;
        let max_write = within("max_write", link.max_write, 123)?;
        let (can, message) = match resync {
            Resync::Fc08 => {
                (link.functions.contains(&8), "resync \"fc08\" needs function code 8 in functions")
            }
            Resync::Tid => (
                link.protocol == Protocol::ModbusTcp,
                "resync \"tid\" needs protocol \"modbus-tcp\"",
            ),
            Resync::Length => (
                max_read >= 2,
                "resync \"length\" needs max_read 2 or more: reads of one length are all alike",
            ),
            Resync::None => (true, ""),
        };
        if can {
            Ok(Self { max_read, max_write, base, resync })
        } else {
            Err(("resync", message.to_owned()))
        }
    }
}

fn missing(key: &'static str) -> Wrong {
    (key, format!("{key} is missing"))
}

//! Exceptions of Modbus (MODBUS Application Protocol V1.1b3, section 7): the name of each, who sends it, what it states of
//! the request, and the way on, which depends on the function code.

use std::time::Duration;

use super::link_error::LinkError;

/// What a request was for, as far as the way on after its exception depends on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Requested {
    /// Function code; 0: no request of Modbus.
    pub function: u8,
    pub count: u16,
    /// A drive profile maps them.
    pub is_of_profile: bool,
}

pub const fn exception_name(code: u8) -> &'static str {
    match code {
        1 => "illegal function",
        2 => "illegal data address",
        3 => "illegal data value",
        4 => "device failure",
        5 => "acknowledge: it takes long",
        6 => "device busy",
        8 => "memory parity error",
        10 => "gateway path unavailable",
        11 => "the gateway's device does not answer",
        _ => "a code of the maker",
    }
}

/// Who states what of a request: 05 accepts it, 0A and 0B come from a gateway, and every other exception is a refusal.
pub(super) fn sentence(code: u8, requested: Requested, request: &str) -> String {
    match (code, requested.function) {
        (_, 0) => format!("the drive refused {request}"),
        (5, _) => format!("the drive accepted {request} and has not finished it"),
        (10, _) => format!("the gateway has no path for {request}"),
        (11, _) => format!("the gateway got no reply from its device to {request}"),
        _ => format!("the drive refused {request}"),
    }
}

pub(super) const fn help(code: u8, requested: Requested) -> &'static str {
    let Requested { function, count, is_of_profile } = requested;
    match (code, function) {
        (_, 0) => "see the drive's manual for what it accepts in this state",
        (1, _) if is_of_profile => {
            "is it the drive of this profile? `drivebench probe --port PORT` without --drive tries every built-in one; else correct `functions` in the [link] of the profile"
        }
        (1, 3) => {
            "the drive may have input registers only (function code 04): `registers read --input`"
        }
        (1, 4) => "the drive may have holding registers only (function code 03): leave --input out",
        (1, 6) => "the drive may take function code 16 only: add --multiple",
        (1, 16) if count > 1 => {
            "the drive may take one register at a time (function code 06): write them one by one"
        }
        (1, 16) => "the drive may take function code 06 only: leave --multiple out",
        (1, _) => "the drive does not have this function code; its manual lists those that it has",
        (2, _) if is_of_profile => {
            "the profile asks for a register this drive does not have; `drivebench probe --port PORT --drive PROFILE` shows which ones it has"
        }
        (2, _) => {
            "the unit has no such register, or not so many from there on; addresses count from 0 (40001 is 0)"
        }
        (3, 3 | 4 | 23) if count > 1 => {
            "the drive may give fewer registers in one request: read them in smaller parts (ADDRESS:COUNT), down to one by one"
        }
        (3, 3 | 4) => {
            "the drive gives this register only with others, or not at all; see its manual"
        }
        (3, _) => {
            "the value is outside the range that the drive accepts in this state, or these are too many registers at once; its manual has the limits"
        }
        (4, _) => {
            "the drive could not carry it out: look at its display for a fault, its state, a parameter lock or local control"
        }
        (5, _) => {
            "it may still be carried out: read the registers before anything is written again"
        }
        (6, _) => {
            "nothing was carried out: start the command again when the drive has finished what it does"
        }
        (8, _) => {
            "a check of the drive's memory failed: switch it off and on; if it comes again, the drive needs service"
        }
        (10, _) => "check the unit number, and the gateway's table of units and serial ports",
        (11, _) => {
            "the gateway answers and its device does not: check the device's power and wiring, the unit number, and time-out, baud rate and parity in the gateway"
        }
        _ => "the drive's manual explains its own codes",
    }
}

/// Pauses after which a read is repeated whose unit was busy (06) or has accepted it and not finished (05). A write is never
/// repeated.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BusyPauses(u32);

impl BusyPauses {
    /// 20 ms doubled up to 160 ms, ten of them: 1.3 s in all.
    pub(super) fn next(&mut self, error: &LinkError) -> Option<Duration> {
        let LinkError::Exception { code: 5 | 6, requested, .. } = error else { return None };
        if !matches!(requested.function, 3 | 4 | 43) || self.0 == 10 {
            return None;
        }
        self.0 += 1;
        Some(Duration::from_millis(20 << (self.0 - 1).min(3)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exception(code: u8, function: u8, count: u16, is_of_profile: bool) -> LinkError {
        LinkError::Exception {
            link: "x".to_owned(),
            request: "the request".to_owned(),
            code,
            name: exception_name(code),
            requested: Requested { function, count, is_of_profile },
        }
    }

    #[test]
    fn each_exception_has_its_sender_and_its_own_way_on() {
        for (code, function, count, sentence, help) in [
            (1, 3, 1, "the drive refused", "--input"),
            (1, 4, 1, "the drive refused", "leave --input out"),
            (1, 6, 1, "the drive refused", "--multiple"),
            (1, 16, 1, "the drive refused", "leave --multiple out"),
            (1, 16, 2, "the drive refused", "one by one"),
            (1, 43, 1, "the drive refused", "its manual lists"),
            (2, 3, 1, "the drive refused", "40001 is 0"),
            (3, 3, 5, "the drive refused", "smaller parts"),
            (3, 3, 1, "the drive refused", "only with others"),
            (3, 6, 1, "the drive refused", "range"),
            (4, 6, 1, "the drive refused", "display"),
            (5, 6, 1, "the drive accepted", "before anything is written again"),
            (6, 3, 1, "the drive refused", "start the command again"),
            (8, 3, 1, "the drive refused", "memory"),
            (10, 3, 1, "the gateway has no path", "gateway's table"),
            (11, 3, 1, "the gateway got no reply", "power and wiring"),
            (99, 3, 1, "the drive refused", "manual"),
        ] {
            let error = exception(code, function, count, false);
            let context = format!("{code} to {function}: {error} {}", error.help());
            assert!(error.to_string().contains(sentence), "{context}");
            assert!(error.help().contains(help), "{context}");
        }
        // Only an unknown register blames the register map of a profile; the stream has codes of its own.
        for (code, blames) in
            [(1, false), (2, true), (3, false), (4, false), (5, false), (6, false)]
        {
            let help = exception(code, 3, 1, true).help();
            assert_eq!(help.contains("does not have; `drivebench probe"), blames, "{code}: {help}");
        }
        assert!(exception(5, 0, 0, false).to_string().contains("the drive refused"));
    }
}

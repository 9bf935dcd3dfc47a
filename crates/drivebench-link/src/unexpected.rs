//! What came in the place of the awaited reply: its sentence, and the way on.

/// The difference between what came and the reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unexpected {
    /// A frame of this unit.
    Unit(u8),
    /// A reply with this transaction number of Modbus TCP.
    Transaction { found: u16, expected: u16 },
    /// A reply with so many bytes of data.
    Length { found: usize, expected: usize },
    /// Another frame that answers no request of this host.
    Frame,
    /// The request itself, which the line returns, and no reply.
    Echo,
    /// Frames of RTU on a connection of Modbus TCP.
    RtuFrames,
    /// A frame of Modbus ASCII.
    Ascii,
    /// A header of Modbus TCP that announces more bytes than came.
    Incomplete { announced: usize, came: usize },
    /// Replies to earlier requests with every probe.
    OutOfStep,
}

impl Unexpected {
    pub(super) fn sentence(self, request: &str) -> String {
        match self {
            Self::Unit(unit) => format!("only a frame of unit {unit} came in reply to {request}"),
            Self::Transaction { found, expected } => {
                format!(
                    "the reply to {request} carries transaction number {found} instead of {expected}"
                )
            }
            Self::Length { found, expected } => {
                format!(
                    "the reply to {request} carries {found} bytes of data instead of {expected}"
                )
            }
            Self::Frame => format!("only frames that do not answer {request} came"),
            Self::Echo => {
                format!(
                    "only the host's own bytes came back, and no reply to {request}: the line echoes, and the unit is silent"
                )
            }
            Self::RtuFrames => {
                format!(
                    "frames of Modbus RTU came over TCP in reply to {request}, which went out as Modbus TCP"
                )
            }
            Self::Ascii => format!("a frame of Modbus ASCII came in reply to {request}"),
            Self::Incomplete { announced, came } => {
                format!(
                    "the reply to {request} announces {announced} bytes in its header and has {came}"
                )
            }
            Self::OutOfStep => {
                "the line is out of step: older replies came with every probe".to_owned()
            }
        }
    }

    pub(super) const fn help(self, is_network: bool) -> &'static str {
        match self {
            Self::Unit(0) if !is_network => {
                "0 is the broadcast address, with which no unit answers: set the unit number of the drive to one from 1 to 247"
            }
            Self::Unit(_) => {
                "give the number of the unit that answers (--unit, link.unit in a bench file); if it is not the drive, two devices share the line"
            }
            Self::Transaction { .. } => {
                "the server does not return the transaction number of its request, as Modbus TCP requires, and no value can be proven: look for newer firmware, or set it to a transparent connection and use RTU over TCP (--rtu-over-tcp)"
            }
            Self::Length { found, expected } if found > expected => {
                "the drive sends more bytes for each register than the 2 of Modbus: its manual may have a mode with registers of 16 bits"
            }
            Self::Length { .. } => {
                "the drive does not keep to the count of the request, so no value can be proven: compare the address and the count with the register list of its manual"
            }
            Self::Frame => "two devices may share the address or the bus; see the link statistics",
            Self::Echo => {
                "the adapter works and the drive does not answer: check its power, the wires A and B, baud rate, parity and unit number"
            }
            Self::RtuFrames => {
                "a transparent converter: use RTU over TCP (--rtu-over-tcp; link.protocol = \"modbus-rtu-over-tcp\" in a bench file)"
            }
            Self::Ascii => "set the drive's protocol to Modbus RTU",
            Self::Incomplete { .. } => {
                "the server's header is wrong or the reply breaks off: look for newer firmware of the drive or gateway"
            }
            Self::OutOfStep => {
                "late or repeated replies come all the time: allow the drive more time (link.reply_ms in its profile), and look for another master on the line"
            }
        }
    }
}

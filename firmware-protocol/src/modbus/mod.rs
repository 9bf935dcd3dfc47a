//! Modbus server (slave).
//!
//! ```text
//!   bytes -> rtu::RtuReceiver / tcp::TcpReceiver -> unit + PDU -> pdu::respond(bank, PDU) -> PDU -> framing -> bytes
//!                                                                  |
//!                                                       RegisterBank: the drive's registers
//! ```
//!
//! * [`pdu`] answers function codes 03, 04, 06, 08/0, 16, 23 and 43/14.
//! * [`length`] gives the lengths of requests and responses, for framing by receivers and pacing by masters and emulators.

pub mod length;
pub mod pdu;
pub mod rtu;
pub mod tcp;

pub use length::{Length, expected_response_len, request_len, response_len};
pub use pdu::{Exception, MAX_PDU, RegisterBank, respond};
pub use rtu::{RtuFrame, RtuReceiver};
pub use tcp::{TcpFrame, TcpReceiver};

//! Modbus as a slave speaks it.
//!
//! ```text
//!   bytes -> rtu::RtuReceiver / tcp::TcpReceiver -> unit + PDU -> pdu::respond(bank, PDU) -> PDU -> framing -> bytes
//!                                                                  |
//!                                                       RegisterBank: the drive's registers
//! ```
//!
//! * [`pdu`] answers function codes 03, 04, 06, 08/0, 16, 23 and 43/14.
//! * [`length`] tells how long requests and responses are: receivers frame by it, masters and emulators pace by it.

pub mod length;
pub mod pdu;
pub mod rtu;
pub mod tcp;

pub use length::{Length, expected_response_len, request_len, response_len};
pub use pdu::{Exception, MAX_PDU, RegisterBank, respond};
pub use rtu::{RtuFrame, RtuReceiver};
pub use tcp::{TcpFrame, TcpReceiver};

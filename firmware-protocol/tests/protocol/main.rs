//! The contract seen from outside, as emulator and host see it.
//!
//! ```text
//!   registers    the table and its blocks         properties   any bytes, any values, any splits
//!   modbus       codec and framing by example     golden       vectors/ against the code
//!   specification  SPEC.md against the code
//!   header       drivebench_protocol.h against the table
//!   support      a bank of registers, hexadecimal text, freshness of generated files
//! ```

mod golden;
mod header;
mod modbus;
mod properties;
mod registers;
mod specification;
mod support;

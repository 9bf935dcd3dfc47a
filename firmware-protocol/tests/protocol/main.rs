//! The contract seen from outside, as emulator and host see it.
//!
//! ```text
//!   registers    the table and its blocks         properties   any bytes, any values, any splits
//!   modbus       codec and framing by example     golden       vectors/ against the code
//!   specification  SPEC.md against the code; examples: vectors taken apart for it
//!   header       include/drive_protocol.h against the table
//!   garbage      64 KiB of it: work and memory stay in bounds
//!   c_slave      the reference slave in c/ against vectors/ and, dialogue by dialogue, against the codec
//!   support      a bank of registers, hexadecimal text, freshness of generated files
//! ```

#[path = "../c_compiler/mod.rs"]
mod c_compiler;
mod c_slave;
mod examples;
mod garbage;
mod golden;
mod header;
mod modbus;
mod properties;
mod registers;
mod specification;
mod support;

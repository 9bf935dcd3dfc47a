//! Emulator of a drive with its motor, under the same protocols as a real drive.
//!
//! ```text
//!          config.rs (TOML) --> drive/ SoftDrive (state machine, watchdog, limits) --> truth/ (the machine)
//!                                   ^ pure function of drive time
//!   fault.rs   fault injection: line_faults.rs on the bytes of a line, drive/ in the drive
//!   mystery/   hidden effect drawn from a seed
//!   foreign/   the same motor under the register map of another make
//!   memory.rs, line.rs  virtual time, at the level of registers and of bytes
//!   journal.rs true state of the motor, row by row
//!   pty.rs, tcp.rs  real time ------+   (codec.rs: bytes <-> answers, pace.rs: a wire's timing, server.rs: the clock)
//! ```

mod codec;
mod config;
mod drive;
mod fault;
mod foreign;
mod journal;
mod line;
mod line_faults;
mod memory;
pub mod mystery;
mod pace;
#[cfg(target_os = "linux")]
mod pty;
mod server;
mod session;
mod tcp;
pub mod truth;

pub use codec::UNIT;
pub use config::{
    BrakeConfig, EmulatorConfig, EmulatorConfigError, FaultsConfig, LimitsConfig, LineConfig,
    OutputOff,
};
pub use drive::SoftDrive;
pub use drivebench_link::VirtualClock;
pub use fault::{FaultEntry, FaultKind, Injector};
pub use foreign::{ForeignBus, ForeignDrive, Guise};
pub use journal::Journal;
pub use line::open_line;
pub use memory::{Latency, MemoryLink};
pub use server::{Endpoint, Served, ServerError, ServerHandle, ready_line, serve, spawn, spawn_as};

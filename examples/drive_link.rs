//! A drive through its link: identify it, command a voltage for a second, stop. The drive is emulated, in virtual time;
//! `drivebench::drive::open` gives the same [`DriveLink`] for a real port.
//!
//! ```sh
//! cargo run --release --example drive_link
//! ```
#![expect(clippy::print_stdout, reason = "the output of an example")]

use std::error::Error;

use drivebench::drive::{DriveLink, LinkError};
use drivebench::emulator::{EmulatorConfig, Latency, MemoryLink, SoftDrive, VirtualClock};
use drivebench::sample::{Channel, Command, Demand, Sample};

const PERIOD_S: f64 = 0.01;

/// One second at `voltage_v`; the output is off again whatever happens.
pub fn one_second(
    link: &mut dyn DriveLink,
    clock: &VirtualClock,
    voltage_v: f64,
) -> Result<Vec<Sample>, LinkError> {
    let run = |link: &mut dyn DriveLink| -> Result<Vec<Sample>, LinkError> {
        (0..100_u32)
            .map(|cycle| {
                clock.set_time_s(f64::from(cycle) * PERIOD_S);
                let demand = if cycle == 0 { Demand::Disable } else { Demand::Voltage(voltage_v) };
                link.exchange(Command { seq: u64::from(cycle), demand })
            })
            .collect()
    };
    let samples = run(link);
    link.stop()?;
    samples
}

/// The emulated drive without hidden effects.
pub fn emulated() -> Result<(MemoryLink, VirtualClock), Box<dyn Error>> {
    let config = EmulatorConfig::embedded("zk-22fc-plain")?;
    let clock = VirtualClock::new();
    let latency = Latency { request_s: 0.001, reply_s: 0.001 };
    let link = MemoryLink::new(SoftDrive::new(&config, 1), clock.clone(), latency);
    Ok((link, clock))
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut link, clock) = emulated()?;
    println!("{:?}", link.identify()?);
    for sample in one_second(&mut link, &clock, 24.0)?.iter().step_by(10) {
        let read = [Channel::Current, Channel::Speed].map(|channel| sample.get(channel));
        println!("{:6.3} s  {read:?} A, rad/s", sample.time_s);
    }
    Ok(())
}

//! `emulate`: the software drive for other programs.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use serde_json::json;

use crate::runtime::{Failure, LINK, Terminal, USAGE, opening, output, read_text, signals};
use drivebench_emulator::mystery::{self, Mystery};
use drivebench_emulator::{
    EmulatorConfig, Endpoint, Guise, Journal, Served, UNIT, ready_line, serve,
};
use drivebench_link::{DriveProfile, Protocol};

/// Serve the software drive on a pseudo-terminal or a TCP port until interrupted
#[derive(clap::Args)]
#[command(after_help = "Example:\n  drivebench emulate --link modbus-rtu --pty drive.pty
  drivebench run --port ./drive.pty --headless
  drivebench emulate --mystery 7 --pty drive.pty      a hidden effect that the seed draws; shown at the end
  drivebench emulate --profile siemens-v20 --pty v20.pty  answers as that drive, with its registers and its watchdog")]
pub(super) struct Arguments {
    /// Emulator file, or the name of an embedded one; without it the ZK-22FC with a hidden effect
    emulator: Option<String>,
    /// Protocol that the drive has, as modbus-rtu, modbus-tcp, modbus-rtu-over-tcp or stream; without it that of the profile
    #[arg(long)]
    link: Option<String>,
    /// Path of the pseudo-terminal's symlink; without it one in the temporary folder
    #[arg(long, value_name = "PATH", conflicts_with = "listen")]
    pty: Option<PathBuf>,
    /// TCP address, as 127.0.0.1:1502; port 0 takes a free one. Up to 8 hosts at once: each may read, one is in command until
    /// it is gone or has commanded nothing for 2 s; a host that is silent for 60 s is disconnected
    #[arg(long, value_name = "ADDR")]
    listen: Option<SocketAddr>,
    /// Draws the specimen within its tolerance, and the sensor noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Hide an effect that this number draws, and its size; both are printed when the drive ends
    #[arg(long, value_name = "SEED", conflicts_with_all = ["emulator", "seed"])]
    mystery: Option<u64>,
    /// Drive to answer as: a built-in profile or a file
    #[arg(long, value_name = "DRIVE", default_value = "own")]
    profile: String,
    /// The watchdog time of another drive, as set at its keypad, ms; 0 is off; without it as delivered
    #[arg(long, value_name = "MS")]
    watchdog_ms: Option<f64>,
    /// Write the true state of the emulated motor into a new CSV file: a row at each change and every 10 ms, in the monotonic
    /// time of this machine
    #[arg(long, value_name = "FILE")]
    journal: Option<PathBuf>,
    /// Print JSON: one object a line, `ready` when the drive can be opened and `stopped` at the end
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(arguments: Arguments, terminal: &Terminal) -> Result<(), Failure> {
    let (profile, _) = opening::profile(&arguments.profile)?;
    let guise = guise(&profile, arguments.watchdog_ms)?;
    let link = arguments.link.as_deref().unwrap_or_else(|| profile.link.protocol.name());
    let link = Protocol::named(link).ok_or_else(|| {
        let names: Vec<&str> = Protocol::ALL.iter().map(|known| known.name()).collect();
        Failure::usage(
            format!("link {link:?} is not known"),
            format!("known: {}", names.join(", ")),
        )
    })?;
    opening::check_protocol(&profile, link)?;
    if guise.is_some() {
        opening::announce(&profile, terminal);
    }
    let mystery = arguments.mystery.map(mystery::draw);
    let seed = arguments.mystery.unwrap_or(arguments.seed);
    let config = match &arguments.emulator {
        None => match &mystery {
            Some(mystery) => mystery.config.clone(),
            None => EmulatorConfig::embedded_default(),
        },
        Some(name) if Path::new(name).exists() => {
            EmulatorConfig::parse(name, &read_text(name.as_ref())?)?
        }
        Some(name) => opening::emulator_config(name)?,
    };
    config.suits(guise.is_some(), link)?;
    let endpoint = match (arguments.pty, arguments.listen) {
        (Some(path), _) => Endpoint::Pty(path),
        (None, Some(address)) => Endpoint::Tcp(address),
        (None, None) if link.is_network() => Endpoint::Tcp(SocketAddr::from(([127, 0, 0, 1], 0))),
        (None, None) => Endpoint::temporary_pty(),
    };
    if let Endpoint::Tcp(address) = &endpoint
        && let Some(warning) = open_to_others(*address)
    {
        terminal.message(&warning);
    }
    let journal = arguments.journal.as_deref().map(|path| {
        output::refuse_existing([path], "--journal")?;
        Journal::create(path).map_err(|error| output::cannot_write(path, &error))
    });
    let served_drive = Served {
        guise: guise.as_ref(),
        config: &config,
        seed,
        link,
        journal: journal.transpose()?,
    };
    let stop = signals::flag()?;
    let mut served = String::new();
    let (unit, baud) = match &guise {
        Some(guise) => (guise.unit, guise.line.baud),
        None => (UNIT, config.line.baud),
    };
    serve(served_drive, &endpoint, &stop, |address| {
        address.clone_into(&mut served);
        let line = if arguments.json {
            json!({
                "state": "ready",
                "link": link.to_string(),
                "address": address,
                "unit": unit,
                "baud": baud,
                "profile": profile.name,
            })
            .to_string()
        } else {
            ready_line(link, address, &config, guise.as_ref())
        };
        // A line that nobody reads is no error.
        let _ = terminal.line(&line);
    })
    .map_err(|error| {
        let status = if error.is_usage() { USAGE } else { LINK };
        Failure::with_help(status, error.to_string(), error.help())
    })?;
    if let Some(Mystery { seed, truth, .. }) = &mystery {
        let hidden = truth.effect().map(ToString::to_string);
        let hidden = hidden.unwrap_or_else(|| "no effect".to_owned());
        terminal.message(&format!("mystery {seed} hides {hidden}"));
    }
    if arguments.json {
        let state = json!({ "state": "stopped", "link": link.to_string(), "address": served });
        let _ = terminal.line(&state.to_string());
    }
    Ok(())
}

/// The warning of an address that other machines reach.
fn open_to_others(address: SocketAddr) -> Option<String> {
    let who = match address.ip() {
        ip if ip.is_loopback() => return None,
        ip if ip.is_unspecified() => format!("{ip} is every address of this machine"),
        ip => format!("{ip} is reached from other machines"),
    };
    Some(format!(
        "warning: --listen {address}: {who}: anybody on the network can drive this; 127.0.0.1 is for this machine only"
    ))
}

/// The guise of a profile; our own map needs none.
fn guise(profile: &DriveProfile, watchdog_ms: Option<f64>) -> Result<Option<Guise>, Failure> {
    let guise = Guise::of(profile);
    match (guise, watchdog_ms) {
        (guise, None) => Ok(guise),
        (Some(guise), Some(ms)) if (0.0..=60_000.0).contains(&ms) => {
            Ok(Some(Guise { watchdog_s: Some(ms * 1e-3), ..guise }))
        }
        (Some(_), Some(ms)) => {
            Err(Failure::usage(format!("--watchdog-ms {ms} is not allowed"), "allowed: 0 to 60000"))
        }
        (None, Some(_)) => Err(Failure::usage(
            "--watchdog-ms is for the profile of another drive",
            "for our own: watchdog_ms in the emulator file",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_that_others_reach_has_a_warning() {
        let warning = |address: &str| open_to_others(address.parse().unwrap());
        for open in ["0.0.0.0:502", "[::]:502", "192.168.1.7:502"] {
            let text = warning(open).unwrap();
            assert!(text.contains("anybody on the network"), "{open}: {text}");
        }
        for local in ["127.0.0.1:502", "[::1]:502"] {
            assert_eq!(warning(local), None, "{local}");
        }
    }
}

//! The `drivebench` program; everything is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    drivebench::commands::main()
}

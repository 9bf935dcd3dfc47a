//! One hot path, a given number of times: for external profilers.
//!
//! ```text
//! kernel                   ids of all, with their elements
//! kernel online/push 20    runs it twenty times, prints the nanoseconds of one element
//! kernel table             the rows that it reads, as CSV, for others to read
//! ```

#[path = "common/kernels.rs"]
mod kernels;
#[path = "common/records.rs"]
mod records;
#[path = "common/rows.rs"]
mod rows;

use std::time::Instant;

#[expect(
    clippy::disallowed_methods,
    clippy::print_stdout,
    reason = "a benchmark measures time, and prints it"
)]
fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    match words.as_slice() {
        // `cargo bench` starts every benchmark; this one runs on request only.
        [word] if word == "--bench" => {}
        [word] if word == "table" => print!("{}", kernels::text()),
        [] => {
            for (id, make) in kernels::ALL {
                println!("{id} {}", make().elements);
            }
        }
        [id, times] => {
            let known = kernels::ALL.into_iter().find(|(name, _)| name == id);
            let (Some((_, make)), Ok(times)) = (known, times.parse::<u32>()) else {
                eprintln!("error: {id} {times}: no such kernel, or no number");
                std::process::exit(2);
            };
            let mut kernel = make();
            let begun = Instant::now();
            for _ in 0..times {
                (kernel.work)();
            }
            let each = f64::from(times) * kernel.elements as f64;
            println!("{:.3}", begun.elapsed().as_secs_f64() * 1e9 / each);
        }
        _ => {
            eprintln!("error: expected nothing, or an id and a number");
            std::process::exit(2);
        }
    }
}

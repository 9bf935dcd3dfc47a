//! Units and gateways with one habit of real devices, through the real binary: what is read, what a write has done, what is
//! named, and that the way on which is printed is one.

use std::io::{Read as _, Write as _};
use std::net::TcpListener;
use std::time::{Duration, Instant};

use crate::kit::prelude::*;
use crate::witness::codec::framed;

/// The clock of the unit.
#[expect(clippy::disallowed_methods, reason = "a unit in real time")]
fn now() -> Instant {
    Instant::now()
}

/// Serves one host after another until the process ends: each request is handed to `reply`, whose bytes go back.
fn serve(mut reply: impl FnMut(&[u8]) -> Vec<u8> + Send + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("bound").to_string();
    std::thread::spawn(move || {
        while let Ok((mut stream, _)) = listener.accept() {
            let mut request = [0; 300];
            while let Ok(count @ 1..) = stream.read(&mut request) {
                if stream.write_all(&reply(&request[..count])).is_err() {
                    break;
                }
            }
        }
    });
    address
}

/// A unit whose register holds its own address, unless it was written; `habit` may answer a PDU otherwise.
fn unit(mut habit: impl FnMut(&[u8]) -> Option<Vec<u8>>) -> impl FnMut(&[u8]) -> Vec<u8> {
    let mut written = std::collections::BTreeMap::new();
    move |pdu: &[u8]| {
        if let Some(reply) = habit(pdu) {
            return reply;
        }
        let word = |at: usize| u16::from_be_bytes([pdu[at], pdu[at + 1]]);
        match pdu[0] {
            code @ (3 | 4) => {
                let words = (word(1)..).take(word(3).into());
                let words = words.map(|address| written.get(&address).copied().unwrap_or(address));
                let bytes: Vec<u8> = words.flat_map(u16::to_be_bytes).collect();
                [&[code, 2 * pdu[4]], &bytes[..]].concat()
            }
            6 => {
                written.insert(word(1), word(3));
                pdu.to_vec()
            }
            16 => {
                for (address, at) in (word(1)..).zip((6..pdu.len()).step_by(2)) {
                    written.insert(address, word(at));
                }
                pdu[..5].to_vec()
            }
            8 => pdu.to_vec(),
            code => vec![code | 0x80, 1],
        }
    }
}

/// Over Modbus TCP, with what `header` makes of transaction number and unit.
fn tcp(
    habit: impl FnMut(&[u8]) -> Option<Vec<u8>> + Send + 'static,
    header: impl Fn(&mut [u8]) + Send + 'static,
) -> String {
    let mut unit = unit(habit);
    serve(move |request| {
        let reply = unit(&request[7..]);
        let mut frame = request[..7].to_vec();
        frame[5] = u8::try_from(reply.len() + 1).expect("short");
        header(&mut frame);
        [frame, reply].concat()
    })
}

/// Frames of RTU over TCP, with what `line` makes of request and reply.
fn rtu(
    habit: impl FnMut(&[u8]) -> Option<Vec<u8>> + Send + 'static,
    line: impl Fn(&[u8], Vec<u8>) -> Vec<u8> + Send + 'static,
) -> String {
    let mut unit = unit(habit);
    serve(move |request| match request.split_last_chunk::<2>() {
        Some((body, _)) if framed(body) == request => {
            let reply = [&body[..1], &unit(&body[1..])].concat();
            line(request, framed(&reply))
        }
        _ => Vec::new(),
    })
}

fn plain(_: &[u8]) -> Option<Vec<u8>> {
    None
}

fn clean(_: &[u8], reply: Vec<u8>) -> Vec<u8> {
    reply
}

/// An exception to every request of these function codes.
fn refuses(code: u8, functions: &'static [u8]) -> impl FnMut(&[u8]) -> Option<Vec<u8>> {
    move |pdu| functions.contains(&pdu[0]).then(|| vec![pdu[0] | 0x80, code])
}

/// A command against a unit: `{}` stands for `--host ADDRESS --timeout-ms 300`.
#[track_caller]
fn ask(name: &str, address: &str, command: &str, status: i32, parts: &[&str]) {
    let wire = format!("--host {address} --timeout-ms 300");
    let done = call(&command.replace("{}", &wire), &[]).expect(status);
    let text = [&done.stdout, &done.stderr]
        .map(|text| text.split_whitespace().collect::<Vec<_>>().join(" "));
    let text = text.join(" ");
    for part in parts {
        match part.strip_prefix('!') {
            Some(part) => assert!(!text.contains(part), "{name}: {part} in {text}"),
            None => assert!(text.contains(part), "{name}: {part} not in {text}"),
        }
    }
}

/// An address at which there is a unit with this habit.
fn odd(habit: &str) -> String {
    match habit {
        "a number of its own" => tcp(plain, |header| header[1] ^= 0x40),
        "unit 255" => tcp(plain, |header| header[6] = 255),
        "unit 0" => tcp(plain, |header| header[6] = 0),
        "a header that is too long" => tcp(plain, |header| header[5] += 1),
        "registers of 32 bits" => {
            let zeros = |pdu: &[u8]| vec![0; 4 * usize::from(pdu[4])];
            tcp(move |pdu| Some([&[pdu[0], 4 * pdu[4]], &zeros(pdu)[..]].concat()), |_| ())
        }
        "rtu frames" => rtu(plain, clean),
        "zero in front" => rtu(plain, |_, reply| [vec![0], reply].concat()),
        "zeros behind" => rtu(plain, |_, reply| [reply, vec![0; 3]].concat()),
        "each frame twice" => rtu(plain, |_, reply| reply.repeat(2)),
        "echo and silence" => rtu(plain, |request, _| request.to_vec()),
        "echo" => rtu(plain, |request, reply| [request, &reply].concat()),
        "busy" => tcp(refuses(6, &[3]), |_| ()),
        "no function 3" => tcp(refuses(1, &[3]), |_| ()),
        "no function 6" => tcp(refuses(1, &[6]), |_| ()),
        "one at a time" => tcp(|pdu| (pdu[0] == 3 && pdu[4] > 1).then(|| vec![0x83, 3]), |_| ()),
        "no such register" => tcp(refuses(2, &[3]), |_| ()),
        "a gateway without its unit" => tcp(refuses(11, &[3]), |_| ()),
        "busy for writes" => tcp(refuses(6, &[6]), |_| ()),
        other => panic!("{other}"),
    }
}

/// A table of a unit, a command against it, the status, and parts of the answer.
#[track_caller]
fn answers(table: &str, address: impl Fn(&str) -> String) {
    for [unit, command, status, parts] in cases(table) {
        let parts: Vec<&str> = parts.split(" & ").collect();
        let name = format!("{unit}, {command}");
        ask(&name, &address(unit), command, status.parse().unwrap(), &parts);
    }
}

#[test]
fn what_a_unit_answers_is_used_or_named_with_a_way_on_that_works() {
    const ANSWERS: &str = "
a number of its own | registers read 10:3 {} | 3 | transaction number & --rtu-over-tcp & !000a & !latency
unit 255 | registers read 10:3 {} | 3 | a frame of unit 255 & --unit & !latency
unit 255 | registers read 10:3 --unit 255 {} | 0 | 10 11 12
unit 0 | registers read 10:3 --unit 0 {} | 0 | 10 11 12
a header that is too long | registers read 10:3 {} | 3 | announces 16 bytes & !baud rate
registers of 32 bits | registers read 10:3 {} | 3 | 12 bytes of data instead of 6 & !latency
rtu frames | registers read 10:3 {} | 3 | --rtu-over-tcp
rtu frames | registers read 10:3 --rtu-over-tcp {} | 0 | 10 11 12
rtu frames | doctor --rtu-over-tcp {} | 0 | works: all 50 requests
zero in front | registers read 10:3 --rtu-over-tcp {} | 0 | 10 11 12 & stray bytes
zeros behind | registers read 10:3 --rtu-over-tcp {} | 0 | 10 11 12 & stray bytes
each frame twice | registers read 10:3 --rtu-over-tcp {} | 0 | 10 11 12
echo and silence | registers read 10:3 --rtu-over-tcp {} | 3 | own bytes came back & the adapter works
echo | registers read 10:3 --rtu-over-tcp {} | 0 | 10 11 12
busy | registers read 10:3 {} | 3 | 0x06 device busy & repeated because the unit was busy: 10 & !no such register
busy | doctor {} | 0 | all with exception 0x06 & !does not have
no function 3 | registers read 10:3 {} | 3 | --input
no function 3 | registers read 10:3 --input {} | 0 | 10 11 12
no function 6 | registers write 50 77 --yes --hardware {} | 3 | --multiple
no function 6 | registers write 50 77 --multiple --yes --hardware {} | 0 | confirmed
one at a time | registers read 10:3 {} | 3 | one by one
one at a time | registers read 10 11 12 {} | 0 | 000b
no such register | registers read 40001 {} | 3 | 40001 is 0
no such register | registers write 50 77 --yes --hardware {} | 0 | acknowledged, cannot be read back
a gateway without its unit | registers read 10:3 {} | 3 | the gateway got no reply & !the drive refused
busy for writes | registers write 50 77 --yes --hardware {} | 3 | NOT confirmed & nothing was carried out
";
    answers(ANSWERS, odd);
}

/// A register of this unit holds its own address until it is written.
#[test]
fn a_unit_that_does_not_call_itself_an_emulator_counts_as_hardware() {
    let address = tcp(plain, |_| ());
    ask("write", &address, "registers write 5 7 --yes {}", 2, &["--hardware"]);
    ask("read", &address, "registers read 5 {}", 0, &["0005"]);
}

#[test]
fn a_write_that_is_accepted_first_is_waited_for() {
    let mut accepted: Option<Instant> = None;
    let address = tcp(
        move |pdu| match pdu[0] {
            6 => {
                accepted = Some(now());
                Some(vec![0x86, 5])
            }
            3 => {
                let acts = Duration::from_millis(400);
                let is_done = accepted.is_some_and(|at| at.elapsed() >= acts);
                let words = (0..pdu[4]).flat_map(|_| [0, if is_done { 77 } else { 50 }]);
                Some([3, 2 * pdu[4]].into_iter().chain(words).collect())
            }
            _ => None,
        },
        |_| (),
    );
    ask(
        "accepted",
        &address,
        "registers write 50 77 --yes --hardware {}",
        0,
        &["accepted (exception 0x05 acknowledge), confirmed", "!refused"],
    );
}

/// All of one unit, so that what is written first is read afterwards.
#[test]
fn values_of_every_type_are_written_and_read_back() {
    const ANSWERS: &str = "
write | registers write 4x0401 49.98 --as f32 --order CDAB --yes --hardware {} | 0 | 4x0401 is holding register 400 & confirmed & as f32 CDAB 49.98
read | registers read 400 --as f32 --order cdab {} | 0 | 49.98 & eb85 4247
guess | registers read 400001:2 400401:2 --guess {} | 0 | f32 CDAB 49.98 & short decimal
input | registers read 3x11 {} | 0 | 3x11 is input register 10 & 000a
plain 40001 | registers read 40001 {} | 0 | 9c41
odd number | registers read 400:3 --as u32 {} | 2 | no whole number of values & 400:2
out of range | registers write 50 70000 --as i16 --yes --hardware {} | 2 | -32768 to 32767
";
    let address = tcp(plain, |_| ());
    answers(ANSWERS, |_| address.clone());
}

//! Modbus RTU as a drive hears and speaks it: frames made from the standard alone, with nothing of the program under test.

/// Remainder of the polynomial x^16 + x^15 + x^2 + 1, lowest bit first, one bit at a time.
pub(crate) fn crc(bytes: &[u8]) -> u16 {
    let mut remainder = 0xFFFF_u16;
    for byte in bytes {
        remainder ^= u16::from(*byte);
        for _ in 0..8 {
            let carry = remainder & 1 == 1;
            remainder >>= 1;
            if carry {
                remainder ^= 0xA001;
            }
        }
    }
    remainder
}

/// The frame with its check sum.
pub(crate) fn framed(body: &[u8]) -> Vec<u8> {
    let mut frame = body.to_vec();
    frame.extend(crc(body).to_le_bytes());
    frame
}

/// What a host asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Request {
    Read {
        function: u8,
        address: u16,
        count: u16,
    },
    Write {
        function: u8,
        address: u16,
        values: Vec<u16>,
    },
    /// Writes first, then reads.
    WriteRead {
        read: (u16, u16),
        write: u16,
        values: Vec<u16>,
    },
    /// Function code 8, returned as it came.
    Echo(Vec<u8>),
    Unknown(u8),
}

fn word(bytes: &[u8], at: usize) -> u16 {
    u16::from_be_bytes([bytes[at], bytes[at + 1]])
}

fn words(bytes: &[u8]) -> Vec<u16> {
    bytes.chunks_exact(2).map(|pair| word(pair, 0)).collect()
}

/// The whole length of the request that begins here, where enough of it is there to tell.
fn length(bytes: &[u8]) -> Option<usize> {
    Some(match *bytes.get(1)? {
        16 => 9 + usize::from(*bytes.get(6)?),
        23 => 13 + usize::from(*bytes.get(10)?),
        43 => 7,
        _ => 8,
    })
}

/// The request at the head of what has come: its unit, what it asks, and its bytes. `Err`: no frame, the check sum is wrong.
pub(crate) fn request(bytes: &[u8]) -> Option<Result<(u8, Request, usize), usize>> {
    let whole = length(bytes)?;
    let frame = bytes.get(..whole)?;
    let body = &frame[..whole - 2];
    if framed(body) != frame {
        return Some(Err(whole));
    }
    let request = match body[1] {
        function @ (3 | 4) => {
            Request::Read { function, address: word(body, 2), count: word(body, 4) }
        }
        6 => Request::Write { function: 6, address: word(body, 2), values: vec![word(body, 4)] },
        16 => Request::Write { function: 16, address: word(body, 2), values: words(&body[7..]) },
        23 => Request::WriteRead {
            read: (word(body, 2), word(body, 4)),
            write: word(body, 6),
            values: words(&body[11..]),
        },
        8 => Request::Echo(body[2..].to_vec()),
        function => Request::Unknown(function),
    };
    Some(Ok((body[0], request, whole)))
}

/// Reply with registers.
pub(crate) fn registers(unit: u8, function: u8, values: &[u16]) -> Vec<u8> {
    let bytes = u8::try_from(2 * values.len()).expect("at most 125 registers");
    let mut body = vec![unit, function, bytes];
    body.extend(values.iter().flat_map(|value| value.to_be_bytes()));
    framed(&body)
}

/// Reply to a write.
pub(crate) fn written(unit: u8, function: u8, address: u16, values: &[u16]) -> Vec<u8> {
    let second = match function {
        6 => values[0],
        _ => u16::try_from(values.len()).expect("at most 123 registers"),
    };
    let mut body = vec![unit, function];
    body.extend(address.to_be_bytes());
    body.extend(second.to_be_bytes());
    framed(&body)
}

pub(crate) fn exception(unit: u8, function: u8, code: u8) -> Vec<u8> {
    framed(&[unit, function | 0x80, code])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The frame that the standard's own description shows.
    #[test]
    fn the_check_sum_is_that_of_the_standard() {
        assert_eq!(crc(&[0x02, 0x07]), 0x1241);
        let read = framed(&[0x11, 0x03, 0x00, 0x6B, 0x00, 0x03]);
        assert_eq!(read[6..], [0x76, 0x87]);
        let asked = Request::Read { function: 3, address: 0x6B, count: 3 };
        assert_eq!(request(&read), Some(Ok((0x11, asked, 8))));
    }
}

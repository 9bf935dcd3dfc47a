//! The slave's side of the application protocol (MODBUS Application Protocol Specification V1.1b3, sections 6 and 7).

use crate::bytes::Bytes;
use crate::codes::coded;

/// Longest PDU, bytes.
pub const MAX_PDU: usize = 253;

/// Most registers of a read and of a write.
const MAX_READ: usize = 125;
const MAX_WRITE: usize = 123;
/// MEI type of the device identification.
const DEVICE_IDENTIFICATION: u8 = 14;

coded! {
    /// Why a request is refused.
    Exception: u8 {
        /// 01: the function code is not served.
        IllegalFunction = 1,
        /// 02: an address of the range has no register, or may not be written.
        IllegalAddress = 2,
        /// 03: quantity, length or value is not allowed.
        IllegalValue = 3,
        /// 04: the drive failed while it acted.
        DeviceFailure = 4,
        /// 06: the drive is busy, ask again.
        Busy = 6,
    }
}

impl From<crate::registers::WriteError> for Exception {
    fn from(error: crate::registers::WriteError) -> Self {
        match error {
            crate::registers::WriteError::Range => Self::IllegalValue,
            _ => Self::IllegalAddress,
        }
    }
}

/// The drive's registers, holding and input alike.
pub trait RegisterBank {
    /// Fills `out` with the registers from `address` on; the range does not wrap.
    ///
    /// # Errors
    /// The exception to answer; `out` is then not sent.
    fn read(&mut self, address: u16, out: &mut [u16]) -> Result<(), Exception>;

    /// Writes all registers or, on error, none.
    ///
    /// # Errors
    /// The exception to answer.
    fn write(&mut self, address: u16, values: &[u16]) -> Result<(), Exception>;

    /// Whether [`RegisterBank::read`] would serve the range. Called before the write of function code 23, so that a refused request
    /// has no effect.
    fn readable(&self, _address: u16, _quantity: usize) -> bool {
        true
    }

    /// Device identification: 0 vendor, 1 product code, 2 revision, 3 URL, 4 product name, 5 model, 6 application.
    fn identification(&self, object: u8) -> Option<&str>;
}

/// Answers one request; no bytes only for an empty one.
pub fn respond(bank: &mut impl RegisterBank, request_pdu: &[u8]) -> Bytes<MAX_PDU> {
    let Some((&function, data)) = request_pdu.split_first() else {
        return Bytes::EMPTY;
    };
    let mut response = Bytes::of(&[function]);
    let answer = match function {
        3 | 4 => read(bank, data, &mut response),
        6 => write_single(bank, data, &mut response),
        8 => echo(data, &mut response),
        16 => write_multiple(bank, data, &mut response),
        23 => read_write(bank, data, &mut response),
        43 => identify(bank, data, &mut response),
        _ => Err(Exception::IllegalFunction),
    };
    let refusal = |exception: Exception| Bytes::of(&[function | 0x80, exception.code()]);
    answer.map_or_else(refusal, |()| response)
}

/// What follows the function code has been put into the response.
type Answer = Result<(), Exception>;

fn read(bank: &mut impl RegisterBank, data: &[u8], response: &mut Bytes<MAX_PDU>) -> Answer {
    let [a1, a0, q1, q0] = *data else {
        return Err(Exception::IllegalValue);
    };
    let quantity = usize::from(word(q1, q0));
    read_registers(bank, word(a1, a0), quantity, response)
}

fn read_registers(
    bank: &mut impl RegisterBank,
    address: u16,
    quantity: usize,
    response: &mut Bytes<MAX_PDU>,
) -> Answer {
    if !(1..=MAX_READ).contains(&quantity) {
        return Err(Exception::IllegalValue);
    }
    check_range(address, quantity)?;
    let mut registers = [0_u16; MAX_READ];
    let registers = &mut registers[..quantity];
    bank.read(address, registers)?;
    response.extend(&[byte(2 * quantity)]);
    for register in registers {
        response.extend(&register.to_be_bytes());
    }
    Ok(())
}

fn write_single(
    bank: &mut impl RegisterBank,
    data: &[u8],
    response: &mut Bytes<MAX_PDU>,
) -> Answer {
    let [a1, a0, v1, v0] = *data else {
        return Err(Exception::IllegalValue);
    };
    bank.write(word(a1, a0), &[word(v1, v0)])?;
    response.extend(data);
    Ok(())
}

/// Sub-function 0, return query data.
fn echo(data: &[u8], response: &mut Bytes<MAX_PDU>) -> Answer {
    let [s1, s0, query @ ..] = data else {
        return Err(Exception::IllegalValue);
    };
    if word(*s1, *s0) != 0 {
        return Err(Exception::IllegalFunction);
    }
    if query.is_empty() || data.len() >= MAX_PDU {
        return Err(Exception::IllegalValue);
    }
    response.extend(data);
    Ok(())
}

fn write_multiple(
    bank: &mut impl RegisterBank,
    data: &[u8],
    response: &mut Bytes<MAX_PDU>,
) -> Answer {
    let [a1, a0, q1, q0, count, values @ ..] = data else {
        return Err(Exception::IllegalValue);
    };
    let (address, quantity) = (word(*a1, *a0), usize::from(word(*q1, *q0)));
    let registers = parse_write(address, quantity, MAX_WRITE, *count, values)?;
    bank.write(address, &registers[..quantity])?;
    response.extend(&data[..4]);
    Ok(())
}

/// The values of a write whose quantity, byte count and address range are right.
fn parse_write(
    address: u16,
    quantity: usize,
    most: usize,
    count: u8,
    values: &[u8],
) -> Result<[u16; MAX_WRITE], Exception> {
    let fits = usize::from(count) == 2 * quantity && values.len() == 2 * quantity;
    if !(1..=most).contains(&quantity) || !fits {
        return Err(Exception::IllegalValue);
    }
    check_range(address, quantity)?;
    let mut registers = [0_u16; MAX_WRITE];
    for (slot, bytes) in registers.iter_mut().zip(values.as_chunks::<2>().0) {
        *slot = u16::from_be_bytes(*bytes);
    }
    Ok(registers)
}

/// The write comes before the read. Both ranges are judged before anything is written.
fn read_write(bank: &mut impl RegisterBank, data: &[u8], response: &mut Bytes<MAX_PDU>) -> Answer {
    let [ra1, ra0, rq1, rq0, wa1, wa0, wq1, wq0, count, values @ ..] = data else {
        return Err(Exception::IllegalValue);
    };
    let (read_address, read_quantity) = (word(*ra1, *ra0), usize::from(word(*rq1, *rq0)));
    let (address, quantity) = (word(*wa1, *wa0), usize::from(word(*wq1, *wq0)));
    if !(1..=MAX_READ).contains(&read_quantity) {
        return Err(Exception::IllegalValue);
    }
    // Two registers fewer than of a plain write: the request holds the range to read, too.
    let registers = parse_write(address, quantity, 121, *count, values)?;
    check_range(read_address, read_quantity)?;
    if !bank.readable(read_address, read_quantity) {
        return Err(Exception::IllegalAddress);
    }
    bank.write(address, &registers[..quantity])?;
    read_registers(bank, read_address, read_quantity, response)
}

/// Device identification (section 6.21): basic and regular as a stream, or one object.
fn identify(bank: &impl RegisterBank, data: &[u8], response: &mut Bytes<MAX_PDU>) -> Answer {
    let [kind, rest @ ..] = data else {
        return Err(Exception::IllegalValue);
    };
    if *kind != DEVICE_IDENTIFICATION {
        return Err(Exception::IllegalFunction);
    }
    let [code, object] = *rest else {
        return Err(Exception::IllegalValue);
    };
    let (first, last) = match code {
        1 => (object, 2),
        // Extended is answered at the drive's own level, regular.
        2 | 3 => (object, 6),
        4 if bank.identification(object).is_some() => (object, object),
        4 => return Err(Exception::IllegalAddress),
        _ => return Err(Exception::IllegalValue),
    };
    // A stream that asks for an object that does not exist begins again at object 0.
    let known = first <= last && bank.identification(first).is_some();
    let first = if known { first } else { 0 };
    // Conformity: regular objects, stream and individual access. Whether more follows, where it begins, and how many there are
    // is known behind the last of them.
    response.extend(&[DEVICE_IDENTIFICATION, code, 0x82, 0, 0, 0]);
    for object in first..=last {
        let Some(text) = bank.identification(object) else {
            continue;
        };
        // An object longer than a whole response is cut.
        let text = text.as_bytes();
        let text = &text[..text.len().min(MAX_PDU - 9)];
        if response.len() + 2 + text.len() > MAX_PDU {
            (response[4], response[5]) = (0xFF, object);
            break;
        }
        response.extend(&[object, byte(text.len())]);
        response.extend(text);
        response[6] += 1;
    }
    Ok(())
}

const fn word(high: u8, low: u8) -> u16 {
    u16::from_be_bytes([high, low])
}

/// A range that runs past 65535 names addresses that do not exist.
fn check_range(address: u16, quantity: usize) -> Result<(), Exception> {
    if usize::from(address) + quantity > 0x1_0000 { Err(Exception::IllegalAddress) } else { Ok(()) }
}

/// Every count in a PDU is below 253.
fn byte(count: usize) -> u8 {
    u8::try_from(count).unwrap_or(u8::MAX)
}

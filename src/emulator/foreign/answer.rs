//! Requests as this drive answers them: its function codes, its limits of length, its registers.

use firmware_protocol::modbus::{
    Exception, MAX_PDU, RegisterBank, RtuFrame, TcpFrame, respond, rtu, tcp,
};

use super::ForeignDrive;
use super::identity::plate;
use crate::drive::{KickedBy, RegisterTable};

type Answer = Result<Vec<u8>, Exception>;

impl ForeignDrive {
    /// The answer to a request.
    pub fn answer(&mut self, request: &[u8]) -> Vec<u8> {
        let Some((&function, data)) = request.split_first() else {
            return Vec::new();
        };
        if let Some(code) = self.refusing {
            return vec![function | 0x80, code];
        }
        let writes = matches!(function, 6 | 16 | 22 | 23);
        if let Some(code) = self.refusing_writes.filter(|_| writes) {
            return vec![function | 0x80, code];
        }
        let answer = if self.map.functions.contains(&function) {
            self.execute(function, data, request)
        } else {
            Err(Exception::IllegalFunction)
        };
        if answer.is_ok() {
            let by = if writes {
                KickedBy::Write
            } else {
                KickedBy::Any
            };
            self.kick(by);
        }
        answer.unwrap_or_else(|exception| vec![function | 0x80, exception.code()])
    }

    fn execute(&mut self, function: u8, data: &[u8], request: &[u8]) -> Answer {
        match function {
            3 => self.read(function, RegisterTable::Holding, data),
            4 => self.read(function, RegisterTable::Input, data),
            6 => {
                let [a1, a0, v1, v0] = *data else {
                    return Err(Exception::IllegalValue);
                };
                self.write(word(a1, a0), &[word(v1, v0)])?;
                Ok(request.to_vec())
            }
            16 => {
                let [a1, a0, q1, q0, bytes, values @ ..] = data else {
                    return Err(Exception::IllegalValue);
                };
                let values = self.values(word(*q1, *q0), *bytes, values)?;
                self.write(word(*a1, *a0), &values)?;
                Ok(request[..5].to_vec())
            }
            23 => {
                let [r1, r0, n1, n0, a1, a0, q1, q0, bytes, values @ ..] = data else {
                    return Err(Exception::IllegalValue);
                };
                let values = self.values(word(*q1, *q0), *bytes, values)?;
                self.write(word(*a1, *a0), &values)?;
                self.read(function, RegisterTable::Holding, &[*r1, *r0, *n1, *n0])
            }
            _ => {
                // Diagnosis and identification are the same for everyone.
                let mut response = [0; MAX_PDU];
                let length = respond(&mut Plate(plate(&self.map)), request, &mut response);
                Ok(response[..length].to_vec())
            }
        }
    }

    fn read(&mut self, function: u8, table: RegisterTable, data: &[u8]) -> Answer {
        let [a1, a0, q1, q0] = *data else {
            return Err(Exception::IllegalValue);
        };
        let (first, count) = (word(a1, a0), word(q1, q0));
        let length = u8::try_from(2 * u32::from(count)).map_err(|_| Exception::IllegalValue)?;
        if count == 0 || count > self.map.max_read {
            return Err(Exception::IllegalValue);
        }
        let touches = |(at, n): &(u16, u16)| {
            first < at.saturating_add(*n) && *at < first.saturating_add(count)
        };
        let broken = |block: &(u16, u16)| touches(block) && *block != (first, count);
        if self.map.exact_reads.iter().any(broken) {
            return Err(Exception::IllegalValue);
        }
        let mut answer = vec![function, length];
        for offset in 0..count {
            let address = first.checked_add(offset).ok_or(Exception::IllegalAddress)?;
            let register = self
                .register(table, address)
                .ok_or(Exception::IllegalAddress)?;
            answer.extend(register.to_be_bytes());
        }
        Ok(answer)
    }

    fn values(&self, count: u16, bytes: u8, values: &[u8]) -> Result<Vec<u16>, Exception> {
        let whole = values.len() == usize::from(bytes) && u16::from(bytes) == 2 * count;
        if count == 0 || count > self.map.max_write || !whole {
            return Err(Exception::IllegalValue);
        }
        Ok(values
            .chunks_exact(2)
            .map(|pair| word(pair[0], pair[1]))
            .collect())
    }

    fn write(&mut self, first: u16, values: &[u16]) -> Result<(), Exception> {
        let mut addresses = Vec::new();
        for (offset, value) in (0_u16..).zip(values) {
            let address = first.checked_add(offset).ok_or(Exception::IllegalAddress)?;
            let writable = self.map.set_points.iter().any(|point| {
                let at = point.location.address;
                (at..at.saturating_add(point.location.layout.registers())).contains(&address)
            }) || self
                .map
                .watchdog
                .time
                .is_some_and(|(at, _)| at.address == address);
            if !writable {
                return Err(Exception::IllegalAddress);
            }
            addresses.push((address, *value));
        }
        let count = u16::try_from(addresses.len()).map_err(|_| Exception::IllegalValue)?;
        for (address, value) in addresses {
            self.written(address, value);
        }
        self.obey(first, count);
        Ok(())
    }

    pub(in crate::emulator) fn answer_rtu(&mut self, request: &RtuFrame) -> Vec<u8> {
        let response = self.answer(request.pdu());
        if request.is_broadcast() || response.is_empty() {
            return Vec::new();
        }
        let mut frame = [0; rtu::MAX_FRAME];
        let length = rtu::encode_frame(request.unit, &response, &mut frame);
        frame[..length].to_vec()
    }

    pub(in crate::emulator) fn answer_tcp(&mut self, request: &TcpFrame) -> Vec<u8> {
        let response = self.answer(request.pdu());
        let mut frame = [0; tcp::MAX_FRAME];
        let length = tcp::encode_frame(request.transaction, request.unit, &response, &mut frame);
        frame[..length].to_vec()
    }
}

const fn word(high: u8, low: u8) -> u16 {
    u16::from_be_bytes([high, low])
}

/// The type plate for function code 43.
struct Plate(Vec<(u8, String)>);

impl RegisterBank for Plate {
    fn read(&mut self, _: u16, _: &mut [u16]) -> Result<(), Exception> {
        Err(Exception::IllegalAddress)
    }

    fn write(&mut self, _: u16, _: &[u16]) -> Result<(), Exception> {
        Err(Exception::IllegalAddress)
    }

    fn identification(&self, object: u8) -> Option<&str> {
        let known = self.0.iter().find(|(known, _)| *known == object)?;
        Some(&known.1)
    }
}

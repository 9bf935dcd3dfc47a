//! Requests for registers and the values of their replies, as bytes of the PDU.

use super::super::modbus::RegisterTable;

/// Most registers of one request (MODBUS Application Protocol V1.1b3, 6.3 and 6.12).
pub const MOST_READ: u16 = 125;
pub const MOST_WRITTEN: usize = 123;

/// One question for registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadRequest {
    pub table: RegisterTable,
    /// Protocol address, from 0.
    pub address: u16,
    /// 1 to [`MOST_READ`].
    pub count: u16,
}

impl ReadRequest {
    pub(super) const fn function(self) -> u8 {
        match self.table {
            RegisterTable::Holding => 3,
            RegisterTable::Input => 4,
        }
    }

    /// RTU frame of the reply.
    pub(in crate::drive) fn reply_bytes(self) -> usize {
        5 + 2 * usize::from(self.count)
    }

    pub(in crate::drive) fn pdu(self) -> [u8; 5] {
        let [a, b] = self.address.to_be_bytes();
        let [c, d] = self.count.to_be_bytes();
        [self.function(), a, b, c, d]
    }
}

/// Values of a reply to a read whose length was checked.
pub(super) fn values(response: &[u8]) -> Vec<u16> {
    let words = response.get(2..).unwrap_or_default().chunks_exact(2);
    words
        .map(|word| u16::from_be_bytes([word[0], word[1]]))
        .collect()
}

/// How a write is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WriteFunction {
    /// Function code 6: one register.
    Single,
    /// Function code 16: any number.
    Multiple,
}

pub(super) fn write_pdu(function: WriteFunction, address: u16, values: &[u16]) -> Vec<u8> {
    let [a, b] = address.to_be_bytes();
    let mut pdu = match function {
        WriteFunction::Single => vec![6, a, b],
        WriteFunction::Multiple => {
            // At most MOST_WRITTEN, which the caller has checked.
            let count = u8::try_from(values.len()).unwrap_or(u8::MAX);
            vec![16, a, b, 0, count, count.saturating_mul(2)]
        }
    };
    pdu.extend(values.iter().flat_map(|value| value.to_be_bytes()));
    pdu
}

/// `1 register`, `2 registers`.
pub fn registers(count: usize) -> String {
    format!("{count} register{}", if count == 1 { "" } else { "s" })
}

pub(in crate::drive) const fn exception_name(code: u8) -> &'static str {
    match code {
        1 => "illegal function",
        2 => "illegal data address",
        3 => "illegal data value",
        4 => "device failure",
        5 => "acknowledge: it takes long",
        6 => "device busy",
        8 => "memory parity error",
        10 => "gateway path unavailable",
        11 => "the gateway's device does not answer",
        _ => "a code of the maker",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_the_bytes_of_the_standard() {
        let read = ReadRequest {
            table: RegisterTable::Input,
            address: 0x0108,
            count: 3,
        };
        assert_eq!(read.pdu(), [4, 1, 8, 0, 3]);
        assert_eq!(
            write_pdu(WriteFunction::Single, 1, &[0x0203]),
            [6, 0, 1, 2, 3]
        );
        assert_eq!(
            write_pdu(WriteFunction::Multiple, 1, &[0x000A, 0x0102]),
            [16, 0, 1, 0, 2, 4, 0, 10, 1, 2]
        );
        assert_eq!(values(&[3, 4, 0, 6, 0xFF, 5]), [6, 0xFF05]);
        assert_eq!(values(&[]), [0_u16; 0]);
        assert_eq!([registers(1), registers(2)], ["1 register", "2 registers"]);
    }
}

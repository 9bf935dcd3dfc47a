//! Any request: one complete response of its function, and a refused request writes nothing.
#![no_main]

use firmware_protocol::modbus::{Exception, Length, RegisterBank, respond, response_len};
use firmware_protocol::registers::{check_read, check_write};
use libfuzzer_sys::fuzz_target;

#[derive(Default)]
struct Bank {
    writes: usize,
}

impl RegisterBank for Bank {
    fn read(&mut self, address: u16, out: &mut [u16]) -> Result<(), Exception> {
        out.fill(address);
        if check_read(address, out.len()) { Ok(()) } else { Err(Exception::IllegalAddress) }
    }

    fn write(&mut self, address: u16, values: &[u16]) -> Result<(), Exception> {
        check_write(address, values)?;
        self.writes += 1;
        Ok(())
    }

    fn readable(&self, address: u16, quantity: usize) -> bool {
        check_read(address, quantity)
    }

    fn identification(&self, object: u8) -> Option<&str> {
        (object < 3).then_some("name")
    }
}

fuzz_target!(|request: &[u8]| {
    let mut bank = Bank::default();
    let response = respond(&mut bank, request);
    assert_eq!(response.is_empty(), request.is_empty());
    if let Some(function) = request.first() {
        assert_eq!(response[0] | 0x80, function | 0x80);
        assert_eq!(response_len(&response), Length::Known(response.len()));
        assert!(response[0] & 0x80 == 0 || *function >= 0x80 || bank.writes == 0);
    }
});

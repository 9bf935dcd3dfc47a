//! Requests as this drive answers them: its function codes, its limits of length, its registers.

use firmware_protocol::modbus::{Exception, RegisterBank, respond};

use super::ForeignDrive;
use drivebench_link::{CellTable, KickedBy};

impl ForeignDrive {
    pub fn answer(&mut self, request: &[u8]) -> Vec<u8> {
        let Some(&function) = request.first() else { return Vec::new() };
        let writes = matches!(function, 6 | 16 | 22 | 23);
        let refusing = self.refusing.or(self.refusing_writes.filter(|_| writes));
        let is_known = self.map.functions.contains(&function);
        let unknown = (!is_known).then_some(Exception::IllegalFunction.code());
        if let Some(code) = refusing.or(unknown) {
            return vec![function | 0x80, code];
        }
        let table = match function {
            4 => CellTable::Input,
            _ => CellTable::Holding,
        };
        if let Some(late_s) = self.accepts_for_s.filter(|_| writes && function != 23) {
            self.accepted.push_back((self.soft.time_s() + late_s, request.to_vec()));
            self.kick(KickedBy::Write);
            // Acknowledge.
            return vec![function | 0x80, 5];
        }
        let response = respond(&mut Bank { drive: self, table }, request);
        if response[0] == function {
            let by = if writes { KickedBy::Write } else { KickedBy::Any };
            self.kick(by);
        }
        response.to_vec()
    }

    /// Carries out the accepted writes whose time has come.
    pub(super) fn carry_out_accepted(&mut self) {
        let now_s = self.soft.time_s();
        while self.accepted.front().is_some_and(|(due_s, _)| *due_s <= now_s) {
            let (_, request) = self.accepted.pop_front().unwrap_or_default();
            respond(&mut Bank { drive: self, table: CellTable::Holding }, &request);
        }
    }

    pub(super) fn is_writable(&self, address: u16) -> bool {
        let points = self.map.set_points.iter().map(|point| point.location);
        let mut points = points.map(|at| at.address..at.address.saturating_add(at.layout.cells()));
        let time = self.map.watchdog.time;
        points.any(|addresses| addresses.contains(&address))
            || time.is_some_and(|(at, _)| at.address == address)
    }
}

struct Bank<'a> {
    drive: &'a mut ForeignDrive,
    table: CellTable,
}

impl RegisterBank for Bank<'_> {
    fn read(&mut self, first: u16, out: &mut [u16]) -> Result<(), Exception> {
        let map = &self.drive.map;
        let touches = |(at, n): &(u16, u16)| {
            usize::from(first) < usize::from(*at) + usize::from(*n)
                && usize::from(*at) < usize::from(first) + out.len()
        };
        let is_whole = |block: &(u16, u16)| *block == (first, count(out));
        let mut exact = map.exact_reads.iter();
        if count(out) > map.max_read || exact.any(|block| touches(block) && !is_whole(block)) {
            return Err(Exception::IllegalValue);
        }
        for (address, word) in (first..=u16::MAX).zip(out) {
            *word = self.drive.register(self.table, address).ok_or(Exception::IllegalAddress)?;
        }
        Ok(())
    }

    fn write(&mut self, first: u16, values: &[u16]) -> Result<(), Exception> {
        if count(values) > self.drive.map.max_write {
            return Err(Exception::IllegalValue);
        }
        let words = || (first..=u16::MAX).zip(values);
        if !words().all(|(address, _)| self.drive.is_writable(address)) {
            return Err(Exception::IllegalAddress);
        }
        for (address, value) in words() {
            self.drive.written(address, *value);
        }
        self.drive.apply_write(first, count(values));
        Ok(())
    }

    fn identification(&self, object: u8) -> Option<&str> {
        let mut objects = self.drive.identification_objects.iter();
        let (_, text) = objects.find(|(known, _)| *known == object)?;
        Some(text)
    }
}

fn count(words: &[u16]) -> u16 {
    u16::try_from(words.len()).unwrap_or(u16::MAX)
}

//! In-memory link to the software drive at the level of registers, in virtual time. Unlike the line of `line.rs` (every byte)
//! an exchange takes a constant latency.

use drivebench_link::Result;
use firmware_protocol::modbus::RegisterBank;
use firmware_protocol::registers::{
    CAPTURE_CONTROL, CAPTURE_STATE, COMMAND_ADDRESS, IDENTITY_ADDRESS, IDENTITY_WORDS,
    TELEMETRY_ADDRESS, TELEMETRY_WORDS,
};
use firmware_protocol::{CaptureControl, CaptureState, Telemetry};

use super::SoftDrive;
use super::config::LineConfig;
use super::pace::Pace;
use drivebench_link::burst::{Burst, Capture, WINDOW_ADDRESS, WINDOW_WORDS, window_samples};
use drivebench_link::timeline::{self, Timeline};
use drivebench_link::{
    DriveLink, Identity, LinkError, LinkName, LinkStatistics, Requested, Span, VirtualClock,
    exception_name, signed_difference, stop_confirmed,
};
use drivebench_model::sample::{Command, Demand, Sample};

/// Latency of request and reply, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latency {
    /// From the host's clock to the drive applying the command and taking the sample.
    pub request_s: f64,
    /// From there to the host having the reply.
    pub reply_s: f64,
}

impl Latency {
    /// What one exchange takes over this line; `with_gaps`: silence separates frames, as Modbus RTU's are.
    pub fn of_line(line: &LineConfig, with_gaps: bool) -> Self {
        let mut pace = Pace::serial(line, with_gaps);
        // 21 bytes of a request over Modbus RTU and 37 of its reply; the stream's are about as many.
        let request_s = pace.arrived_s(0.0, 21);
        Self { request_s, reply_s: pace.delivery_s(request_s, 37) - request_s }
    }
}

impl Default for Latency {
    /// About what an exchange takes over Modbus RTU at 115200 baud, with silent gaps.
    fn default() -> Self {
        Self { request_s: 0.001_8, reply_s: 0.005_5 }
    }
}

/// The software drive as a link, without a line.
pub struct MemoryLink {
    drive: SoftDrive,
    clock: VirtualClock,
    latency: Latency,
    statistics: LinkStatistics,
    last_seq: u64,
    timeline: Timeline,
    /// Distance of captured samples, s; 0 before the drive is identified.
    capture_period_s: f64,
}

impl MemoryLink {
    pub fn new(drive: SoftDrive, clock: VirtualClock, latency: Latency) -> Self {
        Self {
            drive,
            clock,
            latency,
            statistics: LinkStatistics::default(),
            last_seq: 0,
            timeline: Timeline::default(),
            capture_period_s: 0.0,
        }
    }

    /// The drive of this link, for tests that compare with its true state.
    pub const fn drive(&self) -> &SoftDrive {
        &self.drive
    }

    /// Lets drive time pass without an exchange, so that a test can look at the truth in between.
    pub fn advance_to(&mut self, time_s: f64) {
        self.drive.advance_to(time_s);
    }

    /// One exchange with the register bank, counted.
    fn exchange_registers<const N: usize>(
        &mut self,
        write: Option<(u16, &[u16])>,
        address: u16,
        request: &str,
    ) -> Result<[u16; N]> {
        self.statistics.sent += 1;
        let arrived_s = self.clock.time_s() + self.latency.request_s;
        self.drive.advance_to(arrived_s);
        let mut block = [0; N];
        let mut written = Ok(());
        if let Some((address, values)) = write {
            written = self.drive.write(address, values);
        }
        if let Err(exception) = written.and_then(|()| self.drive.read(address, &mut block)) {
            self.statistics.exception += 1;
            return Err(LinkError::Exception {
                link: self.name().0,
                request: request.to_owned(),
                code: exception.code(),
                name: exception_name(exception.code()),
                requested: Requested::default(),
            });
        }
        self.statistics.ok += 1;
        Ok(block)
    }
}

impl DriveLink for MemoryLink {
    fn name(&self) -> LinkName {
        LinkName("sim:".to_owned())
    }

    fn identify(&mut self) -> Result<Identity> {
        let block: [u16; IDENTITY_WORDS] =
            self.exchange_registers(None, IDENTITY_ADDRESS, "read the identity")?;
        let block = firmware_protocol::Identity::from_registers(&block)
            .map_err(|error| timeline::identity_error(&self.name().0, error))?;
        self.capture_period_s = f64::from(block.capture_period_us) * 1e-6;
        let text = |object| self.drive.identification(object).unwrap_or_default().to_owned();
        Ok(Identity {
            vendor: text(0),
            product: text(4),
            firmware: text(2),
            ..timeline::identity(&block)
        })
    }

    fn exchange(&mut self, command: Command) -> Result<Sample> {
        let sent_s = self.clock.time_s();
        let block = timeline::command(command).to_registers();
        self.last_seq = command.seq;
        let reply: [u16; TELEMETRY_WORDS] = self.exchange_registers(
            Some((COMMAND_ADDRESS, &block)),
            TELEMETRY_ADDRESS,
            "write the command and read the telemetry",
        )?;
        let telemetry = Telemetry::from_registers(&reply);
        let received_s = sent_s + self.latency.request_s + self.latency.reply_s;
        Ok(self.timeline.sample(&telemetry, command.seq, Span::new(sent_s, received_s)))
    }

    fn stop(&mut self) -> Result<()> {
        let stop = Command { seq: self.last_seq.wrapping_add(1), demand: Demand::Stop };
        stop_confirmed(&self.name().0, || self.exchange(stop))
    }

    fn statistics(&self) -> LinkStatistics {
        self.statistics
    }

    fn shortest_cycle_s(&self) -> Option<f64> {
        None
    }

    fn burst(&mut self) -> Option<&mut dyn Burst> {
        (self.capture_period_s > 0.0).then_some(self as &mut dyn Burst)
    }
}

impl Burst for MemoryLink {
    fn arm(&mut self) -> Result<()> {
        let arm = [CaptureControl::Arm.code()];
        let put = Some((CAPTURE_CONTROL.address, &arm[..]));
        self.exchange_registers(put, CAPTURE_CONTROL.address, "arm the capture")
            .map(|[_]: [u16; 1]| ())
    }

    fn fetch(&mut self) -> Result<Option<Capture>> {
        let head: [u16; 4] =
            self.exchange_registers(None, CAPTURE_STATE.address, "read the capture")?;
        let [state, count, high, low] = head;
        if state != CaptureState::Complete.code() {
            return Ok(None);
        }
        let block = self.exchange_registers(None, TELEMETRY_ADDRESS, "read the telemetry")?;
        let time_us = Telemetry::from_registers(&block).time_us;
        let now_s = self.clock.time_s();
        let time_s = self.timeline.note(time_us, Span::new(now_s, now_s));
        let age_us = signed_difference(time_us, u32::from(high) << 16 | u32::from(low));
        let first_s = time_s - f64::from(age_us) * 1e-6;
        let period_s = self.capture_period_s;
        let name = self.name().0;
        let capture = Capture::collect(&name, first_s, period_s, count, |index| {
            let write = Some((WINDOW_ADDRESS, &[index][..]));
            let words: [u16; WINDOW_WORDS] =
                self.exchange_registers(write, WINDOW_ADDRESS, "read a window")?;
            Ok(window_samples(index, &words))
        });
        capture.map(Some)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exchange_takes_as_long_as_its_line() {
        let line = |baud| LineConfig { baud, ..LineConfig::default() };
        let rtu = Latency::of_line(&line(115_200), true);
        let usual = Latency::default();
        assert!((rtu.request_s - usual.request_s).abs() < 0.1e-3, "{rtu:?}");
        assert!((rtu.reply_s - usual.reply_s).abs() < 0.1e-3, "{rtu:?}");
        let usb = Latency::of_line(&line(12_000_000), false);
        // Half a millisecond of turnaround is left.
        assert!(usb.request_s + usb.reply_s < 0.6e-3, "{usb:?}");
    }
}

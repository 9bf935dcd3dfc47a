//! Any bytes, any values, any splits. The seed is fixed: a failure is the same everywhere.

use firmware_protocol::modbus::{
    Length, MAX_PDU, RtuReceiver, TcpReceiver, request_len, response_len, rtu,
};
use firmware_protocol::registers::{CURRENT, SPEED, TEMPERATURE, VOLTAGE};
use firmware_protocol::stream::{self, CaptureBlock, Decoder, Frame, Message};
use firmware_protocol::{
    CaptureSample, Control, DriveCommand, Fault, REGISTERS, Register, Status, Telemetry,
};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use crate::support::{Bank, UNIT, decode, response, rtu_frame, stream_frame, tcp_frame};

pub(crate) fn config() -> ProptestConfig {
    ProptestConfig {
        cases: 300,
        rng_seed: RngSeed::Fixed(1),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

/// Bytes that look like requests more often than noise does.
pub(crate) fn line() -> impl Strategy<Value = Vec<u8>> {
    let byte = prop_oneof![
        any::<u8>(),
        prop::sample::select(&[0_u8, 1, 3, 4, 6, 8, 14, 16, 23, 32, 43, 64, 128, 255][..])
    ];
    vec(byte, 0..600)
}

pub(crate) fn pdu() -> impl Strategy<Value = Vec<u8>> {
    prop_oneof![
        (0_u16..300, 1_u16..126).prop_map(|(address, quantity)| read(3, address, quantity)),
        (0_u16..300, 1_u16..126).prop_map(|(address, quantity)| read(4, address, quantity)),
        (0_u16..300, any::<u16>()).prop_map(|(address, value)| read(6, address, value)),
        (0_u16..300, vec(any::<u16>(), 1..124)).prop_map(|(a, values)| write(vec![16], a, &values)),
        (0_u16..300, 1_u16..126, 0_u16..300, vec(any::<u16>(), 1..122))
            .prop_map(|(from, quantity, to, values)| write(read(23, from, quantity), to, &values)),
    ]
}

fn read(function: u8, address: u16, quantity: u16) -> Vec<u8> {
    let mut pdu = vec![function];
    pdu.extend(address.to_be_bytes());
    pdu.extend(quantity.to_be_bytes());
    pdu
}

fn write(mut pdu: Vec<u8>, address: u16, values: &[u16]) -> Vec<u8> {
    let quantity = u16::try_from(values.len()).expect("at most 123 values");
    pdu.extend(address.to_be_bytes());
    pdu.extend(quantity.to_be_bytes());
    pdu.push(u8::try_from(2 * quantity).expect("at most 246 bytes"));
    pdu.extend(values.iter().flat_map(|value| value.to_be_bytes()));
    pdu
}

fn sample() -> impl Strategy<Value = CaptureSample> {
    let values = (-300.0..300.0, -300.0..300.0, -600.0..600.0);
    values.prop_map(|(voltage_v, current_a, speed_rad_s)| CaptureSample {
        voltage_v,
        current_a,
        speed_rad_s,
    })
}

fn telemetry() -> impl Strategy<Value = Telemetry> {
    let whole = (any::<[u16; 4]>(), any::<[u32; 2]>());
    let values = (sample(), -200_000.0..200_000.0, 0.0..6000.0, -300.0..300.0, -300.0..300.0);
    (whole, values).prop_map(|((words, times), values)| Telemetry {
        status: Status(words[0]),
        fault: Fault::from_code(words[1]),
        seq: words[2],
        time_us: times[0],
        applied_us: times[1],
        voltage_v: values.0.voltage_v,
        current_a: values.0.current_a,
        speed_rad_s: values.0.speed_rad_s,
        angle_rad: values.1,
        bus_v: values.2,
        temperature_c: values.3,
        voltage_cmd_v: values.4,
        protocol_version: words[3],
    })
}

/// Equal but for half a step, `finer` times smaller than the register's.
fn near(a: f64, b: f64, register: &Register, finer: f64) -> bool {
    (a - b).abs() <= 0.500_001 * register.scale / finer
}

fn telemetry_near(a: &Telemetry, b: &Telemetry, finer: f64) -> bool {
    use firmware_protocol::registers::{ANGLE, BUS_VOLTAGE, VOLTAGE_COMMAND};
    let whole = |t: &Telemetry| {
        let times = (t.time_us, t.applied_us);
        (t.status, t.fault, t.seq, times, t.protocol_version)
    };
    let values = [
        (a.voltage_v, b.voltage_v, VOLTAGE, finer),
        (a.current_a, b.current_a, CURRENT, finer),
        (a.speed_rad_s, b.speed_rad_s, SPEED, finer),
        (a.angle_rad, b.angle_rad, ANGLE, 1.0),
        (a.bus_v, b.bus_v, BUS_VOLTAGE, finer),
        (a.temperature_c, b.temperature_c, TEMPERATURE, finer),
        (a.voltage_cmd_v, b.voltage_cmd_v, VOLTAGE_COMMAND, finer),
    ];
    let mut values = values.iter();
    whole(a) == whole(b) && values.all(|(a, b, row, finer)| near(*a, *b, row, *finer))
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn any_request_gets_one_whole_answer_of_its_function(request in line()) {
        let response = response(&mut Bank::new(), &request);
        prop_assert_eq!(response.first().map(|said| said | 0x80), request.first().map(|asked| asked | 0x80));
        prop_assert!(response.is_empty() || response_len(&response) == Length::Known(response.len()));
    }

    #[test]
    fn lengths_are_told_by_a_beginning_and_never_change(pdu in pdu()) {
        prop_assert_eq!(request_len(&pdu), Length::Known(pdu.len()));
        for end in 0..pdu.len() {
            let told = request_len(&pdu[..end]);
            prop_assert!(told == Length::NeedMore || told == Length::Known(pdu.len()));
        }
    }

    #[test]
    fn the_rtu_receiver_accounts_for_every_byte_of_any_line(line in line(), gaps in vec(any::<bool>(), 600)) {
        let mut receiver = RtuReceiver::new(UNIT);
        let mut taken = 0;
        for (byte, gap) in line.iter().zip(gaps) {
            receiver.push(*byte);
            if gap {
                receiver.idle();
            }
            while let Some(frame) = receiver.take_frame() {
                taken += frame.pdu().len() + 3;
            }
        }
        receiver.idle();
        while let Some(frame) = receiver.take_frame() {
            taken += frame.pdu().len() + 3;
        }
        let statistics = receiver.statistics();
        if statistics.foreign == 0 {
            prop_assert_eq!(taken as u64 + statistics.skipped, line.len() as u64);
        }
    }

    #[test]
    fn rtu_requests_are_found_behind_any_garbage_and_a_gap(
        garbage in line(),
        requests in vec(pdu(), 1..5),
        late in any::<bool>(),
    ) {
        let mut receiver = RtuReceiver::new(UNIT);
        for byte in garbage {
            receiver.push(byte);
            while receiver.take_frame().is_some() {}
        }
        receiver.idle();
        while receiver.take_frame().is_some() {}
        let mut found = Vec::new();
        for byte in requests.iter().flat_map(|pdu| rtu_frame(UNIT, pdu)) {
            receiver.push(byte);
            // Asking late must find the same; the buffer holds one longest frame.
            if !late {
                found.extend(receiver.take_frame());
            }
        }
        while let Some(frame) = receiver.take_frame() {
            found.push(frame);
        }
        let found: Vec<_> = found.iter().map(|frame| frame.pdu().to_vec()).collect();
        let total: usize = requests.iter().map(|pdu| pdu.len() + 3).sum();
        if !late || total <= rtu::MAX_FRAME {
            prop_assert_eq!(found, requests);
        }
    }

    #[test]
    fn an_rtu_frame_with_one_or_two_wrong_bits_is_not_taken(pdu in pdu(), a in any::<prop::sample::Index>(), b in any::<prop::sample::Index>()) {
        let mut frame = rtu_frame(UNIT, &pdu);
        let bits = 8 * frame.len();
        let (a, b) = (a.index(bits), b.index(bits));
        frame[a / 8] ^= 1 << (a % 8);
        if a != b {
            frame[b / 8] ^= 1 << (b % 8);
        }
        let mut receiver = RtuReceiver::new(UNIT);
        for byte in &frame {
            receiver.push(*byte);
        }
        receiver.idle();
        // A shorter frame that happens to lie inside is another matter: the checksum finds it with probability 2^-16.
        prop_assert!(receiver.take_frame().is_none_or(|found| found.pdu().len() < pdu.len()));
    }

    #[test]
    fn tcp_requests_are_found_however_they_are_merged(requests in vec((any::<u16>(), any::<u8>(), pdu()), 1..6)) {
        let mut receiver = TcpReceiver::new();
        let mut found = Vec::new();
        for (transaction, unit, pdu) in &requests {
            for byte in tcp_frame(*transaction, *unit, pdu) {
                found.extend(receiver.push(byte).unwrap());
            }
        }
        let found: Vec<_> = found.iter().map(|f| (f.transaction, f.unit, f.pdu().to_vec())).collect();
        prop_assert_eq!(found, requests);
    }

    #[test]
    fn any_bytes_are_safe_for_tcp_receiver_and_stream_decoder(bytes in line()) {
        let (mut receiver, mut decoder) = (TcpReceiver::new(), Decoder::new());
        for byte in &bytes {
            if let Ok(Some(frame)) = receiver.push(*byte) {
                prop_assert!((1..=MAX_PDU).contains(&frame.pdu().len()));
            }
            if let Some(Ok(frame)) = decoder.push(*byte) {
                prop_assert!(bytes.len() >= stream_frame(&frame).len());
            }
        }
    }

    #[test]
    fn telemetry_survives_registers_within_half_a_step(sent in telemetry()) {
        let got = Telemetry::from_registers(&sent.to_registers());
        prop_assert!(telemetry_near(&sent, &got, 1.0), "{sent:?} {got:?}");
    }

    #[test]
    fn telemetry_survives_the_stream_within_half_of_a_finer_step(sent in telemetry(), seq in any::<u16>()) {
        let got: Vec<_> = decode(&stream_frame(&Frame::telemetry(seq, sent)));
        let [Ok(Frame { seq: echoed, message: Message::Telemetry(got), .. })] = got[..] else {
            return Err(TestCaseError::fail(format!("{got:?}")));
        };
        prop_assert_eq!(echoed, seq);
        prop_assert!(telemetry_near(&sent, &got, 1000.0), "{sent:?} {got:?}");
    }

    #[test]
    fn commands_survive_block_and_stream(seq in any::<u16>(), kind in 0_u8..6, set_point in -2e6..2e6) {
        let control = match kind {
            0 => Control::Disable,
            1 => Control::Stop,
            2 => Control::ResetFault,
            3 => Control::Voltage(set_point),
            4 => Control::Current(set_point),
            _ => Control::Speed(set_point),
        };
        let sent = DriveCommand { seq, control };
        let got = DriveCommand::from_registers(&sent.to_registers()).unwrap();
        prop_assert_eq!((got.seq, got.control.code()), (seq, control.code()));
        prop_assert!((got.control.set_point() - control.set_point()).abs() <= 0.5e-3 * 1.000_001);
        prop_assert_eq!(decode(&stream_frame(&Frame::command(sent))), vec![Ok(Frame::command(got))]);
    }

    #[test]
    fn every_register_keeps_every_raw_number(row in 0..REGISTERS.len(), raw in any::<i64>()) {
        let register = &REGISTERS[row];
        let raw = register.min + raw.rem_euclid(register.max - register.min + 1);
        let mut block = [0; 2];
        register.put(&mut block, register.address, raw);
        prop_assert_eq!(register.get(&block, register.address), raw);
        prop_assert_eq!(register.encode(register.decode(raw)), raw);
    }

    #[test]
    fn a_capture_block_survives_within_half_of_a_finer_step(index in any::<u16>(), samples in vec(sample(), 0..40)) {
        let block = CaptureBlock::new(index, &samples);
        let frame = Frame { seq: 1, time_us: 2, message: Message::CaptureBlock(block) };
        let got = decode(&stream_frame(&frame));
        let [Ok(Frame { message: Message::CaptureBlock(got), .. })] = got[..] else {
            return Err(TestCaseError::fail(format!("{got:?}")));
        };
        prop_assert_eq!(got.index, index);
        prop_assert_eq!(got.samples().len(), samples.len().min(stream::CAPTURE_BLOCK_SAMPLES));
        for (a, b) in samples.iter().zip(got.samples()) {
            prop_assert!(near(a.voltage_v, b.voltage_v, &VOLTAGE, 1000.0));
            prop_assert!(near(a.current_a, b.current_a, &CURRENT, 1000.0));
            prop_assert!(near(a.speed_rad_s, b.speed_rad_s, &SPEED, 1000.0));
        }
    }

    #[test]
    fn damage_costs_the_stream_the_frames_it_touches_and_no_other(
        sent in vec(telemetry(), 4..7),
        garbage in line(),
        hit in any::<prop::sample::Index>(),
        wrong in 1_u8..,
    ) {
        let frames: Vec<_> = sent.iter().map(|t| stream_frame(&Frame::telemetry(t.seq, *t))).collect();
        let alone = |frame: &Vec<u8>| decode(frame)[0];
        // Garbage ended by a delimiter, then whole frames.
        let mut bytes = garbage;
        bytes.push(0);
        let before = decode(&bytes).len();
        bytes.extend(frames.concat());
        let whole: Vec<_> = frames.iter().map(alone).collect();
        prop_assert_eq!(&decode(&bytes)[before..], &whole[..]);
        // One wrong byte in the second frame: the last is untouched, nothing false comes out.
        let mut damaged = frames.clone();
        let at = hit.index(damaged[1].len());
        damaged[1][at] ^= wrong;
        let good: Vec<_> = decode(&damaged.concat()).into_iter().flatten().collect();
        let whole: Vec<_> = whole.into_iter().flatten().collect();
        prop_assert_eq!(good.first(), whole.first());
        prop_assert_eq!(good.last(), whole.last());
        prop_assert!(good.iter().all(|frame| whole.contains(frame)));
        prop_assert!(good.len() + 2 >= whole.len());
    }
}

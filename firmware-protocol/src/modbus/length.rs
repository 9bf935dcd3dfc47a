//! Length of a PDU from its first bytes.

/// Bytes of a PDU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Length {
    /// So many bytes, function code included.
    Known(usize),
    /// The bytes that determine it have not been received yet.
    NeedMore,
    /// Not determined by the function code; only silence ends the frame.
    Unknown,
}

/// Length of a request PDU that begins with these bytes.
pub fn request_len(pdu: &[u8]) -> Length {
    match pdu.first() {
        None => Length::NeedMore,
        Some(1..=6 | 8) => Length::Known(5),
        Some(7 | 11 | 12 | 17) => Length::Known(1),
        Some(15 | 16) => counted(pdu, 5),
        Some(20 | 21) => counted(pdu, 1),
        Some(22) => Length::Known(7),
        Some(23) => counted(pdu, 9),
        Some(24) => Length::Known(3),
        Some(43) => match pdu.get(1) {
            None => Length::NeedMore,
            Some(14) => Length::Known(4),
            Some(_) => Length::Unknown,
        },
        Some(_) => Length::Unknown,
    }
}

/// Length of a response PDU that begins with these bytes; an exception has two.
pub fn response_len(pdu: &[u8]) -> Length {
    match pdu.first() {
        None => Length::NeedMore,
        Some(7 | 128..) => Length::Known(2),
        Some(1..=4 | 12 | 17 | 20 | 21 | 23) => counted(pdu, 1),
        Some(5 | 6 | 8 | 11 | 15 | 16) => Length::Known(5),
        Some(22) => Length::Known(7),
        Some(43) => objects(pdu),
        Some(_) => Length::Unknown,
    }
}

/// Length of the normal response to a request; `None` if the request does not determine it.
pub fn expected_response_len(request: &[u8]) -> Option<usize> {
    let quantity = || Some(usize::from(u16::from_be_bytes([*request.get(3)?, *request.get(4)?])));
    match request.first()? {
        1 | 2 => Some(2 + quantity()?.div_ceil(8)),
        3 | 4 | 23 => Some(2 + 2 * quantity()?),
        5 | 6 | 15 | 16 => Some(5),
        8 => Some(request.len()),
        22 => Some(7),
        _ => None,
    }
}

/// The byte at `at` counts the bytes after it.
fn counted(pdu: &[u8], at: usize) -> Length {
    pdu.get(at).map_or(Length::NeedMore, |count| Length::Known(at + 1 + usize::from(*count)))
}

/// Device identification: a list of objects, each with its length.
fn objects(pdu: &[u8]) -> Length {
    match pdu.get(1) {
        None => return Length::NeedMore,
        Some(14) => {}
        Some(_) => return Length::Unknown,
    }
    let Some(&number) = pdu.get(6) else {
        return Length::NeedMore;
    };
    let mut at = 7;
    for _ in 0..number {
        let Some(&length) = pdu.get(at + 1) else {
            return Length::NeedMore;
        };
        at += 2 + usize::from(length);
    }
    Length::Known(at)
}

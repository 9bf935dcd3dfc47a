//! Bytes of a capture file: header, records, and IP packets around what a TCP connection carried.

use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

/// Stamps in nanoseconds, in the byte order of the machine that wrote them.
const MAGIC: u32 = 0xA1B2_3C4D;
const LONGEST: u32 = 65_535;
/// Protocol number of TCP, and the flags of a segment with data.
const TCP: u8 = 6;
const PUSH_ACK: u8 = 0x18;

pub(super) fn file_header(link_type: u32) -> Vec<u8> {
    let mut header = Vec::with_capacity(24);
    header.extend(MAGIC.to_le_bytes());
    header.extend(2_u16.to_le_bytes());
    header.extend(4_u16.to_le_bytes());
    header.extend([0; 8]);
    header.extend(LONGEST.to_le_bytes());
    header.extend(link_type.to_le_bytes());
    header
}

/// A record: time since 1970, length twice, bytes.
pub(super) fn record(at: Duration, bytes: &[u8]) -> Vec<u8> {
    let seconds = u32::try_from(at.as_secs()).unwrap_or(u32::MAX);
    let length = u32::try_from(bytes.len()).unwrap_or(LONGEST);
    let mut out = Vec::with_capacity(16 + bytes.len());
    for word in [seconds, at.subsec_nanos(), length, length] {
        out.extend(word.to_le_bytes());
    }
    out.extend_from_slice(bytes);
    out
}

/// A TCP connection, of which only the data are known: addresses are real, sequence numbers count from 1.
pub(super) struct Conversation {
    ours: SocketAddr,
    peer: SocketAddr,
    sent: u32,
    received: u32,
}

impl Conversation {
    pub(super) const fn new(ours: SocketAddr, peer: SocketAddr) -> Self {
        Self {
            ours,
            peer,
            sent: 1,
            received: 1,
        }
    }

    /// An IP packet with these data.
    pub(super) fn packet(&mut self, data: &[u8], is_sent: bool) -> Vec<u8> {
        let length = u32::try_from(data.len()).unwrap_or(LONGEST);
        let (from, to, sequence, acknowledged) = if is_sent {
            (self.ours, self.peer, self.sent, self.received)
        } else {
            (self.peer, self.ours, self.received, self.sent)
        };
        let count = if is_sent {
            &mut self.sent
        } else {
            &mut self.received
        };
        *count = count.wrapping_add(length);
        let mut segment = Vec::with_capacity(20 + data.len());
        segment.extend(from.port().to_be_bytes());
        segment.extend(to.port().to_be_bytes());
        segment.extend(sequence.to_be_bytes());
        segment.extend(acknowledged.to_be_bytes());
        // Header of five words, window of 65535, checksum to come, nothing urgent.
        segment.extend([5 << 4, PUSH_ACK, 0xFF, 0xFF, 0, 0, 0, 0]);
        segment.extend_from_slice(data);
        match (from.ip(), to.ip()) {
            (IpAddr::V4(from), IpAddr::V4(to)) => ip4(from.octets(), to.octets(), &mut segment),
            (from, to) => {
                let sixteen = |ip| match ip {
                    IpAddr::V4(ip) => ip.to_ipv6_mapped().octets(),
                    IpAddr::V6(ip) => ip.octets(),
                };
                ip6(&sixteen(from), &sixteen(to), &mut segment)
            }
        }
    }
}

fn ip4(from: [u8; 4], to: [u8; 4], segment: &mut [u8]) -> Vec<u8> {
    let length = u16::try_from(segment.len()).unwrap_or(u16::MAX);
    let pseudo = [&from[..], &to, &[0, TCP], &length.to_be_bytes()].concat();
    seal(&pseudo, segment);
    let total = length.saturating_add(20).to_be_bytes();
    // Version 4, header of five words, no fragments, 64 hops.
    let mut packet = vec![0x45, 0, total[0], total[1], 0, 0, 0x40, 0, 64, TCP, 0, 0];
    packet.extend_from_slice(&from);
    packet.extend_from_slice(&to);
    let sum = checksum(&packet).to_be_bytes();
    packet[10..12].copy_from_slice(&sum);
    packet.extend_from_slice(segment);
    packet
}

fn ip6(from: &[u8; 16], to: &[u8; 16], segment: &mut [u8]) -> Vec<u8> {
    let length = u16::try_from(segment.len())
        .unwrap_or(u16::MAX)
        .to_be_bytes();
    let pseudo = [&from[..], to, &[0, 0], &length, &[0, 0, 0, TCP]].concat();
    seal(&pseudo, segment);
    let mut packet = vec![0x60, 0, 0, 0, length[0], length[1], TCP, 64];
    packet.extend_from_slice(from);
    packet.extend_from_slice(to);
    packet.extend_from_slice(segment);
    packet
}

/// Puts the checksum into a segment.
fn seal(pseudo_header: &[u8], segment: &mut [u8]) {
    let sum = checksum(&[pseudo_header, segment].concat()).to_be_bytes();
    segment[16..18].copy_from_slice(&sum);
}

/// The Internet checksum (RFC 1071).
fn checksum(bytes: &[u8]) -> u16 {
    let mut sum: u32 = bytes
        .chunks(2)
        .map(|word| u32::from(word[0]) << 8 | u32::from(word.get(1).copied().unwrap_or(0)))
        .sum();
    while sum > 0xFFFF {
        sum = (sum >> 16) + (sum & 0xFFFF);
    }
    !u16::try_from(sum).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sum over everything that includes its own checksum is 0 (RFC 1071).
    #[test]
    fn checksums_are_right_and_sequence_numbers_count_the_data() {
        let address = |text: &str| text.parse::<SocketAddr>().unwrap();
        let mut v4 = Conversation::new(address("10.0.0.1:40000"), address("10.0.0.2:502"));
        let packet = v4.packet(&[1, 2, 3], true);
        assert_eq!(packet.len(), 43);
        assert_eq!(checksum(&packet[..20]), 0);
        let pseudo = [&packet[12..20], &[0, 6, 0, 23], &packet[20..]].concat();
        assert_eq!(checksum(&pseudo), 0);
        let answer = v4.packet(&[9], false);
        assert_eq!(answer[20..22], 502_u16.to_be_bytes());
        assert_eq!(
            answer[28..32],
            4_u32.to_be_bytes(),
            "three bytes acknowledged"
        );
        let mut v6 = Conversation::new(address("[::1]:40000"), address("[::1]:502"));
        let packet = v6.packet(&[1, 2, 3, 4], true);
        assert_eq!(packet.len(), 64);
        let pseudo = [&packet[8..40], &[0, 0, 0, 24, 0, 0, 0, 6], &packet[40..]].concat();
        assert_eq!(checksum(&pseudo), 0);
    }
}

//! Which registers are read together: as few requests as the drive's limits allow.

use super::facts::{PollRate, RegisterMap};
use crate::drive::RegisterTable;

/// One read request and the signals (by position in the map) that it serves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadBlock {
    pub table: RegisterTable,
    pub address: u16,
    pub count: u16,
    pub signals: Vec<usize>,
}

/// The requests that read every signal of one rate.
pub fn plan_reads(map: &RegisterMap, poll: PollRate) -> Vec<ReadBlock> {
    let mut wanted: Vec<usize> = (0..map.signals.len())
        .filter(|index| map.signals[*index].poll == poll)
        .collect();
    wanted.sort_by_key(|index| {
        let location = map.signals[*index].location;
        (location.table == RegisterTable::Input, location.address)
    });
    let mut blocks: Vec<ReadBlock> = Vec::new();
    for index in wanted {
        let location = map.signals[index].location;
        let (address, end) = (
            u32::from(location.address),
            u32::from(location.address) + u32::from(location.layout.registers()),
        );
        let exact = map.exact_reads.iter().find(|(first, count)| {
            (u32::from(*first)..u32::from(*first) + u32::from(*count)).contains(&address)
        });
        if let Some(block) = blocks.last_mut()
            && block.table == location.table
        {
            let (first, last) = (
                u32::from(block.address),
                u32::from(block.address) + u32::from(block.count),
            );
            let whole =
                exact.is_some_and(|(at, count)| (*at, *count) == (block.address, block.count));
            let in_exact = map
                .exact_reads
                .iter()
                .any(|(at, count)| (*at, *count) == (block.address, block.count));
            let joins = exact.is_none()
                && !in_exact
                && address <= last + u32::from(map.max_hole)
                && end.max(last) - first <= u32::from(map.max_read);
            if whole {
                block.signals.push(index);
                continue;
            }
            if joins {
                // It was just compared with `max_read`.
                block.count = u16::try_from(end.max(last) - first).unwrap_or(map.max_read);
                block.signals.push(index);
                continue;
            }
        }
        let (address, count) = exact
            .copied()
            .unwrap_or((location.address, location.layout.registers()));
        blocks.push(ReadBlock {
            table: location.table,
            address,
            count,
            signals: vec![index],
        });
    }
    blocks
}

//! Plan of the reads: as few requests as the drive's limits allow.

use super::facts::RegisterMap;
use super::terms::PollRate;
use crate::cell_bus::{CellTable, ReadRequest};
use crate::framing::{LINE_CELLS, fields_width};

/// One read request and the signals (by position in the map) that it serves.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReadBlock {
    pub read: ReadRequest,
    pub signals: Vec<usize>,
}

/// The requests that read every signal of one rate.
pub fn plan_reads(map: &RegisterMap, poll: PollRate) -> Vec<ReadBlock> {
    // Behind the signals that decide on their place, and on their scale.
    let is_placed = |index: usize| map.signals[index].keys.reply_by.is_some();
    let mut wanted: Vec<(ReadRequest, usize)> = (0..map.signals.len())
        .filter(|index| map.signals[*index].keys.poll == poll)
        .filter(|index| map.signals[*index].formula.is_none())
        .map(|index| (map.signals[index].request(), index))
        .collect();
    wanted.sort_by_key(|(read, index)| (is_placed(*index), read.table, read.address));
    let mut blocks: Vec<ReadBlock> = Vec::new();
    for (mut read, index) in wanted {
        if let (CellTable::Fields(bit), Some(block)) = (read.table, blocks.last_mut())
            && let CellTable::Fields(mask) = block.read.table
        {
            let mask = mask | bit;
            let table = CellTable::Fields(mask);
            block.read = ReadRequest { table, address: 0, count: fields_width(mask) };
            block.signals.push(index);
            continue;
        }
        if let (CellTable::Lines(line), Some(block)) = (read.table, blocks.last_mut())
            && let CellTable::Lines(mask) = block.read.table
        {
            let mask = mask | line;
            let count = LINE_CELLS * u16::try_from(mask.count_ones()).unwrap_or_default();
            block.read = ReadRequest { table: CellTable::Lines(mask), address: 0, count };
            block.signals.push(index);
            continue;
        }
        let (address, end) = (u32::from(read.address), read.end());
        let lies_within = |(first, count): &&(u16, u16)| {
            let first = u32::from(*first);
            (first..first + u32::from(*count)).contains(&address)
        };
        let exact = map.exact_reads.iter().find(lies_within);
        if let Some(block) = blocks.last_mut()
            && block.read.table == read.table
            && block.signals.iter().all(|other| is_placed(*other) == is_placed(index))
        {
            let whole = (block.read.address, block.read.count);
            let count = end.max(block.read.end()) - u32::from(block.read.address);
            let joins = match exact {
                // A block of exact length is read as it is.
                Some(exact) => *exact == whole,
                // The whole reply to a command comes in any case.
                None if matches!(read.table, CellTable::Reply(_)) => true,
                None => {
                    !map.exact_reads.contains(&whole)
                        && address <= block.read.end() + u32::from(map.max_hole)
                        && count <= u32::from(map.max_read)
                }
            };
            if joins {
                if exact.is_none() {
                    // It was just compared with `max_read`.
                    block.read.count = u16::try_from(count).unwrap_or(map.max_read);
                }
                block.signals.push(index);
                continue;
            }
        }
        if let Some((first, count)) = exact {
            (read.address, read.count) = (*first, *count);
        }
        let signals = vec![index];
        blocks.push(ReadBlock { read, signals });
    }
    blocks
}

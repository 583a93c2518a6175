//! Makes blocks of what is in the tail.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::codec;
use super::fold::{self, Raw};
use super::memory::{Lots, Minutes};
use super::writer::HistoryWriter;
use crawler_database::RecordsError;

/// Steps of the levels; the first has every sample.
pub(super) const STEPS: [i64; 3] = [1, 1_000, 60_000];
/// Most rows in a block, for a robot that sends without end.
const BLOCK_ROWS: usize = 4_096;
/// Minutes in a block of minutes.
const HOUR: usize = 60;

/// A row of the table of blocks.
struct Block {
    id: i64,
    level: i64,
    robot: i64,
    first: i64,
    last: i64,
    data: Vec<u8>,
}

/// What a seal comes to.
struct Sealed {
    blocks: Vec<Block>,
    /// Those of the robots that sent something.
    minutes: HashMap<i64, Arc<Minutes>>,
    next_block: i64,
}

fn block<const N: usize>(id: i64, level: i64, robot: i64, rows: &[[i64; N]]) -> Block {
    let times = || rows.iter().map(|row| row[0]);
    Block {
        id,
        level,
        robot,
        first: times().min().unwrap_or(0),
        last: times().max().unwrap_or(0),
        data: codec::encode(rows),
    }
}

fn make(lots: &Lots, minutes: &HashMap<i64, Arc<Minutes>>, mut next_block: i64) -> Sealed {
    let mut sealed = HashMap::with_capacity(lots.len());
    let mut blocks = Vec::with_capacity(lots.len() * 3);
    let mut next = || {
        next_block += 1;
        next_block - 1
    };
    let mut rows: Vec<Raw> = Vec::new();
    for (&robot, lot) in lots {
        if lot.is_empty() {
            continue;
        }
        // In order of time, whatever the order of arrival.
        rows.clone_from(lot);
        rows.sort_by_key(|row| row[0]);
        for rows in rows.chunks(BLOCK_ROWS) {
            blocks.push(block(next(), 0, robot, rows));
        }
        for rows in fold::buckets(&rows, STEPS[1]).chunks(BLOCK_ROWS) {
            blocks.push(block(next(), 1, robot, rows));
        }
        let last = minutes.get(&robot);
        let mut current = Minutes {
            block: last.map_or_else(&mut next, |last| last.block),
            rows: Vec::with_capacity(HOUR),
        };
        current.rows.extend(last.iter().flat_map(|last| &last.rows));
        for row in fold::buckets(&rows, STEPS[2]) {
            if let Some(last) = current.rows.last_mut().filter(|last| last[0] == row[0]) {
                *last = fold::merge(last, &row);
                continue;
            }
            if current.rows.len() >= HOUR {
                blocks.push(block(current.block, 2, robot, &current.rows));
                current.block = next();
                current.rows.clear();
            }
            current.rows.push(row);
        }
        blocks.push(block(current.block, 2, robot, &current.rows));
        sealed.insert(robot, Arc::new(current));
    }
    Sealed {
        blocks,
        minutes: sealed,
        next_block,
    }
}

/// The same lots without a sample, and with room for about as many as they had. Robots that sent nothing get
/// none. Samples of a minute would otherwise be allocated anew every minute, on whatever thread they come in:
/// memory that the system's allocator keeps for each of them.
fn emptied(mut lots: Lots) -> Lots {
    lots.retain(|_, lot| !lot.is_empty());
    for lot in lots.values_mut() {
        lot.shrink_to(2 * lot.len());
        lot.clear();
    }
    lots
}

impl HistoryWriter {
    /// Replaces the tail with blocks, in one transaction. When it fails, everything is as before, and
    /// the next call tries the same again.
    pub(super) async fn seal(&mut self) -> Result<(), RecordsError> {
        let (lots, minutes, next_block) = {
            let mut memory = self.shared.memory();
            if memory.sealing.is_none() {
                if memory.open_count == 0 {
                    return Ok(());
                }
                memory.open_count = 0;
                let room = std::mem::take(&mut self.spare);
                memory.sealing = Some(Arc::new(std::mem::replace(&mut memory.open, room)));
                self.sealing_up_to = self.next_tail - 1;
            }
            (
                memory.sealing.clone().unwrap_or_default(),
                memory.minutes.clone(),
                memory.next_block,
            )
        };
        let Sealed {
            blocks,
            minutes,
            next_block,
        } = tokio::task::spawn_blocking(move || make(&lots, &minutes, next_block))
            .await
            // Ends only with the runtime, or by a panic, which is a bug and not the disk's fault.
            .map_err(|_| RecordsError::Closed)?;
        let count = blocks.len() as u64;
        let up_to = self.sealing_up_to;
        self.db
            .write(move |connection| {
                Box::pin(async move {
                    for block in blocks {
                        sqlx::query(
                            "INSERT OR REPLACE INTO block (id, level, robot, first, last, data)
                             VALUES (?, ?, ?, ?, ?, ?)",
                        )
                        .bind(block.id)
                        .bind(block.level)
                        .bind(block.robot)
                        .bind(block.first)
                        .bind(block.last)
                        .bind(block.data)
                        .execute(&mut *connection)
                        .await?;
                    }
                    sqlx::query("DELETE FROM tail WHERE id <= ?")
                        .bind(up_to)
                        .execute(connection)
                        .await?;
                    Ok(())
                })
            })
            .await?;
        let sealed = {
            let mut memory = self.shared.memory();
            memory.minutes.extend(minutes);
            memory.next_block = next_block;
            memory.sealing.take()
        };
        self.spare = sealed
            .and_then(Arc::into_inner)
            .map_or_else(Lots::new, emptied);
        self.shared
            .counts
            .blocks
            .fetch_add(count, Ordering::Relaxed);
        Ok(())
    }
}

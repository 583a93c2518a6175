//! Makes blocks of what is in the tail.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use super::codec;
use super::fold::{self, Raw};
use super::keeper::Keeper;
use super::memory::{Lots, Minutes};
use crate::RecordsError;

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
    minutes: HashMap<i64, Minutes>,
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

fn make(lots: &Lots, mut minutes: HashMap<i64, Minutes>, mut next_block: i64) -> Sealed {
    let mut blocks = Vec::with_capacity(lots.len() * 3);
    let mut next = || {
        next_block += 1;
        next_block - 1
    };
    for (&robot, lot) in lots {
        let mut rows: Vec<Raw> = lot.clone();
        // In order of time, whatever the order of arrival.
        rows.sort_by_key(|row| row[0]);
        for rows in rows.chunks(BLOCK_ROWS) {
            blocks.push(block(next(), 0, robot, rows));
        }
        for rows in fold::buckets(&rows, STEPS[1]).chunks(BLOCK_ROWS) {
            blocks.push(block(next(), 1, robot, rows));
        }
        let current = minutes.entry(robot).or_insert_with(|| Minutes {
            block: next(),
            rows: Vec::with_capacity(HOUR),
        });
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
    }
    Sealed {
        blocks,
        minutes,
        next_block,
    }
}

impl Keeper {
    /// Replaces the tail with blocks, in one transaction. When it fails, everything is as before, and
    /// the next call tries the same again.
    pub(super) async fn seal(&mut self) -> Result<(), RecordsError> {
        let (lots, minutes, next_block) = {
            let mut memory = self.shared.memory();
            if memory.sealing.is_none() {
                if memory.open.is_empty() {
                    return Ok(());
                }
                memory.open_count = 0;
                memory.sealing = Some(Arc::new(std::mem::take(&mut memory.open)));
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
        } = tokio::task::spawn_blocking(move || make(&lots, minutes, next_block))
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
        let mut memory = self.shared.memory();
        memory.sealing = None;
        memory.minutes = minutes;
        memory.next_block = next_block;
        drop(memory);
        self.shared
            .counts
            .blocks
            .fetch_add(count, Ordering::Relaxed);
        Ok(())
    }
}

//! The queue of task deadlines: a calendar of 1.024 ms buckets, with a heap for what lies beyond
//! it.
//!
//! Nearly every deadline of a robot lies within 100 ms, and at a thousand robots a heap pays ten
//! cache misses for each of them. A calendar writes one word behind the last one of its bucket, a
//! cache line of which holds seven; each bucket is sorted once, when its time comes, and robots
//! that run in phase arrive in it already sorted.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// One bucket spans `2^SHIFT` microseconds.
const SHIFT: u32 = 10;
/// Buckets in the calendar: about a second.
const BUCKETS: u64 = 1024;
const WORDS: usize = (BUCKETS / 64) as usize;
/// Entries in a chunk: it fills 64 bytes.
const CHUNK: usize = 7;
/// No chunk.
const NONE: u32 = u32::MAX;

/// A deadline of a task. Ordered by time, then by task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Entry {
    /// Microseconds of world time.
    pub(super) at: u64,
    /// Index of the task.
    pub(super) task: u32,
}

impl Entry {
    const fn bucket(self) -> u64 {
        self.at >> SHIFT
    }

    /// Time within the bucket and task in one word: ordered as entries of one bucket are.
    const fn key(self) -> u64 {
        (self.at & ((1 << SHIFT) - 1)) << 32 | self.task as u64
    }

    const fn of(bucket: u64, key: u64) -> Self {
        Self {
            at: bucket << SHIFT | key >> 32,
            task: key as u32,
        }
    }
}

/// Some entries of one bucket, as they arrived.
#[derive(Debug, Clone)]
struct Chunk {
    keys: [u64; CHUNK],
    len: u32,
    next: u32,
}

/// See the [module](self).
///
/// Entries are never removed before they are due: whoever pops one checks that it still stands.
#[derive(Debug)]
pub(super) struct TimerQueue {
    /// Number of the bucket being drained. Everything at or before it is in `due` and `near`.
    base: u64,
    /// Keys of the bucket being drained, latest first.
    due: Vec<u64>,
    /// Entries that arrived for the bucket being drained, or for one before it.
    near: BinaryHeap<Reverse<Entry>>,
    /// Newest chunk of each bucket.
    heads: Box<[u32]>,
    /// One bit for each bucket that is not empty.
    occupied: [u64; WORDS],
    /// Chunks of all buckets; memory follows the number of entries, and one chunk more for each
    /// bucket that is not empty.
    chunks: Vec<Chunk>,
    free: u32,
    /// Beyond the calendar.
    far: BinaryHeap<Reverse<Entry>>,
    len: usize,
}

impl TimerQueue {
    pub(super) fn new() -> Self {
        Self {
            base: 0,
            due: Vec::new(),
            near: BinaryHeap::new(),
            heads: vec![NONE; BUCKETS as usize].into_boxed_slice(),
            occupied: [0; WORDS],
            chunks: Vec::new(),
            free: NONE,
            far: BinaryHeap::new(),
            len: 0,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.len
    }

    pub(super) fn clear(&mut self) {
        self.due.clear();
        self.near.clear();
        self.heads.fill(NONE);
        self.occupied = [0; WORDS];
        self.chunks.clear();
        self.free = NONE;
        self.far.clear();
        self.len = 0;
    }

    pub(super) fn push(&mut self, entry: Entry) {
        self.len += 1;
        let bucket = entry.bucket();
        if bucket <= self.base {
            self.near.push(Reverse(entry));
        } else if bucket - self.base < BUCKETS {
            self.push_bucket(bucket, entry);
        } else {
            self.far.push(Reverse(entry));
        }
    }

    /// The earliest entry.
    pub(super) fn peek(&mut self) -> Option<Entry> {
        if self.due.is_empty() && self.near.is_empty() {
            self.advance();
        }
        let due = self.due.last().map(|&key| Entry::of(self.base, key));
        match (due, self.near.peek()) {
            (Some(a), Some(&Reverse(b))) => Some(a.min(b)),
            (Some(a), None) => Some(a),
            (None, Some(&Reverse(b))) => Some(b),
            (None, None) => None,
        }
    }

    /// Takes the earliest entry when it is due at `now`.
    pub(super) fn pop_due(&mut self, now: u64) -> Option<Entry> {
        if self.near.is_empty()
            && let Some(&key) = self.due.last()
        {
            let entry = Entry::of(self.base, key);
            if entry.at > now {
                return None;
            }
            self.due.pop();
            self.len -= 1;
            return Some(entry);
        }
        let entry = self.peek()?;
        if entry.at > now {
            return None;
        }
        self.len -= 1;
        let first = self.due.last().map(|&key| Entry::of(self.base, key));
        if first == Some(entry) {
            self.due.pop();
        } else {
            self.near.pop();
        }
        Some(entry)
    }

    /// The task whose entry lies `places` behind the earliest one, of those that have been sorted.
    pub(super) fn ahead(&self, places: usize) -> Option<u32> {
        let place = self.due.len().checked_sub(places + 1)?;
        self.due.get(place).map(|&key| key as u32)
    }

    fn push_bucket(&mut self, bucket: u64, entry: Entry) {
        let slot = (bucket % BUCKETS) as usize;
        let head = self.heads[slot];
        let room = self
            .chunks
            .get_mut(head as usize)
            .filter(|chunk| (chunk.len as usize) < CHUNK);
        if let Some(chunk) = room {
            chunk.keys[chunk.len as usize] = entry.key();
            chunk.len += 1;
            return;
        }
        let mut chunk = Chunk {
            keys: [0; CHUNK],
            len: 1,
            next: head,
        };
        chunk.keys[0] = entry.key();
        self.heads[slot] = if self.free == NONE {
            self.chunks.push(chunk);
            (self.chunks.len() - 1) as u32
        } else {
            let index = self.free;
            self.free = self.chunks[index as usize].next;
            self.chunks[index as usize] = chunk;
            index
        };
        self.occupied[slot / 64] |= 1 << (slot % 64);
    }

    /// Number of the first bucket after `base` that is not empty.
    fn next_bucket(&self) -> Option<u64> {
        let start = (self.base + 1) % BUCKETS;
        let first_word = (start / 64) as usize;
        let mut bits = self.occupied[first_word] & (u64::MAX << (start % 64));
        for step in 0..=WORDS {
            let word = (first_word + step) % WORDS;
            if step > 0 {
                bits = self.occupied[word];
            }
            if bits != 0 {
                let slot = word as u64 * 64 + u64::from(bits.trailing_zeros());
                let ahead = (slot + BUCKETS - start) % BUCKETS;
                return Some(self.base + 1 + ahead);
            }
        }
        None
    }

    /// Moves on to the next bucket with anything in it, and sorts it.
    fn advance(&mut self) {
        let far = self.far.peek().map(|&Reverse(entry)| entry.bucket());
        let next = match (self.next_bucket(), far) {
            (Some(a), Some(b)) => a.min(b),
            (Some(a), None) | (None, Some(a)) => a,
            (None, None) => return,
        };
        self.base = next;
        while let Some(&Reverse(entry)) = self.far.peek() {
            let bucket = entry.bucket();
            if bucket - next >= BUCKETS {
                break;
            }
            self.far.pop();
            if bucket == next {
                self.due.push(entry.key());
            } else {
                self.push_bucket(bucket, entry);
            }
        }
        let slot = (next % BUCKETS) as usize;
        let mut index = std::mem::replace(&mut self.heads[slot], NONE);
        self.occupied[slot / 64] &= !(1 << (slot % 64));
        // Latest arrivals first, so that robots in phase are in order already.
        while index != NONE {
            let chunk = &mut self.chunks[index as usize];
            let keys = &chunk.keys[..chunk.len as usize];
            self.due.extend(keys.iter().rev());
            let next = std::mem::replace(&mut chunk.next, self.free);
            self.free = index;
            index = next;
        }
        self.due.sort_unstable_by_key(|&key| Reverse(key));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A generator good enough to mix times; the queue sees no randomness of its own.
    fn mix(state: &mut u64) -> u64 {
        *state ^= *state << 13;
        *state ^= *state >> 7;
        *state ^= *state << 17;
        *state
    }

    #[test]
    fn entries_leave_in_order_of_time_and_task_as_from_a_heap() {
        let mut state = 0x9E37_79B9_7F4A_7C15;
        for round in 0..20 {
            let mut queue = TimerQueue::new();
            let mut model: BinaryHeap<Reverse<Entry>> = BinaryHeap::new();
            let mut now = 0;
            for _ in 0..3_000 {
                if mix(&mut state).is_multiple_of(3) {
                    // Spread over the bucket at hand, the calendar and the heap beyond it.
                    let span = [500, 20_000, 900_000, 1_100_000, 90_000_000]
                        [(mix(&mut state) % 5) as usize];
                    let entry = Entry {
                        at: now + mix(&mut state) % span,
                        task: (mix(&mut state) % 50) as u32,
                    };
                    queue.push(entry);
                    model.push(Reverse(entry));
                } else {
                    now += mix(&mut state) % [300, 30_000, 2_000_000][round % 3];
                    assert_eq!(queue.peek(), model.peek().map(|r| r.0));
                    while let Some(entry) = queue.pop_due(now) {
                        assert_eq!(Some(entry), model.pop().map(|r| r.0));
                    }
                    assert!(model.peek().is_none_or(|r| r.0.at > now));
                }
                assert_eq!(queue.len(), model.len());
            }
        }
    }

    #[test]
    fn what_lies_ahead_is_what_comes() {
        let mut queue = TimerQueue::new();
        assert_eq!(queue.ahead(0), None);
        for task in [3, 1, 2] {
            queue.push(Entry {
                at: 2_000 + u64::from(task),
                task,
            });
        }
        // Nobody has looked into its bucket yet.
        assert_eq!(queue.ahead(0), None);
        assert_eq!(queue.peek().map(|entry| entry.task), Some(1));
        assert_eq!(
            [0, 1, 2, 3].map(|places| queue.ahead(places)),
            [Some(1), Some(2), Some(3), None]
        );
    }

    #[test]
    fn memory_follows_the_entries_and_not_the_buckets() {
        let mut queue = TimerQueue::new();
        for beat in 1..=2_000_u64 {
            for task in 0..100 {
                queue.push(Entry {
                    at: beat * 1_024,
                    task,
                });
            }
            let mut popped = 0;
            while queue.pop_due(beat * 1_024).is_some() {
                popped += 1;
            }
            assert_eq!(popped, 100);
        }
        assert!(queue.chunks.len() <= 100 / CHUNK + 1);
    }

    #[test]
    fn an_entry_before_the_bucket_being_drained_still_leaves_first() {
        let mut queue = TimerQueue::new();
        queue.push(Entry {
            at: 5_000_000,
            task: 1,
        });
        assert_eq!(queue.peek().map(|e| e.at), Some(5_000_000));
        queue.push(Entry { at: 40, task: 2 });
        assert_eq!(queue.pop_due(100), Some(Entry { at: 40, task: 2 }));
        assert_eq!(queue.pop_due(100), None);
    }
}

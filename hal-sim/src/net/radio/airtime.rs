//! Airtime: who sends how long, and what others leave of a channel.

use std::ops::AddAssign;

/// What a window of a channel saw, summed over stations. Sums of whole numbers: the order in which
/// parts of a fleet are added does not matter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Airtime {
    /// Sent in all, nanoseconds.
    pub served_ns: u64,
    /// Sent by senders that keep up with what they have to say, nanoseconds.
    pub light_ns: u64,
    /// Senders that do not.
    pub backlogged: u32,
}

impl AddAssign for Airtime {
    fn add_assign(&mut self, other: Self) {
        self.served_ns += other.served_ns;
        self.light_ns += other.light_ns;
        self.backlogged += other.backlogged;
    }
}

/// Fractional bits of a stretch.
const POINT: u32 = 8;
const ONE: u32 = 1 << POINT;
/// Share of a channel that senders who keep up leave to the others at least.
const LEAST: f32 = 0.1;
/// Most of a channel that pays off a debt, and the share of the debt that is paid in one window:
/// slowly, since what is sent now stays as slow as it began.
const PAID: f32 = 0.2;
const PAID_SHARE: f32 = 0.1;
/// Least that collisions leave of a channel.
const LEAST_EFFICIENCY: f32 = 0.3;

/// What one sender has to say in one direction: served one thing after the other, as fast as
/// its share of the channel allows.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Flow {
    /// When all of it is sent, nanoseconds.
    busy_until_ns: u64,
    /// Airtime given to it since the window began, and left over from before.
    offered_ns: u64,
    /// Did not keep up in the last window.
    backlogged: bool,
    stretch: u32,
}

impl Flow {
    /// Sends what takes `airtime_ns` of an empty channel; returns when it is over.
    pub(super) fn send(&mut self, airtime_ns: u64, now_ns: u64, channel: &Channel) -> u64 {
        self.stretch = if self.backlogged {
            channel.backlogged
        } else {
            channel.light
        };
        self.offered_ns += airtime_ns;
        let start = self.busy_until_ns.max(now_ns);
        self.busy_until_ns = start + ((airtime_ns * u64::from(self.stretch)) >> POINT);
        self.busy_until_ns
    }

    /// Ends the window of `window_ns` that is over at `now_ns`; counts it in `sum`. Returns
    /// whether there is more to do.
    pub(super) fn close(&mut self, now_ns: u64, window_ns: u64, sum: &mut Airtime) -> bool {
        let wait = self.busy_until_ns.saturating_sub(now_ns);
        let left = (wait << POINT) / u64::from(self.stretch.max(ONE));
        let served = self.offered_ns.saturating_sub(left);
        // A frame that happens to be on its way is no backlog.
        self.backlogged = wait > window_ns / 2;
        self.offered_ns = left.min(self.offered_ns);
        sum.served_ns += served;
        if self.backlogged {
            sum.backlogged += 1;
        } else {
            sum.light_ns += served;
        }
        self.offered_ns > 0 || self.backlogged
    }

    /// Drops what is not sent yet.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }
}

/// A channel as seen from one more sender: how much longer than alone it takes to be heard.
///
/// Senders that keep up take what they need; the others share what is left in equal parts (the
/// max-min fair share, found window by window as in ATM's explicit rate control: Charny, Clark
/// and Jain, Congestion Control with Explicit Rate Indication, ICC 1995).
#[derive(Debug, Clone, Copy)]
pub(super) struct Channel {
    light: u32,
    backlogged: u32,
    /// Smoothed share that light senders take.
    taken: f32,
    /// Airtime given out beyond what there was, as a share of a window.
    debt: f32,
}

impl Default for Channel {
    fn default() -> Self {
        Self {
            light: ONE,
            backlogged: ONE,
            taken: 0.0,
            debt: 0.0,
        }
    }
}

impl Channel {
    /// Opens the next window after one in which `sum` happened.
    pub(super) fn open(&mut self, sum: Airtime, window_ns: u64, contention: f32) {
        let share = |ns: u64| ns as f32 / window_ns as f32;
        let senders = sum.backlogged as f32;
        let doublings = if sum.backlogged > 1 {
            libm::log2f(senders)
        } else {
            0.0
        };
        let capacity = (1.0 - contention * doublings).max(LEAST_EFFICIENCY);
        self.taken += (share(sum.light_ns) - self.taken) * 0.125;
        self.debt = (self.debt + share(sum.served_ns) - capacity).max(0.0);
        let paid = (PAID_SHARE * self.debt).min(PAID * capacity);
        let left = (capacity - self.taken - paid).max(LEAST * capacity);
        let stretch = |parts: f32| {
            // At most 2^24: a sender in such a crowd is as good as never heard.
            ((parts / left).min(65_536.0) * ONE as f32) as u32
        };
        self.light = stretch(senders + 1.0).max(ONE);
        self.backlogged = stretch(senders.max(1.0)).max(ONE);
    }
}

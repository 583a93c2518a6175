//! This server as one of several.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::{Cluster, Queue, Renewed};

/// A lease counts as over this long before it is: what was begun before goes out in between.
const MARGIN: Duration = Duration::from_millis(250);

/// What this server has with the others.
#[derive(Debug)]
pub struct ClusterMembership {
    /// The connection to Redis.
    pub cluster: Cluster,
    /// What the others are to be told.
    pub queue: Queue,
    member: Mutex<Member>,
    leader: AtomicBool,
    /// What has happened between them.
    pub counts: Counts,
}

#[derive(Debug, Clone, Copy)]
struct Member {
    slot: u8,
    until: Option<Instant>,
}

/// Counted for the metrics.
#[derive(Debug, Default)]
pub struct Counts {
    /// Messages that another server heard.
    pub relayed: AtomicU64,
    /// What came from another server and could not be read.
    pub unreadable: AtomicU64,
    /// Commands taken over.
    pub adopted: AtomicU64,
    /// Leases lost.
    pub lapses: AtomicU64,
}

impl ClusterMembership {
    /// Of a server that has no lease yet.
    pub fn new(cluster: Cluster) -> Self {
        Self {
            queue: Queue::new(cluster.token()),
            cluster,
            member: Mutex::new(Member {
                slot: 0,
                until: None,
            }),
            leader: AtomicBool::new(false),
            counts: Counts::default(),
        }
    }

    fn member(&self) -> MutexGuard<'_, Member> {
        self.member.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The slot that this server has, or had last.
    pub fn slot(&self) -> u8 {
        self.member().slot
    }

    /// Notes the lease.
    pub fn renewed(&self, slot: u8, lease: &Renewed) {
        *self.member() = Member {
            slot,
            until: Some(lease.until),
        };
        self.leader.store(lease.leader, Ordering::Relaxed);
    }

    /// Notes that there is none.
    pub fn lapsed(&self) {
        self.member().until = None;
    }

    /// Whether nobody else can have taken what is this server's.
    pub fn is_member(&self) -> bool {
        let until = self.member().until;
        until.is_some_and(|until| Instant::now() + MARGIN < until)
    }

    /// Whether this server does what one of them is to do. Without a lease everybody does: twice is
    /// better than never.
    pub fn leads(&self) -> bool {
        self.leader.load(Ordering::Relaxed) || !self.is_member()
    }
}

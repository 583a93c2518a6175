//! This server as one of several.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crawler_cluster::{Cluster, Queue, Renewed};
use crawler_protocol::Topic;

/// A lease counts as over this long before it is: what was begun before goes out in between.
const MARGIN: Duration = Duration::from_millis(250);

/// What this server has with the others.
pub(crate) struct ClusterMembership {
    pub(crate) cluster: Cluster,
    /// What the others are to be told.
    pub(crate) queue: Queue,
    member: Mutex<Member>,
    leader: AtomicBool,
    pub(crate) counts: Counts,
}

#[derive(Debug, Clone, Copy)]
struct Member {
    slot: u8,
    until: Option<Instant>,
}

/// Counted for the metrics.
#[derive(Debug, Default)]
pub(crate) struct Counts {
    /// Messages that another server heard.
    pub(crate) relayed: AtomicU64,
    /// What came from another server and could not be read.
    pub(crate) unreadable: AtomicU64,
    /// Commands taken over.
    pub(crate) adopted: AtomicU64,
    /// Leases lost.
    pub(crate) lapses: AtomicU64,
}

impl ClusterMembership {
    pub(crate) fn new(cluster: Cluster) -> Self {
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
    pub(crate) fn slot(&self) -> u8 {
        self.member().slot
    }

    /// Notes the lease.
    pub(crate) fn renewed(&self, slot: u8, lease: &Renewed) {
        *self.member() = Member {
            slot,
            until: Some(lease.until),
        };
        self.leader.store(lease.leader, Ordering::Relaxed);
    }

    /// Notes that there is none.
    pub(crate) fn lapsed(&self) {
        self.member().until = None;
    }

    /// Whether nobody else can have taken what is this server's.
    pub(crate) fn is_member(&self) -> bool {
        let until = self.member().until;
        until.is_some_and(|until| Instant::now() + MARGIN < until)
    }

    /// Whether this server does what one of them is to do. Without a lease everybody does: twice is
    /// better than never.
    pub(crate) fn leads(&self) -> bool {
        self.leader.load(Ordering::Relaxed) || !self.is_member()
    }
}

/// Whether a message goes to one server alone, which tells the others: what robots say all the time.
/// What everybody has to hear for itself is delivered to everybody.
pub(crate) const fn is_shared(topic: &Topic) -> bool {
    matches!(
        topic,
        Topic::Telemetry(_)
            | Topic::Heartbeat(_)
            | Topic::Vision(_)
            | Topic::Logs(_)
            | Topic::Image(_)
    )
}

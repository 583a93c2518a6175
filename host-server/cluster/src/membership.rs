//! This server as one of several.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crawler_metrics::Exposition;

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

/// How this server gets on with the others of its fleet. Zeros for a server that is alone.
pub fn write_metrics(out: &mut Exposition, membership: Option<&ClusterMembership>) {
    let flag = |value: fn(&ClusterMembership) -> bool| membership.is_some_and(value);
    for (name, help, value) in [
        (
            "configured",
            "1 where there may be other servers of this fleet",
            flag(|_| true),
        ),
        (
            "redis_up",
            "1 while Redis answers",
            flag(|membership| membership.cluster.is_up()),
        ),
        (
            "member",
            "1 while this server has a lease, and accepts commands",
            flag(ClusterMembership::is_member),
        ),
        (
            "leader",
            "1 on the server that does what one of them is to do",
            flag(|membership| membership.is_member() && membership.leads()),
        ),
    ] {
        out.flag(&format!("terracrawler_cluster_{name}"), help, value);
    }
    let counts = membership.map(|membership| &membership.counts);
    let count = |pick: fn(&Counts) -> &AtomicU64| {
        counts.map_or(0, |counts| pick(counts).load(Ordering::Relaxed)) as f64
    };
    for (name, help, value) in [
        (
            "relayed",
            "Messages of robots that another server heard and told",
            count(|counts| &counts.relayed),
        ),
        (
            "unreadable",
            "What came from another server and could not be read",
            count(|counts| &counts.unreadable),
        ),
        (
            "adopted",
            "Commands taken over from servers that were gone",
            count(|counts| &counts.adopted),
        ),
        (
            "lapses",
            "Leases that were not renewed in time",
            count(|counts| &counts.lapses),
        ),
        (
            "dropped",
            "Messages that the other servers were not told because too many waited",
            membership.map_or(0, |membership| membership.queue.dropped()) as f64,
        ),
    ] {
        out.counter(&format!("terracrawler_cluster_{name}"), help, value);
    }
}

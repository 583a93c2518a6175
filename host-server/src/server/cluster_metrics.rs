//! What the metrics tell of this server among the others.

use std::sync::atomic::{AtomicU64, Ordering};

use crawler_cluster::{ClusterMembership, Counts};
use crawler_metrics::Exposition;

/// How this server gets on with the others of its fleet. Zeros for a server that is alone.
pub(super) fn write_metrics(out: &mut Exposition, membership: Option<&ClusterMembership>) {
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

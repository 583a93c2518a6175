//! How this server gets on with the others of its fleet.

use std::sync::atomic::Ordering;

use super::observed::{counter, gauge};
use crate::cluster::Together;

/// Zeros for a server that is alone.
pub(super) fn write(out: &mut String, together: Option<&Together>) {
    let flag = |value: fn(&Together) -> bool| f64::from(u8::from(together.is_some_and(value)));
    for (name, help, value) in [
        (
            "configured",
            "1 where there may be other servers of this fleet",
            flag(|_| true),
        ),
        (
            "redis_up",
            "1 while Redis answers",
            flag(|together| together.cluster.is_up()),
        ),
        (
            "member",
            "1 while this server has a lease, and accepts commands",
            flag(Together::is_member),
        ),
        (
            "leader",
            "1 on the server that does what one of them is to do",
            flag(|together| together.is_member() && together.leads()),
        ),
    ] {
        gauge(out, &format!("terracrawler_cluster_{name}"), help, value);
    }
    let counts = together.map(|together| &together.counts);
    let count = |pick: fn(&crate::cluster::Counts) -> &std::sync::atomic::AtomicU64| {
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
            together.map_or(0, |together| together.queue.dropped()) as f64,
        ),
    ] {
        counter(out, &format!("terracrawler_cluster_{name}"), help, value);
    }
}

//! What several servers of one fleet do for each other, by the clock and by what comes over Redis.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use crawler_cluster::{
    Cluster, ClusterError, Joined, LEASE, News, Numbers, RENEW, Renewed, SLOTS, frame,
};
use crawler_protocol::Fleet;
use futures_util::{StreamExt as _, stream};
use tokio::sync::Notify;

use super::StartError;
use super::ingest::Ingest;
use super::outcome_log::OutcomeLog;
use super::parts::Parts;
use crate::config::{EngineUrl, Redis};
use crawler_cluster::ClusterMembership;
use crawler_commands::{CommandCenter, Journal};

/// File with the name of this server among the others, in the data directory.
pub(super) const NAME: &str = "server-name";
/// How often the others are told.
const TELL: Duration = Duration::from_millis(50);
/// They are told so often that this server is there, also when it has heard nothing.
const SIGN: Duration = Duration::from_secs(1);
/// A subscription that is silent for longer, with our own signs in it, is lost.
const SILENCE: Duration = Duration::from_secs(5);
/// Calls under way at a time.
const CALLS: usize = 16;

/// The lease of this server among the others.
pub(super) struct OwnLease {
    pub(super) membership: Arc<ClusterMembership>,
    lease: Renewed,
    slot: u8,
    name: PathBuf,
}

/// Joins the other servers. Whatever another has taken over is dropped from `journal`.
pub(super) async fn join(
    url: &EngineUrl<Redis>,
    fleet: &Fleet,
    name: PathBuf,
    journal: &mut Journal,
) -> Result<OwnLease, StartError> {
    let refused = |reason: String| StartError::Cache {
        cache: url.to_string(),
        reason,
    };
    let own = |error: io::Error| refused(format!("{}: {error}", name.display()));
    let known = read_name(&name).map_err(own)?;
    let instance = match known {
        Some(known) => known,
        None => new_name(&name).map_err(own)?,
    };
    let cluster = Cluster::open(url.reveal(), fleet.as_str(), instance)
        .map_err(|error| refused(error.to_string()))?;
    let deadline = Instant::now() + 3 * LEASE;
    let slot = loop {
        match cluster
            .join()
            .await
            .map_err(|error| refused(error.to_string()))?
        {
            Joined::Slot(slot) => break slot,
            Joined::Adopted => {
                tracing::info!("another server has taken over what this one owed");
                journal.keep(|_| false).map_err(own)?;
                cluster.rename(new_name(&name).map_err(own)?);
            }
            // It was killed a moment ago, and its lease is not over.
            Joined::Taken if Instant::now() < deadline => {
                tokio::time::sleep(RENEW / 4).await;
            }
            Joined::Taken => {
                return Err(refused(format!(
                    "another server runs on a copy of this data directory: remove {} from one of \
                     them",
                    name.display()
                )));
            }
            Joined::Full => {
                return Err(refused(format!("{SLOTS} servers are there already")));
            }
        }
    };
    let lease = cluster.renew(slot).await;
    let lease = lease.map_err(|error| refused(error.to_string()))?;
    let membership = Arc::new(ClusterMembership::new(cluster));
    membership.renewed(slot, &lease);
    Ok(OwnLease {
        membership,
        lease,
        slot,
        name,
    })
}

/// Says goodbye to the other servers.
pub(super) async fn leave(membership: Arc<ClusterMembership>) {
    let slot = membership.slot();
    membership.lapsed();
    if let Err(error) = membership.cluster.leave(slot).await {
        tracing::warn!(%error, "the other servers have to find out that this one is gone");
    }
}

fn read_name(path: &Path) -> io::Result<Option<String>> {
    match fs::read_to_string(path) {
        Ok(text) => {
            let name = text.trim();
            // Cut short by a crash while it was written: nothing was kept under it.
            let whole = name.len() == 16 && name.bytes().all(|byte| byte.is_ascii_hexdigit());
            Ok(whole.then(|| name.to_owned()))
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

fn new_name(path: &Path) -> io::Result<String> {
    let name = Cluster::new_name().map_err(io::Error::other)?;
    let mut file = File::create(path)?;
    writeln!(file, "{name}")?;
    file.sync_all()?;
    Ok(name)
}

impl OwnLease {
    /// Commands that are shared, and those of them that this server owes by the word of the others. What
    /// is not its own any more is dropped from `journal`.
    pub(super) async fn share(
        &self,
        commands: CommandCenter,
        journal: &mut Journal,
    ) -> Result<(CommandCenter, Vec<u64>), ClusterError> {
        let cluster = &self.membership.cluster;
        let commands = commands.with_cluster(&self.membership);
        commands.share(
            Numbers::new(self.slot, self.lease.ahead_us),
            self.lease.greatest,
        );
        let mine = cluster.mine().await?;
        // What the others were told says more than the file. What they know of and is not ours is
        // done. What they have forgotten, the file knows.
        let mut forgotten = BTreeSet::new();
        for id in journal.ids() {
            if !mine.contains(&id) && cluster.read(id).await?.is_empty() {
                forgotten.insert(id);
            }
        }
        if let Err(error) = journal.keep(|id| forgotten.contains(&id)) {
            tracing::error!(%error, "the journal of commands cannot be written");
        }
        Ok((commands, mine))
    }

    /// Goes on with what this server owes by the word of the others, and tells them what it owes by that of
    /// its journal.
    pub(super) async fn go_on(
        &self,
        commands: &CommandCenter,
        mine: Vec<u64>,
    ) -> Result<(), ClusterError> {
        let cluster = &self.membership.cluster;
        let now = Instant::now();
        for id in mine {
            commands.take_over(id, &cluster.read(id).await?, now);
        }
        for (id, fields) in commands.everything() {
            cluster.accept(id, &fields).await?;
        }
        Ok(())
    }

    /// Starts what goes on for as long as the server does.
    pub(super) fn start(
        self,
        commands: &Arc<CommandCenter>,
        outcomes: OutcomeLog,
        ingest: &Arc<Ingest>,
        records_changed: &Arc<Notify>,
        parts: &mut Parts,
    ) -> Result<(), StartError> {
        let membership = Arc::clone(&self.membership);
        let (own, all) = (Arc::clone(commands), Arc::clone(&membership));
        parts.task("what other servers are told of commands", |stop| {
            async move {
                stop.run_until_cancelled(flush(&own, &all)).await;
                // What was answered in the last moment.
                write(&own, &all).await;
            }
        })?;
        let own = Arc::clone(commands);
        parts.task("the lease among the servers", |stop| async move {
            stop.run_until_cancelled(self.keep(&own, &outcomes)).await;
        })?;
        let telling = tell(Arc::clone(&membership));
        parts.task("what other servers are told", |stop| async move {
            stop.run_until_cancelled(telling).await;
        })?;
        let hearing = listen(Arc::clone(records_changed), Arc::clone(ingest), membership);
        parts.task("what other servers tell", |stop| async move {
            stop.run_until_cancelled(hearing).await;
        })
    }

    /// Keeps the lease, and takes over from those who have lost theirs.
    async fn keep(&self, commands: &CommandCenter, outcomes: &OutcomeLog) {
        let membership = &self.membership;
        let mut tick = tokio::time::interval(RENEW);
        tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        // Whoever has just come, or come back, gives the others time to do so.
        let mut since = Instant::now();
        let mut away = false;
        let mut unsure = false;
        loop {
            tick.tick().await;
            match membership.cluster.renew(membership.slot()).await {
                Ok(lease) => {
                    membership.renewed(membership.slot(), &lease);
                    let numbers = Numbers::new(membership.slot(), lease.ahead_us);
                    commands.share(numbers, lease.greatest);
                    if std::mem::take(&mut away) {
                        tracing::info!("Redis is back");
                        since = Instant::now();
                    }
                    if since.elapsed() > LEASE {
                        match inherit(commands, outcomes, membership, unsure).await {
                            Ok(()) => unsure = false,
                            Err(error) => {
                                unsure = true;
                                tracing::warn!(%error, "cannot take over from another server");
                            }
                        }
                    }
                }
                Err(ClusterError::NoLease) => {
                    membership.counts.lapses.fetch_add(1, Ordering::Relaxed);
                    membership.lapsed();
                    since = Instant::now();
                    if let Err(error) = self.rejoin(commands).await {
                        tracing::warn!(%error, "cannot join the other servers");
                    }
                }
                Err(error) => {
                    if !std::mem::replace(&mut away, true) {
                        tracing::error!(%error, "Redis is away: no command is accepted but halts");
                    }
                }
            }
        }
    }

    /// Comes back after the lease was over.
    async fn rejoin(&self, commands: &CommandCenter) -> Result<(), ClusterError> {
        let cluster = &self.membership.cluster;
        for _ in 0..2 {
            match cluster.join().await? {
                Joined::Slot(slot) => {
                    let lease = cluster.renew(slot).await?;
                    commands.share(Numbers::new(slot, lease.ahead_us), lease.greatest);
                    // Redis may have forgotten everything.
                    for (id, fields) in commands.everything() {
                        cluster.accept(id, &fields).await?;
                    }
                    self.membership.renewed(slot, &lease);
                    tracing::warn!(slot, "joined the other servers again");
                    return Ok(());
                }
                Joined::Adopted => {
                    tracing::warn!("another server has taken over what this one owed");
                    commands.let_go();
                    let path = self.name.clone();
                    // A slow disk must not hold up whoever else is on this thread.
                    let named = tokio::task::spawn_blocking(move || new_name(&path)).await;
                    match named.unwrap_or_else(|error| Err(io::Error::other(error))) {
                        Ok(name) => cluster.rename(name),
                        Err(error) => {
                            // Under the old name nothing is accepted any more.
                            tracing::error!(%error, "cannot write the name of this server");
                            return Ok(());
                        }
                    }
                }
                Joined::Taken => {
                    tracing::error!("another server runs on a copy of this data directory");
                    return Ok(());
                }
                Joined::Full => {
                    tracing::error!("{SLOTS} servers are there already");
                    return Ok(());
                }
            }
        }
        Ok(())
    }
}

/// Takes over what servers owe that are gone.
async fn inherit(
    commands: &CommandCenter,
    outcomes: &OutcomeLog,
    membership: &ClusterMembership,
    unsure: bool,
) -> Result<(), ClusterError> {
    let cluster = &membership.cluster;
    let mut ids = Vec::new();
    for adopted in cluster.adopt().await? {
        tracing::warn!(
            server = adopted.from,
            commands = adopted.ids.len(),
            "another server is gone; taking over"
        );
        ids.extend(adopted.ids);
    }
    if unsure {
        // The last time the answer was lost, and perhaps not what was asked for.
        ids.extend(cluster.mine().await?);
    }
    for id in ids {
        let fields = cluster.read(id).await?;
        membership.counts.adopted.fetch_add(1, Ordering::Relaxed);
        if let Some(over) = commands.take_over(id, &fields, Instant::now()) {
            outcomes.tell(&over);
        }
    }
    Ok(())
}

/// Tells the others what becomes of commands.
async fn flush(commands: &CommandCenter, membership: &ClusterMembership) {
    loop {
        tokio::time::sleep(TELL).await;
        if membership.is_member() {
            write(commands, membership).await;
        }
    }
}

async fn write(commands: &CommandCenter, membership: &ClusterMembership) {
    let cluster = &membership.cluster;
    for id in commands.retracted() {
        if let Err(error) = cluster.retract(id).await {
            tracing::debug!(%error, id, "a command cannot be taken back yet");
            commands.retract(id);
        }
    }
    stream::iter(commands.changes())
        .for_each_concurrent(CALLS, |change| async move {
            let told = cluster.update(change.id, &change.fields, change.finished);
            match told.await {
                Ok(()) => commands.written(change),
                Err(error) => {
                    tracing::debug!(%error, id = change.id, "an outcome cannot be shared yet");
                    commands.unwritten(change);
                }
            }
        })
        .await;
}

/// Tells the others what this server has heard.
async fn tell(membership: Arc<ClusterMembership>) {
    let mut told = Instant::now();
    loop {
        tokio::time::sleep(TELL).await;
        let mut next = membership.queue.take();
        if next.is_none() && told.elapsed() >= SIGN {
            next = Some(frame::begin(membership.cluster.token()));
        }
        while let Some(frame) = next {
            told = Instant::now();
            if let Err(error) = membership.cluster.tell(&frame).await {
                // What was heard a second ago is of no use to anybody.
                tracing::debug!(%error, "the others do not hear what this server hears");
            }
            next = membership.queue.take();
        }
    }
}

/// Hears what the others tell.
async fn listen(
    records_changed: Arc<Notify>,
    ingest: Arc<Ingest>,
    membership: Arc<ClusterMembership>,
) {
    loop {
        match membership.cluster.subscribe().await {
            Ok(mut subscription) => {
                // Whatever was told in between is in the records.
                records_changed.notify_one();
                while let Ok(Some(news)) = tokio::time::timeout(SILENCE, subscription.next()).await
                {
                    match news {
                        News::Heard(bytes) => hear(&ingest, &membership, &bytes),
                        News::Changed => records_changed.notify_one(),
                    }
                }
                tracing::warn!("lost the subscription to the other servers");
            }
            Err(error) => tracing::debug!(%error, "cannot listen to the other servers"),
        }
        tokio::time::sleep(SIGN).await;
    }
}

fn hear(ingest: &Ingest, membership: &ClusterMembership, bytes: &[u8]) {
    match frame::read(bytes) {
        Ok((sender, _)) if sender == membership.cluster.token() => {}
        Ok((_, messages)) => {
            let count = messages.len() as u64;
            membership
                .counts
                .relayed
                .fetch_add(count, Ordering::Relaxed);
            for message in &messages {
                ingest.relayed(message);
            }
        }
        Err(error) => {
            membership.counts.unreadable.fetch_add(1, Ordering::Relaxed);
            tracing::debug!(%error, "another server cannot be understood");
        }
    }
}

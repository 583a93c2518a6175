//! What the broker knows of its clients: what each may do, and how much each sends.

use std::collections::HashMap;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crawler_access::limits::{Allowance, Flood, Verdict};
use crawler_access::topics::{Act, is_withheld, may};
use crawler_protocol::{Fleet, RobotId};

use super::accounts::{Access, Kind, Refusal};
use super::edge::Peers;

/// What one client may publish without being slowed down. A robot publishes about seven messages a
/// second; a controller steering at 50 Hz stays far below as well.
const ALLOWANCE: Allowance = Allowance {
    per_second: 500.0,
    burst: 1_000.0,
    // The largest packet is worth 256 units, and a session waits before it sends the next.
    debt: 2_000.0,
    patience: Duration::from_secs(10),
};
/// Halts that one client may send whatever else it sends.
const HALTS: Allowance = Allowance {
    per_second: 50.0,
    burst: 200.0,
    debt: 0.0,
    patience: Duration::ZERO,
};
/// Bytes that count as one message.
const UNIT: usize = 1_024;
/// Messages that a connection and a subscription count as. A subscription with a wildcard brings
/// the retained messages of a whole fleet.
const CONNECTION: f64 = 10.0;
const SUBSCRIPTION: f64 = 1.0;
const WIDE_SUBSCRIPTION: f64 = 50.0;
/// How long a client that was cut off stays away.
const LOCKED: Duration = Duration::from_mins(1);
/// A client counts as throttled so long after it had to wait.
const SHOWN: Duration = Duration::from_secs(2);
/// An empty bucket is full after two seconds, and after six when its client is deep in debt. Nothing
/// is lost by forgetting it then.
const FULL_AFTER: Duration = Duration::from_secs(6);
/// Clients whose spending is remembered: those that are there, and as many that are not.
const MAX_METERS: usize = 50_000;
/// Clients whose sessions are remembered. One whose handshake failed half-way is forgotten when
/// there are so many.
const MAX_CLIENTS: usize = 50_000;
/// Sessions of one client at a time: the one that ends, the one that takes over, and those whose
/// handshake failed half-way.
const MAX_SESSIONS: usize = 4;
/// How long a name that was dropped is kept from logins under way. A handshake takes at most 10 s.
const DROP_MEMORY: Duration = Duration::from_secs(30);
/// Names that were dropped are looked through when there are so many.
const MANY_DROPS: usize = 1_000;

/// How the link to a robot is, when it is not well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkState {
    /// It sends more than it may and is slowed down.
    Throttled,
    /// It stayed over its budget and is locked out for a while.
    CutOff,
}

impl LinkState {
    /// As the API names it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Throttled => "throttled",
            Self::CutOff => "cut_off",
        }
    }
}

/// Which session is meant. A client that connects again has a new session before the old one has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Key<'a> {
    pub(crate) client: &'a str,
    pub(crate) made: Made,
}

/// When and how a session began. Two of a client may begin in the same millisecond, but not over the same
/// connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Made {
    /// Unix time by the broker's clock, in milliseconds.
    pub(crate) at: i64,
    /// The far end of its connection, as the broker sees it.
    pub(crate) over: Option<SocketAddr>,
}

/// What becomes of something that counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Spent {
    /// It goes through.
    Pass,
    /// It goes through after this time.
    Wait(Duration),
    /// The client has just been cut off.
    CutOff,
    /// The client was cut off before; this was under way.
    Locked,
}

struct Session {
    made: Made,
    /// When its login began.
    begun: Instant,
    user: Option<String>,
    access: Access,
}

struct Meter {
    flood: Flood,
    halts: Flood,
    used: Instant,
    /// When it last had to wait.
    waited: Option<Instant>,
    locked_until: Option<Instant>,
}

#[derive(Default)]
struct Inner {
    sessions: HashMap<String, Vec<Session>>,
    /// Whose each session is, also while its client is away.
    kinds: HashMap<String, Kind>,
    meters: HashMap<String, Meter>,
    /// When each name was dropped last. Only the records' names get in here.
    drops: HashMap<(Kind, String), Instant>,
}

/// The list of clients.
pub(crate) struct Clients {
    fleet: Fleet,
    inner: Mutex<Inner>,
    /// Where those come from that come through TLS or a WebSocket.
    peers: Arc<Peers>,
}

impl Clients {
    pub(crate) fn new(fleet: Fleet) -> Self {
        Self {
            fleet,
            inner: Mutex::default(),
            peers: Arc::default(),
        }
    }

    pub(crate) const fn peers(&self) -> &Arc<Peers> {
        &self.peers
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether a client was cut off and has to stay away.
    pub(crate) fn is_locked(&self, client: &str, now: Instant) -> bool {
        let inner = self.lock();
        let meter = inner.meters.get(client);
        meter.is_some_and(|meter| meter.is_locked(now))
    }

    /// Lets a session in.
    ///
    /// # Errors
    /// Why it may not come in after all: its name was dropped since `begun`, it comes too often, or
    /// there are too many.
    pub(crate) fn enter(
        &self,
        key: Key<'_>,
        user: Option<&str>,
        access: Access,
        begun: Instant,
        now: Instant,
    ) -> Result<(), Refusal> {
        let mut inner = self.lock();
        let kind = access.kind();
        if inner.is_dropped(kind, user, begun) {
            return Err(Refusal::Credentials);
        }
        match inner.spend(key.client, CONNECTION, now) {
            Spent::Pass | Spent::Wait(_) => {}
            Spent::CutOff | Spent::Locked => return Err(Refusal::CutOff),
        }
        let is_new = !inner.sessions.contains_key(key.client);
        if is_new && inner.is_full() {
            return Err(Refusal::Busy);
        }
        if let Some(kind) = kind {
            inner.kinds.insert(key.client.to_owned(), kind);
        }
        let sessions = inner.sessions.entry(key.client.to_owned()).or_default();
        if sessions.len() >= MAX_SESSIONS {
            sessions.remove(0);
        }
        sessions.push(Session {
            made: key.made,
            begun,
            user: user.map(str::to_owned),
            access,
        });
        Ok(())
    }

    /// Whether a session that has just been set up may stay: its name was not dropped meanwhile.
    pub(crate) fn may_stay(&self, key: Key<'_>) -> bool {
        let inner = self.lock();
        inner.session(key).is_some_and(|session| {
            !inner.is_dropped(
                session.access.kind(),
                session.user.as_deref(),
                session.begun,
            )
        })
    }

    /// Forgets a session that has ended. What it sent counts on.
    pub(crate) fn leave(&self, key: Key<'_>) {
        self.lock()
            .keep(key.client, |session| session.made != key.made);
    }

    /// Whether there are so many clients that some must be ghosts: see [`prune`](Self::prune).
    pub(crate) fn is_full(&self) -> bool {
        self.lock().is_full()
    }

    /// Forgets the clients that are no longer among the broker's.
    pub(crate) fn prune(&self, exists: impl Fn(&str) -> bool) {
        let mut inner = self.lock();
        inner.sessions.retain(|client, _| exists(client));
        inner.kinds.retain(|client, _| exists(client));
    }

    /// Whose the session of a client is, connected or not.
    pub(crate) fn kind(&self, client: &str) -> Option<Kind> {
        self.lock().kinds.get(client).copied()
    }

    /// Takes everything from the sessions of a name, and keeps logins under way from getting it
    /// back. Returns their client ids.
    pub(crate) fn expel(&self, kind: Kind, user: &str, now: Instant) -> Vec<String> {
        let mut inner = self.lock();
        if inner.drops.len() >= MANY_DROPS {
            let recent = |at: Instant| now.saturating_duration_since(at) <= DROP_MEMORY;
            inner.drops.retain(|_, at| recent(*at));
        }
        inner.drops.insert((kind, user.to_owned()), now);
        let of_user = |session: &Session| {
            session.access.kind() == Some(kind) && session.user.as_deref() == Some(user)
        };
        let clients: Vec<_> = inner
            .sessions
            .iter()
            .filter(|(_, sessions)| sessions.iter().any(of_user))
            .map(|(client, _)| client.clone())
            .collect();
        for client in &clients {
            inner.keep(client, |session| !of_user(session));
        }
        clients
    }

    /// What a session may do; `None` for one that was expelled.
    pub(crate) fn access(&self, key: Key<'_>) -> Option<Access> {
        let inner = self.lock();
        inner.session(key).map(|session| session.access.clone())
    }

    /// Whether something is allowed to somebody with this access.
    pub(crate) fn may(&self, access: &Access, act: Act, topic_or_filter: &str) -> bool {
        match access {
            Access::Everything => true,
            Access::As(who) => may(who, act, &self.fleet, topic_or_filter),
        }
    }

    /// Who is not told of a topic, whatever it has subscribed to: people, of what their rows leave out. `None`
    /// where everybody is.
    pub(crate) fn kept_from(&self, topic: &str) -> Option<impl Fn(&str) -> bool + use<'_>> {
        is_withheld(&self.fleet, topic)
            .then_some(|client: &str| self.kind(client) == Some(Kind::Person))
    }

    /// Counts a publish.
    pub(crate) fn published(&self, client: &str, bytes: usize, now: Instant) -> Spent {
        let units = bytes.div_ceil(UNIT).max(1) as f64;
        self.lock().spend(client, units, now)
    }

    /// Counts a halt. Whether it goes through at once, whatever the client has sent before; otherwise it
    /// counts like anything else.
    pub(crate) fn halted(&self, client: &str, now: Instant) -> bool {
        let mut inner = self.lock();
        let meter = inner.meter(client, now);
        meter.is_some_and(|meter| meter.halts.spend(1.0, now) == Verdict::Pass)
    }

    /// Counts a subscription.
    pub(crate) fn subscribed(&self, client: &str, filter: &str, now: Instant) -> Spent {
        let wide = filter.contains(['+', '#']);
        let units = if wide {
            WIDE_SUBSCRIPTION
        } else {
            SUBSCRIPTION
        };
        self.lock().spend(client, units, now)
    }

    /// How the link to a robot is, when it is not well.
    pub(crate) fn link(&self, robot: &RobotId, now: Instant) -> Option<LinkState> {
        let inner = self.lock();
        let meter = inner.meters.get(robot.as_str())?;
        if meter.is_locked(now) {
            return Some(LinkState::CutOff);
        }
        let waited = meter.waited?;
        (now.saturating_duration_since(waited) < SHOWN).then_some(LinkState::Throttled)
    }
}

impl Inner {
    fn session(&self, key: Key<'_>) -> Option<&Session> {
        let sessions = self.sessions.get(key.client)?;
        sessions.iter().find(|session| session.made == key.made)
    }

    fn keep(&mut self, client: &str, wanted: impl Fn(&Session) -> bool) {
        if let Some(sessions) = self.sessions.get_mut(client) {
            sessions.retain(wanted);
            if sessions.is_empty() {
                self.sessions.remove(client);
            }
        }
    }

    fn meter(&mut self, client: &str, now: Instant) -> Option<&mut Meter> {
        if !self.meters.contains_key(client) {
            self.make_room(now);
            self.meters.insert(client.to_owned(), Meter::new(now));
        }
        let meter = self.meters.get_mut(client)?;
        meter.used = now;
        Some(meter)
    }

    fn spend(&mut self, client: &str, units: f64, now: Instant) -> Spent {
        let Some(meter) = self.meter(client, now) else {
            return Spent::Locked;
        };
        if meter.is_locked(now) {
            return Spent::Locked;
        }
        match meter.flood.spend(units, now) {
            Verdict::Pass => Spent::Pass,
            Verdict::Wait(wait) => {
                meter.waited = Some(now + wait);
                Spent::Wait(wait)
            }
            Verdict::CutOff => {
                // Whoever comes back begins anew.
                *meter = Meter {
                    locked_until: Some(now + LOCKED),
                    ..Meter::new(now)
                };
                Spent::CutOff
            }
        }
    }

    fn make_room(&mut self, now: Instant) {
        if self.meters.len() < MAX_METERS {
            return;
        }
        self.meters.retain(|_, meter| meter.matters(now));
        if self.meters.len() >= MAX_METERS {
            // More floods at once than there can be sessions: a second chance for those that are
            // gone, rather than no memory.
            let sessions = &self.sessions;
            self.meters
                .retain(|client, _| sessions.contains_key(client));
        }
        if self.meters.len() >= MAX_METERS {
            self.meters.clear();
        }
    }

    fn is_full(&self) -> bool {
        self.sessions.len().max(self.kinds.len()) >= MAX_CLIENTS
    }

    /// Whether a name was dropped since a login under it began.
    fn is_dropped(&self, kind: Option<Kind>, user: Option<&str>, begun: Instant) -> bool {
        let name = kind.zip(user).map(|(kind, user)| (kind, user.to_owned()));
        let dropped = name.and_then(|name| self.drops.get(&name));
        dropped.is_some_and(|at| *at >= begun)
    }
}

impl Meter {
    fn new(now: Instant) -> Self {
        Self {
            flood: Flood::new(ALLOWANCE, now),
            halts: Flood::new(HALTS, now),
            used: now,
            waited: None,
            locked_until: None,
        }
    }

    fn is_locked(&self, now: Instant) -> bool {
        self.locked_until.is_some_and(|until| now < until)
    }

    /// Whether it makes a difference to forget it.
    fn matters(&self, now: Instant) -> bool {
        self.is_locked(now) || now.saturating_duration_since(self.used) < FULL_AFTER
    }
}

#[cfg(test)]
#[path = "clients_tests.rs"]
mod tests;

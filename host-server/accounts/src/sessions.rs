//! The sessions that are alive, in memory: what every request is held against.
//!
//! A token says which session it belongs to and is good for a quarter of an hour. A session that
//! ends takes its tokens with it at once: what is not in this list is nobody.

use std::collections::HashMap;

use crawler_access::UserName;
use tokio_util::sync::CancellationToken;

/// Why a session ended, for whoever still listens to the live feed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// Somebody ended it.
    Revoked,
    /// Nobody refreshed it in time.
    Expired,
}

#[derive(Debug)]
struct Session {
    user: UserName,
    /// Unix milliseconds.
    expires: i64,
    ended: CancellationToken,
}

/// For how long it is remembered that a session has ended. Whoever read the records before that, and
/// is late to say so, must not bring it back.
const REMEMBERED: i64 = 10 * 60 * 1_000;

/// Sessions by their number.
#[derive(Debug, Default)]
pub(crate) struct Alive {
    sessions: HashMap<u64, Session>,
    /// Those that ended lately: why, and when.
    ended: HashMap<u64, (Ending, i64)>,
}

impl Alive {
    /// Notes a session, or that it lasts longer than it did. One that has ended stays ended.
    pub(crate) fn insert(&mut self, id: u64, user: &UserName, expires: i64) {
        if self.ended.contains_key(&id) {
            return;
        }
        self.sessions
            .entry(id)
            .and_modify(|session| session.expires = session.expires.max(expires))
            .or_insert_with(|| Session {
                user: user.clone(),
                expires,
                ended: CancellationToken::new(),
            });
    }

    /// Whose session this is, and what ends with it.
    pub(crate) fn get(&self, id: u64, now: i64) -> Option<(&UserName, CancellationToken)> {
        let session = self.sessions.get(&id)?;
        (session.expires > now).then(|| (&session.user, session.ended.clone()))
    }

    /// Why a session has ended.
    pub(crate) fn ending(&self, id: u64) -> Ending {
        let ended = self.ended.get(&id);
        ended.map_or(Ending::Revoked, |(ending, _)| *ending)
    }

    /// The numbers of all sessions.
    pub(crate) fn ids(&self) -> Vec<u64> {
        self.sessions.keys().copied().collect()
    }

    /// Ends a session, whether or not it is known.
    pub(crate) fn end(&mut self, id: u64, now: i64) {
        self.over(id, Ending::Revoked, now);
    }

    fn over(&mut self, id: u64, ending: Ending, now: i64) {
        self.ended.entry(id).or_insert((ending, now));
        if let Some(session) = self.sessions.remove(&id) {
            session.ended.cancel();
        }
    }

    /// Ends all sessions of a user but one.
    pub(crate) fn end_all(&mut self, user: &UserName, but: Option<u64>, now: i64) {
        let own = self.sessions.iter();
        let own = own.filter(|(id, session)| session.user == *user && but != Some(**id));
        for id in own.map(|(id, _)| *id).collect::<Vec<_>>() {
            self.end(id, now);
        }
    }

    /// Ends sessions that nobody refreshed in time, and forgets those that ended long ago.
    pub(crate) fn sweep(&mut self, now: i64) {
        let late = self.sessions.iter();
        let late = late.filter(|(_, session)| session.expires <= now);
        for id in late.map(|(id, _)| *id).collect::<Vec<_>>() {
            self.over(id, Ending::Expired, now);
        }
        self.ended
            .retain(|_, (_, at)| now.saturating_sub(*at) < REMEMBERED);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> UserName {
        text.parse().expect("name")
    }

    #[test]
    fn a_session_ends_at_once_and_takes_its_readers_along() {
        let mut alive = Alive::default();
        alive.insert(1, &name("ada"), 100);
        alive.insert(2, &name("ada"), 100);
        let (user, ended) = alive.get(1, 50).expect("alive");
        assert_eq!(user, &name("ada"));
        alive.end(1, 50);
        assert!(ended.is_cancelled());
        assert!(alive.get(1, 50).is_none());
        assert!(alive.get(2, 50).is_some(), "another session stays");
        assert!(alive.get(3, 50).is_none(), "nobody opened it");
        alive.insert(1, &name("ada"), 200);
        assert!(alive.get(1, 50).is_none(), "what ended stays ended");
        alive.end(9, 50);
        alive.insert(9, &name("ada"), 200);
        assert!(alive.get(9, 50).is_none(), "also when the end was quicker");
    }

    #[test]
    fn time_ends_sessions_as_well() {
        let mut alive = Alive::default();
        alive.insert(1, &name("ada"), 100);
        let (_, ended) = alive.get(1, 99).expect("alive");
        assert!(alive.get(1, 100).is_none());
        alive.insert(1, &name("ada"), 200);
        assert!(alive.get(1, 199).is_some(), "refreshed");
        alive.sweep(199);
        assert!(!ended.is_cancelled());
        alive.sweep(200);
        assert!(ended.is_cancelled());
        assert_eq!(alive.ending(1), Ending::Expired);
        alive.sweep(200 + REMEMBERED);
        assert!(alive.ended.is_empty() && alive.sessions.is_empty());
    }

    #[test]
    fn all_sessions_of_one_end_but_the_one_kept() {
        let mut alive = Alive::default();
        for id in 1..=3 {
            alive.insert(id, &name("ada"), 100);
        }
        alive.insert(4, &name("bob"), 100);
        alive.end_all(&name("ada"), Some(2), 0);
        let left: Vec<_> = (1..=4).filter(|id| alive.get(*id, 0).is_some()).collect();
        assert_eq!(left, [2, 4]);
    }
}

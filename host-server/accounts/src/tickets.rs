//! Tickets: what a browser shows in the address of a WebSocket, where it can send no token.
//!
//! Addresses end up in logs, so a ticket is good once, for half a minute, and for nothing else.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use crawler_access::{Digest, NoRandomness, Role, Secret};

use crate::Identity;

/// For how long a ticket is good.
pub const LIFETIME: Duration = Duration::from_secs(30);
/// Tickets of everybody that wait to be used; the oldest makes room.
const MOST: usize = 1_024;
/// And of one session.
const MOST_EACH: usize = 16;

struct Ticket {
    digest: Digest,
    identity: Identity,
    expires: Instant,
}

/// Tickets that were not used yet, the oldest first.
#[derive(Default)]
pub(crate) struct Tickets(VecDeque<Ticket>);

impl Tickets {
    /// A ticket for `identity`.
    ///
    /// # Errors
    /// [`NoRandomness`] when the system gives none.
    pub(crate) fn issue(
        &mut self,
        identity: &Identity,
        now: Instant,
    ) -> Result<Secret, NoRandomness> {
        self.forget(now);
        let own = |ticket: &Ticket| ticket.identity.session == identity.session;
        if self.0.iter().filter(|ticket| own(ticket)).count() >= MOST_EACH
            && let Some(oldest) = self.0.iter().position(own)
        {
            self.0.remove(oldest);
        } else if self.0.len() >= MOST {
            self.0.pop_front();
        }
        let secret = Secret::generate()?;
        self.0.push_back(Ticket {
            digest: secret.digest(),
            identity: identity.clone(),
            expires: now + LIFETIME,
        });
        Ok(secret)
    }

    /// Whose ticket this is. It is used up by that.
    pub(crate) fn redeem(&mut self, secret: &Secret, now: Instant) -> Option<Identity> {
        self.forget(now);
        let mut all = self.0.iter();
        let position = all.position(|ticket| ticket.digest.matches(secret))?;
        self.0.remove(position).map(|ticket| ticket.identity)
    }

    fn forget(&mut self, now: Instant) {
        while self.0.front().is_some_and(|ticket| ticket.expires <= now) {
            self.0.pop_front();
        }
    }
}

/// What other servers are told of a ticket. Short: it lives for half a minute.
pub(crate) struct SharedTicket;

impl SharedTicket {
    pub(crate) fn of(identity: &Identity) -> String {
        format!("{} {}", identity.session, identity.role)
    }

    /// The session and the role; `None` when it says something else.
    pub(crate) fn read(text: &str) -> Option<(u64, Role)> {
        let (session, role) = text.split_once(' ')?;
        Some((session.parse().ok()?, role.parse().ok()?))
    }
}

#[cfg(test)]
mod tests {
    use tokio_util::sync::CancellationToken;

    use super::*;

    fn identity(session: u64) -> Identity {
        Identity {
            user: "ada".parse().expect("name"),
            role: Role::Viewer,
            session,
            ended: CancellationToken::new(),
        }
    }

    #[test]
    fn a_ticket_is_good_once_and_not_for_long() {
        let mut tickets = Tickets::default();
        let now = Instant::now();
        let ticket = tickets.issue(&identity(7), now).expect("randomness");
        assert_eq!(tickets.redeem(&ticket, now).map(|who| who.session), Some(7));
        assert!(tickets.redeem(&ticket, now).is_none(), "used");
        let late = tickets.issue(&identity(7), now).expect("randomness");
        assert!(tickets.redeem(&late, now + LIFETIME).is_none(), "too old");
        let foreign = Secret::generate().expect("randomness");
        assert!(tickets.redeem(&foreign, now).is_none());
    }

    #[test]
    fn what_other_servers_are_told_says_whose_it_is() {
        let told = SharedTicket::of(&identity(7));
        assert_eq!(SharedTicket::read(&told), Some((7, Role::Viewer)));
        for other in ["", "7", "7 king", "x viewer"] {
            assert_eq!(SharedTicket::read(other), None, "{other}");
        }
    }

    #[test]
    fn tickets_do_not_pile_up() {
        let mut tickets = Tickets::default();
        let now = Instant::now();
        let other = tickets.issue(&identity(1), now).expect("randomness");
        for _ in 0..100 {
            tickets.issue(&identity(2), now).expect("randomness");
        }
        assert_eq!(tickets.0.len(), 1 + MOST_EACH);
        assert!(
            tickets.redeem(&other, now).is_some(),
            "nobody crowds others out"
        );
        for session in 0..2_000 {
            tickets.issue(&identity(session), now).expect("randomness");
        }
        assert_eq!(tickets.0.len(), MOST);
    }
}

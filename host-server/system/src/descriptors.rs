//! File descriptors, shared out among those that take them, so that no crowd at one listener leaves
//! the others without.

use rlimit::Resource;

/// For files, databases, engines and whatever else the process opens.
const FILES: u64 = 128;
/// A connection through the broker's listener takes one, and two more from there to the broker, which keeps
/// one of them for as long as it keeps the session, also when its client is away.
const OF_CLIENT: u64 = 3;
/// A robot in this process has both ends of its connection here.
const OF_ROBOT: u64 = 2;
/// Sessions that the server has with its broker.
const OWN_SESSIONS: usize = 16;
/// What is assumed where the system does not say: the usual limit of a process.
const USUAL: u64 = 1_024;

/// How many connections of each kind there may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Descriptors {
    /// Connections over HTTP, without those that have become a WebSocket.
    pub http: usize,
    /// Readers of the live feed.
    pub readers: usize,
    /// Connections to the broker whose client it has not let in yet.
    pub waiting: usize,
    /// Connections to the broker.
    pub clients: usize,
    /// Sessions with the broker, also of this process and of clients that are away.
    pub sessions: usize,
}

impl Descriptors {
    /// The most there is use for.
    pub const MOST: Self = Self {
        http: 1_024,
        readers: 64,
        waiting: 2_048,
        clients: 25_000,
        sessions: 25_000,
    };

    /// What this process may have, with so many simulated robots in it.
    pub fn of_process(robots: u32) -> Self {
        let limit = Resource::NOFILE.get().map_or(USUAL, |(soft, _)| soft);
        Self::shared_out(limit, robots)
    }

    /// Shares out `limit`. There is a little of each, however low that is.
    pub fn shared_out(limit: u64, robots: u32) -> Self {
        let part = |of: u64, most: usize| of.clamp(16, most as u64);
        let http = part(limit / 8, Self::MOST.http);
        let readers = part(limit / 16, Self::MOST.readers);
        let waiting = part(limit / 16, Self::MOST.waiting);
        let taken = FILES + OF_ROBOT * u64::from(robots) + http + readers + waiting;
        let clients = part(limit.saturating_sub(taken) / OF_CLIENT, Self::MOST.clients);
        Self {
            http: http as usize,
            readers: readers as usize,
            waiting: waiting as usize,
            clients: clients as usize,
            sessions: (clients as usize + robots as usize + OWN_SESSIONS).min(Self::MOST.sessions),
        }
    }
}

/// Whether something failed because the process, or the machine, has no descriptor left.
pub fn are_used_up(error: &std::io::Error) -> bool {
    use rustix::io::Errno;
    let error = Errno::from_io_error(error);
    error.is_some_and(|error| [Errno::MFILE, Errno::NFILE].contains(&error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_tell_whether_descriptors_are_used_up() {
        let error = |error: rustix::io::Errno| std::io::Error::from(error);
        assert!(are_used_up(&error(rustix::io::Errno::MFILE)));
        assert!(are_used_up(&error(rustix::io::Errno::NFILE)));
        assert!(!are_used_up(&error(rustix::io::Errno::CONNABORTED)));
    }

    #[test]
    fn what_is_shared_out_is_there() {
        for limit in (512..100_000).step_by(97).chain([1_048_576, u64::MAX]) {
            for robots in [0, 50, 10_000] {
                let shares = Descriptors::shared_out(limit, robots);
                let own = FILES + OF_ROBOT * u64::from(robots);
                let taken = own
                    + (shares.http + shares.readers + shares.waiting) as u64
                    + OF_CLIENT * shares.clients as u64;
                // Too few for so many robots: they are what fails, not the start.
                assert!(
                    taken <= limit || shares.clients == 16,
                    "{limit}: {shares:?}"
                );
                assert!(shares.http >= 16 && shares.waiting >= 16, "{limit}");
            }
        }
        assert_eq!(Descriptors::shared_out(1_048_576, 50), Descriptors::MOST);
    }
}

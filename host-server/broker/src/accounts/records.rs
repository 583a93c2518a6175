//! Accounts as the records have them.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::Instant;

use async_trait::async_trait;
use crawler_access::{Secret, UserName, password};
use crawler_protocol::RobotId;
use crawler_records::{Records, RecordsError};
use tokio::sync::Semaphore;

use super::{Accounts, LEARNER, Login, Refusal, SIMULATOR, Who};
use crawler_passwords::{Busy, Failures, Hashing};
use crawler_records::audit_log::{Entry, Notes};

/// Passwords that may wait to be checked. The rest is sent away at once: whoever waits holds one of the
/// broker's places for handshakes, and robots need those.
const QUEUE: usize = 16;

/// Robots, simulators and learners by the digests of their secrets, people by their passwords.
pub struct RecordAccounts {
    records: Records,
    failures: Arc<Failures>,
    hashing: Hashing,
    queue: Semaphore,
    notes: Notes,
}

impl RecordAccounts {
    /// Robots and people of `records`; wrong passwords count among `failures`, and logins are noted.
    pub fn new(records: Records, failures: Arc<Failures>, hashing: Hashing, notes: Notes) -> Self {
        Self {
            records,
            failures,
            hashing,
            queue: Semaphore::new(QUEUE),
            notes,
        }
    }

    /// A robot, simulator or learner with this secret. Nothing limits wrong ones: nobody guesses 256
    /// bits, and a limit would let a neighbour lock a robot out.
    async fn machine(&self, name: &str, given: &str) -> Result<Option<Who>, Refusal> {
        let named = if name.starts_with(SIMULATOR) {
            Some(Who::Simulator)
        } else if let Some(node) = name.strip_prefix(LEARNER) {
            RobotId::new(node).ok().map(Who::Learner)
        } else {
            RobotId::new(name).ok().map(Who::Robot)
        };
        let Some(named) = named else {
            return Ok(None);
        };
        let Ok(secret) = given.parse::<Secret>() else {
            return Ok(None);
        };
        let known = self
            .records
            .credentials()
            .get(name)
            .await
            .map_err(|error| unreadable(&error))?;
        let valid = known.is_some_and(|known| {
            // Both, whatever the first says: the time tells nothing.
            known.digest.matches(&secret) & known.revoked.is_none()
        });
        Ok(valid.then_some(named))
    }

    /// A person with this password.
    async fn person(&self, name: UserName, given: &str, from: IpAddr) -> Result<Who, Refusal> {
        let now = Instant::now();
        self.failures
            .check(from, now)
            .map_err(|_| Refusal::Attempts)?;
        let _place = self.queue.try_acquire().map_err(|_| Refusal::Busy)?;
        self.failures
            .begin(Some(&name), from, now)
            .map_err(|_| Refusal::Attempts)?;
        let result = self.check(&name, given).await;
        match &result {
            Ok(_) => self.failures.succeeded(Some(&name), from),
            Err(Refusal::Credentials) => self.failures.failed(from, Instant::now()),
            // Not the fault of whoever came.
            Err(_) => {}
        }
        self.note(&name, from, &result);
        result
    }

    async fn check(&self, name: &UserName, given: &str) -> Result<Who, Refusal> {
        let user = self
            .records
            .users()
            .get(name)
            .await
            .map_err(|error| unreadable(&error))?;
        let known = user.filter(|user| !user.disabled);
        let hash = known.as_ref().and_then(|user| user.password.clone());
        let given = given.to_owned();
        let checking = self.hashing.run(move |memory| {
            if let Some(hash) = hash {
                return memory.verify(&given, &hash);
            }
            memory.verify_nobody(&given);
            false
        });
        let verified = checking.await.map_err(|Busy| Refusal::Busy)?;
        match known {
            Some(user) if verified => Ok(Who::User(user.role)),
            _ => Err(Refusal::Credentials),
        }
    }

    /// Notes a person's login in the audit log, as the API does. A log that cannot be written does not
    /// keep anybody out: robots do not wait for it either.
    fn note(&self, name: &UserName, from: IpAddr, result: &Result<Who, Refusal>) {
        self.notes.note(Entry {
            who: name.to_string(),
            from: from.to_string(),
            action: "login",
            target: "broker".into(),
            detail: serde_json::Value::Null,
            outcome: match result {
                Ok(_) => "ok".into(),
                Err(reason) => reason.name().into(),
            },
        });
    }
}

fn unreadable(error: &RecordsError) -> Refusal {
    tracing::error!(%error, "the accounts cannot be read");
    Refusal::Records
}

#[async_trait]
impl Accounts for RecordAccounts {
    async fn identify(&self, login: Login<'_>) -> Result<Who, Refusal> {
        let (Some(name), Some(given)) = (login.user, login.password) else {
            return Err(Refusal::Nameless);
        };
        let given = std::str::from_utf8(given).map_err(|_| Refusal::Credentials)?;
        if let Some(machine) = self.machine(name, given).await? {
            return Ok(machine);
        }
        // No password is longer, and hashing one takes longer the longer it is.
        let name = name.parse::<UserName>().map_err(|_| Refusal::Credentials)?;
        if given.chars().count() > password::MAX {
            return Err(Refusal::Credentials);
        }
        // A robot with an old secret comes again for ever. It is not worth a password's work.
        let is_robot = self.has_credential(name.as_str()).await?;
        if is_robot
            && self
                .records
                .users()
                .get(&name)
                .await
                .map_err(|error| unreadable(&error))?
                .is_none()
        {
            return Err(Refusal::Credentials);
        }
        self.person(name, given, login.from).await
    }

    async fn has_credential(&self, id: &str) -> Result<bool, Refusal> {
        let known = self
            .records
            .credentials()
            .get(id)
            .await
            .map_err(|error| unreadable(&error))?;
        Ok(known.is_some())
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crawler_metrics::Metrics;
    use crawler_records::audit_log::AuditLog;

    fn login<'a>(user: &'a str, password: &'a str) -> Login<'a> {
        Login {
            user: Some(user),
            password: Some(password.as_bytes()),
            from: IpAddr::from([127, 0, 0, 1]),
        }
    }

    /// All places at which passwords are checked are taken, and nobody makes room.
    #[tokio::test]
    async fn a_robot_waits_for_no_password_of_anybody() {
        let records = Records::in_memory().await.expect("records");
        let secret = Secret::generate().expect("randomness");
        let enrolled = records
            .credentials()
            .enroll("rover-1", secret.digest(), 1, "test")
            .await;
        enrolled.expect("enrolled");
        let (audit, _writer) = AuditLog::new(records.clone(), Arc::new(Metrics::new()));
        let accounts = RecordAccounts::new(
            records,
            Arc::new(Failures::default()),
            Hashing::new(Duration::from_mins(1)),
            audit.notes(),
        );
        let checked = accounts.hashing.occupy().await;
        let waiting = accounts.queue.acquire_many(QUEUE as u32).await;
        let stranger = accounts.identify(login("ada", "correct horse")).await;
        assert_eq!(stranger, Err(Refusal::Busy));
        let secret = secret.to_string();
        let robot = accounts.identify(login("rover-1", &secret)).await;
        let id = RobotId::new("rover-1").expect("an id");
        assert_eq!(robot, Ok(Who::Robot(id)));
        // Nor does one with an old secret take a place.
        let old = accounts.identify(login("rover-1", "correct horse")).await;
        assert_eq!(old, Err(Refusal::Credentials));
        drop((checked, waiting));
    }
}

//! Who may log in to the embedded broker, and as what.

mod records;

use std::net::IpAddr;

use async_trait::async_trait;
use crawler_access::Role;
use crawler_access::topics::Principal;
use crawler_protocol::RobotId;

pub use records::RecordAccounts;

/// First part of the user names of simulators, and of the client ids of what is no robot in them.
pub(crate) const SIMULATOR: &str = "simulator-";
/// First part of the user names of learners, and of their client ids, which are the same.
pub(crate) const LEARNER: &str = "learner-";
/// First part of the ids of simulated robots.
const SIMULATED: &str = "sim-";
/// First part of the client ids of their cameras.
const TRACKER: &str = "tracker-";
/// First part of the client ids of servers.
const SERVER: &str = "server";

/// What a client says of itself when it connects.
#[derive(Clone, Copy)]
pub struct Login<'a> {
    /// Its user name.
    pub user: Option<&'a str>,
    /// Its password.
    pub password: Option<&'a [u8]>,
    /// The address that it counts under.
    pub from: IpAddr,
}

/// Who a client has proven to be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Who {
    /// Nobody in particular, on an open server.
    Anyone,
    /// A robot with a credential of its own.
    Robot(RobotId),
    /// A simulator, with one credential for all of its robots.
    Simulator,
    /// A machine of federated learning, by its name without `learner-`.
    Learner(RobotId),
    /// A person.
    User(Role),
}

/// What a session may do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Access {
    /// Everything: the server is open.
    Everything,
    /// What the table has for this principal.
    As(Principal),
}

/// Whose a name is. A person and a robot may have the same one: nothing that becomes of one is to reach
/// the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// An account's.
    Person,
    /// A robot's, a simulator's or a learner's.
    Machine,
}

impl Access {
    /// Whose name a session with it has. On an open server nobody has one.
    pub(crate) const fn kind(&self) -> Option<Kind> {
        match self {
            Self::Everything => None,
            Self::As(Principal::User(_)) => Some(Kind::Person),
            Self::As(_) => Some(Kind::Machine),
        }
    }
}

/// Why a client is not let in, or not heard. The names are those of the metric's label.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// It gave no name or no password.
    Nameless,
    /// There is no such name, or that is not its password.
    Credentials,
    /// Too many wrong passwords from there lately.
    Attempts,
    /// More passwords are being checked than this machine can.
    Busy,
    /// That client id is another's.
    ClientId,
    /// It was cut off for flooding and has to stay away for a while.
    CutOff,
    /// Its will is nothing that it may publish.
    Will,
    /// It may not publish there.
    Publish,
    /// It may not subscribe to that.
    Subscribe,
    /// The records cannot be read.
    Records,
    /// It did not say in time who it is.
    Silent,
    /// It had to make room for others before it had said who it is.
    Crowded,
    /// There are as many clients as there can be.
    Full,
    /// It has failed to agree on TLS.
    Tls,
    /// What it sent first is no CONNECT, or one that is too large.
    Malformed,
    /// It speaks another version of MQTT.
    Version,
    /// It has used a topic alias, which nobody announced.
    TopicAlias,
}

impl Refusal {
    /// Every reason.
    pub const ALL: [Self; 17] = [
        Self::Nameless,
        Self::Credentials,
        Self::Attempts,
        Self::Busy,
        Self::ClientId,
        Self::CutOff,
        Self::Will,
        Self::Publish,
        Self::Subscribe,
        Self::Records,
        Self::Silent,
        Self::Crowded,
        Self::Full,
        Self::Tls,
        Self::Malformed,
        Self::Version,
        Self::TopicAlias,
    ];

    /// As metrics and logs name it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Nameless => "nameless",
            Self::Credentials => "credentials",
            Self::Attempts => "attempts",
            Self::Busy => "busy",
            Self::ClientId => "client_id",
            Self::CutOff => "cut_off",
            Self::Will => "will",
            Self::Publish => "publish",
            Self::Subscribe => "subscribe",
            Self::Records => "records",
            Self::Silent => "silent",
            Self::Crowded => "crowded",
            Self::Full => "full",
            Self::Tls => "tls",
            Self::Malformed => "malformed",
            Self::Version => "version",
            Self::TopicAlias => "topic_alias",
        }
    }
}

/// Knows names and passwords.
#[async_trait]
pub trait Accounts: Send + Sync + 'static {
    /// Who this is.
    ///
    /// # Errors
    /// Why it is nobody.
    async fn identify(&self, login: Login<'_>) -> Result<Who, Refusal>;

    /// Whether a robot has a credential under this id, or had one that was revoked. Nobody else
    /// goes by such an id then.
    ///
    /// # Errors
    /// [`Refusal::Records`].
    async fn has_credential(&self, id: &str) -> Result<bool, Refusal>;
}

/// No accounts: whoever reaches the port may connect without a name, and a name is refused because
/// none exists.
pub struct Open;

#[async_trait]
impl Accounts for Open {
    async fn identify(&self, login: Login<'_>) -> Result<Who, Refusal> {
        match (login.user, login.password) {
            (None, None) => Ok(Who::Anyone),
            _ => Err(Refusal::Credentials),
        }
    }

    async fn has_credential(&self, _: &str) -> Result<bool, Refusal> {
        Ok(false)
    }
}

/// What `who` may do under a client id.
///
/// A robot goes by its own name only, and so does a learner, with `learner-` before it. The robots of a
/// simulator go by names that begin with `sim-` and belong to no other robot; the rest of a simulator by
/// names that begin with `simulator-` or `tracker-`. A person takes any name that none of those can have.
///
/// # Errors
/// [`Refusal::ClientId`] when the id is not for `who`, and [`Refusal::Records`].
pub(crate) async fn admit(
    accounts: &dyn Accounts,
    who: Who,
    client_id: &str,
) -> Result<Access, Refusal> {
    let begins = |prefixes: &[&str]| prefixes.iter().any(|first| client_id.starts_with(first));
    match who {
        Who::Anyone => Ok(Access::Everything),
        Who::Robot(id) if id.as_str() == client_id => Ok(Access::As(Principal::Robot(id))),
        Who::Learner(name) if client_id.strip_prefix(LEARNER) == Some(name.as_str()) => {
            Ok(Access::As(Principal::Learner(name)))
        }
        Who::Simulator | Who::User(_) if accounts.has_credential(client_id).await? => {
            Err(Refusal::ClientId)
        }
        Who::Simulator if begins(&[SIMULATOR, TRACKER]) => Ok(Access::As(Principal::Simulator)),
        Who::Simulator if begins(&[SIMULATED]) => {
            let robot = RobotId::new(client_id).map_err(|_| Refusal::ClientId)?;
            Ok(Access::As(Principal::Robot(robot)))
        }
        Who::User(role) if !begins(&[SIMULATED, SIMULATOR, LEARNER, TRACKER, SERVER]) => {
            Ok(Access::As(Principal::User(role)))
        }
        Who::Robot(_) | Who::Simulator | Who::Learner(_) | Who::User(_) => Err(Refusal::ClientId),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Some ids have credentials.
    struct Two;

    #[async_trait]
    impl Accounts for Two {
        async fn identify(&self, _: Login<'_>) -> Result<Who, Refusal> {
            Err(Refusal::Credentials)
        }

        async fn has_credential(&self, id: &str) -> Result<bool, Refusal> {
            Ok(["wheely", "sim-0007", "tracker-1"].contains(&id))
        }
    }

    fn robot(id: &str) -> RobotId {
        RobotId::new(id).expect("a robot id")
    }

    #[tokio::test]
    async fn everyone_has_client_ids_of_their_own() {
        let viewer = Who::User(Role::Viewer);
        let wheely = Who::Robot(robot("wheely"));
        // A learner may be called like a robot.
        let learner = Who::Learner(robot("wheely"));
        for (who, client_id, expected) in [
            (&wheely, "wheely", Some(Principal::Robot(robot("wheely")))),
            (&wheely, "wheely-2", None),
            (&wheely, "sim-0001", None),
            (&wheely, "", None),
            (
                &Who::Simulator,
                "sim-0001",
                Some(Principal::Robot(robot("sim-0001"))),
            ),
            (&Who::Simulator, "simulator-7f", Some(Principal::Simulator)),
            (&Who::Simulator, "tracker-swarm", Some(Principal::Simulator)),
            (&Who::Simulator, "tracker-1", None),
            (&Who::Simulator, "sim-0007", None),
            (&Who::Simulator, "sim-A", None),
            (&Who::Simulator, "wheely", None),
            (&Who::Simulator, "other", None),
            (&Who::Simulator, "server-1", None),
            (&Who::Simulator, "learner-wheely", None),
            (&wheely, "learner-wheely", None),
            (
                &learner,
                "learner-wheely",
                Some(Principal::Learner(robot("wheely"))),
            ),
            (&learner, "learner-wheely-2", None),
            (&learner, "learner-", None),
            (&learner, "wheely", None),
            (&learner, "sim-0001", None),
            (&learner, "simulator-wheely", None),
            (&learner, "tracker-swarm", None),
            (&learner, "server-1", None),
            (&learner, "", None),
            (&viewer, "laptop", Some(Principal::User(Role::Viewer))),
            (&viewer, "wheely", None),
            (&viewer, "sim-0001", None),
            (&viewer, "simulator-7f", None),
            (&viewer, "tracker-swarm", None),
            (&viewer, "learner-wheely", None),
            (&viewer, "learner-", None),
            (&viewer, "server-7f", None),
        ] {
            let access = admit(&Two, who.clone(), client_id).await;
            let expected = expected.map(Access::As).ok_or(Refusal::ClientId);
            assert_eq!(access, expected, "{who:?} as {client_id}");
        }
    }

    #[tokio::test]
    async fn an_open_server_takes_everyone_without_a_name() {
        let from = IpAddr::from([127, 0, 0, 1]);
        for (user, password, expected) in [
            (None, None, Ok(Who::Anyone)),
            (Some("a"), None, Err(Refusal::Credentials)),
            (None, Some(&b"x"[..]), Err(Refusal::Credentials)),
            (Some("a"), Some(&b"x"[..]), Err(Refusal::Credentials)),
        ] {
            let login = Login {
                user,
                password,
                from,
            };
            assert_eq!(Open.identify(login).await, expected);
        }
        let access = admit(&Open, Who::Anyone, "sim-0001").await;
        assert_eq!(access, Ok(Access::Everything));
    }

    #[test]
    fn every_refusal_has_a_name_and_a_place() {
        for (place, refusal) in Refusal::ALL.into_iter().enumerate() {
            assert_eq!(refusal as usize, place);
            assert!(!refusal.name().is_empty());
        }
    }
}

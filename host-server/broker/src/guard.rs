//! Who may connect to the embedded broker, and what each may publish and subscribe.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use async_trait::async_trait;
use crawler_access::topics::Act;
use crawler_access::{Digest, LearnTopic, Secret};
use crawler_protocol::{Action, Command, Fleet, MAX_MESSAGE, MAX_OTA, Topic};
use rmqtt::codec::v5::{PublishAckReason, SubscribeAckReason};
use rmqtt::context::ServerContext;
use rmqtt::hook::{Handler, HookResult, Parameter, ReturnType};
use rmqtt::types::{
    AuthResult, ClientId, ConnectInfo, Id, LastWill, Publish, PublishAclResult, PublishResult,
    Subscribe, SubscribeAclResult,
};

use super::accounts::{Access, Accounts, Login, Refusal, Who, admit};
use super::clients::{Clients, Key, Made, Spent};
use super::{Credentials, GuardCounters};
use crawler_records::audit_log::Entry;
use crawler_system::text::Shown;

/// How long a session that has to end may be in the middle of a handshake.
const PATIENCE: Duration = Duration::from_secs(10);
const TRY_EVERY: Duration = Duration::from_millis(20);

/// Name and secret made up at this start.
struct ServerLogin {
    user: String,
    digest: Digest,
}

impl ServerLogin {
    fn new(credentials: &Credentials) -> Self {
        Self {
            user: credentials.user.clone(),
            digest: credentials.password.digest(),
        }
    }

    fn is(&self, login: Login<'_>) -> bool {
        let secret = login
            .password
            .and_then(|password| std::str::from_utf8(password).ok())
            .and_then(|password| password.parse::<Secret>().ok());
        login.user == Some(&self.user) && secret.is_some_and(|secret| self.digest.matches(&secret))
    }
}

/// The broker's hook.
///
/// Everyone but the server's own sessions is let in by [`Accounts`] and held to the table of
/// `crawler-access`; what the table does not have is refused.
#[derive(Clone)]
pub(crate) struct Guard {
    shared: Arc<Shared>,
}

struct Shared {
    fleet: Fleet,
    server: ServerLogin,
    simulator: ServerLogin,
    accounts: Arc<dyn Accounts>,
    clients: Arc<Clients>,
    counters: Arc<GuardCounters>,
    context: ServerContext,
}

impl Guard {
    pub(crate) fn new(
        fleet: Fleet,
        [server, simulator]: [&Credentials; 2],
        accounts: Arc<dyn Accounts>,
        clients: Arc<Clients>,
        counters: Arc<GuardCounters>,
        context: ServerContext,
    ) -> Self {
        Self {
            shared: Arc::new(Shared {
                fleet,
                server: ServerLogin::new(server),
                simulator: ServerLogin::new(simulator),
                accounts,
                clients,
                counters,
                context,
            }),
        }
    }
}

impl Shared {
    async fn authenticate(&self, info: &ConnectInfo) -> AuthResult {
        let reason = match self.let_in(info).await {
            Ok(superuser) => return AuthResult::Allow(superuser, None),
            Err(reason) => reason,
        };
        if self.counters.refuse_connection(reason, Instant::now()) {
            let id = info.id();
            tracing::warn!(
                reason = reason.name(),
                user = %Shown(id.username_ref()),
                client = %Shown(&id.client_id),
                from = ?id.remote_addr.map(|seen| self.clients.peers().origin(seen)),
                "refused a client of the broker"
            );
        }
        match reason {
            Refusal::Credentials => AuthResult::BadUsernameOrPassword,
            _ => AuthResult::NotAuthorized,
        }
    }

    /// Decides about a connection. True for those of the server itself.
    async fn let_in(&self, info: &ConnectInfo) -> Result<bool, Refusal> {
        let begun = Instant::now();
        let id = info.id();
        let key = key(id);
        let from = info
            .ipaddress()
            .map_or(IpAddr::V4(Ipv4Addr::UNSPECIFIED), |address| {
                self.clients.peers().origin(address).ip()
            });
        let login = Login {
            user: info.username().map(AsRef::as_ref),
            password: info.password().map(AsRef::as_ref),
            from,
        };
        if self.server.is(login) {
            let rest = key.client.strip_prefix(&self.server.user);
            let own = rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('-'));
            return own.then_some(true).ok_or(Refusal::ClientId);
        }
        if self.clients.is_locked(key.client, begun) {
            return Err(Refusal::CutOff);
        }
        let who = if self.simulator.is(login) {
            Who::Simulator
        } else {
            self.accounts.identify(login).await?
        };
        let is_robot = matches!(who, Who::Robot(_));
        let access = admit(self.accounts.as_ref(), who, key.client).await?;
        if let Some(will) = info.last_will() {
            self.check_will(&access, &will)?;
        }
        if access != Access::Everything {
            self.keep_apart(id, &access, is_robot).await?;
        }
        if self.clients.is_full() {
            let broker = self.context.extends.shared().await;
            self.clients.prune(|client| broker.exist(client));
        }
        self.clients
            .enter(key, login.user, access, begun, Instant::now())?;
        Ok(false)
    }

    /// A will is published in its client's name when the session ends, so all that holds for
    /// publishing holds for it.
    fn check_will(&self, access: &Access, will: &LastWill<'_>) -> Result<(), Refusal> {
        let (topic, length) = match will {
            LastWill::V3(will) => (&will.topic, will.message.len()),
            LastWill::V5(will) => (&will.topic, will.message.len()),
        };
        let allowed = self.clients.may(access, Act::Publish, topic)
            && self.check(topic, length, will.retain()).is_ok();
        allowed.then_some(()).ok_or(Refusal::Will)
    }

    /// No session takes over what belongs to another name, or to a person of the same name: its
    /// subscriptions and what waits for it. A robot has a right to its id, so whoever goes by it has to
    /// leave.
    async fn keep_apart(&self, id: &Id, access: &Access, is_robot: bool) -> Result<(), Refusal> {
        let holder = {
            let broker = self.context.extends.shared().await;
            broker.entry(id.clone()).session()
        };
        let is_own = self.clients.kind(&id.client_id) == access.kind();
        if holder.is_none_or(|holder| is_own && holder.id.username == id.username) {
            return Ok(());
        }
        if !is_robot {
            return Err(Refusal::ClientId);
        }
        end_session(&self.context, &id.client_id).await;
        Ok(())
    }

    /// Decides about a publish.
    async fn publish(&self, id: &Id, publish: &Publish) -> PublishAclResult {
        let key = key(id);
        let now = Instant::now();
        // A halt does not wait for what its sender has sent before.
        if !(self.is_halt(publish) && self.clients.halted(key.client, now)) {
            let length = publish.payload.len();
            let spent = self.clients.published(key.client, length, now);
            if !self.pay(spent, id).await {
                let text = "too many messages for too long";
                return refuse(PublishAckReason::QuotaExceeded, text);
            }
        }
        let allowed = self
            .clients
            .access(key)
            .is_some_and(|access| self.clients.may(&access, Act::Publish, &publish.topic));
        if !allowed {
            self.counters.refuse(Refusal::Publish);
            tracing::debug!(
                client = %Shown(key.client), topic = %Shown(&publish.topic), "refused a publish"
            );
            let text = "not a topic of yours to publish on";
            return refuse(PublishAckReason::NotAuthorized, text);
        }
        match self.check(&publish.topic, publish.payload.len(), publish.retain) {
            Ok(()) => PublishAclResult::allow(),
            Err(text) => refuse(PublishAckReason::QuotaExceeded, text),
        }
    }

    /// Decides about a subscription.
    async fn subscribe(&self, id: &Id, subscribe: &Subscribe) -> SubscribeAclResult {
        let key = key(id);
        let filter = &subscribe.topic_filter;
        let spent = self.clients.subscribed(key.client, filter, Instant::now());
        if !self.pay(spent, id).await {
            return SubscribeAclResult::new_failure(SubscribeAckReason::QuotaExceeded);
        }
        let allowed = match self.clients.access(key) {
            None => false,
            Some(Access::Everything) => true,
            // A shared subscription takes messages away from others.
            Some(access) => {
                subscribe.opts.shared_group().is_none()
                    && self.clients.may(&access, Act::Subscribe, filter)
            }
        };
        if allowed {
            return SubscribeAclResult::new_success(subscribe.opts.qos(), None);
        }
        self.counters.refuse(Refusal::Subscribe);
        tracing::debug!(
            client = %Shown(key.client), filter = %Shown(filter), "refused a subscription"
        );
        SubscribeAclResult::new_failure(SubscribeAckReason::NotAuthorized)
    }

    /// Has a client wait for what it spent. False when it is cut off.
    async fn pay(&self, spent: Spent, id: &Id) -> bool {
        match spent {
            Spent::Pass => true,
            Spent::Wait(wait) => {
                // The session reads nothing while it waits, so its TCP window fills up and the
                // flood stays with its sender.
                self.counters.delayed.fetch_add(1, Ordering::Relaxed);
                tokio::time::sleep(wait).await;
                true
            }
            Spent::CutOff => {
                self.counters.cut_off.fetch_add(1, Ordering::Relaxed);
                let from = id.remote_addr.map(|seen| self.clients.peers().origin(seen));
                tracing::warn!(
                    client = %Shown(&id.client_id),
                    user = %Shown(id.username_ref()),
                    ?from,
                    "cut off a client that sends too much for too long"
                );
                // At most once a minute for each: it has to stay away for so long.
                if let Some(notes) = self.counters.notes.get() {
                    notes.note(Entry {
                        who: id.username_ref().to_owned(),
                        from: from.map_or_else(String::new, |from| from.ip().to_string()),
                        action: "broker.cut_off",
                        target: id.client_id.to_string(),
                        detail: serde_json::Value::Null,
                        outcome: "ok".to_owned(),
                    });
                }
                // From a task: the session ends when this call has returned.
                let (context, client) = (self.context.clone(), id.client_id.clone());
                tokio::spawn(async move { end_session(&context, &client).await });
                false
            }
            Spent::Locked => false,
        }
    }

    /// Whether this tells robots to stop.
    fn is_halt(&self, publish: &Publish) -> bool {
        let topic = Topic::parse(&self.fleet, &publish.topic);
        let commands = matches!(topic, Ok(Topic::CommandSwarm | Topic::CommandRobot(_)));
        let command = commands.then(|| Command::parse(&publish.payload));
        command.is_some_and(|command| {
            command.is_ok_and(|command| matches!(command.action, Action::Stop | Action::Estop))
        })
    }

    /// Nothing but images may be longer than a message of the contract, or than a chunk of a release where
    /// those go: a robot that announced its largest packet would lose its session over one. No robot reads
    /// messages of federated learning. The server's own sessions are not checked, so its rounds are retained.
    fn check(&self, topic: &str, length: usize, retain: bool) -> Result<(), &'static str> {
        let learn = LearnTopic::parse(&self.fleet, topic);
        let topic = Topic::parse(&self.fleet, topic);
        let (most, text) = match (&topic, learn) {
            (Ok(Topic::Image(_)), _) => (usize::MAX, ""),
            (Ok(Topic::Ota(_)), _) => (MAX_OTA, "larger than 1100 bytes"),
            (_, Some(learn)) => (learn.max_payload(), "larger than a message of learning"),
            _ => (MAX_MESSAGE, "larger than 1024 bytes"),
        };
        if length > most {
            self.counters.oversize.fetch_add(1, Ordering::Relaxed);
            return Err(text);
        }
        if retain && !topic.is_ok_and(|topic| topic.retained()) {
            self.counters.retain_refused.fetch_add(1, Ordering::Relaxed);
            return Err("only status and parameters of a robot are retained");
        }
        Ok(())
    }
}

fn refuse(reason: PublishAckReason, text: &'static str) -> PublishAclResult {
    PublishAclResult(PublishResult::reason_code(reason, Some(text.into()), false))
}

fn key(id: &Id) -> Key<'_> {
    Key {
        client: id.client_id.as_ref(),
        made: Made {
            at: id.create_time,
            over: id.remote_addr,
        },
    }
}

/// The clients that have a session under a name, connected or not.
pub(crate) async fn sessions_of(context: &ServerContext, name: &str) -> Vec<String> {
    let broker = context.extends.shared().await;
    let named = |id: &Id| id.username.as_ref().is_some_and(|known| known == name);
    broker
        .iter()
        .filter_map(|entry| entry.session())
        .filter(|session| named(&session.id))
        .map(|session| session.id.client_id.to_string())
        .collect()
}

/// Ends a client's session and forgets its subscriptions and what waits for it.
pub(crate) async fn end_session(context: &ServerContext, client: &str) {
    let id = Id::from(context.node.id(), ClientId::from(client));
    let end = Instant::now() + PATIENCE;
    loop {
        let entry = {
            let broker = context.extends.shared().await;
            broker.entry(id.clone())
        };
        // A handshake of this client is under way as long as the lock is taken.
        match entry.try_lock().await {
            Ok(mut entry) => {
                if let Err(error) = entry.kick(true, true, true).await {
                    tracing::warn!(client = %Shown(client), %error, "a session does not end");
                }
                return;
            }
            Err(_) if Instant::now() < end => tokio::time::sleep(TRY_EVERY).await,
            Err(_) => {
                tracing::error!(client = %Shown(client), "a session cannot be ended");
                return;
            }
        }
    }
}

// The trait leaves this lifetime out, and async-trait wants the implementation to do the same.
#[allow(elided_lifetimes_in_paths)]
#[async_trait]
impl Handler for Guard {
    async fn hook(&self, parameter: &Parameter, previous: Option<HookResult>) -> ReturnType {
        let guard = &self.shared;
        match parameter {
            Parameter::ClientAuthenticate(info) => {
                let result = guard.authenticate(info).await;
                (false, Some(HookResult::AuthResult(result)))
            }
            Parameter::ClientConnected(session) => {
                let own = session.superuser().await.unwrap_or_default();
                if !own && !guard.clients.may_stay(key(&session.id)) {
                    let (context, client) = (guard.context.clone(), session.id.client_id.clone());
                    tokio::spawn(async move { end_session(&context, &client).await });
                }
                (true, previous)
            }
            Parameter::MessagePublishCheckAcl(session, publish) => {
                let result = guard.publish(&session.id, publish).await;
                (false, Some(HookResult::PublishAclResult(result)))
            }
            Parameter::ClientSubscribeCheckAcl(session, subscribe) => {
                let result = guard.subscribe(&session.id, subscribe).await;
                (false, Some(HookResult::SubscribeAclResult(result)))
            }
            Parameter::ClientDisconnected(session, _) => {
                guard.clients.leave(key(&session.id));
                (true, previous)
            }
            _ => (true, previous),
        }
    }
}

//! Carries rollouts out: the one task that changes them, and stores what comes of it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crawler_protocol::{ReleaseId, RobotId, Topic, UpdateCommand};
use crawler_records::{EventLevel, NewRollout, RecordsError, RolloutStep, Written};
use crawler_updates::rollout::{
    Command, CommandError, Effect, Event, Message, Owner, Plan, Rollout, RolloutId, RolloutState,
    Step,
};
use rumqttc::v5::MqttOptions;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::PublishProperties;
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

use crate::active::Active;
use crate::control::{Action, Request, RolloutError};
use crate::image::Blob;
use crate::lease::{BEAT_MS, Watched};
use crate::link::{self, Heard};
use crate::making::Maker;
use crate::patches::{Offer, Pair};
use crate::plan::NewPlan;
use crate::robots::Known;
use crate::view::damaged;
use crate::{Rollouts, gate, sender, step};

/// How often to look at robots and at what is due.
const LOOK: Duration = Duration::from_millis(250);
/// Before something is stored that the records did not take.
const AGAIN: Duration = Duration::from_secs(1);
/// Messages of robots that wait, and of those that become one step.
const HEARD: usize = 8_192;
const AT_ONCE: usize = 512;
/// For a message to be handed to the connection.
const SEND: Duration = Duration::from_secs(1);
/// What a broker could not hand on for so long is sent again, in seconds.
const EXPIRY: u32 = 15;
/// How often something is tried that another server came before with.
const TRIES: usize = 3;
/// How long robots that are to give up are waited for when a rollout is over.
const CANCEL_TIMEOUT: Duration = Duration::from_mins(10);

/// What carries rollouts out.
pub struct Runner {
    rollouts: Arc<Rollouts>,
    session: MqttOptions,
    requests: mpsc::Receiver<Request>,
    known: Known,
    watched: Watched,
    beat_ms: Option<u64>,
    maker: Maker,
    /// Rollouts that cannot be read or written, which was said. They are carried out here again once somebody asks for
    /// something to be done with them.
    damaged: BTreeSet<i64>,
    /// Rollouts that began here, whose robots earlier ones of other servers may have yet: the records could not tell.
    superseding: BTreeSet<i64>,
    stop: CancellationToken,
}

/// The records did not take a step.
enum NotStored {
    /// The rollout is another server's.
    Lost,
    Records(RecordsError),
}

impl Runner {
    pub(crate) fn new(
        rollouts: Arc<Rollouts>,
        session: MqttOptions,
        lease: Duration,
        requests: mpsc::Receiver<Request>,
    ) -> Self {
        Self {
            rollouts,
            session,
            requests,
            known: Known::default(),
            watched: Watched::new(lease),
            beat_ms: None,
            maker: Maker::default(),
            damaged: BTreeSet::new(),
            superseding: BTreeSet::new(),
            stop: CancellationToken::new(),
        }
    }

    /// Carries rollouts out until `stop`: those that begin here, those that were this server's when it was killed,
    /// and those of servers that are gone.
    pub async fn run(mut self, stop: CancellationToken) {
        self.stop = stop.clone();
        let (wanted, watch) = watch::channel(false);
        let (tell, mut heard) = mpsc::channel(HEARD);
        let link = link::keep(
            Arc::clone(&self.rollouts),
            self.session.clone(),
            watch,
            tell,
            stop.clone(),
        );
        let link = AbortOnDropHandle::new(tokio::spawn(link));
        let sender = sender::run(Arc::clone(&self.rollouts), stop.clone());
        let _sender = AbortOnDropHandle::new(tokio::spawn(sender));
        let mut look = tokio::time::interval(LOOK);
        look.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                () = stop.cancelled() => break,
                Some(request) = self.requests.recv() => self.serve(request).await,
                _ = look.tick() => self.look().await,
                Some((pair, patch)) = self.maker.next() => {
                    self.rollouts.patches().made(&pair, patch);
                    self.send_waiting().await;
                }
                Some(first) = heard.recv() => {
                    let mut all = vec![first];
                    while all.len() < AT_ONCE && let Ok(more) = heard.try_recv() {
                        all.push(more);
                    }
                    self.hear(all).await;
                }
            }
            let any = !self.rollouts.active().is_empty();
            wanted.send_if_modified(|wanted| std::mem::replace(wanted, any) != any);
        }
        self.requests.close();
        // Nobody takes what is heard any more, so nobody waits for that.
        drop(heard);
        if let Err(error) = link.await {
            tracing::warn!(%error, "the session over which robots are updated did not end in order");
        }
    }

    /// What is due by the clock.
    async fn look(&mut self) {
        let now = self.rollouts.now();
        let beat = self
            .beat_ms
            .is_none_or(|at| now.monotonic_ms >= at + BEAT_MS);
        if beat {
            self.beat_ms = Some(now.monotonic_ms);
            self.renew().await;
            self.take_over_what_is_left().await;
            self.pause_withdrawn().await;
            self.supersede_what_is_left().await;
        }
        {
            let active = self.rollouts.active();
            let mut patches = self.rollouts.patches();
            patches.keep(|release| active.program(release).is_some());
        }
        if self.rollouts.active().is_empty() {
            return;
        }
        if self.rollouts.patches().is_due(now.monotonic_ms) {
            self.send_waiting().await;
        }
        self.see().await;
        for id in self.ids() {
            self.apply(id, vec![Event::Tick]).await;
            let ended = |one: &Active| {
                let since = one.over_since;
                since.is_some_and(|at| !one.has_recalled() || at.elapsed() >= CANCEL_TIMEOUT)
            };
            let mut active = self.rollouts.active();
            if active.get(id).is_some_and(ended) {
                active.remove(id);
            }
        }
    }

    fn ids(&self) -> Vec<i64> {
        self.rollouts.active().ids()
    }

    /// Says that this server lives, and forgets what is another's by now.
    async fn renew(&self) {
        let own: Vec<(i64, u64)> = {
            let active = self.rollouts.active();
            active.all().map(|(id, one)| (id, one.epoch)).collect()
        };
        if own.is_empty() {
            return;
        }
        match self.rollouts.records.rollouts().renew(own).await {
            Ok(lost) => lost.into_iter().for_each(|id| self.lose(id)),
            Err(error) => {
                tracing::warn!(%error, "that this server carries out rollouts is not told");
            }
        }
    }

    /// Takes over rollouts that were this server's, or whose server is gone.
    async fn take_over_what_is_left(&mut self) {
        let leases = match self.rollouts.records.rollouts().leases().await {
            Ok(leases) => leases,
            Err(error) => {
                tracing::debug!(%error, "whose rollouts are whose cannot be read");
                self.watched.forget();
                return;
            }
        };
        let own = self.rollouts.server.clone();
        let now = self.rollouts.now();
        let here = self.ids();
        let has = |id| here.contains(&id);
        let left = self
            .watched
            .look(leases, has, own.as_str(), now.monotonic_ms);
        for lease in left {
            if self.damaged.contains(&lease.id) {
                continue;
            }
            match self.take_over(lease.id, lease.epoch).await {
                Ok(true) => tracing::info!(rollout = lease.id, "goes on here"),
                Ok(false) => {}
                Err(error) => self.give_up(lease.id, &error),
            }
        }
    }

    /// A rollout cannot be carried out here; unless that may pass, it is not tried again.
    fn give_up(&mut self, id: i64, error: &RolloutError) {
        tracing::error!(rollout = id, %error, "cannot be carried out");
        if !matches!(error, RolloutError::Records(error) if error.is_passing()) {
            self.damaged.insert(id);
        }
        self.rollouts.active().remove(id);
    }

    /// Makes a rollout this server's. False when somebody was faster, or it is over.
    async fn take_over(&mut self, id: i64, epoch: u64) -> Result<bool, RolloutError> {
        // Nobody looks at robots while there are no rollouts.
        self.see().await;
        let server = &self.rollouts.server;
        let records = &self.rollouts.records;
        let Some(taken) = records.rollouts().take(id, epoch, server.as_str()).await? else {
            return Ok(false);
        };
        let epoch = taken.rollout.epoch;
        let read = self.rollouts.read(&taken.rollout.document, &taken.robots);
        let (mut rollout, mut step) = read?;
        let owner = Owner {
            server: server.clone(),
            epoch,
        };
        // What it sends again comes once more with the step that follows.
        step.effects.clear();
        match rollout.take_over(owner, self.rollouts.now()) {
            Ok(taken) => step::merge(&mut step, taken),
            Err(error) => return Err(RolloutError::Damaged(error.to_string())),
        }
        let mut blobs = Vec::new();
        for release in &rollout.document().plan.releases {
            let blob = Blob::load(records.releases(), release).await?;
            if blob.is_none() {
                tracing::error!(rollout = id, release = %release.release, "its image is gone");
            }
            blobs.push(blob);
        }
        let seen = self.known.all(rollout.document().plan.model());
        let active = Active {
            rollout,
            epoch,
            blobs,
            over_since: None,
        };
        self.damaged.remove(&id);
        self.rollouts.active().insert(id, active);
        self.commit(id, step).await;
        let seen = seen.into_iter().map(Event::Seen).collect();
        self.apply(id, seen).await;
        Ok(true)
    }

    /// Pauses what runs with a release that was withdrawn, whoever has withdrawn it: another server, or somebody who
    /// could not tell every rollout.
    async fn pause_withdrawn(&mut self) {
        let running: Vec<i64> = {
            let active = self.rollouts.active();
            let running = active
                .all()
                .filter(|(_, one)| one.rollout.document().state == RolloutState::Running);
            running.map(|(id, _)| id).collect()
        };
        if running.is_empty() {
            return;
        }
        let in_force = match self.rollouts.records.releases().in_force().await {
            Ok(in_force) => in_force,
            Err(error) => {
                tracing::warn!(%error, "whether releases were withdrawn cannot be read");
                return;
            }
        };
        for id in running {
            let step = {
                let mut active = self.rollouts.active();
                let Some(one) = active.get_mut(id) else {
                    continue;
                };
                let Some(release) = one.withdrawn(&in_force) else {
                    continue;
                };
                tracing::warn!(rollout = id, %release, "a release of it was withdrawn");
                one.rollout.command(&Command::Pause, self.rollouts.now())
            };
            // What does not run by now needs no pause.
            if let Ok(step) = step {
                self.commit(id, step).await;
            }
        }
    }

    /// A rollout is another server's now.
    fn lose(&self, id: i64) {
        tracing::info!(rollout = id, "is carried out by another server now");
        self.rollouts.active().remove(id);
    }

    /// Looks at the robots, and tells the rollouts what has changed.
    async fn see(&mut self) {
        let changes = self.known.changes(self.rollouts.robots.as_ref());
        if changes.is_empty() {
            return;
        }
        for id in self.ids() {
            let events: Vec<Event> = {
                let active = self.rollouts.active();
                let Some(one) = active.get(id) else { continue };
                // A robot that is new to the fleet belongs to the newest rollout that takes it.
                let concerned = changes.iter().filter(|seen| {
                    one.rollout.row(seen.robot()).is_some() || !active.newer_has(id, seen.robot())
                });
                let model = one.model();
                concerned.map(|seen| Event::Seen(seen.of(model))).collect()
            };
            self.apply(id, events).await;
        }
    }

    /// What robots have said, and that the session stands.
    async fn hear(&mut self, all: Vec<Heard>) {
        let mut events: BTreeMap<i64, Vec<Event>> = BTreeMap::new();
        let mut connected = false;
        for heard in all {
            let (robot, release, told) = match heard {
                Heard::Connected => {
                    connected = true;
                    continue;
                }
                Heard::NoPatch(robot, tag) => {
                    let release = self.rollouts.active().release(&robot, tag);
                    if let Some(release) = release {
                        let _ = self.offer(&robot, release);
                    }
                    continue;
                }
                Heard::Report(robot, release, told) => (robot, release, told),
            };
            let (concerned, model) = {
                let active = self.rollouts.active();
                let concerned = active.with_release(&robot, release);
                let first = concerned.first().and_then(|id| active.get(*id));
                let model = first.and_then(|one| one.model().cloned());
                (concerned, model)
            };
            let report = told.with(|| self.known.build(&robot, model.as_ref()));
            let name = crawler_updates::rollout::ReleaseId::new(&release.text());
            let (Some(report), Ok(release), false) = (report, name, concerned.is_empty()) else {
                self.rollouts.numbers.ignored();
                continue;
            };
            for id in concerned {
                events.entry(id).or_default().push(Event::Told {
                    robot: robot.clone(),
                    release: release.clone(),
                    report: report.clone(),
                });
            }
        }
        for (id, events) in events {
            self.apply(id, events).await;
        }
        if connected {
            let owed: Vec<Effect> = {
                let active = self.rollouts.active();
                active.all().flat_map(|(_, one)| one.owed()).collect()
            };
            self.send(owed).await;
        }
    }

    /// Has a rollout take in what has happened, and stores what comes of it.
    async fn apply(&mut self, id: i64, events: Vec<Event>) {
        let mut step = Step::default();
        {
            let mut active = self.rollouts.active();
            let Some(one) = active.get_mut(id) else {
                return;
            };
            let now = self.rollouts.now();
            for event in events {
                step::merge(&mut step, one.rollout.handle(event, now));
            }
        }
        self.commit(id, step).await;
    }

    /// Stores a step, for as long as that takes, and then sends what it sends. A rollout whose step cannot be stored
    /// for good is not carried out any more.
    async fn commit(&mut self, id: i64, step: Step) {
        let mut said = false;
        loop {
            match self.store(id, &step).await {
                Ok(()) => return self.follow(id, step).await,
                Err(NotStored::Lost) => return self.lose(id),
                Err(NotStored::Records(error)) => {
                    self.rollouts.numbers.store_failed();
                    if !error.is_passing() {
                        return self.give_up(id, &error.into());
                    }
                    if !std::mem::replace(&mut said, true) {
                        tracing::error!(rollout = id, %error, "waits: what it does cannot be stored");
                    }
                }
            }
            tokio::select! {
                () = self.stop.cancelled() => return,
                () = tokio::time::sleep(AGAIN) => {}
            }
        }
    }

    /// Stores a step.
    async fn store(&self, id: i64, step: &Step) -> Result<(), NotStored> {
        if step::is_empty(step) {
            return Ok(());
        }
        let epoch = self.rollouts.active().get(id).map(|one| one.epoch);
        let epoch = epoch.ok_or(NotStored::Lost)?;
        let stored = self.to_records(id, step).map_err(NotStored::Records)?;
        let written = self
            .rollouts
            .records
            .rollouts()
            .write(id, epoch, stored)
            .await;
        match written.map_err(NotStored::Records)? {
            Written::Stored => Ok(()),
            Written::Lost => Err(NotStored::Lost),
        }
    }

    fn to_records(&self, id: i64, step: &Step) -> Result<RolloutStep, RecordsError> {
        let at = i64::try_from(self.rollouts.now().unix_ms).unwrap_or(i64::MAX);
        step::to_records(id, step, at)
            .map_err(|_| RecordsError::Invalid("a rollout cannot be written as JSON"))
    }

    /// What follows when a step is stored.
    async fn follow(&mut self, id: i64, step: Step) {
        for (level, robot, text) in step::events(id, &step.notes) {
            (self.rollouts.tell)(level, robot, text);
        }
        let effects = {
            let mut active = self.rollouts.active();
            let Some(one) = active.get_mut(id) else {
                return;
            };
            if one.rollout.document().state.is_over() {
                one.over_since.get_or_insert_with(Instant::now);
            }
            let accepted = step.effects.into_iter();
            accepted
                .filter(|effect| one.rollout.accepts(effect.epoch))
                .collect()
        };
        self.send(effects).await;
    }

    /// Sends messages. What the connection does not take is sent again when it stands, or is due.
    async fn send(&mut self, effects: Vec<Effect>) {
        let Some(client) = self.rollouts.client() else {
            return;
        };
        for effect in effects {
            let Ok(release) = effect.release.as_str().parse::<ReleaseId>() else {
                continue;
            };
            let command = match effect.message {
                Message::Offer => match self.offer(&effect.robot, release) {
                    Offer::Now(delta) => UpdateCommand::Offer { release, delta },
                    Offer::Later { .. } => continue,
                },
                Message::Confirm => UpdateCommand::Confirm { release },
                Message::Cancel => UpdateCommand::Cancel { release },
            };
            let mut bytes = vec![0; crawler_protocol::MAX_MESSAGE];
            let Ok(length) = command.to_json(&mut bytes) else {
                continue;
            };
            bytes.truncate(length);
            let topic = Topic::Ota(effect.robot).render(&self.rollouts.fleet);
            let properties = PublishProperties {
                message_expiry_interval: Some(EXPIRY),
                ..PublishProperties::default()
            };
            let sent = client.publish_with_properties(
                topic.as_str(),
                QoS::AtLeastOnce,
                false,
                bytes,
                properties,
            );
            if !matches!(tokio::time::timeout(SEND, sent).await, Ok(Ok(()))) {
                return;
            }
        }
    }

    /// What to offer a robot of a release. A patch that it takes and that is not there is made from now on; patches are
    /// of programs.
    fn offer(&mut self, robot: &RobotId, release: ReleaseId) -> Offer {
        let blob = self.rollouts.active().program(release);
        let (Some(from), Some(blob)) = (self.known.build(robot, None), blob) else {
            return Offer::Now(None);
        };
        let pair = Pair { from, to: release };
        let now_ms = self.rollouts.now().monotonic_ms;
        let offer = self.rollouts.patches().offer(robot, &pair, now_ms);
        match offer {
            Offer::Later { begin: true } => self.maker.begin(&self.rollouts.records, pair, blob),
            Offer::Now(Some(_)) => self.rollouts.numbers.offered_patch(),
            Offer::Later { begin: false } | Offer::Now(None) => {}
        }
        offer
    }

    /// Sends the offers that have waited for a patch, where robots are still owed them.
    async fn send_waiting(&mut self) {
        let waiting = self.rollouts.patches().waiting();
        if waiting.is_empty() {
            return;
        }
        let owed: Vec<Effect> = {
            let active = self.rollouts.active();
            let owed = active.all().flat_map(|(_, one)| one.owed());
            owed.filter(|effect| {
                matches!(effect.message, Message::Offer) && waiting.contains(&effect.robot)
            })
            .collect()
        };
        let robots = owed.iter().map(|effect| effect.robot.clone()).collect();
        self.rollouts.patches().keep_waiting(&robots);
        self.send(owed).await;
    }

    async fn serve(&mut self, request: Request) {
        match request {
            // Whoever has stopped waiting does not want it any more.
            Request::Start { answer, .. } if answer.is_closed() => {}
            Request::Act { answer, .. } if answer.is_closed() => {}
            Request::Start { by, plan, answer } => {
                let _ = answer.send(self.start(by, plan).await);
            }
            Request::Act { id, action, answer } => {
                let _ = answer.send(self.act(id, &action).await);
            }
        }
    }

    async fn start(&mut self, by: String, plan: NewPlan) -> Result<i64, RolloutError> {
        let rollouts = Arc::clone(&self.rollouts);
        let records = &rollouts.records;
        let plan = plan
            .resolve(records, rollouts.now().unix_ms, rollouts.gates)
            .await?;
        let mut blobs = Vec::new();
        for release in &plan.releases {
            let blob = Blob::load(records.releases(), release).await?;
            let gone = || RolloutError::Release(release.release.clone(), "its image is gone");
            blobs.push(Some(blob.ok_or_else(gone)?));
        }
        self.see().await;
        let (id, rollout, step) = self.begin(&by, &plan).await?;
        let active = Active {
            rollout,
            epoch: 1,
            blobs,
            over_since: None,
        };
        rollouts.active().insert(id, active);
        self.supersede(id).await;
        self.follow(id, step).await;
        Ok(id)
    }

    /// Keeps a rollout that begins under a number of its own.
    async fn begin(&self, by: &str, plan: &Plan) -> Result<(i64, Rollout, Step), RolloutError> {
        let rollouts = &self.rollouts;
        let records = rollouts.records.rollouts();
        for _ in 0..TRIES {
            let id = records.next_id().await?;
            let name = RolloutId::new(&id.to_string()).map_err(damaged)?;
            let owner = Owner {
                server: rollouts.server.clone(),
                epoch: 1,
            };
            let robots = self.known.all(plan.model());
            let started = Rollout::start(name, plan.clone(), owner, &robots, rollouts.now());
            let (rollout, step) = started.map_err(RolloutError::Start)?;
            let new = NewRollout {
                id,
                by: by.to_owned(),
                owner: rollouts.server.as_str().to_owned(),
                step: gate::noted(self.to_records(id, &step)?, id, by, plan),
            };
            match records.add(new).await {
                Ok(()) => {
                    if let Some(text) = gate::told(id, by, plan) {
                        (rollouts.tell)(EventLevel::Warn, None, text);
                    }
                    return Ok((id, rollout, step));
                }
                // Another server began one just now.
                Err(RecordsError::Exists) => {}
                Err(error) => return Err(error.into()),
            }
        }
        Err(RolloutError::Contended)
    }

    /// Goes on with what the records have kept from being done.
    async fn supersede_what_is_left(&mut self) {
        for id in self.superseding.clone() {
            let runs = {
                let active = self.rollouts.active();
                let one = active.get(id);
                one.is_some_and(|one| !one.rollout.document().state.is_over())
            };
            if runs {
                self.supersede(id).await;
            } else {
                self.superseding.remove(&id);
            }
        }
    }

    /// Takes over every rollout that is not over. One that cannot be read is left alone.
    async fn take_all_over(&mut self) -> Result<(), RecordsError> {
        let leases = self.rollouts.records.rollouts().leases().await?;
        let here = self.ids();
        let mut all = Ok(());
        for lease in leases {
            if here.contains(&lease.id) || self.damaged.contains(&lease.id) {
                continue;
            }
            match self.take_over(lease.id, lease.epoch).await {
                Ok(_) => {}
                Err(RolloutError::Records(error)) => all = Err(error),
                Err(error) => self.give_up(lease.id, &error),
            }
        }
        all
    }

    /// Takes the robots of a rollout that begins from earlier ones of the same, programs, a model or policies, whoever carries
    /// those out; later again, for as long as the records do not let it.
    async fn supersede(&mut self, newest: i64) {
        if let Err(error) = self.take_all_over().await {
            if self.superseding.insert(newest) {
                tracing::error!(rollout = newest, %error, "earlier rollouts keep their robots for now");
            }
        } else {
            self.superseding.remove(&newest);
        }
        for id in self.ids().into_iter().filter(|id| *id != newest) {
            let mut step = Step::default();
            {
                let mut active = self.rollouts.active();
                let same = active.get(newest).is_none_or(|newest| {
                    let one = active.get(id);
                    one.is_some_and(|one| one.replaces() == newest.replaces())
                });
                if !same {
                    continue;
                }
                let robots: Vec<RobotId> = active.get(newest).map_or_else(Vec::new, |one| {
                    let rows = one.rollout.rows().filter(|row| row.phase.is_some());
                    rows.map(|row| row.robot.clone()).collect()
                });
                let Some(one) = active.get_mut(id) else {
                    continue;
                };
                let now = self.rollouts.now();
                for robot in robots {
                    let command = Command::Supersede(robot);
                    // One on trial comes to its end; what has ended stays as it is.
                    if let Ok(more) = one.rollout.command(&command, now) {
                        step::merge(&mut step, more);
                    }
                }
            }
            self.commit(id, step).await;
        }
    }

    async fn act(&mut self, id: i64, action: &Action) -> Result<(), RolloutError> {
        for _ in 0..TRIES {
            self.make_own(id).await?;
            if matches!(action, Action::Resume | Action::Retry(_)) {
                self.check_releases(id).await?;
            }
            let step = {
                let mut active = self.rollouts.active();
                let Some(one) = active.get_mut(id) else {
                    if self.damaged.contains(&id) {
                        return Err(damaged("it cannot be written"));
                    }
                    // Somebody took it just now.
                    continue;
                };
                let step = one.rollout.command(&action.command(), self.rollouts.now());
                step.map_err(RolloutError::Command)?
            };
            match self.store(id, &step).await {
                Ok(()) => {
                    self.follow(id, step).await;
                    return Ok(());
                }
                // Somebody took it just now.
                Err(NotStored::Lost) => self.lose(id),
                Err(NotStored::Records(error)) => {
                    // It may have been written all the same: what is true stands in the records.
                    self.rollouts.active().remove(id);
                    return Err(error.into());
                }
            }
        }
        Err(RolloutError::Contended)
    }

    /// Refuses what would offer releases that were withdrawn.
    async fn check_releases(&self, id: i64) -> Result<(), RolloutError> {
        let in_force = self.rollouts.records.releases().in_force().await?;
        let active = self.rollouts.active();
        let withdrawn = active.get(id).and_then(|one| one.withdrawn(&in_force));
        match withdrawn {
            Some(release) => Err(RolloutError::Release(release.clone(), "it was withdrawn")),
            None => Ok(()),
        }
    }

    /// Makes sure that a rollout is this server's, which may have lost it without knowing.
    async fn make_own(&mut self, id: i64) -> Result<(), RolloutError> {
        let kept = self.rollouts.records.rollouts().get(id).await?;
        let kept = kept.ok_or(RolloutError::Unknown)?;
        let own = self.rollouts.active().get(id).map(|one| one.epoch);
        if own == Some(kept.epoch) {
            return Ok(());
        }
        if own.is_some() {
            self.lose(id);
        }
        if kept.ended.is_some() || !self.take_over(id, kept.epoch).await? {
            return Err(RolloutError::Command(CommandError::Over));
        }
        Ok(())
    }
}

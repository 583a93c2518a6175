//! What link and update share: chunks and commands one way, reports the other.
//!
//! One chunk has a place, and the link takes nothing from the stream while it is occupied, for a second at most: the
//! broker then waits, as TCP does it, and nothing gets lost. Of reports the newest of each kind is kept, since each says all
//! that an older one of its kind did.

use core::cell::RefCell;
use core::future::poll_fn;
use core::task::{Context, Poll};

use crawler_protocol::{
    BuildId, ModelName, ReasonCode, ReleaseId, RobotId, UpdateCommand, UpdateOutcome, UpdatePart,
    UpdateReport, UpdateStage,
};
use crawler_release::chunk::{Chunk, PAYLOAD, Part};
use crawler_release::{PublicKeys, Want};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::signal::Signal;
use embassy_sync::waitqueue::WakerRegistration;
use heapless::Deque;

use super::slots::Subject;

/// Commands that may wait. A server sends one, and sends it again when nothing comes of it.
const COMMANDS: usize = 3;

/// What the running program is, for updates: fixed when it is built, and handed over by the body.
#[derive(Debug, Clone)]
pub struct UpdateIdentity {
    /// What names the build. A release proves by it that it runs.
    pub build: BuildId,
    /// The keys by which releases are believed; without any all of them are refused.
    pub keys: Option<PublicKeys>,
}

/// What the server says about a release.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Word {
    /// With the bytes of the patch that makes it out of the program that runs, if the server has one.
    Offer(ReleaseId, Option<u32>),
    Confirm(ReleaseId),
    Cancel(ReleaseId),
}

/// What the robot runs and holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Have {
    pub(crate) sequence: u32,
    pub(crate) floor: u32,
    /// What lies unfinished in the spare slot, and how much of it.
    pub(crate) unfinished: Option<(ReleaseId, u32)>,
}

/// Where the robot stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Progress {
    pub(crate) release: ReleaseId,
    pub(crate) stage: UpdateStage,
    pub(crate) reason: Option<&'static str>,
    pub(crate) bytes: u32,
    /// What it replaces.
    pub(crate) of: Subject,
}

/// What a release came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Outcome {
    pub(crate) release: ReleaseId,
    pub(crate) came_to: UpdateOutcome,
    pub(crate) reason: Option<&'static str>,
    /// Of a refusal: whether it would be the same tomorrow.
    pub(crate) lasting: Option<bool>,
    /// What it replaces.
    pub(crate) of: Subject,
}

/// A kind of report. Of each the newest counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ReportKind {
    Have,
    Outcome,
    Progress,
    Want,
}

impl ReportKind {
    /// In the order in which they are sent: what the robot is comes first, and it asks last.
    const ALL: [Self; 4] = [Self::Have, Self::Outcome, Self::Progress, Self::Want];

    const fn bit(self) -> u8 {
        1 << self as u8
    }
}

/// What the link does for updates. A trait object, so that a body without any links none of the code.
pub(crate) trait UpdatePort {
    /// Whether there are any: whether to listen to the robot's topic of updates.
    fn exists(&self) -> bool;
    /// A message on that topic. What is wrong with it, if that is to be logged.
    fn arrived(&self, payload: &[u8]) -> Result<(), &'static str>;
    /// Whether a chunk can be taken.
    fn has_room(&self) -> bool;
    /// Ready when a chunk can be taken.
    fn poll_room(&self, context: &mut Context<'_>) -> Poll<()>;
    /// A session has begun.
    fn session_began(&self);
    /// The server was heard, by whatever it said.
    fn heard(&self);
    /// The broker has confirmed something.
    fn reached(&self);
    /// The first report that is to be sent and that `free` permits.
    fn next_report(&self, free: &dyn Fn(ReportKind) -> bool) -> Option<ReportKind>;
    /// Writes a report as it is now, and notes that it is on its way. `None` when it fits no message.
    fn compose(&self, kind: ReportKind, robot: &RobotId, page: &mut [u8]) -> Option<usize>;
    /// The broker has a report, or refuses it for good.
    fn settled(&self, kind: ReportKind);
    /// Nothing that was sent is on its way any more.
    fn rewind(&self);
    /// Adds the models that are in use, but for those of the program, to the status that is the first `len` bytes of
    /// `page`; its length then. `None` when it fits no message.
    fn add_models(&self, page: &mut [u8], len: usize) -> Option<usize>;
    /// Another number whenever they have changed; `None` while they are not known.
    fn models_revision(&self) -> Option<u8>;
    /// Whether releases may bring policies.
    fn takes_policies(&self) -> bool;
}

/// The updates of a body without any.
pub(crate) struct NoUpdates;

impl UpdatePort for NoUpdates {
    fn exists(&self) -> bool {
        false
    }

    fn arrived(&self, _: &[u8]) -> Result<(), &'static str> {
        Ok(())
    }

    fn has_room(&self) -> bool {
        true
    }

    fn poll_room(&self, _: &mut Context<'_>) -> Poll<()> {
        Poll::Ready(())
    }

    fn session_began(&self) {}

    fn heard(&self) {}

    fn reached(&self) {}

    fn next_report(&self, _: &dyn Fn(ReportKind) -> bool) -> Option<ReportKind> {
        None
    }

    fn compose(&self, _: ReportKind, _: &RobotId, _: &mut [u8]) -> Option<usize> {
        None
    }

    fn settled(&self, _: ReportKind) {}

    fn rewind(&self) {}

    fn add_models(&self, _: &mut [u8], len: usize) -> Option<usize> {
        Some(len)
    }

    fn models_revision(&self) -> Option<u8> {
        Some(0)
    }

    fn takes_policies(&self) -> bool {
        false
    }
}

struct Inner<const MODELS: usize> {
    words: Deque<Word, COMMANDS>,
    /// A session has begun that was not told of what there is.
    session: bool,
    heard: bool,
    reached: bool,
    /// What was asked for last, and is missing of it: nothing else is taken, and this is what is asked for again.
    want: Option<Want>,
    /// Index and length of the chunk that waits.
    waiting: Option<(u32, u16)>,
    payload: [u8; PAYLOAD],
    room: WakerRegistration,
    /// Bits of [`ReportKind`]: to be sent, and sent without being confirmed.
    due: u8,
    under_way: u8,
    have: Have,
    progress: Option<Progress>,
    outcome: Option<Outcome>,
    models: [InUse; MODELS],
}

/// Which model is in use.
struct InUse {
    /// What it is called, and what names its contents; `None` for what came with the program.
    model: Option<(ModelName, BuildId)>,
    /// Counts its changes; `None` while it is not known which it is.
    revision: Option<u8>,
    /// Who waits until it is known.
    waits: WakerRegistration,
    /// Whether it is a policy.
    drives: bool,
}

impl InUse {
    const OWN: Self = Self {
        model: None,
        revision: Some(0),
        waits: WakerRegistration::new(),
        drives: false,
    };
}

/// What [`update()`](crate::update()) and the link share: chunks and words of the server one way, reports the other. A board
/// keeps it in a static beside its [`Robot`](crate::Robot): 1.6 KB.
///
/// `MODELS` is how many models releases may bring: one for a detector and one for a policy, as far as the body takes them;
/// with 0 it has no code and no memory for it.
pub struct Updates<M: RawMutex, const MODELS: usize = 0> {
    identity: UpdateIdentity,
    inner: Mutex<M, RefCell<Inner<MODELS>>>,
    /// Link → update: something has arrived.
    arrived: Signal<M, ()>,
}

impl<M: RawMutex, const MODELS: usize> Updates<M, MODELS> {
    /// Nothing has been said.
    #[must_use]
    pub const fn new(identity: UpdateIdentity) -> Self {
        Self {
            identity,
            inner: Mutex::new(RefCell::new(Inner {
                words: Deque::new(),
                session: false,
                heard: false,
                reached: false,
                want: None,
                waiting: None,
                payload: [0; PAYLOAD],
                room: WakerRegistration::new(),
                due: 0,
                under_way: 0,
                have: Have {
                    sequence: 0,
                    floor: 0,
                    unfinished: None,
                },
                progress: None,
                outcome: None,
                models: [const { InUse::OWN }; MODELS],
            })),
            arrived: Signal::new(),
        }
    }

    /// What the running program is.
    pub const fn identity(&self) -> &UpdateIdentity {
        &self.identity
    }

    fn with<T>(&self, f: impl FnOnce(&mut Inner<MODELS>) -> T) -> T {
        self.inner.lock(|inner| f(&mut inner.borrow_mut()))
    }

    /// Returns when something may have arrived since the last return.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub(crate) async fn changed(&self) {
        self.arrived.wait().await;
    }

    /// Takes the next word of the server.
    pub(crate) fn take_word(&self) -> Option<Word> {
        self.with(|inner| inner.words.pop_front())
    }

    /// Whether a session has begun since the last call.
    pub(crate) fn take_session(&self) -> bool {
        self.with(|inner| core::mem::take(&mut inner.session))
    }

    /// Whether the server was heard and the broker reached since the start.
    pub(crate) fn linked(&self) -> (bool, bool) {
        self.with(|inner| (inner.heard, inner.reached))
    }

    /// Says which chunks are waited for from now on, and asks for them.
    pub(crate) fn ask(&self, want: Want) {
        self.with(|inner| {
            inner.want = Some(want);
            inner.due |= ReportKind::Want.bit();
        });
    }

    /// Takes no chunk from now on, and forgets the one that waits.
    pub(crate) fn close(&self) {
        self.with(|inner| {
            // What is on its way may be sent once more under its number: then it asks for nothing.
            if let Some(want) = &mut inner.want {
                want.missing = 0;
            }
            inner.due &= !ReportKind::Want.bit();
            inner.under_way &= !ReportKind::Want.bit();
            inner.make_room();
        });
    }

    /// Index and length of the chunk that waits.
    pub(crate) fn chunk(&self) -> Option<(u32, usize)> {
        self.with(|inner| {
            let (index, length) = inner.waiting?;
            Some((index, usize::from(length)))
        })
    }

    /// Makes room for the next chunk. What is in the place stays there until one comes.
    pub(crate) fn make_room(&self) {
        self.with(Inner::make_room);
    }

    /// Copies bytes out of the place of chunks, from `at` on.
    pub(crate) fn copy_out(&self, at: usize, to: &mut [u8]) {
        self.with(|inner| {
            let from = inner.payload.get(at..).unwrap_or(&[]);
            for (to, from) in to.iter_mut().zip(from) {
                *to = *from;
            }
        });
    }

    /// Copies bytes into the place of chunks, which takes none meanwhile, from `at` on.
    pub(crate) fn copy_in(&self, at: usize, from: &[u8]) {
        self.with(|inner| {
            let to = inner.payload.get_mut(at..).unwrap_or(&mut []);
            for (to, from) in to.iter_mut().zip(from) {
                *to = *from;
            }
        });
    }

    /// Reports what the robot runs and holds.
    pub(crate) fn tell_have(&self, have: Have) {
        self.with(|inner| {
            inner.have = have;
            inner.due |= ReportKind::Have.bit();
        });
    }

    /// Reports where the robot stands.
    pub(crate) fn tell_progress(&self, progress: Progress) {
        self.with(|inner| {
            inner.progress = Some(progress);
            inner.due |= ReportKind::Progress.bit();
        });
    }

    /// Reports what a release came to.
    pub(crate) fn tell_outcome(&self, outcome: Outcome) {
        self.with(|inner| {
            inner.outcome = Some(outcome);
            inner.due |= ReportKind::Outcome.bit();
        });
    }

    /// Has [`Self::models_known`], and the status, wait until it is known which models are in use: for a body that takes
    /// models, before the program starts. Who sees a status without a model would think that it was given up.
    pub fn expect_models(&self) {
        self.with(|inner| {
            for used in &mut inner.models {
                used.revision = None;
            }
        });
    }

    /// Returns when it is known which models are in use: at once, unless [`Self::expect_models`] was called. A body that
    /// takes models begins its link then, whose last will tells them as well.
    ///
    /// # Cancellation Safety
    /// A dropped call misses nothing.
    pub async fn models_known(&self) {
        poll_fn(|context| {
            self.with(|inner| {
                let mut all = inner.models.iter_mut();
                match all.find(|used| used.revision.is_none()) {
                    Some(used) => {
                        used.waits.register(context.waker());
                        Poll::Pending
                    }
                    None => Poll::Ready(()),
                }
            })
        })
        .await;
    }

    /// Where it stands which model of `subject` is in use. A body that takes one model has one place for it, whichever it is.
    fn place(subject: Subject) -> Option<usize> {
        let last = MODELS.checked_sub(1)?;
        Some(subject.model()?.min(last))
    }

    /// Says which model of `subject` is in use; `None` for what came with the program.
    pub(crate) fn set_model(&self, subject: Subject, model: Option<(ModelName, BuildId)>) {
        let Some(place) = Self::place(subject) else {
            return;
        };
        self.with(|inner| {
            if let Some(used) = inner.models.get_mut(place) {
                let revision = used.revision.unwrap_or(0);
                let changes = used.model != model;
                used.revision = Some(revision.wrapping_add(u8::from(changes)));
                used.model = model;
                used.waits.wake();
            }
        });
    }

    /// Says that releases may bring policies.
    pub(crate) fn take_policies(&self) {
        let Some(place) = Self::place(Subject::Policy) else {
            return;
        };
        self.with(|inner| {
            if let Some(used) = inner.models.get_mut(place) {
                used.drives = true;
            }
        });
    }

    /// What names the contents of the model of `subject` that is in use.
    pub(crate) fn model_build(&self, subject: Subject) -> Option<BuildId> {
        let place = Self::place(subject)?;
        self.with(|inner| {
            let (_, build) = inner.models.get(place)?.model.as_ref()?;
            Some(build.clone())
        })
    }

    /// Whether the broker has every report.
    pub(crate) fn is_told(&self) -> bool {
        self.with(|inner| inner.due | inner.under_way == 0)
    }
}

impl<const MODELS: usize> Inner<MODELS> {
    fn make_room(&mut self) {
        self.waiting = None;
        self.room.wake();
    }

    /// Whether the chunk is one that is waited for.
    fn put(&mut self, chunk: &Chunk<'_>) -> bool {
        if self.waiting.is_some() {
            return false;
        }
        let Some(want) = &mut self.want else {
            return false;
        };
        // A patch is read from its beginning to its end.
        if chunk.part == Part::Delta && want.indices().next() != Some(chunk.index) {
            return false;
        }
        if !want.take(chunk.tag, chunk.part, chunk.index) {
            return false;
        }
        let Some(place) = self.payload.get_mut(..chunk.payload.len()) else {
            return false;
        };
        place.copy_from_slice(chunk.payload);
        self.waiting = Some((chunk.index, chunk.payload.len() as u16));
        true
    }
}

impl<M: RawMutex, const MODELS: usize> UpdatePort for Updates<M, MODELS> {
    fn exists(&self) -> bool {
        true
    }

    fn arrived(&self, payload: &[u8]) -> Result<(), &'static str> {
        if payload.first() != Some(&b'{') {
            // What is no chunk, or none that is waited for, may be an old one: it is asked for again if not.
            if let Ok(chunk) = Chunk::decode(payload)
                && self.with(|inner| inner.put(&chunk))
            {
                self.arrived.signal(());
            }
            return Ok(());
        }
        let word = match UpdateCommand::from_json(payload) {
            Ok(Some(UpdateCommand::Offer { release, delta })) => {
                let ours = delta.filter(|delta| delta.base == self.identity.build);
                Word::Offer(release, ours.map(|delta| delta.bytes))
            }
            Ok(Some(UpdateCommand::Confirm { release })) => Word::Confirm(release),
            Ok(Some(UpdateCommand::Cancel { release })) => Word::Cancel(release),
            Ok(None) => return Ok(()),
            Err(_) => return Err("a word about updates makes no sense"),
        };
        self.with(|inner| {
            if inner.words.iter().all(|waiting| *waiting != word) {
                // The newest word counts most.
                if inner.words.is_full() {
                    inner.words.pop_front();
                }
                let _ = inner.words.push_back(word);
            }
        });
        self.heard();
        self.arrived.signal(());
        Ok(())
    }

    fn has_room(&self) -> bool {
        self.with(|inner| inner.waiting.is_none())
    }

    fn poll_room(&self, context: &mut Context<'_>) -> Poll<()> {
        self.with(|inner| {
            if inner.waiting.is_none() {
                return Poll::Ready(());
            }
            inner.room.register(context.waker());
            Poll::Pending
        })
    }

    fn session_began(&self) {
        self.with(|inner| inner.session = true);
        self.arrived.signal(());
    }

    fn heard(&self) {
        self.with(|inner| inner.heard = true);
    }

    fn reached(&self) {
        self.with(|inner| inner.reached = true);
    }

    fn next_report(&self, free: &dyn Fn(ReportKind) -> bool) -> Option<ReportKind> {
        let due = self.with(|inner| inner.due);
        ReportKind::ALL
            .into_iter()
            .find(|kind| due & kind.bit() != 0 && free(*kind))
    }

    fn compose(&self, kind: ReportKind, robot: &RobotId, page: &mut [u8]) -> Option<usize> {
        let robot = robot.clone();
        let build = |of| match Self::place(of) {
            Some(_) => self.model_build(of),
            None => Some(self.identity.build.clone()),
        };
        let report: UpdateReport = match kind {
            ReportKind::Have => {
                let have = self.take(kind, |inner| inner.have);
                UpdateReport::Have {
                    robot,
                    build: self.identity.build.clone(),
                    sequence: have.sequence,
                    floor: have.floor,
                    release: have.unfinished.map(|(release, _)| release),
                    bytes: have.unfinished.map(|(_, bytes)| bytes),
                }
            }
            ReportKind::Want => {
                let want = self.take(kind, |inner| inner.want)?;
                UpdateReport::Want {
                    robot,
                    tag: want.tag,
                    part: match want.part {
                        Part::Manifest => UpdatePart::Manifest,
                        Part::Image => UpdatePart::Image,
                        Part::Delta => UpdatePart::Delta,
                    },
                    first: want.first,
                    missing: want.missing,
                }
            }
            ReportKind::Progress => {
                let progress = self.take(kind, |inner| inner.progress)?;
                UpdateReport::Progress {
                    robot,
                    release: progress.release,
                    state: progress.stage,
                    reason: progress.reason.and_then(|code| ReasonCode::new(code).ok()),
                    bytes: progress.bytes,
                    build: build(progress.of),
                }
            }
            ReportKind::Outcome => {
                let outcome = self.take(kind, |inner| inner.outcome)?;
                UpdateReport::Outcome {
                    robot,
                    release: outcome.release,
                    outcome: outcome.came_to,
                    reason: outcome.reason.and_then(|code| ReasonCode::new(code).ok()),
                    build: build(outcome.of),
                    lasting: outcome.lasting,
                }
            }
        };
        report.to_json(page).ok()
    }

    fn settled(&self, kind: ReportKind) {
        self.with(|inner| inner.under_way &= !kind.bit());
        self.arrived.signal(());
    }

    fn rewind(&self) {
        self.with(|inner| {
            inner.due |= core::mem::take(&mut inner.under_way);
        });
    }

    // As the message would, whose models are last in it. A map of JSON takes 2 KB of code, and there are two models at most.
    fn add_models(&self, page: &mut [u8], len: usize) -> Option<usize> {
        if MODELS == 0 {
            return Some(len);
        }
        self.with(|inner| {
            let models = inner.models.iter();
            let mut models = models.filter_map(|used| used.model.as_ref()).peekable();
            if models.peek().is_none() {
                return Some(len);
            }
            // In the place of the brace at the end.
            let mut at = len.checked_sub(1)?;
            let mut before = r#","models":{""#;
            let mut add = |text: &str| {
                let end = at + text.len();
                page.get_mut(at..end)?.copy_from_slice(text.as_bytes());
                at = end;
                Some(())
            };
            for (name, build) in models {
                for text in [before, name.as_str(), r#"":""#, build.as_str()] {
                    add(text)?;
                }
                before = r#"",""#;
            }
            add(r#""}}"#)?;
            Some(at)
        })
    }

    fn models_revision(&self) -> Option<u8> {
        self.with(|inner| {
            let mut revisions = inner.models.iter().map(|used| used.revision);
            revisions.try_fold(0, |sum: u8, one| Some(sum.wrapping_add(one?)))
        })
    }

    fn takes_policies(&self) -> bool {
        self.with(|inner| inner.models.iter().any(|used| used.drives))
    }
}

impl<M: RawMutex, const MODELS: usize> Updates<M, MODELS> {
    /// What is to be reported, which is on its way from now on.
    fn take<T>(&self, kind: ReportKind, of: impl FnOnce(&Inner<MODELS>) -> T) -> T {
        self.with(|inner| {
            inner.due &= !kind.bit();
            inner.under_way |= kind.bit();
            of(inner)
        })
    }
}

/// Waits until a chunk can be taken.
///
/// # Cancellation Safety
/// A dropped call misses nothing.
pub(crate) async fn room(port: &dyn UpdatePort) {
    poll_fn(|context| port.poll_room(context)).await;
}

//! Who asked what, and how far it is.

use std::collections::VecDeque;
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crawler_history::HistoryStore;
use crawler_records::Records;
use crawler_system::process::give_way;

use crate::answer::{Answer, answer};
use crate::bodies::Body;
use crate::past::{self, Certificates, Past, Unreadable};
use crate::question::Question;
use crate::world::{NoWorld, Setting, stop_if};

/// Most that are kept.
const MOST_KEPT: usize = 16;

/// What answers stand on.
pub struct Parts {
    /// Where robots were.
    pub history: HistoryStore,
    /// What they were told, and where.
    pub records: Records,
    /// Whose bodies are known.
    pub certificates: Arc<Certificates>,
}

/// How far an answer is.
#[derive(Debug, Clone, PartialEq)]
pub enum State {
    /// It is being worked out.
    Running,
    /// There it is.
    Done(Arc<Answer>),
    /// There is none: why not.
    Failed(String),
}

/// A question, and how far its answer is.
#[derive(Debug, Clone, PartialEq)]
pub struct Counterfactual {
    /// Its number.
    pub id: u64,
    /// When it was asked, Unix milliseconds.
    pub asked_ms: u64,
    /// By whom.
    pub by: String,
    /// What was asked.
    pub question: Question,
    /// Draws that are done.
    pub done: u32,
    /// How far it is.
    pub state: State,
}

/// Why nothing was asked.
#[derive(Debug)]
#[non_exhaustive]
pub enum NotAsked {
    /// Another one is being worked out.
    Busy,
    /// The past does not tell.
    Past(Unreadable),
    /// The system starts no thread.
    Thread(std::io::Error),
}

impl fmt::Display for NotAsked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Busy => f.write_str("another question is being worked out"),
            Self::Past(error) => error.fmt(f),
            Self::Thread(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for NotAsked {}

impl From<Unreadable> for NotAsked {
    fn from(error: Unreadable) -> Self {
        Self::Past(error)
    }
}

struct Kept {
    counterfactual: Counterfactual,
    ended: Arc<AtomicBool>,
}

/// All questions of this server, the last sixteen; they end with it.
pub struct Counterfactuals {
    parts: Parts,
    /// Oldest first.
    kept: Mutex<VecDeque<Kept>>,
    busy: AtomicBool,
}

/// Held by whoever works one out: another one may, as soon as this is dropped.
struct Turn(Arc<Counterfactuals>);

impl Drop for Turn {
    fn drop(&mut self) {
        self.0.busy.store(false, Ordering::Release);
    }
}

impl Counterfactuals {
    /// None so far.
    #[must_use]
    pub fn new(parts: Parts) -> Arc<Self> {
        Arc::new(Self {
            parts,
            kept: Mutex::default(),
            busy: AtomicBool::new(false),
        })
    }

    /// Asks a question at `now_ms`, Unix milliseconds; its answer is worked out in a thread that gives way to all others.
    ///
    /// # Errors
    /// [`NotAsked`]; nothing is kept then.
    ///
    /// # Cancellation safety
    /// What is dropped before it returns has asked nothing.
    pub async fn ask(
        self: &Arc<Self>,
        by: &str,
        question: Question,
        now_ms: u64,
    ) -> Result<Counterfactual, NotAsked> {
        if self.busy.swap(true, Ordering::AcqRel) {
            return Err(NotAsked::Busy);
        }
        let turn = Turn(Arc::clone(self));
        let Parts {
            history,
            records,
            certificates,
        } = &self.parts;
        let past = past::read(&question, (history, records), &**certificates).await?;
        let ended = Arc::new(AtomicBool::new(false));
        let counterfactual = {
            let mut kept = self.kept();
            let newest = kept.back().map_or(0, |kept| kept.counterfactual.id);
            let counterfactual = Counterfactual {
                id: now_ms.max(newest + 1),
                asked_ms: now_ms,
                by: by.to_owned(),
                question,
                done: 0,
                state: State::Running,
            };
            while kept.len() >= MOST_KEPT {
                kept.pop_front();
            }
            kept.push_back(Kept {
                counterfactual: counterfactual.clone(),
                ended: Arc::clone(&ended),
            });
            counterfactual
        };
        let id = counterfactual.id;
        let question = counterfactual.question.clone();
        let work = move || {
            if let Err(error) = give_way() {
                tracing::warn!(%error, "what if does not give way to other threads");
            }
            let this = Arc::clone(&turn.0);
            let state = this.work(id, &question, &past, &ended);
            // Whoever sees the answer may ask again at once.
            drop(turn);
            this.tell(id, |told| told.state = state);
        };
        let thread = std::thread::Builder::new().name("what if".to_owned());
        if let Err(error) = thread.spawn(work) {
            self.remove(id);
            return Err(NotAsked::Thread(error));
        }
        Ok(counterfactual)
    }

    /// All of them, newest first.
    #[must_use]
    pub fn list(&self) -> Vec<Counterfactual> {
        let kept = self.kept();
        let all = kept.iter().rev();
        all.map(|kept| kept.counterfactual.clone()).collect()
    }

    /// One of them.
    #[must_use]
    pub fn get(&self, id: u64) -> Option<Counterfactual> {
        let kept = self.kept();
        let found = kept.iter().find(|kept| kept.counterfactual.id == id);
        found.map(|kept| kept.counterfactual.clone())
    }

    /// Ends it where it is being worked out, and forgets it; false where there is none.
    pub fn remove(&self, id: u64) -> bool {
        let mut kept = self.kept();
        let Some(place) = kept.iter().position(|kept| kept.counterfactual.id == id) else {
            return false;
        };
        if let Some(kept) = kept.remove(place) {
            kept.ended.store(true, Ordering::Release);
        }
        true
    }

    /// Ends what is being worked out.
    pub fn end(&self) {
        for kept in &*self.kept() {
            kept.ended.store(true, Ordering::Release);
        }
    }

    fn kept(&self) -> MutexGuard<'_, VecDeque<Kept>> {
        // What was done to it is done.
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn tell(&self, id: u64, tell: impl FnOnce(&mut Counterfactual)) {
        let mut kept = self.kept();
        let found = kept.iter_mut().find(|kept| kept.counterfactual.id == id);
        if let Some(kept) = found {
            tell(&mut kept.counterfactual);
        }
    }

    /// What a question comes to.
    fn work(&self, id: u64, question: &Question, past: &Past, ended: &AtomicBool) -> State {
        let work = || -> Result<Answer, NoWorld> {
            let is_ended = || ended.load(Ordering::Acquire);
            let mut bodies = Vec::new();
            for past in &past.robots {
                stop_if(&is_ended)?;
                bodies.push(Body::of(past));
            }
            let setting = Setting::new(past, &bodies, question);
            let mut draws = Vec::new();
            for draw in 0..question.draws {
                let was = setting.run(draw, false, &is_ended)?;
                let would = setting.run(draw, true, &is_ended)?;
                draws.push([was, would]);
                self.tell(id, |told| told.done = draw + 1);
            }
            Ok(answer(past, &bodies, question, &draws))
        };
        // A mistake in the simulator ends this question, and no other one.
        let worked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(work));
        match worked {
            Ok(Ok(answer)) => State::Done(Arc::new(answer)),
            Ok(Err(why)) => State::Failed(why.to_string()),
            Err(_) => State::Failed("the simulation broke off; the log says why".to_owned()),
        }
    }
}

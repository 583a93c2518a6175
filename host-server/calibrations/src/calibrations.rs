//! All calibrations of this server.

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use crawler_protocol::open::{Open, Response};
use crawler_protocol::{Reason as Why, ResponseStatus, RobotId};
use crawler_twin::body::Pose;
use crawler_twin::course::{Course, Limits};
use crawler_twin::rehearsal::Sweep;
use crawler_twins::Twins;
use tokio::sync::Notify;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use crate::course::Driving;
use crate::ground::{Region, Square};
use crate::permit::{self, Refusal};
use crate::record::{BrokenOff, Calibration, Reason, State};
use crate::robots::{Fleet, HARMLESS, RobotView, SOURCE};
use crate::runner::Run;
use crate::store::{MOST, Store};

/// Rehearsals that are remembered: robots of a fleet have few kinds of limits.
const SWEEPS: usize = 16;
/// For runs to come to their end when the server does.
const PATIENCE: Duration = Duration::from_secs(3);

/// What time it is, Unix milliseconds.
pub type Clock = Arc<dyn Fn() -> u64 + Send + Sync>;

/// What calibrations stand on.
pub struct Parts {
    /// Where they are kept.
    pub folder: PathBuf,
    /// What hears the robots.
    pub twins: Arc<Twins>,
    /// The fleet.
    pub fleet: Arc<dyn Fleet>,
    /// Unix milliseconds.
    pub clock: Clock,
}

/// What a person says to be free.
#[derive(Debug, Clone)]
pub enum Free {
    /// This.
    Area(Arc<dyn Region>),
    /// A square around the robot, from its middle to each side so many metres.
    Around(f64),
}

/// What a person asks for.
#[derive(Debug, Clone, Default)]
pub struct NewCalibration {
    /// Who it is.
    pub by: String,
    /// What the robot drives on, in words.
    pub floor: String,
    /// What is free, where that is stated.
    pub free: Option<Free>,
}

/// What a calibration would be.
#[derive(Debug, Clone)]
pub struct Preview {
    /// Why there may be none.
    pub refusal: Option<Refusal>,
    /// How long the drive takes, seconds.
    pub seconds: f64,
    /// Length and width of the floor that it takes, metres; where it is known how fast the robot may drive.
    pub size: Option<[f64; 2]>,
    /// Corners of that floor; where it is known where the robot is.
    pub area: Vec<[f64; 2]>,
}

/// Why none has begun.
#[derive(Debug)]
#[non_exhaustive]
pub enum BeginError {
    /// Nobody knows the robot.
    UnknownRobot,
    /// It may not.
    Refused(Refusal),
    /// The disk does not take it.
    NotWritten(std::io::Error),
    /// The server is about to end.
    Stopping,
}

/// Why one was not stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopError {
    /// There is none of this number.
    Unknown,
    /// It is over.
    Over,
}

/// Ends a run.
#[derive(Debug, Default)]
pub(crate) struct Cut {
    why: Mutex<Option<BrokenOff>>,
    wake: Notify,
}

impl Cut {
    /// The first reason stays.
    pub(crate) fn end(&self, why: BrokenOff) {
        lock(&self.why).get_or_insert(why);
        self.wake.notify_one();
    }

    pub(crate) fn why(&self) -> Option<BrokenOff> {
        lock(&self.why).clone()
    }

    pub(crate) async fn woken(&self) {
        self.wake.notified().await;
    }
}

/// One that goes on.
#[derive(Debug)]
struct Active {
    id: u64,
    corners: Vec<[f64; 2]>,
    cut: Arc<Cut>,
}

#[derive(Debug, Default)]
struct Book {
    all: BTreeMap<u64, Calibration>,
    active: HashMap<RobotId, Active>,
    next: u64,
}

/// See the [crate].
pub struct Calibrations {
    pub(crate) store: Store,
    pub(crate) twins: Arc<Twins>,
    pub(crate) fleet: Arc<dyn Fleet>,
    pub(crate) clock: Clock,
    book: Mutex<Book>,
    /// How many go on: what hears the fleet looks at it alone, as a rule.
    active: AtomicUsize,
    sweeps: Mutex<Vec<(Limits, Arc<Sweep>)>>,
    tasks: TaskTracker,
    pub(crate) stop: CancellationToken,
}

impl fmt::Debug for Calibrations {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let active = self.active.load(Ordering::Relaxed);
        f.debug_struct("Calibrations")
            .field("active", &active)
            .finish_non_exhaustive()
    }
}

fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Whether a robot may begin where it is, and what it takes of the floor then.
struct Checked {
    robot: RobotView,
    home: Pose,
    sweep: Arc<Sweep>,
    corners: Vec<[f64; 2]>,
}

impl Calibrations {
    /// Those of this server. What was going on when it ended is said to be broken off.
    #[must_use]
    pub fn open(parts: Parts) -> Arc<Self> {
        let store = Store::new(parts.folder);
        let mut all = store.all();
        for found in all.values_mut().filter(|found| !found.state.is_over()) {
            found.state = State::BrokenOff;
            found.ended = Some((parts.clock)());
            found.reason = Some(Reason::from(&BrokenOff::ServerEnded));
            if let Err(error) = store.put(found) {
                tracing::warn!(%error, id = found.id, "what became of a calibration is not written down");
            }
            if let Some(hz) = found.telemetry_hz {
                parts.fleet.set_rate(&found.robot, hz);
            }
            let text = "calibration broken off: the server ended meanwhile".to_owned();
            parts.fleet.tell(&found.robot, true, text);
        }
        let next = all.last_key_value().map_or(1, |(id, _)| id + 1);
        Arc::new(Self {
            store,
            twins: parts.twins,
            fleet: parts.fleet,
            clock: parts.clock,
            book: Mutex::new(Book {
                all,
                active: HashMap::new(),
                next,
            }),
            active: AtomicUsize::new(0),
            sweeps: Mutex::default(),
            tasks: TaskTracker::new(),
            stop: CancellationToken::new(),
        })
    }

    fn book(&self) -> MutexGuard<'_, Book> {
        lock(&self.book)
    }

    /// What bodies sweep that drive within `limits`. The first time it takes a fifth of a second of a processor.
    async fn sweep(&self, limits: Limits) -> Option<Arc<Sweep>> {
        // Faster robots are not driven faster, but their wheels may be.
        let known = lock(&self.sweeps)
            .iter()
            .find(|(of, _)| *of == limits)
            .map(|(_, sweep)| Arc::clone(sweep));
        if known.is_some() {
            return known;
        }
        let sigma = (permit::MOST_SIGMA_M * 0.5, permit::MOST_SIGMA_RAD * 0.5);
        let made = tokio::task::spawn_blocking(move || Sweep::of(limits, sigma));
        let made = Arc::new(made.await.ok()?);
        let mut sweeps = lock(&self.sweeps);
        if sweeps.len() >= SWEEPS {
            sweeps.remove(0);
        }
        sweeps.push((limits, Arc::clone(&made)));
        Some(made)
    }

    /// What is against a calibration of a robot, or what it would be.
    async fn check(
        &self,
        robot: &RobotId,
        free: Option<&Free>,
    ) -> Result<Result<Checked, (Refusal, Option<Checked>)>, BeginError> {
        let view = self.fleet.robot(robot).ok_or(BeginError::UnknownRobot)?;
        let against = permit::of_robot(&view);
        let limits = permit::limits(&view);
        let sweep = self.sweep(limits).await.ok_or(BeginError::Stopping)?;
        let now = Instant::now().into_std();
        let state = match self.twins.state(robot, now, (self.clock)()) {
            Ok(state) => state,
            Err(why) => return Ok(Err((against.unwrap_or(Refusal::NoTwin(why)), None))),
        };
        let home = state.view.now.pose;
        let checked = Checked {
            robot: view,
            home,
            corners: sweep.corners(home, 0.0),
            sweep,
        };
        let against = against
            .or_else(|| {
                let now = &state.view.now;
                permit::of_place(now.sigma_m, now.sigma_rad, state.view.v)
            })
            .or_else(|| {
                let at = [home.x, home.y];
                let mut ground = self.fleet.ground(robot, at);
                ground.area = free.map(|free| area(free, at));
                let others = self.fleet.others(robot, at);
                permit::of_drive(&checked.sweep, home, &ground, &others)
            });
        Ok(match against {
            Some(refusal) => Err((refusal, Some(checked))),
            None => Ok(checked),
        })
    }

    /// What is against a calibration beside those that go on.
    fn beside(book: &Book, robot: &RobotId, corners: &[[f64; 2]]) -> Option<Refusal> {
        if book.active.contains_key(robot) {
            return Some(Refusal::Busy);
        }
        let others = book.active.iter();
        let others = others.map(|(robot, active)| (robot, active.corners.as_slice()));
        permit::beside(corners, others)
    }

    /// What a calibration of a robot would be, now and with what is stated to be free.
    ///
    /// # Errors
    /// [`BeginError::UnknownRobot`], [`BeginError::Stopping`].
    pub async fn preview(
        &self,
        robot: &RobotId,
        free: Option<&Free>,
    ) -> Result<Preview, BeginError> {
        let (refusal, checked) = match self.check(robot, free).await? {
            Ok(checked) => (
                Self::beside(&self.book(), robot, &checked.corners),
                Some(checked),
            ),
            Err((refusal, checked)) => {
                let is_busy = self.book().active.contains_key(robot);
                (Some(if is_busy { Refusal::Busy } else { refusal }), checked)
            }
        };
        let usual = Limits { v: 0.5, w: 3.0 };
        Ok(Preview {
            refusal,
            seconds: checked
                .as_ref()
                .map_or_else(|| Course::new(usual, 0).seconds(), |of| of.sweep.seconds),
            size: checked.as_ref().map(|of| of.sweep.size()),
            area: checked.map(|of| of.corners).unwrap_or_default(),
        })
    }

    /// Begins to calibrate a robot, if it may be.
    ///
    /// # Errors
    /// [`BeginError`]; nothing was told to the robot then.
    pub async fn begin(
        self: &Arc<Self>,
        robot: &RobotId,
        asked: NewCalibration,
    ) -> Result<Calibration, BeginError> {
        if self.stop.is_cancelled() {
            return Err(BeginError::Stopping);
        }
        if self.book().active.contains_key(robot) {
            return Err(BeginError::Refused(Refusal::Busy));
        }
        let checked = self.check(robot, asked.free.as_ref()).await?;
        let checked = checked.map_err(|(refusal, _)| BeginError::Refused(refusal))?;
        let recording = self.twins.record(robot);
        let recording = recording.map_err(|why| BeginError::Refused(Refusal::NoTwin(why)))?;
        let now_s = self.twins.seconds(Instant::now().into_std());
        let limits = permit::limits(&checked.robot);
        let (calibration, cut, driving) = {
            let mut book = self.book();
            if self.stop.is_cancelled() {
                return Err(BeginError::Stopping);
            }
            if let Some(refusal) = Self::beside(&book, robot, &checked.corners) {
                return Err(BeginError::Refused(refusal));
            }
            let id = book.next;
            book.next += 1;
            let begun = (self.clock)();
            let seed = begun ^ id.rotate_left(40);
            let driving = Driving::new(
                checked.home,
                Arc::clone(&checked.sweep),
                limits,
                (seed, checked.robot.boot),
                now_s,
            );
            let calibration = Calibration {
                id,
                robot: robot.clone(),
                by: asked.by,
                floor: asked.floor,
                begun,
                ended: None,
                state: State::Preparing,
                seconds: checked.sweep.seconds,
                legs: driving.legs(),
                area: checked.corners.clone(),
                reason: None,
                certificate: None,
                errors: Vec::new(),
                took_s: None,
                telemetry_hz: checked.robot.telemetry_hz,
            };
            let cut = Arc::new(Cut::default());
            let active = Active {
                id,
                corners: checked.corners,
                cut: Arc::clone(&cut),
            };
            book.active.insert(robot.clone(), active);
            book.all.insert(id, calibration.clone());
            self.active.store(book.active.len(), Ordering::Release);
            (calibration, cut, driving)
        };
        // A server that is killed from here on finds it when it starts.
        if let Err(error) = self.write(calibration.clone()).await {
            let mut book = self.book();
            book.all.remove(&calibration.id);
            book.active.remove(robot);
            self.active.store(book.active.len(), Ordering::Release);
            return Err(BeginError::NotWritten(error));
        }
        self.forget_oldest();
        let run = Run {
            calibrations: Arc::clone(self),
            driving,
            recording,
            cut,
            calibration: calibration.clone(),
            firmware: checked.robot.firmware,
        };
        self.tasks.spawn(run.carry_out());
        Ok(calibration)
    }

    pub(crate) async fn write(&self, calibration: Calibration) -> std::io::Result<()> {
        let store = self.store.clone();
        let written = tokio::task::spawn_blocking(move || store.put(&calibration));
        written.await.unwrap_or_else(|error| Err(error.into()))
    }

    fn forget_oldest(&self) {
        let mut gone = Vec::new();
        {
            let mut book = self.book();
            while book.all.len() > MOST {
                gone.extend(book.all.pop_first().map(|(id, _)| id));
            }
        }
        let store = self.store.clone();
        if !gone.is_empty() {
            self.tasks
                .spawn_blocking(move || gone.into_iter().for_each(|id| store.remove(id)));
        }
    }

    /// Shows how far one is.
    pub(crate) fn show(&self, calibration: &Calibration) {
        let mut book = self.book();
        if calibration.state.is_over() {
            let is_this = |active: &Active| active.id == calibration.id;
            if book.active.get(&calibration.robot).is_some_and(is_this) {
                book.active.remove(&calibration.robot);
            }
            self.active.store(book.active.len(), Ordering::Release);
        }
        if let Some(known) = book.all.get_mut(&calibration.id) {
            known.clone_from(calibration);
        }
    }

    /// Those of a robot, the newest first.
    pub fn list(&self, robot: &RobotId) -> Vec<Calibration> {
        let book = self.book();
        let all = book.all.values().rev();
        all.filter(|one| one.robot == *robot).cloned().collect()
    }

    /// One of a robot.
    pub fn get(&self, robot: &RobotId, id: u64) -> Option<Calibration> {
        let book = self.book();
        let found = book.all.get(&id)?;
        (found.robot == *robot).then(|| found.clone())
    }

    /// Stops one. The robot is told at once.
    ///
    /// # Errors
    /// [`StopError`]
    pub fn stop(&self, robot: &RobotId, id: u64, by: &str) -> Result<Calibration, StopError> {
        let found = self.get(robot, id).ok_or(StopError::Unknown)?;
        let cut = {
            let book = self.book();
            let active = book.active.get(robot).filter(|active| active.id == id);
            Arc::clone(&active.ok_or(StopError::Over)?.cut)
        };
        self.fleet.stop(robot);
        cut.end(BrokenOff::Stopped(by.to_owned()));
        Ok(found)
    }

    /// Takes in what a robot answers to commands: that of another one ends its calibration, and so does one that it
    /// refuses.
    pub fn answer(&self, response: &Response) {
        if self.active.load(Ordering::Acquire) == 0 {
            return;
        }
        let Some(why) = ends(response) else {
            return;
        };
        let cut = {
            let book = self.book();
            let active = book.active.get(&response.robot);
            active.map(|active| Arc::clone(&active.cut))
        };
        if let Some(cut) = cut {
            cut.end(why);
        }
    }

    /// How many go on.
    pub fn active(&self) -> usize {
        self.active.load(Ordering::Acquire)
    }

    /// Stops all of them, and returns when that is written down.
    pub async fn end(&self) {
        self.stop.cancel();
        {
            let book = self.book();
            for (robot, active) in &book.active {
                self.fleet.stop(robot);
                active.cut.end(BrokenOff::ServerEnded);
            }
        }
        self.tasks.close();
        if tokio::time::timeout(PATIENCE, self.tasks.wait())
            .await
            .is_err()
        {
            tracing::warn!("calibrations do not end and are left behind");
        }
    }
}

fn area(free: &Free, at: [f64; 2]) -> Arc<dyn Region> {
    match free {
        Free::Area(region) => Arc::clone(region),
        Free::Around(half) => Arc::new(Square {
            middle: at,
            half: *half,
        }),
    }
}

/// Why an answer of a robot ends its calibration.
fn ends(response: &Response) -> Option<BrokenOff> {
    let (status, reason) = (response.status, response.reason);
    let is_ours = response
        .source
        .as_ref()
        .is_none_or(|source| source.as_str() == SOURCE);
    if is_ours {
        let matters = match (status, reason) {
            (Open::Known(ResponseStatus::Rejected), _) => true,
            (Open::Known(ResponseStatus::Failed), Some(Open::Known(why))) => {
                !matches!(why, Why::Interrupted | Why::Timeout)
            }
            _ => false,
        };
        let why = reason.map_or_else(|| "it does not say why".to_owned(), |why| why.to_string());
        return matters.then_some(BrokenOff::RobotRefused(why));
    }
    let source = response.source.as_ref()?.as_str();
    let is_obeyed = matches!(
        status,
        Open::Known(ResponseStatus::Accepted | ResponseStatus::Completed)
    );
    (is_obeyed && !HARMLESS.contains(&source)).then(|| BrokenOff::OtherCommand(source.to_owned()))
}

//! The twins of a fleet, and the thread that steps them.

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::io;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crawler_metrics::Exposition;
use crawler_protocol::open::Telemetry;
use crawler_protocol::{PoseFix, RobotId};
use crawler_twin::around::{Robots, Room};
use crawler_twin::certificate::Certificate;
use crawler_twin::detect::{Fault, FaultName};
use crawler_twin::shadow::{Estimate, Forecast, Residual, View};

use crate::folder::{self, Folder, Read, Refusal, judge};
use crate::gap::{FleetGap, RobotGap};
use crate::inbox::{Evidence, Heard, Inbox};
use crate::notice::{Notice, Turn, notices};
use crate::recording::Recording;
use crate::twin::{Clock, Twin};

/// Robots that have a twin at a time, unless somebody says otherwise.
pub const MOST: usize = 1_000;
/// How long evidence waits at most until a twin has it.
const ROUND: Duration = Duration::from_millis(50);
/// How often faults are looked at, and who has gone.
const SWEEP_EVERY: Duration = Duration::from_secs(1);
/// How often certificates are looked for.
const LOOK_EVERY: Duration = Duration::from_secs(10);
/// A robot that nothing is heard of for so long has no twin any more.
const FORGET_AFTER: Duration = Duration::from_mins(10);
/// The same where there is no room for another.
const MAKE_ROOM_AFTER: Duration = Duration::from_secs(30);

/// A gap that was measured is good for so long.
const MEASURE_EVERY: Duration = Duration::from_secs(2);

/// There was no room for more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Full;

/// Why nothing is known of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum NoTwin {
    /// This server keeps none.
    Off,
    /// No tracker has told where it is.
    NoFix,
    /// Nor may it be followed: so many others are.
    NoRoom(usize),
    /// A tracker sees it, and it does not tell what its motors do, or does not know the time.
    NoTelemetry,
    /// It was lost; the next fix will do.
    Lost,
}

impl fmt::Display for NoTwin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Off => f.write_str("this server keeps no twins"),
            Self::NoFix => f.write_str("no tracker has told where the robot is"),
            Self::NoRoom(most) => write!(f, "{most} other robots are followed, which is all there is room for"),
            Self::NoTelemetry => {
                f.write_str("the robot does not tell what its motors do, or does not know the time")
            }
            Self::Lost => f.write_str("the robot was not heard of for a moment; it is followed again from the next fix on"),
        }
    }
}

/// What a twin knows.
#[derive(Debug, Clone)]
pub struct State {
    /// What it says itself.
    pub view: View,
    /// Unix milliseconds of that, by this server's clock.
    pub time_ms: u64,
    /// How long ago that is.
    pub age: Duration,
    /// Whose body it has; `None` for the nominal one.
    pub body: Option<Arc<Certificate>>,
    /// Faults that people were told of, each with Unix milliseconds since when.
    pub faults: Vec<(Fault, u64)>,
    /// Unix milliseconds since when the certificate does not hold any more; `None` where it does.
    pub stale_since_ms: Option<u64>,
    /// What came as evidence and is none.
    pub refused: u64,
}

/// Where a robot is and will be.
#[derive(Debug, Clone)]
pub struct Ahead {
    /// Unix milliseconds of `now`, by this server's clock.
    pub time_ms: u64,
    /// Where it is.
    pub now: Estimate,
    /// Where it will be if its duties stay as they are.
    pub forecasts: Vec<Forecast>,
    /// How far off forecasts were.
    pub errors: Vec<Residual>,
}

/// A certificate that there is of a robot, or of what is in its place.
#[derive(Debug, Clone)]
pub struct Found {
    /// `None` where the file has none.
    pub certificate: Option<Arc<Certificate>>,
    /// Why it is not used.
    pub refusal: Option<Refusal>,
}

/// How it goes.
#[derive(Debug, Clone, Default)]
struct Summary {
    nominal: usize,
    certified: usize,
    faults: BTreeMap<FaultName, usize>,
    refused: u64,
}

/// What is known of robots beside what they and their tracker say of where they are.
pub trait Fleet: Send + Sync + 'static {
    /// Which program a robot says that it runs, where it does.
    fn program(&self, robot: &RobotId) -> Option<String>;

    /// The rooms that robots are in, in their order; `None` where that is not known.
    fn rooms(&self, robots: &[RobotId]) -> Vec<Option<Arc<Room>>>;
}

/// Robots in rooms that nobody knows.
impl<F: Fn(&RobotId) -> Option<String> + Send + Sync + 'static> Fleet for F {
    fn program(&self, robot: &RobotId) -> Option<String> {
        self(robot)
    }

    fn rooms(&self, robots: &[RobotId]) -> Vec<Option<Arc<Room>>> {
        vec![None; robots.len()]
    }
}

/// The twins of a fleet: whoever hears a robot or a tracker tells them, and whoever wants to know asks them. [`Worker`]
/// steps them.
pub struct Twins {
    most: usize,
    clock: Clock,
    inbox: Inbox,
    robots: Mutex<HashMap<RobotId, Arc<Mutex<Twin>>>>,
    certificates: Mutex<Arc<HashMap<RobotId, Read>>>,
    fleet: Box<dyn Fleet>,
    summary: Mutex<Summary>,
    /// The gap that was measured last, and when.
    gap: Mutex<Option<(Instant, Arc<FleetGap>)>>,
    /// Where certificates are.
    folder: PathBuf,
    /// Whether they are to be looked for at once.
    has_new: AtomicBool,
}

/// What steps the twins; there is one.
pub struct Worker {
    twins: Arc<Twins>,
    folder: Folder,
    batch: Vec<Heard>,
    /// Where trackers saw the robots that have twins.
    places: Robots<RobotId>,
    looked: Option<Instant>,
    swept: Option<Instant>,
    /// What came as evidence and was none, of twins that are gone.
    refused: u64,
}

fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Twins {
    /// At most `most` twins, whose certificates are in `folder`, from `begun` on, which is `begun_ms` in Unix
    /// milliseconds; and what steps them. `fleet` tells which program a robot runs, and where.
    pub fn new(
        most: usize,
        folder: PathBuf,
        (begun, begun_ms): (Instant, u64),
        fleet: impl Fleet,
    ) -> (Arc<Self>, Worker) {
        let twins = Arc::new(Self {
            most,
            clock: Clock { begun, begun_ms },
            inbox: Inbox::default(),
            robots: Mutex::default(),
            certificates: Mutex::default(),
            fleet: Box::new(fleet),
            summary: Mutex::default(),
            gap: Mutex::default(),
            folder: folder.clone(),
            has_new: AtomicBool::new(false),
        });
        let worker = Worker {
            twins: Arc::clone(&twins),
            folder: Folder::new(folder),
            batch: Vec::new(),
            places: Robots::default(),
            looked: None,
            swept: None,
            refused: 0,
        };
        (twins, worker)
    }

    /// Whether there are any to be.
    pub const fn are_on(&self) -> bool {
        self.most > 0
    }

    /// Takes what a robot told, without waiting.
    ///
    /// # Errors
    /// [`Full`]; it is let go.
    pub fn telemetry(&self, sample: &Telemetry, arrived: Instant) -> Result<(), Full> {
        // Before its clock is set a robot has no time to tell.
        if !self.are_on() || sample.timestamp == 0 {
            return Ok(());
        }
        let duty = [sample.wheels.left, sample.wheels.right];
        let mv = sample.battery.mv;
        self.put(
            &sample.robot,
            sample.timestamp,
            arrived,
            Evidence::Sample { duty, mv },
        )
    }

    /// Takes where a tracker saw a robot, without waiting.
    ///
    /// # Errors
    /// [`Full`]; it is let go.
    pub fn fix(&self, fix: &PoseFix, arrived: Instant) -> Result<(), Full> {
        if !self.are_on() {
            return Ok(());
        }
        self.put(&fix.robot, fix.timestamp, arrived, Evidence::Fix(fix.pose))
    }

    pub(crate) fn put(
        &self,
        robot: &RobotId,
        timestamp: u64,
        arrived: Instant,
        evidence: Evidence,
    ) -> Result<(), Full> {
        let heard = Heard {
            robot: robot.clone(),
            timestamp,
            arrived,
            evidence,
        };
        if self.inbox.put(heard) {
            Ok(())
        } else {
            Err(Full)
        }
    }

    /// The twin of a robot.
    fn get(&self, robot: &RobotId) -> Result<Arc<Mutex<Twin>>, NoTwin> {
        if !self.are_on() {
            return Err(NoTwin::Off);
        }
        let robots = lock(&self.robots);
        match robots.get(robot) {
            Some(twin) => Ok(Arc::clone(twin)),
            None if robots.len() >= self.most => Err(NoTwin::NoRoom(self.most)),
            None => Err(NoTwin::NoFix),
        }
    }

    /// How long ago the twin's time `at_s` is at `now`.
    fn age(&self, twin: &Twin, at_s: f64, now: Instant) -> Duration {
        let seconds = self.clock.seconds(now) - (at_s + twin.shadow.delay_s());
        Duration::try_from_secs_f64(seconds).unwrap_or_default()
    }

    /// What is known of a robot at `now`, which is `unix_ms`.
    ///
    /// # Errors
    /// [`NoTwin`].
    pub fn state(&self, robot: &RobotId, now: Instant, unix_ms: u64) -> Result<State, NoTwin> {
        let twin = self.get(robot)?;
        let mut twin = lock(&twin);
        let view = twin.shadow.view().ok_or_else(|| reason(&twin))?;
        let age = self.age(&twin, view.at_s, now);
        let before = |moment: Instant| ms(now.saturating_duration_since(moment));
        let faults = twin.told();
        let stale_since_s = view.drift.and_then(|drift| drift.stale_since_s);
        let stale = stale_since_s.map(|at_s| self.age(&twin, at_s, now));
        Ok(State {
            stale_since_ms: stale.map(|age| unix_ms.saturating_sub(ms(age))),
            time_ms: unix_ms.saturating_sub(ms(age)),
            age,
            faults: faults
                .map(|alarm| (alarm.fault, unix_ms.saturating_sub(before(alarm.since))))
                .collect(),
            body: twin.body.clone(),
            refused: twin.refused,
            view,
        })
    }

    /// Where a robot is at `now`, which is `unix_ms`, and will be.
    ///
    /// # Errors
    /// [`NoTwin`].
    pub fn forecast(&self, robot: &RobotId, now: Instant, unix_ms: u64) -> Result<Ahead, NoTwin> {
        let twin = self.get(robot)?;
        let mut twin = lock(&twin);
        let view = twin.shadow.view().ok_or_else(|| reason(&twin))?;
        let age = self.age(&twin, view.at_s, now);
        Ok(Ahead {
            time_ms: unix_ms.saturating_sub(ms(age)),
            now: view.now,
            forecasts: twin.shadow.forecast(),
            errors: view.residuals,
        })
    }

    /// How far bodies and robots are apart at `now`, which is `unix_ms`. Whoever asks within two seconds of somebody
    /// else is told the same: it takes a tenth of a second of a thousand robots.
    ///
    /// # Errors
    /// [`NoTwin::Off`].
    pub fn gap(&self, now: Instant, unix_ms: u64) -> Result<Arc<FleetGap>, NoTwin> {
        if !self.are_on() {
            return Err(NoTwin::Off);
        }
        let mut known = lock(&self.gap);
        if let Some((at, gap)) = &*known
            && now.saturating_duration_since(*at) < MEASURE_EVERY
        {
            return Ok(Arc::clone(gap));
        }
        let robots = self.all().into_iter().map(|(robot, twin)| {
            // Whoever steps it waits while its numbers are copied, and not while they are looked at.
            let twin = lock(&twin);
            let samples = twin.shadow.gap().clone();
            let since = samples.since_s().map(|at_s| self.age(&twin, at_s, now));
            let body = twin.body.clone();
            drop(twin);
            let gap = RobotGap {
                robot,
                body,
                since_ms: since.map(|age| unix_ms.saturating_sub(ms(age))),
                measures: samples.measure(),
            };
            (gap, samples)
        });
        let gap = Arc::new(FleetGap::of(robots.collect(), unix_ms));
        *known = Some((now, Arc::clone(&gap)));
        Ok(gap)
    }

    fn all(&self) -> Vec<(RobotId, Arc<Mutex<Twin>>)> {
        let robots = lock(&self.robots);
        let all = robots.iter();
        all.map(|(robot, twin)| (robot.clone(), Arc::clone(twin)))
            .collect()
    }

    /// What there is in the place of the certificate of a robot; `None` where there is nothing.
    pub fn certificate(&self, robot: &RobotId, unix_ms: u64) -> Option<Found> {
        let certificates = Arc::clone(&lock(&self.certificates));
        let read = certificates.get(robot)?;
        let program = self.fleet.program(robot);
        Some(Found {
            certificate: read.as_ref().ok().cloned(),
            refusal: judge(read, program.as_deref(), unix_ms).err(),
        })
    }

    /// Keeps what is heard of a robot from now on, until it is dropped or somebody else keeps it.
    ///
    /// # Errors
    /// [`NoTwin`].
    pub fn record(&self, robot: &RobotId) -> Result<Recording, NoTwin> {
        let twin = self.get(robot)?;
        let recording = lock(&twin).record();
        Ok(recording)
    }

    /// A moment by the clock of twins, seconds: that of the evidence that [`Self::record`] keeps.
    pub fn seconds(&self, at: Instant) -> f64 {
        self.clock.seconds(at)
    }

    /// Puts a certificate in its place, for good when this returns; its robot's twin goes on with it.
    ///
    /// # Errors
    /// The disk does not take it; what was there stays.
    pub fn certify(&self, certificate: &Certificate) -> io::Result<()> {
        folder::put(&self.folder, certificate)?;
        self.has_new.store(true, Ordering::Release);
        Ok(())
    }

    /// The body that the twin of a robot is to have.
    fn body(&self, robot: &RobotId, unix_ms: u64) -> Option<Arc<Certificate>> {
        let found = self.certificate(robot, unix_ms)?;
        found.certificate.filter(|_| found.refusal.is_none())
    }

    /// How it goes.
    pub fn write_metrics(&self, out: &mut Exposition) {
        let summary = lock(&self.summary).clone();
        out.gauges(
            "terracrawler_twins",
            "Robots that are followed by a twin, by its body",
            "body",
            [
                ("nominal", summary.nominal),
                ("certificate", summary.certified),
            ],
        );
        let count = |name: FaultName| summary.faults.get(&name).copied().unwrap_or(0);
        out.gauges(
            "terracrawler_twin_faults",
            "Robots that their twin finds something wrong with, by what",
            "fault",
            FaultName::ALL.map(|name| (name.name(), count(name))),
        );
        out.counter(
            "terracrawler_twin_evidence",
            "Samples of robots and fixes of trackers that twins have heard",
            self.inbox.taken() as f64,
        );
        out.counter(
            "terracrawler_twin_evidence_refused",
            "Those of them that are no evidence: doubled, out of range, or of a clock that was set",
            summary.refused as f64,
        );
        out.gauge(
            "terracrawler_twin_evidence_waiting",
            "Samples and fixes that twins do not have yet",
            self.inbox.len() as f64,
        );
    }
}

impl fmt::Debug for Twins {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = lock(&self.robots).len();
        f.debug_struct("Twins")
            .field("count", &count)
            .finish_non_exhaustive()
    }
}

fn ms(span: Duration) -> u64 {
    u64::try_from(span.as_millis()).unwrap_or(u64::MAX)
}

/// Why a twin knows nothing.
fn reason(twin: &Twin) -> NoTwin {
    if twin.shadow.has_duties() {
        NoTwin::Lost
    } else {
        NoTwin::NoTelemetry
    }
}

impl Worker {
    /// Steps the twins until `stops`, and tells what there is to tell.
    pub fn run(
        mut self,
        stops: impl Fn() -> bool,
        unix_ms: impl Fn() -> u64,
        tell: impl Fn(Vec<Notice>),
    ) {
        while !stops() {
            let notices = self.step(Instant::now(), unix_ms());
            if !notices.is_empty() {
                tell(notices);
            }
            std::thread::sleep(ROUND);
        }
    }

    /// One round, at `now`, which is `unix_ms`: hears what waits, and does what is due. Returns what there is to tell.
    pub fn step(&mut self, now: Instant, unix_ms: u64) -> Vec<Notice> {
        let is_due = |last: Option<Instant>, every: Duration| {
            last.is_none_or(|last| now.saturating_duration_since(last) >= every)
        };
        let mut turns = Vec::new();
        let has_new = self.twins.has_new.swap(false, Ordering::AcqRel);
        if has_new || is_due(self.looked, LOOK_EVERY) {
            self.looked = Some(now);
            self.look(unix_ms, &mut turns);
        }
        let mut batch = std::mem::take(&mut self.batch);
        self.twins.inbox.swap(&mut batch);
        for heard in &batch {
            self.hear(heard, unix_ms);
        }
        self.batch = batch;
        if is_due(self.swept, SWEEP_EVERY) {
            self.swept = Some(now);
            self.sweep(now, &mut turns);
        }
        notices(turns)
    }

    fn hear(&mut self, heard: &Heard, unix_ms: u64) {
        let twins = &self.twins;
        let known = lock(&twins.robots).get(&heard.robot).cloned();
        let twin = match (known, heard.evidence) {
            (Some(twin), _) => twin,
            (None, Evidence::Fix(_)) => {
                // Whose telemetry alone is heard cannot be followed.
                if lock(&twins.robots).len() >= twins.most {
                    return;
                }
                let body = twins.body(&heard.robot, unix_ms);
                let robots = std::slice::from_ref(&heard.robot);
                let room = twins.fleet.rooms(robots).pop().flatten();
                let twin = Arc::new(Mutex::new(Twin::new(body, room, heard.arrived)));
                lock(&twins.robots).insert(heard.robot.clone(), Arc::clone(&twin));
                twin
            }
            (None, Evidence::Sample { .. }) => return,
        };
        let mut twin = lock(&twin);
        if let Evidence::Fix(pose) = heard.evidence {
            let at = [pose.x, pose.y].map(f64::from);
            let at_s = twins.clock.seconds(heard.arrived);
            self.places.see(&heard.robot, at, at_s);
            twin.near(at, self.places.is_near(&heard.robot, at, at_s));
        }
        twin.take(heard, &twins.clock);
    }

    /// Looks for certificates, and gives twins the bodies that they are to have.
    fn look(&mut self, unix_ms: u64, turns: &mut Vec<(RobotId, Turn)>) {
        if self.folder.look() {
            *lock(&self.twins.certificates) = Arc::new(self.folder.all());
        }
        for (robot, twin) in self.twins.all() {
            let body = self.twins.body(&robot, unix_ms);
            let mut twin = lock(&twin);
            if twin.body != body {
                let lost = twin.set_body(body).into_iter();
                turns.extend(lost.map(|turn| (robot.clone(), turn)));
            }
        }
    }

    /// Looks at faults, and forgets who has gone.
    fn sweep(&mut self, now: Instant, turns: &mut Vec<(RobotId, Turn)>) {
        let all = self.twins.all();
        let patience = if all.len() >= self.twins.most {
            MAKE_ROOM_AFTER
        } else {
            FORGET_AFTER
        };
        let mut summary = Summary::default();
        let robots: Vec<RobotId> = all.iter().map(|(robot, _)| robot.clone()).collect();
        let rooms = self.twins.fleet.rooms(&robots);
        for ((robot, twin), room) in all.into_iter().zip(rooms) {
            let mut twin = lock(&twin);
            let gone = now.saturating_duration_since(twin.heard) >= patience;
            let found = if gone { twin.end() } else { twin.look(now) };
            turns.extend(found.into_iter().map(|turn| (robot.clone(), turn)));
            if gone {
                self.refused += twin.refused;
                lock(&self.twins.robots).remove(&robot);
                self.places.forget(&robot);
                continue;
            }
            twin.room = room;
            summary.refused += twin.refused;
            match twin.body {
                Some(_) => summary.certified += 1,
                None => summary.nominal += 1,
            }
            for alarm in twin.told() {
                *summary.faults.entry(alarm.fault.fault).or_default() += 1;
            }
        }
        summary.refused += self.refused;
        *lock(&self.twins.summary) = summary;
    }
}

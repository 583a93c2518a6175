//! What was recorded of a moment: where robots were, before it and after, and what they were told.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::Arc;

use crawler_database::RecordsError;
use crawler_history::{Frame, HistoryError, HistoryStore, Point, Track};
use crawler_protocol::{Action, BehaviourName, RobotId, RobotState};
use crawler_records::{Entry, MAX_AUDIT_PAGE, Records};
use crawler_sim::world::{Arena, Pose};
use crawler_twin::body::wrap;
use crawler_twin::certificate::Certificate;
use crawler_twin::evidence::{Duty, Evidence, Fix, Row, Supply};

use crate::question::{Question, STEP_MS, TooMuch, moves};

/// The certificate of a robot, where there is one that may be used.
pub type Certificates = dyn Fn(&RobotId) -> Option<Arc<Certificate>> + Send + Sync;

/// How long before the moment worlds begin: by then wheels turn as they did.
pub(crate) const LEAD_MS: i64 = 3_000;
/// Nothing is recorded later, Unix milliseconds: in the year 9999.
const LAST_MS: i64 = 253_402_300_000_000;
/// Between points that are farther from each other nobody knows where a robot was.
const GAP_MS: i64 = 2_000;
/// How finely it is read how robots moved.
const FINE_MS: i64 = 50;
/// The same for who was there at all.
const COARSE_MS: i64 = 1_000;
/// What a robot did so long before the moment says something of its body and of its pack.
const BEFORE_MS: i64 = 90_000;
/// How finely that is read: as often as robots tell, or more.
const TOLD_MS: i64 = 100;
/// One standard deviation of where a robot takes itself to be, metres.
const OWN_SIGMA_M: f64 = 0.02;
/// Entries of the audit log that are looked through for what robots were told.
const MOST_ENTRIES: usize = 20_000;

/// Something that a robot was told.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Order {
    /// Milliseconds after the moment.
    pub(crate) at_ms: i64,
    pub(crate) action: Action,
}

/// What was recorded of a robot.
#[derive(Debug, Clone)]
pub(crate) struct PastRobot {
    pub(crate) robot: RobotId,
    /// Where it was when worlds begin.
    pub(crate) begin: Pose,
    /// Where it was at the moment.
    pub(crate) there: Pose,
    /// From the moment on, a point every step.
    pub(crate) path: Vec<Option<Pose>>,
    /// What it was told: the last before worlds begin, and all that came later.
    pub(crate) orders: Vec<Order>,
    /// Whether it moved although nobody is known to have told it to.
    pub(crate) supposed: bool,
    /// Of its pack at the moment by its own words, 0 to 1.
    pub(crate) charge: f32,
    /// What it did before the moment, whose stamps are seconds from there.
    pub(crate) before: Evidence,
    /// Whose body it has.
    pub(crate) certificate: Option<Arc<Certificate>>,
}

/// What was recorded.
#[derive(Debug, Clone)]
pub(crate) struct Past {
    /// The arena of the moment, where it was a simulated one.
    pub(crate) arena: Option<Arena>,
    /// In the order of their names.
    pub(crate) robots: Vec<PastRobot>,
}

/// Why nothing can be asked of the past.
#[derive(Debug)]
#[non_exhaustive]
pub enum Unreadable {
    /// Nothing is recorded of the moment, or not of these robots.
    Nothing {
        /// A robot that is asked about, and was not there.
        robot: Option<RobotId>,
    },
    /// It takes too long.
    TooMuch(TooMuch),
    /// The history cannot be read.
    History(HistoryError),
    /// The records cannot be read.
    Records(RecordsError),
}

impl fmt::Display for Unreadable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nothing { robot: Some(robot) } => {
                write!(f, "nothing is recorded of {robot} at that moment")
            }
            Self::Nothing { robot: None } => f.write_str("nothing is recorded of that moment"),
            Self::TooMuch(error) => error.fmt(f),
            Self::History(_) => f.write_str("the history cannot be read"),
            Self::Records(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for Unreadable {}

impl From<HistoryError> for Unreadable {
    fn from(error: HistoryError) -> Self {
        Self::History(error)
    }
}

impl From<RecordsError> for Unreadable {
    fn from(error: RecordsError) -> Self {
        Self::Records(error)
    }
}

/// Reads what was recorded of the moment of a question.
pub(crate) async fn read(
    question: &Question,
    (history, records): (&HistoryStore, &Records),
    certificates: &Certificates,
) -> Result<Past, Unreadable> {
    let at = question.at_ms;
    if !(0..LAST_MS).contains(&at) {
        return Err(Unreadable::Nothing { robot: None });
    }
    let known = history.robots().await?;
    let around = ((at - LEAD_MS - GAP_MS).max(0), at + GAP_MS);
    let coarse = history
        .frames(&known, around.0, around.1, COARSE_MS)
        .await?;
    let there = coarse.iter().filter_map(|track| {
        let frame = nearest(&track.frames, at)?;
        Some((track.robot.clone(), [frame.x, frame.y]))
    });
    let chosen = choose(question, &there.collect())?;
    let end = at + i64::from(question.seconds) * 1_000;
    let tracks = history
        .frames(&chosen, around.0, end + GAP_MS, FINE_MS)
        .await?;
    let orders = orders(records, at, end, &chosen).await?;
    let arena = records.arenas().at(at).await?;
    let arena = arena.and_then(|text| serde_json::from_str(&text).ok());
    let mut robots = Vec::new();
    for track in &tracks {
        let from = (at - BEFORE_MS).max(0);
        let points = history.query(&track.robot, from, at, TOLD_MS).await?;
        robots.extend(robot(track, &points, question, &orders, certificates));
    }
    let is_there = |robot: &&RobotId| robots.iter().any(|past| past.robot == **robot);
    let missing = question
        .robots
        .iter()
        .flatten()
        .find(|robot| !is_there(robot));
    if missing.is_some() || robots.is_empty() {
        let robot = missing.cloned();
        return Err(Unreadable::Nothing { robot });
    }
    Ok(Past { arena, robots })
}

/// The point that is nearest to a time, where one is near.
fn nearest(frames: &[Frame], at: i64) -> Option<&Frame> {
    let nearest = frames.iter().min_by_key(|frame| (frame.at - at).abs())?;
    ((nearest.at - at).abs() <= GAP_MS).then_some(nearest)
}

/// The robots of a world: those that are asked about, and as many others near them as there is room for.
fn choose(
    question: &Question,
    there: &BTreeMap<RobotId, [f32; 2]>,
) -> Result<BTreeSet<RobotId>, Unreadable> {
    let asked: BTreeSet<&RobotId> = match &question.robots {
        Some(robots) => robots.iter().collect(),
        None => there.keys().collect(),
    };
    if let Some(robot) = asked.iter().find(|robot| !there.contains_key(**robot)) {
        let robot = Some((*robot).clone());
        return Err(Unreadable::Nothing { robot });
    }
    let most = question.room();
    if asked.len() > most {
        let robots = asked.len();
        return Err(Unreadable::TooMuch(TooMuch { robots, most }));
    }
    let places: Vec<[f32; 2]> = asked.iter().map(|robot| there[*robot]).collect();
    let mut others: Vec<(f32, &RobotId)> = there
        .iter()
        .filter(|(robot, _)| !asked.contains(robot))
        .map(|(robot, at)| {
            let distances = places.iter().map(|to| (at[0] - to[0]).hypot(at[1] - to[1]));
            (distances.fold(f32::INFINITY, f32::min), robot)
        })
        .collect();
    others.sort_by(|one, other| one.0.total_cmp(&other.0));
    let near = others.into_iter().take(most - asked.len());
    let near = near.map(|(_, robot)| robot);
    Ok(asked.into_iter().chain(near).cloned().collect())
}

fn robot(
    track: &Track,
    points: &[Point],
    question: &Question,
    orders: &BTreeMap<RobotId, Vec<Order>>,
    certificates: &Certificates,
) -> Option<PastRobot> {
    let at = question.at_ms;
    let there = between(&track.frames, at)?;
    let charge = nearest(&track.frames, at)?.battery_percent;
    let steps = 0..question.points() as i64;
    let path = steps.map(|point| between(&track.frames, at + point * i64::from(STEP_MS)));
    let mut told = orders.get(&track.robot).cloned().unwrap_or_default();
    let begun = told.first().is_some_and(|order| order.at_ms <= -LEAD_MS);
    let moved = nearest(&track.frames, at - LEAD_MS).is_some_and(|frame| is_moving(frame.state));
    let supposed = !begun && moved;
    if supposed {
        let action = wander()?;
        let at_ms = -LEAD_MS;
        told.insert(0, Order { at_ms, action });
    }
    Some(PastRobot {
        robot: track.robot.clone(),
        begin: between(&track.frames, at - LEAD_MS).unwrap_or(there),
        there,
        path: path.collect(),
        orders: told,
        supposed,
        charge: (charge * 0.01).clamp(0.0, 1.0),
        before: before(points, at),
        certificate: certificates(&track.robot),
    })
}

/// What a robot did, as a twin takes it.
fn before(points: &[Point], at: i64) -> Evidence {
    let mut evidence = Evidence::default();
    // What is refused counts for nothing.
    let mut take = |row| {
        let _ = evidence.take(row);
    };
    for point in points {
        let (at_s, arrived_s) = ((point.at - at) as f64 * 1e-3, None);
        take(Row::Duty(Duty {
            at_s,
            arrived_s,
            duty: [point.left, point.right].map(f64::from),
        }));
        take(Row::Fix(Fix {
            at_s,
            arrived_s,
            x: f64::from(point.x),
            y: f64::from(point.y),
            theta: f64::from(point.theta),
            sigma_m: OWN_SIGMA_M,
        }));
        let volts = f64::from(point.battery_mv.mean) * 1e-3;
        // A robot that has not measured it says 0.
        if volts > 0.0 {
            take(Row::Supply(Supply {
                at_s,
                arrived_s,
                volts,
            }));
        }
    }
    evidence
}

/// Whether a robot in this state is on its way.
const fn is_moving(state: RobotState) -> bool {
    matches!(
        state,
        RobotState::Moving | RobotState::Caution | RobotState::Avoiding
    )
}

/// What a robot is supposed to do that moves, and that nobody has told to.
fn wander() -> Option<Action> {
    let name = BehaviourName::Wander.name();
    let text = format!(r#"{{"command":"behave","parameters":{{"behaviour":"{name}"}}}}"#);
    Action::parse(text.as_bytes()).ok()
}

/// Where a robot was, between the points before and after; `None` across a gap.
fn between(frames: &[Frame], at: i64) -> Option<Pose> {
    let next = frames.partition_point(|frame| frame.at <= at);
    let before = &frames[next.checked_sub(1)?];
    let pose = |frame: &Frame| Pose::new(frame.x, frame.y, frame.theta);
    let Some(after) = frames
        .get(next)
        .filter(|after| after.at - before.at <= GAP_MS)
    else {
        return (at - before.at <= GAP_MS / 2).then(|| pose(before));
    };
    let share = (at - before.at) as f32 / (after.at - before.at) as f32;
    let blend = |one: f32, other: f32| one + (other - one) * share;
    let turn = wrap(f64::from(after.theta - before.theta)) as f32;
    Some(Pose::new(
        blend(before.x, after.x),
        blend(before.y, after.y),
        wrap(f64::from(before.theta + turn * share)) as f32,
    ))
}

/// What robots were told, by the audit log: the last thing before worlds begin, and all that came until the end.
async fn orders(
    records: &Records,
    at: i64,
    end: i64,
    robots: &BTreeSet<RobotId>,
) -> Result<BTreeMap<RobotId, Vec<Order>>, RecordsError> {
    let mut known = Orders::new(robots, at, end);
    let (mut before, mut read) = (None, 0);
    loop {
        let page = records.audit().page(before, MAX_AUDIT_PAGE, None).await?;
        read += page.len();
        let full = page.len() == MAX_AUDIT_PAGE as usize;
        before = page.last().map(|stored| stored.seq);
        for stored in &page {
            known.add(&stored.entry);
        }
        if known.is_whole() || !full || read >= MOST_ENTRIES {
            return Ok(known.all());
        }
    }
}

/// What robots were told, from the newest on.
pub(crate) struct Orders {
    at: i64,
    end: i64,
    /// Newest first.
    all: BTreeMap<RobotId, Vec<Order>>,
}

impl Orders {
    pub(crate) fn new(robots: &BTreeSet<RobotId>, at: i64, end: i64) -> Self {
        let none = robots.iter().map(|robot| (robot.clone(), Vec::new()));
        Self {
            at,
            end,
            all: none.collect(),
        }
    }

    /// Takes in an entry that is older than those before.
    pub(crate) fn add(&mut self, entry: &Entry) {
        if entry.action != "command.send" || entry.outcome != "ok" || entry.at >= self.end {
            return;
        }
        let Some(action) = action(&entry.detail["request"]) else {
            return;
        };
        let at_ms = entry.at - self.at;
        let swarm = entry.target == "swarm";
        for (robot, orders) in &mut self.all {
            let told = swarm || robot.as_str() == entry.target;
            if told && !begun(orders) {
                let action = action.clone();
                orders.push(Order { at_ms, action });
            }
        }
    }

    /// Whether there is nothing older that counts.
    pub(crate) fn is_whole(&self) -> bool {
        self.all.values().all(|orders| begun(orders))
    }

    /// All of it, oldest first.
    pub(crate) fn all(mut self) -> BTreeMap<RobotId, Vec<Order>> {
        self.all.values_mut().for_each(|orders| orders.reverse());
        self.all
    }
}

/// Whether what a robot does when worlds begin is known.
fn begun(orders: &[Order]) -> bool {
    orders.last().is_some_and(|order| order.at_ms <= -LEAD_MS)
}

/// A command that makes a difference to where a robot is.
fn action(request: &serde_json::Value) -> Option<Action> {
    let action = Action::parse(request.to_string().as_bytes()).ok()?;
    moves(&action).then_some(action)
}

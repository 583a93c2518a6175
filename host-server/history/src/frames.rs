//! Where many robots were over a stretch of time, in one pass.

use std::collections::{BTreeSet, HashMap, HashSet};
use std::sync::atomic::Ordering;

use crawler_database::{Boxed, Db, RecordsError};
use crawler_protocol::{RobotId, RobotState};

use super::fold::{self, Bucket};
use super::memory::{Memory, Shared};
use super::points::Stretch;
use super::query::{PAGE, level};
use super::{Point, codec, numbered_state, retention};

/// Most frames in one answer, of all robots together; those that step and beginning add at the ends are
/// not counted.
pub const MAX_FRAMES: usize = 600_000;
/// When at least one of so many robots is asked for, all are read: one pass in the order of time is so
/// much faster than one for each robot.
const ONE_PASS: usize = 8;

/// Where a robot was in a stretch of time, and how it was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// When the stretch begins; a multiple of the step.
    pub at: i64,
    /// Mean, in metres along the x axis.
    pub x: f32,
    /// Mean, in metres along the y axis.
    pub y: f32,
    /// Last heading, in radians.
    pub theta: f32,
    /// The last state.
    pub state: RobotState,
    /// Mean distance to what was ahead; none if none of the samples had one.
    pub range_mm: Option<f32>,
    /// Mean charge of the battery.
    pub battery_percent: f32,
}

impl From<&Point> for Frame {
    fn from(point: &Point) -> Self {
        Self {
            at: point.at,
            x: point.x,
            y: point.y,
            theta: point.theta,
            state: point.state,
            range_mm: point.range_mm.map(|range| range.mean),
            battery_percent: point.battery_percent.mean,
        }
    }
}

/// Where one robot was over time.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    /// The robot.
    pub robot: RobotId,
    /// Oldest first; at least one.
    pub frames: Vec<Frame>,
}

/// A frame while it is put together: sums, since there are many and each is to be small.
#[derive(Debug, Clone, Copy, Default)]
struct Cell {
    count: f64,
    /// Time of what `theta` and `state` are from.
    latest: i64,
    theta: i64,
    state: i64,
    x: f64,
    y: f64,
    percent: f64,
    /// Samples with a range.
    seen: f64,
    range: f64,
}

impl Cell {
    fn add(&mut self, bucket: &Bucket) {
        let [
            at,
            count,
            x,
            y,
            theta,
            _,
            _,
            _,
            _,
            _,
            percent,
            _,
            _,
            no_range,
            range,
            ..,
            state,
        ] = *bucket;
        if count <= 0 {
            return;
        }
        if self.count == 0.0 || at >= self.latest {
            (self.latest, self.theta, self.state) = (at, theta, state);
        }
        // In floating point, since what comes out of a damaged file may be any number.
        let weight = count as f64;
        self.count += weight;
        self.x += x as f64 * weight;
        self.y += y as f64 * weight;
        self.percent += percent as f64 * weight;
        let seen = count.saturating_sub(no_range).max(0) as f64;
        self.seen += seen;
        self.range += range as f64 * seen;
    }

    fn frame(&self, at: i64) -> Option<Frame> {
        (self.count > 0.0).then(|| Frame {
            at,
            x: (self.x / self.count / 1_000.0) as f32,
            y: (self.y / self.count / 1_000.0) as f32,
            theta: (self.theta as f64 / 1_000.0) as f32,
            state: numbered_state(self.state),
            range_mm: (self.seen > 0.0).then(|| (self.range / self.seen) as f32),
            battery_percent: (self.percent / self.count) as f32,
        })
    }
}

/// The answer while it is put together, by the number of the robot. A robot without a sample has no
/// cells.
struct Grid {
    stretch: Stretch,
    tracks: HashMap<i64, (RobotId, Vec<Cell>)>,
}

impl Grid {
    fn add(&mut self, robot: i64, bucket: &Bucket) {
        let Some(place) = self.stretch.place(bucket[0]) else {
            return;
        };
        let Some((_, cells)) = self.tracks.get_mut(&robot) else {
            return;
        };
        if cells.is_empty() {
            cells.resize(self.stretch.places, Cell::default());
        }
        if let Some(cell) = cells.get_mut(place) {
            cell.add(bucket);
        }
    }

    /// Adds what is in no block, and returns which blocks must be left out for that: those from the
    /// first number on, and these.
    fn add_open(&mut self, memory: &Memory, level: usize) -> (i64, HashSet<i64>) {
        let mut but = HashSet::new();
        if level == 2 {
            for (&robot, minutes) in &memory.minutes {
                but.insert(minutes.block);
                for minute in &minutes.rows {
                    self.add(robot, minute);
                }
            }
        }
        let sealing = memory.sealing.iter().flat_map(|lots| lots.iter());
        for (&robot, lot) in sealing.chain(&memory.open) {
            if !self.tracks.contains_key(&robot) {
                continue;
            }
            for raw in lot {
                if self.stretch.place(raw[0]).is_some() {
                    self.add(robot, &fold::bucket(raw));
                }
            }
        }
        let below = if memory.keeper {
            memory.next_block
        } else {
            i64::MAX
        };
        (below, but)
    }

    fn finish(self) -> Vec<Track> {
        let stretch = self.stretch;
        let mut tracks: Vec<Track> = self
            .tracks
            .into_values()
            .filter(|(_, cells)| !cells.is_empty())
            .map(|(robot, cells)| {
                let frames = cells.iter().enumerate();
                let frames = frames.filter_map(|(place, cell)| cell.frame(stretch.at(place)));
                Track {
                    robot,
                    frames: frames.collect(),
                }
            })
            .filter(|track| !track.frames.is_empty())
            .collect();
        tracks.sort_by(|one, other| one.robot.cmp(&other.robot));
        tracks
    }
}

/// All robots that are known, and their numbers.
pub(super) fn named<'a>(
    shared: &'a Shared,
    db: &'a Db,
) -> Boxed<'a, Result<HashMap<RobotId, i64>, RecordsError>> {
    Box::pin(async move {
        {
            let memory = shared.memory();
            if memory.keeper {
                return Ok(memory.numbers.clone());
            }
        }
        let rows: Vec<(String, i64)> = db
            .read(|connection| {
                Box::pin(async move {
                    Ok(sqlx::query_as("SELECT name, id FROM robot")
                        .fetch_all(connection)
                        .await?)
                })
            })
            .await?;
        let names = rows.into_iter();
        // A name that is none has been counted as damage by who keeps the history.
        Ok(names
            .filter_map(|(name, number)| Some((name.parse().ok()?, number)))
            .collect())
    })
}

pub(super) fn frames<'a>(
    shared: &'a Shared,
    db: &'a Db,
    robots: &'a BTreeSet<RobotId>,
    (from, to, step): (i64, i64, i64),
) -> Boxed<'a, Result<Vec<Track>, RecordsError>> {
    Box::pin(async move {
        let level = level(step, from, retention::now());
        let stretch = Stretch::at_level(from, to, step, level)?;
        let mut known = named(shared, db).await?;
        let all = known.len();
        known.retain(|robot, _| robots.contains(robot));
        if known.len().saturating_mul(((to - from) / step) as usize) > MAX_FRAMES {
            return Err(RecordsError::Invalid(
                "an answer about robots has at most 600000 frames: ask for fewer robots or a longer step",
            ));
        }
        let asked: Vec<i64> = known.values().copied().collect();
        let mut grid = Grid {
            stretch,
            tracks: known
                .into_iter()
                .map(|(robot, number)| (number, (robot, Vec::new())))
                .collect(),
        };
        // One moment: what is in memory then is not in the blocks that may be read, and the reverse.
        let (below, but) = grid.add_open(&shared.memory(), level);
        let pages = Pages {
            shared,
            db,
            level,
            from: stretch.from,
            to,
            below,
            but,
        };
        if asked.len().saturating_mul(ONE_PASS) >= all {
            pages.read(None, &mut grid).await?;
        } else {
            for robot in asked {
                pages.read(Some(robot), &mut grid).await?;
            }
        }
        Ok(grid.finish())
    })
}

/// Reads blocks page by page.
struct Pages<'a> {
    shared: &'a Shared,
    db: &'a Db,
    level: usize,
    from: i64,
    to: i64,
    below: i64,
    but: HashSet<i64>,
}

/// Last, first and number of a block, its robot, and what is in it.
type Row = (i64, i64, i64, i64, Vec<u8>);

// Each in the order of its index, so that the next page goes on where one ends.
const OF_ONE: &str = "SELECT last, first, id, robot, data FROM block
    WHERE level = ?1 AND first < ?2 AND id < ?3 AND robot = ?8
    AND (last, first, id) > (?4, ?5, ?6) ORDER BY last, first, id LIMIT ?7";
const OF_ALL: &str = "SELECT last, first, id, robot, data FROM block
    WHERE level = ?1 AND first < ?2 AND id < ?3
    AND (last, id) > (?4, ?5) ORDER BY last, id LIMIT ?6";

impl Pages<'_> {
    /// All blocks of `robot`, or of everybody, into `grid`.
    async fn read(&self, robot: Option<i64>, grid: &mut Grid) -> Result<(), RecordsError> {
        let (mut last, mut first, mut id) = (self.from, i64::MIN, i64::MIN);
        loop {
            let (level, to, below) = (self.level as i64, self.to, self.below);
            let rows: Vec<Row> = self
                .db
                .read(move |connection| {
                    Box::pin(async move {
                        let sql = if robot.is_some() { OF_ONE } else { OF_ALL };
                        let page = sqlx::query_as(sql)
                            .bind(level)
                            .bind(to)
                            .bind(below)
                            .bind(last);
                        let page = match robot {
                            Some(robot) => page.bind(first).bind(id).bind(PAGE).bind(robot),
                            None => page.bind(id).bind(PAGE),
                        };
                        Ok(page.fetch_all(connection).await?)
                    })
                })
                .await?;
            let Some(end) = rows.last() else { break };
            (last, first, id) = (end.0, end.1, end.2);
            for (.., id, robot, data) in &rows {
                if !self.but.contains(id) {
                    self.take(*robot, data, grid);
                }
            }
            if (rows.len() as i64) < PAGE {
                break;
            }
        }
        Ok(())
    }

    fn take(&self, robot: i64, data: &[u8], grid: &mut Grid) {
        if !grid.tracks.contains_key(&robot) {
            return;
        }
        let read = if self.level == 0 {
            codec::decode(data, |raw| grid.add(robot, &fold::bucket(raw)))
        } else {
            codec::decode(data, |bucket| grid.add(robot, bucket))
        };
        if read.is_none() {
            self.shared.counts.damaged.fetch_add(1, Ordering::Relaxed);
        }
    }
}

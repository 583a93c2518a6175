//! Rollouts as the API shows them.

use std::collections::BTreeMap;

use crawler_protocol::RobotId;
use crawler_records::{KeptRollout, MAX_ROLLOUT_PAGE};
use crawler_updates::rollout::{
    Busy, Code, CommandError, Counts, Document, Happening, PauseReason, Plan, Reason, ReleaseId,
    RobotRow, Rollout, RolloutState, UpdateState,
};
use serde::Serialize;
use utoipa::ToSchema;

use crate::control::RolloutError;
use crate::{Rollouts, step};

/// Lines of the log of a rollout that are shown.
const LOG: u32 = 100;

/// A rollout.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Rollout)]
pub struct RolloutView {
    /// Its id.
    pub id: String,
    /// Who asked for it.
    pub by: String,
    /// When, in Unix milliseconds.
    pub made: i64,
    /// When it ended, in Unix milliseconds.
    pub ended: Option<i64>,
    /// The server that carries it out.
    pub server: String,
    /// `running`, `paused`, `aborting`, `aborted` or `done`.
    pub state: &'static str,
    /// Why it is paused: `person`, `failures` or `threshold`.
    pub reason: Option<PauseReason>,
    /// The phase that is served, from 1.
    pub phase: u32,
    /// What it is to do.
    pub plan: Plan,
    /// How far it is, in numbers: for each phase and for all robots by state. Of one rollout alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub counts: Option<Counts>,
    /// What has happened, oldest first: the last 100 lines. Of one rollout alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub log: Option<Vec<LogLine>>,
}

/// Some rollouts.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct RolloutPage {
    /// Newest first.
    pub rollouts: Vec<RolloutView>,
    /// Behind which number there are more.
    pub next: Option<i64>,
}

/// Something that has happened in a rollout.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = RolloutLogLine)]
pub struct LogLine {
    /// Unix milliseconds.
    pub at: i64,
    /// What: `started`, `phase_began`, `paused` and so on.
    pub what: &'static str,
    /// The phase, from 1, where it is about one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub phase: Option<u32>,
    /// Why, where it was paused.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<PauseReason>,
}

/// Where a robot of a rollout stands.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = RolloutRobot)]
pub struct Robot {
    /// The robot.
    #[schema(value_type = String)]
    pub robot: RobotId,
    /// Where it stands.
    pub state: UpdateState,
    /// Why: a word, or an object with one field.
    pub reason: Option<Reason>,
    /// The release that is for it.
    #[schema(value_type = Option<String>)]
    pub release: Option<ReleaseId>,
    /// The phase that it belongs to, from 1.
    pub phase: Option<u32>,
    /// Attempts that have failed since somebody last asked for one.
    pub attempts: u32,
    /// How often it was offered the release.
    pub offers: u32,
    /// Bytes of the image that it has.
    pub received: u32,
    /// Bytes of the image.
    pub bytes: Option<u32>,
    /// Since when it stands there, in Unix milliseconds.
    pub since: i64,
}

/// A robot of a rollout, and what has happened to it.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = RolloutRobotDetail)]
pub struct RobotDetail {
    /// Where it stands.
    #[serde(flatten)]
    pub robot: Robot,
    /// Where it has stood, oldest first: the last 100 lines.
    pub log: Vec<RobotLine>,
}

/// Where a robot of a rollout has come to stand.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = RolloutRobotLine)]
pub struct RobotLine {
    /// Unix milliseconds.
    pub at: i64,
    /// Where.
    pub state: UpdateState,
    /// Why.
    pub reason: Option<Reason>,
}

/// The name of a state, and why it is so.
const fn state(state: RolloutState) -> (&'static str, Option<PauseReason>) {
    match state {
        RolloutState::Running => ("running", None),
        RolloutState::Paused(reason) => ("paused", Some(reason)),
        RolloutState::Aborting => ("aborting", None),
        RolloutState::Aborted => ("aborted", None),
        RolloutState::Done => ("done", None),
    }
}

pub(crate) fn damaged(error: impl std::fmt::Display) -> RolloutError {
    RolloutError::Damaged(error.to_string())
}

fn view(kept: KeptRollout, document: Document) -> RolloutView {
    let (state, reason) = state(document.state);
    RolloutView {
        id: kept.id.to_string(),
        by: kept.by,
        made: kept.made,
        ended: kept.ended,
        server: kept.owner,
        state,
        reason,
        phase: u32::from(document.phase) + 1,
        plan: document.plan,
        counts: None,
        log: None,
    }
}

fn robot(document: &Document, row: RobotRow, busy: &BTreeMap<RobotId, Busy>) -> Robot {
    // What it would say itself if it were asked.
    let waits_for = busy.get(&row.robot).filter(|_| waits(&row));
    let reason = waits_for.and_then(|busy| Code::new(busy.code()).ok());
    let release = row.release.map(usize::from);
    let release = release.and_then(|at| document.plan.releases.get(at));
    // By its own clock, which began when the anchor's reading was none.
    let anchor = document.anchor;
    let began = anchor.unix_ms.saturating_sub(anchor.elapsed_ms);
    let since = began.saturating_add(row.since_ms);
    Robot {
        robot: row.robot,
        state: row.state,
        reason: row.reason.or(reason.map(Reason::Told)),
        release: release.map(|release| release.release.clone()),
        phase: row.phase.map(|phase| u32::from(phase) + 1),
        attempts: row.attempts.into(),
        offers: row.offers,
        received: row.received,
        bytes: release.map(|release| release.bytes),
        since: i64::try_from(since).unwrap_or(i64::MAX),
    }
}

/// Whether a robot waits, and has not said why.
fn waits(row: &RobotRow) -> bool {
    row.state == UpdateState::Waiting && row.reason.is_none()
}

fn line(at: i64, text: &str) -> Result<LogLine, RolloutError> {
    let what: Happening = serde_json::from_str(text).map_err(damaged)?;
    let (phase, reason) = match what {
        Happening::PhaseBegan(phase)
        | Happening::PhaseSoaks(phase)
        | Happening::PhasePassed(phase) => (Some(u32::from(phase) + 1), None),
        Happening::Paused(reason) => (None, Some(reason)),
        _ => (None, None),
    };
    Ok(LogLine {
        at,
        what: step::action(&what),
        phase,
        reason,
    })
}

/// A line of a robot; none of what is about anything else.
fn robot_line(at: i64, text: &str) -> Result<Option<RobotLine>, RolloutError> {
    Ok(match serde_json::from_str(text).map_err(damaged)? {
        Happening::Robot { state, reason, .. } => Some(RobotLine { at, state, reason }),
        _ => None,
    })
}

impl Rollouts {
    /// Up to `limit` rollouts before number `before`, or the last ones, newest first. One that cannot be read is
    /// left out.
    ///
    /// # Errors
    /// [`RolloutError::Records`].
    pub async fn list(&self, before: Option<i64>, limit: u32) -> Result<RolloutPage, RolloutError> {
        let mut kept = self
            .records
            .rollouts()
            .page(before, limit.saturating_add(1))
            .await?;
        let more = kept.len() > limit as usize;
        kept.truncate(limit as usize);
        let next = kept.last().filter(|_| more).map(|last| last.id);
        let views =
            kept.into_iter()
                .filter_map(|kept| match serde_json::from_str(&kept.document) {
                    Ok(document) => Some(view(kept, document)),
                    Err(error) => {
                        tracing::error!(rollout = kept.id, %error, "cannot be shown");
                        None
                    }
                });
        let rollouts = views.collect();
        Ok(RolloutPage { rollouts, next })
    }

    /// A rollout, in numbers and with its log.
    ///
    /// # Errors
    /// [`RolloutError::Unknown`], [`RolloutError::Records`], [`RolloutError::Damaged`].
    pub async fn one(&self, id: i64) -> Result<RolloutView, RolloutError> {
        // Counts no older than the state, and a log no older than both: who reads `done` reads what was done.
        let kept = self.records.rollouts().get(id).await?;
        let kept = kept.ok_or(RolloutError::Unknown)?;
        let own = {
            let active = self.active();
            active.get(id).map(|one| one.rollout.counts(self.now()))
        };
        let (kept, counts) = if let Some(counts) = own {
            (kept, counts)
        } else {
            let whole = self.records.rollouts().whole(id).await?;
            let (kept, rows) = whole.ok_or(RolloutError::Unknown)?;
            let (rollout, _) = self.read(&kept.document, &rows)?;
            (kept, rollout.counts(self.now()))
        };
        let log = self.records.rollouts().notes(id, None, LOG).await?;
        let log = log.iter().map(|(at, text)| line(*at, text));
        let document = serde_json::from_str(&kept.document).map_err(damaged)?;
        Ok(RolloutView {
            counts: Some(counts),
            log: Some(log.collect::<Result<_, _>>()?),
            ..view(kept, document)
        })
    }

    /// Up to `limit` robots of a rollout behind the robot `after`, by name, only of those in `state` where one is
    /// named.
    ///
    /// # Errors
    /// [`RolloutError::Unknown`], [`RolloutError::Records`], [`RolloutError::Damaged`].
    pub async fn robots(
        &self,
        id: i64,
        after: Option<&RobotId>,
        state: Option<UpdateState>,
        limit: u32,
    ) -> Result<Vec<Robot>, RolloutError> {
        let kept = self.records.rollouts().get(id).await?;
        let kept = kept.ok_or(RolloutError::Unknown)?;
        let document: Document = serde_json::from_str(&kept.document).map_err(damaged)?;
        let kept = self.records.rollouts();
        let rows = kept.robots(
            id,
            after.map(RobotId::as_str),
            state.map(UpdateState::name),
            limit.min(MAX_ROLLOUT_PAGE),
        );
        let rows = rows.await?.into_iter();
        let rows = rows.map(|row| serde_json::from_str(&row).map_err(damaged));
        let rows: Vec<RobotRow> = rows.collect::<Result<_, _>>()?;
        let busy = self.busy(&rows);
        let robots = rows.into_iter().map(|row| robot(&document, row, &busy));
        Ok(robots.collect())
    }

    /// Why robots that wait cannot be offered anything just now.
    fn busy(&self, rows: &[RobotRow]) -> BTreeMap<RobotId, Busy> {
        let mut busy = BTreeMap::new();
        if rows.iter().any(waits) {
            self.robots.each(&mut |view| {
                if let Some(why) = view.busy.filter(|_| view.online) {
                    busy.insert(view.robot.clone(), why);
                }
            });
        }
        busy
    }

    /// A robot of a rollout, with its log.
    ///
    /// # Errors
    /// [`RolloutError::Unknown`], [`RolloutError::Command`] where it is in none of its phases,
    /// [`RolloutError::Records`], [`RolloutError::Damaged`].
    pub async fn robot(&self, id: i64, name: &RobotId) -> Result<RobotDetail, RolloutError> {
        let rollouts = self.records.rollouts();
        let kept = rollouts.get(id).await?.ok_or(RolloutError::Unknown)?;
        let document: Document = serde_json::from_str(&kept.document).map_err(damaged)?;
        let row = rollouts.robot(id, name.as_str()).await?;
        let row = row.ok_or(RolloutError::Command(CommandError::UnknownRobot))?;
        let row: RobotRow = serde_json::from_str(&row).map_err(damaged)?;
        let busy = self.busy(std::slice::from_ref(&row));
        let log = rollouts.notes(id, Some(name.as_str()), LOG).await?;
        let log = log.iter().map(|(at, text)| robot_line(*at, text));
        Ok(RobotDetail {
            robot: robot(&document, row, &busy),
            log: log
                .filter_map(Result::transpose)
                .collect::<Result<_, _>>()?,
        })
    }

    /// What was kept of a rollout, as a rollout.
    pub(crate) fn read(
        &self,
        document: &str,
        rows: &[String],
    ) -> Result<(Rollout, crawler_updates::rollout::Step), RolloutError> {
        let document = serde_json::from_str(document).map_err(damaged)?;
        let rows: Result<Vec<RobotRow>, _> =
            rows.iter().map(|row| serde_json::from_str(row)).collect();
        Rollout::load(document, rows.map_err(damaged)?, self.now()).map_err(damaged)
    }
}

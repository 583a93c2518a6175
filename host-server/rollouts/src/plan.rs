//! What people ask for: a plan that names releases by their ids alone.

use std::collections::BTreeMap;

use crawler_protocol::{Kind as Body, ModelName};
use crawler_records::{KeptRelease, MAX_ROLLOUTS, Records, RecordsError, Rollouts};
use crawler_release::Kind;
use crawler_updates::rollout::{
    BoardName, BuildId, Document, Limits, OWN_MODEL, Phase, Plan, PlannedRelease, ReleaseId,
    Retries, Timeouts, Version, Window,
};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::control::RolloutError;
use crate::gate::{self, GateDemand};

/// A release that is asked for.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = RolloutRelease)]
#[serde(deny_unknown_fields)]
pub struct Asked {
    /// Its id.
    #[schema(value_type = String)]
    pub release: ReleaseId,
    /// The kind of robot that gets it; all on its board without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>)]
    pub kind: Option<Body>,
}

/// What a rollout is to do, with releases that the server has. What is known of those is filled in: [`Plan`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = NewRollout)]
#[serde(deny_unknown_fields)]
pub struct NewPlan {
    /// The releases: at most one for each robot.
    #[schema(min_items = 1, max_items = 32)]
    pub releases: Vec<Asked>,
    /// The phases, first to last. A robot belongs to the first that selects it.
    #[schema(min_items = 1, max_items = 32)]
    pub phases: Vec<Phase>,
    /// How much at once.
    #[serde(default)]
    pub limits: Limits,
    /// When robots may be offered a release; at any time without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub window: Option<Window>,
    /// What becomes of attempts that fail without saying anything about the release.
    #[serde(default)]
    pub retries: Retries,
    /// How long a robot may take.
    #[serde(default)]
    pub timeouts: Timeouts,
    /// Why releases go out although they have no passing gate, 1 to 512 bytes on one line, which everybody sees, and
    /// the audit log keeps. Says nothing where all have one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(min_length = 1, max_length = 128)]
    pub override_gate: Option<String>,
}

impl NewPlan {
    /// The plan, checked.
    pub(crate) async fn resolve(
        self,
        records: &Records,
        now_ms: u64,
        demand: GateDemand,
    ) -> Result<Plan, RolloutError> {
        let mut releases = Vec::with_capacity(self.releases.len());
        let mut ungated = Vec::new();
        for asked in self.releases {
            let kept = records.releases().get(asked.release.as_str()).await?;
            if kept.as_ref().is_some_and(|kept| demand.refuses(kept)) {
                ungated.push(asked.release.clone());
            }
            releases.push(planned(asked, kept, now_ms)?);
        }
        let mut plan = Plan {
            releases,
            phases: self.phases,
            limits: self.limits,
            window: self.window,
            retries: self.retries,
            timeouts: self.timeouts,
            override_gate: None,
        };
        plan.check().map_err(RolloutError::Plan)?;
        let newest = newest(records.rollouts(), &plan).await?;
        plan.check_sequences(&newest).map_err(RolloutError::Plan)?;
        // Last, so that nothing but the gate is in the way of who is told of it.
        plan.override_gate = gate::overridden(self.override_gate.as_deref(), ungated)?;
        Ok(plan)
    }
}

fn planned(
    asked: Asked,
    kept: Option<KeptRelease>,
    now_ms: u64,
) -> Result<PlannedRelease, RolloutError> {
    let Some(kept) = kept else {
        return Err(RolloutError::UnknownRelease(asked.release));
    };
    let refused = |why| RolloutError::Release(asked.release.clone(), why);
    if kept.withdrawn.is_some() {
        return Err(refused("it was withdrawn"));
    }
    let kind = kept.what();
    let model = match (kind, &kept.name) {
        (Some(Kind::Program), None) => None,
        (Some(Kind::Model | Kind::Policy), Some(name)) if kept.build != OWN_MODEL => Some(name),
        _ => {
            return Err(refused(
                "it is neither a program nor a model or a policy that could be rolled out",
            ));
        }
    };
    let model = model.map(|name| name.parse::<ModelName>()).transpose();
    let now_s = i64::try_from(now_ms / 1_000).unwrap_or(i64::MAX);
    if kept.expires.is_some_and(|expires| expires <= now_s) {
        return Err(refused("it has expired: robots refuse it"));
    }
    let unnamed = |_| refused("it has a name that none can be");
    Ok(PlannedRelease {
        board: BoardName::new(&kept.board).map_err(unnamed)?,
        build: BuildId::new(&kept.build).map_err(unnamed)?,
        version: Version::new(&kept.version).map_err(unnamed)?,
        model: model.map_err(|_| refused("no robot has a model of such a name"))?,
        policy: kind == Some(Kind::Policy),
        release: asked.release.clone(),
        kind: asked.kind,
        sequence: kept.sequence.into(),
        bytes: kept.size,
    })
}

/// The highest sequence for each board of the releases that were rolled out before, of programs, of the model of the plan,
/// or of policies, but for those of the plan: the same release may go to more robots.
async fn newest(
    rollouts: Rollouts<'_>,
    plan: &Plan,
) -> Result<BTreeMap<BoardName, u64>, RecordsError> {
    let mut newest = BTreeMap::new();
    for kept in rollouts.page(None, MAX_ROLLOUTS as u32).await? {
        // One that cannot be read says nothing.
        let Ok(document) = serde_json::from_str::<Document>(&kept.document) else {
            continue;
        };
        for one in document.plan.releases {
            let same = plan.releases.iter().any(|own| own.release == one.release);
            if same || Some(one.replaces()) != plan.replaces() {
                continue;
            }
            let sequence = newest.entry(one.board).or_insert(0);
            *sequence = one.sequence.max(*sequence);
        }
    }
    Ok(newest)
}

//! Policies by their names: in releases and on robots, and on their way to chosen robots.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse as _, Response};
use crawler_fleet::{Robot, SharedFleet};
use crawler_protocol::{Action, PolicyName, RobotId};
use crawler_records::{KeptRelease, Records};
use crawler_release::Kind;
use crawler_rollouts::Rollouts;
use crawler_system::clock::now_ms;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use utoipa::ToSchema;

use super::access::Caller;
use super::audit::Audit;
use super::commands::CommandSender;
use super::guard::JsonBody;
use super::problem::{Code, FieldError, Problem};
use super::releases::view::ReleaseView;
use super::rollouts;
use super::shadows::{SumView, Sums};

/// The policy that every program brings.
const BUILT_IN: &str = "spread";
/// The model by which robots see: no policy, whatever else is called so.
const EYES: &str = "eyes";
/// Releases that are read from the records at a time.
const TOGETHER: u32 = 200;
/// Most robots that a policy is deployed to, or compared on, at once.
const MAX_ROBOTS: usize = 1_000;
/// Longest time that a deployment is watched, in seconds: a week.
const MAX_SOAK_S: u32 = 7 * 24 * 3_600;

/// How many robots have a build of a policy.
#[derive(Serialize, ToSchema)]
pub(super) struct PolicyBuild {
    /// What names its contents.
    build: String,
    /// How many robots say that they have it.
    robots: u32,
}

/// A policy, by its name.
#[derive(Serialize, ToSchema)]
#[schema(as = Policy)]
pub(super) struct PolicyView {
    /// Its name, as `behave` takes it.
    name: String,
    /// Whether it comes with every program.
    built_in: bool,
    /// Its releases, those that were added last first.
    releases: Vec<ReleaseView>,
    /// What robots say that they have, beside what comes with their program.
    builds: Vec<PolicyBuild>,
}

/// A robot that has a policy.
#[derive(Serialize, ToSchema)]
#[schema(as = PolicyRobot)]
pub(super) struct RobotView {
    /// Its name.
    robot: String,
    /// What names the contents of its policy.
    build: String,
}

/// A policy, and who has it.
#[derive(Serialize, ToSchema)]
#[schema(as = PolicyDetail)]
pub(super) struct PolicyDetail {
    /// What is in the list of policies as well.
    #[serde(flatten)]
    policy: PolicyView,
    /// The robots that say that they have it, by name.
    robots: Vec<RobotView>,
    /// How it compares where it decides beside another policy that drives, for each of its builds.
    shadows: Vec<SumView>,
}

/// Policies.
#[derive(Serialize, ToSchema)]
#[schema(as = Policies)]
pub(super) struct PolicyList {
    /// By name.
    policies: Vec<PolicyView>,
}

/// To whom a policy goes.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PolicyDeployment)]
pub(super) struct DeployBody {
    /// The robots, each of which the server knows.
    #[schema(min_items = 1, max_items = 1000)]
    robots: Vec<String>,
    /// Id of one of its releases; left out, the newest for the board of each robot.
    release: Option<String>,
    /// How long the robots are watched once they are done, in seconds; left out, not at all.
    #[schema(minimum = 0, maximum = 604_800)]
    soak_s: Option<u32>,
    /// Why it goes out although there is no passing gate, as of any rollout.
    #[schema(min_length = 1, max_length = 128)]
    override_gate: Option<String>,
}

fn unknown() -> Problem {
    Problem::new(
        Code::UnknownPolicy,
        "there is no policy of that name, in releases or on robots",
    )
}

/// Where a policy is to be compared, or no more.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = PolicyShadow)]
pub(super) struct ShadowBody {
    /// The robots, each of which the server knows and which have the policy.
    #[schema(min_items = 1, max_items = 1000)]
    robots: Vec<String>,
    /// Whether they are to compare nothing any more.
    #[serde(default)]
    end: bool,
}

/// The command that a robot was sent.
#[derive(Serialize, ToSchema)]
#[schema(as = SentCommand)]
pub(super) struct SentView {
    /// The robot.
    robot: String,
    /// Name of the command in `/api/v1/commands/{id}`, which tells what it came to.
    command: String,
}

/// The commands that robots were sent.
#[derive(Serialize, ToSchema)]
#[schema(as = SentCommands)]
pub(super) struct SentList {
    /// In the order of the robots.
    sent: Vec<SentView>,
}

/// Everything that is known of policies.
struct Known {
    /// Releases by the names of their policies, those that were added last first.
    releases: BTreeMap<String, Vec<KeptRelease>>,
    /// Robots by the names of the policies that they say they have, with its build.
    robots: BTreeMap<String, Vec<RobotView>>,
    /// What robots compare.
    shadows: Sums,
}

impl Known {
    async fn gather(records: &Records, fleet: &SharedFleet) -> Result<Self, Problem> {
        let mut releases: BTreeMap<String, Vec<KeptRelease>> = BTreeMap::new();
        let mut models = BTreeSet::from([EYES.to_owned()]);
        let mut before: Option<String> = None;
        loop {
            let page = records.releases().page(before.as_deref(), TOGETHER).await;
            let page = page.map_err(|error| Problem::records(&error))?;
            before = page.last().map(|row| row.id.clone());
            let full = page.len() == TOGETHER as usize;
            for row in page {
                match (row.what(), row.name.clone()) {
                    (Some(Kind::Policy), Some(name)) => {
                        releases.entry(name).or_default().push(row);
                    }
                    (Some(Kind::Model), Some(name)) => {
                        models.insert(name);
                    }
                    _ => {}
                }
            }
            if !full {
                break;
            }
        }
        let mut robots: BTreeMap<String, Vec<RobotView>> = BTreeMap::new();
        let mut shadows = Sums::default();
        let fleet = fleet.lock();
        for robot in fleet.robots() {
            shadows.add(robot);
            let has = robot.status.iter().flat_map(|status| status.models.iter());
            for (name, build) in has {
                let name = name.as_str();
                // A name may be that of a detector.
                if releases.contains_key(name) || !models.contains(name) {
                    robots.entry(name.to_owned()).or_default().push(RobotView {
                        robot: robot.id.as_str().to_owned(),
                        build: build.as_str().to_owned(),
                    });
                }
            }
        }
        Ok(Self {
            releases,
            robots,
            shadows,
        })
    }

    fn names(&self) -> BTreeSet<String> {
        let names = self.releases.keys().chain(self.robots.keys()).cloned();
        names.chain([BUILT_IN.to_owned()]).collect()
    }

    /// Takes out what is known of one.
    fn take(&mut self, name: &str) -> PolicyDetail {
        let mut robots = self.robots.remove(name).unwrap_or_default();
        robots.sort_by(|a, b| a.robot.cmp(&b.robot));
        let mut builds: BTreeMap<&str, u32> = BTreeMap::new();
        for robot in &robots {
            *builds.entry(&robot.build).or_default() += 1;
        }
        let builds = builds.into_iter().map(|(build, robots)| PolicyBuild {
            build: build.to_owned(),
            robots,
        });
        let builds = builds.collect();
        let releases = self.releases.remove(name).unwrap_or_default();
        PolicyDetail {
            policy: PolicyView {
                built_in: name == BUILT_IN,
                name: name.to_owned(),
                releases: releases.into_iter().map(ReleaseView::new).collect(),
                builds,
            },
            robots,
            shadows: self.shadows.take(name),
        }
    }
}

/// Policies that releases have, that robots say they have, and the one that comes with every program; by name
#[utoipa::path(get, path = "/policies", tag = "updates",
    responses(
        (status = 200, description = "All of them", body = PolicyList),
        (status = 503, description = "The records cannot be read")))]
pub(super) async fn list(
    State(records): State<Records>,
    State(fleet): State<Arc<SharedFleet>>,
) -> Result<Json<PolicyList>, Problem> {
    let mut known = Known::gather(&records, &fleet).await?;
    let names = known.names().into_iter();
    Ok(Json(PolicyList {
        policies: names.map(|name| known.take(&name).policy).collect(),
    }))
}

/// One policy, and which robots have it
#[utoipa::path(get, path = "/policies/{name}", tag = "updates",
    params(("name" = String, Path, description = "Name of the policy")),
    responses(
        (status = 200, description = "The policy", body = PolicyDetail),
        (status = 404, description = "There is none of that name"),
        (status = 503, description = "The records cannot be read")))]
pub(super) async fn one(
    State(records): State<Records>,
    State(fleet): State<Arc<SharedFleet>>,
    Path(name): Path<String>,
) -> Result<Json<PolicyDetail>, Problem> {
    let mut known = Known::gather(&records, &fleet).await?;
    if !known.names().contains(&name) {
        return Err(unknown());
    }
    Ok(Json(known.take(&name)))
}

/// Puts a policy on chosen robots
///
/// A rollout of its releases with these robots as its only phase: it is watched and steered as any other one. Each robot gets
/// the newest release for its board that nobody has withdrawn and that has not expired, or the one that is named.
#[utoipa::path(post, path = "/policies/{name}/deploy", tag = "updates",
    params(("name" = String, Path, description = "Name of the policy")),
    request_body = DeployBody,
    responses(
        (status = 201, description = "The rollout has begun", body = crawler_rollouts::RolloutView),
        (status = 400, description = "Not JSON"),
        (status = 404, description = "There is no release of a policy of that name"),
        (status = 409, description = "There are as many rollouts at work as may be"),
        (status = 422, description = "`errors` names every field that is wrong; or the rollout cannot be carried out; or \
                                      a release has no gate that has passed (`gate_missing`)"),
        (status = 503, description = "The records are away")))]
pub(super) async fn deploy(
    State(records): State<Records>,
    State(fleet): State<Arc<SharedFleet>>,
    State(rollouts): State<Arc<Rollouts>>,
    State(audit): State<Audit>,
    caller: Caller,
    Path(name): Path<String>,
    body: JsonBody,
) -> Result<Response, Problem> {
    let asked: DeployBody = body.read()?;
    let mut known = Known::gather(&records, &fleet).await?;
    let releases = known.releases.remove(&name).unwrap_or_default();
    if releases.is_empty() {
        let what = "there is no release of a policy of that name";
        return Err(Problem::new(Code::UnknownPolicy, what));
    }
    let plan = planned(&asked, &releases, &fleet, now_ms())
        .map_err(|errors| Problem::invalid(Code::InvalidRollout, errors))?;
    rollouts::begin(&rollouts, &audit, &caller, plan).await
}

/// Has chosen robots compare a policy with the one that drives them, and moves none of them
///
/// While a robot drives by another policy, this one decides on the same observations; what it would do is counted, in
/// `shadow` of the robot and `shadows` of the policy. Counting begins at 0, and anew whenever another policy drives or a
/// release replaces one. It lasts until `end`, another policy, or a restart of the robot. Each robot gets a command
/// `shadow`, which it rejects where it does not know it.
#[utoipa::path(post, path = "/policies/{name}/shadow", tag = "updates",
    params(("name" = String, Path, description = "Name of the policy")),
    request_body = ShadowBody,
    responses(
        (status = 202, description = "Sent to the robots", body = SentList),
        (status = 400, description = "Not JSON"),
        (status = 404, description = "There is no policy of that name"),
        (status = 422, description = "`errors` names every field that is wrong"),
        (status = 503, description = "The records are away, or there is no connection to the broker, or no disk to write \
                                      commands to; some may have been sent then")))]
pub(super) async fn shadow(
    State(records): State<Records>,
    State(fleet): State<Arc<SharedFleet>>,
    State(sender): State<CommandSender>,
    caller: Caller,
    Path(name): Path<String>,
    body: JsonBody,
) -> Result<Response, Problem> {
    let asked: ShadowBody = body.read()?;
    let known = Known::gather(&records, &fleet).await?;
    let policy = PolicyName::new(&name)
        .ok()
        .filter(|_| known.names().contains(&name));
    let policy = policy.ok_or_else(unknown)?;
    let owners = known.robots.get(&name).into_iter().flatten();
    let owners: BTreeSet<&str> = owners.map(|owner| owner.robot.as_str()).collect();
    let has = |robot: &str| asked.end || name == BUILT_IN || owners.contains(robot);
    let robots = comparing(&asked.robots, &fleet, has)
        .map_err(|errors| Problem::invalid(Code::InvalidShadow, errors))?;
    let action = Action::Shadow {
        policy: (!asked.end).then_some(policy),
    };
    let detail = json!({ "robots": asked.robots, "end": asked.end });
    let what = ("policy.shadow", name, detail);
    let sent = sender.send_to_each(caller, robots, action, what).await?;
    let sent = asked.robots.into_iter().zip(sent);
    let sent = sent.map(|(robot, command)| SentView { robot, command });
    let sent = SentList {
        sent: sent.collect(),
    };
    Ok((StatusCode::ACCEPTED, Json(sent)).into_response())
}

/// The robots of these names.
///
/// # Errors
/// Every one that is wrong, and how.
fn comparing(
    robots: &[String],
    fleet: &SharedFleet,
    has: impl Fn(&str) -> bool,
) -> Result<Vec<RobotId>, Vec<FieldError>> {
    if robots.is_empty() || robots.len() > MAX_ROBOTS {
        let rule = format!("must name 1 to {MAX_ROBOTS} robots");
        return Err(vec![FieldError::at("/robots", rule)]);
    }
    let (mut found, mut errors, mut named) = (Vec::new(), Vec::new(), BTreeSet::new());
    let fleet = fleet.lock();
    for (place, text) in robots.iter().enumerate() {
        let robot = RobotId::new(text).ok();
        let wrong = match robot.filter(|robot| fleet.get(robot).is_some()) {
            None => "is known to nobody",
            Some(_) if !named.insert(text.as_str()) => "is named twice",
            Some(_) if !has(text) => "does not have the policy",
            Some(robot) => {
                found.push(robot);
                continue;
            }
        };
        errors.push(FieldError::at(format!("/robots/{place}"), wrong));
    }
    if errors.is_empty() {
        Ok(found)
    } else {
        Err(errors)
    }
}

/// Where a robot may be found wanting.
fn suited<'a>(
    releases: &'a [KeptRelease],
    robot: &Robot,
    now: i64,
) -> Result<&'a KeptRelease, String> {
    let status = robot.status.as_ref();
    let status = status.ok_or("has not said on which board it is")?;
    let board = status.board.as_str();
    let good = |release: &&KeptRelease| {
        let ends = release.expires.map(|ends| ends.saturating_mul(1_000));
        release.withdrawn.is_none() && ends.is_none_or(|ends| ends > now) && release.board == board
    };
    let newest = releases.iter().filter(good).max_by_key(|one| one.sequence);
    newest.ok_or_else(|| format!("is on the board {board}, for which there is no release of it"))
}

/// The plan of a rollout.
///
/// # Errors
/// Every field that is wrong, and how.
fn planned(
    asked: &DeployBody,
    releases: &[KeptRelease],
    fleet: &SharedFleet,
    now: i64,
) -> Result<Value, Vec<FieldError>> {
    let mut errors = Vec::new();
    let chosen: Vec<KeptRelease> = match &asked.release {
        None => releases.to_vec(),
        Some(id) => releases
            .iter()
            .filter(|one| one.id == *id)
            .cloned()
            .collect(),
    };
    if chosen.is_empty() {
        errors.push(FieldError::at("/release", "is no release of this policy"));
    }
    if asked.soak_s.is_some_and(|soak| soak > MAX_SOAK_S) {
        let rule = format!("must be 0 to {MAX_SOAK_S}");
        errors.push(FieldError::at("/soak_s", rule));
    }
    if asked.robots.is_empty() || asked.robots.len() > MAX_ROBOTS {
        let rule = format!("must name 1 to {MAX_ROBOTS} robots");
        errors.push(FieldError::at("/robots", rule));
        return Err(errors);
    }
    let (mut needed, mut named) = (BTreeSet::new(), BTreeSet::new());
    {
        let fleet = fleet.lock();
        for (place, text) in asked.robots.iter().enumerate() {
            let robot = RobotId::new(text).ok();
            let robot = robot.as_ref().and_then(|robot| fleet.get(robot));
            let found = match robot {
                None => Err("is known to nobody".to_owned()),
                Some(_) if !named.insert(text.as_str()) => Err("is named twice".to_owned()),
                Some(_) if chosen.is_empty() => continue,
                Some(robot) => suited(&chosen, robot, now),
            };
            match found {
                Ok(release) => {
                    needed.insert(release.id.clone());
                }
                Err(why) => errors.push(FieldError::at(format!("/robots/{place}"), why)),
            }
        }
    }
    if !errors.is_empty() {
        return Err(errors);
    }
    let releases: Vec<Value> = needed.iter().map(|id| json!({ "release": id })).collect();
    let mut plan = json!({
        "releases": releases,
        "phases": [{ "select": { "group": asked.robots }, "soak_s": asked.soak_s.unwrap_or(0) }],
    });
    if let Some(why) = &asked.override_gate {
        plan["override_gate"] = json!(why);
    }
    Ok(plan)
}

//! `terracrawler rollout`: rollouts of a running server, over its API.

mod args;
mod plan;
mod table;
mod view;
mod watch;

use std::process::ExitCode;

use crawler_system::cli_error::CliError;
use serde_json::Value;

use crate::client::{CallError, Client};
use crate::config::Settings;

pub use args::{Group, Phases, PlanArgs, RemoteArgs, RolloutArgs, RolloutTask, StartArgs};
use view::{Robot, Rollout};

/// Robots of a page that is asked for.
const PAGE: usize = 1_000;
/// Failures that are shown with a rollout, of each state.
const FAILURES: usize = 20;

/// Does what the command line asks for. What the exit code means, the help of the command says.
///
/// # Errors
/// One line: what cannot be done, and why.
pub(crate) async fn run(args: RolloutArgs, settings: &Settings) -> Result<ExitCode, CliError> {
    // What can be refused without a server is.
    let plan = match &args.task {
        RolloutTask::Start(start) if args.remote.reads_input() && start.plan.is_piped() => {
            let text =
                "standard input is the plan: name a file with the password (--password-file)";
            return Err(CliError::new(text));
        }
        RolloutTask::Start(start) => Some(plan::body(&start.plan)?),
        _ => None,
    };
    let mut client = args.remote.client(settings)?;
    args.remote.log_in(&mut client).await?;
    let done = tokio::select! {
        done = perform(&mut client, args.task, plan.unwrap_or_default()) => done,
        _ = tokio::signal::ctrl_c() => {
            Err(CliError::new("given up; what was asked for may be done all the same"))
        }
    };
    client.log_out().await;
    done
}

async fn perform(
    client: &mut Client,
    task: RolloutTask,
    plan: Vec<u8>,
) -> Result<ExitCode, CliError> {
    let (view, json, follow) = match task {
        RolloutTask::Start(args) => {
            let begun = client.post("/api/v1/rollouts", plan).await?;
            (begun, args.json, args.watch)
        }
        RolloutTask::Show { id: None, json, .. } => return list(client, json).await,
        RolloutTask::Show {
            id: Some(id),
            json,
            watch,
        } => (client.get(&address(id)).await?, json, watch),
        RolloutTask::Pause { id } => (act(client, id, "pause").await?, false, false),
        RolloutTask::Resume { id, watch } => (act(client, id, "resume").await?, false, watch),
        RolloutTask::Abort { id } => (act(client, id, "abort").await?, false, false),
        RolloutTask::Robots { id, state, json } => {
            return robots(client, id, state.as_deref(), json).await;
        }
        RolloutTask::Retry { id, robot } => {
            let path = format!("robots/{robot}/retry");
            (act(client, id, &path).await?, false, false)
        }
        RolloutTask::Skip { id, robot } => {
            let path = format!("robots/{robot}/skip");
            (act(client, id, &path).await?, false, false)
        }
    };
    if follow {
        return watch::follow(client, view, json).await;
    }
    show(client, view, json).await?;
    Ok(ExitCode::SUCCESS)
}

fn address(id: u64) -> String {
    format!("/api/v1/rollouts/{id}")
}

async fn act(client: &mut Client, id: u64, path: &str) -> Result<Value, CallError> {
    let path = format!("{}/{path}", address(id));
    client.post(&path, Vec::new()).await
}

/// Prints a rollout, with the robots at which it has failed.
async fn show(client: &mut Client, view: Value, json: bool) -> Result<(), CliError> {
    if json {
        println!("{view}");
        return Ok(());
    }
    let rollout = Rollout::read(view)?;
    let mut failures = Vec::new();
    let mut more = false;
    for state in ["rolled_back", "failed"] {
        if rollout.count(state) > 0 {
            let (page, next) = page(client, rollout.number()?, Some(state), None, FAILURES).await?;
            more |= next.is_some();
            failures.extend(Robot::read(Value::Array(page))?);
        }
    }
    print!("{}", table::rollout(&rollout, &failures, more));
    Ok(())
}

/// A page of the robots of a rollout, and behind which one there are more.
async fn page(
    client: &mut Client,
    id: u64,
    state: Option<&str>,
    after: Option<&str>,
    limit: usize,
) -> Result<(Vec<Value>, Option<String>), CliError> {
    let mut path = format!("{}/robots?limit={limit}", address(id));
    for (name, value) in [("state", state), ("after", after)] {
        if let Some(value) = value {
            path = format!("{path}&{name}={value}");
        }
    }
    let mut page = client.get(&path).await?;
    let next = page["next"].as_str().map(str::to_owned);
    match page["robots"].take() {
        Value::Array(robots) => Ok((robots, next)),
        other => Err(CliError::new(format!(
            "the server answers with {other} where robots were asked for"
        ))),
    }
}

async fn robots(
    client: &mut Client,
    id: u64,
    state: Option<&str>,
    json: bool,
) -> Result<ExitCode, CliError> {
    let mut after = None;
    let mut all = Vec::new();
    loop {
        let (robots, next) = page(client, id, state, after.as_deref(), PAGE).await?;
        // Whoever answers with the same page for ever is not asked for ever.
        let forward = !robots.is_empty() && next > after;
        all.extend(robots);
        after = next.filter(|_| forward);
        if after.is_none() {
            break;
        }
    }
    let all = Value::Array(all);
    if json {
        println!("{all}");
    } else {
        print!("{}", table::robots(&Robot::read(all)?));
    }
    Ok(ExitCode::SUCCESS)
}

/// Prints the last rollouts.
async fn list(client: &mut Client, json: bool) -> Result<ExitCode, CliError> {
    let mut list = client.get("/api/v1/rollouts").await?;
    let list = list["rollouts"].take();
    if json {
        println!("{list}");
    } else {
        print!("{}", table::list(&Rollout::read_all(list)?));
    }
    Ok(ExitCode::SUCCESS)
}

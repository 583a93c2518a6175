//! `terracrawler learn-node`: learns in worlds of its own for a training of the fleet.

use std::num::NonZeroUsize;
use std::process::ExitCode;
use std::sync::Arc;

use clap::Args;
use crawler_experiments::scenarios::{Randomisation, scenario};
use crawler_federation::{NodeName, Told, learn};
use crawler_learning::Spread;
use crawler_learning::federated::Node;
use crawler_sim::scenario::Scenario;
use crawler_system::cli_error::{CliError, OrSay as _};
use tokio_util::sync::CancellationToken;

use crate::config::{Broker, BrokerUrl, Common, Settings};
use crate::run::{Signals, log_to_stderr};
use crate::server::BrokerSession;

/// First part of the user names of nodes.
const LEARNER: &str = "learner-";
/// The scenario of the task.
const TASK: &str = "spread";

/// Options of `learn-node`.
#[derive(Debug, Clone, Args)]
pub struct LearnNodeArgs {
    #[command(flatten)]
    #[allow(missing_docs)] // a doc comment here would become the command's description
    pub common: Common,
    /// Name of the node [default: that of its account, `learner-NAME`]
    #[arg(long, value_name = "NAME")]
    pub name: Option<NodeName>,
    /// Name or TOML file of the scenario that it learns in: its own floor, things and robots
    #[arg(long, value_name = "SCENARIO", default_value = TASK)]
    pub scenario: String,
    /// How far the parameters of each world differ from those of the scenario [default: as it says]
    #[arg(long, value_name = "PROFILE", value_parser = randomisation)]
    pub randomisation: Option<Randomisation>,
    /// Threads; they change nothing but the time it takes [default: one for each processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
}

fn randomisation(text: &str) -> Result<Randomisation, &'static str> {
    Randomisation::by_name(text).ok_or("none, mild or wild")
}

/// Learns until it is told to stop.
///
/// # Errors
/// When an option cannot be used.
pub(crate) async fn run(args: &LearnNodeArgs, settings: &Settings) -> Result<ExitCode, CliError> {
    log_to_stderr(settings)?;
    let Broker::Outside(url) = &settings.broker else {
        return Err(CliError::new("say where the broker is: --broker URL"));
    };
    let name = name(args.name.as_ref(), url)?;
    let scenario = Arc::new(worlds(args)?);
    let threads = args
        .threads
        .and_then(|threads| NonZeroUsize::new(threads.into()));
    let threads = threads
        .or_else(|| std::thread::available_parallelism().ok())
        .unwrap_or(NonZeroUsize::MIN);
    let mut signals = Signals::new().or_say(|error| format!("cannot start: {error}"))?;
    let session = BrokerSession::open(settings, url, &format!("{LEARNER}{name}")).await?;
    println!(
        "Learns as `{name}` in worlds of `{}` for fleet `{}`, over {url}.\nCtrl-C ends it.",
        scenario.name, settings.fleet
    );
    let stop = CancellationToken::new();
    let own = name.clone();
    let make = move || Node::new(own.as_str(), (*scenario).clone(), threads);
    let learning = learn(
        session.options(),
        settings.fleet.clone(),
        name,
        make,
        tell,
        stop.clone(),
    );
    tokio::pin!(learning);
    let learned = tokio::select! {
        learned = &mut learning => learned,
        name = signals.next() => {
            tracing::info!(signal = name, "stopping");
            stop.cancel();
            learning.await
        }
    };
    session.end().await;
    learned.or_say(|error| format!("a mistake of the program ended it: {error}"))?;
    Ok(ExitCode::SUCCESS)
}

/// How it is called: as its account, or as somebody says where it has none.
fn name(asked: Option<&NodeName>, url: &BrokerUrl) -> Result<NodeName, CliError> {
    let user = url.credentials.as_ref().map(|(user, _)| user.as_str());
    let own = match user.map(|user| user.strip_prefix(LEARNER)) {
        None => None,
        Some(Some(own)) => Some(own.parse().map_err(CliError::from)?),
        Some(None) => {
            return Err(CliError::new(format!(
                "a node has an account of its own, `{LEARNER}NAME`: `terracrawler robot enroll --learner NAME`"
            )));
        }
    };
    match (own, asked) {
        (Some(own), Some(asked)) if own != *asked => Err(CliError::new(format!(
            "--name {asked} is not that of its account, {LEARNER}{own}"
        ))),
        (Some(own), _) => Ok(own),
        (None, Some(asked)) => Ok(asked.clone()),
        (None, None) => Err(CliError::new("say how the node is called: --name NAME")),
    }
}

/// What it learns in.
fn worlds(args: &LearnNodeArgs) -> Result<Scenario, CliError> {
    let mut scenario = scenario(Some(&args.scenario))?;
    if let Some(profile) = args.randomisation {
        scenario.randomisation = profile.profile();
    }
    if !(2..=16).contains(&scenario.robots) {
        return Err(CliError::new(format!(
            "{}: robots get apart from each other: it takes 2 to 16, not {}",
            args.scenario, scenario.robots
        )));
    }
    if !Spread::can_be_drawn(&scenario) {
        return Err(CliError::new(format!(
            "{}: none of a thousand worlds could be drawn from it",
            args.scenario
        )));
    }
    Ok(scenario)
}

/// A line for what happens.
fn tell(told: &Told<'_>) {
    match *told {
        Told::Answered {
            run,
            round,
            report,
            took,
            bytes,
        } => println!(
            "run {run}, round {}: {} decisions in {:.1} s, {} episodes, {:.0} % of them with success; {bytes} bytes told",
            round + 1,
            report.samples,
            took.as_secs_f32(),
            report.episodes,
            report.success * 100.0
        ),
        Told::Over { run } => println!("run {run} is over"),
        Told::Refused { run, error } => {
            tracing::error!(run, %error, "a round cannot be learned from");
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(asked: Option<&str>, url: &str) -> Result<String, String> {
        let asked = asked.map(|name| name.parse::<NodeName>().expect("a name"));
        let url = url.parse().expect("a URL");
        let found = name(asked.as_ref(), &url);
        found
            .map(|name| name.to_string())
            .map_err(|error| error.to_string())
    }

    #[test]
    fn a_node_is_called_as_its_account() {
        let own = "mqtt://learner-hall:secret@broker";
        assert_eq!(named(None, own), Ok("hall".to_owned()));
        assert_eq!(named(Some("hall"), own), Ok("hall".to_owned()));
        assert_eq!(named(Some("yard"), "mqtt://broker"), Ok("yard".to_owned()));
        for (asked, url, why) in [
            (
                Some("yard"),
                own,
                "--name yard is not that of its account, learner-hall",
            ),
            (
                None,
                "mqtt://broker",
                "say how the node is called: --name NAME",
            ),
            (
                None,
                "mqtt://ada:secret@broker",
                "a node has an account of its own",
            ),
            (
                None,
                "mqtt://learner-:secret@broker",
                "not a name of a node",
            ),
        ] {
            let error = named(asked, url).expect_err("refused");
            assert!(error.contains(why), "{error}");
        }
    }
}

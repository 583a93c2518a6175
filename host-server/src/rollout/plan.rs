//! The plan of a rollout that is to begin, as it is sent.

use std::io::{self, Read as _};
use std::path::Path;

use crawler_system::cli_error::{CliError, OrSay as _};
use serde_json::{Value, json};

use super::args::PlanArgs;

/// Longest plan that a server takes, in bytes.
const MOST: usize = 512 * 1024;

/// The plan as JSON. Whether it can be carried out, the server says.
///
/// # Errors
/// When a file is not JSON, or the options say too little.
pub(super) fn body(args: &PlanArgs) -> Result<Vec<u8>, CliError> {
    match &args.file {
        Some(_) if args.is_piped() => {
            let mut bytes = Vec::new();
            let input = io::stdin().lock();
            let read = input.take(MOST as u64 + 1).read_to_end(&mut bytes);
            read.or_say(|error| format!("cannot read the plan: {error}"))?;
            checked(bytes, "standard input")
        }
        Some(path) => checked(crate::release::read(path, MOST)?, &shown(path)),
        None => of_options(args).map(|plan| plan.to_string().into_bytes()),
    }
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}

fn checked(bytes: Vec<u8>, name: &str) -> Result<Vec<u8>, CliError> {
    if bytes.len() > MOST {
        return Err(CliError::new(format!("{name}: more than {MOST} bytes")));
    }
    match serde_json::from_slice(&bytes) {
        Ok(Value::Object(_)) => Ok(bytes),
        Ok(_) => Err(CliError::new(format!(
            "{name}: a plan is a JSON object: docs/updates.md"
        ))),
        Err(error) => Err(CliError::new(format!("{name}: no JSON: {error}"))),
    }
}

fn of_options(args: &PlanArgs) -> Result<Value, CliError> {
    let releases = args.release.iter().map(|(id, kind)| {
        let mut release = json!({ "release": id.to_string() });
        if let Some(kind) = kind {
            release["kind"] = json!(kind);
        }
        release
    });
    let groups = args
        .phases
        .group
        .iter()
        .map(|group| json!({ "group": group.0 }));
    let shares = args
        .phases
        .share
        .iter()
        .map(|share| json!({ "share": share }));
    let phases = groups.chain(shares).map(|select| {
        let mut phase = json!({ "select": select });
        if let Some(soak) = args.phases.soak {
            phase["soak_s"] = json!(soak);
        }
        phase
    });
    let phases: Vec<_> = phases.collect();
    if phases.is_empty() {
        return Err(CliError::new(
            "say for whom it is: --share 10,100 for instance, or --group rover-1,rover-2",
        ));
    }
    let mut plan = json!({ "releases": releases.collect::<Vec<_>>(), "phases": phases });
    if let Some(parallel) = args.parallel {
        plan["limits"]["parallel"] = json!(parallel);
    }
    if let Some(bytes) = args.bytes_per_second {
        plan["limits"]["bytes_per_second"] = json!(bytes);
    }
    if let Some(why) = &args.override_gate {
        plan["override_gate"] = json!(why);
    }
    Ok(plan)
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;
    use crawler_rollouts::NewPlan;

    use super::*;
    use crate::cli::{Cli, Command};
    use crate::rollout::RolloutTask;

    fn args(line: &str) -> PlanArgs {
        let words = ["terracrawler", "rollout", "start"]
            .into_iter()
            .chain(line.split(' '));
        let cli = Cli::try_parse_from(words).unwrap_or_else(|error| panic!("{line}: {error}"));
        match cli.command {
            Command::Rollout(args) => match args.task {
                RolloutTask::Start(start) => start.plan,
                other => panic!("{other:?}"),
            },
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn options_are_a_plan_that_servers_read() {
        let line = "--release 9f2c1ab034d5e6f7 --release 03b1f2d94c5a6e78=physical --share 10,100 --group a,b \
                    --group c --soak 5 --parallel 20 --bytes-per-second 50000 --override-gate hurry";
        let plan = of_options(&args(line)).expect("a plan");
        let phase = |select| json!({ "select": select, "soak_s": 5 });
        let expected = json!({
            "releases": [
                {"release": "9f2c1ab034d5e6f7"},
                {"release": "03b1f2d94c5a6e78", "kind": "physical"},
            ],
            "phases": [
                phase(json!({"group": ["a", "b"]})), phase(json!({"group": ["c"]})),
                phase(json!({"share": 10})), phase(json!({"share": 100})),
            ],
            "limits": {"parallel": 20, "bytes_per_second": 50_000},
            "override_gate": "hurry",
        });
        assert_eq!(plan, expected);
        let read: NewPlan = serde_json::from_value(plan).expect("a server reads it");
        assert_eq!(read.phases.len(), 4);
        let least = of_options(&args("--release 9f2c1ab034d5e6f7=simulated --share 100"));
        let least: NewPlan =
            serde_json::from_value(least.expect("a plan")).expect("a server reads it");
        assert_eq!((least.limits.parallel, least.phases[0].soak_s), (50, 600));
        let nobody = of_options(&args("--release 9f2c1ab034d5e6f7"));
        assert!(nobody.is_err_and(|error| error.to_string().contains("--share 10,100")));
    }

    #[test]
    fn the_plan_of_the_page_is_one_that_servers_read() {
        let page = include_str!("../../../docs/updates.md");
        let (_, block) = page.split_once("```text\n{").expect("a block");
        let (block, _) = block.split_once("```").expect("its end");
        let plan: NewPlan = serde_json::from_str(&format!("{{{block}")).expect("a plan");
        assert_eq!((plan.releases.len(), plan.phases.len()), (2, 3));
    }

    #[test]
    fn what_is_no_object_in_json_is_refused_before_it_is_sent() {
        for (text, why) in [
            ("", "no JSON"),
            ("{", "no JSON"),
            ("[]", "a JSON object"),
            ("{} {}", "no JSON"),
        ] {
            let refused = checked(text.as_bytes().to_vec(), "plan.json");
            let refused = refused.expect_err(text).to_string();
            assert!(
                refused.starts_with("plan.json: ") && refused.contains(why),
                "{refused}"
            );
        }
        let long = checked(vec![b' '; MOST + 1], "plan.json").expect_err("too long");
        let long = long.to_string();
        assert!(long.contains("524288 bytes"), "{long}");
        let sent = checked(b"{}".to_vec(), "plan.json").expect("an object");
        assert_eq!(sent, b"{}");
    }
}

//! Credentials of robots, of simulators and of learners.

use std::fmt::Write as _;
use std::path::Path;

use crawler_access::{Secret, UserName};
use crawler_sim::live::Authority;
use serde_json::json;

use super::Console;
use super::args::{RobotTask, Whose};
use crate::addresses::{Addresses, Endpoint};
use crate::calendar::moment;
use crate::config::{Broker, Settings};
use crawler_server_tls::first_certificate;
use crawler_system::cli_error::CliError;
use crawler_system::clock::now_ms;

pub(super) async fn run(task: RobotTask, settings: &Settings) -> Result<(), CliError> {
    let make = matches!(task, RobotTask::Enroll { .. });
    let console = Console::open(settings, make).await?;
    let result = match task {
        RobotTask::Enroll { whose, address } => {
            enroll(&console, settings, &whose, address.as_deref()).await
        }
        RobotTask::List => list(&console).await,
        RobotTask::Revoke { whose } => revoke(&console, &whose).await,
    };
    console.close().await;
    result
}

/// The name at the broker.
fn name(whose: &Whose) -> String {
    match (&whose.robot, &whose.simulator, &whose.learner) {
        (Some(robot), _, _) => robot.as_str().to_owned(),
        (None, Some(simulator), _) => format!("simulator-{}", simulator.as_str()),
        (None, None, Some(learner)) => format!("learner-{}", learner.as_str()),
        // The command line has required one of the three.
        (None, None, None) => String::new(),
    }
}

async fn enroll(
    console: &Console,
    settings: &Settings,
    whose: &Whose,
    address: Option<&str>,
) -> Result<(), CliError> {
    let name = name(whose);
    if let Some(robot) = &whose.robot {
        check_free(console, robot.as_str()).await?;
    }
    let broker = endpoint(settings, address, whose.robot.is_some())?;
    let before = console.records.credentials().get(&name).await?;
    let secret = Secret::generate()?;
    let result = console
        .records
        .credentials()
        .enroll(&name, secret.digest(), now_ms(), &console.who)
        .await;
    console
        .noted("robot.enroll", &name, json!({}), result)
        .await?;
    // What a script wants is on standard output, what a person wants beside it.
    let url = format!(
        "mqtt{}://{name}:{secret}@{broker}",
        if broker.tls { "s" } else { "" }
    );
    println!("{url}");
    eprint!("{}", advice(&url, &name, &secret, &broker, settings));
    if before.is_some_and(|credential| credential.revoked.is_none()) {
        eprintln!("The secret it had before is void.");
    }
    Ok(())
}

/// A robot goes by its id at the broker, where the server, simulators, learners and people have names too.
async fn check_free(console: &Console, robot: &str) -> Result<(), CliError> {
    let reserved = ["server", "simulator", "learner"].iter().any(|word| {
        robot
            .strip_prefix(word)
            .is_some_and(|rest| rest.is_empty() || rest.starts_with('-'))
    });
    if reserved {
        return Err(CliError::new(format!(
            "`{robot}` is a name that the server, a simulator or a learner goes by at the broker: give the \
             robot another id, or use --simulator NAME or --learner NAME"
        )));
    }
    if let Ok(name) = robot.parse::<UserName>()
        && console.find(&name).await?.is_some()
    {
        return Err(CliError::new(format!(
            "`{robot}` is the account of a person: give the robot another id"
        )));
    }
    Ok(())
}

/// What to do with a new secret.
fn advice(
    url: &str,
    name: &str,
    secret: &Secret,
    broker: &Endpoint,
    settings: &Settings,
) -> String {
    let mut text = String::from(
        "\nThis secret is shown once; the server keeps only its digest. If it is lost, enroll again.\n\n",
    );
    // Writing to a String does not fail.
    let _ = if name.starts_with("simulator-") {
        write!(
            text,
            "Start the robots with that address:\n  TERRACRAWLER_BROKER='{url}' terracrawler sim\n"
        )
    } else if name.starts_with("learner-") {
        write!(
            text,
            "Start the node with that address, on the machine that learns:\n  \
             TERRACRAWLER_BROKER='{url}' terracrawler learn-node\n"
        )
    } else {
        write!(
            text,
            "On the robot's page (docs/provisioning.md) enter:\n  \
             Address               {broker}\n{}  \
             User name             {name}\n  \
             Password of the user  {secret}\n  \
             Name of this robot    {name}\n  \
             Fleet                 {}\n",
            authority(broker, settings),
            settings.fleet
        )
    };
    if broker.is_loopback() {
        text.push_str(
            "\nThe address is of this machine alone. For machines elsewhere let the broker listen on the \
             network (--mqtt) and name its address here with --address.\n",
        );
    }
    text
}

/// The key of the first certificate in a file, as robots pin it; `None` when there is none that they
/// can use.
fn pin(certificate: &Path) -> Option<Authority> {
    let certificate = first_certificate(certificate).ok()?;
    Authority::of_certificate(&certificate).ok()
}

/// The line about what a robot knows the broker by.
fn authority(broker: &Endpoint, settings: &Settings) -> String {
    if !broker.tls {
        return String::new();
    }
    let pinned = match &settings.broker {
        Broker::Embedded(_) => pin(&settings.certificates().dir.join("ca.pem")),
        Broker::Outside(_) => settings.tls.broker_ca.as_deref().and_then(pin),
    };
    let pinned = pinned.filter(|_| settings.tls.own.is_none());
    pinned.map_or_else(
        || "  Authority             the key of the one that has signed the broker's certificate (docs/tls.md)\n".into(),
        |pinned| format!("  Authority             {pinned}\n"),
    )
}

async fn list(console: &Console) -> Result<(), CliError> {
    let credentials = console.records.credentials().all().await?;
    if credentials.is_empty() {
        println!("No credentials yet.");
        return Ok(());
    }
    println!("{:<42}  {:<20}  {:<24}  state", "name", "made", "by");
    for credential in credentials {
        let state = match credential.revoked {
            Some(at) => format!("revoked {}", moment(at)),
            None => "valid".into(),
        };
        println!(
            "{:<42}  {:<20}  {:<24}  {state}",
            credential.name,
            moment(credential.created),
            credential.by
        );
    }
    Ok(())
}

async fn revoke(console: &Console, whose: &Whose) -> Result<(), CliError> {
    let name = name(whose);
    let known = console.records.credentials().get(&name).await?;
    if known.is_none() {
        return Err(CliError::new(format!(
            "{name} has no credential; `terracrawler robot list` has those there are"
        )));
    }
    let result = console.records.credentials().revoke(&name, now_ms()).await;
    console
        .noted("robot.revoke", &name, json!({}), result)
        .await?;
    println!("The secret of {name} is void. A running server ends its connection within seconds.");
    Ok(())
}

/// Where robots find the broker: as told, or where the server is.
fn endpoint(
    settings: &Settings,
    address: Option<&str>,
    for_board: bool,
) -> Result<Endpoint, CliError> {
    let addresses = Addresses::of(settings);
    let Endpoint { host, port, tls } = if for_board {
        addresses.robots
    } else {
        addresses.simulators
    };
    let Some(address) = address else {
        return Ok(Endpoint { host, port, tls });
    };
    let wrong = || CliError::new(format!("--address: `{address}` is not HOST or HOST:PORT"));
    let (host, given) = if let Some(inner) = address.strip_prefix('[') {
        let (host, tail) = inner.split_once(']').ok_or_else(wrong)?;
        (host, tail.strip_prefix(':'))
    } else {
        match address.split_once(':') {
            Some((host, port)) => (host, Some(port)),
            None => (address, None),
        }
    };
    let legal = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | ':');
    if host.is_empty() || host.len() > 253 || !host.chars().all(legal) {
        return Err(wrong());
    }
    let port = match given {
        None => port,
        Some(text) => text
            .parse()
            .ok()
            .filter(|port| *port > 0)
            .ok_or_else(wrong)?,
    };
    Ok(Endpoint {
        host: host.to_owned(),
        port,
        tls,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Layer, Role};

    fn settings(mqtt: &str) -> Settings {
        let layer = Layer {
            mqtt: Some(mqtt.parse().expect("address")),
            ..Layer::default()
        };
        Settings::from_layers(Role::Serve, &[layer]).expect("settings")
    }

    #[test]
    fn robots_are_told_an_address_they_can_dial() {
        let settings = settings("10.1.2.3:1883");
        for (address, text) in [
            (None, "10.1.2.3:1883"),
            (Some("robots.example"), "robots.example:1883"),
            (Some("robots.example:8883"), "robots.example:8883"),
            (Some("[fd00::1]:8883"), "[fd00::1]:8883"),
            (Some("[fd00::1]"), "[fd00::1]:1883"),
        ] {
            let broker = endpoint(&settings, address, true).expect("an address");
            assert_eq!(broker.to_string(), text);
        }
        for wrong in [
            "",
            ":1883",
            "a b",
            "host:0",
            "host:99999",
            "[::1",
            "mqtt://host",
        ] {
            assert!(endpoint(&settings, Some(wrong), true).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_robot_is_told_by_what_it_knows_the_broker() {
        let data = std::env::temp_dir().join(format!("crawler-enroll-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&data);
        let mut settings = settings("10.1.2.3:8883");
        settings.data.clone_from(&data);
        let own = endpoint(&settings, None, true).expect("an address");
        assert!(own.tls && authority(&own, &settings).contains("docs/tls.md"));
        crawler_server_tls::Certificates::of(&settings.certificates()).expect("certificates");
        let told = authority(&own, &settings);
        let digits = told.split_whitespace().next_back().expect("a key");
        assert!(digits.parse::<Authority>().is_ok(), "{told}");
        let _ = std::fs::remove_dir_all(&data);
        let plain = Endpoint { tls: false, ..own };
        assert_eq!(authority(&plain, &settings), "");
    }
}

//! Configurations for Mosquitto: a bridge from the broker of a site to the one in the middle, and
//! what each client of that one may do.
//!
//! Both are written from the table that the embedded broker goes by ([`TABLE`]).

use std::collections::BTreeMap;
use std::fmt::Write as _;

use clap::{Args, Subcommand};
use crawler_access::Role;
use crawler_access::topics::{Act, Row, TABLE, Who};
use crawler_protocol::{Fleet, Qos, RobotId, Topic};
use crawler_system::cli_error::CliError;

use crate::config::{Broker, Common, Settings};

/// Configurations for the broker Mosquitto.
#[derive(Debug, Clone, Args)]
pub struct MosquittoArgs {
    /// Which one.
    #[command(subcommand)]
    pub task: MosquittoTask,
}

/// The configurations.
#[derive(Debug, Clone, Subcommand)]
pub enum MosquittoTask {
    /// Prints what makes the Mosquitto of a site forward to the fleet's broker, which is `--broker`
    Bridge {
        /// Name of the site
        #[arg(value_parser = site)]
        site: String,
        #[command(flatten)]
        #[allow(missing_docs)] // a doc comment here would become the command's description
        common: Common,
    },
    /// Prints an `acl_file` for the fleet's broker, where that is a Mosquitto
    Acl {
        /// User that the server, or all of several, logs in as
        #[arg(long, value_name = "NAME", default_value = "server")]
        server: String,
        /// Users that the bridges of sites log in as
        #[arg(long, value_name = "NAME")]
        bridge: Vec<String>,
        /// Users that simulators log in as
        #[arg(long, value_name = "NAME")]
        simulator: Vec<String>,
        /// Users that machines of federated learning log in as, `learner-NAME` each
        #[arg(long, value_name = "NAME")]
        learner: Vec<String>,
        /// People and programs that see everything
        #[arg(long, value_name = "NAME")]
        viewer: Vec<String>,
        /// People and programs that also command
        #[arg(long, value_name = "NAME")]
        operator: Vec<String>,
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        common: Common,
    },
}

impl MosquittoTask {
    pub(crate) fn common(self) -> Common {
        match self {
            Self::Bridge { common, .. } | Self::Acl { common, .. } => common,
        }
    }
}

/// Reads the name of a site.
fn site(text: &str) -> Result<String, &'static str> {
    let word = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
    if (1..=32).contains(&text.len()) && text.chars().all(word) {
        Ok(text.to_owned())
    } else {
        Err("1 to 32 of a-z, 0-9 and hyphen")
    }
}

/// Prints what was asked for.
pub(super) fn run(task: &MosquittoTask, settings: &Settings) -> Result<(), CliError> {
    let text = match task {
        MosquittoTask::Bridge { site, .. } => bridge(site, settings)?,
        MosquittoTask::Acl {
            server,
            bridge,
            simulator,
            learner,
            viewer,
            operator,
            ..
        } => {
            let users = [
                (vec![server.clone()], As::Server),
                (bridge.clone(), As::Bridge),
                (simulator.clone(), As::Simulator),
                (learner.clone(), As::Learner),
                (viewer.clone(), As::User(Role::Viewer)),
                (operator.clone(), As::User(Role::Operator)),
            ];
            acl(&settings.fleet, &users)?
        }
    };
    print!("{text}");
    Ok(())
}

/// A filter of the table for one fleet, with `own` in the place of the robot's id or the learner's name.
fn filter(topics: &str, fleet: &Fleet, own: &str) -> String {
    let text = topics.replace("{fleet}", fleet.as_str());
    text.replace("{own}", own)
}

/// The quality of service of the topics under a filter.
fn quality(filter: &str, fleet: &Fleet) -> u8 {
    // Robot ids and numbers of cells can be 0.
    match Topic::parse(fleet, &filter.replace('+', "0")).map(|topic| topic.qos()) {
        Ok(Qos::AtMostOnce) => 0,
        Ok(Qos::AtLeastOnce) | Err(_) => 1,
    }
}

/// Text that can stand in a line of Mosquitto's configuration.
fn line<'a>(what: &str, text: &'a str) -> Result<&'a str, CliError> {
    if text.is_empty() || text.contains(|c: char| c.is_control()) || text.trim() != text {
        return Err(CliError::new(format!(
            "the {what} cannot stand in a configuration"
        )));
    }
    Ok(text)
}

fn bridge(site: &str, settings: &Settings) -> Result<String, CliError> {
    let Broker::Outside(broker) = &settings.broker else {
        return Err(CliError::new("name the fleet's broker with --broker"));
    };
    let mut out = String::new();
    // Writing to a String does not fail.
    let _ = writeln!(
        out,
        "# Mosquitto 2, on a site: what robots here say goes to {broker}, what is for them comes\n\
         # back. Made by `terracrawler mosquitto bridge`.\n\
         connection {site}\n\
         address {}:{}\n\
         bridge_protocol_version mqttv50\n\
         remote_clientid bridge-{site}\n\
         cleansession true\n\
         notifications false\n\
         try_private false\n\
         restart_timeout 1 30\n\
         keepalive_interval 10",
        broker.host, broker.port
    );
    if let Some((user, password)) = &broker.credentials {
        let _ = writeln!(out, "remote_username {}", line("user name", user)?);
        if !password.is_empty() {
            let _ = writeln!(out, "remote_password {}", line("password", password)?);
        }
    }
    if broker.tls {
        let authorities = match &settings.tls.broker_ca {
            Some(path) => format!("bridge_cafile {}", line("path", &path.to_string_lossy())?),
            // Where Debian keeps those that the machine trusts.
            None => "bridge_capath /etc/ssl/certs".to_owned(),
        };
        let _ = writeln!(out, "{authorities}");
    }
    for (filter, direction) in directions(&settings.fleet) {
        let quality = quality(&filter, &settings.fleet);
        let _ = writeln!(out, "topic {filter} {direction} {quality}");
    }
    Ok(out)
}

/// What robots publish goes out, what they subscribe to comes in.
fn directions(fleet: &Fleet) -> BTreeMap<String, &'static str> {
    let mut all = BTreeMap::new();
    for row in TABLE.iter().filter(|row| row.who == Who::Robot) {
        let direction = match row.act {
            Act::Publish => "out",
            Act::Subscribe => "in",
        };
        all.entry(filter(row.topics, fleet, "+"))
            .and_modify(|known| {
                if *known != direction {
                    *known = "both";
                }
            })
            .or_insert(direction);
    }
    all
}

/// What a user of the broker is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum As {
    Server,
    /// All robots of a site, in one session.
    Bridge,
    /// All robots of a simulator, each in a session of its own, and what controls them.
    Simulator,
    /// A machine of federated learning.
    Learner,
    User(Role),
}

impl As {
    fn may(self, row: &Row) -> bool {
        match (self, row.who) {
            (Self::Server, Who::Server)
            | (Self::Bridge | Self::Simulator, Who::Robot)
            | (Self::Simulator, Who::Simulator)
            | (Self::Learner, Who::Learner) => true,
            (Self::User(role), Who::User(least)) => role >= least,
            _ => false,
        }
    }

    /// What stands in the place of `{own}` for the user of that name: every robot's id for those that have
    /// many robots, and for a learner its own.
    fn own(self, user: &str) -> Result<String, CliError> {
        if self != Self::Learner {
            return Ok("+".to_owned());
        }
        let node = user.strip_prefix("learner-").map(RobotId::new);
        let Some(Ok(node)) = node else {
            return Err(CliError::new(format!(
                "{user:?} is no name of a learner: learner- and 1 to 32 of a-z, 0-9 and hyphen"
            )));
        };
        Ok(node.as_str().to_owned())
    }
}

fn acl(fleet: &Fleet, users: &[(Vec<String>, As)]) -> Result<String, CliError> {
    let mut out = String::from(
        "# Mosquitto 2: what each client may do. Made by `terracrawler mosquitto acl`. Belongs to\n\
         # `allow_anonymous false` and a `password_file` in which every robot has its id as name.\n\n\
         # A robot, whose user name is %u.\n",
    );
    for row in TABLE.iter().filter(|row| row.who == Who::Robot) {
        let topics = filter(row.topics, fleet, "%u");
        let _ = writeln!(out, "pattern {} {topics}", access(row.act));
    }
    for (names, kind) in users {
        for name in names {
            // A wildcard in a name would be one in the patterns above.
            let word = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
            if name.is_empty() || !name.chars().all(word) {
                return Err(CliError::new(format!("{name:?} is no name of a user")));
            }
            let own = kind.own(name)?;
            let _ = writeln!(out, "\nuser {name}");
            for row in TABLE.iter().filter(|row| kind.may(row)) {
                let topics = filter(row.topics, fleet, &own);
                let _ = writeln!(out, "topic {} {topics}", access(row.act));
                // Mosquitto looks at what is denied first, whatever the order.
                if let Some(but) = row.but {
                    let _ = writeln!(out, "topic deny {}", filter(but, fleet, &own));
                }
            }
        }
    }
    Ok(out)
}

const fn access(act: Act) -> &'static str {
    match act {
        Act::Publish => "write",
        Act::Subscribe => "read",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Layer, Role as Part};

    fn settings(broker: &str) -> Settings {
        let layer = Layer {
            broker: Some(broker.parse().expect("an address")),
            ..Layer::default()
        };
        Settings::from_layers(Part::Sim, &[layer]).expect("settings")
    }

    #[test]
    fn a_bridge_carries_what_robots_say_and_hear() {
        let text = bridge("north", &settings("mqtts://site:secret@b.example")).expect("text");
        for line in [
            "address b.example:8883",
            "remote_username site",
            "remote_password secret",
            "bridge_capath /etc/ssl/certs",
            "topic swarm/telemetry/+ out 0",
            "topic swarm/status/+ out 1",
            "topic swarm/command/robot/+ in 1",
            "topic swarm/cell/+/+ in 0",
            "topic swarm/ota/+ both 1",
        ] {
            assert!(text.lines().any(|known| known == line), "{line}:\n{text}");
        }
        assert!(!text.contains("#\n") && !text.contains("topic #"), "{text}");
        let odd = settings("mqtt://site:two words @b.example");
        assert!(bridge("north", &odd).is_err());
    }

    #[test]
    fn the_rules_are_those_of_the_table() {
        let fleet = Fleet::default();
        let users = [
            (vec!["server".to_owned()], As::Server),
            (vec!["eve".to_owned()], As::User(Role::Viewer)),
        ];
        let text = acl(&fleet, &users).expect("text");
        for line in [
            "pattern write swarm/telemetry/%u",
            "pattern read swarm/command/robot/%u",
            "topic write #",
            "topic read swarm/#",
        ] {
            assert!(text.lines().any(|known| known == line), "{line}:\n{text}");
        }
        let eve = text.split("user eve").nth(1).expect("her part");
        assert!(!eve.contains("write"), "{eve}");
        let denied = eve.lines().any(|line| line == "topic deny swarm/ota/#");
        assert!(denied, "{eve}");
        assert_eq!(text.matches("deny").count(), 1, "{text}");
        let learners = [(vec!["learner-desk".to_owned()], As::Learner)];
        let text = acl(&fleet, &learners).expect("text");
        let desk = text.split("user learner-desk\n").nth(1);
        assert_eq!(
            desk,
            Some("topic write swarm/learn/+/update/desk\ntopic read swarm/learn/+/round\n"),
            "{text}"
        );
        for odd in ["desk", "learner-", "learner-Desk", "learner-desk.1"] {
            assert!(acl(&fleet, &[(vec![odd.to_owned()], As::Learner)]).is_err());
        }
        let odd = [(vec!["+".to_owned()], As::Server)];
        assert!(acl(&fleet, &odd).is_err());
    }
}

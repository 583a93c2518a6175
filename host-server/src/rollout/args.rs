//! What `terracrawler rollout` takes.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::{Args, Subcommand};
use crawler_access::UserName;
use crawler_protocol::{Kind, ReleaseId, RobotId};
use crawler_system::cli_error::{CliError, OrSay as _};
use crawler_updates::rollout::UpdateState;

use crate::addresses::Addresses;
use crate::client::{Client, ServerUrl};
use crate::config::{Layer, Settings};
use crate::terminal;

/// Most bytes of a file with a password.
const PASSWORD_MAX: usize = 4_096;

/// Rollouts.
#[derive(Debug, Clone, Args)]
pub struct RolloutArgs {
    /// What to do.
    #[command(subcommand)]
    pub task: RolloutTask,
    #[command(flatten)]
    #[allow(missing_docs)] // a doc comment here would become the command's description
    pub remote: RemoteArgs,
}

/// Which server is asked, and by whom.
#[derive(Debug, Clone, Args)]
pub struct RemoteArgs {
    /// Address of the server [default: the one of this machine, by its data directory]
    #[arg(long, value_name = "http://HOST:PORT", global = true)]
    pub(crate) server: Option<ServerUrl>,
    /// Account to log in with, where the server is not open; asks for its password
    #[arg(long, value_name = "NAME", global = true)]
    pub user: Option<UserName>,
    /// File with the password in its first line [default: a terminal, or standard input]
    #[arg(long, value_name = "FILE", requires = "user", global = true)]
    pub password_file: Option<PathBuf>,
    /// Authorities by which a server with TLS is trusted [default: its own for that of this machine, or those of
    /// this machine]
    #[arg(long, value_name = "FILE", global = true)]
    pub ca: Option<PathBuf>,
    /// Data directory of the server of this machine [default: data]
    #[arg(long, value_name = "DIR", global = true)]
    pub data: Option<PathBuf>,
    /// TOML file with the options of the server of this machine
    #[arg(long, value_name = "FILE", global = true)]
    pub config: Option<PathBuf>,
}

impl RemoteArgs {
    /// The options that it sets.
    pub(crate) fn layer(&self) -> Layer {
        Layer {
            data: self.data.clone(),
            ..Layer::default()
        }
    }

    /// A client of that server.
    ///
    /// # Errors
    /// When nobody would be trusted.
    pub(crate) fn client(&self, settings: &Settings) -> Result<Client, CliError> {
        if let Some(url) = &self.server {
            return Ok(Client::new(url.clone(), self.ca.as_deref())?);
        }
        let page = Addresses::of(settings).page;
        let url = page.parse::<ServerUrl>().or_say(|_| {
            format!("the server of this machine is at no address ({page}): name it with --server")
        })?;
        // The authority that a server makes for itself is in its data directory.
        let own = settings
            .tls
            .own
            .is_none()
            .then(|| settings.data.join("tls/ca.pem"));
        let own = own.filter(|path| path.exists());
        Ok(Client::new(url, self.ca.as_deref().or(own.as_deref()))?)
    }

    /// Logs in, where an account is named.
    ///
    /// # Errors
    /// One line saying why not.
    pub(crate) async fn log_in(&self, client: &mut Client) -> Result<(), CliError> {
        let Some(user) = &self.user else {
            return Ok(());
        };
        let password = match &self.password_file {
            Some(path) => first_line(path)?,
            None => terminal::password_of(user.as_ref())?,
        };
        Ok(client.log_in(user.as_ref(), &password).await?)
    }

    /// Whether the password is typed, or comes over standard input.
    pub(super) const fn reads_input(&self) -> bool {
        self.user.is_some() && self.password_file.is_none()
    }
}

fn first_line(path: &Path) -> Result<String, CliError> {
    let bytes = crate::release::read(path, PASSWORD_MAX)?;
    let line = bytes
        .split(|byte| *byte == b'\n')
        .next()
        .unwrap_or_default();
    let line = line.strip_suffix(b"\r").unwrap_or(line);
    String::from_utf8(line.to_vec())
        .ok()
        .filter(|line| !line.is_empty())
        .ok_or_else(|| CliError::new(format!("{}: its first line is no password", path.display())))
}

/// What can be done with rollouts.
#[derive(Debug, Clone, Subcommand)]
pub enum RolloutTask {
    /// Begins a rollout, by a plan or by options
    Start(Box<StartArgs>),
    /// Says how far a rollout is; without an id, lists the last ones
    #[command(after_help = WATCHED)]
    Show {
        /// Id of the rollout
        #[arg(value_name = "ID")]
        id: Option<u64>,
        /// JSON instead of a table
        #[arg(long)]
        json: bool,
        /// Follows it until it ends or is paused
        #[arg(long, requires = "id")]
        watch: bool,
    },
    /// Offers nothing more for now; robots that have not started the new program give it up
    Pause {
        /// Id of the rollout
        #[arg(value_name = "ID")]
        id: u64,
    },
    /// Goes on with a rollout that is paused; failures that stopped it do not count any more
    #[command(after_help = WATCHED)]
    Resume {
        /// Id of the rollout
        #[arg(value_name = "ID")]
        id: u64,
        /// Follows it until it ends or is paused
        #[arg(long)]
        watch: bool,
    },
    /// Ends a rollout; robots on trial come to the end of that
    Abort {
        /// Id of the rollout
        #[arg(value_name = "ID")]
        id: u64,
    },
    /// Lists robots of a rollout: where each stands, and why
    Robots {
        /// Id of the rollout
        #[arg(value_name = "ID")]
        id: u64,
        /// Only those in this state, like failed or confirmed
        #[arg(long, value_name = "STATE", value_parser = state)]
        state: Option<String>,
        /// JSON instead of a table
        #[arg(long)]
        json: bool,
    },
    /// Offers the release to a robot again that has failed, was rolled back, or left out
    Retry {
        /// Id of the rollout
        #[arg(value_name = "ID")]
        id: u64,
        /// Id of the robot
        #[arg(value_name = "ROBOT")]
        robot: RobotId,
    },
    /// Leaves a robot out of a rollout
    Skip {
        /// Id of the rollout
        #[arg(value_name = "ID")]
        id: u64,
        /// Id of the robot
        #[arg(value_name = "ROBOT")]
        robot: RobotId,
    },
}

/// What the exit code says of a rollout that was followed.
const WATCHED: &str = "With --watch it ends with 0 when the rollout is done, with 3 when it is paused, and with 4 when \
                       it was aborted; with 1 when the server refuses, or does not answer any more.";

/// What `rollout start` takes.
#[derive(Debug, Clone, Args)]
#[command(after_help = WATCHED)]
pub struct StartArgs {
    #[command(flatten)]
    #[allow(missing_docs)] // a doc comment here would become the command's description
    pub plan: PlanArgs,
    /// Follows it until it ends or is paused
    #[arg(long)]
    pub watch: bool,
    /// JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// A plan: a file with all of it, or what most of them say.
#[derive(Debug, Clone, Default, Args)]
pub struct PlanArgs {
    /// File with a plan in JSON, or `-` for standard input
    #[arg(value_name = "PLAN", required_unless_present = "release")]
    pub file: Option<PathBuf>,
    /// Id of a release that the server has; may be given several times, for several boards, and as ID=physical,
    /// ID=emulated or ID=simulated for robots of one kind
    #[arg(long, value_name = "ID[=KIND]", value_parser = release, conflicts_with = "file")]
    pub release: Vec<(ReleaseId, Option<Kind>)>,
    #[command(flatten)]
    #[allow(missing_docs)] // as above
    pub phases: Phases,
    /// Robots at work at once [default: 50]
    #[arg(long, value_name = "N", requires = "release")]
    pub parallel: Option<u32>,
    /// Bytes of images per second, to all robots together [default: no limit]
    #[arg(long, value_name = "N", requires = "release")]
    pub bytes_per_second: Option<u32>,
    /// Why the releases go out although they have no gate that has passed; everybody sees it, and the audit log keeps
    /// it
    #[arg(long, value_name = "WHY", requires = "release")]
    pub override_gate: Option<String>,
}

impl PlanArgs {
    /// Whether the plan comes over standard input.
    pub(super) fn is_piped(&self) -> bool {
        self.file
            .as_ref()
            .is_some_and(|path| path.as_os_str() == "-")
    }
}

/// Who gets the release, in phases.
#[derive(Debug, Clone, Default, Args)]
pub struct Phases {
    /// Robots of a phase, separated by commas; may be given several times. Groups come before shares
    #[arg(long, value_name = "ROBOTS", requires = "release")]
    pub group: Vec<Group>,
    /// Shares of the robots in percent, a phase each, those of earlier phases included
    #[arg(long, value_name = "PERCENT,…", value_delimiter = ',', requires = "release",
          value_parser = clap::value_parser!(u8).range(1..=100))]
    pub share: Vec<u8>,
    /// How long each phase is watched once its robots are done [default: 600]
    #[arg(long, value_name = "SECONDS", requires = "release")]
    pub soak: Option<u32>,
}

/// Robots of a phase.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group(pub Vec<RobotId>);

impl FromStr for Group {
    type Err = CliError;

    fn from_str(text: &str) -> Result<Self, CliError> {
        let robots = text.split(',').map(|name| {
            RobotId::new(name)
                .or_say(|_| format!("`{name}` is not a robot's id: 1 to 32 of a-z, 0-9 and -"))
        });
        robots.collect::<Result<_, _>>().map(Self)
    }
}

fn release(text: &str) -> Result<(ReleaseId, Option<Kind>), CliError> {
    let (id, kind) = match text.split_once('=') {
        Some((id, word)) => {
            let kind = Kind::from_name(word);
            let unknown = || CliError::new("behind `=` stands physical, emulated or simulated");
            (id, Some(kind.ok_or_else(unknown)?))
        }
        None => (text, None),
    };
    let id = id.parse();
    let id = id.map_err(|_| CliError::new("the id of a release has 16 of 0-9 and a-f"))?;
    Ok((id, kind))
}

fn state(text: &str) -> Result<String, CliError> {
    let known = UpdateState::ALL.map(UpdateState::name);
    if known.contains(&text) {
        return Ok(text.to_owned());
    }
    Err(CliError::new(format!(
        "must be one of {}",
        known.join(", ")
    )))
}

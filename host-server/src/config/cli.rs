//! The command line.

use std::net::SocketAddr;
use std::num::NonZeroU8;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand};
use crawler_protocol::Fleet;

use super::layer::parse_fleet;
use super::{
    BrokerUrl, ConfigError, EngineUrl, Influx, Layer, LogFormat, Networks, Postgres, Redis, Role,
    TlsMode, TlsNames,
};
use crate::console::{AuditArgs, BackupArgs, MosquittoArgs, RestoreArgs, RobotArgs, UserArgs};
use crate::evaluate::EvaluateArgs;
use crate::replay::ReplayArgs;

/// A swarm of robots, simulated or real: broker, API, control room.
///
/// Every option of `up`, `serve`, `sim` and `doctor` is also an environment variable (`--log-format` is
/// `TERRACRAWLER_LOG_FORMAT`) and a key of the file given by `--config` (`log_format`). The command line
/// wins over the environment, that over the file.
#[derive(Debug, Parser)]
#[command(name = "terracrawler", version)]
pub struct Cli {
    /// What to run.
    #[command(subcommand)]
    pub command: Command,
}

/// What to run.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Server, broker and simulated robots in one process
    Up {
        #[command(flatten)]
        #[allow(missing_docs)] // a doc comment here would become the command's description
        common: Common,
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        server: ServerOptions,
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        robots: RobotOptions,
    },
    /// Server and broker, without robots
    Serve {
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        common: Common,
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        server: ServerOptions,
    },
    /// Simulated robots alone, on any MQTT 5 broker
    Sim {
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        common: Common,
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        robots: RobotOptions,
    },
    /// Runs a scenario on many seeds and tells what comes of it
    Evaluate(Box<EvaluateArgs>),
    /// Runs a recording, or a seed, through the program once more
    Replay(Box<ReplayArgs>),
    /// Accounts of people
    User(UserArgs),
    /// Credentials of robots and simulators
    Robot(RobotArgs),
    /// Who did what
    Audit(AuditArgs),
    /// Copies records, keys and certificates to one file, also beside a running server
    Backup(BackupArgs),
    /// Puts a backup back
    Restore(RestoreArgs),
    /// Configurations for the broker Mosquitto, on sites and in the middle
    Mosquitto(MosquittoArgs),
    /// Checks everything a server needs, and says what to do
    Doctor {
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        common: Common,
        #[command(flatten)]
        #[allow(missing_docs)] // as above
        server: ServerOptions,
    },
}

/// Options of every command.
#[derive(Debug, Clone, Args)]
pub struct Common {
    /// TOML file with options
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Root topic of the fleet [default: swarm]
    #[arg(long, value_name = "NAME", value_parser = parse_fleet)]
    pub fleet: Option<Fleet>,
    /// Outside MQTT 5 broker, like `mqtt://host:1883` or `mqtts://host:8883`
    #[arg(long, value_name = "URL")]
    pub broker: Option<BrokerUrl>,
    /// PEM file with the authorities that broker is trusted by [default: those of this machine]
    #[arg(long, value_name = "FILE")]
    pub broker_ca: Option<PathBuf>,
    /// Log filter, like `debug` or `info,crawler_server=trace` [default: info]
    #[arg(long, value_name = "FILTER")]
    pub log: Option<String>,
    /// How log lines are written [default: text]
    #[arg(long, value_enum, value_name = "FORMAT", hide_possible_values = false)]
    pub log_format: Option<LogFormat>,
}

/// Options of the server.
#[derive(Debug, Args)]
pub struct ServerOptions {
    /// Address of API and control room [default: 127.0.0.1:8080]
    #[arg(long, value_name = "ADDRESS")]
    pub http: Option<SocketAddr>,
    /// Address of the embedded broker [default: 127.0.0.1:1883]
    #[arg(long, value_name = "ADDRESS", conflicts_with = "broker")]
    pub mqtt: Option<SocketAddr>,
    /// Directory for what must survive a restart [default: data]
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)] // as above
    pub engines: EngineOptions,
    /// Load balancers whose `X-Forwarded-For` is believed: addresses or networks, separated by commas
    #[arg(long, value_name = "NETWORKS")]
    pub trusted_proxies: Option<Networks>,
    #[command(flatten)]
    #[allow(missing_docs)] // as above
    pub tls: TlsOptions,
    /// No accounts: everyone who reaches the server may do everything
    #[arg(long, num_args = 0..=1, default_missing_value = "true", value_name = "BOOL")]
    pub open: Option<bool>,
    /// Trials of experiments that run at the same time [default: one for every two processors]
    #[arg(long, value_name = "N")]
    pub experiment_threads: Option<NonZeroU8>,
}

/// Options of what outgrows one machine.
#[derive(Debug, Args)]
pub struct EngineOptions {
    /// `PostgreSQL` database for accounts, credentials and audit log [default: a file in the data directory]
    #[arg(long, value_name = "URL")]
    pub database: Option<EngineUrl<Postgres>>,
    /// Engine for the history that takes `InfluxDB`'s line protocol [default: a file in the data directory]
    #[arg(long, value_name = "URL")]
    pub timeseries: Option<EngineUrl<Influx>>,
    /// Redis, for what several servers of one fleet must agree on quickly
    #[arg(long, value_name = "URL")]
    pub cache: Option<EngineUrl<Redis>>,
}

/// Options of TLS.
#[derive(Debug, Args)]
pub struct TlsOptions {
    /// Whether listeners speak TLS; `auto`: those that other machines can reach [default: auto]
    #[arg(long, value_enum, value_name = "WHEN", hide_possible_values = false)]
    pub tls: Option<TlsMode>,
    /// More names and addresses for the certificate that the server makes, separated by commas
    #[arg(long, value_name = "NAMES")]
    pub tls_names: Option<TlsNames>,
    /// PEM file with another certificate and its chain
    #[arg(long, value_name = "FILE")]
    pub tls_certificate: Option<PathBuf>,
    /// PEM file with the key of that
    #[arg(long, value_name = "FILE")]
    pub tls_key: Option<PathBuf>,
    /// PEM file with the authorities of certificates that MQTT clients may show
    #[arg(long, value_name = "FILE")]
    pub tls_client_ca: Option<PathBuf>,
    /// Address at which the embedded broker listens without TLS as well, for robots that have none
    #[arg(long, value_name = "ADDRESS")]
    pub mqtt_plain: Option<SocketAddr>,
}

/// Options of the simulated robots.
#[derive(Debug, Args)]
pub struct RobotOptions {
    /// How many [default: those of the scenario, or 50]
    #[arg(long, value_name = "N")]
    pub robots: Option<u32>,
    /// Name or TOML file of the scenario they live in
    #[arg(long, value_name = "SCENARIO")]
    pub scenario: Option<String>,
    /// Seed of their world: the same seed draws the same arena [default: 1]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Address at which real boards can join the radio of the scenario, on their way to the broker
    #[arg(long, value_name = "ADDRESS")]
    pub radio_proxy: Option<SocketAddr>,
    /// MCAP file to record the world to
    #[arg(long, value_name = "FILE")]
    pub record: Option<PathBuf>,
}

impl Cli {
    pub(super) fn into_layer(self) -> Result<(Role, Layer, Option<PathBuf>), ConfigError> {
        let (role, common, server, robots) = match self.command {
            Command::Up {
                common,
                server,
                robots,
            } => (Role::Up, common, Some(server), Some(robots)),
            // The doctor looks at a server with these options.
            Command::Serve { common, server } | Command::Doctor { common, server } => {
                (Role::Serve, common, Some(server), None)
            }
            Command::User(UserArgs { place, .. })
            | Command::Robot(RobotArgs { place, .. })
            | Command::Audit(AuditArgs { place, .. })
            | Command::Backup(BackupArgs { place, .. })
            | Command::Restore(RestoreArgs { place, .. }) => {
                return Ok((Role::Serve, place.layer(), place.config));
            }
            Command::Mosquitto(args) => (Role::Sim, args.task.common(), None, None),
            Command::Sim { common, robots } => (Role::Sim, common, None, Some(robots)),
            Command::Evaluate(_) => {
                return Err(ConfigError::Conflict("`evaluate` has options of its own"));
            }
            Command::Replay(_) => {
                return Err(ConfigError::Conflict("`replay` has options of its own"));
            }
        };
        let mut layer = Layer {
            fleet: common.fleet,
            broker: common.broker,
            broker_ca: common.broker_ca,
            log: common.log,
            log_format: common.log_format,
            ..Layer::default()
        };
        if let Some(server) = server {
            layer.http = server.http;
            layer.mqtt = server.mqtt;
            layer.data = server.data;
            layer.database = server.engines.database;
            layer.timeseries = server.engines.timeseries;
            layer.cache = server.engines.cache;
            layer.trusted_proxies = server.trusted_proxies;
            layer.tls = server.tls.tls;
            layer.tls_names = server.tls.tls_names;
            layer.tls_certificate = server.tls.tls_certificate;
            layer.tls_key = server.tls.tls_key;
            layer.tls_client_ca = server.tls.tls_client_ca;
            layer.mqtt_plain = server.tls.mqtt_plain;
            layer.open = server.open;
            layer.experiment_threads = server.experiment_threads;
        }
        if let Some(robots) = robots {
            layer.robots = robots.robots;
            layer.scenario = robots.scenario;
            layer.seed = robots.seed;
            layer.radio_proxy = robots.radio_proxy;
            layer.record = robots.record;
        }
        Ok((role, layer, common.config))
    }
}

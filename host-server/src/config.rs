//! Options: the command line wins over the environment, that over the file, that over defaults.
//!
//! Every option exists in all three places under one name: `--log-format`,
//! `TERRACRAWLER_LOG_FORMAT` and the key `log_format` of the file given by `--config`. A name
//! nobody knows is an error in each of them, so a typing mistake cannot pass for a default.

mod keys;
mod layer;
mod options;
mod place;
mod tls;
mod worker_name;

use std::ffi::OsString;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::num::NonZeroU8;
use std::path::{Path, PathBuf};

use crawler_protocol::Fleet;

pub use crawler_system::address::{
    BrokerUrl, BrokerUrlError, Engine, EngineUrl, Influx, Networks, NoEngineUrl, NoNetwork,
    Postgres, Redis,
};

use crawler_server_tls::CertificateOptions;

pub use keys::{KeyFiles, NoKeyFiles};
pub(crate) use layer::KEYS;
pub use layer::{BadFile, Layer, LogFormat, RequireGate};
pub use options::{Common, EngineOptions, RobotOptions, ServerOptions, TlsOptions, WorkerOptions};
pub use place::Place;
pub use tls::{NoTlsName, TlsMode, TlsNames, TlsSettings};
pub use worker_name::{NoWorkerName, WorkerName};

/// Prefix of every environment variable of this program.
pub const ENV_PREFIX: &str = "TERRACRAWLER_";

/// How many simulated robots one process may be asked for.
pub const MAX_SIMULATED: u32 = 10_000;

/// And how many there are when nobody says.
pub const DEFAULT_ROBOTS: u32 = 50;

/// Which parts of the program run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Server, broker (unless an outside one is named) and simulated robots.
    Up,
    /// Server and broker, no robots.
    Serve,
    /// Simulated robots alone, on somebody's broker.
    Sim,
    /// Experiments of servers, in their database.
    Worker,
}

/// Where the fleet's broker is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Broker {
    /// In this process, listening at this address.
    Embedded(SocketAddr),
    /// Somewhere else.
    Outside(BrokerUrl),
}

/// All options, resolved.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Which parts of the program run.
    pub role: Role,
    /// Root topic of the fleet.
    pub fleet: Fleet,
    /// Where the fleet's broker is.
    pub broker: Broker,
    /// Address of API and control room.
    pub http: SocketAddr,
    /// Where the server keeps what must survive a restart.
    pub data: PathBuf,
    /// Where the records are; `None` for a file in the data directory.
    pub database: Option<EngineUrl<Postgres>>,
    /// Where the history is; `None` for a file in the data directory.
    pub timeseries: Option<EngineUrl<Influx>>,
    /// What several servers agree on quickly is here; `None` for a server that is alone.
    pub cache: Option<EngineUrl<Redis>>,
    /// Proxies whose word on where a request came from is believed.
    pub trusted_proxies: Networks,
    /// Whether everyone who connects may do everything. Without it nobody may do anything without an
    /// account or the credential of a robot.
    pub open: bool,
    /// Number of simulated robots; `None` leaves it to the scenario.
    pub robots: Option<u32>,
    /// Name or file of the scenario the simulated robots live in.
    pub scenario: Option<String>,
    /// Seed of the simulated world.
    pub seed: u64,
    /// Where boards can join the radio of the simulated world.
    pub radio_proxy: Option<SocketAddr>,
    /// MCAP file that the simulated world is recorded to.
    pub record: Option<PathBuf>,
    /// Public keys by which the server and simulated robots believe releases; `None` when they take none.
    pub release_key: Option<KeyFiles>,
    /// Of which releases a rollout demands a gate that has passed.
    pub require_gate: RequireGate,
    /// Robots that have a twin at a time; none where it is 0.
    pub twins: usize,
    /// Log filter in the syntax of `tracing_subscriber::EnvFilter`.
    pub log: String,
    /// How log lines are written.
    pub log_format: LogFormat,
    /// The options of TLS.
    pub tls: TlsSettings,
    /// Trials of experiments that run at the same time; `None` for one for every two processors.
    pub experiment_threads: Option<NonZeroU8>,
    /// The name of this process among those that work on experiments; `None` for that of the machine.
    pub worker_name: Option<WorkerName>,
}

/// Why the options cannot be used.
#[derive(Debug)]
#[non_exhaustive]
pub enum ConfigError {
    /// The file could not be read.
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        cause: std::io::Error,
    },
    /// The file is not what it should be.
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong and where.
        cause: BadFile,
    },
    /// An environment variable with our prefix that is not an option.
    UnknownVariable(String),
    /// A value that cannot be used.
    Value {
        /// Where it came from, as the person wrote it.
        origin: String,
        /// What is wrong with it.
        text: String,
    },
    /// Two options that exclude each other.
    Conflict(&'static str),
}

impl std::fmt::Display for ConfigError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Read { path, cause } => write!(f, "cannot read {}: {cause}", path.display()),
            Self::File { path, cause } => write!(f, "{}: {cause}", path.display()),
            Self::UnknownVariable(name) => write!(
                f,
                "unknown environment variable {name}; known ones are {}",
                KEYS.iter()
                    .map(|key| format!("{ENV_PREFIX}{}", key.to_uppercase()))
                    .chain([format!("{ENV_PREFIX}CONFIG")])
                    .collect::<Vec<_>>()
                    .join(", ")
            ),
            Self::Value { origin, text } => write!(f, "{origin}: {text}"),
            Self::Conflict(text) => f.write_str(text),
        }
    }
}

impl std::error::Error for ConfigError {}

impl Settings {
    /// Resolves the options of one run: those of the command line, and the file that it names.
    ///
    /// `environment` is every variable of the process; those without our prefix are ignored.
    ///
    /// # Errors
    /// [`ConfigError`] when a source cannot be read or holds something unknown or unusable.
    pub fn resolve(
        role: Role,
        arguments: Layer,
        config: Option<PathBuf>,
        environment: impl IntoIterator<Item = (OsString, OsString)>,
    ) -> Result<Self, ConfigError> {
        let (environment, environment_config) = Layer::from_environment(environment)?;
        let file = match config.or(environment_config) {
            Some(path) => read_file(&path)?,
            None => Layer::default(),
        };
        Self::from_layers(role, &[arguments, environment, file])
    }

    /// Resolves layers, the strongest first.
    ///
    /// # Errors
    /// [`ConfigError`] when values are out of range or exclude each other.
    pub fn from_layers(role: Role, layers: &[Layer]) -> Result<Self, ConfigError> {
        let first = |level: fn(&Layer) -> bool| layers.iter().position(level);
        let mqtt_at = first(|layer| layer.mqtt.is_some());
        let broker_at = first(|layer| layer.broker.is_some());
        let mut merged = Layer::default();
        for layer in layers {
            merged.fill_from(layer);
        }
        let loopback = |port| SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), port);
        let broker = match (role, merged.broker.clone(), merged.mqtt) {
            (Role::Sim | Role::Worker, Some(url), _) => Broker::Outside(url),
            (Role::Sim | Role::Worker, None, _) => Broker::Outside(BrokerUrl::loopback()),
            (Role::Up | Role::Serve, Some(_), Some(_)) if mqtt_at == broker_at => {
                return Err(ConfigError::Conflict(
                    "`mqtt` sets where the embedded broker listens and `broker` names an outside \
                     one: give one of the two",
                ));
            }
            // The stronger source decides: `--mqtt` on the command line overrules a `broker` key
            // in the file, and the other way round.
            (Role::Up | Role::Serve, Some(url), _) if mqtt_at.is_none() || broker_at < mqtt_at => {
                Broker::Outside(url)
            }
            (Role::Up | Role::Serve, _, listen) => {
                Broker::Embedded(listen.unwrap_or_else(|| loopback(1883)))
            }
        };
        if merged.cache.is_some() && matches!(broker, Broker::Embedded(_)) {
            return Err(ConfigError::Conflict(
                "`cache` is for several servers of one fleet, which need a broker that all of them \
                 reach: name it with `broker`",
            ));
        }
        if role == Role::Worker && merged.database.is_none() {
            return Err(ConfigError::Conflict(
                "a worker shares the `database` of servers: name it like \
                 postgres://user:password@host/database",
            ));
        }
        if merged.record.is_some() && merged.release_key.is_some() {
            return Err(ConfigError::Conflict(
                "robots that are recorded (`record`) take no updates (`release_key`)",
            ));
        }
        let tls = TlsSettings::resolve(role, &merged, &broker)?;
        // A scenario that somebody chose knows how many robots it is for.
        let robots = merged
            .robots
            .or_else(|| merged.scenario.is_none().then_some(DEFAULT_ROBOTS));
        // A radio for boards alone needs no robots.
        let least = u32::from(merged.radio_proxy.is_none());
        if let Some(robots) = robots
            && matches!(role, Role::Up | Role::Sim)
            && !(least..=MAX_SIMULATED).contains(&robots)
        {
            return Err(ConfigError::Value {
                origin: "robots".into(),
                text: format!("{robots} is outside {least} to {MAX_SIMULATED}"),
            });
        }
        Ok(Self {
            role,
            fleet: merged.fleet.unwrap_or_default(),
            broker,
            http: merged.http.unwrap_or_else(|| loopback(8080)),
            data: merged.data.unwrap_or_else(|| PathBuf::from("data")),
            database: merged.database,
            timeseries: merged.timeseries,
            cache: merged.cache,
            trusted_proxies: merged.trusted_proxies.unwrap_or_default(),
            open: merged.open.unwrap_or(false),
            robots,
            scenario: merged.scenario,
            seed: merged.seed.unwrap_or(1),
            radio_proxy: merged
                .radio_proxy
                .filter(|_| matches!(role, Role::Up | Role::Sim)),
            record: merged.record,
            release_key: merged.release_key,
            require_gate: merged.require_gate.unwrap_or_default(),
            twins: merged.twins.map_or(crawler_twins::MOST, usize::from),
            log: merged
                .log
                .unwrap_or_else(|| "info,rmqtt=error,rmqtt_net=error".into()),
            log_format: merged.log_format.unwrap_or_default(),
            tls,
            experiment_threads: merged.experiment_threads,
            worker_name: merged.worker_name,
        })
    }

    /// What people call this process among those that work on experiments.
    #[must_use]
    pub fn worker_name(&self) -> String {
        let given = self.worker_name.as_ref();
        given.map_or_else(crawler_experiments::machine, |name| {
            name.as_str().to_owned()
        })
    }

    /// What the certificate of the listeners that speak TLS is to be.
    pub(crate) fn certificates(&self) -> CertificateOptions {
        let mqtt = match self.broker {
            Broker::Embedded(listen) => Some(listen),
            Broker::Outside(_) => None,
        };
        let listeners = mqtt.into_iter().chain([self.http]);
        CertificateOptions {
            own: self.tls.own.clone(),
            names: self.tls.names.as_slice().to_vec(),
            dir: self.data.join("tls"),
            listeners: listeners
                .filter(|listen| self.tls.covers(*listen))
                .collect(),
        }
    }

    /// The addresses that machines other than this one can reach.
    #[must_use]
    pub fn exposed(&self) -> Vec<(&'static str, SocketAddr)> {
        let mut exposed = Vec::new();
        if let Some(address) = self.radio_proxy
            && !address.ip().is_loopback()
        {
            exposed.push(("radio proxy to the MQTT broker", address));
        }
        if matches!(self.role, Role::Sim | Role::Worker) {
            return exposed;
        }
        if !self.http.ip().is_loopback() {
            exposed.push(("API and control room", self.http));
        }
        if let Broker::Embedded(address) = self.broker
            && !address.ip().is_loopback()
        {
            exposed.push(("MQTT broker", address));
        }
        if let Some(address) = self.tls.mqtt_plain
            && !address.ip().is_loopback()
        {
            exposed.push(("MQTT broker without TLS", address));
        }
        exposed
    }
}

fn read_file(path: &Path) -> Result<Layer, ConfigError> {
    let text = crawler_system::text::read_text(path).map_err(|cause| ConfigError::Read {
        path: path.to_owned(),
        cause,
    })?;
    Layer::from_toml(&text).map_err(|cause| ConfigError::File {
        path: path.to_owned(),
        cause,
    })
}

//! One source of options: each of them may be there or not.

use std::ffi::OsString;
use std::fmt::{self, Display};
use std::net::SocketAddr;
use std::num::NonZeroU8;
use std::path::PathBuf;
use std::str::FromStr;

use crawler_protocol::Fleet;
use crawler_rollouts::GateDemand;
use serde::Deserialize;

use super::{
    BrokerUrl, ConfigError, ENV_PREFIX, EngineUrl, Influx, KeyFiles, Networks, Postgres, Redis,
    TlsMode, TlsNames, WorkerName,
};

/// How log lines are written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum LogFormat {
    /// For people.
    #[default]
    Text,
    /// One JSON object per line.
    Json,
}

impl FromStr for LogFormat {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "text" => Ok(Self::Text),
            "json" => Ok(Self::Json),
            _ => Err("must be `text` or `json`"),
        }
    }
}

/// Of which releases a rollout demands a gate that has passed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum RequireGate {
    /// Of those for boards, not of those for simulated robots.
    #[default]
    Boards,
    /// Of all.
    All,
    /// Of none.
    None,
}

impl FromStr for RequireGate {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text {
            "boards" => Ok(Self::Boards),
            "all" => Ok(Self::All),
            "none" => Ok(Self::None),
            _ => Err("must be `boards`, `all` or `none`"),
        }
    }
}

impl From<RequireGate> for GateDemand {
    fn from(option: RequireGate) -> Self {
        match option {
            RequireGate::Boards => Self::Boards,
            RequireGate::All => Self::All,
            RequireGate::None => Self::None,
        }
    }
}

/// Every key, as the file spells it.
pub(crate) const KEYS: [&str; 29] = [
    "fleet",
    "broker",
    "mqtt",
    "http",
    "data",
    "database",
    "timeseries",
    "cache",
    "trusted_proxies",
    "open",
    "robots",
    "scenario",
    "seed",
    "radio_proxy",
    "record",
    "release_key",
    "require_gate",
    "twins",
    "log",
    "log_format",
    "tls",
    "tls_names",
    "tls_certificate",
    "tls_key",
    "tls_client_ca",
    "mqtt_plain",
    "broker_ca",
    "experiment_threads",
    "worker_name",
];

/// One source of options. The fields are those of [`super::Settings`].
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// Root topic of the fleet.
    pub fleet: Option<Fleet>,
    /// An outside broker.
    pub broker: Option<BrokerUrl>,
    /// Where the embedded broker listens.
    pub mqtt: Option<SocketAddr>,
    /// Address of API and control room.
    pub http: Option<SocketAddr>,
    /// Where the server keeps what must survive a restart.
    pub data: Option<PathBuf>,
    /// Where the records are.
    pub database: Option<EngineUrl<Postgres>>,
    /// Where the history is.
    pub timeseries: Option<EngineUrl<Influx>>,
    /// What several servers agree on.
    pub cache: Option<EngineUrl<Redis>>,
    /// Proxies whose word on where a request came from is believed.
    pub trusted_proxies: Option<Networks>,
    /// Whether everyone may do everything.
    pub open: Option<bool>,
    /// Number of simulated robots.
    pub robots: Option<u32>,
    /// Name or file of the scenario.
    pub scenario: Option<String>,
    /// Seed of the simulated world.
    pub seed: Option<u64>,
    /// Where boards can join the radio of the simulated world.
    pub radio_proxy: Option<SocketAddr>,
    /// MCAP file that the simulated world is recorded to.
    pub record: Option<PathBuf>,
    /// Public keys by which the server, and its simulated robots, believe releases.
    pub release_key: Option<KeyFiles>,
    /// Of which releases a gate is demanded.
    pub require_gate: Option<RequireGate>,
    /// Robots that have a twin at a time.
    pub twins: Option<u16>,
    /// Log filter.
    pub log: Option<String>,
    /// How log lines are written.
    pub log_format: Option<LogFormat>,
    /// Whether listeners speak TLS.
    pub tls: Option<TlsMode>,
    /// More names for the certificate that the server makes.
    pub tls_names: Option<TlsNames>,
    /// Certificate of the user, with its chain.
    pub tls_certificate: Option<PathBuf>,
    /// Its key.
    pub tls_key: Option<PathBuf>,
    /// Authorities of the certificates that MQTT clients may show.
    pub tls_client_ca: Option<PathBuf>,
    /// Where the embedded broker listens without TLS as well.
    pub mqtt_plain: Option<SocketAddr>,
    /// Authorities that an outside broker is trusted by.
    pub broker_ca: Option<PathBuf>,
    /// Trials of experiments that run at the same time.
    pub experiment_threads: Option<NonZeroU8>,
    /// What this process is called among those that work on experiments.
    pub worker_name: Option<WorkerName>,
}

/// What is wrong with a file of options, and where.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadFile {
    line: usize,
    what: String,
}

impl Display for BadFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: {}", self.line, self.what)
    }
}

impl std::error::Error for BadFile {}

/// What is wrong with the value of an option.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct BadValue(String);

impl Display for BadValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for BadValue {}

impl Layer {
    /// Reads the file format.
    ///
    /// # Errors
    /// [`BadFile`]
    pub fn from_toml(text: &str) -> Result<Self, BadFile> {
        toml::from_str(text).map_err(|error| {
            let line = error
                .span()
                .map_or(1, |span| 1 + text[..span.start].matches('\n').count());
            BadFile {
                line,
                what: error.message().replace('\n', " "),
            }
        })
    }

    /// Reads the variables with our prefix, and apart from them the file named by
    /// `TERRACRAWLER_CONFIG`.
    ///
    /// # Errors
    /// [`ConfigError::UnknownVariable`] and [`ConfigError::Value`].
    pub fn from_environment(
        variables: impl IntoIterator<Item = (OsString, OsString)>,
    ) -> Result<(Self, Option<PathBuf>), ConfigError> {
        let mut layer = Self::default();
        let mut config = None;
        for (name, value) in variables {
            let Some(key) = name.to_str().and_then(|name| name.strip_prefix(ENV_PREFIX)) else {
                continue;
            };
            let origin = || format!("{ENV_PREFIX}{key}");
            if key == "CONFIG" {
                config = Some(PathBuf::from(value));
                continue;
            }
            let key_name = key.to_lowercase();
            if key != key.to_uppercase() || !KEYS.contains(&key_name.as_str()) {
                return Err(ConfigError::UnknownVariable(origin()));
            }
            let value = value.into_string().map_err(|_| ConfigError::Value {
                origin: origin(),
                text: "is not UTF-8".into(),
            })?;
            layer
                .set(&key_name, &value)
                .map_err(|BadValue(text)| ConfigError::Value {
                    origin: origin(),
                    text,
                })?;
        }
        Ok((layer, config))
    }

    fn set(&mut self, key: &str, value: &str) -> Result<(), BadValue> {
        fn parse<T: FromStr<Err: Display>>(value: &str) -> Result<Option<T>, BadValue> {
            value
                .parse()
                .map(Some)
                .map_err(|error| BadValue(format!("`{value}`: {error}")))
        }
        match key {
            "fleet" => self.fleet = Some(parse_fleet(value)?),
            "broker" => self.broker = parse(value)?,
            "mqtt" => self.mqtt = parse(value)?,
            "http" => self.http = parse(value)?,
            "data" => self.data = Some(PathBuf::from(value)),
            "database" => self.database = parse(value)?,
            "timeseries" => self.timeseries = parse(value)?,
            "cache" => self.cache = parse(value)?,
            "trusted_proxies" => self.trusted_proxies = parse(value)?,
            "open" => self.open = parse(value)?,
            "robots" => self.robots = parse(value)?,
            "scenario" => self.scenario = Some(value.to_owned()),
            "seed" => self.seed = parse(value)?,
            "radio_proxy" => self.radio_proxy = parse(value)?,
            "record" => self.record = Some(PathBuf::from(value)),
            "release_key" => self.release_key = parse(value)?,
            "require_gate" => self.require_gate = parse(value)?,
            "twins" => self.twins = parse(value)?,
            "log" => self.log = Some(value.to_owned()),
            "log_format" => self.log_format = parse(value)?,
            "tls" => self.tls = parse(value)?,
            "tls_names" => self.tls_names = parse(value)?,
            "tls_certificate" => self.tls_certificate = Some(PathBuf::from(value)),
            "tls_key" => self.tls_key = Some(PathBuf::from(value)),
            "tls_client_ca" => self.tls_client_ca = Some(PathBuf::from(value)),
            "mqtt_plain" => self.mqtt_plain = parse(value)?,
            "broker_ca" => self.broker_ca = Some(PathBuf::from(value)),
            "experiment_threads" => self.experiment_threads = parse(value)?,
            "worker_name" => self.worker_name = parse(value)?,
            _ => return Err(BadValue("unknown".to_owned())),
        }
        Ok(())
    }

    /// Takes from `weaker` what is not there yet.
    pub(super) fn fill_from(&mut self, weaker: &Self) {
        fn fill<T: Clone>(own: &mut Option<T>, other: Option<&T>) {
            if own.is_none() {
                *own = other.cloned();
            }
        }
        fill(&mut self.fleet, weaker.fleet.as_ref());
        fill(&mut self.broker, weaker.broker.as_ref());
        fill(&mut self.mqtt, weaker.mqtt.as_ref());
        fill(&mut self.http, weaker.http.as_ref());
        fill(&mut self.data, weaker.data.as_ref());
        fill(&mut self.database, weaker.database.as_ref());
        fill(&mut self.timeseries, weaker.timeseries.as_ref());
        fill(&mut self.cache, weaker.cache.as_ref());
        fill(&mut self.trusted_proxies, weaker.trusted_proxies.as_ref());
        fill(&mut self.open, weaker.open.as_ref());
        fill(&mut self.robots, weaker.robots.as_ref());
        fill(&mut self.scenario, weaker.scenario.as_ref());
        fill(&mut self.seed, weaker.seed.as_ref());
        fill(&mut self.radio_proxy, weaker.radio_proxy.as_ref());
        fill(&mut self.record, weaker.record.as_ref());
        fill(&mut self.release_key, weaker.release_key.as_ref());
        fill(&mut self.require_gate, weaker.require_gate.as_ref());
        fill(&mut self.twins, weaker.twins.as_ref());
        fill(&mut self.log, weaker.log.as_ref());
        fill(&mut self.log_format, weaker.log_format.as_ref());
        fill(&mut self.tls, weaker.tls.as_ref());
        fill(&mut self.tls_names, weaker.tls_names.as_ref());
        fill(&mut self.tls_certificate, weaker.tls_certificate.as_ref());
        fill(&mut self.tls_key, weaker.tls_key.as_ref());
        fill(&mut self.tls_client_ca, weaker.tls_client_ca.as_ref());
        fill(&mut self.mqtt_plain, weaker.mqtt_plain.as_ref());
        fill(&mut self.broker_ca, weaker.broker_ca.as_ref());
        fill(
            &mut self.experiment_threads,
            weaker.experiment_threads.as_ref(),
        );
        fill(&mut self.worker_name, weaker.worker_name.as_ref());
    }
}

/// A fleet's name, with the rule in the message when it breaks it.
pub(super) fn parse_fleet(text: &str) -> Result<Fleet, BadValue> {
    Fleet::new(text).map_err(|_| {
        BadValue(format!(
            "`{text}` is not a fleet's name: 1 to 32 of a-z, 0-9 and -"
        ))
    })
}

//! Options that commands have in common.

use std::net::SocketAddr;
use std::num::NonZeroU8;
use std::path::PathBuf;

use clap::Args;
use crawler_protocol::Fleet;

use super::layer::parse_fleet;
use super::{
    BrokerUrl, EngineUrl, Influx, KeyFiles, Layer, LogFormat, Networks, Postgres, Redis,
    RequireGate, TlsMode, TlsNames, WorkerName,
};

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
    /// Log filter, like `debug` or `info,crawler_api=trace` [default: info]
    #[arg(long, value_name = "FILTER")]
    pub log: Option<String>,
    /// How log lines are written [default: text]
    #[arg(long, value_enum, value_name = "FORMAT", hide_possible_values = false)]
    pub log_format: Option<LogFormat>,
    /// PEM file with a public key by which the server and simulated robots believe releases, or two of them
    /// separated by a comma: the one that signs now, and the next [default: they take none]
    #[arg(long, value_name = "FILES")]
    pub release_key: Option<KeyFiles>,
}

impl Common {
    /// The options that are given, and the file with others.
    pub(crate) fn layer(self) -> (Layer, Option<PathBuf>) {
        let layer = Layer {
            fleet: self.fleet,
            broker: self.broker,
            broker_ca: self.broker_ca,
            log: self.log,
            log_format: self.log_format,
            release_key: self.release_key,
            ..Layer::default()
        };
        (layer, self.config)
    }
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
    /// Of which releases a rollout demands a gate that has passed, unless an administrator overrides it; `boards`: of
    /// all but those for simulated robots [default: boards]
    #[arg(long, value_enum, value_name = "WHICH", hide_possible_values = false)]
    pub require_gate: Option<RequireGate>,
    /// Robots that have a twin at a time; 0 for none [default: 1000]
    #[arg(long, value_name = "N")]
    pub twins: Option<u16>,
    /// Trials of experiments that run at the same time [default: one for every two processors]
    #[arg(long, value_name = "N")]
    pub experiment_threads: Option<NonZeroU8>,
    /// What this server is called among those that work on experiments [default: the name of this machine]
    #[arg(long, value_name = "NAME")]
    pub worker_name: Option<WorkerName>,
}

impl ServerOptions {
    /// Puts the options that are given into `layer`.
    pub(crate) fn fill(self, layer: &mut Layer) {
        layer.http = self.http;
        layer.mqtt = self.mqtt;
        layer.data = self.data;
        layer.database = self.engines.database;
        layer.timeseries = self.engines.timeseries;
        layer.cache = self.engines.cache;
        layer.trusted_proxies = self.trusted_proxies;
        layer.tls = self.tls.tls;
        layer.tls_names = self.tls.tls_names;
        layer.tls_certificate = self.tls.tls_certificate;
        layer.tls_key = self.tls.tls_key;
        layer.tls_client_ca = self.tls.tls_client_ca;
        layer.mqtt_plain = self.tls.mqtt_plain;
        layer.open = self.open;
        layer.require_gate = self.require_gate;
        layer.twins = self.twins;
        layer.experiment_threads = self.experiment_threads;
        layer.worker_name = self.worker_name;
    }
}

/// Options of a process that works on experiments.
#[derive(Debug, Args)]
pub struct WorkerOptions {
    /// TOML file with options
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// `PostgreSQL` database of the servers whose experiments it works on
    #[arg(long, value_name = "URL")]
    pub database: Option<EngineUrl<Postgres>>,
    /// Trials that run at the same time [default: one for every processor]
    #[arg(long, value_name = "N", visible_alias = "threads")]
    pub experiment_threads: Option<NonZeroU8>,
    /// What it is called among those that work on experiments [default: the name of this machine]
    #[arg(long, value_name = "NAME", visible_alias = "name")]
    pub worker_name: Option<WorkerName>,
    /// Log filter, like `debug` or `info,crawler_experiments=trace` [default: info]
    #[arg(long, value_name = "FILTER")]
    pub log: Option<String>,
    /// How log lines are written [default: text]
    #[arg(long, value_enum, value_name = "FORMAT", hide_possible_values = false)]
    pub log_format: Option<LogFormat>,
}

impl WorkerOptions {
    /// The options that are given, and the file with others.
    pub(crate) fn layer(self) -> (Layer, Option<PathBuf>) {
        let layer = Layer {
            database: self.database,
            experiment_threads: self.experiment_threads,
            worker_name: self.worker_name,
            log: self.log,
            log_format: self.log_format,
            ..Layer::default()
        };
        (layer, self.config)
    }
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

impl RobotOptions {
    /// Puts the options that are given into `layer`.
    pub(crate) fn fill(self, layer: &mut Layer) {
        layer.robots = self.robots;
        layer.scenario = self.scenario;
        layer.seed = self.seed;
        layer.radio_proxy = self.radio_proxy;
        layer.record = self.record;
    }
}

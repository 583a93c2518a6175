//! Which engine answers, and what it needs before it takes samples.

use std::fmt;

use hyper::body::Bytes;
use hyper::{Method, StatusCode};

use crate::address::{Address, Dialect, Read, encoded};
use crate::client::Client;
use crate::error::EngineError;
use crate::line::MEASUREMENT;
use crate::read::influxql::{self, Row};

/// A program that takes line protocol.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Product {
    /// `InfluxDB`, with its version.
    InfluxDb(String),
    /// `VictoriaMetrics`.
    VictoriaMetrics,
    /// `QuestDB`.
    QuestDb,
    /// One that says nothing of itself.
    Unknown,
}

impl fmt::Display for Product {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::InfluxDb(version) => write!(f, "InfluxDB {version}"),
            Self::VictoriaMetrics => f.write_str("VictoriaMetrics"),
            Self::QuestDb => f.write_str("QuestDB"),
            Self::Unknown => f.write_str("an engine that does not say what it is"),
        }
    }
}

/// The engine that was found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Engine {
    /// What it is.
    pub product: Product,
    /// How it is asked; `None` where samples are written alone.
    pub dialect: Option<Dialect>,
}

impl Product {
    fn dialect(&self) -> Option<Dialect> {
        match self {
            Self::InfluxDb(_) => Some(Dialect::InfluxQl),
            Self::VictoriaMetrics => Some(Dialect::MetricsQl),
            Self::QuestDb | Self::Unknown => None,
        }
    }

    /// Whether databases are made with a statement. From version 2 on they are mapped to buckets.
    fn makes_databases(&self) -> bool {
        let old = |version: &str| version.starts_with("0.") || version.starts_with("1.");
        matches!(self, Self::InfluxDb(version) if old(version))
    }
}

async fn product(client: &Client) -> Result<Product, EngineError> {
    // First, since this one also says that it were an InfluxDB, where that is asked.
    let health = client.get("/-/healthy").await?;
    if health.body.starts_with(b"VictoriaMetrics") {
        return Ok(Product::VictoriaMetrics);
    }
    let ping = client.get("/ping").await?;
    if matches!(ping.status.as_u16(), 401 | 403 | 408 | 429 | 500..) {
        ping.accepted()?;
        return Ok(Product::Unknown);
    }
    let header = |name: &str| {
        let value = ping.headers.get(name)?.to_str().ok()?;
        Some(value.trim_start_matches('v').to_owned())
    };
    if header("server").is_some_and(|server| server.to_lowercase().starts_with("questdb")) {
        return Ok(Product::QuestDb);
    }
    if let Some(version) = header("x-influxdb-version") {
        let known = |c: char| c.is_ascii_graphic();
        let version = version.chars().filter(|&c| known(c)).take(32).collect();
        return Ok(Product::InfluxDb(version));
    }
    // Whoever answers everything with a page would take samples as well, and throw them away.
    if ping.status == StatusCode::NO_CONTENT {
        return Ok(Product::Unknown);
    }
    let status = ping.status.as_u16();
    Err(EngineError::Nonsense(format!("{status} to GET /ping")))
}

fn dialect(read: Read, product: &Product) -> Option<Dialect> {
    match read {
        Read::Detect => product.dialect(),
        Read::In(dialect) => Some(dialect),
        Read::Nothing => None,
    }
}

/// Finds out which engine answers and whether it lets us read.
async fn meet(client: &Client) -> Result<Engine, EngineError> {
    let product = product(client).await?;
    let dialect = dialect(client.address().read, &product);
    Ok(Engine { product, dialect })
}

/// A question that costs nothing: whether the database is there, and we may read it.
async fn try_out(client: &Client, engine: &Engine) -> Result<(), EngineError> {
    if engine.dialect == Some(Dialect::InfluxQl) {
        let question = format!("SELECT \"x\" FROM \"{MEASUREMENT}\" LIMIT 1");
        influxql::ask::<Row<2>>(client, &question).await?;
    }
    Ok(())
}

/// Finds the engine, and makes its database where that is how it is done and we may.
pub(crate) async fn prepare(client: &Client) -> Result<Engine, EngineError> {
    let engine = meet(client).await?;
    if engine.product.makes_databases() {
        let database = influxql::name(&client.address().database);
        let target = format!(
            "/query?q={}",
            encoded(&format!("CREATE DATABASE {database}"))
        );
        let made = client.send(Method::POST, &target, Bytes::new()).await?;
        // Who may not make databases may still use one: trying it tells.
        if made.status.as_u16() != 403 {
            influxql::checked(made)?;
        }
    }
    try_out(client, &engine).await?;
    Ok(engine)
}

/// Finds out which engine is at `address` and whether its database can be used, without a change.
///
/// # Errors
/// [`EngineError`] says what is in the way; [`EngineError::NoDatabase`] where the first start of a
/// server may make it.
pub async fn look(address: &Address) -> Result<Engine, EngineError> {
    let client = Client::new(address.clone())?;
    let engine = meet(&client).await?;
    try_out(&client, &engine).await?;
    Ok(engine)
}

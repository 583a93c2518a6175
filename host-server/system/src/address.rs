//! Where brokers, engines and proxies are, as people write it in options.

mod broker_url;
mod engine_url;
mod networks;

pub use broker_url::{BrokerUrl, BrokerUrlError};
pub use engine_url::{Engine, EngineUrl, Influx, NoEngineUrl, Postgres, Redis};
pub use networks::{Networks, NoNetwork};

//! The engine that keeps the history, where there is one.

use crawler_timeseries::{Address, Engine, EngineError, look as ask};

use super::Finding;
use crate::config::Settings;

const WHAT: &str = "history";

pub(super) async fn look(settings: &Settings) -> Option<Finding> {
    let engine = settings.timeseries.as_ref()?;
    Some(match engine.reveal().parse::<Address>() {
        Ok(address) => judge(&engine.to_string(), ask(&address).await),
        Err(error) => Finding::fail(
            WHAT,
            format!("{engine}: {error}"),
            "correct --timeseries (docs/history.md)",
        ),
    })
}

fn judge(address: &str, found: Result<Engine, EngineError>) -> Finding {
    match found {
        Ok(Engine {
            product,
            dialect: Some(_),
        }) => Finding::ok(WHAT, format!("{address}: {product}")),
        Ok(Engine { product, .. }) => Finding::warn(
            WHAT,
            format!("{address}: {product} takes samples, but cannot be asked for them"),
            EngineError::Unreadable.advice(),
        ),
        Err(error @ EngineError::NoDatabase(_)) => Finding::warn(
            WHAT,
            format!("{address}: {error}"),
            format!(
                "the first start of the server makes it where it may; else {}",
                error.advice()
            ),
        ),
        Err(error) => Finding::fail(WHAT, format!("{address}: {error}"), error.advice()),
    }
}

#[cfg(test)]
mod tests {
    use crawler_timeseries::{Dialect, Product};

    use super::super::Grade;
    use super::*;

    #[test]
    fn an_engine_is_judged_by_what_it_can() {
        let engine = |dialect| Engine {
            product: Product::InfluxDb("1.6.7".into()),
            dialect,
        };
        let grade = |found| judge("influx://host/d", found).grade;
        assert_eq!(grade(Ok(engine(Some(Dialect::InfluxQl)))), Grade::Ok);
        assert_eq!(grade(Ok(engine(None))), Grade::Warn);
        let missing = EngineError::NoDatabase("database not found".into());
        assert_eq!(grade(Err(missing)), Grade::Warn);
        let away = EngineError::Unreachable("connection refused".into());
        let finding = judge("influx://host/d", Err(away));
        assert_eq!(finding.grade, Grade::Fail);
        assert!(finding.found.contains("connection refused"), "{finding:?}");
        assert!(finding.advice.is_some());
    }
}

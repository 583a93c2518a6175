//! What stands behind the question mark of an address.

use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use serde::de::DeserializeOwned;

use super::problem::{Code, FieldError, Problem, unreadable};

/// A query, or the problem document that says what is wrong with it.
pub(super) struct ApiQuery<T>(pub(super) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for ApiQuery<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        let query = parts.uri.query().unwrap_or_default();
        let pairs = form_urlencoded::parse(query.as_bytes());
        let reader = serde_urlencoded::Deserializer::new(pairs);
        serde_path_to_error::deserialize(reader)
            .map(Self)
            .map_err(|error| {
                let error = unreadable(error.path(), &error.inner().to_string());
                let name = error.pointer.unwrap_or_default();
                bad_query(name.trim_start_matches('/'), error.detail)
            })
    }
}

/// What is wrong with a parameter of a query.
pub(super) fn bad_query(parameter: &str, detail: impl Into<String>) -> Problem {
    let error = FieldError::of_parameter(parameter, detail);
    Problem::invalid(Code::BadQuery, vec![error])
}

/// How many lines of a list are wanted: `limit`, where that is not more than `most`.
pub(super) fn page(limit: u32, most: u32) -> Result<u32, Problem> {
    if (1..=most).contains(&limit) {
        Ok(limit)
    } else {
        Err(bad_query("limit", format!("must be within 1 to {most}")))
    }
}

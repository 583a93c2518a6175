//! What stands behind the question mark of an address.

use axum::extract::{FromRequestParts, Query};
use axum::http::request::Parts;
use serde::de::DeserializeOwned;

use super::problem::{Code, Problem};

/// A query, or the problem document that says what is wrong with it.
pub(super) struct ApiQuery<T>(pub(super) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for ApiQuery<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        match Query::from_request_parts(parts, state).await {
            Ok(Query(query)) => Ok(Self(query)),
            Err(error) => Err(bad_query(error.body_text())),
        }
    }
}

pub(super) fn bad_query(why: impl Into<String>) -> Problem {
    Problem::new(Code::BadQuery, why)
}

/// How many lines of a list are wanted: `limit`, where that is not more than `most`.
pub(super) fn page(limit: u32, most: u32) -> Result<u32, Problem> {
    if (1..=most).contains(&limit) {
        Ok(limit)
    } else {
        Err(bad_query(format!("`limit` must be within 1 to {most}")))
    }
}

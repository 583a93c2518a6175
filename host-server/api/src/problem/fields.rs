//! Which parts of a request are wrong.

use std::fmt::Display;

use serde::{Serialize, de::DeserializeOwned};
use serde_path_to_error::{Path, Segment};
use utoipa::ToSchema;

/// A part of a request that is wrong: of its body, or of its address.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub(crate) struct FieldError {
    /// Where it is in the body, as a JSON pointer (RFC 6901); empty for all of the body.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "/parameters/speed")]
    pub(crate) pointer: Option<String>,
    /// Its name, where it is a parameter of the query or of the path.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "limit")]
    pub(crate) parameter: Option<String>,
    /// What is wrong with it, for people.
    pub(crate) detail: String,
}

impl FieldError {
    /// Of the body.
    pub(crate) fn at(pointer: impl Into<String>, detail: impl Into<String>) -> Self {
        Self {
            pointer: Some(pointer.into()),
            parameter: None,
            detail: detail.into(),
        }
    }

    /// Of the query, or of the path.
    pub(crate) fn of_parameter(parameter: impl Into<String>, detail: impl Into<String>) -> Self {
        Self {
            pointer: None,
            parameter: Some(parameter.into()),
            detail: detail.into(),
        }
    }

    /// In one line, for people.
    pub(super) fn line(&self) -> String {
        let part = self.pointer.as_deref().or(self.parameter.as_deref());
        match part.unwrap_or_default() {
            "" => format!("the body {}", self.detail),
            part => format!("`{part}` {}", self.detail),
        }
    }
}

impl From<crawler_experiments::FieldError> for FieldError {
    fn from(error: crawler_experiments::FieldError) -> Self {
        Self::at(error.pointer, error.detail)
    }
}

/// The pointer to the member `name` of what `pointer` points to.
pub(crate) fn member(pointer: &str, name: impl Display) -> String {
    let name = name.to_string().replace('~', "~0").replace('/', "~1");
    format!("{pointer}/{name}")
}

/// The part that a reader did not take, and why, without quoting what was there: that may be a password.
pub(crate) fn unreadable(path: &Path, message: &str) -> FieldError {
    let mut pointer = String::new();
    for segment in path {
        pointer = match segment {
            Segment::Seq { index } => member(&pointer, index),
            Segment::Map { key } => member(&pointer, key),
            Segment::Enum { variant } => member(&pointer, variant),
            Segment::Unknown => break,
        };
    }
    // The names in these are those of the program.
    let named = |what: &str| message.strip_prefix(what)?.split('`').next();
    if let Some(name) = named("missing field `") {
        return FieldError::at(member(&pointer, name), "is missing");
    }
    if let Some(name) = named("duplicate field `") {
        return FieldError::at(member(&pointer, name), "is there twice");
    }
    if message.starts_with("unknown field") {
        return FieldError::at(pointer, "is unknown");
    }
    FieldError::at(pointer, expected(message))
}

/// What a message of a reader says of what should have been there. What was there comes before that.
fn expected(message: &str) -> String {
    let message = message
        .rsplit_once(" at line ")
        .map_or(message, |(message, _)| message);
    let Some((_, expected)) = message.rsplit_once(", expected ") else {
        return "holds what it must not".to_owned();
    };
    let expected = match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number, not negative, and not too large",
        "i8" | "i16" | "i32" | "i64" => "a whole number",
        "f32" | "f64" => "a number",
        "a sequence" => "a list",
        "a map" => "an object",
        text if text.starts_with("struct ") => "an object",
        text => text,
    };
    format!("must be {expected}")
}

/// Reads JSON.
///
/// # Errors
/// The part that is wrong; `None` where it is no JSON at all.
pub(crate) fn read<T: DeserializeOwned>(body: &[u8]) -> Result<T, Option<FieldError>> {
    let mut reader = serde_json::Deserializer::from_slice(body);
    let value = serde_path_to_error::deserialize(&mut reader).map_err(|error| {
        let inner = error.inner();
        let is_json = inner.classify() == serde_json::error::Category::Data;
        is_json.then(|| unreadable(error.path(), &inner.to_string()))
    })?;
    reader.end().map_err(|_| None)?;
    Ok(value)
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code, reason = "only read")]
    struct Form {
        name: String,
        side: Option<Side>,
        #[serde(default)]
        rooms: Vec<Room>,
        #[serde(rename = "a/b~c", default)]
        odd: Option<bool>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code, reason = "only read")]
    struct Room {
        size: f64,
        door: Door,
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "snake_case")]
    enum Side {
        Left,
        Right,
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "snake_case")]
    #[allow(dead_code, reason = "only read")]
    enum Door {
        Width(u8),
        Names([String; 2]),
    }

    #[test]
    fn what_is_wrong_is_pointed_at_and_not_quoted() {
        let secret = "correct horse, expected battery";
        for (body, pointer, detail) in [
            ("{}", "/name", "is missing"),
            ("7", "", "must be an object"),
            (r#"{"name":7}"#, "/name", "must be a string"),
            (r#"{"name":"a","name":"b"}"#, "/name", "is there twice"),
            (r#"{"name":"a","s/d~":1}"#, "/s~1d~0", "is unknown"),
            (r#"{"name":"a","a/b~c":1}"#, "/a~1b~0c", "must be a boolean"),
            (
                r#"{"name":"a","side":"correct horse, expected battery"}"#,
                "/side",
                "must be `left` or `right`",
            ),
            (
                r#"{"name":"a","side":{"correct horse, expected battery":1}}"#,
                "/side",
                "must be `left` or `right`",
            ),
            (
                r#"{"name":"a","rooms":"correct horse, expected battery"}"#,
                "/rooms",
                "must be a list",
            ),
            (
                r#"{"name":"a","rooms":[{"size":1,"door":{"width":1}},{"size":true}]}"#,
                "/rooms/1/size",
                "must be a number",
            ),
            (
                r#"{"name":"a","rooms":[{"size":1}]}"#,
                "/rooms/0/door",
                "is missing",
            ),
            (
                r#"{"name":"a","rooms":[{"size":1,"door":{"width":-1}}]}"#,
                "/rooms/0/door/width",
                "must be a whole number, not negative, and not too large",
            ),
            (
                r#"{"name":"a","rooms":[{"size":1,"door":{"names":["a",5]}}]}"#,
                "/rooms/0/door/names/1",
                "must be a string",
            ),
        ] {
            let error = read::<Form>(body.as_bytes()).expect_err(body);
            let error = error.expect(body);
            assert_eq!(error, FieldError::at(pointer, detail), "{body}");
            assert!(!error.line().contains(secret), "{body}");
        }
        for body in ["", "{", r#"{"name":"a"} 1"#, "{name:1}"] {
            assert_eq!(read::<Form>(body.as_bytes()).expect_err(body), None);
        }
        assert!(read::<Form>(br#" {"name":"a","side":"left"} "#).is_ok());
    }

    #[test]
    fn parts_are_told_in_a_line() {
        let line = |error: FieldError| error.line();
        assert_eq!(line(FieldError::at("/a", "is missing")), "`/a` is missing");
        assert_eq!(line(FieldError::at("", "is empty")), "the body is empty");
        assert_eq!(
            line(FieldError::of_parameter("limit", "must be 1")),
            "`limit` must be 1"
        );
    }
}

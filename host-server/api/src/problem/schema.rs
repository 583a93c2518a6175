//! Where a message is wrong. The protocol's own reader decides whether it is, and says why; it is made for robots, and
//! says no more. Here the place is found, by the message's schema, and where that does not tell, by leaving out one
//! part after the other.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::LazyLock;

use crawler_protocol::Reason;
use serde::de::{DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::Value;

use super::fields::{FieldError, member};

/// Schemas by the names of messages: they are the same all the time, and take a while to write.
static SCHEMAS: LazyLock<BTreeMap<&str, Value>> = LazyLock::new(|| {
    let all = crawler_sim_protocol::schemas().into_iter();
    all.map(|(name, schema)| (name, schema.to_value()))
        .collect()
});
/// Parts that are left out to see whether they are to blame.
const MOST_TRIED: usize = 64;
/// Members that say which of several things an object is: a schema sees whether they are right.
const TAGS: [&str; 4] = ["command", "behaviour", "fault", "shape"];

/// What is wrong with `body`, which should be a `message` and was refused for `reason` by `reader`.
pub(crate) fn locate(
    message: &str,
    body: &[u8],
    reason: Reason,
    reader: impl Fn(&[u8]) -> Option<Reason>,
) -> Vec<FieldError> {
    let Ok(value) = serde_json::from_slice::<Value>(body) else {
        return Vec::new();
    };
    if reason == Reason::DuplicateField
        && let Some(pointer) = first_twice(body)
    {
        return vec![FieldError::at(pointer, "is there twice")];
    }
    if reason != Reason::TooLarge
        && let Some(schema) = SCHEMAS.get(message)
    {
        let mut wrong = Vec::new();
        check(schema, schema, &value, "", &mut wrong);
        if !wrong.is_empty() {
            return wrong;
        }
    }
    let mut all = Vec::new();
    members(&value, "", &mut all);
    all.truncate(MOST_TRIED);
    let without = |pointer: &String| {
        let mut less = value.clone();
        let (parent, name) = pointer.rsplit_once('/')?;
        let name = name.replace("~1", "/").replace("~0", "~");
        less.pointer_mut(parent)?.as_object_mut()?.remove(&name)?;
        let again = reader(less.to_string().as_bytes());
        (again != Some(reason)).then(|| pointer.clone())
    };
    let pointer = all.iter().find_map(without).unwrap_or_default();
    vec![FieldError::at(pointer, words(reason))]
}

/// What a reason says of a part.
fn words(reason: Reason) -> &'static str {
    match reason {
        Reason::TooLarge => "is too large for a message",
        Reason::UnknownField => "is unknown",
        Reason::MissingField => "lacks a field",
        Reason::WrongType => "has another type than it must",
        Reason::OutOfRange => "is out of range",
        _ => "holds what it must not",
    }
}

/// Pointers to the members of all objects in `value`, inner ones first.
fn members(value: &Value, at: &str, found: &mut Vec<String>) {
    match value {
        Value::Object(fields) => {
            for (name, field) in fields {
                let at = member(at, name);
                members(field, &at, found);
                if !TAGS.contains(&name.as_str()) {
                    found.push(at);
                }
            }
        }
        Value::Array(items) => {
            for (index, item) in items.iter().enumerate() {
                members(item, &member(at, index), found);
            }
        }
        _ => {}
    }
}

/// Holds `value` against `schema`, a part of `root`, as far as schemas of messages go.
fn check(root: &Value, schema: &Value, value: &Value, at: &str, wrong: &mut Vec<FieldError>) {
    if let Some(place) = schema["$ref"].as_str() {
        if let Some(part) = root.pointer(place.trim_start_matches('#')) {
            check(root, part, value, at, wrong);
        }
        return;
    }
    if let Some(ways) = schema["oneOf"].as_array() {
        check_ways(root, ways, value, at, wrong);
        return;
    }
    let mut tell = |detail: String| wrong.push(FieldError::at(at, detail));
    if let Some(only) = schema.get("const") {
        if value != only {
            tell(format!("must be {only}"));
        }
        return;
    }
    if let Some(values) = schema["enum"].as_array() {
        if !values.contains(value) {
            tell(one_of(values.iter()));
        }
        return;
    }
    let kinds: Vec<&str> = match &schema["type"] {
        Value::String(kind) => vec![kind],
        Value::Array(kinds) => kinds.iter().filter_map(Value::as_str).collect(),
        _ => Vec::new(),
    };
    if !kinds.is_empty() && !kinds.iter().any(|kind| is_a(value, kind)) {
        tell(format!("must be {}", kinds.join(" or ")));
        return;
    }
    let bound = |name: &str| schema[name].as_f64();
    let range = |what: &str, least: Option<f64>, most: Option<f64>| match (least, most) {
        (Some(least), Some(most)) => format!("must be {} to {}{what}", short(least), short(most)),
        (Some(least), None) => format!("must be at least {}{what}", short(least)),
        (_, most) => format!("must be at most {}{what}", short(most.unwrap_or_default())),
    };
    let mut hold = |measure: f64, least: &str, most: &str, what: &str| {
        let (least, most) = (bound(least), bound(most));
        if least.is_some_and(|least| measure < least) || most.is_some_and(|most| measure > most) {
            tell(range(what, least, most));
        }
    };
    match value {
        Value::Number(number) => {
            let number = number.as_f64().unwrap_or(f64::NAN);
            hold(number, "minimum", "maximum", "");
        }
        Value::String(text) => {
            let length = text.chars().count() as f64;
            hold(length, "minLength", "maxLength", " characters long");
        }
        Value::Array(items) => {
            hold(items.len() as f64, "minItems", "maxItems", " entries long");
            for (index, item) in items.iter().enumerate() {
                check(root, &schema["items"], item, &member(at, index), wrong);
            }
        }
        Value::Object(fields) => {
            let count = fields.len() as f64;
            hold(count, "minProperties", "maxProperties", " fields large");
            let required = schema["required"].as_array().into_iter().flatten();
            for name in required.filter_map(Value::as_str) {
                if !fields.contains_key(name) {
                    wrong.push(FieldError::at(member(at, name), "is missing"));
                }
            }
            let others = &schema["additionalProperties"];
            for (name, field) in fields {
                let at = member(at, name);
                match schema["properties"].get(name) {
                    Some(part) => check(root, part, field, &at, wrong),
                    None if others == &Value::Bool(false) => {
                        wrong.push(FieldError::at(at, "is unknown"));
                    }
                    None => check(root, others, field, &at, wrong),
                }
            }
        }
        Value::Null | Value::Bool(_) => {}
    }
}

/// Holds `value` against the one of these that it seems to be meant as.
fn check_ways(root: &Value, ways: &[Value], value: &Value, at: &str, wrong: &mut Vec<FieldError>) {
    let names: Vec<&Value> = ways.iter().filter_map(|way| way.get("const")).collect();
    if names.len() == ways.len() {
        if !names.contains(&value) {
            wrong.push(FieldError::at(at, one_of(names.into_iter())));
        }
        return;
    }
    // The member whose value says which of them it is.
    let first = ways.first().and_then(|way| way["properties"].as_object());
    let mut fields = first.into_iter().flatten();
    let tag = fields.find(|(_, field)| field.get("const").is_some());
    let Some((tag, _)) = tag else {
        return;
    };
    let name_of = |way: &'_ Value| way["properties"][tag]["const"].clone();
    let Some(fields) = value.as_object() else {
        wrong.push(FieldError::at(at, "must be an object"));
        return;
    };
    let Some(name) = fields.get(tag) else {
        wrong.push(FieldError::at(member(at, tag), "is missing"));
        return;
    };
    let meant = ways.iter().filter(|way| name_of(way) == *name);
    let least = meant
        .map(|way| {
            let mut wrong = Vec::new();
            check(root, way, value, at, &mut wrong);
            wrong
        })
        .min_by_key(Vec::len);
    if let Some(found) = least {
        wrong.extend(found);
        return;
    }
    let names: BTreeSet<String> = ways.iter().map(|way| name_of(way).to_string()).collect();
    let names: Vec<String> = names.into_iter().collect();
    let detail = format!("must be one of {}", names.join(", "));
    wrong.push(FieldError::at(member(at, tag), detail));
}

/// A bound as it was written: those of numbers with four bytes are not quite there.
fn short(bound: f64) -> String {
    let four = bound as f32;
    if f64::from(four) == bound {
        four.to_string()
    } else {
        bound.to_string()
    }
}

fn one_of<'a>(values: impl Iterator<Item = &'a Value>) -> String {
    let values: Vec<String> = values.map(ToString::to_string).collect();
    format!("must be one of {}", values.join(", "))
}

fn is_a(value: &Value, kind: &str) -> bool {
    match kind {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "boolean" => value.is_boolean(),
        "number" => value.is_number(),
        "integer" => value.as_f64().is_some_and(|number| number.fract() == 0.0),
        "null" => value.is_null(),
        // No schema of ours knows another.
        _ => true,
    }
}

/// The pointer to the first member that its object has twice.
fn first_twice(body: &[u8]) -> Option<String> {
    let mut found = None;
    let seed = Twice {
        at: String::new(),
        found: &mut found,
    };
    let mut reader = serde_json::Deserializer::from_slice(body);
    seed.deserialize(&mut reader).ok()?;
    found
}

struct Twice<'a> {
    at: String,
    found: &'a mut Option<String>,
}

impl<'de> DeserializeSeed<'de> for Twice<'_> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Twice<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("JSON")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut fields: A) -> Result<(), A::Error> {
        let mut seen = BTreeSet::new();
        while let Some(name) = fields.next_key::<String>()? {
            let at = member(&self.at, &name);
            if !seen.insert(name) {
                self.found.get_or_insert_with(|| at.clone());
            }
            let found = &mut *self.found;
            fields.next_value_seed(Twice { at, found })?;
        }
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<(), A::Error> {
        for index in 0_usize.. {
            let (at, found) = (member(&self.at, index), &mut *self.found);
            if items.next_element_seed(Twice { at, found })?.is_none() {
                break;
            }
        }
        Ok(())
    }

    fn visit_bool<E>(self, _: bool) -> Result<(), E> {
        Ok(())
    }

    fn visit_i64<E>(self, _: i64) -> Result<(), E> {
        Ok(())
    }

    fn visit_u64<E>(self, _: u64) -> Result<(), E> {
        Ok(())
    }

    fn visit_f64<E>(self, _: f64) -> Result<(), E> {
        Ok(())
    }

    fn visit_str<E>(self, _: &str) -> Result<(), E> {
        Ok(())
    }

    fn visit_unit<E>(self) -> Result<(), E> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crawler_protocol::Action;

    use super::*;

    fn of_command(body: &str) -> Vec<(String, String)> {
        let reader = |body: &[u8]| Action::parse(body).err();
        let reason = reader(body.as_bytes()).unwrap_or_else(|| panic!("{body} is a command"));
        let wrong = locate("command-request", body.as_bytes(), reason, reader);
        wrong
            .into_iter()
            .map(|error| (error.pointer.expect("of the body"), error.detail))
            .collect()
    }

    #[test]
    fn every_wrong_part_of_a_command_is_pointed_at() {
        for (body, pointers) in [
            ("7", &[""][..]),
            ("{}", &["/command"]),
            (r#"{"command":"dance"}"#, &["/command"]),
            (r#"{"command":"stop","speed":1}"#, &["/speed"]),
            (
                r#"{"command":"stop","parameters":{"a":1}}"#,
                &["/parameters"],
            ),
            (r#"{"command":"drive"}"#, &["/parameters"]),
            (
                r#"{"command":"drive","parameters":{"v":"x","w":99,"u":1}}"#,
                &["/parameters/u", "/parameters/v", "/parameters/w"],
            ),
            (
                r#"{"command":"drive","parameters":{"v":0}}"#,
                &["/parameters/w"],
            ),
            (
                r#"{"command":"move","parameters":{"direction":"up","speed":101,"duration":5}}"#,
                &["/parameters/direction", "/parameters/speed"],
            ),
            (
                r#"{"command":"behave","parameters":{"behaviour":"dance"}}"#,
                &["/parameters/behaviour"],
            ),
            (
                r#"{"command":"behave","parameters":{"behaviour":"patrol","waypoints":[[0,1],[1,"a"]]}}"#,
                &["/parameters/waypoints/1/1"],
            ),
            (
                r#"{"command":"behave","parameters":{"behaviour":"consensus","measure":"range","f":9}}"#,
                &["/parameters/f"],
            ),
            // No length and no number: only its reader knows.
            (
                r#"{"command":"behave","parameters":{"behaviour":"follow","leader":"NO"}}"#,
                &["/parameters/leader"],
            ),
            (
                r#"{"command":"set","parameters":{"good":1,"NO NAME":2}}"#,
                &["/parameters/NO NAME"],
            ),
            (
                r#"{"command":"drive","parameters":{"v":0,"w":1,"v":2}}"#,
                &["/parameters/v"],
            ),
        ] {
            let wrong = of_command(body);
            let found: Vec<&str> = wrong.iter().map(|(pointer, _)| pointer.as_str()).collect();
            assert_eq!(found, pointers, "{body}: {wrong:?}");
        }
        let wrong = of_command(r#"{"command":"drive","parameters":{"v":0,"w":99}}"#);
        assert!(wrong[0].1.starts_with("must be -"), "{wrong:?}");
    }

    #[test]
    fn schemas_say_nothing_that_is_not_understood() {
        const KNOWN: [&str; 22] = [
            "$defs",
            "$ref",
            "$schema",
            "additionalProperties",
            "const",
            "description",
            "enum",
            "items",
            "maxItems",
            "maxLength",
            "maxProperties",
            "maximum",
            "minItems",
            "minLength",
            "minProperties",
            "minimum",
            "oneOf",
            "properties",
            "required",
            "title",
            "type",
            // Left to the readers.
            "pattern",
        ];
        fn walk(schema: &Value) {
            for (word, part) in schema.as_object().into_iter().flatten() {
                assert!(
                    KNOWN.contains(&word.as_str()) || word == "propertyNames",
                    "{word}"
                );
                match word.as_str() {
                    "properties" | "$defs" => {
                        part.as_object()
                            .into_iter()
                            .flatten()
                            .for_each(|(_, part)| walk(part));
                    }
                    "oneOf" => part.as_array().into_iter().flatten().for_each(walk),
                    "items" | "additionalProperties" => walk(part),
                    _ => {}
                }
            }
        }
        for message in ["command-request", "simulator-command"] {
            walk(&SCHEMAS[message]);
        }
    }
}

//! The schema that the server serves says what the type does.

use crawler_protocol::MAX_MESSAGE;
use crawler_sim_protocol::schemas;
use jsonschema::Validator;
use proptest::prelude::*;
use serde_json::{Value, json};

fn validator() -> Validator {
    let (name, schema) = schemas().pop().expect("messages");
    assert_eq!(name, "simulator-command");
    let schema = Value::from(schema);
    jsonschema::meta::validate(&schema).expect("a schema");
    assert!(schema["description"].is_string());
    jsonschema::validator_for(&schema).expect("a schema")
}

thread_local! {
    // Compiled once: a schema takes longer to compile than a message to check.
    static VALIDATOR: Validator = validator();
}

fn is_valid(value: &Value) -> bool {
    VALIDATOR.with(|validator| validator.is_valid(value))
}

#[test]
fn those_of_robots_come_first() {
    let names =
        |all: Vec<(&'static str, _)>| -> Vec<_> { all.into_iter().map(|(name, _)| name).collect() };
    let mut expected = names(crawler_protocol::schemas());
    expected.push("simulator-command");
    assert_eq!(names(schemas()), expected);
}

proptest! {
    #![proptest_config(crawler_properties::cases(64))]
    #[test]
    fn simulator_command(command in crate::common::simulator_command()) {
        let mut buf = [0; MAX_MESSAGE];
        let length = command.to_json(&mut buf).expect("every command fits");
        let mut value: Value = serde_json::from_slice(&buf[..length]).expect("JSON");
        prop_assert!(is_valid(&value), "{value}");
        // One field more is another message.
        value["colour"] = json!("red");
        prop_assert!(!is_valid(&value), "{value}");
    }
}

//! What the messages of a recording look like, as JSON Schemas.

use serde_json::{Value, json};

fn object(title: &str, description: &str, properties: &Value) -> Vec<u8> {
    let schema = json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": title,
        "description": description,
        "type": "object",
        "properties": properties,
    });
    schema.to_string().into_bytes()
}

/// Title and schema of each kind of message.
pub(super) fn all() -> Vec<(&'static str, Vec<u8>)> {
    let integer = || json!({ "type": "integer" });
    let number = || json!({ "type": "number" });
    let text = || json!({ "type": "string" });
    let list = |items: Value| json!({ "type": "array", "items": items });
    let moment = json!({
        "type": "object",
        "title": "time",
        "properties": { "sec": integer(), "nsec": integer() },
    });
    let vector = json!({
        "type": "object",
        "properties": { "x": number(), "y": number(), "z": number() },
    });
    let pose = json!({
        "type": "object",
        "properties": {
            "position": vector,
            "orientation": {
                "type": "object",
                "properties": { "x": number(), "y": number(), "z": number(), "w": number() },
            },
        },
    });
    let colour = json!({
        "type": "object",
        "properties": { "r": number(), "g": number(), "b": number(), "a": number() },
    });
    let solid = json!({
        "type": "object",
        "properties": { "pose": pose, "size": vector, "color": colour },
    });
    let arrow = json!({
        "type": "object",
        "properties": {
            "pose": pose,
            "shaft_length": number(),
            "shaft_diameter": number(),
            "head_length": number(),
            "head_diameter": number(),
            "color": colour,
        },
    });
    let scene = json!({
        "deletions": list(json!({ "type": "object" })),
        "entities": list(json!({
            "type": "object",
            "properties": {
                "timestamp": moment,
                "frame_id": text(),
                "id": text(),
                "lifetime": moment,
                "frame_locked": { "type": "boolean" },
                "arrows": list(arrow),
                "cubes": list(solid.clone()),
                "cylinders": list(solid),
            },
        })),
    });
    let robots = |fields: Value| {
        let item = json!({ "type": "object", "properties": fields });
        json!({ "at_us": integer(), "robots": list(item) })
    };
    let truth = robots(json!({
        "robot": text(), "x": number(), "y": number(), "theta": number(), "speed": number(),
        "turn": number(), "contacts": integer(), "charge": number(), "powered": {},
    }));
    let readings = robots(json!({
        "robot": text(), "range_mm": {}, "temperature_c": {}, "battery_mv": {},
    }));
    let decisions = robots(json!({
        "robot": text(), "state": text(), "behaviour": text(), "duty": list(integer()),
        "carried_out": {
            "type": "object",
            "properties": { "commands": integer(), "numbers": integer() },
        },
    }));
    let message = json!({
        "at_us": integer(), "robot": text(), "boot": integer(),
        "direction": { "enum": ["published", "delivered"] },
        "topic": text(), "payload": text(), "qos": integer(), "retain": { "type": "boolean" },
    });
    let input = json!({ "at_us": integer(), "settled": {}, "input": text() });
    let boot = json!({
        "at_us": integer(), "robot": text(), "number": integer(), "boot": integer(),
        "life": { "type": "object" },
    });
    let end = json!({ "at_us": integer(), "robot": text(), "boot": integer() });
    let devices = json!({
        "robot": text(), "boot": integer(), "lost": integer(),
        "events": list(json!({ "type": "array", "prefixItems": [integer(), {}] })),
    });
    let hash = json!({ "second": integer(), "hash": text() });
    let mark = json!({ "at_us": integer() });
    vec![
        (
            "foxglove.SceneUpdate",
            object("foxglove.SceneUpdate", "Things to draw.", &scene),
        ),
        (
            "terracrawler.Truth",
            object("terracrawler.Truth", "Where robots really are.", &truth),
        ),
        (
            "terracrawler.Readings",
            object("terracrawler.Readings", "What robots read last.", &readings),
        ),
        (
            "terracrawler.Decisions",
            object(
                "terracrawler.Decisions",
                "What robots have decided.",
                &decisions,
            ),
        ),
        (
            "terracrawler.Message",
            object(
                "terracrawler.Message",
                "An MQTT message at a robot's end.",
                &message,
            ),
        ),
        (
            "terracrawler.Input",
            object(
                "terracrawler.Input",
                "Something done to the world from outside.",
                &input,
            ),
        ),
        (
            "terracrawler.Boot",
            object("terracrawler.Boot", "A program starts.", &boot),
        ),
        (
            "terracrawler.End",
            object("terracrawler.End", "A program was stopped.", &end),
        ),
        (
            "terracrawler.Devices",
            object(
                "terracrawler.Devices",
                "What passed through the devices of a robot.",
                &devices,
            ),
        ),
        (
            "terracrawler.Hash",
            object("terracrawler.Hash", "Fingerprint of the history.", &hash),
        ),
        (
            "terracrawler.Mark",
            object(
                "terracrawler.Mark",
                "All up to this moment is in the file.",
                &mark,
            ),
        ),
    ]
}

//! JSON Schemas of all messages, from the types that read and write them.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::format;
use std::vec::Vec;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema, schema_for};

use crate::{
    Action, BehaviourName, CellDigest, Command, CommandName, Detections, Direction,
    FOLLOW_DISTANCE, Formation, Heartbeat, LogRecord, MAX_COORDINATE, MAX_DRIVE_V, MAX_DRIVE_W,
    MAX_LAPS, MAX_LIARS, MAX_MOVE_MS, MAX_PLACES, MAX_SET, MAX_VALUE, MapSegment, ParameterValue,
    ParametersMessage, PolicyName, PoseFix, Response, RobotId, Shape, Source, StatusMessage,
    SwarmResponse, Telemetry, TimeMessage, UpdateCommand, UpdateReport,
};

/// Name and JSON Schema (2020-12) of every message, and of the request for a command.
#[must_use]
pub fn schemas() -> Vec<(&'static str, Schema)> {
    [
        ("command", schema_for!(Command)),
        ("command-request", schema_for!(Action)),
        ("response", schema_for!(Response)),
        ("swarm-response", schema_for!(SwarmResponse)),
        ("status", schema_for!(StatusMessage)),
        ("heartbeat", schema_for!(Heartbeat)),
        ("telemetry", schema_for!(Telemetry)),
        ("detections", schema_for!(Detections)),
        ("log-record", schema_for!(LogRecord)),
        ("map-segment", schema_for!(MapSegment)),
        ("parameters", schema_for!(ParametersMessage)),
        ("cell-digest", schema_for!(CellDigest)),
        ("pose-fix", schema_for!(PoseFix)),
        ("time", schema_for!(TimeMessage)),
        ("update-command", schema_for!(UpdateCommand)),
        ("update-report", schema_for!(UpdateReport)),
    ]
    .into()
}

impl JsonSchema for Command {
    fn schema_name() -> Cow<'static, str> {
        "Command".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let source = generator.subschema_for::<Source>();
        let mut alternatives = alternatives(generator);
        for alternative in &mut alternatives {
            let members = alternative.ensure_object();
            if let Some(properties) = members
                .get_mut("properties")
                .and_then(|p| p.as_object_mut())
            {
                properties.insert(
                    "timestamp".into(),
                    whole(u64::MAX, "When it was sent, in Unix milliseconds.").into(),
                );
                properties.insert(
                    "seq".into(),
                    whole(u64::MAX, "Rises with each command of the source.").into(),
                );
                properties.insert("source".into(), source.clone().into());
            }
            if let Some(required) = members.get_mut("required").and_then(|r| r.as_array_mut()) {
                required.extend(["timestamp", "seq", "source"].map(Into::into));
            }
        }
        json_schema!({
            "description": "What a robot is told to do.",
            "oneOf": alternatives,
        })
    }
}

impl JsonSchema for Action {
    fn schema_name() -> Cow<'static, str> {
        "CommandRequest".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "description": "A command as a person asks the server for it.",
            "oneOf": alternatives(generator),
        })
    }
}

/// One schema per command.
fn alternatives(generator: &mut SchemaGenerator) -> Vec<Schema> {
    CommandName::ALL
        .iter()
        .map(|name| {
            let parameters = parameters(*name, generator);
            let mut required = std::vec!["command"];
            // Without a policy it ends what there is.
            if parameters.is_some() && *name != CommandName::Shadow {
                required.push("parameters");
            }
            let parameters = parameters.unwrap_or_else(
                || json_schema!({ "type": ["object", "null"], "maxProperties": 0 }),
            );
            json_schema!({
                "title": name.name(),
                "type": "object",
                "properties": {
                    "command": { "const": name.name() },
                    "parameters": parameters,
                },
                "required": required,
                "additionalProperties": false,
            })
        })
        .collect()
}

/// The parameters of a command that has some.
fn parameters(name: CommandName, generator: &mut SchemaGenerator) -> Option<Schema> {
    let place = || {
        [
            (
                "x",
                within(MAX_COORDINATE, "Metres along the x axis."),
                true,
            ),
            (
                "y",
                within(MAX_COORDINATE, "Metres along the y axis."),
                true,
            ),
        ]
    };
    match name {
        CommandName::Move => Some(object([
            ("direction", generator.subschema_for::<Direction>(), true),
            ("speed", whole(100, "Share of full duty in percent."), true),
            (
                "duration",
                whole(
                    MAX_MOVE_MS.into(),
                    "Milliseconds; 0 lasts until told otherwise, with a word every 500 ms.",
                ),
                true,
            ),
        ])),
        CommandName::Drive => Some(object([
            ("v", within(MAX_DRIVE_V, "Forward speed in m/s."), true),
            (
                "w",
                within(MAX_DRIVE_W, "Turning speed in rad/s, counter-clockwise."),
                true,
            ),
        ])),
        CommandName::Goto => Some(object(place())),
        CommandName::Behave => {
            let behaviours: Vec<Schema> = BehaviourName::ALL
                .iter()
                .flat_map(|behaviour| {
                    let ways = match behaviour {
                        // A number of its own, or one that is measured.
                        BehaviourName::Consensus => 2,
                        // The lattice round the origin, a shape with a spacing, or one with a radius.
                        BehaviourName::Formation => 3,
                        _ => 1,
                    };
                    (0..ways).map(move |way| (behaviour, way))
                })
                .map(|(behaviour, way)| {
                    let mut members = std::vec![(
                        "behaviour",
                        json_schema!({ "const": behaviour.name() }),
                        true
                    )];
                    match behaviour {
                        BehaviourName::Wander => members.push((
                            "speed",
                            whole(100, "Top speed in percent; 60 where it is not given."),
                            false,
                        )),
                        BehaviourName::Goto => members.extend(place()),
                        BehaviourName::Gather => members.extend([
                            (
                                "x",
                                within(MAX_COORDINATE, "Metres along the x axis; 0 by default."),
                                false,
                            ),
                            (
                                "y",
                                within(MAX_COORDINATE, "Metres along the y axis; 0 by default."),
                                false,
                            ),
                        ]),
                        BehaviourName::Follow => members.extend([
                            ("leader", generator.subschema_for::<RobotId>(), true),
                            (
                                "distance",
                                json_schema!({
                                    "description": "Metres to keep; 0.6 where it is not given.",
                                    "type": "number",
                                    "minimum": FOLLOW_DISTANCE[0],
                                    "maximum": FOLLOW_DISTANCE[1],
                                }),
                                false,
                            ),
                        ]),
                        BehaviourName::Consensus => members.extend([
                            if way == 0 {
                                ("value", within(MAX_VALUE, "The number to begin with."), true)
                            } else {
                                (
                                    "measure",
                                    json_schema!({
                                        "description": "What to measure for it: °C, or metres.",
                                        "enum": ["temperature", "range"],
                                    }),
                                    true,
                                )
                            },
                            (
                                "f",
                                whole(
                                    MAX_LIARS.into(),
                                    "Most liars among the neighbours of a robot; 1 where it is not given.",
                                ),
                                false,
                            ),
                        ]),
                        BehaviourName::Allocate => members.push((
                            "tasks",
                            places(1, "Where there is something to do."),
                            true,
                        )),
                        BehaviourName::Policy => {
                            members.push((
                                "policy",
                                generator.subschema_for::<PolicyName>(),
                                true,
                            ));
                        }
                        BehaviourName::Formation if way > 0 => members.extend(shaped(way == 2)),
                        BehaviourName::Cover => members.push((
                            "area",
                            places(3, "The corners of the area, one after the other."),
                            true,
                        )),
                        BehaviourName::Patrol => members.extend([
                            (
                                "waypoints",
                                places(2, "Where to go, one after the other."),
                                true,
                            ),
                            (
                                "laps",
                                whole(
                                    MAX_LAPS.into(),
                                    "After how many rounds to stop; 0, as where it is not given, is never.",
                                ),
                                false,
                            ),
                        ]),
                        BehaviourName::Manual
                        | BehaviourName::Disperse
                        | BehaviourName::Flock
                        | BehaviourName::Formation => {}
                    }
                    object(members)
                })
                .collect();
            Some(json_schema!({ "oneOf": behaviours }))
        }
        CommandName::Set => Some(json_schema!({
            "type": "object",
            "propertyNames": { "pattern": "^[a-z0-9_]{1,32}$" },
            "additionalProperties": generator.subschema_for::<ParameterValue>(),
            "minProperties": 1,
            "maxProperties": MAX_SET,
        })),
        CommandName::Shadow => {
            let mut schema = object([("policy", generator.subschema_for::<PolicyName>(), false)]);
            let nothing = json_schema!({ "type": ["object", "null"] });
            let kind = nothing.get("type").cloned().unwrap_or_default();
            schema.ensure_object().insert("type".into(), kind);
            Some(schema)
        }
        CommandName::Stop
        | CommandName::Estop
        | CommandName::Reset
        | CommandName::Scan
        | CommandName::Capture
        | CommandName::ReportMap
        | CommandName::Identify
        | CommandName::Reboot => None,
    }
}

/// The parameters of a formation with a shape.
fn shaped(round: bool) -> [(&'static str, Schema, bool); 4] {
    let shapes = Shape::ALL.iter().copied();
    let shapes = shapes.filter(|shape| (*shape == Shape::Circle) == round);
    let names: Vec<_> = shapes.map(Shape::name).collect();
    let shape = if round { Shape::Circle } else { Shape::Line };
    let (size, [least, most], usual) = Formation::size_of(shape);
    [
        ("shape", json_schema!({ "enum": names }), true),
        (
            size,
            json_schema!({
                "description": format!("Metres; {usual} where it is not given."),
                "type": "number",
                "minimum": least,
                "maximum": most,
            }),
            false,
        ),
        (
            "heading",
            within(
                Formation::MOST_HEADING,
                "Where it faces, in radians from the x axis; 0 where it is not given.",
            ),
            false,
        ),
        (
            "path",
            places(
                1,
                "Where its middle goes, one place after the other; the origin where it is not given.",
            ),
            false,
        ),
    ]
}

/// An object of these members: name, schema, and whether it must be there.
#[must_use]
pub fn object(members: impl IntoIterator<Item = (&'static str, Schema, bool)>) -> Schema {
    let mut properties = BTreeMap::new();
    let mut required = Vec::new();
    for (name, schema, must) in members {
        properties.insert(name, schema);
        if must {
            required.push(name);
        }
    }
    json_schema!({
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": false,
    })
}

/// At least so many places.
fn places(least: u8, description: &str) -> Schema {
    json_schema!({
        "description": description,
        "type": "array",
        "items": {
            "description": "Metres along the x axis and along the y axis.",
            "type": "array",
            "items": within(MAX_COORDINATE, "Metres."),
            "minItems": 2,
            "maxItems": 2,
        },
        "minItems": least,
        "maxItems": MAX_PLACES,
    })
}

fn whole(most: u64, description: &str) -> Schema {
    json_schema!({
        "description": description,
        "type": "integer",
        "minimum": 0,
        "maximum": most,
    })
}

/// A number within ±`most`.
#[must_use]
pub fn within(most: f32, description: &str) -> Schema {
    json_schema!({
        "description": description,
        "type": "number",
        "minimum": -most,
        "maximum": most,
    })
}

/// A whole number of a range.
#[must_use]
pub fn integer(least: i64, most: u64, description: &str) -> Schema {
    json_schema!({
        "description": description,
        "type": "integer",
        "minimum": least,
        "maximum": most,
    })
}

/// A number of a range.
#[must_use]
pub fn number(least: f32, most: f32, description: &str) -> Schema {
    json_schema!({
        "description": description,
        "type": "number",
        "minimum": least,
        "maximum": most,
    })
}

/// An object with the constant `tag`, and these members.
#[must_use]
pub fn tagged(
    tag: &'static str,
    name: &'static str,
    mut members: Vec<(&'static str, Schema, bool)>,
) -> Schema {
    members.push((tag, json_schema!({ "const": name }), true));
    let mut schema = object(members);
    schema.ensure_object().insert("title".into(), name.into());
    schema
}

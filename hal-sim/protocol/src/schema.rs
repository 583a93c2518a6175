//! JSON Schemas of commands to a simulated world.

use std::borrow::Cow;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema, schema_for};

use crate::{
    Colour, EXTENT_RANGE, MAX_LOADED, MAX_STEPS, Object, ObjectShape, Obstacle, Place, SPEED_RANGE,
    ScenarioName, SimulatorCommand, SimulatorCommandName, SnapshotName,
};
use crawler_protocol::schema::{integer, number, object, tagged, within};
use crawler_protocol::{FaultSpec, MAX_COORDINATE, MAX_LASTING_MS, RobotId};

/// Name and JSON Schema (2020-12) of every message of a fleet, those to a simulator included.
#[must_use]
pub fn schemas() -> Vec<(&'static str, Schema)> {
    let mut all = crawler_protocol::schemas();
    all.push(("simulator-command", schema_for!(SimulatorCommand)));
    all
}

impl JsonSchema for Place {
    fn schema_name() -> Cow<'static, str> {
        "Place".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        object([
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
            (
                "theta",
                within(
                    Self::MAX_THETA,
                    "Radians, counter-clockwise from the x axis.",
                ),
                true,
            ),
        ])
    }
}

/// A place and a length, as everything that is dropped has.
fn placed(more: Vec<(&'static str, Schema, bool)>) -> Vec<(&'static str, Schema, bool)> {
    let mut members = vec![
        ("x", within(MAX_COORDINATE, "Metres, of the centre."), true),
        ("y", within(MAX_COORDINATE, "Metres, of the centre."), true),
    ];
    members.extend(more);
    members
}

fn length(description: &str) -> Schema {
    number(EXTENT_RANGE.0, EXTENT_RANGE.1, description)
}

impl JsonSchema for Obstacle {
    fn schema_name() -> Cow<'static, str> {
        "Obstacle".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let circle = placed(vec![("r", length("Radius, metres."), true)]);
        let theta = within(Place::MAX_THETA, "Radians, anticlockwise; 0 when left out.");
        let boxed = placed(vec![
            ("w", length("Metres along its own x axis."), true),
            ("h", length("Metres along its own y axis."), true),
            ("theta", theta, false),
        ]);
        json_schema!({
            "description": "Something solid that does not move.",
            "oneOf": [tagged("shape", "circle", circle), tagged("shape", "box", boxed)],
        })
    }
}

impl JsonSchema for Object {
    fn schema_name() -> Cow<'static, str> {
        "Thing".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        object(placed(vec![
            ("shape", generator.subschema_for::<ObjectShape>(), true),
            ("size", length("Width and height, metres."), true),
            ("colour", generator.subschema_for::<Colour>(), true),
        ]))
    }
}

fn command_field(field: &'static str, generator: &mut SchemaGenerator) -> (Schema, bool) {
    match field {
        "steps" => (integer(1, MAX_STEPS.into(), "Physics steps."), true),
        "factor" => (
            number(SPEED_RANGE.0, SPEED_RANGE.1, "Multiple of real time."),
            true,
        ),
        "seed" => (
            integer(0, u64::MAX, "Seed of the world from now on."),
            false,
        ),
        "pose" => (generator.subschema_for::<Place>(), false),
        "robot" => (generator.subschema_for::<RobotId>(), true),
        "name" => (generator.subschema_for::<SnapshotName>(), true),
        "fault" => (generator.subschema_for::<FaultSpec>(), true),
        "scenario" => (generator.subschema_for::<ScenarioName>(), true),
        "robots" => (integer(1, MAX_LOADED.into(), "How many robots."), false),
        "obstacle" => (generator.subschema_for::<Obstacle>(), true),
        "object" => (generator.subschema_for::<Object>(), true),
        "item" => (
            integer(0, u32::MAX.into(), "Number of what was dropped."),
            true,
        ),
        // `lasting_ms`.
        _ => (
            integer(1, MAX_LASTING_MS.into(), "Milliseconds of the world."),
            false,
        ),
    }
}

impl JsonSchema for SimulatorCommand {
    fn schema_name() -> Cow<'static, str> {
        "SimulatorCommand".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let mut alternative = |command: SimulatorCommandName, fields: &[&'static str]| {
            let members = fields
                .iter()
                .map(|field| {
                    let (schema, must) = command_field(field, generator);
                    (*field, schema, must)
                })
                .collect();
            tagged("command", command.name(), members)
        };
        let mut alternatives = Vec::new();
        for &command in SimulatorCommandName::ALL {
            if command == SimulatorCommandName::Drop {
                // One of the two, and not both.
                for field in command.fields() {
                    alternatives.push(alternative(command, &[field]));
                }
            } else {
                alternatives.push(alternative(command, command.fields()));
            }
        }
        json_schema!({
            "description": "What a simulated world is told to do.",
            "oneOf": alternatives,
        })
    }
}

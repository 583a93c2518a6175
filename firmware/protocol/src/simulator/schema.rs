//! JSON Schemas of faults and of commands to a simulated world.

use std::borrow::Cow;
use std::vec;
use std::vec::Vec;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};

use super::{
    Colour, EXTENT_RANGE, FaultName, FaultSpec, LinkCut, MAX_CLOCK_STEP_MS, MAX_LASTING_MS,
    MAX_LOADED, MAX_NOISE_MM, MAX_PACKETS_PER_S, MAX_SAG_OHM, MAX_STEPS, Obstacle, Place,
    SPEED_RANGE, SimulatorCommand, SimulatorCommandName, Thing, ThingShape, Wheel,
};
use crate::schema::{object, within};
use crate::{MAX_COORDINATE, RobotId, ScenarioName, SnapshotName};

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

/// A whole number of a range.
fn integer(least: i64, most: u64, description: &str) -> Schema {
    json_schema!({
        "description": description,
        "type": "integer",
        "minimum": least,
        "maximum": most,
    })
}

/// A number of a range.
fn number(least: f32, most: f32, description: &str) -> Schema {
    json_schema!({
        "description": description,
        "type": "number",
        "minimum": least,
        "maximum": most,
    })
}

fn fault_field(fault: FaultName, field: &'static str, generator: &mut SchemaGenerator) -> Schema {
    match (fault, field) {
        (_, "wheel") => generator.subschema_for::<Wheel>(),
        (_, "how") => generator.subschema_for::<LinkCut>(),
        (FaultName::RangerNoisy, "mm") => integer(
            0,
            MAX_NOISE_MM.into(),
            "One standard deviation, in millimetres.",
        ),
        (_, "mm") => integer(0, u16::MAX.into(), "A distance in millimetres."),
        (_, "ms") => json_schema!({
            "description": "Milliseconds by which the clock is off.",
            "type": "integer",
            "minimum": -MAX_CLOCK_STEP_MS,
            "maximum": MAX_CLOCK_STEP_MS,
        }),
        (_, "per_s") => integer(1, MAX_PACKETS_PER_S.into(), "Packets a second."),
        (_, "ohm") => number(0.0, MAX_SAG_OHM, "Ohms added to the pack's own."),
        (_, "after_bytes") => integer(0, u32::MAX.into(), "Bytes written or erased until then."),
        (_, "seed") => integer(0, u32::MAX.into(), "Names the noise."),
        // `flips`, `strength` and `charge`.
        _ => number(0.0, 1.0, "A share of 0 to 1."),
    }
}

/// An object with the constant `tag`, and these members.
fn tagged(
    tag: &'static str,
    name: &'static str,
    mut members: Vec<(&'static str, Schema, bool)>,
) -> Schema {
    members.push((tag, json_schema!({ "const": name }), true));
    let mut schema = object(members);
    schema.ensure_object().insert("title".into(), name.into());
    schema
}

impl JsonSchema for FaultSpec {
    fn schema_name() -> Cow<'static, str> {
        "FaultSpec".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let alternatives: Vec<Schema> = FaultName::ALL
            .iter()
            .map(|fault| {
                let members = fault
                    .fields()
                    .iter()
                    .map(|field| {
                        (
                            *field,
                            fault_field(*fault, field, generator),
                            *field != "how",
                        )
                    })
                    .collect();
                tagged("fault", fault.name(), members)
            })
            .collect();
        json_schema!({
            "description": "Something broken about a robot.",
            "oneOf": alternatives,
        })
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

impl JsonSchema for Thing {
    fn schema_name() -> Cow<'static, str> {
        "Thing".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        object(placed(vec![
            ("shape", generator.subschema_for::<ThingShape>(), true),
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
        "object" => (generator.subschema_for::<Thing>(), true),
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

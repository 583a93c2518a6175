//! JSON Schema of faults.

use std::borrow::Cow;
use std::vec::Vec;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};

use super::{
    FaultName, FaultSpec, LinkCut, MAX_CLOCK_STEP_MS, MAX_NOISE_MM, MAX_PACKETS_PER_S, MAX_SAG_OHM,
    Wheel,
};
use crate::schema::{integer, number, tagged};

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

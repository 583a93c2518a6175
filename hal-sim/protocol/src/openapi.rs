//! What is in a world, as an HTTP API describes it. Names there are those of old.

use std::borrow::Cow;

use utoipa::openapi::schema::RefBuilder;
use utoipa::openapi::{
    KnownFormat, ObjectBuilder, OneOfBuilder, RefOr, Schema, SchemaFormat, Type,
};
use utoipa::{PartialSchema, ToSchema};

use crate::{Colour, Object, ObjectShape, Obstacle};

/// A number of 32 bits.
fn number(description: &str) -> ObjectBuilder {
    ObjectBuilder::new()
        .schema_type(Type::Number)
        .format(Some(SchemaFormat::KnownFormat(KnownFormat::Float)))
        .description(Some(description))
}

/// One of these words.
fn words(words: impl IntoIterator<Item = &'static str>) -> ObjectBuilder {
    ObjectBuilder::new()
        .schema_type(Type::String)
        .enum_values(Some(words))
}

/// An obstacle of one shape, with these numbers.
fn obstacle(shape: &'static str, description: &str, numbers: &[(&str, &str)]) -> Schema {
    let mut object = ObjectBuilder::new().description(Some(description));
    for (name, description) in numbers {
        object = object.property(*name, number(description)).required(*name);
    }
    let object = object.property("shape", words([shape])).required("shape");
    object.build().into()
}

impl PartialSchema for Obstacle {
    fn schema() -> RefOr<Schema> {
        let text = "Something solid that does not move; lengths in metres, angles in radians.";
        let (x, y) = (("x", "Centre."), ("y", "Centre."));
        let round = [x, y, ("r", "Radius.")];
        let boxed = [
            x,
            y,
            ("w", "Full length along its own x axis."),
            ("h", "Full length along its own y axis."),
            ("theta", "Anticlockwise turn about its centre."),
        ];
        OneOfBuilder::new()
            .item(obstacle("circle", "A round post.", &round))
            .item(obstacle("box", "A box.", &boxed))
            .description(Some(text))
            .into()
    }
}

impl ToSchema for Obstacle {
    fn name() -> Cow<'static, str> {
        "Obstacle".into()
    }
}

impl PartialSchema for Object {
    fn schema() -> RefOr<Schema> {
        let of = |name: &str, description: &str| {
            let path = format!("#/components/schemas/{name}");
            RefBuilder::new()
                .ref_location(path)
                .description(Some(description))
        };
        let (shape, colour) = (
            <ObjectShape as ToSchema>::name(),
            <Colour as ToSchema>::name(),
        );
        ObjectBuilder::new()
            .description(Some("A coloured thing that stands on the floor."))
            .property("shape", of(&shape, "What it looks like."))
            .required("shape")
            .property("colour", of(&colour, "Its colour."))
            .required("colour")
            .property("x", number("Centre, metres."))
            .required("x")
            .property("y", number("Centre, metres."))
            .required("y")
            .property("size", number("Width and height, metres."))
            .required("size")
            .into()
    }
}

impl ToSchema for Object {
    fn name() -> Cow<'static, str> {
        "Thing".into()
    }

    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        schemas.push((
            <ObjectShape as ToSchema>::name().into(),
            ObjectShape::schema(),
        ));
        schemas.push((<Colour as ToSchema>::name().into(), Colour::schema()));
    }
}

impl PartialSchema for ObjectShape {
    fn schema() -> RefOr<Schema> {
        words(Self::ALL.iter().map(|shape| shape.name())).into()
    }
}

impl ToSchema for ObjectShape {
    fn name() -> Cow<'static, str> {
        "ThingShape".into()
    }
}

impl PartialSchema for Colour {
    fn schema() -> RefOr<Schema> {
        words(Self::ALL.iter().map(|colour| colour.name())).into()
    }
}

impl ToSchema for Colour {
    fn name() -> Cow<'static, str> {
        "ThingColour".into()
    }
}

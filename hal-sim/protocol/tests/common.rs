//! Any command there can be.

use crawler_protocol::MAX_COORDINATE;
use crawler_sim_protocol::{
    Colour, Dropped, EXTENT_RANGE, MAX_LOADED, MAX_STEPS, Object, ObjectShape, Obstacle, Place,
    SPEED_RANGE, ScenarioName, SimulatorCommand, SnapshotName,
};
use proptest::option;
use proptest::prelude::*;
use proptest::sample::select;

use crate::faults::{self, robot};

fn place() -> impl Strategy<Value = (f32, f32)> {
    let axis = -MAX_COORDINATE..=MAX_COORDINATE;
    (axis.clone(), axis)
}

fn dropped() -> impl Strategy<Value = Dropped> {
    let length = || EXTENT_RANGE.0..=EXTENT_RANGE.1;
    let theta = -Place::MAX_THETA..=Place::MAX_THETA;
    prop_oneof![
        (place(), length()).prop_map(|((x, y), r)| Dropped::Obstacle(Obstacle::Circle { x, y, r })),
        (place(), length(), length(), theta).prop_map(|((x, y), w, h, theta)| {
            Dropped::Obstacle(Obstacle::Box { x, y, w, h, theta })
        }),
        (
            place(),
            length(),
            select(ObjectShape::ALL),
            select(Colour::ALL)
        )
            .prop_map(|((x, y), size, shape, colour)| Dropped::Object(Object {
                shape,
                x,
                y,
                size,
                colour
            })),
    ]
}

pub(crate) fn simulator_command() -> impl Strategy<Value = SimulatorCommand> {
    let name = || "[a-z0-9-]{1,32}".prop_map(|text| SnapshotName::new(&text).unwrap());
    let there = (place(), -Place::MAX_THETA..=Place::MAX_THETA).prop_map(|((x, y), theta)| Place {
        x,
        y,
        theta,
    });
    prop_oneof![
        select(vec![SimulatorCommand::Pause, SimulatorCommand::Resume]),
        (1..=MAX_STEPS).prop_map(|steps| SimulatorCommand::Step { steps }),
        (SPEED_RANGE.0..=SPEED_RANGE.1).prop_map(|factor| SimulatorCommand::Speed { factor }),
        option::of(any::<u64>()).prop_map(|seed| SimulatorCommand::Reset { seed }),
        option::of(there).prop_map(|pose| SimulatorCommand::Add { pose }),
        robot().prop_map(|robot| SimulatorCommand::Remove { robot }),
        name().prop_map(|name| SimulatorCommand::Snapshot { name }),
        name().prop_map(|name| SimulatorCommand::Restore { name }),
        faults::fault_command().prop_map(SimulatorCommand::Fault),
        (
            "[a-z0-9-]{1,32}".prop_map(|text| ScenarioName::new(&text).unwrap()),
            option::of(1..=MAX_LOADED),
            option::of(any::<u64>()),
        )
            .prop_map(|(scenario, robots, seed)| SimulatorCommand::Load {
                scenario,
                robots,
                seed
            }),
        dropped().prop_map(|what| SimulatorCommand::Drop { what }),
        any::<u32>().prop_map(|item| SimulatorCommand::Take { item }),
        name().prop_map(|name| SimulatorCommand::Forget { name }),
    ]
}

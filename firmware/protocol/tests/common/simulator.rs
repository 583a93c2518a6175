//! What a simulated world is told, and faults.

use crawler_protocol::{
    Colour, Dropped, EXTENT_RANGE, FaultSpec, LinkCut, MAX_CLOCK_STEP_MS, MAX_LASTING_MS,
    MAX_LOADED, MAX_NOISE_MM, MAX_PACKETS_PER_S, MAX_SAG_OHM, MAX_STEPS, Obstacle, Place,
    SPEED_RANGE, ScenarioName, SimulatorCommand, SnapshotName, Thing, ThingShape, Wheel,
};
use proptest::option;
use proptest::prelude::*;
use proptest::sample::select;

use super::{place, robot};

fn share() -> impl Strategy<Value = f32> {
    0.0..=1.0_f32
}

fn fault() -> impl Strategy<Value = FaultSpec> {
    let wheel = || select(Wheel::ALL);
    prop_oneof![
        select(vec![
            FaultSpec::RangerDead,
            FaultSpec::LineStuck,
            FaultSpec::BrownOut,
            FaultSpec::CameraAbsent,
            FaultSpec::CameraStalled,
            FaultSpec::CameraGarbage,
        ]),
        any::<u16>().prop_map(|mm| FaultSpec::RangerStuck { mm }),
        (0..=MAX_NOISE_MM).prop_map(|mm| FaultSpec::RangerNoisy { mm }),
        share().prop_map(|flips| FaultSpec::LineNoise { flips }),
        (wheel(), share()).prop_map(|(wheel, strength)| FaultSpec::MotorWeak { wheel, strength }),
        wheel().prop_map(|wheel| FaultSpec::MotorDead { wheel }),
        wheel().prop_map(|wheel| FaultSpec::MotorStuckOn { wheel }),
        select(LinkCut::ALL).prop_map(|how| FaultSpec::LinkLoss { how }),
        (1..=MAX_PACKETS_PER_S).prop_map(|per_s| FaultSpec::HostilePackets { per_s }),
        (-MAX_CLOCK_STEP_MS..=MAX_CLOCK_STEP_MS).prop_map(|ms| FaultSpec::ClockStep { ms }),
        (0.0..=MAX_SAG_OHM).prop_map(|ohm| FaultSpec::BatterySag { ohm }),
        share().prop_map(|charge| FaultSpec::BatteryAt { charge }),
        any::<u32>().prop_map(|after_bytes| FaultSpec::FlashPowerCut { after_bytes }),
        any::<u32>().prop_map(|seed| FaultSpec::FlashNoise { seed }),
    ]
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
            select(ThingShape::ALL),
            select(Colour::ALL)
        )
            .prop_map(|((x, y), size, shape, colour)| Dropped::Object(Thing {
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
        (robot(), fault(), option::of(1..=MAX_LASTING_MS)).prop_map(
            |(robot, fault, lasting_ms)| SimulatorCommand::Inject {
                robot,
                fault,
                lasting_ms
            }
        ),
        robot().prop_map(|robot| SimulatorCommand::Heal { robot }),
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

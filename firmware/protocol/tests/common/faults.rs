//! Any fault there can be, and any way to order it.

use crawler_protocol::{
    FaultCommand, FaultSpec, LinkCut, MAX_CLOCK_STEP_MS, MAX_LASTING_MS, MAX_NOISE_MM,
    MAX_PACKETS_PER_S, MAX_SAG_OHM, RobotId, Wheel,
};
use proptest::option;
use proptest::prelude::*;
use proptest::sample::select;

pub(crate) fn robot() -> impl Strategy<Value = RobotId> {
    "[a-z0-9-]{1,32}".prop_map(|text| RobotId::new(&text).unwrap())
}

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

pub(crate) fn fault_command() -> impl Strategy<Value = FaultCommand> {
    prop_oneof![
        (robot(), fault(), option::of(1..=MAX_LASTING_MS)).prop_map(
            |(robot, fault, lasting_ms)| FaultCommand::Inject {
                robot,
                fault,
                lasting_ms
            }
        ),
        robot().prop_map(|robot| FaultCommand::Heal { robot }),
    ]
}

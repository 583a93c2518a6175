//! Any message about updates there can be.

use crawler_protocol::{
    BuildId, MAX_MODELS, ModelName, Models, ReasonCode, ReleaseId, UpdateCommand, UpdateDelta,
    UpdateOutcome, UpdatePart, UpdateReport, UpdateStage,
};
use proptest::collection::vec;
use proptest::option;
use proptest::prelude::*;
use proptest::sample::select;

use super::robot;

pub(crate) fn release() -> impl Strategy<Value = ReleaseId> {
    any::<[u8; 8]>().prop_map(ReleaseId::new)
}

pub(crate) fn build() -> impl Strategy<Value = BuildId> {
    "[A-Za-z0-9_.+-]{1,64}".prop_map(|text| BuildId::new(&text).unwrap())
}

pub(crate) fn models() -> impl Strategy<Value = Models> {
    let model = ("[a-z0-9-]{1,16}", build())
        .prop_map(|(name, build)| (ModelName::new(&name).unwrap(), build));
    vec(model, 0..=MAX_MODELS).prop_map(|models| models.into_iter().collect())
}

fn reason() -> impl Strategy<Value = ReasonCode> {
    "[A-Za-z0-9_.+-]{1,32}".prop_map(|text| ReasonCode::new(&text).unwrap())
}

pub(crate) fn update_command() -> impl Strategy<Value = UpdateCommand> {
    let delta = (build(), any::<u32>()).prop_map(|(base, bytes)| UpdateDelta { base, bytes });
    prop_oneof![
        (release(), option::of(delta))
            .prop_map(|(release, delta)| UpdateCommand::Offer { release, delta }),
        release().prop_map(|release| UpdateCommand::Confirm { release }),
        release().prop_map(|release| UpdateCommand::Cancel { release }),
    ]
}

pub(crate) fn update_report() -> impl Strategy<Value = UpdateReport> {
    let unfinished = (option::of(release()), option::of(any::<u32>()));
    prop_oneof![
        (robot(), build(), any::<[u32; 2]>(), unfinished).prop_map(
            |(robot, build, [sequence, floor], (release, bytes))| UpdateReport::Have {
                robot,
                build,
                sequence,
                floor,
                release,
                bytes,
            }
        ),
        (
            robot(),
            any::<[u32; 2]>(),
            select(UpdatePart::ALL),
            any::<u16>()
        )
            .prop_map(|(robot, [tag, first], part, missing)| UpdateReport::Want {
                robot,
                tag,
                part,
                first,
                missing,
            }),
        (
            (robot(), release(), select(UpdateStage::ALL)),
            (option::of(reason()), any::<u32>(), option::of(build())),
        )
            .prop_map(|((robot, release, state), (reason, bytes, build))| {
                UpdateReport::Progress {
                    robot,
                    release,
                    state,
                    reason,
                    bytes,
                    build,
                }
            }),
        (
            (robot(), release(), select(UpdateOutcome::ALL)),
            (
                option::of(reason()),
                option::of(build()),
                option::of(any::<bool>())
            ),
        )
            .prop_map(|((robot, release, outcome), (reason, build, lasting))| {
                UpdateReport::Outcome {
                    robot,
                    release,
                    outcome,
                    reason,
                    build,
                    lasting,
                }
            }),
    ]
}

//! Plans that are refused, each with its reason.

use super::*;
use crate::rollout::names::{BuildId, Version};
use crate::rollout::plan::{Limits, PlannedRelease, Retries, Timeouts};
use crate::rollout::window::Window;
use crawler_protocol::Kind;
use proptest::prelude::*;

fn release(id: &str, board: &str, kind: Option<Kind>) -> PlannedRelease {
    PlannedRelease {
        release: ReleaseId::new(id).unwrap(),
        board: BoardName::new(board).unwrap(),
        kind,
        model: None,
        policy: false,
        build: BuildId::new("new").unwrap(),
        version: Version::new("0.4.0").unwrap(),
        sequence: 4,
        bytes: 608_100,
    }
}

fn phase(select: Selection) -> Phase {
    Phase {
        select,
        soak_s: 0,
        success_percent: 95,
        min_count: 1,
        stop_percent: 5,
        stop_min_count: 1,
    }
}

fn plan() -> Plan {
    Plan {
        releases: vec![release("sim", "sim", None), release("c3", "esp32-c3", None)],
        phases: [1, 10, 100]
            .map(|share| phase(Selection::Share(share)))
            .into(),
        limits: Limits::default(),
        window: None,
        retries: Retries::default(),
        timeouts: Timeouts::default(),
        override_gate: None,
    }
}

fn group(names: &[&str]) -> Selection {
    let robots = names.iter().map(|name| RobotId::new(name).unwrap());
    Selection::Group(robots.collect())
}

#[test]
fn good_plans_pass() {
    assert_eq!(plan().check(), Ok(()));
    let mut mixed = plan();
    mixed.releases = vec![
        release("a", "sim", Some(Kind::Simulated)),
        release("b", "sim", Some(Kind::Emulated)),
    ];
    mixed.phases.insert(0, phase(group(&["a", "b"])));
    mixed
        .phases
        .insert(1, phase(Selection::Kind(Kind::Emulated)));
    mixed
        .phases
        .insert(2, phase(Selection::Board(BoardName::new("sim").unwrap())));
    assert_eq!(mixed.check(), Ok(()));
}

#[test]
fn programs_and_each_model_have_plans_of_their_own() {
    let mut plan = plan();
    let text = serde_json::to_string(&plan).unwrap();
    assert!(!text.contains("model"), "{text}");
    let ids = plan.releases.iter().map(|one| one.release.clone());
    let [a, b] = ids.collect::<Vec<_>>().try_into().unwrap();
    let mixed = Err(PlanError::Mixed(a, b));
    for (first, second, expected) in [
        (None, Some("eyes"), mixed.clone()),
        (Some("eyes"), None, mixed.clone()),
        (Some("eyes"), Some("ears"), mixed),
        (Some("eyes"), Some("eyes"), Ok(())),
    ] {
        for (release, model) in plan.releases.iter_mut().zip([first, second]) {
            release.model = model.map(|name| name.parse().unwrap());
        }
        assert_eq!(plan.check(), expected, "{first:?} {second:?}");
    }
    assert_eq!(
        plan.model().map(crawler_protocol::ModelName::as_str),
        Some("eyes")
    );
    let text = serde_json::to_string(&plan).unwrap();
    assert_eq!(serde_json::from_str::<Plan>(&text).unwrap(), plan);
}

/// Makes a good plan a bad one.
type Spoil = fn(&mut Plan);

#[test]
fn bad_plans_say_what_is_wrong() {
    let bad: [(&str, Spoil); 27] = [
        ("releases: at least one, at most 32", |p| p.releases.clear()),
        ("releases: at least one, at most 32", |p| {
            p.releases = vec![p.releases[0].clone(); 33];
        }),
        (
            "releases sim and other are for the same robots: leave one out",
            |p| {
                p.releases
                    .push(release("other", "sim", Some(Kind::Physical)));
            },
        ),
        ("bytes of a release: from 1 to 16777216", |p| {
            p.releases[0].bytes = 0;
        }),
        ("bytes of a release: from 1 to 16777216", |p| {
            p.releases[1].bytes = u32::MAX;
        }),
        ("sequence: from 1 to 18446744073709551615", |p| {
            p.releases[0].sequence = 0;
        }),
        ("phases: at least one, at most 32", |p| p.phases.clear()),
        ("phases: at least one, at most 32", |p| {
            p.phases = vec![p.phases[0].clone(); 33];
        }),
        ("share: from 1 to 100", |p| {
            p.phases[0].select = Selection::Share(0);
        }),
        ("share: from 1 to 100", |p| {
            p.phases[2].select = Selection::Share(101);
        }),
        (
            "a share of 10 % adds no robot: shares count those of earlier phases, and rise",
            |p| p.phases[2].select = Selection::Share(10),
        ),
        ("robots of a group: at least one, at most 20000", |p| {
            p.phases[1].select = group(&[]);
        }),
        ("a is named twice", |p| {
            p.phases[0].select = group(&["a", "b"]);
            p.phases[1].select = group(&["c", "a"]);
        }),
        ("phase 2: an earlier phase selects the same", |p| {
            p.phases[0].select = Selection::Kind(Kind::Physical);
            p.phases[1].select = Selection::Kind(Kind::Physical);
        }),
        (
            "phase 1: no release is for the robots that it selects",
            |p| {
                p.phases[0].select = Selection::Board(BoardName::new("esp32-s3").unwrap());
            },
        ),
        (
            "phase 1: no release is for the robots that it selects",
            |p| {
                p.releases = vec![release("sim", "sim", Some(Kind::Simulated))];
                p.phases[0].select = Selection::Kind(Kind::Physical);
            },
        ),
        ("success_percent: from 1 to 100", |p| {
            p.phases[0].success_percent = 0;
        }),
        ("success_percent: from 1 to 100", |p| {
            p.phases[0].success_percent = 255;
        }),
        ("stop_percent: from 1 to 100", |p| {
            p.phases[0].stop_percent = 0;
        }),
        ("min_count: from 1 to 20000", |p| p.phases[0].min_count = 0),
        ("soak_s: from 0 to 7776000", |p| {
            p.phases[0].soak_s = u32::MAX;
        }),
        ("limits.parallel: from 1 to 20000", |p| {
            p.limits.parallel = 0;
        }),
        ("limits.bytes_per_second: from 16384 to 4294967295", |p| {
            p.limits.bytes_per_second = Some(1);
        }),
        ("retries.attempts: from 1 to 10", |p| {
            p.retries.attempts = 11;
        }),
        ("retries.longest_pause_s: from 60 to 7776000", |p| {
            p.retries.longest_pause_s = 59;
        }),
        ("timeouts.trial_s: from 60 to 7776000", |p| {
            p.timeouts.trial_s = 59;
        }),
        (
            "the window closes when it opens: leave it out for a rollout at any time",
            |p| {
                let noon = "12:00".parse().unwrap();
                p.window = Some(Window {
                    from: noon,
                    to: noon,
                    offset_minutes: 0,
                });
            },
        ),
    ];
    for (want, spoil) in bad {
        let mut plan = plan();
        spoil(&mut plan);
        assert_eq!(
            plan.check().map_err(|error| error.to_string()),
            Err(want.to_owned())
        );
    }
}

#[test]
fn a_plan_is_json_with_defaults_and_no_unknown_keys() {
    let json = r#"{
        "releases": [{"release": "sim-4", "board": "sim", "build": "4f", "version": "0.4.0", "sequence": 4,
                      "bytes": 1000}],
        "phases": [{"select": {"share": 1}}, {"select": {"group": ["a"]}, "soak_s": 5},
                   {"select": {"board": "sim"}}, {"select": {"kind": "simulated"}}],
        "limits": {"parallel": 7},
        "window": {"from": "22:00", "to": "04:00"}}"#;
    let plan: Plan = serde_json::from_str(json).unwrap();
    assert_eq!(plan.check(), Ok(()));
    assert_eq!((plan.limits.parallel, plan.retries.attempts), (7, 3));
    let again = serde_json::to_string(&plan).unwrap();
    assert_eq!(serde_json::from_str::<Plan>(&again).unwrap(), plan);
    for (from, to) in [
        ("\"parallel\"", "\"paralel\""),
        ("\"soak_s\"", "\"soak\""),
        ("\"sequence\"", "\"number\""),
        ("{\"share\": 1}", "{\"share\": -1}"),
        ("{\"share\": 1}", "{\"share\": 1, \"kind\": \"physical\"}"),
        ("22:00", "22:60"),
        ("\"a\"", "\"A\""),
    ] {
        assert!(json.contains(from));
        assert!(
            serde_json::from_str::<Plan>(&json.replace(from, to)).is_err(),
            "{to}"
        );
    }
}

proptest! {
    /// Whatever numbers a plan has, it is judged, and one that passes has sane ones.
    #[test]
    fn any_numbers_are_judged(
        share: u8, percent: u8, stop: u8, least: u32, parallel: u32, rate: u32, attempts: u8, time: u32,
        minutes: i16,
    ) {
        let mut plan = plan();
        plan.phases.truncate(1);
        plan.phases[0] = Phase {
            select: Selection::Share(share),
            soak_s: time,
            success_percent: percent,
            min_count: least,
            stop_percent: stop,
            stop_min_count: least,
        };
        plan.limits.parallel = parallel;
        plan.limits.bytes_per_second = Some(rate);
        plan.retries.attempts = attempts;
        plan.timeouts.trial_s = time;
        plan.window = Some(Window {
            from: "01:00".parse().unwrap(), to: "02:00".parse().unwrap(), offset_minutes: minutes,
        });
        if plan.check().is_ok() {
            for percent in [share, percent, stop] {
                prop_assert!((1..=100).contains(&percent));
            }
            prop_assert!(parallel > 0 && least > 0 && (1..=10).contains(&attempts));
            prop_assert!(minutes.abs() <= 840 && rate >= 16_384);
        }
    }
}

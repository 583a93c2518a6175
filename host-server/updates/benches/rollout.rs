//! What a rollout costs the server.
//!
//! `cargo bench -p crawler-updates --bench rollout`.

use std::hint::black_box;
use std::time::Duration;

use crawler_protocol::{Kind, RobotId};
use crawler_updates::rollout::{
    BoardName, BuildId, Event, Message, Now, Owner, Plan, ReleaseId, Report, Rollout, RolloutId,
    RolloutState, ServerId, Sighting,
};
use criterion::{Criterion, Throughput};

const ROBOTS: u32 = 1_000;
/// What a robot says on its way: blocks of 64 KB, and the steps around them.
const REPORTS: u32 = 14;

fn fleet() -> Vec<Sighting> {
    let robots = (0..ROBOTS).map(|n| Sighting {
        robot: RobotId::new(&format!("sim-{n:04}")).expect("an id"),
        board: BoardName::new("sim").expect("a board"),
        kind: Kind::Simulated,
        vision: false,
        policies: false,
        build: BuildId::new("old").expect("a build"),
        boot: 1,
        online: true,
        busy: None,
    });
    robots.collect()
}

fn plan() -> Plan {
    let plan = serde_json::json!({
        "releases": [{"release": "sim-4", "board": "sim", "build": "new", "version": "0.4.0", "sequence": 4,
                      "bytes": 622_592}],
        "phases": [{"select": {"share": 1}, "soak_s": 0}, {"select": {"share": 10}, "soak_s": 0},
                   {"select": {"share": 100}, "soak_s": 0}],
        "limits": {"parallel": 100},
    });
    serde_json::from_value(plan).expect("a plan")
}

/// A whole rollout: every robot makes its way in turn. Returns how many events that took.
fn whole(fleet: &[Sighting]) -> u32 {
    let id = RolloutId::new("bench").expect("an id");
    let server = ServerId::new("a").expect("a name");
    let owner = Owner { server, epoch: 1 };
    let now = Now {
        unix_ms: 1_700_000_000_000,
        monotonic_ms: 0,
    };
    let release = ReleaseId::new("sim-4").expect("an id");
    let build = BuildId::new("new").expect("a build");
    let (mut rollout, step) = Rollout::start(id, plan(), owner, fleet, now).expect("a rollout");
    let mut offers = std::collections::VecDeque::from(step.effects);
    let mut events = 0;
    while let Some(offer) = offers.pop_front() {
        if offer.message != Message::Offer {
            continue;
        }
        let blocks = (1..=10).map(|block| Report::Receiving(block * 62_259));
        let way = [Report::Preparing].into_iter().chain(blocks).chain([
            Report::Verifying,
            Report::Trial(build.clone()),
            Report::Confirmed(build.clone()),
        ]);
        for report in way {
            let told = Event::Told {
                robot: offer.robot.clone(),
                release: release.clone(),
                report,
            };
            offers.extend(black_box(rollout.handle(told, now)).effects);
            events += 1;
        }
    }
    assert_eq!(rollout.document().state, RolloutState::Done);
    events
}

fn main() {
    let mut criterion = Criterion::default()
        .sample_size(20)
        .measurement_time(Duration::from_secs(4))
        .configure_from_args();
    let fleet = fleet();
    assert_eq!(whole(&fleet), ROBOTS * REPORTS);
    let mut group = criterion.benchmark_group("rollout");
    group.throughput(Throughput::Elements(u64::from(ROBOTS * REPORTS)));
    group.bench_function("events of 1,000 robots", |b| b.iter(|| whole(&fleet)));
    group.finish();
    criterion.final_summary();
}

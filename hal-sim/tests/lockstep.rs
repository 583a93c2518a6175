//! The real robot program, in lockstep.

use crawler_hal::Instant;
use crawler_sim::run::Simulation;
use crawler_sim::scenario::Scenario;

#[test]
fn smoke() {
    let scenario = Scenario::built_in("arena").unwrap().with_robots(5);
    let mut sim = Simulation::lockstep(scenario, 1).unwrap();
    sim.air().unwrap().record(10_000);
    for s in 1..=40 {
        sim.run_until(Instant::from_millis(s * 500));
        let o = sim.observe(0).unwrap();
        let snap = sim.robot(0).unwrap().snapshot();
        println!(
            "{s} {:?} {:?} {:?} pose {:?} contacts {} duty {:?} bat {:?} odo {:?} polls {}",
            snap.state, snap.behaviour, snap.fault, o.pose, o.contacts, o.duty, o.battery, snap.pose, sim.polls()
        );
    }
    let air = sim.air().unwrap();
    println!("{:?} {:?}", air.statistics(), air.take_faults());
    for p in air.take_record() {
        if p.client.as_ref() == "sim-0001" && !p.topic.contains("telemetry") && !p.topic.contains("heartbeat") {
            println!("{:?} {} {}", p.at, p.topic, String::from_utf8_lossy(&p.payload));
        }
    }
}

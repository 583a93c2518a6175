use super::*;
use crate::scenario::Scenario;

fn debugger(seed: u64) -> Debugger {
    let scenario = Scenario::built_in("arena").expect("there").with_robots(3);
    Debugger::new(Simulation::lockstep(scenario, seed).expect("sound"))
}

#[test]
fn steps_end_on_their_grid_whatever_came_before() {
    let mut debugger = debugger(1);
    assert_eq!(debugger.simulation().world().steps(), 0);
    debugger.step(Step::Physics, 1);
    assert_eq!(debugger.simulation().world().steps(), 1);
    debugger
        .simulation_mut()
        .run_for(Duration::from_micros(137));
    let reached = debugger.step(Step::Physics, 3);
    assert_eq!(reached, Instant::BOOT + PHYSICS_STEP * 4);
    assert_eq!(debugger.simulation().world().steps(), 4);
    let reached = debugger.step(Step::Control, 2);
    assert_eq!(reached.as_micros() % Step::Control.span().as_micros(), 0);
    assert!(debugger.is_paused());
    let mut whole = self::debugger(1);
    whole.run_until(reached);
    assert_eq!(
        whole.simulation().history_hash(),
        debugger.simulation().history_hash()
    );
}

#[test]
fn time_passes_at_the_pace_asked_for_and_not_while_paused() {
    let mut debugger = debugger(1);
    let second = StdDuration::from_secs(1);
    assert_eq!(debugger.pass(second), Duration::ZERO);
    debugger.resume();
    debugger.set_factor(0.5).expect("usable");
    assert_eq!(debugger.pass(second), Duration::from_millis(500));
    debugger.set_factor(3.0).expect("usable");
    debugger.pass(second);
    assert_eq!(debugger.simulation().now(), Instant::from_micros(3_500_000));
    for factor in [0.0, -1.0, 1e9, f64::NAN, f64::INFINITY] {
        assert!(debugger.set_factor(factor).is_err(), "{factor}");
    }
    assert_eq!(debugger.factor(), 3.0);
    debugger.pause();
    assert_eq!(debugger.pass(second), Duration::ZERO);
}

#[test]
fn a_reset_is_a_new_beginning_in_the_same_process() {
    let mut debugger = debugger(1);
    let end = Instant::from_micros(6_000_000);
    debugger.run_until(end);
    let first = debugger.simulation().history_hash();
    debugger.simulation_mut().remove(1);
    debugger.run_until(end + Duration::from_secs(1));
    debugger.reset(None).expect("sound");
    assert_eq!(debugger.simulation().now(), Instant::BOOT);
    assert!(debugger.simulation().journal().entries().is_empty());
    debugger.run_until(end);
    assert_eq!(debugger.simulation().history_hash(), first);
    debugger.reset(Some(2)).expect("sound");
    assert_eq!(debugger.simulation().seed(), 2);
    debugger.run_until(end);
    assert_ne!(debugger.simulation().history_hash(), first);
    debugger.reset(Some(1)).expect("sound");
    debugger.run_until(end);
    assert_eq!(debugger.simulation().history_hash(), first);
}

#[test]
fn a_world_can_be_taken_back_and_another_way_tried() {
    let mut debugger = debugger(4);
    debugger.run_until(Instant::from_micros(5_500_000));
    let kept = debugger.snapshot().expect("complete");
    let begun = debugger.simulation().history_hash();
    debugger.simulation_mut().remove(0);
    debugger.simulation_mut().spawn().expect("room");
    debugger.run_until(Instant::from_micros(8_000_000));
    let first = debugger.simulation().history_hash();
    debugger.restore(&kept).expect("the same program");
    assert_eq!(debugger.simulation().history_hash(), begun);
    assert_eq!(debugger.simulation().present(), 3);
    debugger.run_until(Instant::from_micros(8_000_000));
    assert_ne!(debugger.simulation().history_hash(), first);
}

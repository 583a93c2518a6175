//! What the bodies in software have in common: the drive that the robot program is told of.

use crawler_board::model::GEOMETRY;
use crawler_sim::run::Simulation;
use crawler_sim::scenario::Scenario;

/// How far they may be apart, as a share. The simulator has masses and forces, from which a time constant follows; the
/// board has the time constant itself.
const NEAR: f32 = 0.005;

#[test]
fn the_emulated_board_has_the_drive_of_the_simulator() {
    let scenario = Scenario::built_in("empty").expect("built in");
    let simulation = Simulation::without_network(scenario.with_robots(1), 1).expect("sound");
    let simulated = simulation.robot(0).expect("it runs here").config().geometry;
    for (what, board, simulator) in [
        ("wheel base", GEOMETRY.wheel_base_m, simulated.wheel_base_m),
        ("top speed", GEOMETRY.top_speed_mps, simulated.top_speed_mps),
        (
            "time constant",
            GEOMETRY.time_constant_s,
            simulated.time_constant_s,
        ),
        ("stiction", GEOMETRY.stiction_duty, simulated.stiction_duty),
        ("voltage", GEOMETRY.nominal_v, simulated.nominal_v),
        ("bridge", GEOMETRY.bridge_drop_v, simulated.bridge_drop_v),
    ] {
        assert!(
            (board - simulator).abs() <= NEAR * simulator,
            "{what}: {board} and {simulator}"
        );
    }
}

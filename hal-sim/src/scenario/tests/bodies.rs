//! Robots whose bodies are known.

use crate::scenario::Scenario;
use crate::world::Body;

#[test]
fn the_last_entry_that_names_a_robot_counts() {
    let text = "name = \"known\"\nrobots = 3\n\
                [[bodies]]\nmotors = [0.9, 1.1]\ntrack_m = 0.15\n\
                [[bodies]]\nrobots = [1]\nfriction = [1.5, 0.5]\nmass_kg = 0.5\n";
    let scenario = Scenario::parse(text).expect("a scenario");
    let all = Body {
        motors: Some([0.9, 1.1]),
        track_m: Some(0.15),
        ..Body::default()
    };
    let one = Body {
        friction: Some([1.5, 0.5]),
        mass_kg: Some(0.5),
        ..Body::default()
    };
    assert_eq!([0, 1, 2].map(|robot| scenario.body(robot)), [all, one, all]);
    let again = Scenario::parse(&scenario.to_toml().expect("a file")).expect("the same");
    assert_eq!(again, scenario);
}

#[test]
fn bodies_that_no_robot_has_are_named() {
    for (entry, told) in [
        (
            "motors = [1.0, 2.5]",
            "bodies[0].motors must be between 0.2 and 2",
        ),
        (
            "motors = [nan, 1.0]",
            "bodies[0].motors must be between 0.2 and 2",
        ),
        (
            "friction = [-0.1, 1.0]",
            "bodies[0].friction must be between 0 and 2",
        ),
        (
            "track_m = 0.0",
            "bodies[0].track_m must be between 0.02 and 0.3",
        ),
        (
            "mass_kg = 1e9",
            "bodies[0].mass_kg must be between 0.05 and 5",
        ),
        (
            "gyration_m = 0.2",
            "bodies[0].gyration_m must be between 0.01 and 0.1",
        ),
        ("charge = 1.5", "bodies[0].charge must be between 0 and 1"),
        (
            "internal_ohm = inf",
            "bodies[0].internal_ohm must be between 0 and 2",
        ),
        ("robots = [2]", "bodies[0].robots names robot 2"),
    ] {
        let text = format!("name = \"x\"\nrobots = 2\n[[bodies]]\n{entry}\n");
        let error = Scenario::parse(&text).expect_err(entry).to_string();
        assert!(error.contains(told), "{entry}: {error}");
    }
    let error = Scenario::parse("name = \"x\"\n[[bodies]]\nmotor = [1.0, 1.0]\n");
    assert!(
        error
            .expect_err("no such key")
            .to_string()
            .contains("motor")
    );
}

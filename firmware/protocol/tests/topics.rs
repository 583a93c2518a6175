//! Topics, filters and names.

use crawler_protocol::{Fleet, IdError, Qos, RobotId, Source, Topic, TopicError, TopicFilter};

fn robot() -> RobotId {
    RobotId::new("sim-0001").unwrap()
}

/// Topic, text after the fleet, QoS 1, retained; as the table of the contract has them.
fn topics(id: &RobotId) -> Vec<(Topic, String, bool, bool)> {
    let id = || id.clone();
    vec![
        (Topic::CommandSwarm, "command/swarm".into(), true, false),
        (
            Topic::CommandRobot(id()),
            format!("command/robot/{}", id()),
            true,
            false,
        ),
        (
            Topic::CommandExperiment,
            "command/experiment".into(),
            true,
            false,
        ),
        (
            Topic::Response(id()),
            format!("response/robot/{}", id()),
            true,
            false,
        ),
        (Topic::ResponseSwarm, "response/swarm".into(), true, false),
        (Topic::Status(id()), format!("status/{}", id()), true, true),
        (
            Topic::Heartbeat(id()),
            format!("heartbeat/{}", id()),
            false,
            false,
        ),
        (
            Topic::Telemetry(id()),
            format!("telemetry/{}", id()),
            false,
            false,
        ),
        (
            Topic::Vision(id()),
            format!("vision/{}", id()),
            false,
            false,
        ),
        (Topic::Image(id()), format!("image/{}", id()), true, false),
        (Topic::Logs(id()), format!("logs/{}", id()), false, false),
        (Topic::Map(id()), format!("map/{}", id()), false, false),
        (
            Topic::Parameters(id()),
            format!("parameters/{}", id()),
            true,
            true,
        ),
        (Topic::Pose(id()), format!("pose/{}", id()), false, false),
        (Topic::Time, "time".into(), false, false),
        (Topic::Ota(id()), format!("ota/{}", id()), true, false),
        (
            Topic::SimulatorCommand,
            "simulator/command".into(),
            true,
            false,
        ),
        (
            Topic::SimulatorExperiment,
            "simulator/experiment".into(),
            true,
            false,
        ),
        (
            Topic::Cell { x: -3, y: 12 },
            "cell/-3/12".into(),
            false,
            false,
        ),
    ]
}

#[test]
fn topics_are_those_of_the_table() {
    let long = "a".repeat(32);
    for fleet in ["swarm", "a", long.as_str()] {
        let fleet = Fleet::new(fleet).unwrap();
        for id in ["sim-0001", "-", long.as_str()] {
            let id = RobotId::new(id).unwrap();
            for (topic, levels, acknowledged, retained) in topics(&id) {
                let text = format!("{fleet}/{levels}");
                assert_eq!(topic.render(&fleet).as_str(), text);
                assert_eq!(Topic::parse(&fleet, &text), Ok(topic.clone()));
                assert_eq!(topic.qos() == Qos::AtLeastOnce, acknowledged, "{text}");
                assert_eq!(topic.retained(), retained, "{text}");
                assert_eq!(
                    topic.robot().is_some(),
                    text.ends_with(id.as_str()),
                    "{text}"
                );
            }
        }
    }
    assert_eq!(Fleet::default().as_str(), "swarm");
}

#[test]
fn every_cell_has_one_topic() {
    let fleet = Fleet::default();
    for x in i16::MIN..=i16::MAX {
        let topic = Topic::Cell { x, y: !x };
        let text = topic.render(&fleet);
        assert_eq!(text.as_str(), format!("swarm/cell/{x}/{}", !x));
        assert_eq!(Topic::parse(&fleet, &text), Ok(topic));
    }
}

#[test]
fn what_is_no_topic_says_why() {
    let fleet = Fleet::default();
    let long = format!("swarm/status/{}", "a".repeat(33));
    for (text, error) in [
        ("", TopicError::OtherFleet),
        ("swarm", TopicError::OtherFleet),
        ("herd/time", TopicError::OtherFleet),
        ("swarmtime", TopicError::OtherFleet),
        ("/swarm/time", TopicError::OtherFleet),
        ("swarm/", TopicError::Unknown),
        ("swarm/time/", TopicError::Unknown),
        ("swarm/Time", TopicError::Unknown),
        ("swarm//time", TopicError::Unknown),
        ("swarm/status", TopicError::Unknown),
        ("swarm/status/a/b", TopicError::Unknown),
        ("swarm/command/robot", TopicError::Unknown),
        ("swarm/command/robot/a/b", TopicError::Unknown),
        ("swarm/simulator/other", TopicError::Unknown),
        ("swarm/status/", TopicError::Robot),
        ("swarm/status/+", TopicError::Robot),
        ("swarm/status/#", TopicError::Robot),
        ("swarm/status/Robot", TopicError::Robot),
        ("swarm/status/ä", TopicError::Robot),
        ("swarm/status/a\0", TopicError::Robot),
        (long.as_str(), TopicError::Robot),
        ("swarm/cell/+/+", TopicError::Cell),
        ("swarm/cell//1", TopicError::Cell),
        ("swarm/cell/01/1", TopicError::Cell),
        ("swarm/cell/-0/1", TopicError::Cell),
        ("swarm/cell/+1/1", TopicError::Cell),
        ("swarm/cell/1.0/1", TopicError::Cell),
        ("swarm/cell/32768/1", TopicError::Cell),
    ] {
        assert_eq!(Topic::parse(&fleet, text), Err(error), "{text}");
    }
}

/// Whether an MQTT filter selects a topic, by the rules of MQTT 5 section 4.7.
fn selects(filter: &str, topic: &str) -> bool {
    let (mut filter, mut topic) = (filter.split('/'), topic.split('/'));
    loop {
        match (filter.next(), topic.next()) {
            (Some("#"), _) | (None, None) => return true,
            (Some("+"), Some(_)) => {}
            (Some(wanted), Some(level)) if wanted == level => {}
            _ => return false,
        }
    }
}

#[test]
fn every_topic_has_exactly_one_filter_and_it_selects_as_mqtt_does() {
    let fleet = Fleet::new("herd").unwrap();
    for (topic, ..) in topics(&robot()) {
        let matching: Vec<_> = TopicFilter::ALL
            .iter()
            .filter(|filter| filter.matches(&topic))
            .collect();
        assert_eq!(matching.len(), 1, "{topic:?}");
        assert_eq!(matching[0].qos(), topic.qos(), "{topic:?}");
        for filter in TopicFilter::ALL {
            assert_eq!(
                selects(&filter.render(&fleet), &topic.render(&fleet)),
                filter.matches(&topic),
                "{filter:?} {topic:?}"
            );
        }
    }
}

#[test]
fn names_are_what_they_must_be() {
    assert_eq!(RobotId::new(""), Err(IdError::Empty));
    assert_eq!(RobotId::new(&"a".repeat(33)), Err(IdError::TooLong));
    for byte in 0..=u8::MAX {
        let text = String::from(char::from(byte));
        let id = matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'-');
        let source = matches!(byte, 0x20..=0x7e) && !matches!(byte, b'"' | b'\\');
        assert_eq!(RobotId::new(&text).is_ok(), id, "{byte}");
        assert_eq!(Fleet::new(&text).is_ok(), id, "{byte}");
        assert_eq!(Source::new(&text).is_ok(), source, "{byte}");
    }
    assert_eq!(Source::new(&"a".repeat(49)), Err(IdError::TooLong));
}

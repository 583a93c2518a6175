//! Tests of the policy.

use proptest::prelude::*;

use super::*;

const ME: &str = "rover-7";

fn fleet() -> Fleet {
    Fleet::new("barn").expect("a name")
}

fn robot(id: &str) -> Principal {
    Principal::Robot(RobotId::new(id).expect("an id"))
}

/// A learner, which may be called like a robot.
fn learner(name: &str) -> Principal {
    Principal::Learner(RobotId::new(name).expect("a name"))
}

fn everybody() -> [Principal; 7] {
    [
        Principal::Server,
        robot(ME),
        Principal::Simulator,
        learner(ME),
        Principal::User(Role::Viewer),
        Principal::User(Role::Operator),
        Principal::User(Role::Admin),
    ]
}

fn publishes(who: &Principal, topic: &str) -> bool {
    may(who, Act::Publish, &fleet(), topic)
}

fn subscribes(who: &Principal, filter: &str) -> bool {
    may(who, Act::Subscribe, &fleet(), filter)
}

/// Whom a row is about, if it is about one of `everybody`.
fn is_about(row: &Row, who: &Principal) -> bool {
    match (row.who, who) {
        (Who::Server, Principal::Server)
        | (Who::Robot, Principal::Robot(_))
        | (Who::Simulator, Principal::Simulator)
        | (Who::Learner, Principal::Learner(_)) => true,
        (Who::User(least), Principal::User(role)) => match least {
            Role::Viewer => true,
            Role::Operator => *role != Role::Viewer,
            Role::Admin => *role == Role::Admin,
        },
        _ => false,
    }
}

/// What a row allows, as a filter.
fn filter_of(row: &Row) -> String {
    row.topics.replace("{fleet}", "barn").replace("{own}", ME)
}

/// Whether `filter` matches `topic`, as MQTT has it. Written without a look at `covers`.
fn matches(filter: &[&str], topic: &[&str]) -> bool {
    match (filter, topic) {
        (["#"], _) | ([], []) => true,
        (["+", filter @ ..], [_, topic @ ..]) => matches(filter, topic),
        ([one, filter @ ..], [two, topic @ ..]) => one == two && matches(filter, topic),
        _ => false,
    }
}

fn levels(text: &str) -> Vec<&str> {
    text.split('/').collect()
}

/// Whether some row speaks of `topic`: the reference that `may` is compared with.
fn allowed_topic(who: &Principal, act: Act, topic: &str) -> bool {
    TABLE.iter().any(|row| {
        row.act == act
            && is_about(row, who)
            && matches(&levels(&filter_of(row)), &levels(topic))
            && !left_out(row, topic)
    })
}

/// Whether a row leaves out what it otherwise speaks of.
fn left_out(row: &Row, topic: &str) -> bool {
    let but = row.but.map(|topics| topics.replace("{fleet}", "barn"));
    but.is_some_and(|but| matches(&levels(&but), &levels(topic)))
}

#[test]
fn each_row_allows_what_it_says_to_those_it_is_about() {
    for row in TABLE {
        // The server's rows speak of everything; what follows is about those of a fleet.
        let filter = filter_of(row);
        let topic = filter
            .replace("+/+", "3/-4")
            .replace("learn/+", "learn/42")
            .replace('+', "other-1");
        let topic = topic
            .replace("barn/#", "barn/logs/x")
            .replace('#', "command");
        for who in everybody() {
            let mine = is_about(row, &who);
            if mine {
                assert!(
                    may(&who, row.act, &fleet(), &topic),
                    "{who:?} {row:?} {topic}"
                );
            }
            if mine && row.act == Act::Subscribe {
                assert!(subscribes(&who, &filter), "{who:?} {filter}");
            }
            if !mine {
                let other = allowed_topic(&who, row.act, &topic);
                assert_eq!(
                    may(&who, row.act, &fleet(), &topic),
                    other,
                    "{who:?} {topic}"
                );
            }
            if who != Principal::Server {
                let elsewhere = topic.replacen("barn", "shed", 1);
                assert!(!may(&who, row.act, &fleet(), &elsewhere), "{elsewhere}");
                let elsewhere = filter.replacen("barn", "+", 1);
                assert!(!may(&who, row.act, &fleet(), &elsewhere), "{elsewhere}");
            }
        }
        if row.topics.contains("{own}") {
            for other in ["rover-8", "rover"] {
                for other in [robot(other), learner(other)] {
                    assert!(!may(&other, row.act, &fleet(), &topic), "{other:?} {topic}");
                }
            }
        }
        assert!(!row.what.is_empty());
    }
}

/// The policy in another form, so that no row changes by accident: who publishes and who subscribes
/// each topic of the contract. S server, R the robot itself, X another robot, M simulator, L a learner of
/// the robot's name, K another learner, V viewer, O operator, A admin.
#[test]
fn each_topic_has_its_publishers_and_subscribers() {
    let expected = [
        ("command/swarm", "SOA", "SRXVOA"),
        ("command/robot/rover-7", "SOA", "SRVOA"),
        ("command/experiment", "SOA", "SRXVOA"),
        ("response/robot/rover-7", "SR", "SVOA"),
        ("response/swarm", "S", "SVOA"),
        ("status/rover-7", "SR", "SVOA"),
        ("heartbeat/rover-7", "SR", "SVOA"),
        ("telemetry/rover-7", "SR", "SVOA"),
        ("vision/rover-7", "SR", "SVOA"),
        ("image/rover-7", "SR", "SVOA"),
        ("logs/rover-7", "SR", "SVOA"),
        ("parameters/rover-7", "SR", "SVOA"),
        ("cell/-3/12", "S", "SRXVOA"),
        ("pose/rover-7", "SMOA", "SRVOA"),
        ("time", "S", "SRXMVOA"),
        ("ota/rover-7", "SR", "SR"),
        ("ota/rover-7/x", "S", "S"),
        ("simulator/command", "SOA", "SRXMVOA"),
        ("simulator/experiment", "S", "SMVOA"),
        ("simulator/response", "SM", "SMVOA"),
        ("learn/42/round", "S", "SLKVOA"),
        ("learn/42/update/rover-7", "SL", "SVOA"),
        ("learn/42/update/other-1", "S", "SVOA"),
        ("learn/42/other", "S", "SVOA"),
        ("anything/else", "S", "SVOA"),
    ];
    let all = [
        ('S', Principal::Server),
        ('R', robot(ME)),
        ('X', robot("rover-70")),
        ('M', Principal::Simulator),
        ('L', learner(ME)),
        ('K', learner("rover-70")),
        ('V', Principal::User(Role::Viewer)),
        ('O', Principal::User(Role::Operator)),
        ('A', Principal::User(Role::Admin)),
    ];
    for (topic, publishers, subscribers) in expected {
        let topic = format!("barn/{topic}");
        for (act, expected) in [(Act::Publish, publishers), (Act::Subscribe, subscribers)] {
            let found: String = all
                .iter()
                .filter(|(_, who)| may(who, act, &fleet(), &topic))
                .map(|(letter, _)| *letter)
                .collect();
            assert_eq!(found, expected, "{act} {topic}");
        }
    }
}

/// What `firmware/app/src/link` asks of a broker. It gives a session up when one subscription is
/// refused, so a row too few here is a robot that never comes up.
#[test]
fn a_robot_may_do_all_that_its_program_does() {
    let id = RobotId::new(ME).expect("an id");
    for topic in [
        Topic::CommandRobot(id.clone()),
        Topic::CommandSwarm,
        Topic::CommandExperiment,
        Topic::Time,
        Topic::Pose(id.clone()),
        Topic::SimulatorCommand,
    ] {
        assert!(subscribes(&robot(ME), &topic.render(&fleet())), "{topic:?}");
    }
    for topic in [
        Topic::Response(id.clone()),
        Topic::Status(id.clone()),
        Topic::Heartbeat(id.clone()),
        Topic::Telemetry(id.clone()),
        Topic::Vision(id.clone()),
        Topic::Image(id.clone()),
        Topic::Logs(id.clone()),
        Topic::Parameters(id),
    ] {
        assert!(publishes(&robot(ME), &topic.render(&fleet())), "{topic:?}");
    }
}

#[test]
fn nobody_but_the_server_leaves_the_fleet() {
    for filter in [
        "#",
        "+",
        "+/#",
        "/#",
        "+/command/swarm",
        "$SYS/#",
        "$SYS/broker/clients",
        "$share/g/barn/#",
        "$share/g/barn/command/swarm",
        "$queue/barn/command/swarm",
        "barnyard/#",
        "bar",
        "Barn/#",
        "/barn/#",
        " barn/#",
        "$exclusive/barn/time",
        "$delayed/1/barn/time",
        "$limit/1/barn/time",
    ] {
        for who in everybody() {
            let server = who == Principal::Server;
            assert_eq!(subscribes(&who, filter), server, "{who:?} {filter}");
            if !filter.contains(['+', '#']) {
                assert_eq!(publishes(&who, filter), server, "{who:?} {filter}");
            }
        }
    }
}

#[test]
fn a_filter_wider_than_a_row_is_refused() {
    for filter in [
        "barn/#",
        "barn/+",
        "barn/+/+",
        "barn/command/#",
        "barn/command/+",
        "barn/command/robot/+",
        "barn/command/robot/#",
        "barn/command/robot/rover-7/#",
        "barn/command/robot/rover-7/+",
        "barn/command/swarm/#",
        "barn/time/#",
        "barn/pose/+",
        "barn/+/rover-7",
        "barn/cell/#",
        "barn/cell/+/#",
        "barn/cell/+",
        "barn/cell/+/+/+",
        "barn/ota/+",
        "barn/command",
        "barn/status/rover-7",
        "barn/simulator/#",
        "barn/simulator/+",
    ] {
        assert!(!subscribes(&robot(ME), filter), "{filter}");
    }
    for filter in [
        "barn/cell/+/+",
        "barn/cell/1/+",
        "barn/cell/+/2",
        "barn/cell/1/2",
    ] {
        assert!(subscribes(&robot(ME), filter), "{filter}");
    }
    for filter in [
        "barn/simulator/#",
        "barn/simulator/+",
        "barn/simulator/command/#",
    ] {
        assert!(subscribes(&Principal::Simulator, filter), "{filter}");
    }
    for filter in [
        "barn/#",
        "barn/+/#",
        "barn",
        "barn/+",
        "barn/command/robot/+",
    ] {
        assert!(
            subscribes(&Principal::User(Role::Viewer), filter),
            "{filter}"
        );
    }
}

/// Nobody but a server and the robot reads about its update; who may have everything of the fleet still has the
/// rest of it by one filter.
#[test]
fn people_have_everything_but_updates() {
    for role in [Role::Viewer, Role::Operator, Role::Admin] {
        let person = Principal::User(role);
        for filter in ["barn/ota/#", "barn/ota/+", "barn/ota/rover-7", "barn/ota"] {
            assert!(!subscribes(&person, filter), "{filter}");
        }
        for filter in ["barn/#", "barn/+/#", "barn/+/+", "barn/+/rover-7"] {
            assert!(subscribes(&person, filter), "{filter}");
        }
    }
    for (topic, withheld) in [
        ("barn/ota/rover-7", true),
        ("barn/ota/rover-7/x", true),
        ("barn/ota", true),
        ("barn/otac/rover-7", false),
        ("barn/telemetry/rover-7", false),
        ("shed/ota/rover-7", false),
        ("ota/rover-7", false),
    ] {
        assert_eq!(is_withheld(&fleet(), topic), withheld, "{topic}");
    }
    // What is withheld from people by topic is not theirs, and is nobody else's loss: only their rows leave
    // something out.
    for row in TABLE {
        assert!(
            row.but.is_none() || matches!(row.who, Who::User(_)),
            "{row:?}"
        );
    }
}

#[test]
fn a_learner_hears_rounds_and_tells_what_it_learned_itself() {
    let me = learner(ME);
    for filter in [
        "barn/learn/+/round",
        "barn/learn/42/round",
        "barn/learn/9999999999999999999/round",
    ] {
        assert!(subscribes(&me, filter), "{filter}");
    }
    for filter in [
        "barn/#",
        "barn/+/+/round",
        "barn/learn/#",
        "barn/learn/+",
        "barn/learn/+/+",
        "barn/learn/+/#",
        "barn/learn/42/#",
        "barn/learn/+/round/#",
        "barn/learn/+/update/+",
        "barn/learn/+/update/rover-7",
        "barn/learn/42/update/rover-8",
        "barn/time",
        "barn/command/swarm",
        "barn/command/robot/rover-7",
    ] {
        assert!(!subscribes(&me, filter), "{filter}");
    }
    for topic in [
        "barn/learn/0/update/rover-7",
        "barn/learn/42/update/rover-7",
        "barn/learn/9999999999999999999/update/rover-7",
    ] {
        assert!(publishes(&me, topic), "{topic}");
    }
    for topic in [
        "barn/learn/42/update/rover-8",
        "barn/learn/42/update/learner-rover-7",
        "barn/learn/42/update/rover-7/x",
        "barn/learn/42/update",
        "barn/learn/42/round",
        "barn/learn//update/rover-7",
        "barn/learn/x/update/rover-7",
        "barn/learn/-1/update/rover-7",
        "barn/learn/+1/update/rover-7",
        "barn/learn/1.5/update/rover-7",
        "barn/learn/10000000000000000000/update/rover-7",
        "shed/learn/42/update/rover-7",
        "barn/telemetry/rover-7",
        "barn/status/rover-7",
        "barn/response/robot/rover-7",
    ] {
        assert!(!publishes(&me, topic), "{topic}");
    }
}

#[test]
fn nobody_else_speaks_of_learning() {
    for who in everybody() {
        if matches!(who, Principal::Server | Principal::Learner(_)) {
            continue;
        }
        for topic in [
            "barn/learn",
            "barn/learn/42",
            "barn/learn/42/round",
            "barn/learn/42/update/rover-7",
            "barn/learn/42/update/rover-8",
            "barn/learn/x/update/rover-7",
        ] {
            assert!(!publishes(&who, topic), "{who:?} {topic}");
            // People read everything of the fleet, machines nothing of this.
            let person = matches!(who, Principal::User(_));
            assert_eq!(subscribes(&who, topic), person, "{who:?} {topic}");
        }
    }
}

#[test]
fn what_is_no_topic_is_refused_to_everybody() {
    let long = format!("barn/{}", "a".repeat(MAX_TOPIC));
    for who in everybody() {
        for filter in [
            "",
            "barn/#/x",
            "barn/a#",
            "barn/#a",
            "barn/+a",
            "barn/a+/b",
            "barn/++",
            "barn/##",
            "barn/time\0",
            "barn/\n",
            "barn/\u{7f}",
            &long,
        ] {
            assert!(!subscribes(&who, filter), "{who:?} {filter:?}");
            assert!(!publishes(&who, filter), "{who:?} {filter:?}");
        }
        for topic in [
            "barn/+",
            "barn/#",
            "#",
            "+",
            "barn/pose/+",
            "barn/command/robot/+",
        ] {
            assert!(!publishes(&who, topic), "{who:?} {topic}");
        }
    }
}

#[test]
fn a_wildcard_in_a_row_stands_for_a_name_when_publishing() {
    let operator = Principal::User(Role::Operator);
    assert!(publishes(&operator, "barn/command/robot/rover-9"));
    for topic in [
        "barn/command/robot/",
        "barn/command/robot/Rover",
        "barn/pose/a.b",
        "barn/pose/$",
    ] {
        assert!(!publishes(&operator, topic), "{topic}");
        assert!(publishes(&Principal::Server, topic), "{topic}");
    }
}

fn some_text() -> impl Strategy<Value = String> {
    let level = prop::sample::select(vec![
        "barn",
        "shed",
        "+",
        "#",
        "",
        "command",
        "swarm",
        "robot",
        "rover-7",
        "rover-8",
        "cell",
        "1",
        "-2",
        "time",
        "pose",
        "status",
        "simulator",
        "response",
        "ota",
        "learn",
        "round",
        "update",
        "$share",
        "$SYS",
    ]);
    let start = prop::sample::select(vec!["barn", "barn", "barn", "", "+", "#", "$share"]);
    (start, prop::collection::vec(level, 0..5)).prop_map(|(start, rest)| {
        let mut all = vec![start];
        all.extend(rest);
        all.join("/")
    })
}

fn somebody() -> impl Strategy<Value = Principal> {
    prop::sample::select(everybody().to_vec())
}

proptest! {
    #![proptest_config(crawler_properties::cases(20_000))]

    #[test]
    fn a_filter_is_allowed_only_if_all_that_it_matches_is(
        who in somebody(), filter in some_text(), topic in some_text(),
    ) {
        let plain = !topic.contains(['+', '#']);
        let told = plain && (!is_withheld(&fleet(), &topic) || !matches!(who, Principal::User(_)));
        if told && subscribes(&who, &filter) && matches(&levels(&filter), &levels(&topic)) {
            prop_assert!(allowed_topic(&who, Act::Subscribe, &topic), "{} {}", filter, topic);
        }
    }

    #[test]
    fn a_topic_is_allowed_exactly_if_a_row_speaks_of_it(who in somebody(), topic in some_text()) {
        let plain = !topic.is_empty() && !topic.contains(['+', '#']);
        let allowed = plain && allowed_topic(&who, Act::Subscribe, &topic);
        prop_assert!(!plain || subscribes(&who, &topic) == allowed);
        if publishes(&who, &topic) {
            prop_assert!(plain && allowed_topic(&who, Act::Publish, &topic));
        }
    }

    #[test]
    fn no_text_makes_it_panic(who in somebody(), text in ".{0,300}", tail in "[+#/a]{0,8}") {
        for text in [format!("barn/{text}"), format!("{text}/{tail}"), text] {
            for act in [Act::Publish, Act::Subscribe] {
                let allowed = may(&who, act, &fleet(), &text);
                prop_assert!(!allowed || text.len() <= MAX_TOPIC);
            }
        }
    }
}

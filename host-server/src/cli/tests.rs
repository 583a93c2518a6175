use std::ffi::OsString;
use std::path::PathBuf;

use clap::{CommandFactory as _, Parser as _};

use super::*;
use crate::config::*;

fn resolve(arguments: &[&str], environment: &[(&str, &str)]) -> Result<Settings, ConfigError> {
    let cli = Cli::try_parse_from([&["terracrawler"], arguments].concat()).expect("command line");
    let environment = environment
        .iter()
        .map(|(name, value)| (OsString::from(name), OsString::from(value)));
    cli.settings(environment)
}

/// A file of its own for each test, removed with the value.
struct TomlFile(PathBuf);

impl TomlFile {
    fn new(name: &str, text: &str) -> Self {
        let path = std::env::temp_dir().join(format!("crawler-{name}-{}.toml", std::process::id()));
        std::fs::write(&path, text).expect("write");
        Self(path)
    }

    fn path(&self) -> &str {
        self.0.to_str().expect("UTF-8")
    }
}

impl Drop for TomlFile {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

#[test]
fn defaults_stay_on_this_machine() {
    let settings = resolve(&["up"], &[]).expect("defaults");
    assert_eq!(settings.robots, Some(50));
    assert_eq!(settings.fleet.as_str(), "swarm");
    assert_eq!(settings.http.to_string(), "127.0.0.1:8080");
    assert_eq!(
        settings.broker,
        Broker::Embedded("127.0.0.1:1883".parse().expect("address"))
    );
    assert!(settings.exposed().is_empty());
}

#[test]
fn command_line_over_environment_over_file() {
    let file = TomlFile::new(
        "precedence",
        "robots = 1\nseed = 11\nfleet = \"file\"\nlog = \"warn\"\n",
    );
    let environment = [
        ("TERRACRAWLER_CONFIG", file.path()),
        ("TERRACRAWLER_ROBOTS", "2"),
        ("TERRACRAWLER_SEED", "22"),
        ("UNRELATED", "x"),
    ];
    let settings = resolve(&["up", "--robots", "3"], &environment).expect("settings");
    assert_eq!(settings.robots, Some(3), "command line");
    assert_eq!(settings.seed, 22, "environment");
    assert_eq!(settings.fleet.as_str(), "file", "file");
    assert_eq!(settings.log, "warn", "file");
}

#[test]
fn several_servers_need_a_broker_that_all_of_them_reach() {
    let alone = resolve(&["serve", "--cache", "redis://h"], &[]);
    assert!(matches!(alone, Err(ConfigError::Conflict(_))), "{alone:?}");
    let several = resolve(
        &["serve", "--cache", "redis://h", "--broker", "mqtt://b:1883"],
        &[],
    );
    assert!(several.expect("settings").cache.is_some());
}

#[test]
fn a_worker_shares_the_database_of_servers() {
    let alone = resolve(&["worker"], &[]);
    assert!(matches!(alone, Err(ConfigError::Conflict(_))), "{alone:?}");
    let file = TomlFile::new(
        "worker",
        // The options of its servers are no matter to it.
        "database = \"postgres://h/d\"\nexperiment_threads = 7\nrobots = 0\nhttp = \"0.0.0.0:1\"\n",
    );
    let environment = [
        ("TERRACRAWLER_CONFIG", file.path()),
        ("TERRACRAWLER_WORKER_NAME", "lab-1"),
    ];
    let settings = resolve(&["worker", "--threads", "3"], &environment).expect("settings");
    assert_eq!(settings.role, Role::Worker);
    assert_eq!(settings.worker_name(), "lab-1");
    assert_eq!(settings.experiment_threads.map(u8::from), Some(3));
    assert!(settings.database.is_some() && settings.exposed().is_empty());
    let named = resolve(&["worker", "--name", "x"], &environment).expect("settings");
    assert_eq!(named.worker_name(), "x");
}

#[test]
fn robots_that_are_recorded_take_no_updates() {
    let both = ["sim", "--record", "a.mcap", "--release-key", "key.pem"];
    let both = resolve(&both, &[]);
    assert!(matches!(both, Err(ConfigError::Conflict(_))), "{both:?}");
    let keys = resolve(&["sim", "--release-key", "key.pem"], &[]);
    assert!(keys.expect("settings").release_key.is_some());
}

#[test]
fn every_key_is_known_in_every_source() {
    let values = [
        ("fleet", "bench", "\"bench\""),
        ("broker", "mqtt://h:1", "\"mqtt://h:1\""),
        ("mqtt", "127.0.0.1:1", "\"127.0.0.1:1\""),
        ("http", "127.0.0.1:2", "\"127.0.0.1:2\""),
        ("data", "d", "\"d\""),
        ("database", "postgres://h/d", "\"postgres://h/d\""),
        ("timeseries", "influx://h/d", "\"influx://h/d\""),
        ("cache", "redis://h", "\"redis://h\""),
        ("trusted_proxies", "10.0.0.0/8", "\"10.0.0.0/8\""),
        ("open", "true", "true"),
        ("robots", "7", "7"),
        ("scenario", "arena", "\"arena\""),
        ("seed", "9", "9"),
        ("radio_proxy", "127.0.0.1:3", "\"127.0.0.1:3\""),
        ("record", "r.mcap", "\"r.mcap\""),
        ("release_key", "k.pem,n.pem", "\"k.pem, n.pem\""),
        ("require_gate", "all", "\"all\""),
        ("twins", "20", "20"),
        ("log", "debug", "\"debug\""),
        ("log_format", "json", "\"json\""),
        ("tls", "on", "\"on\""),
        ("tls_names", "a.example,10.0.0.1", "\"a.example, 10.0.0.1\""),
        ("tls_certificate", "c.pem", "\"c.pem\""),
        ("tls_key", "c.key", "\"c.key\""),
        ("tls_client_ca", "r.pem", "\"r.pem\""),
        ("mqtt_plain", "127.0.0.1:4", "\"127.0.0.1:4\""),
        ("broker_ca", "b.pem", "\"b.pem\""),
        ("experiment_threads", "3", "3"),
        ("worker_name", "lab-1", "\"lab-1\""),
    ];
    assert_eq!(values.map(|(key, _, _)| key), KEYS);
    for (key, plain, toml) in values {
        let variable = format!("TERRACRAWLER_{}", key.to_uppercase());
        let (from_environment, _) =
            Layer::from_environment([(OsString::from(variable), OsString::from(plain))])
                .expect(key);
        let from_file = Layer::from_toml(&format!("{key} = {toml}")).expect(key);
        assert_eq!(from_environment, from_file, "{key}");
        assert_ne!(from_file, Layer::default(), "{key}");

        let option = format!("--{}", key.replace('_', "-"));
        let cli = Cli::try_parse_from(["terracrawler", "up", &option, plain]).expect(key);
        assert_eq!(cli.into_layer().expect("a layer").1, from_file, "{key}");
    }
}

#[test]
fn a_server_is_closed_unless_told_otherwise() {
    assert!(!resolve(&["serve"], &[]).expect("settings").open);
    // The bare word is enough, and an option may follow it.
    for arguments in [&["up", "--open"][..], &["up", "--open", "--seed", "2"]] {
        assert!(resolve(arguments, &[]).expect("settings").open);
    }
    let environment = [("TERRACRAWLER_OPEN", "true")];
    assert!(resolve(&["serve"], &environment).expect("settings").open);
    let closed = resolve(&["serve", "--open", "false"], &environment);
    assert!(!closed.expect("settings").open);
    resolve(&["serve"], &[("TERRACRAWLER_OPEN", "yes")]).expect_err("neither true nor false");
}

#[test]
fn unknown_names_are_errors() {
    let error = Cli::try_parse_from(["terracrawler", "up", "--robot", "5"]).expect_err("option");
    assert!(error.to_string().contains("--robots"), "{error}");

    let error = resolve(&["up"], &[("TERRACRAWLER_ROBOT", "5")]).expect_err("variable");
    let text = error.to_string();
    assert!(text.contains("TERRACRAWLER_ROBOT;"), "{text}");
    assert!(text.contains("TERRACRAWLER_ROBOTS"), "{text}");

    let file = TomlFile::new("unknown", "seed = 1\nrobot = 5\n");
    let text = resolve(&["up", "--config", file.path()], &[])
        .expect_err("key")
        .to_string();
    assert!(text.contains("line 2"), "{text}");
    assert!(text.contains("unknown field `robot`"), "{text}");
    assert!(!text.contains('\n'), "{text}");
}

#[test]
fn values_that_cannot_be_are_errors() {
    for (arguments, environment, expected) in [
        (&["up", "--robots", "0"][..], &[][..], "outside 1 to 10000"),
        (&["up", "--robots", "10001"], &[], "outside 1 to 10000"),
        (
            &["up"],
            &[("TERRACRAWLER_ROBOTS", "many")],
            "TERRACRAWLER_ROBOTS: `many`",
        ),
        (
            &["up"],
            &[("TERRACRAWLER_FLEET", "My Fleet")],
            "1 to 32 of a-z",
        ),
        (
            &["up"],
            &[("TERRACRAWLER_BROKER", "wss://h")],
            "only mqtt:// and mqtts:// are supported",
        ),
        (
            &["up", "--config", "/nonexistent.toml"],
            &[],
            "cannot read /nonexistent.toml",
        ),
    ] {
        let text = resolve(arguments, environment)
            .expect_err(expected)
            .to_string();
        assert!(text.contains(expected), "{text}");
    }
}

#[test]
fn one_broker_at_a_time_and_the_stronger_source_decides() {
    let both = ["up", "--mqtt", "127.0.0.1:1", "--broker", "mqtt://h"];
    Cli::try_parse_from([&["terracrawler"], &both[..]].concat()).expect_err("both");

    let file = TomlFile::new("broker", "broker = \"mqtt://elsewhere\"\n");
    let settings = resolve(
        &["up", "--config", file.path(), "--mqtt", "127.0.0.1:7"],
        &[],
    )
    .expect("settings");
    assert_eq!(
        settings.broker,
        Broker::Embedded("127.0.0.1:7".parse().expect("address"))
    );

    let file = TomlFile::new("mqtt", "mqtt = \"127.0.0.1:7\"\n");
    let settings = resolve(
        &["up", "--config", file.path(), "--broker", "mqtt://h:9"],
        &[],
    )
    .expect("settings");
    assert_eq!(
        settings.broker,
        Broker::Outside("mqtt://h:9".parse().expect("broker"))
    );

    let file = TomlFile::new("both", "mqtt = \"127.0.0.1:7\"\nbroker = \"mqtt://h\"\n");
    resolve(&["up", "--config", file.path()], &[]).expect_err("both in one file");
}

#[test]
fn a_chosen_scenario_knows_its_robots() {
    let robots = |arguments: &[&str]| resolve(arguments, &[]).expect("settings").robots;
    assert_eq!(robots(&["up", "--scenario", "x.toml"]), None);
    assert_eq!(
        robots(&["up", "--scenario", "x.toml", "--robots", "9"]),
        Some(9)
    );
}

#[test]
fn other_machines_are_named() {
    let settings =
        resolve(&["up", "--http", "0.0.0.0:80", "--mqtt", "[::]:1883"], &[]).expect("settings");
    assert_eq!(settings.exposed().len(), 2);
    // Robots alone listen nowhere.
    let settings = resolve(&["sim"], &[("TERRACRAWLER_HTTP", "0.0.0.0:80")]).expect("settings");
    assert!(settings.exposed().is_empty());
}

#[test]
fn brokers_are_read_strictly() {
    let ok = |text: &str| text.parse::<BrokerUrl>().expect(text);
    assert_eq!(ok("mqtt://h").port, 1883);
    assert_eq!(ok("mqtt://h:1884/").port, 1884);
    let secure = ok("mqtts://h");
    assert_eq!((secure.port, secure.tls), (8883, true));
    assert_eq!(secure.to_string(), "mqtts://h:8883");
    assert_eq!(ok("mqtt://[::1]:1884").host, "::1");
    let url = ok("mqtt://ada:p:w@h");
    assert_eq!(url.credentials, Some(("ada".into(), "p:w".into())));
    assert_eq!(
        url.to_string(),
        "mqtt://h:1883",
        "no password where it is shown"
    );
    assert_eq!(format!("{url:?}"), "mqtt://h:1883");
    for (text, error) in [
        ("h:1883", BrokerUrlError::Scheme),
        ("http://h", BrokerUrlError::Scheme),
        ("wss://h", BrokerUrlError::Unsupported),
        ("mqtt://", BrokerUrlError::Host),
        ("mqtt://a b", BrokerUrlError::Host),
        ("mqtt://[::1", BrokerUrlError::Host),
        ("mqtt://[::1]x", BrokerUrlError::Host),
        ("mqtt://[h]:1", BrokerUrlError::Host),
        ("mqtt://h:0", BrokerUrlError::Port),
        ("mqtt://h:65536", BrokerUrlError::Port),
        ("mqtt://h:", BrokerUrlError::Port),
        ("mqtt://h/x", BrokerUrlError::Path),
    ] {
        assert_eq!(text.parse::<BrokerUrl>(), Err(error), "{text}");
    }
}

#[test]
fn tls_is_for_listeners_that_others_can_reach() {
    let covers = |arguments: &[&str], listen: &str| {
        let settings = resolve(arguments, &[]).expect("settings");
        settings.tls.covers(listen.parse().expect("address"))
    };
    for listen in ["127.0.0.1:1", "[::1]:1", "[::ffff:127.0.0.1]:1"] {
        assert!(!covers(&["serve"], listen), "{listen}");
        assert!(covers(&["serve", "--tls", "on"], listen), "{listen}");
    }
    for listen in ["0.0.0.0:1", "[::]:1", "192.0.2.1:1"] {
        assert!(covers(&["serve"], listen), "{listen}");
        assert!(!covers(&["serve", "--tls", "off"], listen), "{listen}");
    }
}

#[test]
fn options_of_tls_that_do_not_fit_are_refused() {
    for (arguments, expected) in [
        (&["serve", "--tls-certificate", "c"][..], "belong together"),
        (&["serve", "--tls-key", "k"], "belong together"),
        (
            &[
                "serve",
                "--tls-certificate",
                "c",
                "--tls-key",
                "k",
                "--tls-names",
                "h",
            ],
            "one of the two",
        ),
        (
            &["sim", "--broker", "mqtt://h", "--broker-ca", "f"],
            "mqtts://",
        ),
        (&["serve", "--mqtt-plain", "127.0.0.1:1"], "second listener"),
    ] {
        let text = resolve(arguments, &[]).expect_err(expected).to_string();
        assert!(text.contains(expected), "{text}");
    }
    let names = |text: &str| text.parse::<TlsNames>();
    assert!(names("Robots.example, 10.0.0.1,::1,a-b.c").is_ok());
    for wrong in ["", "a,", "a b", "*.example", "-a", "https://a", "a:1"] {
        assert!(names(wrong).is_err(), "{wrong}");
    }
}

#[test]
fn the_command_line_is_consistent() {
    Cli::command().debug_assert();
}

#[test]
fn a_radio_for_boards_needs_no_robots_and_is_seen_from_outside() {
    let alone = ["sim", "--robots", "0", "--radio-proxy", "0.0.0.0:1884"];
    let settings = resolve(&alone, &[]).expect("settings");
    assert_eq!(settings.robots, Some(0));
    assert_eq!(settings.exposed().len(), 1);
    assert!(resolve(&["sim", "--robots", "0"], &[]).is_err());
    let file = TomlFile::new("radio", "radio_proxy = \"0.0.0.0:1884\"\n");
    let serve = resolve(&["serve", "--config", file.path()], &[]).expect("settings");
    assert_eq!(serve.radio_proxy, None, "without robots there is no radio");
}

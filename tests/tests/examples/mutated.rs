//! The checks find what is wrong: pages with one thing changed do not pass.

use std::collections::BTreeMap;

use super::check::faults;
use super::lists;
use super::page::Page;

/// Each line is right as it stands, and wrong with one thing changed.
#[test]
fn a_page_that_is_wrong_is_noticed() {
    let mut sound = BTreeMap::new();
    for (page, right, wrong) in [
        ("README.md", "$ cargo up ", "$ cargo upp "),
        ("README.md", "$ cargo xtask test", "$ cargo xtask tests"),
        (
            "README.md",
            "--scenario resilience --seeds 100",
            "--scenario resilience --seedz 100",
        ),
        (
            "README.md",
            "--scenario resilience --seeds 100",
            "--scenario resilience --seeds many",
        ),
        (
            "README.md",
            "terracrawler replay run.mcap",
            "terracrawler replay run.mcap --untill 3",
        ),
        ("README.md", "$ terracrawler up ", "$ terracrawler start "),
        ("README.md", "-p crawler-server", "-p crawler-servant"),
        (
            "README.md",
            "swarm/telemetry/sim-0001",
            "swarm/telemetries/sim-0001",
        ),
        ("README.md", "\\\"speed\\\": 60", "\\\"speed\\\": 160"),
        (
            "README.md",
            "/api/v1/swarm/commands",
            "/api/v1/swarm/command",
        ),
        (
            "README.md",
            "'{\"command\": \"stop\"}'",
            "'{\"command\": \"stop\"'",
        ),
        ("README.md", "--board esp32c3", "--boards esp32c3"),
        ("README.md", "hil --robot ID", "hil --robots ID"),
        ("README.md", "`cargo up --open`", "`cargo up --opened`"),
        ("README.md", "```console", "```sh"),
        (
            "docs/operate.md",
            "tc doctor --config /etc",
            "tc doctors --config /etc",
        ),
        (
            "docs/operate.md",
            "tls_names = \"robots",
            "tls_name = \"robots",
        ),
        ("docs/operate.md", "rate_hz = 2.0", "rate_hertz = 2.0"),
        (
            "docs/operate.md",
            "TERRACRAWLER_BROKER=",
            "TERRACRAWLER_BROKERS=",
        ),
        (
            "docs/operate.md",
            "deploy/systemd/terracrawler.service",
            "deploy/terracrawler.service",
        ),
        (
            "docs/operate.md",
            "compose.production.yml exec terracrawler",
            "compose.production.yml exec server",
        ),
        (
            "docs/operate.md",
            "bin/terracrawler backup /var",
            "bin/terracrawler save /var",
        ),
        (
            "docs/operate.md",
            "`GET /api/v1/fences`",
            "`GET /api/v1/fence`",
        ),
        (
            "docs/operate.md",
            "\"direction\": \"forward\"",
            "\"direction\": \"upward\"",
        ),
        (
            "docs/protocol.md",
            "\"fault\": \"ranger-stuck\"",
            "\"fault\": \"ranger-struck\"",
        ),
        (
            "docs/protocol.md",
            "--example telemetry_cost",
            "--example telemetry_price",
        ),
        (
            "docs/architecture.md",
            "`firmware/app/src/intake.rs`",
            "`firmware/app/src/intakes.rs`",
        ),
        ("docs/scenarios.md", "within_s = 120.0", "with_s = 120.0"),
        (
            "docs/flash.md",
            "$ cargo xtask image",
            "$ cargo xtask picture",
        ),
        ("docs/flash.md", "$ espup install", "$ espdown install"),
        ("docs/history.md", "&step=1000", "&steps=1000"),
    ] {
        let page = Page::read(page);
        assert!(page.text.contains(right), "{} lacks {right}", page.name);
        // Were it wrong already, nothing would be shown.
        let before = sound
            .entry(page.name.clone())
            .or_insert_with(|| faults(&page));
        assert!(before.is_empty(), "{before:?}");
        let changed = Page {
            text: page.text.replacen(right, wrong, 1),
            ..page
        };
        assert!(
            !faults(&changed).is_empty(),
            "{}: {wrong} passes",
            changed.name
        );
    }
}

#[test]
fn a_list_that_is_wrong_is_noticed() {
    let pages = Page::all();
    let before = lists::faults(&pages);
    assert!(before.is_empty(), "{before:?}");
    for (name, right, wrong) in [
        (
            "docs/architecture.md",
            "`hal-sim`, `models/detector`, `models/federated` |",
            "`hal-sim` |",
        ),
        ("README.md", "| `hil` |", "| `loop` |"),
        ("docs/scenarios.md", "| `arena` | 20 |", "| `arena` | 21 |"),
        ("docs/scenarios.md", "| `uptime` |", "| `up_time` |"),
        (
            "docs/operate.md",
            "`resilience`, `long-duration`",
            "`long-duration`",
        ),
        ("docs/operate.md", "| `scan`, `capture` |", "| `scan` |"),
        ("docs/operate.md", "`flock`, `formation`", "`formation`"),
        ("docs/operate.md", "503 `not_shared`", "503 `not_divided`"),
        ("docs/debugger.md", "`forget`, `inject`", "`inject`"),
        ("docs/protocol.md", "| `vision/{id}` |", "| `sight/{id}` |"),
        (
            "docs/protocol.md",
            "| `logs/{id}` | robot → | 0 |",
            "| `logs/{id}` | robot → | 1 |",
        ),
        ("docs/protocol.md", "| `pose-fix` |", "| `pose` |"),
        ("docs/scenarios.md", "still_s = 0.2", "calm_s = 0.2"),
        ("docs/protocol.md", "| `no_clock`,", "| `no_watch`,"),
        ("docs/protocol.md", "| `stale` |", "| `old` |"),
        ("docs/experiments.md", "| `robots` |", "| `bots` |"),
        ("docs/debugger.md", "| `hash`, `journal` |", "| `journal` |"),
        ("docs/bench.md", "| `--json FILE` |", "| `--csv FILE` |"),
        ("docs/tls.md", "| `mqtt_plain` |", "| `plain_mqtt` |"),
        (
            "docs/protocol.md",
            "terracrawler_mqtt_messages",
            "terracrawler_messages",
        ),
        (
            "docs/tls.md",
            "`TERRACRAWLER_TLS_KEY`",
            "`TERRACRAWLER_TLS_SECRET`",
        ),
        (
            "docs/tls.md",
            "`--tls-client-ca FILE`",
            "`--tls-clients-ca FILE`",
        ),
        ("docs/bench.md", "`--no-motion`", "`--without-motion`"),
        (
            "docs/simulator.md",
            "`--radio-proxy ADDRESS`",
            "`--radio-proxies ADDRESS`",
        ),
    ] {
        let mut pages = pages.clone();
        let page = pages.iter_mut().find(|page| page.name == name);
        let page = page.expect("a page");
        assert!(page.text.contains(right), "{name} lacks {right}");
        page.text = page.text.replacen(right, wrong, 1);
        assert!(!lists::faults(&pages).is_empty(), "{name}: {wrong} passes");
    }
}

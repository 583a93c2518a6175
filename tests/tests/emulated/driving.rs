//! How long a board drives on when nobody steers it any more.

use std::time::Duration;

use crawler_hil::suite::{ANSWER, Bench, Failure, REST, is_standing};
use crawler_protocol::open::Telemetry;
use crawler_protocol::{Action, ResponseStatus};
use serde_json::json;

use super::board::{Board, listen};
use super::{JOINS, command, knows_the_time, machine, one, serve};

/// One controller that drives and falls silent: when the last wheel turned and the first time both stood,
/// in milliseconds after the robot took the last word, by the robot's clock. `None` when that clock was
/// set meanwhile, or telemetry went missing or was late.
async fn falls_silent(bench: &mut Bench) -> Result<Option<[u64; 2]>, Failure> {
    let mut taken = 0;
    for _ in 0..12 {
        let word = bench.ask(Action::Drive { v: 0.0, w: 4.0 }).await?;
        assert_eq!(word.status, ResponseStatus::Completed, "{word:?}");
        taken = word.timestamp;
        bench.listen(Duration::from_millis(100)).await?;
    }
    let mut before: Option<Telemetry> = None;
    loop {
        let seen = bench.until("telemetry", ANSWER, |_| true).await?;
        if let Some(before) = &before {
            // The next sample, a twentieth of a second later.
            let even = before.timestamp + 35..=before.timestamp + 65;
            if seen.seq != before.seq + 1 || !even.contains(&seen.timestamp) {
                return Ok(None);
            }
            if is_standing(&seen) {
                let after = |sample: &Telemetry| sample.timestamp.saturating_sub(taken);
                return Ok(Some([after(before), after(&seen)]));
            }
        }
        if is_standing(&seen) {
            // It has not been heard in time.
            return Ok(None);
        }
        before = Some(seen);
    }
}

#[test]
fn wheels_stand_half_a_second_after_the_last_word_of_their_controller() {
    let _machine = machine();
    let server = serve();
    let _board = Board::start("virt-01", server.mqtt(), &[]);
    server.wait_online(1, JOINS);
    knows_the_time(&server, "virt-01");
    let often = json!({"command": "set", "parameters": {"telemetry_hz": 20}});
    let counts = command(&server, "/api/v1/robots/virt-01/commands", &often);
    assert!(one("completed")(&counts), "{counts}");
    listen("virt-01", server.mqtt(), async |bench| {
        bench.meet().await.expect("a robot");
        let mut measured = Vec::new();
        let mut void = 0;
        while measured.len() < 5 {
            assert!(void < 40, "no even clock; measured so far: {measured:?}");
            match falls_silent(bench).await? {
                Some(times) => measured.push(times),
                None => void += 1,
            }
            bench.rests(REST).await?;
        }
        println!("[last turning, first standing] in ms: {measured:?}; {void} void");
        for [turning, standing] in measured {
            assert!(turning <= 500, "still turning after {turning} ms");
            assert!(standing >= 300, "standing after {standing} ms");
        }
        Ok(())
    });
}

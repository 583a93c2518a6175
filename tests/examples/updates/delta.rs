//! A release for everybody as what has changed of the one before.

use crawler_bundle::{DIGEST_BYTES, Digest};
use crawler_tests::measure::{metrics, sum};
use serde_json::json;

use super::Size;
use super::fleet::{BUILD, BYTES, Fleet, Meeting};

/// The build of the second release.
const SECOND: &str = "the-one-after";
/// What is changed of the image, in pieces of so many bytes, from one to the next of them: 9 % of it, as in a day's work.
const PIECE: usize = 1_000;
const APART: usize = 11_000;
/// For all robots to be confirmed, in seconds.
const GOAL_S: f64 = 180.0;

pub(crate) fn run(size: &Size) -> Vec<String> {
    let Size {
        robots,
        parallel_delta: parallel,
        ..
    } = *size;
    let fleet = Fleet::start(Meeting::Embedded);
    let _simulated = fleet.robots(fleet.port, robots);
    let phases = json!([{ "select": { "share": 100 }, "soak_s": 1 }]);
    let roll_out = |release: &str, what: &str| {
        let rollout = fleet.begin(release, &phases, parallel);
        fleet.wait(what, &rollout, |seen| {
            seen.count("confirmed") == robots || seen.at_work() == 0 && seen.state() != "running"
        })
    };
    let first = fleet.release(&[]);
    let whole = roll_out(&first, "all are confirmed");
    let before = fleet.chunks();
    let image = changed(fleet.bundle(SECOND, &[]));
    let second = fleet.add(&image, SECOND, 2);
    let took = roll_out(&second, "all are confirmed by delta");
    let (after, text) = (fleet.chunks(), metrics(&fleet.server));
    let count = |name: &str| sum(&text, &format!("terracrawler_updates_{name}_total"));
    let sent = (after.bytes - before.bytes) as f64 / (BYTES * robots as u64) as f64;
    println!(
        "\n{robots} robots, {parallel} at once, of whose image {} % have changed:\n\n\
         | whole image: all confirmed after, s | by delta, s | goal | sent, % of the images | offers with a delta | \
         robots that took the image in its place |\n|---:|---:|---:|---:|---:|---:|",
        100 * PIECE / APART
    );
    println!(
        "| {:.0} | {:.0} | {GOAL_S:.0} | {:.1} | {:.0} | {:.0} |",
        whole.as_secs_f64(),
        took.as_secs_f64(),
        100.0 * sent,
        count("delta_offers"),
        count("deltas_given_up")
    );
    let (first, second) = (fleet.running(BUILD), fleet.running(SECOND));
    let mut wrong = Vec::new();
    if second != robots {
        wrong.push(format!(
            "{second} of {robots} robots run the second release, {first} the first"
        ));
    }
    if count("deltas_given_up") > 0.0 || sent > 0.25 {
        wrong.push("robots took whole images in place of the delta".to_owned());
    }
    wrong
}

/// The same image with other bytes here and there.
fn changed(mut image: Vec<u8>) -> Vec<u8> {
    let end = image.len() - DIGEST_BYTES;
    for piece in image[..end].chunks_mut(APART).skip(1) {
        for byte in piece.iter_mut().take(PIECE) {
            *byte ^= 0x5a;
        }
    }
    let mut digest = Digest::new();
    digest.update(&image[..end]);
    image[end..].copy_from_slice(&digest.finish());
    image
}

//! What a sample of telemetry costs on the wire, and to read, in every way it can be written.
//!
//! The wire is that of MQTT 5 at QoS 0 over TCP over IPv4: each message is a segment of its own, with 20
//! bytes of IP, 32 of TCP (time stamps) and the PUBLISH around the samples; the acknowledgement of the
//! segment is not counted. Times are the best of many rounds, and count reading alone: what a broker
//! and sockets take for a message comes on top, once for all its samples.

use std::hint::black_box;
use std::time::Instant;

use crawler_protocol::{
    Battery, BehaviourName, Fleet, MAX_MESSAGE, Pose, RobotId, RobotState, Telemetry,
    TelemetryEncoding, Topic, Wheels,
};

/// IPv4 without options, TCP with time stamps.
const SEGMENT: usize = 20 + 32;
const ROUNDS: usize = 400;
const REPEATS: usize = 500;

/// One of a row of samples of a robot under way.
fn sample(number: u64) -> Telemetry {
    let far = number as f32 * 0.083_71;
    Telemetry {
        robot: RobotId::new("sim-0042").expect("an id"),
        seq: 12_345 + number,
        timestamp: 1_790_000_000_123 + 200 * number,
        state: RobotState::Moving,
        behaviour: BehaviourName::Wander,
        pose: Pose {
            x: 1.204_731 + far,
            y: -0.310_552 - far,
            theta: 1.571_233 + far / 7.0,
            sigma: 0.081_44,
        },
        range_mm: Some(812),
        temperature_c: Some(22.0),
        wheels: Wheels {
            left: 0.6,
            right: 0.583_1,
        },
        battery: Battery {
            mv: 7_610,
            percent: 71,
        },
        rssi_dbm: Some(-61),
        says: None,
    }
}

/// Bytes of the PUBLISH packet, but for its payload.
fn publish(how: TelemetryEncoding, payload: usize) -> usize {
    let fleet = Fleet::default();
    let topic = Topic::Telemetry(sample(0).robot).render(&fleet);
    let content_type = match how {
        TelemetryEncoding::Json => 0,
        other => 3 + other.content_type().len(),
    };
    let rest = 2 + topic.len() + 1 + content_type;
    let length = if rest + payload < 128 { 1 } else { 2 };
    1 + length + rest
}

fn main() {
    let cases = [
        (TelemetryEncoding::Json, 1),
        (TelemetryEncoding::JsonSeq, 3),
        (TelemetryEncoding::Cbor, 1),
        (TelemetryEncoding::CborSeq, 5),
        (TelemetryEncoding::CborSeq, 10),
    ];
    let messages: Vec<(TelemetryEncoding, usize, Vec<u8>)> = cases
        .into_iter()
        .map(|(how, count)| {
            let mut buf = [0; MAX_MESSAGE];
            let length = (0..count as u64).fold(0, |at, number| {
                how.append(&sample(number), &mut buf, at).expect("it fits")
            });
            (how, count, buf[..length].to_vec())
        })
        .collect();
    let mut best = vec![f64::INFINITY; messages.len()];
    // In turns, so that whatever else runs on the machine meets them all.
    for _ in 0..ROUNDS {
        for ((how, count, payload), best) in messages.iter().zip(&mut best) {
            let begun = Instant::now();
            for _ in 0..REPEATS {
                let read = how.samples(black_box(payload));
                let good = read.filter(|sample| black_box(sample).is_ok()).count();
                assert_eq!(good, *count);
            }
            let spent = begun.elapsed().as_nanos() as f64;
            *best = best.min(spent / (REPEATS * count) as f64);
        }
    }
    let wire = |how, count: usize, payload: &[u8]| {
        (SEGMENT + publish(how, payload.len()) + payload.len()) as f64 / count as f64
    };
    println!(
        "| content type | samples | payload, bytes | on the wire, bytes a sample | share | reading, ns a sample | share |"
    );
    println!("|---|---:|---:|---:|---:|---:|---:|");
    let (first, count, payload) = &messages[0];
    let whole = wire(*first, *count, payload);
    for ((how, count, payload), time) in messages.iter().zip(&best) {
        let bytes = wire(*how, *count, payload);
        println!(
            "| `{}` | {count} | {} | {bytes:.0} | {:.0} % | {time:.0} | {:.0} % |",
            how.content_type(),
            payload.len(),
            100.0 * bytes / whole,
            100.0 * time / best[0],
        );
    }
}

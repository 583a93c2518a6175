//! A sample as a line of `InfluxDB`'s line protocol.
//!
//! `telemetry,fleet=swarm,robot=sim-0001 x=1.204,y=-0.310,… 1700000000000`; see
//! <https://docs.influxdata.com/influxdb/v1/write_protocols/line_protocol_reference/>.

use std::fmt::Write as _;

use crawler_history::{LATEST, Sample, state_number, thousandths};

/// Name of the measurement that telemetry is kept under.
pub const MEASUREMENT: &str = "telemetry";

/// Writes the value of a tag. The protocol has no sign for the end of a line within one, and a value
/// cannot end in a backslash: both become `_`.
fn push_tag(out: &mut String, value: &str) {
    let begin = out.len();
    for c in value.chars() {
        match c {
            ',' | '=' | ' ' => {
                out.push('\\');
                out.push(c);
            }
            // A backslash before one of those would be taken for theirs.
            '\\' => out.push('_'),
            c if c.is_control() => out.push('_'),
            c => out.push(c),
        }
    }
    if out.len() == begin {
        out.push('_');
    }
}

/// Writes thousandths as a decimal number, exactly.
fn push_thousandths(out: &mut String, value: i64) {
    if value < 0 {
        out.push('-');
    }
    let value = value.unsigned_abs();
    // Writing to a String does not fail.
    let _ = write!(out, "{}.{:03}", value / 1_000, value % 1_000);
}

/// Appends `sample` of a robot in `fleet` to `out`, with the end of the line. A number that is none
/// becomes 0, one beyond what a robot can be is brought back into range, as in every history.
pub fn push_line(out: &mut String, fleet: &str, sample: &Sample) {
    out.push_str(MEASUREMENT);
    out.push_str(",fleet=");
    push_tag(out, fleet);
    out.push_str(",robot=");
    push_tag(out, sample.robot.as_str());
    for (name, value) in [
        (" x=", sample.x),
        (",y=", sample.y),
        (",theta=", sample.theta),
        (",left=", sample.left),
        (",right=", sample.right),
    ] {
        out.push_str(name);
        push_thousandths(out, thousandths(value));
    }
    let mut whole = |name: &str, value: i64| {
        let _ = write!(out, ",{name}={value}i");
    };
    whole("battery_mv", sample.battery_mv.into());
    whole("battery_percent", sample.battery_percent.into());
    if let Some(range) = sample.range_mm {
        whole("range_mm", range.into());
    }
    if let Some(rssi) = sample.rssi {
        whole("rssi_dbm", rssi.into());
    }
    whole("state", state_number(sample.state));
    let _ = writeln!(out, " {}", sample.at.clamp(0, LATEST));
}

#[cfg(test)]
mod tests {
    use crawler_protocol::{RobotId, RobotState};
    use proptest::prelude::*;

    use super::*;

    fn sample() -> Sample {
        Sample {
            robot: RobotId::new("sim-0001").expect("a robot id"),
            at: 1_700_000_000_123,
            x: 1.204,
            y: -0.31,
            theta: f32::NAN,
            range_mm: None,
            battery_mv: 7_610,
            battery_percent: 71,
            rssi: Some(-61),
            left: 0.6,
            right: -1.0,
            state: RobotState::Moving,
        }
    }

    /// Takes one line apart again: tags, fields and time.
    type Taken = (Vec<(String, String)>, Vec<(String, String)>, i64);

    fn take_apart(line: &str) -> Option<Taken> {
        // Split where no backslash stands before.
        let split = |text: &str, at: char| {
            let (mut parts, mut escaped) = (vec![String::new()], false);
            for c in text.chars() {
                if c == at && !escaped {
                    parts.push(String::new());
                    continue;
                }
                escaped = c == '\\' && !escaped;
                parts.last_mut().expect("one").push(c);
            }
            parts
        };
        let pairs = |parts: &[String]| {
            let pair = |part: &String| match split(part, '=').as_slice() {
                [key, value] => Some((key.clone(), value.replace('\\', ""))),
                _ => None,
            };
            parts.iter().map(pair).collect::<Option<Vec<_>>>()
        };
        let parts = split(line.strip_suffix('\n')?, ' ');
        let [key, fields, at] = parts.as_slice() else {
            return None;
        };
        let tags = split(key, ',');
        (tags[0] == MEASUREMENT).then_some(())?;
        Some((
            pairs(&tags[1..])?,
            pairs(&split(fields, ','))?,
            at.parse().ok()?,
        ))
    }

    #[test]
    fn a_sample_is_a_line() {
        let mut out = String::new();
        push_line(&mut out, "swarm", &sample());
        assert_eq!(
            out,
            "telemetry,fleet=swarm,robot=sim-0001 x=1.204,y=-0.310,theta=0.000,left=0.600,right=-1.000,\
             battery_mv=7610i,battery_percent=71i,rssi_dbm=-61i,state=2i 1700000000123\n"
        );
    }

    proptest! {
        #[test]
        fn any_sample_is_one_line_that_can_be_taken_apart(
            fleet in any::<String>(),
            at in any::<i64>(),
            numbers in any::<[f32; 5]>(),
            range_mm in any::<Option<u16>>(),
            rssi in any::<Option<i8>>(),
            battery_mv in any::<u16>(),
        ) {
            let [x, y, theta, left, right] = numbers;
            let sample = Sample { at, x, y, theta, left, right, range_mm, rssi, battery_mv, ..sample() };
            let mut out = String::new();
            push_line(&mut out, &fleet, &sample);
            prop_assert_eq!(out.matches('\n').count(), 1);
            let (tags, fields, time) = take_apart(&out).expect("a line");
            let clean: String = fleet
                .chars()
                .map(|c| if c.is_control() || c == '\\' { '_' } else { c })
                .collect();
            let clean = if clean.is_empty() { "_".to_owned() } else { clean };
            let robot = "sim-0001".to_owned();
            prop_assert_eq!(tags, [("fleet".to_owned(), clean), ("robot".to_owned(), robot)]);
            prop_assert_eq!(time, at.clamp(0, LATEST));
            let field = |name: &str| {
                fields.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
            };
            for (name, value) in [("x", x), ("y", y), ("theta", theta), ("left", left), ("right", right)] {
                let back: f64 = field(name).expect("a field").parse().expect("a number");
                prop_assert_eq!((back * 1_000.0).round() as i64, thousandths(value));
            }
            let whole = |value: Option<i64>| value.map(|value| format!("{value}i"));
            prop_assert_eq!(field("battery_mv").map(str::to_owned), whole(Some(battery_mv.into())));
            prop_assert_eq!(field("range_mm").map(str::to_owned), whole(range_mm.map(Into::into)));
            prop_assert_eq!(field("rssi_dbm").map(str::to_owned), whole(rssi.map(Into::into)));
        }
    }
}

//! Readings as a table that programs read, and as a picture.

use std::fmt::Write as _;
use std::io;
use std::path::Path;

use super::Reading;

const WIDTH: f64 = 720.0;
const PANEL: f64 = 110.0;
const LEFT: f64 = 120.0;
const RIGHT: f64 = 20.0;
const HEAD: f64 = 28.0;

/// What a panel shows.
struct Panel {
    name: &'static str,
    of: fn(&Reading) -> f64,
}

const PANELS: [Panel; 4] = [
    Panel {
        name: "memory, MiB",
        of: |reading| reading.memory_mib,
    },
    Panel {
        name: "descriptors",
        of: |reading| reading.descriptors as f64,
    },
    Panel {
        name: "tasks",
        of: |reading| reading.tasks.iter().sum::<u64>() as f64,
    },
    Panel {
        name: "disk, MB",
        of: |reading| (reading.history_bytes + reading.records_bytes) as f64 / 1e6,
    },
];

/// Writes `soak.csv` and `soak.svg`.
///
/// # Errors
/// What the operating system says.
pub(super) fn write(folder: &Path, readings: &[Reading]) -> io::Result<()> {
    std::fs::create_dir_all(folder)?;
    std::fs::write(folder.join("soak.csv"), csv(readings))?;
    std::fs::write(folder.join("soak.svg"), svg(readings))
}

fn csv(readings: &[Reading]) -> String {
    let mut text = "cycle,minutes,restarted,memory_mib,descriptors,tasks_server,tasks_broker,queued,acknowledged,\
                    refused,ended,forgotten,lost,let_go,samples,history_bytes,records_bytes\n"
        .to_owned();
    for reading in readings {
        // Writing to a String does not fail.
        let _ = writeln!(
            text,
            "{},{:.2},{},{:.1},{},{},{},{},{},{},{},{},{},{},{},{},{}",
            reading.cycle,
            reading.at.as_secs_f64() / 60.0,
            u8::from(reading.restarted),
            reading.memory_mib,
            reading.descriptors,
            reading.tasks[0],
            reading.tasks[1],
            reading.queued,
            reading.acknowledged,
            reading.refused,
            reading.ended,
            reading.forgotten,
            reading.lost.len(),
            reading.let_go,
            reading.samples,
            reading.history_bytes,
            reading.records_bytes,
        );
    }
    text
}

/// One panel below the other, each from zero to its greatest value, over minutes. A vertical line is a restart.
fn svg(readings: &[Reading]) -> String {
    let height = HEAD + PANEL * PANELS.len() as f64 + 30.0;
    let minutes = |reading: &Reading| reading.at.as_secs_f64() / 60.0;
    let end = readings.last().map_or(1.0, minutes).max(1.0);
    let x = |reading: &Reading| LEFT + (WIDTH - LEFT - RIGHT) * minutes(reading) / end;
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {height}\" font-family=\"sans-serif\" \
         font-size=\"12\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"{LEFT}\" y=\"18\">A server at rest, after each cycle; dashed: it was started again</text>\n"
    );
    for (at, panel) in PANELS.iter().enumerate() {
        let top = HEAD + PANEL * at as f64 + 10.0;
        let bottom = top + PANEL - 24.0;
        let most = readings.iter().map(panel.of).fold(1.0, f64::max);
        let y = |value: f64| bottom - (bottom - top) * value / most;
        let mut line = String::new();
        for reading in readings {
            let value = (panel.of)(reading);
            let _ = write!(line, "{:.1},{:.1} ", x(reading), y(value));
        }
        let last = readings.last().map_or(0.0, panel.of);
        let _ = write!(
            text,
            "<text x=\"8\" y=\"{:.0}\">{}</text>\n<text x=\"{}\" y=\"{:.0}\" text-anchor=\"end\">{most:.0}</text>\n\
             <text x=\"{}\" y=\"{bottom:.0}\" text-anchor=\"end\">0</text>\n\
             <path d=\"M{LEFT} {top:.0}V{bottom:.0}H{}\" fill=\"none\" stroke=\"#999\"/>\n\
             <polyline points=\"{line}\" fill=\"none\" stroke=\"#0a5\" stroke-width=\"2\"/>\n\
             <text x=\"{}\" y=\"{:.0}\" text-anchor=\"end\" fill=\"#063\">{last:.0}</text>\n",
            top + 20.0,
            panel.name,
            LEFT - 6.0,
            top + 8.0,
            LEFT - 6.0,
            WIDTH - RIGHT,
            WIDTH - RIGHT,
            y(last) - 6.0,
        );
    }
    let bottom = HEAD + PANEL * PANELS.len() as f64;
    for reading in readings.iter().filter(|reading| reading.restarted) {
        let x = x(reading);
        let _ = writeln!(
            text,
            "<path d=\"M{x:.1} {HEAD}V{bottom}\" stroke=\"#c33\" stroke-dasharray=\"4 4\"/>"
        );
    }
    let _ = write!(
        text,
        "<text x=\"{LEFT}\" y=\"{}\">0</text>\n<text x=\"{}\" y=\"{}\" text-anchor=\"end\">{end:.0} min</text>\n</svg>\n",
        bottom + 16.0,
        WIDTH - RIGHT,
        bottom + 16.0,
    );
    text
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn readings_are_in_both_files() {
        let reading = |cycle: u64| Reading {
            cycle: cycle as usize,
            at: Duration::from_mins(4 * cycle),
            restarted: cycle == 1,
            memory_mib: 100.0 + cycle as f64,
            descriptors: 1_500,
            ..Reading::default()
        };
        let readings = [reading(1), reading(2)];
        let csv = csv(&readings);
        assert_eq!(csv.lines().count(), 3);
        let columns = |line: &str| line.split(',').count();
        assert!(
            csv.lines()
                .all(|line| columns(line) == columns(csv.lines().next().expect("a head")))
        );
        assert!(csv.contains("\n2,8.00,0,102.0,1500,"));
        let svg = svg(&readings);
        assert_eq!(svg.matches("<polyline").count(), PANELS.len());
        assert_eq!(svg.matches("stroke-dasharray").count(), 1);
        assert!(svg.contains(">102</text>") && svg.contains(">8 min</text>"));
        assert!(svg.ends_with("</svg>\n"));
    }
}

//! A recorded run, made again with something else in it.

use std::fmt::Write as _;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::process::ExitCode;

use crawler_experiments::scenarios::DETECTOR;
use crawler_sim::evaluate::{Trial, of_mean};
use crawler_sim::run::{Instant, Simulation};
use crawler_sim::scenario::Metric;
use crawler_sim::what_if::{Answer, NoAnswer, Run};
use crawler_system::cli_error::{CliError, OrSay as _};

use super::prompt;

/// Robots that are told of one by one.
const MOST_ROBOTS: usize = 20;

/// Asks, and prints the answer: 0, or 1 when this build makes another run of the recording.
pub(super) fn run(
    path: &Path,
    commands: &[String],
    at_s: f64,
    until_s: Option<f64>,
    seeds: u32,
) -> Result<ExitCode, CliError> {
    let told = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let file = File::open(path).or_say(|error| told(&error))?;
    let run = Run::read(BufReader::new(file), DETECTOR).or_say(|error| told(&error))?;
    let moment = |seconds: f64| Instant::from_micros((seconds * 1e6).round() as u64);
    let (at, until) = (moment(at_s), until_s.map_or(run.end(), moment));
    let until_s = until.as_micros() as f64 * 1e-6;
    let change = |world: &mut Simulation| {
        commands.iter().try_for_each(|line| {
            let line = line.trim();
            let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
            match prompt::act(world, word, rest.trim()) {
                Ok(Some(_)) => Ok(()),
                Ok(None) => Err(CliError::new(format!(
                    "`{word:.40}` does nothing to a world"
                ))),
                Err(error) => Err(CliError::new(format!("{line:.80}: {error}"))),
            }
        })
    };
    let answer = match run.ask(at, until, change) {
        Ok(answer) => answer,
        Err(error @ NoAnswer::Differs { .. }) => {
            println!("{}", told(&error));
            return Ok(ExitCode::from(1));
        }
        Err(error) => return Err(CliError::new(told(&error))),
    };
    println!(
        "{}: {} seed {}, made again up to {until_s:.1} s, the same in all {} seconds that were recorded\nwhat if, at {at_s:.1} s: {}\n",
        path.display(),
        run.scenario().name,
        run.seed(),
        answer.same_s,
        commands.join("; ")
    );
    print!("{}", robots(&answer, run.scenario().robots as usize));
    print!("{}", metrics(&answer.was, &answer.would));
    if seeds > 0 {
        let others = (1..=u64::from(seeds)).map(|number| run.seed().wrapping_add(number));
        let asked = others.map(|seed| run.with_seed(seed).ask(at, until, change));
        let asked: Result<Vec<Answer>, NoAnswer<CliError>> = asked.collect();
        let asked = asked.map_err(|error| CliError::new(told(&error)))?;
        print!("{}", differences(&asked));
    }
    Ok(ExitCode::SUCCESS)
}

/// By how much the change changes metrics, over runs of several seeds.
fn differences(asked: &[Answer]) -> String {
    let mut text = format!(
        "\nthe same asked of {} other seeds\n{:<26}{:>12}{:>12}  {}\n",
        asked.len(),
        "",
        "as it was",
        "what if",
        "difference, 95 %"
    );
    for metric in Metric::ALL {
        let of = |trial: &Trial| trial.measured.get(metric);
        let pairs = asked.iter();
        let pairs: Vec<(f64, f64)> = pairs
            .filter_map(|answer| Some((of(&answer.was)?, of(&answer.would)?)))
            .collect();
        let mean = |of: fn(&(f64, f64)) -> f64| of_mean(&pairs.iter().map(of).collect::<Vec<_>>());
        let Some((was, (would, by))) =
            mean(|pair| pair.0).zip(mean(|pair| pair.1).zip(mean(|pair| pair.1 - pair.0)))
        else {
            continue;
        };
        let _ = write!(
            text,
            "{:<26}{:>12.3}{:>12.3}  {:+.3}",
            metric.name(),
            was.mean,
            would.mean,
            by.mean
        );
        let _ = match by.count {
            1 => writeln!(text),
            count if count < asked.len() => {
                writeln!(text, ", {:+.3} to {:+.3}, of {count}", by.low, by.high)
            }
            _ => writeln!(text, ", {:+.3} to {:+.3}", by.low, by.high),
        };
    }
    text
}

fn robots(answer: &Answer, known: usize) -> String {
    let mut all = answer.robots.clone();
    let count = all.len();
    all.retain(|robot| robot.parted_s.is_some() || robot.contacts[0] != robot.contacts[1]);
    if all.is_empty() {
        return format!("none of {count} robots is elsewhere at any moment\n");
    }
    let parted = all.len();
    all.sort_by(|one, other| {
        let when = |parted: Option<f64>| parted.unwrap_or(f64::INFINITY);
        when(one.parted_s).total_cmp(&when(other.parted_s))
    });
    let mut text = format!(
        "{parted} of {count} robots are elsewhere at some moment\n{:>8}{:>11}{:>19}{:>21}{:>10}\n",
        "robot", "from, s", "apart at the end", "contacts as it was", "what if"
    );
    for robot in all.iter().take(MOST_ROBOTS) {
        let from = robot
            .parted_s
            .map_or_else(|| "-".to_owned(), |at_s| format!("{at_s:.1}"));
        let apart = match robot.apart_m {
            Some(apart_m) => format!("{apart_m:.2} m"),
            None if robot.robot >= known => "added".to_owned(),
            None => "in one only".to_owned(),
        };
        let [was, would] = robot.contacts;
        let number = robot.robot + 1;
        // Writing to a String does not fail.
        let _ = writeln!(text, "{number:>8}{from:>11}{apart:>19}{was:>21}{would:>10}");
    }
    if parted > MOST_ROBOTS {
        let _ = writeln!(text, "    and {} more", parted - MOST_ROBOTS);
    }
    text
}

fn metrics(was: &Trial, would: &Trial) -> String {
    let mut text = format!("\n{:<26}{:>12}{:>12}\n", "", "as it was", "what if");
    for metric in Metric::ALL {
        let values = [was, would].map(|trial| trial.measured.get(metric));
        if values == [None, None] {
            continue;
        }
        let [was, would] =
            values.map(|value| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}")));
        let _ = writeln!(text, "{:<26}{was:>12}{would:>12}", metric.name());
    }
    for (whose, trial) in [("as it was", was), ("what if", would)] {
        for failure in &trial.failures {
            let _ = writeln!(text, "failed {whose}, {failure}");
        }
    }
    text
}

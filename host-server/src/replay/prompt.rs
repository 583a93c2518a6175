//! Commands to a world, one for each line.

use std::io::{BufRead, Error, ErrorKind, Read as _, Write};
use std::path::Path;
use std::process::ExitCode;

use crawler_protocol::Action;
use crawler_sim::faults::Fault;
use crawler_sim::run::Simulation;
use crawler_sim::tools::debugger::Step;
use crawler_sim::world::Pose;
use crawler_system::cli_error::{CliError, OrSay as _};

use super::session::Session;

const HELP: &str = "  \
  step [N] [control]     N physics steps (or control periods), then stand still
  run S                  S seconds on; at the pace of `speed`, or as fast as it can
  until S                run to second S of the world
  speed FACTOR|max       pace of `run`: multiple of real time
  robots                 every robot, one line each
  show ROBOT             all there is to see of one robot
  command ROBOT|all JSON give a command, like {\"command\":\"stop\"}
  set ROBOT|all NAME=VALUE  set a robot parameter
  inject ROBOT FAULT     break something: a name, or JSON like {\"fault\":\"motor-weak\",...}
  heal ROBOT             mend it all
  add [X Y THETA]        one more robot
  remove ROBOT           one less
  carry ROBOT X Y THETA  pick one up and put it down there
  drop JSON              put something in, like {\"obstacle\":{\"shape\":\"circle\",...}}
  take NUMBER            take away what was dropped
  hash                   fingerprint of every second so far
  journal                what was done to this world
  snapshot FILE          keep the world
  restore FILE           go back to one that was kept
  reset [SEED]           begin again
  record FILE|off        record from the beginning of the world
  quit                   leave
";

/// How a robot is carried.
const CARRY: &str = "carry ROBOT X Y THETA";
/// Longest line, bytes. No command comes near it.
const MOST_LINE: u64 = 64 * 1024;

/// Reads commands to the end of `input`. From a pipe the first one that fails ends it, with 2.
pub(super) fn run(
    session: &mut Session,
    mut input: impl BufRead,
    output: &mut impl Write,
    shows_prompt: bool,
) -> std::io::Result<ExitCode> {
    let prompt = |output: &mut dyn Write| {
        if shows_prompt {
            write!(output, "> ")?;
        }
        output.flush()
    };
    prompt(output)?;
    loop {
        let mut line = Vec::new();
        let taken = input
            .by_ref()
            .take(MOST_LINE + 1)
            .read_until(b'\n', &mut line)?;
        if taken == 0 {
            break;
        }
        if taken as u64 > MOST_LINE {
            let told = format!("a line of more than {MOST_LINE} bytes");
            return Err(Error::new(ErrorKind::InvalidData, told));
        }
        let line = std::str::from_utf8(&line)
            .map_err(|_| Error::new(ErrorKind::InvalidData, "a line that is no text"))?;
        let line = line.trim();
        if line == "quit" {
            break;
        }
        if !line.is_empty() && !line.starts_with('#') {
            match obey(session, line) {
                Ok(text) => writeln!(output, "{text}")?,
                Err(text) => {
                    writeln!(output, "error: {text}")?;
                    if !shows_prompt {
                        output.flush()?;
                        return Ok(ExitCode::from(2));
                    }
                }
            }
        }
        prompt(output)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Does what a line says, and says what came of it.
fn obey(session: &mut Session, line: &str) -> Result<String, CliError> {
    let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
    let rest = rest.trim();
    match word {
        "help" | "?" => return Ok(HELP.trim_end().to_owned()),
        "step" => {
            let mut words = rest.split_whitespace().peekable();
            let count = match words.peek().map(|word| word.parse::<u32>()) {
                Some(Ok(count)) if count > 0 => {
                    words.next();
                    count
                }
                Some(Ok(_)) => return Err(CliError::new("at least one step")),
                _ => 1,
            };
            let step = match words.next() {
                None | Some("physics") => Step::Physics,
                Some("control") => Step::Control,
                Some(other) => {
                    return Err(CliError::new(format!(
                        "`{other}` is no step: physics or control"
                    )));
                }
            };
            session.step(step, count)?;
        }
        "run" => {
            let now = session.world().now().as_micros() as f64 / 1e6;
            session.run_until(now + super::seconds(rest)?)?;
        }
        "until" => session.run_until(super::seconds(rest)?)?,
        "speed" if rest == "max" => session.set_speed(None)?,
        "speed" => {
            let factor = rest
                .parse()
                .map_err(|_| CliError::new("speed FACTOR, or speed max"))?;
            session.set_speed(Some(factor))?;
        }
        "robots" => return Ok(robots(session.world())),
        "show" => return show(session.world(), rest),
        "hash" => return Ok(hashes(session.world())),
        "journal" => return Ok(journal(session.world())),
        "snapshot" => session.keep(file(rest)?)?,
        "restore" => session.restore(file(rest)?)?,
        "reset" => {
            let seed = if rest.is_empty() {
                None
            } else {
                Some(
                    rest.parse::<u64>()
                        .or_say(|_| format!("`{rest}` is no seed"))?,
                )
            };
            session.reset(seed)?;
        }
        "record" if rest == "off" => {
            return Ok(match session.finish()? {
                Some(done) => format!("recorded {} messages", done.messages),
                None => "it was not being recorded".to_owned(),
            });
        }
        "record" => session.record(file(rest)?)?,
        _ => match act(session.world_mut(), word, rest)? {
            Some(told) if told.is_empty() => {}
            Some(told) => return Ok(told),
            None => {
                return Err(CliError::new(format!(
                    "`{word:.40}` is no command; `help` names those there are"
                )));
            }
        },
    }
    Ok(session.summary())
}

/// Does something to a world; what there is to tell of it, or `None` for a word that does nothing to one.
pub(super) fn act(
    world: &mut Simulation,
    word: &str,
    rest: &str,
) -> Result<Option<String>, CliError> {
    let told = match word {
        "command" => {
            let (robot, json) = two(rest, "command ROBOT|all JSON")?;
            let action = Action::parse(json.as_bytes()).map_err(|reason| {
                CliError::new(format!("the command is refused: {}", reason.name()))
            })?;
            command(world, robot, action)?
        }
        "set" => {
            let (robot, change) = two(rest, "set ROBOT|all NAME=VALUE")?;
            let values = super::parameters(&[super::setting(change)?])?;
            command(world, robot, Action::Set(values))?
        }
        "inject" => {
            let (robot, fault) = two(rest, "inject ROBOT FAULT")?;
            let robot = number(world, robot)?;
            world.inject(robot, fault_of(fault)?, None)?;
            String::new()
        }
        "heal" => {
            let robot = number(world, rest)?;
            world.heal(robot);
            String::new()
        }
        "add" => add(world, rest)?,
        "carry" => {
            let (robot, place) = two(rest, CARRY)?;
            let robot = number(world, robot)?;
            let numbers: Result<Vec<f32>, _> = place.split_whitespace().map(str::parse).collect();
            let Ok([x, y, theta]) = numbers.as_deref() else {
                return Err(CliError::new(format!("it is: {CARRY}")));
            };
            world.carry(robot, Pose::new(*x, *y, *theta))?;
            String::new()
        }
        "remove" => {
            let robot = number(world, rest)?;
            world.remove(robot);
            String::new()
        }
        "drop" => {
            let item = world.drop_in(serde_json::from_str(rest)?)?;
            format!("item {item}")
        }
        "take" => {
            let there = rest.parse().is_ok_and(|item| world.take_away(item));
            if !there {
                return Err(CliError::new(format!(
                    "nothing that was dropped has number `{rest:.20}`"
                )));
            }
            String::new()
        }
        _ => return Ok(None),
    };
    Ok(Some(told))
}

/// Gives a command to a robot, or to all.
fn command(world: &mut Simulation, robot: &str, action: Action) -> Result<String, CliError> {
    let seq = if robot == "all" {
        world.submit_all(action)
    } else {
        let robot = number(world, robot)?;
        world.submit(robot, action)
    };
    Ok(format!("command {seq} is on its way"))
}

fn two<'a>(rest: &'a str, usage: &str) -> Result<(&'a str, &'a str), CliError> {
    let (first, second) = rest
        .split_once(char::is_whitespace)
        .ok_or_else(|| CliError::new(format!("it is: {usage}")))?;
    Ok((first, second.trim()))
}

fn file(name: &str) -> Result<&Path, CliError> {
    if name.is_empty() {
        return Err(CliError::new("a file is missing"));
    }
    Ok(Path::new(name))
}

/// A robot by its name or its number, counting from 1.
fn number(world: &Simulation, name: &str) -> Result<usize, CliError> {
    let named = (0..world.robots()).find(|&robot| {
        world.id(robot).is_some_and(|id| id.as_str() == name)
            || name
                .parse::<usize>()
                .is_ok_and(|number| number == robot + 1)
    });
    let there = named.filter(|&robot| world.observe(robot).is_some_and(|seen| seen.present));
    there.ok_or_else(|| CliError::new(format!("there is no robot `{name}`")))
}

fn fault_of(text: &str) -> Result<Fault, CliError> {
    let json = if text.starts_with('{') {
        text.to_owned()
    } else {
        serde_json::json!({ "fault": text }).to_string()
    };
    serde_json::from_str(&json).map_err(CliError::from)
}

fn add(world: &mut Simulation, rest: &str) -> Result<String, CliError> {
    let numbers: Result<Vec<f32>, _> = rest.split_whitespace().map(str::parse).collect();
    let added = match numbers.as_deref() {
        Ok([]) => world.spawn(),
        Ok([x, y, theta]) => world.spawn_at(Pose::new(*x, *y, *theta)),
        _ => return Err(CliError::new("it is: add, or add X Y THETA")),
    };
    let robot = added?;
    let id = world.id(robot).map_or("", |id| id.as_str());
    Ok(format!("added {id}"))
}

fn line(world: &Simulation, robot: usize) -> Option<String> {
    let seen = world.observe(robot).filter(|seen| seen.present)?;
    let told = world.robot(robot)?.snapshot();
    Some(format!(
        "{:<9} x {:+.3} y {:+.3} theta {:+.3}  {} {}  duty {} {}  {} mV",
        world.id(robot)?.as_str(),
        seen.pose.x,
        seen.pose.y,
        seen.pose.theta,
        told.state.name(),
        told.behaviour.name(),
        seen.duty[0],
        seen.duty[1],
        seen.battery.0,
    ))
}

fn robots(world: &Simulation) -> String {
    let lines: Vec<String> = (0..world.robots())
        .filter_map(|robot| line(world, robot))
        .collect();
    lines.join("\n")
}

fn show(world: &Simulation, name: &str) -> Result<String, CliError> {
    let robot = number(world, name)?;
    let (Some(first), Some(seen), Some(program)) =
        (line(world, robot), world.observe(robot), world.robot(robot))
    else {
        return Err(CliError::new(format!("robot `{name}` does not run")));
    };
    let told = program.snapshot();
    Ok(format!(
        "{first}\n  truth      speed {:+.3} m/s, turn {:+.3} rad/s, contacts {}, charge {:.1} %, \
         powered {}\n  believes   x {:+.3} y {:+.3} theta {:+.3} sigma {:.3}\n  reading    {:?}\n  \
         battery    {:?}\n  fault      {:?}\n  boots      {}, link trouble {:?}",
        seen.speed,
        seen.turn,
        seen.contacts,
        seen.charge * 100.0,
        seen.powered,
        told.pose.x,
        told.pose.y,
        told.pose.theta,
        told.pose.sigma,
        told.reading,
        told.battery,
        told.fault,
        world.boots(robot),
        program.link_trouble(),
    ))
}

fn hashes(world: &Simulation) -> String {
    let lines = world.second_hashes().iter().enumerate();
    let lines = lines.map(|(number, hash)| format!("second {} hash {hash:016x}", number + 1));
    let now = format!("now hash {:016x}", world.history_hash());
    lines.chain([now]).collect::<Vec<_>>().join("\n")
}

fn journal(world: &Simulation) -> String {
    let journal = world.journal();
    let lines = journal.entries().iter();
    let lines = lines.map(|entry| serde_json::to_string(entry).unwrap_or_default());
    let mut lines: Vec<String> = lines.collect();
    lines.push(format!("{} inputs, {} lost", lines.len(), journal.lost()));
    lines.join("\n")
}

#[cfg(test)]
mod tests;

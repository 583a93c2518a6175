//! The robot's eyes: what they take on a chip, how well they see, and what a thousand of them cost.

use std::path::Path;

use crate::bench_sim::{Figures, get, parse};
use crate::counts;
use crate::dataset;
use crate::detector;
use crate::run::{self, Failure, Outcome};
use crate::sight::Sight;
use crate::tools;

/// Frames of the test split that the detector's README names.
const FRAMES: u32 = 2_000;
/// Robots of the world that is measured.
const ROBOTS: u32 = 1_000;
/// Clocks of the chips, in MHz. What an instruction takes there is not known: these are bounds.
const CLOCKS: [u32; 2] = [160, 240];

/// Prints the tables. `FRAMES`, if given, are judged instead of 2,000.
///
/// # Errors
/// When an argument is no number, or a measurement fails.
pub(crate) fn tables(arguments: &[String]) -> Outcome {
    let frames = match arguments {
        [] => FRAMES,
        [frames] => frames
            .parse()
            .ok()
            .filter(|frames| (1..=100_000).contains(frames))
            .ok_or_else(|| Failure(format!("'{frames}' is no number of frames")))?,
        _ => return Err(Failure("cargo xtask bench vision [FRAMES]".to_owned())),
    };
    tools::QEMU.require()?;
    chip()?;
    let program = run::build_example("crawler-sim", "vision_bench")?;
    scores(&program, frames)?;
    engines(frames)?;
    robots(&program)
}

/// Bytes and instructions on the emulated board.
fn chip() -> Outcome {
    let sight = Sight::on_board()?;
    let figure = |what: &str| {
        sight
            .figure(what)
            .ok_or_else(|| Failure(format!("the board did not tell of its {what}")))
    };
    let count = |name: &str| {
        counts::count_of(sight.text(), name)
            .ok_or_else(|| Failure(format!("the board did not count {name}")))
    };
    let parts = ["arena", "frame", "finder", "future", "stack"];
    let mut ram = 0;
    for part in parts {
        ram += figure(part)?;
    }
    println!("On the emulated board (riscv32):\n");
    println!("| blob | arena | frame | detector | look | stack of a look | RAM together |");
    println!("|---:|---:|---:|---:|---:|---:|---:|");
    print!("| {} ", figure("blob")?);
    for part in parts {
        print!("| {} ", figure(part)?);
    }
    println!("| {ram} |\n");
    let (look, row, products) = (
        count("vision_look")?,
        count("vision_row")?,
        figure("multiplications")?,
    );
    println!(
        "| multiplications | instructions of a look | for each multiplication | between two chances \
         for others |{}",
        CLOCKS
            .map(|clock| format!(" looks/s at {clock} MHz |"))
            .concat()
    );
    println!("|---:|---:|---:|---:|---:|---:|");
    let rates = CLOCKS.map(|clock| format!(" {:.1} |", f64::from(clock) * 1e6 / look as f64));
    println!(
        "| {products} | {look} | {:.2} | {row} |{}\n",
        look as f64 / products as f64,
        rates.concat()
    );
    Ok(())
}

/// What a program prints, lines of a name and a number.
fn figures(mut command: std::process::Command) -> Outcome<Figures> {
    command.stderr(std::process::Stdio::inherit());
    let shown = format!("{command:?}").replace('"', "");
    run::output_of(command)
        .map(|text| parse(&text))
        .ok_or_else(|| Failure(format!("`{shown}` fails")))
}

fn scores(program: &Path, frames: u32) -> Outcome {
    let mut command = std::process::Command::new(program);
    command.args(["scores", &frames.to_string()]);
    let figures = figures(command)?;
    println!("F1 on {frames} frames of the test split, int8:\n");
    println!("| frames | obstacle | object | robot | all |");
    println!("|---|---:|---:|---:|---:|");
    for (name, about) in [
        ("full", "8 bits a colour, as in training"),
        ("robot", "RGB565, as a robot sees them"),
    ] {
        let kinds = ["obstacle", "object", "robot", "all"];
        let cells = kinds.map(|kind| format!(" {:.3} |", get(&figures, &format!("{name}_{kind}"))));
        println!("| {about} |{}", cells.concat());
    }
    let judged = ["obstacle", "object", "robot"]
        .map(|kind| format!(" {:.0} |", get(&figures, &format!("judged_{kind}"))));
    println!("| things judged |{} |\n", judged.concat());
    Ok(())
}

/// Both engines on the frames of the test split, which the data set's program writes.
fn engines(frames: u32) -> Outcome {
    let folder = run::root().join(run::target_dir()).join("vision");
    let out = folder.to_string_lossy();
    let wanted = format!("--seed 1 --train 1 --check 1 --test {frames}");
    let mut words = vec!["--out".to_owned(), out.into_owned()];
    words.extend(wanted.split(' ').map(str::to_owned));
    dataset::command(&words)?;
    let mut command = detector::of_compare("bench", &["--bench", "engines", "--"]);
    command.arg(folder.join("test/frames.bin"));
    let figures = figures(command)?;
    let (ours, theirs) = (
        get(&figures, "micromodel_frames_per_s"),
        get(&figures, "tract_frames_per_s"),
    );
    println!("\nOn this machine, one thread, frames in turns:\n");
    println!("| micromodel, frames/s | tract, frames/s | ratio | logits | of them equal |");
    println!("|---:|---:|---:|---:|---:|");
    println!(
        "| {ours:.0} | {theirs:.0} | {:.2} | {:.0} | {:.0} |\n",
        ours / theirs,
        get(&figures, "logits"),
        get(&figures, "equal"),
    );
    Ok(())
}

fn robots(program: &Path) -> Outcome {
    let mut command = std::process::Command::new(program);
    command.args(["robots", &ROBOTS.to_string()]);
    let figures = figures(command)?;
    println!("{ROBOTS} robots with cameras that wander, lockstep, one thread:\n");
    println!("| | looks/s | CPU seconds for each second |");
    println!("|---|---:|---:|");
    for (name, about) in [("blind", "without a detector"), ("seeing", "with one")] {
        println!(
            "| {about} | {:.0} | {:.2} |",
            get(&figures, &format!("{name}_looks")),
            get(&figures, &format!("{name}_cpu_s")),
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::tables;

    #[test]
    fn what_is_no_number_of_frames_is_refused() {
        for wrong in [&["0"][..], &["-1"], &["many"], &["100001"], &["1", "2"]] {
            let words: Vec<String> = wrong.iter().map(|word| (*word).to_owned()).collect();
            assert!(tables(&words).is_err(), "{wrong:?}");
        }
    }
}

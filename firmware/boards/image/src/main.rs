//! Turns a board's ELF into flashable images, and weighs images against the budgets.
//!
//! The commands of the repository (`cargo xtask image`, `cargo xtask size`) call it; so can anybody.

mod app_image;
mod budgets;
#[cfg(test)]
mod elf_bench;
mod failure;
mod pack;
mod partitions;
mod sources;
mod weigh;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use budgets::Row;
use crawler_image_format::header::Header;
use crawler_image_format::{elf, pem};
use failure::{Context as _, Failure, Outcome, read, write};

const USAGE: &str = "\
crawler-image pack --chip CHIP --flash SIZE --partitions CSV --elf ELF --merged OUT --update OUT
crawler-image keys --elf ELF --out OUT {--release-key PEM}...
crawler-image slot --elf ELF --update OUT
crawler-image size --budgets TOML {--image NAME ELF [--chip CHIP] [--stack TASKS CONTROL]
                   [--slot UPDATE CSV SIZE]}...
crawler-image crates ELF";

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let outcome = match arguments.split_first() {
        Some((command, rest)) if command == "pack" => pack(rest),
        Some((command, rest)) if command == "keys" => keys(rest),
        Some((command, rest)) if command == "slot" => slot(rest),
        Some((command, rest)) if command == "size" => size(rest),
        Some((command, [elf])) if command == "crates" => crates(Path::new(elf)),
        _ => {
            eprintln!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure(reason)) => {
            eprintln!("crawler-image: {reason}");
            ExitCode::FAILURE
        }
    }
}

fn pack(arguments: &[String]) -> Outcome {
    let chip = pack::chip(option(arguments, "--chip")?)?;
    let flash = partitions::flash_size(option(arguments, "--flash")?)?;
    let table = PathBuf::from(option(arguments, "--partitions")?);
    let elf = PathBuf::from(option(arguments, "--elf")?);
    let merged = PathBuf::from(option(arguments, "--merged")?);
    let update = PathBuf::from(option(arguments, "--update")?);
    let target = pack::Target {
        chip,
        flash,
        partitions: &table,
    };
    let images = pack::pack(&read(&elf)?, &target)
        .map_err(|Failure(reason)| Failure(format!("{}: {reason}", elf.display())))?;
    write(&merged, &images.merged)?;
    write(&update, &images.update)?;
    println!(
        "{}: {} bytes, from address 0",
        merged.display(),
        images.merged.len()
    );
    println!(
        "{}: {} bytes, one update slot, build {}",
        update.display(),
        images.update.len(),
        app_image::build(&images.update).when(update.display())?
    );
    print_program()
}

/// Writes release keys into a program.
fn keys(arguments: &[String]) -> Outcome {
    let elf = PathBuf::from(option(arguments, "--elf")?);
    let out = PathBuf::from(option(arguments, "--out")?);
    let mut keys = Vec::new();
    for pair in arguments.windows(2) {
        if pair[0] == "--release-key" {
            let path = Path::new(&pair[1]);
            let text = String::from_utf8(read(path)?).when(path.display())?;
            let found = pem::public_keys(&text).ok_or_else(|| {
                Failure(format!("{}: no public key of P-256 in PEM", path.display()))
            })?;
            keys.extend(found);
        }
    }
    let mut program = read(&elf)?;
    crawler_image_format::keys::set(&mut program, &keys).when(elf.display())?;
    write(&out, &program)?;
    println!("{}: {} release keys", out.display(), keys.len());
    Ok(())
}

/// Tells which sources the robot program is made of, for `terracrawler release gate`.
fn print_program() -> Outcome {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    println!(
        "program {}",
        sources::hash(&root, &sources::CRATES).when(root.display())?
    );
    Ok(())
}

/// Packs the program of the emulated board.
fn slot(arguments: &[String]) -> Outcome {
    let elf = PathBuf::from(option(arguments, "--elf")?);
    let update = PathBuf::from(option(arguments, "--update")?);
    let image = elf::image(&read(&elf)?).when(elf.display())?;
    write(&update, &image)?;
    let header = image.first_chunk().and_then(Header::parse);
    let build = header.map(|header| header.build()).unwrap_or_default();
    println!(
        "{}: {} bytes, one update slot, build {}",
        update.display(),
        image.len(),
        build.escape_ascii()
    );
    print_program()
}

/// The value that follows `name`.
fn option<'a>(arguments: &'a [String], name: &str) -> Outcome<&'a str> {
    arguments
        .iter()
        .position(|argument| argument == name)
        .and_then(|at| arguments.get(at + 1))
        .map(String::as_str)
        .ok_or_else(|| Failure(format!("{name} is missing\n{USAGE}")))
}

fn size(arguments: &[String]) -> Outcome {
    let mut budgets = None;
    let mut rows: Vec<Row> = Vec::new();
    let mut rest = arguments.iter().map(String::as_str);
    while let Some(name) = rest.next() {
        let mut value = || {
            rest.next()
                .ok_or_else(|| Failure(format!("{name} lacks a value\n{USAGE}")))
        };
        match name {
            "--budgets" => {
                let path = PathBuf::from(value()?);
                let text = String::from_utf8(read(&path)?).when(path.display())?;
                budgets = Some(budgets::parse(&text)?);
            }
            "--image" => {
                let name = value()?.to_owned();
                let elf = PathBuf::from(value()?);
                let chip = pack::chip(&name).ok();
                let weight = weigh::weigh(&read(&elf)?, chip)?;
                rows.push(Row {
                    name,
                    weight,
                    stacks_used: None,
                    slot: None,
                });
            }
            "--stack" => {
                let mut bytes = || {
                    let bytes = value()?;
                    bytes.parse().when(format_args!("--stack {bytes}"))
                };
                last(&mut rows)?.stacks_used = Some([bytes()?, bytes()?]);
            }
            "--slot" => {
                let update = read(Path::new(value()?))?;
                let table = PathBuf::from(value()?);
                let flash = partitions::flash_size(value()?)?;
                let slot = partitions::load(&table, flash)?.slot;
                last(&mut rows)?.slot = Some((update.len() as u64, u64::from(slot)));
            }
            other => return Err(Failure(format!("unknown: {other}\n{USAGE}"))),
        }
    }
    let budgets = budgets.ok_or_else(|| Failure(format!("--budgets is missing\n{USAGE}")))?;
    let (table, over) = budgets::table(&rows, &budgets);
    print!("{table}");
    if over.is_empty() {
        Ok(())
    } else {
        Err(Failure(format!("over budget\n{}", over.join("\n"))))
    }
}

fn last(rows: &mut [Row]) -> Outcome<&mut Row> {
    rows.last_mut()
        .ok_or_else(|| Failure(format!("--image comes first\n{USAGE}")))
}

/// What takes the room: flash and RAM by crate.
fn crates(elf: &Path) -> Outcome {
    println!("| crate | flash | static RAM |\n|---|---:|---:|");
    for (name, weight) in weigh::by_crate(&read(elf)?)? {
        println!("| {name} | {} | {} |", weight.flash, weight.ram);
    }
    Ok(())
}

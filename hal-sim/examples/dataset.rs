//! Writes a data set for detectors: `cargo xtask dataset`.
//!
//! ```text
//! cargo run --release -p crawler-sim --example dataset -- --out DIR
//!     [--seed N] [--train N] [--check N] [--test N]
//! ```
//!
//! A folder for each split, with `frames.bin` (96 × 96 pixels of red, green, blue, frame after
//! frame) and `truth.csv` (a line for each thing that shows: number of the frame, class, middle of
//! its pixels, number of pixels, share that is not hidden, share that is within the picture).
//! Prints a hash (FNV-1a, 64 bits) of each file.

use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use crawler_sim::render::Frame;
use crawler_sim::tools::dataset::{Split, class, picture};

const USAGE: &str = "dataset --out DIR [--seed N] [--train N] [--check N] [--test N]";
/// Most frames of a split: 28 GB.
const MOST: u64 = 1_000_000;

struct Wanted {
    out: PathBuf,
    seed: u64,
    frames: [u32; 3],
}

fn wanted(arguments: impl Iterator<Item = String>) -> Result<Wanted, String> {
    let (mut out, mut seed, mut frames) = (None, 1, [90_000, 1_000, 2_000]);
    let mut arguments = arguments;
    while let Some(name) = arguments.next() {
        let value = arguments.next().ok_or(format!("{name} needs a value"))?;
        let number = || {
            value
                .parse::<u64>()
                .map_err(|_| format!("{name}: '{value}' is no number"))
        };
        if name == "--out" {
            out = Some(PathBuf::from(value));
        } else if name == "--seed" {
            seed = number()?;
        } else if let Some(at) = Split::ALL
            .iter()
            .position(|split| name.strip_prefix("--") == Some(split.name()))
        {
            frames[at] = match number()? {
                count @ 1..=MOST => count as u32,
                count => return Err(format!("{name}: 1 to {MOST} frames, not {count}")),
            };
        } else {
            return Err(format!("there is no option '{name}'"));
        }
    }
    let out = out.ok_or("--out is missing")?;
    Ok(Wanted { out, seed, frames })
}

/// FNV-1a (Fowler, Noll, Vo) over bytes.
struct Hash(u64);

impl Hash {
    const fn new() -> Self {
        Self(0xCBF2_9CE4_8422_2325)
    }

    fn take(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3);
        }
    }
}

fn write_split(folder: &Path, seed: u64, split: Split, frames: u32) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let mut pixels = BufWriter::new(File::create(folder.join("frames.bin"))?);
    let mut truth = "frame,class,x,y,pixels,visible,inside\n".to_owned();
    let mut hash = Hash::new();
    let mut frame = Frame::square();
    let began = Instant::now();
    for number in 0..frames {
        for one in picture(seed, split, number, &mut frame) {
            let Some(class) = class(one.spot.of) else {
                continue;
            };
            let spot = one.spot;
            writeln!(
                truth,
                "{number},{class},{:.2},{:.2},{},{:.3},{:.3}",
                spot.x, spot.y, spot.pixels, one.visible, one.inside
            )
            .map_err(io::Error::other)?;
        }
        pixels.write_all(frame.rgb())?;
        hash.take(frame.rgb());
    }
    pixels.flush()?;
    fs::write(folder.join("truth.csv"), &truth)?;
    let mut lines = Hash::new();
    lines.take(truth.as_bytes());
    println!(
        "{}: {frames} frames {:016x}, truth {:016x}, {:.0} s",
        split.name(),
        hash.0,
        lines.0,
        began.elapsed().as_secs_f32()
    );
    Ok(())
}

fn main() -> ExitCode {
    let wanted = match wanted(std::env::args().skip(1)) {
        Ok(wanted) => wanted,
        Err(reason) => {
            eprintln!("{reason}\n{USAGE}");
            return ExitCode::from(2);
        }
    };
    for (split, frames) in Split::ALL.into_iter().zip(wanted.frames) {
        let folder = wanted.out.join(split.name());
        if let Err(error) = write_split(&folder, wanted.seed, split, frames) {
            eprintln!("cannot write {}: {error}", folder.display());
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}

//! What `terracrawler release` takes.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::{Args, Subcommand};
use crawler_bundle::{Defect, SIZE_DEFAULT, SIZE_MAX};
use crawler_release::{Chip, Kind};
use crawler_system::cli_error::CliError;
use crawler_updates::delta::Side;
use crawler_updates::gate::Digest;

use crate::calendar::{date, moment};
use crate::config::Place;
use crate::config::{KeyFiles, Layer};

/// Seconds of a day.
const DAY: u64 = 86_400;
/// The most days that a release may last: a hundred years.
const MOST_DAYS: u64 = 36_525;

/// Releases as files.
#[derive(Debug, Clone, Args)]
pub struct ReleaseArgs {
    /// What to do.
    #[command(subcommand)]
    pub task: ReleaseTask,
}

/// What can be done with releases.
#[derive(Debug, Clone, Subcommand)]
pub enum ReleaseTask {
    /// Makes a pair of keys: one signs releases, by the other they are believed
    Keygen {
        /// Folder for both, made where it is missing
        #[arg(long, value_name = "DIR")]
        out: PathBuf,
    },
    /// Makes an image for simulated robots: a program that behaves as it is told to, well or badly
    Bundle(BundleArgs),
    /// Signs an image, and puts both into one file
    Sign(Box<SignArgs>),
    /// Says what a release is, and whether it is genuine
    Verify(VerifyArgs),
    /// Verifies a release and adds it to those of a server, on its machine; the server may run
    Add(AddArgs),
    /// Makes a patch from the image of one release to that of another
    Delta(DeltaArgs),
    /// Tries a release on scenarios and recordings with the robot program of this command line, and signs what comes
    /// of it
    Gate(GateArgs),
}

/// What `release bundle` takes.
#[derive(Debug, Clone, Args)]
pub struct BundleArgs {
    /// Version that the robots tell
    #[arg(long, value_name = "VERSION")]
    pub version: String,
    /// Build id that the robots tell
    #[arg(long, value_name = "ID")]
    pub build: String,
    /// What is wrong with it: panic=MS, hang=MS or restart=MS after each start, never-link, ranger-dead,
    /// ranger-noisy=MM, miss-control=MS (every so often); for a share of the robots with @PERCENT behind, as
    /// panic=5000@10%. May be given several times
    #[arg(long, value_name = "DEFECT")]
    pub defect: Vec<Defect>,
    /// Parameter that it overrides with this value, whatever a robot has stored. May be given several times
    #[arg(long, value_name = "NAME=NUMBER", value_parser = setting)]
    pub set: Vec<(String, f32)>,
    /// Bytes of the image
    #[arg(long, value_name = "BYTES", default_value_t = SIZE_DEFAULT, value_parser = clap::value_parser!(u32).range(..=i64::from(SIZE_MAX)))]
    pub size: u32,
    /// What fills it is drawn from this number: images with the same one differ little
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// File for the image
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// What `release sign` takes.
#[derive(Debug, Clone, Args)]
pub struct SignArgs {
    /// Private key, as `release keygen` makes it
    #[arg(long, value_name = "FILE")]
    pub key: PathBuf,
    /// Image: a program for an update slot, a model, or a policy as `train` makes it
    #[arg(long, value_name = "FILE")]
    pub image: PathBuf,
    /// Board that it is for, as the status of a robot names it, like xiao-c3
    #[arg(long, value_name = "BOARD")]
    pub board: String,
    /// Chip of that board: none, esp32c3, esp32c6, esp32s3, or Espressif's number [default: that of the
    /// board or, where the board is not known, of the image]
    #[arg(long, value_name = "CHIP", value_parser = chip)]
    pub chip: Option<Chip>,
    /// Version, for people
    #[arg(long, value_name = "VERSION")]
    pub version: String,
    /// Number of the release, above that of every earlier one for the board
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub sequence: u32,
    /// Least sequence that a robot takes once it has confirmed this release
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub floor: u32,
    /// From when on it is not to be installed: a day as 2027-01-31, at 0:00 UTC, or in how many days
    /// [default: never]
    #[arg(long, value_name = "DATE|DAYS")]
    pub expires: Option<Expiry>,
    /// What the image is: program, model or policy
    #[arg(long, value_name = "KIND", default_value_t = Kind::Program, value_parser = kind)]
    pub kind: Kind,
    /// Name of the model or the policy
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
    /// Build id of the program, by which a robot proves that it runs [default for models and policies:
    /// half of its SHA-256]
    #[arg(long, value_name = "ID")]
    pub build: Option<String>,
    /// Least sequence that must be installed before
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub requires_sequence: u32,
    /// Least version of the protocol that the program before must speak
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub requires_protocol: u8,
    /// File for the release
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// What `release verify` takes.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Ends with 0 when the release is genuine and what was asked for, and with 1 otherwise."
)]
pub struct VerifyArgs {
    /// File with the release
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Public key that is believed; may be given several times
    #[arg(long, value_name = "FILE")]
    pub public: Vec<PathBuf>,
    /// Image that must be the one in the release
    #[arg(long, value_name = "FILE")]
    pub image: Option<PathBuf>,
    /// Board that it must be for
    #[arg(long, value_name = "BOARD")]
    pub board: Option<String>,
    /// Sequence that it must be above
    #[arg(long, value_name = "N")]
    pub above: Option<u32>,
    /// Report of `release gate`, which must say that this release passed
    #[arg(long, value_name = "FILE")]
    pub gate: Option<PathBuf>,
    /// One JSON object instead of a table
    #[arg(long)]
    pub json: bool,
}

/// What `release add` takes.
#[derive(Debug, Clone, Args)]
pub struct AddArgs {
    /// File with the release
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// PEM file with a public key by which releases are believed, or two of them separated by a comma [default:
    /// those of the server's options]
    #[arg(long, value_name = "FILES")]
    pub release_key: Option<KeyFiles>,
    /// Report of `release gate` to be kept with it; of a release that is there already, in the place of another
    #[arg(long, value_name = "FILE")]
    pub gate: Option<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs)] // a doc comment here would become the command's description
    pub place: Place,
}

impl AddArgs {
    /// The options that it sets.
    pub(crate) fn layer(&self) -> Layer {
        Layer {
            release_key: self.release_key.clone(),
            ..self.place.layer()
        }
    }
}

/// What `release delta` takes.
#[derive(Debug, Clone, Args)]
pub struct DeltaArgs {
    /// File with the release that a robot runs
    #[arg(long, value_name = "FILE")]
    pub from: PathBuf,
    /// File with the release that it is to get
    #[arg(long, value_name = "FILE")]
    pub to: PathBuf,
    /// File for the patch
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

impl DeltaArgs {
    /// The file of one of both releases.
    pub(super) fn file(&self, side: Side) -> &Path {
        match side {
            Side::From => &self.from,
            Side::To => &self.to,
        }
    }
}

/// What `release gate` takes.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Ends with 0 when the release passed, and with 1 when it did not, which the report says as well, or \
    when it could not be tried."
)]
pub struct GateArgs {
    /// File with the release
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Private key that signs the report: the one that has signed the release
    #[arg(long, value_name = "FILE")]
    pub key: PathBuf,
    /// TOML file with scenarios and recordings, and what must come of them
    #[arg(long, value_name = "FILE")]
    pub plan: PathBuf,
    /// Hash of the robot program's sources that `cargo xtask image` has printed for the image: another program is not
    /// tried
    #[arg(long, value_name = "HASH")]
    pub program: Option<Digest>,
    /// Worlds that run at the same time [default: one for each processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// File for the report
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// When a release expires.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Expiry {
    /// So many days from now.
    InDays(u64),
    /// At this moment: Unix time, in seconds.
    At(u64),
}

impl Expiry {
    /// The moment, as Unix time in seconds.
    pub(super) const fn unix(self, now: u64) -> u64 {
        match self {
            Self::InDays(days) => now + days * DAY,
            Self::At(moment) => moment,
        }
    }
}

impl FromStr for Expiry {
    type Err = CliError;

    fn from_str(text: &str) -> Result<Self, CliError> {
        let wrong =
            || CliError::new("must be a day like 2027-01-31, or a number of days from 1 to 36525");
        if let Ok(days) = text.parse() {
            return if (1..=MOST_DAYS).contains(&days) {
                Ok(Self::InDays(days))
            } else {
                Err(wrong())
            };
        }
        let year: u64 = text
            .get(..4)
            .and_then(|year| year.parse().ok())
            .ok_or_else(wrong)?;
        // The calendar is asked which day has that name: none has when it is no day.
        let first = year.saturating_sub(1970) * 365;
        (first..first + 2_500)
            .find(|day| {
                let (year, month, of_month) = date(*day as i64);
                format!("{year:04}-{month:02}-{of_month:02}") == text
            })
            .map(|day| Self::At(day * DAY))
            .ok_or_else(wrong)
    }
}

/// A moment for people: UTC, to the second; `never` beyond the year 9999.
pub(super) fn shown(unix: u64) -> String {
    match i64::try_from(unix)
        .ok()
        .and_then(|unix| unix.checked_mul(1_000))
    {
        Some(unix_ms) if unix <= 253_402_300_799 => moment(unix_ms),
        _ => "after the year 9999".to_owned(),
    }
}

fn kind(text: &str) -> Result<Kind, CliError> {
    let mut known = Kind::ALL.into_iter();
    known
        .find(|kind| kind.name() == text)
        .ok_or_else(|| CliError::new("must be program, model or policy"))
}

fn setting(text: &str) -> Result<(String, f32), CliError> {
    let (name, value) = text.split_once('=').unwrap_or_default();
    match value.parse::<f32>() {
        Ok(value) if value.is_finite() && !name.is_empty() => Ok((name.to_owned(), value)),
        _ => Err(CliError::new(
            "must be a name and a number, as max_speed=40",
        )),
    }
}

fn chip(text: &str) -> Result<Chip, CliError> {
    let known = Chip::ALL.into_iter().find(|chip| chip.name() == Some(text));
    known
        .or_else(|| text.parse().ok().map(Chip))
        .ok_or_else(|| CliError::new("must be none, esp32c3, esp32c6, esp32s3 or a number"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_are_days_or_dates() {
        for (text, expected) in [
            ("1", Some(Expiry::InDays(1))),
            ("36525", Some(Expiry::InDays(36_525))),
            ("0", None),
            ("36526", None),
            ("1970-01-01", Some(Expiry::At(0))),
            ("2024-02-29", Some(Expiry::At(1_709_164_800))),
            ("2100-12-31", Some(Expiry::At(4_133_894_400))),
            ("2027-01-31", Some(Expiry::At(1_801_353_600))),
            ("2027-02-29", None),
            ("2027-13-01", None),
            ("2027-1-31", None),
            ("9999-12-31", Some(Expiry::At(253_402_214_400))),
            ("-5", None),
            ("tomorrow", None),
            ("é0-01-01", None),
            ("", None),
        ] {
            assert_eq!(text.parse().ok(), expected, "{text}");
        }
        assert_eq!(Expiry::InDays(2).unix(5), 172_805);
        assert_eq!(shown(1_801_353_600), "2027-01-31 00:00:00Z");
        assert_eq!(shown(u64::MAX), "after the year 9999");
    }

    #[test]
    fn settings_are_names_with_numbers() {
        let (name, value) = setting("max_speed=40").expect("a setting");
        assert_eq!((name.as_str(), value), ("max_speed", 40.0));
        for wrong in [
            "",
            "=",
            "max_speed",
            "max_speed=",
            "=4",
            "a=b",
            "a=NaN",
            "a=1=2",
            "a=1e99",
        ] {
            assert!(setting(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn chips_have_names_and_numbers() {
        assert_eq!(chip("esp32c3").expect("a chip"), Chip::ESP32_C3);
        assert_eq!(chip("none").expect("a chip"), Chip::NONE);
        assert_eq!(chip("2").expect("a chip"), Chip(2));
        for wrong in ["esp8266", "-1", "65536", ""] {
            assert!(chip(wrong).is_err(), "{wrong}");
        }
    }
}

//! What can go wrong with an emulator, in one line each.

use std::fmt;
use std::path::PathBuf;
use std::process::ExitStatus;

use super::QEMU;

/// Why an emulator does not start, or does not do what it is told.
#[derive(Debug)]
#[non_exhaustive]
pub enum EmulatorError {
    /// QEMU is not installed.
    NoQemu,
    /// There is no image at this place.
    NoImage(PathBuf),
    /// What reads the log of an image has not been built.
    NoDecoder,
    /// The file is not an image: place, and why.
    NotAnImage(PathBuf, String),
    /// A boot argument contains blanks.
    Argument(String),
    /// The flash file, or the folder for the control socket.
    File(PathBuf, std::io::Error),
    /// QEMU could not be started.
    Start(std::io::Error),
    /// QEMU has ended: how, and what it said.
    Ended(ExitStatus, String),
    /// The control socket.
    Control(String),
}

impl fmt::Display for EmulatorError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoQemu => write!(f, "{QEMU} is missing: apt-get install qemu-system-misc"),
            Self::NoImage(path) => write!(
                f,
                "the image {} is missing: cargo xtask image --board virt",
                path.display()
            ),
            Self::NoDecoder => write!(
                f,
                "the decoder of the board's log is missing: cargo xtask image --board virt"
            ),
            Self::NotAnImage(path, text) => {
                write!(f, "{} is not an image: {text}", path.display())
            }
            Self::Argument(key) => write!(f, "the boot argument {key} must not contain blanks"),
            Self::File(path, error) => write!(f, "{}: {error}", path.display()),
            Self::Start(error) => write!(f, "{QEMU} cannot be started: {error}"),
            Self::Ended(status, said) => {
                write!(f, "the emulator has ended with {status}")?;
                let meaning = match status.code() {
                    Some(2) => "the image does not understand its boot arguments",
                    Some(3) => "the image finds no network card",
                    Some(5) => "no slot of its flash holds a whole program",
                    Some(6) => "the boot stage failed",
                    _ => "",
                };
                for text in [meaning, said.trim()] {
                    if !text.is_empty() {
                        write!(f, ": {text}")?;
                    }
                }
                Ok(())
            }
            Self::Control(text) => write!(f, "the emulator's control socket: {text}"),
        }
    }
}

impl std::error::Error for EmulatorError {}

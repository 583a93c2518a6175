//! What an image says of itself, held against the board that it is to be for.

use std::fmt;

use crawler_bundle::BundleFault;
use crawler_release::{Chip, Kind, MAX_IMAGE};

/// The boards of this repository, as their `status` names them, each with its chip.
pub const BOARDS: [(&str, Chip); 5] = [
    ("xiao-c3", Chip::ESP32_C3),
    ("xiao-c6", Chip::ESP32_C6),
    ("xiao-s3-sense", Chip::ESP32_S3),
    ("virt", Chip::NONE),
    (SIMULATED, Chip::NONE),
];

/// The board of simulated robots.
const SIMULATED: &str = "sim";

/// The first byte of an image that a bootloader of Espressif starts (ESP-IDF, `esp_image_header_t`).
const ESP_MAGIC: u8 = 0xE9;
/// Where its header has the number of the chip, and where the header ends.
const ESP_CHIP: usize = 12;
const ESP_HEADER: usize = 24;
/// Most segments of such an image (ESP-IDF, `ESP_IMAGE_MAX_SEGMENTS`).
const ESP_SEGMENTS: u8 = 16;

/// Why an image cannot be one for a board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum ImageFault {
    /// There is nothing in it.
    Empty,
    /// It is larger than [`MAX_IMAGE`].
    TooLarge,
    /// The board has a chip of Espressif, and this is no image for one.
    NotEsp,
    /// It is for another chip: the one that it names, and the board's.
    OtherChip(Chip, Chip),
    /// It is for a chip of Espressif, and the board has none.
    Esp(Chip),
    /// It holds more than the program: bootloader, partition table, an ELF file.
    NotUpdate(&'static str),
    /// The board is a simulated one, and this is no bundle.
    NotBundle(BundleFault),
    /// It is a bundle, and the board runs machine code.
    Bundle,
    /// It names another version or build than the release does.
    OtherName(&'static str),
    /// The board is not known here, so that its chip has to be named.
    UnknownBoard,
}

impl fmt::Display for ImageFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Empty => f.write_str("the image is empty"),
            Self::TooLarge => write!(f, "the image has more than {MAX_IMAGE} bytes"),
            Self::NotEsp => f.write_str("not an image for an ESP32: it does not begin as one"),
            Self::OtherChip(image, board) => {
                write!(f, "the image is for {image}, the board has {board}")
            }
            Self::Esp(image) => {
                write!(f, "the image is for {image}, which the board does not have")
            }
            Self::NotUpdate(what) => write!(
                f,
                "{what}; an update is the image of the program alone (`-update.bin`)"
            ),
            Self::NotBundle(fault) => write!(
                f,
                "not an image for simulated robots (`release bundle` makes one): {fault}"
            ),
            Self::Bundle => f.write_str("the image is a bundle, for simulated robots (board sim)"),
            Self::OtherName(what) => {
                write!(f, "the image names another {what} than the release")
            }
            Self::UnknownBoard => {
                f.write_str("nobody here knows the board: name its chip (--chip)")
            }
        }
    }
}

impl std::error::Error for ImageFault {}

/// The chip that an image of Espressif names; `None` for any other image.
#[must_use]
pub fn chip_of(image: &[u8]) -> Option<Chip> {
    let header = image.get(..ESP_HEADER)?;
    if header[0] != ESP_MAGIC || !(1..=ESP_SEGMENTS).contains(&header[1]) {
        return None;
    }
    Some(Chip(u16::from_le_bytes([
        header[ESP_CHIP],
        header[ESP_CHIP + 1],
    ])))
}

/// The chip that a release of `image` for `board` is for, once it is sure that the one can be for the other.
/// `named` is what somebody says that it is.
///
/// # Errors
/// [`ImageFault`] says why it cannot be.
pub fn chip_for(
    kind: Kind,
    board: &str,
    named: Option<Chip>,
    image: &[u8],
) -> Result<Chip, ImageFault> {
    if image.is_empty() {
        return Err(ImageFault::Empty);
    }
    if image.len() > MAX_IMAGE as usize {
        return Err(ImageFault::TooLarge);
    }
    let known = BOARDS.iter().find(|(name, _)| *name == board);
    let known = known.map(|(_, chip)| *chip);
    let own = chip_of(image);
    let chip = match (named, known) {
        (Some(named), Some(known)) if named != known => {
            return Err(ImageFault::OtherChip(named, known));
        }
        (Some(chip), _) | (None, Some(chip)) => chip,
        (None, None) => match (kind, own) {
            (Kind::Program, Some(chip)) => chip,
            _ => return Err(ImageFault::UnknownBoard),
        },
    };
    if kind != Kind::Program {
        return Ok(chip);
    }
    if board == SIMULATED {
        let bundle = crawler_bundle::decode(image);
        return bundle.map(|_| chip).map_err(ImageFault::NotBundle);
    }
    match own {
        _ if image.starts_with(&crawler_bundle::MAGIC) => Err(ImageFault::Bundle),
        _ if image.starts_with(b"\x7FELF") => Err(ImageFault::NotUpdate("this is an ELF file")),
        Some(own) if own == chip => Ok(chip),
        Some(own) if chip == Chip::NONE => Err(ImageFault::Esp(own)),
        Some(own) => Err(ImageFault::OtherChip(own, chip)),
        None if chip == Chip::NONE => Ok(chip),
        None => Err(ImageFault::NotEsp),
    }
}

/// Whether a bundle names the version and the build that its release does, by which robots are told apart.
///
/// # Errors
/// [`ImageFault::OtherName`] says what differs. An image that is no bundle names nothing.
pub(super) fn check_names(
    image: &[u8],
    version: &str,
    build: Option<&str>,
) -> Result<(), ImageFault> {
    let Ok(bundle) = crawler_bundle::decode(image) else {
        return Ok(());
    };
    if bundle.version != version {
        return Err(ImageFault::OtherName("version"));
    }
    if build.is_some_and(|build| build != bundle.build) {
        return Err(ImageFault::OtherName("build"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use crawler_bundle::{Bundle, BundleFault};

    use super::*;

    fn esp(chip: u16) -> Vec<u8> {
        let mut image = vec![0; 64];
        (image[0], image[1]) = (ESP_MAGIC, 4);
        image[12..14].copy_from_slice(&chip.to_le_bytes());
        image
    }

    #[test]
    fn an_image_is_for_its_board() {
        let other = |image, board| Err(ImageFault::OtherChip(image, board));
        let large = vec![0; MAX_IMAGE as usize + 1];
        let (c3, c6) = (Chip::ESP32_C3, Chip::ESP32_C6);
        let bundle = Bundle::new("1", "b").image(1_000, 0).expect("a bundle");
        for (board, named, image, expected) in [
            ("xiao-c3", None, &esp(5)[..], Ok(c3)),
            ("xiao-c3", Some(c3), &esp(5), Ok(c3)),
            ("xiao-c3", Some(c6), &esp(5), other(c6, c3)),
            ("xiao-c3", None, &esp(13), other(c6, c3)),
            ("xiao-c3", None, b"text", Err(ImageFault::NotEsp)),
            ("xiao-c3", None, &esp(5)[..20], Err(ImageFault::NotEsp)),
            ("virt", None, b"machine code", Ok(Chip::NONE)),
            ("virt", None, &esp(5), Err(ImageFault::Esp(c3))),
            (
                "virt",
                None,
                b"\x7FELF",
                Err(ImageFault::NotUpdate("this is an ELF file")),
            ),
            ("mine", None, &esp(13), Ok(c6)),
            ("mine", Some(Chip(2)), &esp(2), Ok(Chip(2))),
            ("mine", None, b"text", Err(ImageFault::UnknownBoard)),
            ("mine", Some(Chip::NONE), b"text", Ok(Chip::NONE)),
            ("sim", None, b"", Err(ImageFault::Empty)),
            ("sim", None, &large, Err(ImageFault::TooLarge)),
            ("sim", None, &bundle, Ok(Chip::NONE)),
            (
                "sim",
                None,
                &bundle[1..],
                Err(ImageFault::NotBundle(BundleFault::NotBundle)),
            ),
            (
                "sim",
                None,
                &bundle[..900],
                Err(ImageFault::NotBundle(BundleFault::Short)),
            ),
            ("virt", None, &bundle, Err(ImageFault::Bundle)),
            ("xiao-c3", None, &bundle, Err(ImageFault::Bundle)),
        ] {
            let came = chip_for(Kind::Program, board, named, image);
            assert_eq!(came, expected, "{board} {named:?}");
        }
        // A model is data to every chip.
        for kind in [Kind::Model, Kind::Policy] {
            assert_eq!(chip_for(kind, "xiao-c3", None, b"weights"), Ok(c3));
        }
    }

    #[test]
    fn a_bundle_names_what_its_release_does() {
        let bundle = Bundle::new("1.2", "b").image(1_000, 0).expect("a bundle");
        let differs = |what| Err(ImageFault::OtherName(what));
        assert_eq!(check_names(&bundle, "1.2", Some("b")), Ok(()));
        assert_eq!(check_names(&bundle, "1.2", None), Ok(()));
        assert_eq!(check_names(&bundle, "1.3", Some("b")), differs("version"));
        assert_eq!(check_names(&bundle, "1.2", Some("c")), differs("build"));
        assert_eq!(check_names(b"machine code", "1.3", Some("c")), Ok(()));
    }
}

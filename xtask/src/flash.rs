//! Onto a board that is plugged in, and what it has to say.

use crate::boards::Board;
use crate::image;
use crate::run::{self, Failure, Outcome};

const USAGE: &str =
    "cargo xtask flash --board esp32s3|esp32c3|esp32c6 [--port PORT] [--release-key FILE]";

/// Builds, flashes with `espflash`, and shows the log until Ctrl-C.
///
/// Settings and parameters of the robot survive; the new program starts from the first slot.
///
/// # Errors
/// When an argument is unknown, no compiler or no espflash is here, or flashing fails.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    let (arguments, keys) = image::split_keys(arguments);
    let (board, port) = parse(&arguments)?;
    let Some(flash) = &board.flash else {
        return Err(Failure(format!(
            "{} has no flash to write: `cargo xtask emulate` runs it",
            board.name
        )));
    };
    if run::output("espflash", &["--version"]).is_none() {
        return Err(Failure(
            "espflash is missing: cargo install espflash --locked".to_owned(),
        ));
    }
    let elf = image::build(board, board.binary)?;
    let elf = image::with_keys(board, elf, &keys)?;
    let table = image::table(flash);
    let mut all = vec![
        "flash",
        "--chip",
        board.name,
        "--flash-size",
        flash.size,
        "--partition-table",
        path(&table)?,
        // The bootloader starts ota_0 while otadata is blank.
        "--target-app-partition",
        "ota_0",
        "--erase-parts",
        "otadata",
        "--monitor",
        "--log-format",
        "defmt",
    ];
    if let Some(port) = port {
        all.extend(["--port", port]);
    }
    all.push(path(&elf)?);
    run::replace_with(
        std::path::Path::new("espflash"),
        all.into_iter().map(str::to_owned),
    )
}

fn path(path: &std::path::Path) -> Outcome<&str> {
    path.to_str()
        .ok_or_else(|| Failure(format!("{} is not UTF-8", path.display())))
}

fn parse(arguments: &[String]) -> Outcome<(&'static Board, Option<&str>)> {
    let mut board = None;
    let mut port = None;
    for pair in arguments.chunks(2) {
        match pair {
            [option, name] if option == "--board" => board = Some(Board::named(name)?),
            [option, name] if option == "--port" => port = Some(name.as_str()),
            _ => return Err(Failure(USAGE.to_owned())),
        }
    }
    Ok((board.ok_or_else(|| Failure(USAGE.to_owned()))?, port))
}

#[cfg(test)]
mod tests {
    use super::parse;

    #[test]
    fn a_board_is_needed_and_a_port_may_follow() {
        let words =
            |text: &str| -> Vec<String> { text.split_whitespace().map(str::to_owned).collect() };
        let both = words("--board esp32c3 --port /dev/ttyACM0");
        let (board, port) = parse(&both).expect("both");
        assert_eq!((board.name, port), ("esp32c3", Some("/dev/ttyACM0")));
        for wrong in ["", "--port x", "--board", "--board x", "esp32c3"] {
            assert!(parse(&words(wrong)).is_err(), "{wrong}");
        }
    }
}

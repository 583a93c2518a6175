//! Building a board's program, and packing it for flash.

use std::path::{Path, PathBuf};

use crate::boards::{self, Board, Flash};
use crate::cross;
use crate::run::{self, Failure, Outcome};

/// `cargo xtask image --board NAME`, or several.
///
/// # Errors
/// When an argument is unknown, no compiler is here, or the build fails.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    let boards = requested(arguments)?;
    if boards.is_empty() {
        let names = boards::ALL.map(|board| board.name).join("|");
        return Err(Failure(format!("cargo xtask image --board {names}")));
    }
    boards.into_iter().try_for_each(image)
}

/// The boards named by `--board`.
///
/// # Errors
/// On any other argument.
pub(crate) fn requested(arguments: &[String]) -> Outcome<Vec<&'static Board>> {
    arguments
        .chunks(2)
        .map(|pair| match pair {
            [option, name] if option == "--board" => Board::named(name),
            [option, ..] => Err(Failure(format!("unknown, or without a value: {option}"))),
            [] => unreachable!("chunks are not empty"),
        })
        .collect()
}

/// Builds `board` and packs what has to be packed.
///
/// # Errors
/// When no compiler is here, the build fails, or the program does not fit its slot.
pub(crate) fn image(board: &Board) -> Outcome {
    let elf = build(board, board.binary)?;
    match &board.flash {
        None => {
            println!("{}", elf.display());
            tool("log", "build", &[])
        }
        Some(flash) => pack(board, flash, &elf),
    }
}

/// Builds one program of the board's workspace; its path.
///
/// # Errors
/// When no compiler is here, or the build fails.
pub(crate) fn build(board: &Board, binary: &str) -> Outcome<PathBuf> {
    let mut command = cross::compiler(board)?.cargo(board, "build");
    command.args(["--bin", binary]);
    run::run_command(command)?;
    Ok(board.elf(binary))
}

fn pack(board: &Board, flash: &Flash, elf: &Path) -> Outcome {
    crawler_image(&[
        "pack",
        "--chip",
        board.name,
        "--flash",
        flash.size,
        "--partitions",
        &table(flash).to_string_lossy(),
        "--elf",
        &elf.to_string_lossy(),
        "--merged",
        &board.merged_image().to_string_lossy(),
        "--update",
        &board.update_image().to_string_lossy(),
    ])
}

/// The partition table of a flash.
pub(crate) fn table(flash: &Flash) -> PathBuf {
    boards::folder().join(flash.partitions)
}

/// Calls `firmware/boards/image`, which has espflash's dependencies to itself.
///
/// # Errors
/// When it cannot be built, or fails.
pub(crate) fn crawler_image(arguments: &[&str]) -> Outcome {
    tool("image", "run", &[&["--"], arguments].concat())
}

/// Has cargo do `what` with a program for this machine that has a workspace of its own below
/// `firmware/boards`.
///
/// # Errors
/// When it cannot be built, or fails.
pub(crate) fn tool(workspace: &str, what: &str, arguments: &[&str]) -> Outcome {
    let manifest = boards::manifest(workspace);
    let target = boards::target_dir();
    let target = target.to_string_lossy();
    let place = [
        what,
        "--locked",
        "--quiet",
        "--manifest-path",
        &manifest,
        "--target-dir",
        &target,
    ];
    run::cargo(&[&place, arguments].concat())
}

#[cfg(test)]
mod tests {
    use super::requested;

    #[test]
    fn boards_are_asked_for_by_name() {
        let asked = |words: &[&str]| {
            let words: Vec<String> = words.iter().map(|word| (*word).to_owned()).collect();
            requested(&words).map(|boards| boards.len())
        };
        assert_eq!(asked(&[]).expect("none"), 0);
        assert_eq!(
            asked(&["--board", "virt", "--board", "esp32c3"]).expect("two"),
            2
        );
        for wrong in [
            &["--board"][..],
            &["virt"],
            &["--board", "toaster"],
            &["--port", "x"],
        ] {
            assert!(asked(wrong).is_err(), "{wrong:?}");
        }
    }
}

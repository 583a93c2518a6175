//! Building a board's program, and packing it for flash.

use std::path::{Path, PathBuf};

use crate::boards::{self, BOOT_STAGE, Board, Flash, VIRT};
use crate::cross;
use crate::run::{self, Failure, Outcome};

/// `cargo xtask image --board NAME [--release-key FILE]`, or several of either.
///
/// # Errors
/// When an argument is unknown, no compiler is here, or the build fails.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    let (boards, keys) = split_keys(arguments);
    let boards = requested(&boards)?;
    if boards.is_empty() {
        let names = boards::ALL.map(|board| board.name).join("|");
        return Err(Failure(format!(
            "cargo xtask image --board {names} [--release-key FILE]"
        )));
    }
    boards
        .into_iter()
        .try_for_each(|board| image_with(board, &keys))
}

/// The arguments without the files named by `--release-key`, and these.
pub(crate) fn split_keys(arguments: &[String]) -> (Vec<String>, Vec<String>) {
    let mut keys = Vec::new();
    let mut others = Vec::new();
    for pair in arguments.chunks(2) {
        match pair {
            [option, file] if option == "--release-key" => keys.push(file.clone()),
            other => others.extend_from_slice(other),
        }
    }
    (others, keys)
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

/// Builds `board` and packs what has to be packed. It takes no releases.
///
/// # Errors
/// When no compiler is here, the build fails, or the program does not fit its slot.
pub(crate) fn image(board: &Board) -> Outcome {
    image_with(board, &[])
}

/// Builds `board`, for releases signed with one of these keys, and packs what has to be packed.
fn image_with(board: &Board, keys: &[String]) -> Outcome {
    let elf = with_keys(board, build(board, board.binary)?, keys)?;
    match &board.flash {
        None => {
            println!("{}", elf.display());
            if board.binary == VIRT.binary {
                println!("{}", build(&BOOT_STAGE, BOOT_STAGE.binary)?.display());
                crawler_image(&[
                    "slot",
                    "--elf",
                    &elf.to_string_lossy(),
                    "--update",
                    &board.update_image().to_string_lossy(),
                ])?;
            }
            tool("log", "build", &[])
        }
        Some(flash) => pack(board, flash, &elf),
    }
}

/// The program with these release keys written into it: `elf` itself when there are none.
///
/// # Errors
/// When a file holds no public key, or the program cannot take so many.
pub(crate) fn with_keys(board: &Board, elf: PathBuf, keys: &[String]) -> Outcome<PathBuf> {
    if keys.is_empty() {
        return Ok(elf);
    }
    let keyed = board.keyed_elf();
    let (from, to) = (elf.to_string_lossy(), keyed.to_string_lossy());
    let mut words = vec!["keys", "--elf", &from, "--out", &to];
    for key in keys {
        words.extend(["--release-key", key]);
    }
    crawler_image(&words)?;
    Ok(keyed)
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
    use super::{requested, split_keys};

    #[test]
    fn release_keys_are_files() {
        let words = [
            "--board",
            "virt",
            "--release-key",
            "a.pem",
            "--release-key",
            "b.pem",
        ];
        let (others, keys) = split_keys(&words.map(str::to_owned));
        assert_eq!(others, ["--board", "virt"]);
        assert_eq!(keys, ["a.pem", "b.pem"]);
        let (others, keys) = split_keys(&["--release-key".to_owned()]);
        assert_eq!((others.len(), keys.len()), (1, 0));
    }

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

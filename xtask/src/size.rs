//! What images take, held against `firmware/boards/budgets.toml`.

use std::fs;

use crate::boards::{self, BOOT_STAGE, Board, C3, C6, PROGRAM, VIRT};
use crate::image;
use crate::run::Outcome;

/// `cargo xtask size [--board NAME]…`: builds the boards named, or those that every machine can
/// build, and prints what they take.
///
/// # Errors
/// When a build fails, or an image is past its budget.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    let mut boards = image::requested(arguments)?;
    if boards.is_empty() {
        boards = vec![&PROGRAM, &VIRT, &BOOT_STAGE, &C3, &C6];
    }
    let mut words = vec![
        "size".to_owned(),
        "--budgets".to_owned(),
        text(&boards::folder().join("budgets.toml")),
    ];
    for board in boards {
        image::image(board)?;
        weigh(board, &mut words);
    }
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    image::crawler_image(&words)
}

fn weigh(board: &Board, words: &mut Vec<String>) {
    words.extend(["--image".to_owned(), board.name.to_owned()]);
    words.push(text(&board.elf(board.binary)));
    if let Some(note) = stacks_used(&board.elf(board.binary)) {
        words.push("--stack".to_owned());
        words.extend(note.split_whitespace().map(str::to_owned));
    }
    if let Some(flash) = &board.flash {
        words.extend([
            "--slot".to_owned(),
            text(&board.update_image()),
            text(&image::table(flash)),
            flash.size.to_owned(),
        ]);
    }
}

/// The deepest stacks of tasks and of control, where a test that ran just this program left a note beside it.
fn stacks_used(elf: &std::path::Path) -> Option<String> {
    let note = elf.with_extension("stack");
    let when = |path: &std::path::Path| fs::metadata(path).and_then(|file| file.modified()).ok();
    if when(&note)? < when(elf)? {
        return None;
    }
    fs::read_to_string(&note).ok()
}

fn text(path: &std::path::Path) -> String {
    path.to_string_lossy().into_owned()
}

//! A `terracrawler` of an earlier commit beside the one of today: its robots at our server, and ours at its.

use std::path::PathBuf;

use crate::run::{self, Failure, Outcome};

/// The last commit whose robots and servers know nothing of updates.
const COMMIT: &str = "9615e8842c2e7e839e0943f0de7dff6069583401";
/// Where it is checked out, below the directory of what is built.
const FOLDER: &str = "earlier";

/// Builds both, and has them meet. Skips where the history of this clone does not go back as far.
///
/// # Errors
/// When one cannot be built, or they do not understand each other.
pub(crate) fn step() -> Outcome {
    let root = text(run::root())?;
    let commit = format!("{COMMIT}^{{commit}}");
    if run::output("git", &["-C", &root, "cat-file", "-e", &commit]).is_none() {
        println!("skipped: this clone does not have commit {COMMIT} (git fetch --unshallow)");
        return Ok(());
    }
    let earlier = check_out()?;
    run::build_beside_tests(&["--bin", "terracrawler", "--example", "mixed_versions"])?;
    let built = run::root().join(run::target_dir()).join("debug/examples");
    let meeting = text(built.join("mixed_versions"))?;
    let program = text(earlier.join("target/debug/terracrawler"))?;
    run::run(&run::root(), &meeting, &[program])
}

/// The folder with the earlier program, built. What was built of it before is taken again.
fn check_out() -> Outcome<PathBuf> {
    let folder = run::root().join(run::target_dir()).join(FOLDER);
    let root = run::root();
    if !folder.join("Cargo.toml").is_file() {
        // One that somebody has removed by hand is still on git's list.
        run::run(&root, "git", &["worktree", "prune"])?;
        let place = text(folder.clone())?;
        let words = [
            "worktree", "add", "--quiet", "--force", "--detach", &place, COMMIT,
        ];
        run::run(&root, "git", &words)?;
    }
    let line = "build --locked --quiet --workspace --all-features --bin terracrawler";
    let words: Vec<&str> = line.split(' ').collect();
    // Its own, whatever the one of today is built into.
    let target = text(folder.join("target"))?;
    let own = [("CARGO_TARGET_DIR", target.as_str())];
    run::run_with_env(&folder, &run::cargo_program(), &words, &own)?;
    Ok(folder)
}

fn text(path: PathBuf) -> Outcome<String> {
    let path = path.into_os_string().into_string();
    path.map_err(|path| Failure(format!("{} cannot be written", path.display())))
}

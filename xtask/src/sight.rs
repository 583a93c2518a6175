//! What the detector sees on the emulated board, against what it sees on this machine.

use std::process::Command;

use crate::boards::VIRT;
use crate::counts;
use crate::image;
use crate::run::{self, Failure, Outcome};

/// What the program on the board said.
#[derive(Debug, Clone)]
pub(crate) struct Sight(String);

impl Sight {
    /// Builds the program and runs it in QEMU.
    ///
    /// # Errors
    /// When it cannot be built, or does not end well.
    pub(crate) fn on_board() -> Outcome<Self> {
        let elf = image::build(&VIRT, "sight")?;
        counts::emulate(&elf, "sight").map(Self)
    }

    /// All of its lines.
    pub(crate) fn text(&self) -> &str {
        &self.0
    }

    /// The number in its line `figure WHAT N`.
    pub(crate) fn figure(&self, what: &str) -> Option<u64> {
        self.0.lines().find_map(|line| {
            let mut words = line.trim().strip_prefix("figure ")?.split_whitespace();
            (words.next()? == what).then_some(())?;
            words.next()?.parse().ok()
        })
    }

    /// What is different from what this machine sees.
    ///
    /// # Errors
    /// When the program for this machine cannot be built or fails.
    pub(crate) fn differences(&self) -> Outcome<Vec<String>> {
        Ok(differences(&self.0, &on_host()?))
    }
}

/// What the same frames show on this machine.
fn on_host() -> Outcome<String> {
    run::build_beside_tests(&[])?;
    let folder = run::root().join(run::target_dir());
    let command = Command::new(folder.join("debug/examples/sight"));
    run::output_of(command)
        .ok_or_else(|| Failure("the example `sight` of crawler-board fails".to_owned()))
}

/// Lines about frames that only one side says. There is a complaint as well when there are none.
fn differences(board: &str, host: &str) -> Vec<String> {
    let seen = |text: &str| -> Vec<String> {
        text.lines()
            .map(str::trim)
            .filter(|line| line.starts_with("frame ") || line.starts_with("spot "))
            .map(str::to_owned)
            .collect()
    };
    let (board, host) = (seen(board), seen(host));
    if board.is_empty() || host.is_empty() {
        return vec!["the detector told of no frame".to_owned()];
    }
    let mut complaints = Vec::new();
    for line in &board {
        if !host.contains(line) {
            complaints.push(format!("only the board sees `{line}`"));
        }
    }
    for line in &host {
        if !board.contains(line) {
            complaints.push(format!("only the host sees `{line}`"));
        }
    }
    complaints
}

#[cfg(test)]
mod tests {
    use super::{Sight, differences};

    const SAID: &str = "frame black 00ff\r\nframe red 12ab\r\nspot red object 3f000000 3e800000 9\r\n\
        count vision_look 7\r\nfigure arena 4711\r\ndone\r\n";

    #[test]
    fn the_same_lines_are_no_difference() {
        let host = "frame black 00ff\nframe red 12ab\nspot red object 3f000000 3e800000 9\n";
        assert_eq!(differences(SAID, host), Vec::<String>::new());
    }

    #[test]
    fn any_other_line_is_one() {
        let other = SAID.replace("12ab", "12ac");
        assert_eq!(differences(SAID, &other).len(), 2);
        let spots = SAID.replace(" 9", " 8");
        assert_eq!(differences(&spots, SAID).len(), 2);
        let fewer = "frame black 00ff\nframe red 12ab\n";
        assert_eq!(differences(SAID, fewer).len(), 1);
        assert_eq!(differences(fewer, SAID).len(), 1);
        assert_eq!(differences("", "").len(), 1);
    }

    #[test]
    fn figures_are_found_by_name() {
        let sight = Sight(SAID.to_owned());
        assert_eq!(sight.figure("arena"), Some(4711));
        assert_eq!(sight.figure("frame"), None);
    }
}

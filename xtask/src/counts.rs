//! Instructions of what the robot program does again and again, against the committed table.
//!
//! QEMU with `-icount shift=0` executes one instruction per nanosecond of guest time, so the
//! figures are exact and the same in every run; only the compiler and the code change them.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use crate::boards::{self, VIRT};
use crate::counts_simulator;
use crate::cross::{self, Compiler};
use crate::files;
use crate::image;
use crate::run::{self, Failure, Outcome};
use crate::sight::Sight;
use crate::tools;

/// A rise beyond this must be explained in a commit.
const TOLERANCE_PERCENT: u64 = 5;

/// It takes under a second on a quiet machine.
const LIMIT: Duration = Duration::from_mins(3);

/// One line of the table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Count {
    pub(crate) name: String,
    pub(crate) instructions: u64,
    /// What it may never exceed.
    pub(crate) limit: Option<u64>,
}

/// Where figures stand in a row. std as it is delivered is optimised for speed, std built with the
/// board for size like the rest: soft floats differ by a tenth, so each has its own figures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Column {
    /// std of rustup's target.
    Delivered = 2,
    /// std from source.
    Source = 3,
}

impl Column {
    fn of(compiler: &Compiler) -> Self {
        match compiler {
            Compiler::Source(_) => Self::Source,
            Compiler::Stock | Compiler::Espressif(_) => Self::Delivered,
        }
    }

    /// What the line about the compiler begins with.
    const fn label(self) -> &'static str {
        match self {
            Self::Delivered => "- delivered std: ",
            Self::Source => "- std from source: ",
        }
    }
}

fn table_file() -> PathBuf {
    run::root().join("docs/counts.md")
}

/// `cargo xtask counts [--simulator] [--update]`
///
/// # Errors
/// When QEMU or a compiler is missing, the program fails, or a figure rose by more than 5 %.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        [] => board(false),
        ["--update"] => board(true),
        ["--simulator"] => counts_simulator::command(false),
        ["--simulator", "--update"] => counts_simulator::command(true),
        _ => Err(Failure(
            "cargo xtask counts [--simulator] [--update]".to_owned(),
        )),
    }
}

/// What the robot program executes, on the emulated board.
fn board(update: bool) -> Outcome {
    tools::QEMU.require()?;
    let compiler = cross::compiler(&VIRT)?;
    let column = Column::of(&compiler);
    let compiler = compiler.version();
    let elf = image::build(&VIRT, "counts")?;
    let sight = Sight::on_board()?;
    let mut measured = Vec::new();
    for text in [&emulate(&elf, "counts")?, sight.text()] {
        let counts = read_lines(text);
        if counts.is_empty() {
            return Err(Failure(format!("QEMU printed no counts, but:\n{text}")));
        }
        measured.extend(counts);
    }
    let path = table_file();
    let text = fs::read_to_string(&path)
        .map_err(|error| Failure(format!("{}: {error}", path.display())))?;
    println!("{compiler}");
    if update {
        return files::write(&path, &rewritten(&text, &measured, column, &compiler));
    }
    let (report, mut complaints) = compare(&read_table(&text, column), &measured);
    print!("{report}");
    complaints.extend(sight.differences()?);
    if complaints.is_empty() {
        Ok(())
    } else {
        Err(Failure(format!(
            "{}\nIf that is meant: `cargo xtask counts --update`, and the reason in the commit.",
            complaints.join("\n")
        )))
    }
}

/// Runs a program in QEMU and returns what it says. Its lines `count NAME INSTRUCTIONS` are exact.
///
/// # Errors
/// When it does not end well within three minutes.
pub(crate) fn emulate(elf: &Path, name: &str) -> Outcome<String> {
    let serial = boards::target_dir().join(format!("{name}.txt"));
    // What an earlier run left must not be taken for this one.
    files::write(&serial, "")?;
    let mut qemu = Command::new(tools::QEMU.program);
    qemu.args(["-M", "virt", "-smp", "1", "-m", "32M", "-bios", "none"])
        .arg("-kernel")
        .arg(elf)
        .args(["-display", "none", "-monitor", "none", "-no-reboot"])
        .args(["-icount", "shift=0", "-serial"])
        .arg(format!("file:{}", serial.display()));
    let done = run::within(qemu, LIMIT);
    let bytes =
        fs::read(&serial).map_err(|error| Failure(format!("{}: {error}", serial.display())))?;
    let text = String::from_utf8_lossy(&bytes).into_owned();
    if done {
        Ok(text)
    } else {
        Err(Failure(format!(
            "the program in QEMU did not end well; it said:\n{text}"
        )))
    }
}

/// The count called `name` in what a program said.
pub(crate) fn count_of(text: &str, name: &str) -> Option<u64> {
    let counts = read_lines(text);
    let count = counts.iter().find(|count| count.name == name)?;
    Some(count.instructions)
}

fn read_lines(text: &str) -> Vec<Count> {
    text.lines()
        .filter_map(|line| {
            let mut words = line.trim().strip_prefix("count ")?.split_whitespace();
            Some(Count {
                name: words.next()?.to_owned(),
                instructions: words.next()?.parse().ok()?,
                limit: None,
            })
        })
        .collect()
}

/// Rows of the form ``| `name` | 1,234 | 1,345 | 20,000 | … |``: both columns, limit, words.
pub(crate) fn read_table(text: &str, column: Column) -> Vec<Count> {
    text.lines()
        .filter_map(|line| read_row(line, column))
        .collect()
}

fn read_row(line: &str, column: Column) -> Option<Count> {
    let cells: Vec<&str> = line.split('|').map(str::trim).collect();
    let name = cells.get(1)?.strip_prefix('`')?.strip_suffix('`')?;
    let number = |at: usize| cells.get(at)?.replace(',', "").parse().ok();
    Some(Count {
        name: name.to_owned(),
        // A figure that is missing is exceeded by any.
        instructions: number(column as usize).unwrap_or(0),
        limit: number(4),
    })
}

/// The comparison as text, and what must not pass.
pub(crate) fn compare(committed: &[Count], measured: &[Count]) -> (String, Vec<String>) {
    let mut report = String::new();
    let mut complaints = Vec::new();
    for old in committed {
        let Some(new) = measured.iter().find(|new| new.name == old.name) else {
            complaints.push(format!("{}: in the table, but not measured", old.name));
            continue;
        };
        let (was, is) = (old.instructions, new.instructions);
        let change = (is as f64 / was.max(1) as f64 - 1.0) * 100.0;
        // Writing to a string cannot fail.
        let _ = writeln!(
            report,
            "{:<28} {was:>9} -> {is:>9}  {change:+.1} %",
            old.name
        );
        if is * 100 > was * (100 + TOLERANCE_PERCENT) {
            complaints.push(format!(
                "{}: {was} -> {is} instructions, {change:+.1} %",
                old.name
            ));
        }
        if let Some(limit) = old.limit
            && is > limit
        {
            complaints.push(format!("{}: {is} instructions, limit {limit}", old.name));
        }
    }
    for new in measured {
        if !committed.iter().any(|old| old.name == new.name) {
            complaints.push(format!("{}: measured, but not in the table", new.name));
        }
    }
    (report, complaints)
}

/// The document with its figures replaced; new ones get a row behind the last.
pub(crate) fn rewritten(text: &str, measured: &[Count], column: Column, compiler: &str) -> String {
    let mut lines: Vec<String> = Vec::new();
    let mut last_row = None;
    let mut known = Vec::new();
    for line in text.lines() {
        if line.starts_with(column.label()) {
            lines.push(format!("{}{compiler}", column.label()));
        } else if let Some(old) = read_row(line, column) {
            let Some(new) = measured.iter().find(|new| new.name == old.name) else {
                continue;
            };
            let figure = format!(" {} ", grouped(new.instructions));
            let mut cells: Vec<&str> = line.split('|').collect();
            if let Some(cell) = cells.get_mut(column as usize) {
                *cell = &figure;
            }
            lines.push(cells.join("|"));
            known.push(&new.name);
            last_row = Some(lines.len());
        } else {
            if line.starts_with("|---") {
                last_row = Some(lines.len() + 1);
            }
            lines.push(line.to_owned());
        }
    }
    let place = last_row.unwrap_or(lines.len());
    let added = measured
        .iter()
        .filter(|new| !known.contains(&&new.name))
        .map(|new| {
            let figure = grouped(new.instructions);
            let (delivered, source) = match column {
                Column::Delivered => (figure.as_str(), ""),
                Column::Source => ("", figure.as_str()),
            };
            format!("| `{}` | {delivered} | {source} | | |", new.name)
        });
    lines.splice(place..place, added);
    lines.join("\n") + "\n"
}

/// 12,345
fn grouped(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::{Column, Count, compare, grouped, read_lines, read_table, rewritten};

    const TABLE: &str = "# Counts\n\n- delivered std: rustc 1\n- std from source: rustc 1\n\n\
        | what | delivered | source | limit | means |\n|---|---:|---:|---:|---|\n\
        | `control` | 10,000 | 11,000 | 20,000 | one step |\n\
        | `sense` | 1,000 | 1,100 | | one ping |\n\nEnd.\n";

    fn counts(values: &[(&str, u64)]) -> Vec<Count> {
        values
            .iter()
            .map(|(name, instructions)| Count {
                name: (*name).to_owned(),
                instructions: *instructions,
                limit: None,
            })
            .collect()
    }

    fn complaints(values: &[(&str, u64)]) -> Vec<String> {
        compare(&read_table(TABLE, Column::Delivered), &counts(values)).1
    }

    #[test]
    fn a_table_is_read_with_its_limits() {
        let table = read_table(TABLE, Column::Delivered);
        assert_eq!(table.len(), 2);
        assert_eq!(table[0].limit, Some(20_000));
        assert_eq!(table[1].instructions, 1000);
        assert_eq!(table[1].limit, None);
        let source = read_table(TABLE, Column::Source);
        assert_eq!(
            (source[0].instructions, source[0].limit),
            (11_000, Some(20_000))
        );
    }

    #[test]
    fn five_percent_pass_and_one_instruction_more_does_not() {
        assert!(complaints(&[("control", 10_500), ("sense", 1)]).is_empty());
        assert_eq!(complaints(&[("control", 10_501), ("sense", 1)]).len(), 1);
    }

    #[test]
    fn a_limit_holds_whatever_the_table_says() {
        let table = TABLE.replace("10,000", "19,900");
        let (_, complaints) = compare(
            &read_table(&table, Column::Delivered),
            &counts(&[("control", 20_001), ("sense", 1000)]),
        );
        assert_eq!(complaints, ["control: 20001 instructions, limit 20000"]);
    }

    #[test]
    fn table_and_program_name_the_same() {
        assert_eq!(complaints(&[("control", 1)]).len(), 1);
        assert_eq!(
            complaints(&[("control", 1), ("sense", 1), ("link", 1)]).len(),
            1
        );
    }

    #[test]
    fn an_update_keeps_the_words_and_passes_afterwards() {
        let new = counts(&[("control", 12_345), ("link", 7)]);
        for (column, row, other) in [
            (
                Column::Delivered,
                "| `control` | 12,345 | 11,000 | 20,000 | one step |",
                Column::Source,
            ),
            (
                Column::Source,
                "| `control` | 10,000 | 12,345 | 20,000 | one step |",
                Column::Delivered,
            ),
        ] {
            let text = rewritten(TABLE, &new, column, "rustc 2");
            assert!(text.contains(row), "{text}");
            assert!(
                text.contains(&format!("{}rustc 2", column.label())),
                "{text}"
            );
            assert!(
                text.contains(&format!("{}rustc 1", other.label())),
                "{text}"
            );
            assert!(text.starts_with("# Counts\n") && text.ends_with("\nEnd.\n"));
            assert!(!text.contains("sense"), "{text}");
            assert!(compare(&read_table(&text, column), &new).1.is_empty());
            // A figure that the other compiler still owes does not pass there.
            assert!(!compare(&read_table(&text, other), &new).1.is_empty());
            assert_eq!(rewritten(&text, &new, column, "rustc 2"), text);
        }
    }

    #[test]
    fn only_whole_lines_of_the_program_count() {
        let text = "boot\r\ncount control 12\r\ncount sense\ncount x y\ncount a 3 b\n";
        assert_eq!(read_lines(text).len(), 2);
    }

    #[test]
    fn thousands_are_grouped() {
        for (number, text) in [
            (0, "0"),
            (999, "999"),
            (1000, "1,000"),
            (1_234_567, "1,234,567"),
        ] {
            assert_eq!(grouped(number), text);
        }
    }
}

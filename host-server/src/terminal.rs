//! Passwords from a person or from a pipe, and never from an argument: the list of processes shows
//! those to everybody.

use crawler_system::cli_error::{CliError, OrSay as _};
use std::io::{self, BufRead as _, IsTerminal as _, Write as _};

use rustix::termios::{
    LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcsetattr,
};

/// What Ctrl-C sends.
const CONTROL_C: u8 = 3;
/// A line longer than this is no password. Longer than any that is accepted, so the rules of
/// passwords say what is wrong with it.
const LONGEST: u64 = 4_096;

/// A password for `whom`: typed twice at a terminal, or the first line of standard input.
pub(crate) fn new_password(whom: &str) -> Result<String, CliError> {
    if !io::stdin().is_terminal() {
        return read_line(io::stdin().lock());
    }
    let first = ask(&format!("New password of {whom}: "))?;
    let second = ask("Once more: ")?;
    if first != second {
        return Err(CliError::new(
            "the two are not the same; nothing was changed",
        ));
    }
    Ok(first)
}

/// The password of `whom`: typed at a terminal, or the first line of standard input.
pub(crate) fn password_of(whom: &str) -> Result<String, CliError> {
    if !io::stdin().is_terminal() {
        return read_line(io::stdin().lock());
    }
    ask(&format!("Password of {whom}: "))
}

fn ask(question: &str) -> Result<String, CliError> {
    let failed = |error: &io::Error| format!("cannot ask: {error}");
    // The question goes where it does not mix with what a script reads.
    let mut errors = io::stderr();
    write!(errors, "{question}")
        .and_then(|()| errors.flush())
        .or_say(failed)?;
    let silence = Silence::new().or_say(failed)?;
    let answer = read_line(io::stdin().lock());
    drop(silence);
    let _ = writeln!(errors);
    answer.and_then(|line| {
        if line.as_bytes().contains(&CONTROL_C) {
            return Err(CliError::new("given up; nothing was changed"));
        }
        Ok(line)
    })
}

fn read_line(input: impl io::BufRead) -> Result<String, CliError> {
    let mut line = Vec::new();
    input
        .take(LONGEST)
        .read_until(b'\n', &mut line)
        .or_say(|error| format!("cannot read the password: {error}"))?;
    if line.is_empty() {
        return Err(CliError::new("no password came"));
    }
    if line.last() == Some(&b'\n') {
        line.pop();
        if line.last() == Some(&b'\r') {
            line.pop();
        }
    }
    String::from_utf8(line).or_say(|_| "the password is not UTF-8".to_owned())
}

/// The terminal shows nothing of what is typed while this lives.
struct Silence(Termios);

impl Silence {
    fn new() -> io::Result<Self> {
        let before = tcgetattr(io::stdin())?;
        let mut quiet = before.clone();
        quiet.local_modes.remove(LocalModes::ECHO);
        quiet.local_modes.insert(LocalModes::ICANON);
        // Ctrl-C would end the process with the terminal still silent, so here it ends the line.
        quiet.local_modes.remove(LocalModes::ISIG);
        quiet.special_codes[SpecialCodeIndex::VEOL] = CONTROL_C;
        tcsetattr(io::stdin(), OptionalActions::Flush, &quiet)?;
        Ok(Self(before))
    }
}

impl Drop for Silence {
    fn drop(&mut self) {
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, &self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_line_without_its_end() {
        for (input, password) in [
            (&b"correct horse\nbattery\n"[..], "correct horse"),
            (b"correct horse\r\n", "correct horse"),
            (b"correct horse", "correct horse"),
            (b"  spaces count  \n", "  spaces count  "),
            (b"\n", ""),
        ] {
            assert_eq!(read_line(input).expect("a line"), password);
        }
        assert!(read_line(&b""[..]).is_err());
        assert!(read_line(&b"\xff\xfe\n"[..]).is_err());
        let endless = vec![b'x'; 100_000];
        let read = read_line(&endless[..]).expect("cut off");
        assert_eq!(read.len() as u64, LONGEST);
    }
}

//! Command lines as a shell takes them apart, as far as the documentation uses one.

/// One program and what it is called with. Where its output goes is left out.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Simple {
    /// Variables that are set for it alone.
    pub(crate) variables: Vec<(String, String)>,
    /// The program first. A substitution `$(…)` stands as it is written.
    pub(crate) words: Vec<String>,
}

impl Simple {
    /// Whether it is this program.
    pub(crate) fn calls(&self, program: &str) -> bool {
        self.words.first().is_some_and(|word| word == program)
    }
}

/// The text ends within a word, or behind an operator: another line is to follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Incomplete;

#[derive(Debug, Default)]
struct Line {
    commands: Vec<Simple>,
    current: Simple,
    word: Option<String>,
    /// The next word is a file.
    redirected: bool,
    /// Another command has to follow.
    operator: bool,
}

impl Line {
    fn push(&mut self, text: &str) {
        self.operator = false;
        self.word.get_or_insert_default().push_str(text);
    }

    fn end_word(&mut self) {
        let Some(word) = self.word.take() else {
            return;
        };
        if std::mem::take(&mut self.redirected) {
            return;
        }
        let assigned = word.split_once('=').filter(|(name, _)| {
            let letter = |c: char| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_';
            !name.is_empty() && name.chars().all(letter)
        });
        match assigned {
            Some((name, value)) if self.current.words.is_empty() => {
                let variable = (name.to_owned(), value.to_owned());
                self.current.variables.push(variable);
            }
            _ => self.current.words.push(word),
        }
    }

    fn end_command(&mut self) {
        self.end_word();
        let command = std::mem::take(&mut self.current);
        if command != Simple::default() {
            self.commands.push(command);
        }
    }
}

/// Everything up to `end`, which is taken too.
fn until(rest: &mut std::str::Chars<'_>, end: char) -> Result<String, Incomplete> {
    let (text, behind) = rest.as_str().split_once(end).ok_or(Incomplete)?;
    *rest = behind.chars();
    Ok(text.to_owned())
}

/// A substitution, behind its `$`.
fn substitution(rest: &mut std::str::Chars<'_>) -> Result<String, Incomplete> {
    if !rest.as_str().starts_with('(') {
        return Ok("$".to_owned());
    }
    Ok(format!("${})", until(rest, ')')?))
}

fn quoted(rest: &mut std::str::Chars<'_>) -> Result<String, Incomplete> {
    let mut text = String::new();
    loop {
        match rest.next().ok_or(Incomplete)? {
            '"' => return Ok(text),
            '$' => text.push_str(&substitution(rest)?),
            '\\' => match rest.next().ok_or(Incomplete)? {
                '\n' => {}
                c @ ('"' | '\\' | '$' | '`') => text.push(c),
                c => text.extend(['\\', c]),
            },
            c => text.push(c),
        }
    }
}

/// The programs that a line calls, in order.
///
/// # Errors
/// [`Incomplete`] when the line goes on.
pub(crate) fn parse(text: &str) -> Result<Vec<Simple>, Incomplete> {
    let mut line = Line::default();
    let mut rest = text.chars();
    while let Some(c) = rest.next() {
        match c {
            '\\' => match rest.next().ok_or(Incomplete)? {
                '\n' => {}
                c => line.push(c.encode_utf8(&mut [0; 4])),
            },
            '\'' => {
                let text = until(&mut rest, '\'')?;
                line.push(&text);
            }
            '"' => {
                let text = quoted(&mut rest)?;
                line.push(&text);
            }
            '$' => {
                let text = substitution(&mut rest)?;
                line.push(&text);
            }
            '#' if line.word.is_none() => {
                // The end of the line, or of the text.
                let _comment = until(&mut rest, '\n').map_err(|_| rest = "".chars());
                line.end_command();
            }
            '\n' if line.operator => {}
            '\n' | ';' => line.end_command(),
            '|' | '&' => {
                line.end_command();
                let twice = rest.as_str().starts_with(c);
                if twice {
                    rest.next();
                }
                line.operator = twice || c == '|';
            }
            '<' | '>' => {
                // `2>` is a redirection of its own.
                line.word.take_if(|word| word == "1" || word == "2");
                line.end_word();
                if rest.as_str().starts_with(c) {
                    rest.next();
                }
                line.redirected = true;
            }
            c if c.is_whitespace() => line.end_word(),
            c => line.push(c.encode_utf8(&mut [0; 4])),
        }
    }
    line.end_command();
    if line.operator || line.redirected {
        return Err(Incomplete);
    }
    Ok(line.commands)
}

#[test]
fn lines_are_taken_apart_as_a_shell_does() {
    let words = |text: &str| -> Vec<Vec<String>> {
        let commands = parse(text).unwrap_or_else(|Incomplete| panic!("{text}: incomplete"));
        commands.into_iter().map(|command| command.words).collect()
    };
    for (text, expected) in [
        ("cargo up   # all of it", &[&["cargo", "up"][..]][..]),
        ("a b && c | d & # e", &[&["a", "b"], &["c"], &["d"]]),
        ("a 'b  c' \"d \\\"e\\\"\"", &[&["a", "b  c", "d \"e\""]]),
        ("a > b.txt 2> c d", &[&["a", "d"]]),
        ("a \\\n  b", &[&["a", "b"]]),
        ("a |\n  b", &[&["a"], &["b"]]),
        (
            "a $(date +%s) \"x$(b c)\"",
            &[&["a", "$(date +%s)", "x$(b c)"]],
        ),
        (
            "printf 'x\\n' \"\\d\" a\\;b",
            &[&["printf", "x\\n", "\\d", "a;b"]],
        ),
        ("a b#c", &[&["a", "b#c"]]),
    ] {
        assert_eq!(words(text), expected, "{text}");
    }
    let variable = parse("A_B='c d' e F=g").expect("whole");
    assert_eq!(
        variable[0].variables,
        [("A_B".to_owned(), "c d".to_owned())]
    );
    assert_eq!(variable[0].words, ["e", "F=g"]);
    for open in ["a 'b", "a \"b", "a \\", "a |", "a &&", "a >", "a $(b"] {
        assert_eq!(parse(open), Err(Incomplete), "{open}");
    }
}

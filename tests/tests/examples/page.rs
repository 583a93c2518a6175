//! Pages of Markdown, as far as examples in them need it.

use std::collections::BTreeSet;

use crawler_tests::root;

use super::shell::{self, Simple};

/// A page of the documentation.
#[derive(Debug, Clone)]
pub(crate) struct Page {
    /// Its path in the repository.
    pub(crate) name: String,
    pub(crate) text: String,
}

/// A fenced block.
#[derive(Debug, Clone)]
pub(crate) struct Block {
    /// Line of its first fence, from 1 on.
    pub(crate) line: usize,
    /// What stands behind the fence.
    pub(crate) language: String,
    pub(crate) text: String,
}

/// A span of code in the prose.
#[derive(Debug, Clone)]
pub(crate) struct Span {
    /// Line that its paragraph begins at, from 1 on.
    pub(crate) line: usize,
    /// On one line, however it is broken.
    pub(crate) text: String,
}

/// A command line of a `console` block, whole.
#[derive(Debug, Clone)]
pub(crate) struct Example {
    pub(crate) line: usize,
    /// As it is typed, without the prompt.
    pub(crate) text: String,
    pub(crate) commands: Vec<Simple>,
}

impl Page {
    pub(crate) fn read(name: &str) -> Self {
        let text = std::fs::read_to_string(root().join(name));
        Self {
            name: name.to_owned(),
            text: text.unwrap_or_else(|error| panic!("{name}: {error}")),
        }
    }

    /// Every page that a user or a contributor reads.
    pub(crate) fn all() -> Vec<Self> {
        let mut names = vec!["README.md".to_owned(), "CONTRIBUTING.md".to_owned()];
        let folder = std::fs::read_dir(root().join("docs")).expect("docs");
        let mut docs: Vec<_> = folder
            .map(|entry| entry.expect("an entry").path())
            .filter(|path| path.extension().is_some_and(|ending| ending == "md"))
            .filter_map(|path| Some(format!("docs/{}", path.file_name()?.to_str()?)))
            .collect();
        docs.sort();
        assert!(docs.len() > 20, "pages are missing: {docs:?}");
        names.extend(docs);
        names.iter().map(|name| Self::read(name)).collect()
    }

    /// Every page of the book, in its order.
    pub(crate) fn of_the_book() -> Vec<Self> {
        let contents = Self::read("docs/SUMMARY.md").links();
        let pages = contents.iter().map(|(_, target)| {
            let name = format!("docs/{target}");
            Self::read(name.strip_prefix("docs/../").unwrap_or(&name))
        });
        pages.collect()
    }

    /// A place in the page, for messages.
    pub(crate) fn at(&self, line: usize) -> String {
        format!("{}:{line}", self.name)
    }

    pub(crate) fn blocks(&self) -> Vec<Block> {
        let mut blocks: Vec<Block> = Vec::new();
        let mut inside = false;
        for (number, line) in self.text.lines().enumerate() {
            let fence = line.trim_start().strip_prefix("```");
            match (fence, inside) {
                (Some(language), false) => {
                    inside = true;
                    blocks.push(Block {
                        line: number + 1,
                        language: language.trim().to_owned(),
                        text: String::new(),
                    });
                }
                (Some(_), true) => inside = false,
                (None, true) => {
                    let block = blocks.last_mut().expect("one that is open");
                    block.text.push_str(line);
                    block.text.push('\n');
                }
                (None, false) => {}
            }
        }
        assert!(!inside, "{}: a block that does not end", self.name);
        blocks
    }

    /// The page without its blocks; every line stays in its place.
    pub(crate) fn prose(&self) -> String {
        let mut inside = false;
        let mut prose = String::new();
        for line in self.text.lines() {
            let fence = line.trim_start().starts_with("```");
            if !fence && !inside {
                prose.push_str(line);
            }
            inside ^= fence;
            prose.push('\n');
        }
        prose
    }

    pub(crate) fn spans(&self) -> Vec<Span> {
        let prose = self.prose();
        let mut spans = Vec::new();
        let mut line = 1;
        // A span may go over the end of a line, and not over that of a paragraph.
        for paragraph in prose.split("\n\n") {
            let mut rest = paragraph;
            while let Some(begin) = rest.find('`') {
                let fence = rest[begin..].chars().take_while(|&c| c == '`').count();
                let body = &rest[begin + fence..];
                let Some(end) = body.find(&"`".repeat(fence)) else {
                    break;
                };
                let words: Vec<_> = body[..end].split_whitespace().collect();
                spans.push(Span {
                    line,
                    // In a table a bar is written with a backslash.
                    text: words.join(" ").replace("\\|", "|"),
                });
                rest = &body[end + fence..];
            }
            line += paragraph.matches('\n').count() + 2;
        }
        spans
    }

    /// The targets of its links, each with the line that it is on.
    pub(crate) fn links(&self) -> Vec<(usize, String)> {
        let mut links = Vec::new();
        for (number, line) in self.prose().lines().enumerate() {
            for part in line.split("](").skip(1) {
                let target = part.split(')').next().unwrap_or_default();
                links.push((number + 1, target.to_owned()));
            }
        }
        links
    }

    /// What a link can point to behind `#`, as GitHub spells it.
    pub(crate) fn anchors(&self) -> BTreeSet<String> {
        let prose = self.prose();
        let headings = prose.lines().filter(|line| line.starts_with('#'));
        headings
            .map(|heading| {
                let text = heading.trim_start_matches('#').trim().to_lowercase();
                text.chars()
                    .filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'))
                    .map(|c| if c == ' ' { '-' } else { c })
                    .collect()
            })
            .collect()
    }

    /// The command lines of its `console` blocks, and what is wrong with those that are none.
    pub(crate) fn examples(&self) -> Result<Vec<Example>, Vec<String>> {
        let mut examples = Vec::new();
        let mut wrong = Vec::new();
        for block in self.blocks() {
            if block.language != "console" {
                continue;
            }
            let mut lines = (block.line + 1..).zip(block.text.lines()).peekable();
            let before = examples.len();
            while let Some((line, first)) = lines.next() {
                // Anything else is what a command prints.
                let Some(first) = first.trim_start().strip_prefix("$ ") else {
                    continue;
                };
                let mut text = first.to_owned();
                let commands = loop {
                    if let Ok(commands) = shell::parse(&text) {
                        break commands;
                    }
                    // A line that begins anew cannot end the one before.
                    let next = lines.next_if(|(_, line)| !line.starts_with("$ "));
                    let Some((_, next)) = next else {
                        wrong.push(format!("{}: the command has no end", self.at(line)));
                        break Vec::new();
                    };
                    text = format!("{text}\n{next}");
                };
                examples.push(Example {
                    line,
                    text,
                    commands,
                });
            }
            if examples.len() == before {
                wrong.push(format!("{}: no line begins with `$ `", self.at(block.line)));
            }
        }
        if wrong.is_empty() {
            Ok(examples)
        } else {
            Err(wrong)
        }
    }
}

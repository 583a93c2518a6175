//! `terracrawler twin gap`: how far bodies and robots of a running server are apart, or how alike the metrics of
//! scenarios are in the simulator and in a reference reality.

mod live;
mod scenarios;
mod table;

use std::fs;
use std::path::Path;

use crawler_system::cli_error::{CliError, OrSay as _};
use serde_json::Value;

pub(super) use live::run as live;
pub(super) use scenarios::run as scenarios;
use table::Table;

use super::told;

/// What a file is to be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    Json,
    Markdown,
    Html,
}

impl Form {
    /// What a file of this name is to be.
    fn of(path: &Path) -> Result<Self, CliError> {
        match path.extension().and_then(|end| end.to_str()) {
            Some("json") => Ok(Self::Json),
            Some("md") => Ok(Self::Markdown),
            Some("html") => Ok(Self::Html),
            _ => Err(CliError::new(told(
                path,
                "the name ends with .json, .md or .html",
            ))),
        }
    }

    fn write(self, title: &str, tables: &[Table], all: &Value) -> String {
        match self {
            Self::Json => format!("{all:#}\n"),
            Self::Markdown => {
                let tables: Vec<String> = tables.iter().map(Table::markdown).collect();
                format!("# {title}\n\n{}", tables.join("\n"))
            }
            Self::Html => table::page(title, tables),
        }
    }
}

/// Prints tables, and writes them to a file where one is named.
fn tell(
    title: &str,
    tables: &[Table],
    all: &Value,
    out: Option<(&Path, Form)>,
) -> Result<(), CliError> {
    for table in tables {
        println!("{}", table.text());
    }
    if let Some((path, form)) = out {
        let text = form.write(title, tables, all);
        fs::write(path, text).or_say(|error| told(path, error))?;
        println!("written to {}", path.display());
    }
    Ok(())
}

/// The file that is to be written, if there is one.
fn out(path: Option<&Path>) -> Result<Option<(&Path, Form)>, CliError> {
    path.map(|path| Ok((path, Form::of(path)?))).transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_of_a_file_says_what_it_is() {
        let of = |name: &str| Form::of(Path::new(name));
        assert_eq!(of("a/gap.json").expect("a form"), Form::Json);
        assert_eq!(of("gap.md").expect("a form"), Form::Markdown);
        assert_eq!(of("x.y.html").expect("a form"), Form::Html);
        for name in ["gap", "gap.txt", "json"] {
            of(name).expect_err("no form");
        }
    }
}

//! Tables for people: text, Markdown, HTML.

use std::fmt::Write as _;

/// A table under a title.
#[derive(Debug, Default)]
pub(super) struct Table {
    pub(super) title: String,
    /// What stands over each column; the first is of names, the others of numbers.
    pub(super) head: Vec<String>,
    pub(super) rows: Vec<Vec<String>>,
    /// What is to be known to read it.
    pub(super) notes: Vec<String>,
}

/// A number with so many decimals, or that there is none.
pub(super) fn number(value: Option<f64>, decimals: usize) -> String {
    value.map_or_else(|| "–".to_owned(), |value| format!("{value:.decimals$}"))
}

impl Table {
    pub(super) fn new(title: impl Into<String>, head: &[&str]) -> Self {
        Self {
            title: title.into(),
            head: head.iter().copied().map(str::to_owned).collect(),
            ..Self::default()
        }
    }

    /// For a terminal.
    pub(super) fn text(&self) -> String {
        let all = || std::iter::once(&self.head).chain(&self.rows);
        let widths: Vec<usize> = (0..self.head.len())
            .map(|column| {
                let cells = all().filter_map(|row| row.get(column));
                cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
            })
            .collect();
        let mut text = format!("{}\n\n", self.title);
        for row in all() {
            let mut line = String::new();
            for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
                // Writing to a String does not fail.
                let _ = if column == 0 {
                    write!(line, "  {cell:<width$}")
                } else {
                    write!(line, "  {cell:>width$}")
                };
            }
            text.push_str(line.trim_end());
            text.push('\n');
        }
        text.push('\n');
        for note in &self.notes {
            let _ = writeln!(text, "  {note}");
        }
        text
    }

    /// As Markdown.
    pub(super) fn markdown(&self) -> String {
        let line = |cells: &[String]| {
            let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        let mut text = format!("## {}\n\n{}", self.title, line(&self.head));
        let rules = (0..self.head.len()).map(|column| if column == 0 { "---" } else { "---:" });
        let _ = writeln!(text, "|{}|", rules.collect::<Vec<_>>().join("|"));
        for row in &self.rows {
            text.push_str(&line(row));
        }
        text.push('\n');
        for note in &self.notes {
            let _ = writeln!(text, "- {note}");
        }
        text
    }

    /// As part of a page.
    pub(super) fn html(&self) -> String {
        let line = |name: &str, cells: &[String]| {
            let mut line = "<tr>".to_owned();
            for cell in cells {
                // Writing to a String does not fail.
                let _ = write!(line, "<{name}>{}</{name}>", escaped(cell));
            }
            line + "</tr>\n"
        };
        let mut text = format!("<h2>{}</h2>\n<table>\n<thead>\n", escaped(&self.title));
        text += &line("th", &self.head);
        text.push_str("</thead>\n<tbody>\n");
        for row in &self.rows {
            text += &line("td", row);
        }
        text.push_str("</tbody>\n</table>\n<ul>\n");
        for note in &self.notes {
            let _ = writeln!(text, "<li>{}</li>", escaped(note));
        }
        text.push_str("</ul>\n");
        text
    }
}

/// A page of its own, which loads nothing.
pub(super) fn page(title: &str, tables: &[Table]) -> String {
    let body: String = tables.iter().map(Table::html).collect();
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n{body}</body>\n</html>\n",
        title = escaped(title)
    )
}

const STYLE: &str = "body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 70rem; padding: 0 1rem; overflow-x: auto }\n\
    table { border-collapse: collapse; font-variant-numeric: tabular-nums }\n\
    th, td { border-bottom: 1px solid #ccc; padding: .3rem .7rem; text-align: right; white-space: nowrap }\n\
    th:first-child, td:first-child { text-align: left }\n";

fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            letter => escaped.push(letter),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_the_same_in_every_form_and_says_nothing_else() {
        let mut table = Table::new("gap <of> all", &["robot", "own, cm"]);
        let row = |name: &str, value| vec![name.to_owned(), number(value, 1)];
        table.rows = vec![row("a|b", Some(1.25)), row("sim-0002", None)];
        table.notes.push("5 & more".to_owned());
        assert_eq!(
            table.text(),
            "gap <of> all\n\n  robot     own, cm\n  a|b           1.2\n  sim-0002        –\n\n  5 & more\n"
        );
        assert_eq!(
            table.markdown(),
            "## gap <of> all\n\n| robot | own, cm |\n|---|---:|\n| a\\|b | 1.2 |\n| sim-0002 | – |\n\n- 5 & more\n"
        );
        let page = page("gap", &[table]);
        for part in [
            "<h2>gap &lt;of&gt; all</h2>",
            "<tr><td>a|b</td><td>1.2</td></tr>",
            "<li>5 &amp; more</li>",
        ] {
            assert!(page.contains(part), "{part} is not in {page}");
        }
    }
}

//! `docs/access.md` says what the program does.

use std::fmt::Write as _;
use std::path::Path;

use crawler_access::topics::TABLE;

#[test]
fn the_table_of_topics_is_the_policy() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/access.md");
    let text = std::fs::read_to_string(path).expect("docs/access.md");
    let mut expected = String::from("| who | may | topics | what for |\n|---|---|---|---|\n");
    for row in TABLE {
        let (who, act) = (row.who.to_string(), row.act.to_string());
        let but = row.but.map(|topics| format!(" without `{topics}`"));
        let but = but.unwrap_or_default();
        writeln!(
            expected,
            "| {who} | {act} | `{}`{but} | {} |",
            row.topics, row.what
        )
        .expect("a string takes everything");
    }
    let (_, found) = text
        .split_once("<!-- topics -->\n\n")
        .expect("a mark before the table");
    let found = found.split("\n\n").next().unwrap_or_default();
    assert_eq!(
        found.trim_end(),
        expected.trim_end(),
        "docs/access.md should have:\n\n{expected}"
    );
}

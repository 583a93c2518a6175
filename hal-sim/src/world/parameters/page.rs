//! `docs/parameters.md`, from the table.

use core::fmt::Write;

use super::table::{Bound, Row, TABLE, Vary};

const HEAD: &str = "\
# Parameters of the simulator

Every number the simulated bodies are made of, rendered from the table in
`hal-sim/src/world/parameters/` (a test compares; `cargo run -p crawler-sim --example parameters >
docs/parameters.md` writes it anew). A scenario sets them by section and key:

```toml
randomisation = \"mild\"

[parameters.chassis]
track_m = 0.15
```

*allowed* is what a world accepts; anything else is refused with the name of the key. *mild* and
*wild* are how far the profile of `randomisation` varies a parameter from world to world, drawn from
the seed around the value of the scenario and brought into the allowed range. Beside that the robots
of one world differ by the section `spread`. The last column says where the nominal value is from;
an estimate is called one.
";

fn bound(bound: Bound) -> String {
    match bound {
        Bound::Number(number) => number.to_string(),
        Bound::Of(key) => format!("`{key}`"),
    }
}

fn vary(vary: Vary) -> String {
    match vary {
        Vary::Fixed => "–".to_owned(),
        Vary::Times(share) => format!("±{} %", f64::from(libm::roundf(share * 1_000.0)) / 10.0),
        Vary::Plus(amount) => format!("±{amount}"),
        Vary::Within(least, most) => format!("{least} to {most}"),
    }
}

fn line(page: &mut String, row: &Row) {
    let key = row.key.split_once('.').map_or(row.key, |(_, key)| key);
    let (least, most) = (bound(row.least), bound(row.most));
    writeln!(
        page,
        "| `{key}` | {} | {} | {least} to {most} | {} | {} | {} | {} |",
        row.nominal(),
        row.unit,
        vary(row.mild),
        vary(row.wild),
        row.meaning,
        row.source,
    )
    .unwrap_or_else(|_| unreachable!("a string takes everything"));
}

/// The page `docs/parameters.md`.
pub fn page() -> String {
    let mut page = HEAD.to_owned();
    let mut open = "";
    for row in TABLE {
        let section = row.key.split('.').next().unwrap_or_default();
        if section != open {
            open = section;
            page.push_str("\n## ");
            page.push_str(section);
            page.push_str(
                "\n\n| key | nominal | unit | allowed | mild | wild | meaning | source |\n\
                 |---|---:|---|---|---|---|---|---|\n",
            );
        }
        line(&mut page, row);
    }
    page
}

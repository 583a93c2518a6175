//! The budgets, and the table that holds images against them.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Deserialize;

use crate::failure::{Context as _, Outcome};
use crate::weigh::Weight;

/// What one image may take, in bytes; what is not stated is not limited.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Budget {
    flash: Option<u64>,
    ram: Option<u64>,
    stack: Option<u64>,
    control_stack: Option<u64>,
    /// Part of the update slot that stays free.
    slot_spare_percent: Option<u64>,
}

/// Budgets by the name of the image.
pub(crate) type Budgets = BTreeMap<String, Budget>;

/// One line of the table.
#[derive(Debug)]
pub(crate) struct Row {
    /// What it is, as in the budgets.
    pub(crate) name: String,
    /// What it takes.
    pub(crate) weight: Weight,
    /// Deepest stacks of tasks and of control seen while it ran, where somebody looked.
    pub(crate) stacks_used: Option<[u64; 2]>,
    /// Its update image, and the slot for it.
    pub(crate) slot: Option<(u64, u64)>,
}

/// Reads `budgets.toml`.
///
/// # Errors
/// On anything but tables of known limits.
pub(crate) fn parse(text: &str) -> Outcome<Budgets> {
    toml::from_str(text).when("cannot read the budgets")
}

/// The table in Markdown, and what is over budget.
///
/// # Errors
/// When an image has no budget: a new one must get its own.
pub(crate) fn table(rows: &[Row], budgets: &Budgets) -> (String, Vec<String>) {
    let mut text = String::from(
        "| image | flash | static RAM | stack used | of control | stack region | update slot used |\n\
         |---|---:|---:|---:|---:|---:|---:|\n",
    );
    let mut over = Vec::new();
    for row in rows {
        let Some(budget) = budgets.get(&row.name) else {
            over.push(format!("'{}' has no budget", row.name));
            continue;
        };
        let mut cell = |what: &str, used: Option<u64>, limit: Option<u64>| match (used, limit) {
            (Some(used), Some(limit)) => {
                if used > limit {
                    over.push(format!(
                        "{} {what}: {used} bytes, {} over the budget of {limit}",
                        row.name,
                        used - limit
                    ));
                }
                format!("{used} of {limit}")
            }
            (Some(used), None) => used.to_string(),
            // Only running it tells; the test that does holds it to the limit itself.
            (None, Some(limit)) => format!("not run, of {limit}"),
            (None, None) => "–".to_owned(),
        };
        let flash = cell("flash", Some(row.weight.flash), budget.flash);
        let ram = cell("static RAM", Some(row.weight.ram), budget.ram);
        let [tasks, control] = row.stacks_used.map_or([None; 2], |both| both.map(Some));
        let stack = cell("stack", tasks, budget.stack);
        let control = cell("stack of control", control, budget.control_stack);
        let region = cell("stack region", row.weight.stack, None);
        let slot = slot_cell(row, budget, &mut over);
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "| {} | {flash} | {ram} | {stack} | {control} | {region} | {slot} |",
            row.name
        );
    }
    (text, over)
}

fn slot_cell(row: &Row, budget: &Budget, over: &mut Vec<String>) -> String {
    match (row.slot, budget.slot_spare_percent) {
        (Some((image, slot)), spare) => {
            let spare = spare.unwrap_or(0);
            let limit = slot * 100_u64.saturating_sub(spare) / 100;
            if image > limit {
                over.push(format!(
                    "{} update image: {image} bytes, {} over {limit}, which leaves {spare} % of the slot free",
                    row.name,
                    image - limit
                ));
            }
            format!("{image} of {slot} ({} %)", image * 100 / slot.max(1))
        }
        (None, Some(_)) => {
            over.push(format!("{} update image: a budget, and no image", row.name));
            "?".to_owned()
        }
        (None, None) => "–".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::{Row, parse, table};
    use crate::weigh::Weight;

    fn row(flash: u64, ram: u64, stacks_used: Option<[u64; 2]>, slot: Option<(u64, u64)>) -> Row {
        Row {
            name: "virt".to_owned(),
            weight: Weight {
                flash,
                ram,
                stack: None,
            },
            stacks_used,
            slot,
        }
    }

    fn over(row: Row, budgets: &str) -> Vec<String> {
        table(&[row], &parse(budgets).expect("budgets")).1
    }

    #[test]
    fn what_fits_passes_and_one_byte_more_does_not() {
        let budgets = "[virt]\nflash = 1_000\nram = 100\nstack = 10\ncontrol_stack = 5\n";
        assert!(over(row(1000, 100, Some([10, 5]), None), budgets).is_empty());
        assert!(over(row(1000, 100, None, None), budgets).is_empty());
        for (row, what) in [
            (row(1001, 100, Some([10, 5]), None), "virt flash"),
            (row(1000, 101, Some([10, 5]), None), "virt static RAM"),
            (row(1000, 100, Some([11, 5]), None), "virt stack:"),
            (row(1000, 100, Some([10, 6]), None), "virt stack of control"),
        ] {
            let lines = over(row, budgets);
            assert!(lines.len() == 1 && lines[0].contains(what), "{lines:?}");
        }
    }

    #[test]
    fn a_slot_keeps_its_spare() {
        let budgets = "[virt]\nslot_spare_percent = 25\n";
        assert!(over(row(1, 1, None, Some((750, 1000))), budgets).is_empty());
        assert_eq!(over(row(1, 1, None, Some((751, 1000))), budgets).len(), 1);
        assert_eq!(over(row(1, 1, None, None), budgets).len(), 1);
        // Without a stated spare it must fit at least.
        assert_eq!(over(row(1, 1, None, Some((1001, 1000))), "[virt]").len(), 1);
    }

    #[test]
    fn an_image_without_a_budget_does_not_pass() {
        assert_eq!(over(row(1, 1, None, None), "").len(), 1);
    }

    #[test]
    fn budgets_are_read_strictly() {
        for text in [
            "[virt]\nflesh = 1\n",
            "[virt]\nflash = -1\n",
            "virt = 3\n",
            "[",
        ] {
            assert!(parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn the_budgets_of_the_repository_can_be_read() {
        let budgets = parse(include_str!("../../budgets.toml")).expect("budgets");
        for name in ["program", "virt", "esp32c3", "esp32c6"] {
            assert!(budgets.contains_key(name), "{name}");
        }
    }
}

//! The drawing of the crates in `docs/architecture.md`, made from their manifests.
//!
//! Reading order: [`command`] writes the drawing, [`crates`] reads the manifests, [`reduced`] leaves out
//! the lines that others imply, [`Layout`] places boxes in rows, [`svg`] writes them down.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use crate::files;
use crate::run::{self, Failure, Outcome};

/// Where the drawing is.
const DRAWING: &str = "docs/architecture.svg";

/// What looks at others and ships with nothing: each would draw a line to almost every box.
const ONLOOKERS: [&str; 5] = [
    "crawler-compare",
    "crawler-footprint",
    "crawler-fuzz",
    "crawler-tests",
    "crawler-world-history",
];

/// Folders without manifests of ours.
const SKIPPED: [&str; 4] = ["target", "node_modules", "docs", "deploy"];

/// Size of a box, in pixels, as everything below.
const BOX: (f64, f64) = (128.0, 42.0);
/// Between two boxes of a row.
const GAP: f64 = 16.0;
/// What a line needs that passes a row.
const LANE: f64 = 14.0;
/// From the top of a row to the top of the next.
const ROW: f64 = 92.0;
/// Around the drawing.
const MARGIN: f64 = 20.0;
/// How often rows are sorted and boxes pulled towards what they are tied to.
const SWEEPS: usize = 24;

/// A crate, as its manifest describes it.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Crate {
    name: String,
    /// From the root of the repository on.
    folder: String,
    /// The crates of ours that it is built from, without those of its tests.
    needs: BTreeSet<String>,
}

/// Writes the drawing anew.
///
/// # Errors
/// When there are arguments, or a manifest cannot be read, or the drawing not be written.
pub(crate) fn command(arguments: &[String]) -> Outcome {
    if let Some(argument) = arguments.first() {
        return Err(Failure(format!("'{argument}' is not understood")));
    }
    files::write(&run::root().join(DRAWING), &drawing()?)?;
    println!("{DRAWING} is up to date");
    Ok(())
}

/// The drawing that the manifests give.
fn drawing() -> Outcome<String> {
    let mut found = Vec::new();
    crates(&run::root(), &mut found)?;
    Ok(svg(&found))
}

/// Adds every crate at or below `folder`.
fn crates(folder: &Path, found: &mut Vec<Crate>) -> Outcome {
    let failed = |error| Failure(format!("{}: {error}", folder.display()));
    if let Ok(manifest) = fs::read_to_string(folder.join("Cargo.toml")) {
        let place = folder.strip_prefix(run::root()).unwrap_or(folder);
        found.extend(parsed(
            &manifest,
            &place.to_string_lossy().replace('\\', "/"),
        ));
    }
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if path.is_dir() && !name.starts_with('.') && !SKIPPED.contains(&name.as_ref()) {
            crates(&path, found)?;
        }
    }
    Ok(())
}

/// The crate of a manifest; none where it is that of a workspace alone.
fn parsed(manifest: &str, folder: &str) -> Option<Crate> {
    let mut section = "";
    let mut name = None;
    let mut needs = BTreeSet::new();
    for line in manifest.lines() {
        if let Some(head) = line.strip_prefix('[') {
            section = head.trim_end().trim_end_matches(']');
        } else if section == "package" {
            if let Some(rest) = line.strip_prefix("name = \"") {
                name = Some(rest.trim_end_matches('"').to_owned());
            }
        } else if section.ends_with("dependencies") && !section.ends_with("dev-dependencies") {
            let need = line.split([' ', '.', '=']).next().unwrap_or_default();
            if need.starts_with("crawler-") && section != "workspace.dependencies" {
                needs.insert(need.to_owned());
            }
        }
    }
    Some(Crate {
        name: name?,
        folder: folder.to_owned(),
        needs,
    })
}

/// What is drawn: no onlookers, nothing that stands alone, and no line where a longer way leads too.
fn reduced(crates: &[Crate]) -> BTreeMap<String, Crate> {
    let drawn = |name: &str| !ONLOOKERS.contains(&name);
    let all: BTreeMap<&str, &Crate> = crates
        .iter()
        .filter(|one| drawn(&one.name))
        .map(|one| (one.name.as_str(), one))
        .collect();
    let needed: BTreeSet<&String> = all.values().flat_map(|one| &one.needs).collect();
    all.values()
        .filter(|one| !one.needs.is_empty() || needed.contains(&one.name))
        .map(|one| {
            let implied: BTreeSet<&str> = one
                .needs
                .iter()
                .flat_map(|need| below(&all, need))
                .collect();
            let direct = one
                .needs
                .iter()
                .filter(|need| all.contains_key(need.as_str()));
            let needs = direct.filter(|need| !implied.contains(need.as_str()));
            let reduced = Crate {
                needs: needs.cloned().collect(),
                ..(*one).clone()
            };
            (one.name.clone(), reduced)
        })
        .collect()
}

/// Everything that a crate stands on, itself left out.
fn below<'a>(all: &BTreeMap<&'a str, &'a Crate>, name: &str) -> BTreeSet<&'a str> {
    let mut found = BTreeSet::new();
    let mut waiting = vec![name.to_owned()];
    while let Some(name) = waiting.pop() {
        for need in all
            .get(name.as_str())
            .into_iter()
            .flat_map(|one| &one.needs)
        {
            if found.insert(need.as_str()) {
                waiting.push(need.clone());
            }
        }
    }
    found
}

/// What has a place in a row.
#[derive(Debug, Clone)]
struct Spot {
    /// The crate; none where a line passes the row.
    holds: Option<String>,
    /// Its middle.
    x: f64,
}

impl Spot {
    fn width(&self) -> f64 {
        if self.holds.is_some() { BOX.0 } else { LANE }
    }
}

/// Rows from the bottom up, and the lines between neighbouring rows.
#[derive(Debug, Clone, Default)]
struct Layout {
    spots: Vec<Spot>,
    /// The numbers of the spots of each row, from left to right.
    rows: Vec<Vec<usize>>,
    /// Each from a spot to one in the row below.
    lines: Vec<(usize, usize)>,
}

impl Layout {
    fn of(crates: &BTreeMap<String, Crate>) -> Self {
        let mut layout = Self::default();
        let mut ranks = BTreeMap::new();
        for name in crates.keys() {
            rank(crates, name, &mut ranks);
        }
        let mut by_folder: Vec<&Crate> = crates.values().collect();
        by_folder.sort_by_key(|one| &one.folder);
        let mut places = BTreeMap::new();
        for one in by_folder {
            let spot = layout.add(ranks[&one.name], Some(one.name.clone()));
            places.insert(&one.name, spot);
        }
        for one in crates.values() {
            for need in &one.needs {
                let mut from = places[&one.name];
                for row in (ranks[need] + 1..ranks[&one.name]).rev() {
                    let lane = layout.add(row, None);
                    layout.lines.push((from, lane));
                    from = lane;
                }
                layout.lines.push((from, places[need]));
            }
        }
        layout.sort();
        layout.align();
        layout
    }

    fn add(&mut self, row: usize, holds: Option<String>) -> usize {
        while self.rows.len() <= row {
            self.rows.push(Vec::new());
        }
        let spot = self.spots.len();
        self.spots.push(Spot { holds, x: 0.0 });
        self.rows[row].push(spot);
        spot
    }

    /// The spots that one is tied to, in the row above or below.
    fn ties(&self, spot: usize, above: bool) -> impl Iterator<Item = usize> {
        self.lines
            .iter()
            .filter_map(move |&(upper, lower)| match above {
                true if lower == spot => Some(upper),
                false if upper == spot => Some(lower),
                _ => None,
            })
    }

    /// Sorts each row by the middle of what its spots are tied to, and keeps the order with the fewest
    /// crossings.
    fn sort(&mut self) {
        let mut best = (self.crossings(), self.rows.clone());
        for sweep in 0..SWEEPS {
            let down = sweep % 2 == 0;
            let count = self.rows.len();
            for step in 1..count {
                let row = if down { count - 1 - step } else { step };
                let neighbour = if down { row + 1 } else { row - 1 };
                let place = |spot: usize| self.rows[neighbour].iter().position(|&one| one == spot);
                let mut sorted: Vec<(f64, usize)> = Vec::new();
                for (at, &spot) in self.rows[row].iter().enumerate() {
                    let tied: Vec<f64> = self
                        .ties(spot, down)
                        .filter_map(place)
                        .map(|place| place as f64)
                        .collect();
                    sorted.push((mean(&tied).unwrap_or(at as f64), spot));
                }
                sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
                self.rows[row] = sorted.into_iter().map(|(_, spot)| spot).collect();
            }
            let crossings = self.crossings();
            if crossings < best.0 {
                best = (crossings, self.rows.clone());
            }
        }
        self.rows = best.1;
    }

    /// How many pairs of lines cross.
    fn crossings(&self) -> usize {
        let mut places = vec![0; self.spots.len()];
        let mut rows = vec![0; self.spots.len()];
        for (number, row) in self.rows.iter().enumerate() {
            for (place, &spot) in row.iter().enumerate() {
                places[spot] = place;
                rows[spot] = number;
            }
        }
        let crossed = |a: &(usize, usize), b: &(usize, usize)| {
            rows[a.0] == rows[b.0] && places[a.0] < places[b.0] && places[a.1] > places[b.1]
        };
        let pairs = self
            .lines
            .iter()
            .map(|a| self.lines.iter().filter(|b| crossed(a, b)).count());
        pairs.sum()
    }

    /// Puts every spot near the middle of what it is tied to, without one coming onto another.
    fn align(&mut self) {
        for row in 0..self.rows.len() {
            self.place(row, |_, _| 0.0);
        }
        for sweep in 0..SWEEPS {
            let count = self.rows.len();
            for step in 0..count {
                let row = if sweep % 2 == 0 {
                    count - 1 - step
                } else {
                    step
                };
                self.place(row, |layout, spot| {
                    let ties = layout.ties(spot, true).chain(layout.ties(spot, false));
                    let tied: Vec<f64> = ties.map(|tie| layout.spots[tie].x).collect();
                    mean(&tied).unwrap_or(layout.spots[spot].x)
                });
            }
        }
        let left = |spot: &Spot| spot.x - spot.width() / 2.0;
        let least = self.spots.iter().map(left).fold(f64::INFINITY, f64::min);
        for spot in &mut self.spots {
            spot.x += MARGIN - least;
        }
    }

    /// Places a row as near as it goes to where its spots are wanted.
    fn place(&mut self, row: usize, wanted: impl Fn(&Self, usize) -> f64) {
        let row = self.rows[row].clone();
        let wanted: Vec<f64> = row.iter().map(|&spot| wanted(self, spot)).collect();
        let apart = |a: usize, b: usize| {
            f64::midpoint(self.spots[row[a]].width(), self.spots[row[b]].width()) + GAP
        };
        let mut right = wanted.clone();
        for at in 1..row.len() {
            right[at] = right[at].max(right[at - 1] + apart(at - 1, at));
        }
        let mut left = wanted;
        for at in (1..row.len()).rev() {
            left[at - 1] = left[at - 1].min(left[at] - apart(at - 1, at));
        }
        for (at, spot) in row.into_iter().enumerate() {
            self.spots[spot].x = f64::midpoint(left[at], right[at]);
        }
    }
}

fn mean(numbers: &[f64]) -> Option<f64> {
    (!numbers.is_empty()).then(|| numbers.iter().sum::<f64>() / numbers.len() as f64)
}

/// How many crates stand on top of each other below this one, at most.
fn rank(
    crates: &BTreeMap<String, Crate>,
    name: &str,
    ranks: &mut BTreeMap<String, usize>,
) -> usize {
    if let Some(&known) = ranks.get(name) {
        return known;
    }
    let needs = crates.get(name).into_iter().flat_map(|one| &one.needs);
    let lower = needs.map(|need| rank(crates, need, ranks) + 1).max();
    let rank = lower.unwrap_or(0);
    ranks.insert(name.to_owned(), rank);
    rank
}

/// Colours of a box by the folder at the top: its ground and its border.
fn colours(folder: &str) -> (&'static str, &'static str) {
    match folder {
        _ if folder.starts_with("firmware/boards") => ("#fde8d7", "#c2661a"),
        _ if folder.starts_with("firmware") => ("#e0edfb", "#2f6fb3"),
        _ if folder.starts_with("models") => ("#efe6f8", "#7a4fae"),
        _ if folder.starts_with("hal-sim") => ("#e2f3e4", "#3b8a45"),
        _ if folder.starts_with("host-server") => ("#fbf3d0", "#a08415"),
        _ => ("#eeeeee", "#777777"),
    }
}

/// The drawing of these crates.
fn svg(crates: &[Crate]) -> String {
    let crates = reduced(crates);
    let layout = Layout::of(&crates);
    let rows = layout.rows.len();
    let right = |spot: &Spot| spot.x + spot.width() / 2.0;
    let width = layout.spots.iter().map(right).fold(0.0, f64::max) + MARGIN;
    let height = 2.0 * MARGIN + ROW * (rows as f64 - 1.0) + BOX.1;
    let mut tops = vec![0.0; layout.spots.len()];
    for (row, spots) in layout.rows.iter().enumerate() {
        for &spot in spots {
            tops[spot] = MARGIN + ROW * (rows - 1 - row) as f64;
        }
    }
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width:.0} {height:.0}\" \
         font-family=\"sans-serif\" text-anchor=\"middle\">\n\
         <title>The crates, each above those that it depends on</title>\n\
         <!-- Written by `cargo xtask architecture`. -->\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n\
         <g fill=\"none\" stroke=\"#8a8a8a\" stroke-width=\"1.2\">\n"
    );
    for &(upper, lower) in &layout.lines {
        let (from, to) = (layout.spots[upper].x, layout.spots[lower].x);
        let (begin, end) = (tops[upper] + BOX.1, tops[lower]);
        let middle = f64::midpoint(begin, end);
        // A line that passes a row goes straight through it.
        let through = match layout.spots[lower].holds {
            Some(_) => String::new(),
            None => format!(" V{:.0}", end + BOX.1),
        };
        let _ = writeln!(
            text,
            "<path d=\"M{from:.0} {begin:.0} C{from:.0} {middle:.0} {to:.0} {middle:.0} {to:.0} {end:.0}{through}\"/>"
        );
    }
    text += "</g>\n";
    for (spot, top) in layout.spots.iter().zip(&tops) {
        let Some(name) = &spot.holds else { continue };
        let folder = &crates[name].folder;
        let (ground, border) = colours(folder);
        let (parent, last) = folder.rsplit_once('/').unwrap_or(("", folder));
        let _ = writeln!(
            text,
            "<rect x=\"{:.0}\" y=\"{top:.0}\" width=\"{}\" height=\"{}\" rx=\"5\" fill=\"{ground}\" stroke=\"{border}\"/>",
            spot.x - BOX.0 / 2.0,
            BOX.0,
            BOX.1
        );
        let line = if parent.is_empty() { 26.0 } else { 33.0 };
        if !parent.is_empty() {
            let _ = writeln!(
                text,
                "<text x=\"{:.0}\" y=\"{:.0}\" font-size=\"11\" fill=\"#555555\">{parent}/</text>",
                spot.x,
                top + 16.0
            );
        }
        let _ = writeln!(
            text,
            "<text x=\"{:.0}\" y=\"{:.0}\" font-size=\"14\" fill=\"#111111\">{last}</text>",
            spot.x,
            top + line
        );
    }
    text + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::{Crate, DRAWING, Layout, drawing, parsed, reduced};
    use crate::run;

    fn named(name: &str, needs: &[&str]) -> Crate {
        Crate {
            name: name.to_owned(),
            folder: name.to_owned(),
            needs: needs.iter().map(|&need| need.to_owned()).collect(),
        }
    }

    #[test]
    fn the_drawing_is_that_of_the_manifests() {
        let real = drawing().expect("a drawing");
        let told = std::fs::read_to_string(run::root().join(DRAWING)).expect(DRAWING);
        assert!(
            told == real,
            "{DRAWING} is stale: `cargo xtask architecture` writes it anew"
        );
    }

    #[test]
    fn a_manifest_says_what_a_crate_is_built_from() {
        let manifest = "[package]\nname = \"crawler-a\"\n[dependencies]\ncrawler-b.workspace = true\n\
            serde = \"1\"\n[dev-dependencies]\ncrawler-c = \"1\"\n\
            [target.'cfg(unix)'.dependencies]\ncrawler-d = { path = \"d\" }\n";
        let one = parsed(manifest, "a").expect("a crate");
        assert_eq!(one.needs, named("", &["crawler-b", "crawler-d"]).needs);
        assert!(parsed("[workspace.dependencies]\ncrawler-b = \"1\"\n", "").is_none());
    }

    #[test]
    fn what_a_longer_way_tells_is_left_out() {
        let crates = [
            named("a", &["b", "c"]),
            named("b", &["c"]),
            named("c", &[]),
            named("alone", &[]),
            named("crawler-tests", &["a"]),
        ];
        let drawn = reduced(&crates);
        assert_eq!(drawn.keys().collect::<Vec<_>>(), ["a", "b", "c"]);
        assert_eq!(drawn["a"].needs, named("", &["b"]).needs);
    }

    #[test]
    fn boxes_of_a_row_are_apart() {
        let crates = [
            named("a", &["d"]),
            named("b", &["d", "e"]),
            named("c", &["e"]),
            named("d", &["f"]),
            named("e", &[]),
            named("f", &[]),
        ];
        let layout = Layout::of(&reduced(&crates));
        for row in &layout.rows {
            for pair in row.windows(2) {
                let [left, right] = [&layout.spots[pair[0]], &layout.spots[pair[1]]];
                let apart = f64::midpoint(left.width(), right.width());
                assert!(right.x - left.x >= apart, "{left:?} {right:?}");
            }
        }
    }
}

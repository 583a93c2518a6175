//! The pin tables of the boards: free of conflicts, and told alike to people and to the chip.
//!
//! The tables are read by the compiler, through a macro of the same name as the board crate's.

use std::collections::BTreeMap;
use std::fmt::Write;

use crawler_tests::root;

/// Most that a pack of two cells can have: 4.2 V each, and the tolerance of charger and divider.
const HIGHEST_MV: u32 = 8_600;

/// One row of a table.
#[derive(Debug)]
struct Pin {
    role: &'static str,
    schematic: &'static str,
    gpio: &'static str,
    number: u8,
    what: &'static str,
}

/// A board as its table tells it.
struct Board {
    name: &'static str,
    id: &'static str,
    battery: &'static str,
    top_ohms: u32,
    bottom_ohms: u32,
    limit_mv: u32,
    strapping: &'static [u8],
    usb: &'static [u8],
    console: &'static [u8],
    groups: &'static [(&'static str, &'static [Pin])],
}

macro_rules! pin_table {
    (
        name: $name:literal,
        id: $id:literal,
        lamp: lit $lit:ident,
        battery: $battery:ident,
        divider: $top:literal over $bottom:literal, converter ends at $limit:literal,
        strapping: [$($strapping:literal),*],
        usb: [$($usb:literal),*],
        console: [$($console:literal),*],
        $(
            $(#[$about:meta])*
            $group:ident as $field:ident {
                $($role:ident: $schematic:literal = $gpio:ident, $number:literal, $what:literal;)*
            }
        )*
    ) => {
        pub(super) const BOARD: super::Board = super::Board {
            name: $name,
            id: $id,
            battery: stringify!($battery),
            top_ohms: $top,
            bottom_ohms: $bottom,
            limit_mv: $limit,
            strapping: &[$($strapping),*],
            usb: &[$($usb),*],
            console: &[$($console),*],
            groups: &[$((
                stringify!($field),
                &[$(super::Pin {
                    role: stringify!($role),
                    schematic: $schematic,
                    gpio: stringify!($gpio),
                    number: $number,
                    what: $what,
                }),*],
            )),*],
        };
    };
}

#[path = "../../firmware/boards/esp/src/board/c3.rs"]
mod c3;
#[path = "../../firmware/boards/esp/src/board/c6.rs"]
mod c6;
#[path = "../../firmware/boards/esp/src/board/s3.rs"]
mod s3;

impl Board {
    /// What the pin has when the pack has `pack_mv`.
    fn pin_mv(&self, pack_mv: u32) -> u32 {
        let sum = self.top_ohms + self.bottom_ohms;
        (pack_mv * self.bottom_ohms / 100 + sum / 200) / (sum / 100)
    }
}

/// Each board with its name in the documentation and the pins of its first converter (data sheets,
/// "ADC channels").
const BOARDS: [(&str, Board, std::ops::RangeInclusive<u8>); 3] = [
    ("s3", s3::BOARD, 1..=10),
    ("c3", c3::BOARD, 0..=4),
    ("c6", c6::BOARD, 0..=6),
];

/// What may hang on a pin that decides how the chip starts: each is high or open by then.
const MAY_STRAP: [(&str, &str); 6] = [
    ("s3", "button"),
    ("c3", "button"),
    ("c6", "button"),
    // Pulled up, and without effect while the enable is low.
    ("c3", "right_in2"),
    ("c3", "lamp"),
    // Read only when a fuse is burnt, for a debugger.
    ("c6", "lamp"),
];

const ROLES: [&str; 11] = [
    "battery",
    "button",
    "lamp",
    "left_enable",
    "left_in1",
    "left_in2",
    "ranger_rx",
    "ranger_tx",
    "right_enable",
    "right_in1",
    "right_in2",
];

fn pins(board: &Board) -> impl Iterator<Item = &Pin> {
    board.groups.iter().flat_map(|(_, pins)| pins.iter())
}

fn robot(board: &Board) -> impl Iterator<Item = &Pin> {
    let (name, pins) = board.groups.first().expect("a group");
    assert_eq!(*name, "robot");
    pins.iter()
}

#[test]
fn every_board_has_every_role_once() {
    for (name, board, _) in &BOARDS {
        let mut roles: Vec<_> = robot(board).map(|pin| pin.role).collect();
        roles.sort_unstable();
        assert_eq!(roles, ROLES, "{name}");
        assert!(board.id.len() <= 16, "{name}: the status has room for 16");
    }
}

#[test]
fn no_pin_is_used_twice() {
    for (name, board, _) in &BOARDS {
        let mut owners: BTreeMap<u8, Vec<&str>> = BTreeMap::new();
        let mut labels: BTreeMap<&str, u32> = BTreeMap::new();
        for pin in pins(board) {
            assert_eq!(pin.gpio, format!("GPIO{}", pin.number), "{name}");
            owners.entry(pin.number).or_default().push(pin.role);
            *labels.entry(pin.schematic).or_default() += 1;
        }
        owners.retain(|_, owners| owners.len() > 1);
        labels.retain(|_, count| *count > 1);
        assert!(owners.is_empty(), "{name}: {owners:?}");
        assert!(labels.is_empty(), "{name}: {labels:?}");
    }
}

#[test]
fn pins_that_start_the_chip_carry_nothing_that_moves_or_pulls_low() {
    for (name, board, _) in &BOARDS {
        for pin in pins(board) {
            assert!(!board.usb.contains(&pin.number), "{name}: {pin:?} is USB");
            let strap = board.strapping.contains(&pin.number);
            assert!(
                !strap || MAY_STRAP.contains(&(name, pin.role)),
                "{name}: {pin:?} decides how the chip starts"
            );
            // The loader writes its messages there: a ranger takes them for noise.
            let console = board.console.contains(&pin.number);
            assert!(
                !console || pin.role == "ranger_tx",
                "{name}: {pin:?} moves while the chip starts"
            );
        }
    }
}

#[test]
fn the_battery_is_on_the_converter_and_fits_it() {
    for (name, board, converter) in &BOARDS {
        let battery = robot(board)
            .find(|pin| pin.role == "battery")
            .expect("battery");
        assert_eq!(battery.gpio, board.battery, "{name}");
        assert!(converter.contains(&battery.number), "{name}: {battery:?}");
        assert!(board.pin_mv(HIGHEST_MV) < board.limit_mv, "{name}");
    }
}

/// What stands between the marker `<!-- {begin}…-->` and the next `<!-- end -->`.
fn section(begin: &str) -> String {
    let page =
        std::fs::read_to_string(root().join("docs/build-a-robot.md")).expect("docs/build-a-robot");
    let (_, rest) = page
        .split_once(&format!("<!-- {begin}"))
        .unwrap_or_else(|| panic!("docs/build-a-robot.md lacks '{begin}'"));
    let (_, rest) = rest.split_once("-->\n").expect("end of the marker");
    let (section, _) = rest.split_once("<!-- end -->").expect("end of the section");
    section.to_owned()
}

#[test]
fn the_documentation_has_the_same_pins() {
    for (name, board, _) in &BOARDS {
        let mut expected = String::new();
        for (at, (group, pins)) in board.groups.iter().enumerate() {
            if at > 0 {
                writeln!(expected, "\nOn the board itself ({group}):\n").expect("string");
            }
            expected.push_str("| pin | GPIO | role | what |\n|---|---|---|---|\n");
            for pin in *pins {
                let Pin {
                    role,
                    schematic,
                    gpio,
                    what,
                    ..
                } = pin;
                writeln!(expected, "| {schematic} | {gpio} | `{role}` | {what} |").expect("string");
            }
        }
        let told = section(&format!("pins: {name}"));
        assert!(
            told == expected,
            "docs/build-a-robot.md tells other pins of {name} than its table:\n{expected}"
        );
    }
}

#[test]
fn the_documentation_has_the_same_dividers() {
    let mut expected =
        "| board | top | bottom | at 8.4 V | at 6.6 V | converter ends at |\n|---|---|---|---|---|---|\n"
            .to_owned();
    for (_, board, _) in &BOARDS {
        let volts = |mv: u32| f64::from(mv) * 1e-3;
        writeln!(
            expected,
            "| {} | {} kΩ | {} kΩ | {:.2} V | {:.2} V | {:.1} V |",
            board.name,
            board.top_ohms / 1_000,
            board.bottom_ohms / 1_000,
            volts(board.pin_mv(8_400)),
            volts(board.pin_mv(6_600)),
            volts(board.limit_mv),
        )
        .expect("string");
    }
    assert_eq!(section("dividers: "), expected);
}

//! Open-circuit voltage of a lithium-ion cell against its state of charge.
//!
//! The curve of a cell at rest: mean of a charge and a discharge at C/20, each after 24 h of rest,
//! which leaves little of the voltage lost inside the cell. Measured on a Sony/Murata US18650VTC6
//! (nickel-rich cathode, graphite anode) by L. Engelmann, 2022
//! (<https://github.com/derlucae98/US18650VTC6_OCV_SOC_Curve>, MIT), read off here at thirteen
//! points and stretched so that 0 % is 3.0 V: the 2.7 % of the charge below that voltage are not
//! worth the harm to the cell. Cells of another make differ by some five percent.

use crawler_hal::{Millivolts, Percent};

/// Voltage of one cell at rest, and its state of charge in percent. Both rise from row to row;
/// between two rows the curve is straight.
pub const TABLE: [(Millivolts, u8); 13] = [
    (Millivolts(3_000), 0),
    (Millivolts(3_218), 5),
    (Millivolts(3_313), 10),
    (Millivolts(3_446), 20),
    (Millivolts(3_577), 30),
    (Millivolts(3_676), 40),
    (Millivolts(3_765), 50),
    (Millivolts(3_849), 60),
    (Millivolts(3_932), 70),
    (Millivolts(4_042), 80),
    (Millivolts(4_091), 90),
    (Millivolts(4_113), 95),
    (Millivolts(4_175), 100),
];

/// The state of charge of a cell that has `cell` at rest, to the nearest percent; 0 or 100 beyond
/// the ends of the table. Never falls when the voltage rises.
#[must_use]
pub fn state_of_charge(cell: Millivolts) -> Percent {
    let points = TABLE.map(|(voltage, percent)| (u32::from(voltage.0), u32::from(percent)));
    percent(interpolate(&points, u32::from(cell.0)))
}

/// The voltage at rest of a cell with `charge`, to the nearest millivolt. The other way round, for
/// models of the pack.
#[must_use]
pub fn open_circuit_voltage(charge: Percent) -> Millivolts {
    let points = TABLE.map(|(voltage, percent)| (u32::from(percent), u32::from(voltage.0)));
    // Between two voltages of the table, so it fits.
    Millivolts(interpolate(&points, u32::from(charge.get())) as u16)
}

fn percent(value: u32) -> Percent {
    u8::try_from(value)
        .ok()
        .and_then(Percent::new)
        .unwrap_or(Percent::FULL)
}

/// The curve through `points`, which rise, at `x`, to the nearest whole; flat beyond the ends.
fn interpolate(points: &[(u32, u32)], x: u32) -> u32 {
    let mut below: Option<(u32, u32)> = None;
    for &(x1, y1) in points {
        if x <= x1 {
            return match below {
                Some((x0, y0)) => {
                    let run = x1 - x0;
                    y0 + ((y1 - y0) * (x - x0) + run / 2) / run
                }
                None => y1,
            };
        }
        below = Some((x1, y1));
    }
    below.map_or(0, |(_, y)| y)
}

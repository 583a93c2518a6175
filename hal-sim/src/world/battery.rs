//! The battery pack: two lithium-ion cells in series.

/// Terminal voltage of a full pack at rest.
pub(crate) const FULL_V: f32 = 8.4;

/// Open-circuit voltage of one cell at 0, 10, … 100 % charge.
///
/// The common shape of a 18650 with nickel-rich cathode at 25 °C: steep at both ends, a plateau
/// around 3.7 V.
const CELL_V: [f32; 11] = [
    3.00, 3.35, 3.50, 3.58, 3.64, 3.70, 3.78, 3.87, 3.96, 4.06, 4.20,
];

/// Voltage of the pack at rest, at a charge of 0 to 1. An empty pack is cut off by its
/// protection circuit and gives nothing.
pub(crate) fn open_circuit_v(charge: f32) -> f32 {
    if charge <= 0.0 {
        return 0.0;
    }
    let place = (charge * 10.0).min(10.0);
    let below = (place as usize).min(9);
    let share = place - below as f32;
    2.0 * (CELL_V[below] + (CELL_V[below + 1] - CELL_V[below]) * share)
}

/// Charge, 0 to 1, of a pack that has this voltage at rest; empty below that of an empty one.
#[must_use]
pub fn charge_at_rest(volts: f32) -> f32 {
    let cell = volts * 0.5;
    let above = CELL_V.partition_point(|at| *at <= cell);
    let Some(below) = above.checked_sub(1) else {
        return 0.0;
    };
    match CELL_V.get(above) {
        Some(next) => {
            (below as f32 + (cell - CELL_V[below]) / (next - CELL_V[below]))
                / (CELL_V.len() - 1) as f32
        }
        None => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn voltage_rises_with_charge_between_empty_and_full() {
        let mut last = open_circuit_v(0.001);
        for step in 2..=1_000_u16 {
            let next = open_circuit_v(f32::from(step) / 1_000.0);
            assert!(next > last, "at {step} per mille: {next} after {last}");
            last = next;
        }
        assert!((last - FULL_V).abs() < 1e-4);
        assert!((open_circuit_v(0.5) - 7.4).abs() < 1e-4);
        assert!(open_circuit_v(0.0) == 0.0, "the protection circuit opens");
    }

    #[test]
    fn the_voltage_at_rest_tells_the_charge() {
        for step in 1..=1_000_u16 {
            let charge = f32::from(step) / 1_000.0;
            let told = charge_at_rest(open_circuit_v(charge));
            assert!((told - charge).abs() < 1e-4, "{told} for {charge}");
        }
        for (volts, charge) in [(0.0, 0.0), (5.9, 0.0), (9.0, 1.0), (f32::NAN, 0.0)] {
            assert_eq!(charge_at_rest(volts), charge);
        }
    }
}

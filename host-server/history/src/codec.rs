//! Rows of whole numbers in few bytes: of each row, which columns changed, and by how much.
//!
//! Telemetry repeats itself. The first column is a time and comes at even steps, so the change of its
//! step is kept; most others stay, or change by little.

/// Writes a number so that small ones, of either sign, are short.
fn put(out: &mut Vec<u8>, value: i64) {
    let mut rest = ((value << 1) ^ (value >> 63)) as u64;
    while rest >= 0x80 {
        out.push(rest as u8 | 0x80);
        rest >>= 7;
    }
    out.push(rest as u8);
}

/// The number at the front of `bytes`, which moves past it.
fn take(bytes: &mut &[u8]) -> Option<i64> {
    let mut value = 0_u64;
    for shift in (0..64).step_by(7) {
        let (&byte, rest) = bytes.split_first()?;
        *bytes = rest;
        let part = u64::from(byte & 0x7f);
        // The tenth byte has room for one bit.
        if shift == 63 && part > 1 {
            return None;
        }
        value |= part << shift;
        if byte & 0x80 == 0 {
            return Some((value >> 1) as i64 ^ -((value & 1) as i64));
        }
    }
    None
}

/// `rows` as bytes. At most 32 columns.
pub(super) fn encode<const N: usize>(rows: &[[i64; N]]) -> Vec<u8> {
    const { assert!(N <= 32, "the set of changed columns has 32 bits") };
    let mut out = Vec::with_capacity(rows.len() * 12 + 8);
    put(&mut out, rows.len() as i64);
    let (mut before, mut step) = ([0_i64; N], 0_i64);
    for row in rows {
        let mut changes = [0_i64; N];
        let mut changed = 0_i64;
        for column in 0..N {
            let mut change = row[column].wrapping_sub(before[column]);
            if column == 0 {
                (change, step) = (change.wrapping_sub(step), change);
            }
            changes[column] = change;
            changed |= i64::from(change != 0) << column;
        }
        put(&mut out, changed);
        for change in changes.into_iter().filter(|&change| change != 0) {
            put(&mut out, change);
        }
        before = *row;
    }
    out
}

/// Calls `each` with the rows in `bytes`. `None` when they are not what [`encode`] makes of rows of
/// this width; rows before the damage have been handed out by then.
pub(super) fn decode<const N: usize>(
    mut bytes: &[u8],
    mut each: impl FnMut(&[i64; N]),
) -> Option<()> {
    let count = take(&mut bytes)?;
    let (mut row, mut step) = ([0_i64; N], 0_i64);
    for _ in 0..count {
        let changed = take(&mut bytes)?;
        if changed >> N != 0 {
            return None;
        }
        for (column, value) in row.iter_mut().enumerate() {
            let mut change = if changed >> column & 1 == 1 {
                take(&mut bytes)?
            } else {
                0
            };
            if column == 0 {
                step = step.wrapping_add(change);
                change = step;
            }
            *value = value.wrapping_add(change);
        }
        each(&row);
    }
    bytes.is_empty().then_some(())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn back<const N: usize>(bytes: &[u8]) -> Option<Vec<[i64; N]>> {
        let mut rows = Vec::new();
        decode(bytes, |row| rows.push(*row))?;
        Some(rows)
    }

    #[test]
    fn the_ends_of_the_range_survive() {
        let rows = [[i64::MIN, i64::MAX], [i64::MAX, i64::MIN], [0, -1]];
        assert_eq!(back(&encode(&rows)), Some(rows.to_vec()));
        assert_eq!(back::<2>(&encode::<2>(&[])), Some(vec![]));
    }

    #[test]
    fn an_idle_robot_costs_a_byte_per_row() {
        let rows: Vec<[i64; 11]> = (0..1_000)
            .map(|n| {
                [
                    1_700_000_000_000 + n * 200,
                    5,
                    6,
                    7,
                    8,
                    9,
                    10,
                    11,
                    12,
                    13,
                    14,
                ]
            })
            .collect();
        assert!(encode(&rows).len() < 1_050);
    }

    #[test]
    fn nonsense_is_refused() {
        for bytes in [
            &[][..],
            &[2],
            // One row whose columns beyond the second changed.
            &[2, 8, 2],
            // No number ends there.
            &[0xff; 11],
            // Something follows.
            &[0, 0],
        ] {
            assert_eq!(back::<2>(bytes), None, "{bytes:?}");
        }
    }

    proptest! {
        #[test]
        fn any_rows_survive(rows in prop::collection::vec(any::<[i64; 5]>(), 0..50)) {
            prop_assert_eq!(back(&encode(&rows)), Some(rows));
        }

        #[test]
        fn any_bytes_are_rows_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = back::<11>(&bytes);
        }
    }
}

//! The table, its profiles and its page.

use proptest::prelude::*;

use super::*;

#[test]
fn the_page_in_the_documentation_is_the_table() {
    let written = include_str!("../../../../docs/parameters.md");
    assert!(
        written == page(),
        "write it anew: cargo run -p crawler-sim --example parameters > docs/parameters.md"
    );
}

#[test]
fn every_number_has_a_row_of_its_own() {
    let nominal = Parameters::default();
    let value = serde_json::to_value(nominal).expect("it serialises");
    let mut keys = Vec::new();
    for (section, fields) in value.as_object().expect("sections") {
        for (field, value) in fields.as_object().expect("fields") {
            if value.is_number() {
                keys.push(format!("{section}.{field}"));
            }
        }
    }
    let mut rows: Vec<String> = TABLE.iter().map(|row| row.key.to_owned()).collect();
    keys.sort_unstable();
    rows.sort_unstable();
    assert_eq!(keys, rows);
}

#[test]
fn every_row_reads_and_writes_its_own_field() {
    for row in TABLE {
        let mut changed = Parameters::default();
        let value = row.nominal() + 1.0;
        row.set(&mut changed, value);
        assert!(row.value(&changed) == value, "{}", row.key);
        row.set(&mut changed, row.nominal());
        assert_eq!(changed, Parameters::default(), "{}", row.key);
        for text in [row.unit, row.meaning, row.source] {
            assert!(!text.is_empty() && !text.contains('|'), "{}", row.key);
        }
        for bound in [row.least, row.most] {
            if let Bound::Of(key) = bound {
                let place = |key| TABLE.iter().position(|row| row.key == key);
                let of = place(key).expect("a key of the table");
                assert!(
                    place(row.key) > Some(of),
                    "{} is drawn before {key}",
                    row.key
                );
            }
        }
    }
}

#[test]
fn what_is_out_of_range_is_refused_by_name() {
    for row in TABLE {
        let (least, most) = row.range(&Parameters::default());
        let whole = row.value(&{
            let mut half = Parameters::default();
            row.set(&mut half, 0.5);
            half
        }) != 0.5;
        let mut wrong = vec![most + 1.0];
        if !whole {
            wrong.extend([f32::NAN, f32::INFINITY, f32::NEG_INFINITY, least - 1.0]);
        }
        for value in wrong {
            let mut parameters = Parameters::default();
            row.set(&mut parameters, value);
            let error = parameters.validate().expect_err(row.key);
            assert!(error.to_string().contains('.'), "{error}");
        }
    }
}

#[test]
fn a_wilder_profile_reaches_at_least_as_far() {
    for row in TABLE {
        let reach = |vary: Vary| match vary {
            Vary::Fixed => (row.nominal(), row.nominal()),
            Vary::Times(share) => (row.nominal() * (1.0 - share), row.nominal() * (1.0 + share)),
            Vary::Plus(by) => (row.nominal() - by, row.nominal() + by),
            Vary::Within(least, most) => (least, most),
        };
        let (mild, wild) = (reach(row.mild), reach(row.wild));
        // A share of a number that cannot exceed its range is cut there.
        let (least, most) = row.range(&Parameters::default());
        assert!(
            wild.0.max(least) <= mild.0.max(least) && wild.1.min(most) >= mild.1.min(most),
            "{}: {mild:?} {wild:?}",
            row.key
        );
    }
}

proptest! {
    #[test]
    fn drawn_parameters_are_sound_and_come_from_the_seed(seed: u64, other: u64) {
        let nominal = Parameters::default();
        prop_assert_eq!(nominal.randomised(Profile::None, seed), nominal);
        for profile in [Profile::Mild, Profile::Wild] {
            let drawn = nominal.randomised(profile, seed);
            prop_assert_eq!(drawn.validate(), Ok(()));
            prop_assert_eq!(drawn, nominal.randomised(profile, seed));
            prop_assert!(seed == other || drawn != nominal.randomised(profile, other));
        }
    }

    /// Whatever a scenario says, as long as it is sound, stays so.
    #[test]
    fn the_edges_of_the_ranges_stay_sound(seed: u64, sides in proptest::collection::vec(0.0..=1.0_f32, TABLE.len())) {
        let mut edge = Parameters::default();
        for (row, side) in TABLE.iter().zip(sides) {
            let (least, most) = row.range(&edge);
            let value = if side < 0.3 { least } else if side > 0.7 { most } else { least + (most - least) * side };
            row.set(&mut edge, value);
        }
        prop_assume!(edge.validate().is_ok());
        for profile in Profile::ALL {
            prop_assert_eq!(edge.randomised(profile, seed).validate(), Ok(()));
        }
    }
}

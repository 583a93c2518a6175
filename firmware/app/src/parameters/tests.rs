//! The table, setting, and the form in flash.

use crawler_protocol::{ParameterValue, ParameterValues, Reason};
use proptest::prelude::*;

use super::{
    Definition, Domain, ENCODED_MAX, MAX_TEXT, PARAMETER_COUNT, Parameter, Parameters, TABLE,
};

fn values<const N: usize>(pairs: [(&str, ParameterValue); N]) -> ParameterValues {
    pairs
        .into_iter()
        .map(|(name, value)| (name.try_into().expect("short"), value))
        .collect()
}

fn number(value: f32) -> ParameterValue {
    ParameterValue::Number(value)
}

fn text(value: &str) -> ParameterValue {
    ParameterValue::Text(value.try_into().expect("short"))
}

#[test]
fn the_table_is_in_order_and_its_defaults_are_legal() {
    for (index, definition) in TABLE.iter().enumerate() {
        assert_eq!(definition.parameter as usize, index, "{}", definition.name);
        let same =
            |other: &&Definition| other.name == definition.name || other.key == definition.key;
        assert_eq!(TABLE.iter().filter(same).count(), 1, "{}", definition.name);
        if let Domain::Number {
            default, min, max, ..
        } = definition.domain
        {
            assert!(definition.domain.admits(default), "{}", definition.name);
            assert!(min < max, "{}", definition.name);
        }
    }
    let defaults = Parameters::default();
    assert!(defaults.check_consistent().is_ok());
    assert_eq!(defaults.iter().count(), PARAMETER_COUNT);
}

#[test]
fn setting_takes_effect_and_counts_a_version() {
    let before = Parameters::default();
    let after = before
        .with(&values([
            ("safe_distance_mm", number(800.0)),
            ("avoidance", ParameterValue::Bool(false)),
            ("name", text("bob")),
        ]))
        .expect("legal");
    assert_eq!(after.number(Parameter::SafeDistance), 800.0);
    assert!(!after.switch(Parameter::Avoidance));
    assert_eq!(after.name(), "bob");
    assert_ne!(after.version(), before.version());
}

#[test]
fn setting_is_all_or_nothing_with_the_exact_reason() {
    let cases = [
        (
            values([("speed_of_light", number(1.0))]),
            Reason::UnknownParameter,
        ),
        (
            values([("max_speed", ParameterValue::Bool(true))]),
            Reason::WrongType,
        ),
        (values([("avoidance", number(1.0))]), Reason::WrongType),
        (values([("name", number(1.0))]), Reason::WrongType),
        (values([("max_speed", number(0.0))]), Reason::OutOfRange),
        (
            values([("max_speed", number(f32::NAN))]),
            Reason::OutOfRange,
        ),
        (
            values([("max_speed", number(f32::INFINITY))]),
            Reason::OutOfRange,
        ),
        (
            values([("safe_distance_mm", number(600.5))]),
            Reason::OutOfRange,
        ),
        (values([("name", text("quo\"te"))]), Reason::OutOfRange),
        (values([("name", text("ümlaut"))]), Reason::OutOfRange),
        (
            values([("name", text("a name longer than twenty-four"))]),
            Reason::OutOfRange,
        ),
        (
            values([("max_speed", number(0.4)), ("max_speed", number(0.3))]),
            Reason::DuplicateField,
        ),
        // The critical distance must stay below the safe one, whichever of them is set.
        (
            values([("safe_distance_mm", number(250.0))]),
            Reason::OutOfRange,
        ),
        (
            values([("critical_distance_mm", number(600.0))]),
            Reason::OutOfRange,
        ),
        (
            values([("low_battery_mv", number(6_700.0))]),
            Reason::OutOfRange,
        ),
        // A good value beside a bad one.
        (
            values([("max_turn", number(2.0)), ("max_speed", number(99.0))]),
            Reason::OutOfRange,
        ),
    ];
    let before = Parameters::default();
    for (values, reason) in cases {
        assert_eq!(before.with(&values), Err(reason), "{values:?}");
    }
    // Both together go together.
    let both = values([
        ("critical_distance_mm", number(700.0)),
        ("safe_distance_mm", number(900.0)),
    ]);
    assert!(before.with(&both).is_ok());
}

#[test]
fn everything_persistent_survives_flash_and_nothing_else_does() {
    let set = values([
        ("name", text("a name of 24 characters!")),
        ("max_speed", number(0.33)),
        ("avoidance", ParameterValue::Bool(false)),
        ("low_battery_mv", number(7_100.0)),
    ]);
    let parameters = Parameters::default().with(&set).expect("legal");
    let mut buffer = [0; ENCODED_MAX];
    let (loaded, dropped) = Parameters::decode(parameters.encode(&[], &mut buffer));
    assert_eq!(dropped, 0);
    assert_eq!(loaded.name().len(), MAX_TEXT);
    for definition in &TABLE {
        if definition.persistent {
            let parameter = definition.parameter;
            assert_eq!(loaded.number(parameter), parameters.number(parameter));
        }
    }
    assert!(loaded.switch(Parameter::Avoidance), "on again after a boot");
    assert!(!loaded.differs_in_flash(&parameters));
}

#[test]
fn what_a_newer_program_has_stored_is_passed_over_and_kept() {
    let parameters = Parameters::default()
        .with(&values([("max_speed", number(0.33))]))
        .expect("legal");
    let mut buffer = [0; ENCODED_MAX];
    let stored = std::vec::Vec::from(parameters.encode(&[], &mut buffer));
    // A number that this program does not know, before what it knows, and a text behind it.
    let newer = [
        &[100, 1, 2, 3, 4],
        &stored[..],
        &[200, 3, b'n', b'e', b'w'],
        &[255, 0],
    ]
    .concat();
    let (loaded, dropped) = Parameters::decode(&newer);
    assert_eq!(dropped, 0);
    assert_eq!(loaded.number(Parameter::MaxSpeed), 0.33);

    let changed = loaded
        .with(&values([("max_turn", number(2.0))]))
        .expect("legal");
    let mut buffer = [0; ENCODED_MAX];
    let rewritten = changed.encode(&newer, &mut buffer);
    let kept = [100, 1, 2, 3, 4, 200, 3, b'n', b'e', b'w', 255, 0];
    assert!(rewritten.ends_with(&kept), "{rewritten:?}");
    assert_eq!(rewritten.len(), stored.len() + kept.len());
    assert_eq!(
        Parameters::decode(rewritten).0.number(Parameter::MaxTurn),
        2.0
    );

    // Cut off anywhere, what came before is kept.
    for len in 0..newer.len() {
        let (loaded, _) = Parameters::decode(&newer[..len]);
        assert!(loaded.check_consistent().is_ok());
    }
}

#[test]
fn a_key_tells_how_long_its_value_is() {
    for definition in &TABLE {
        let text = matches!(definition.domain, Domain::Text { .. });
        let sized = definition.key >= super::stored::SIZED || definition.key == super::NAME_KEY;
        assert_eq!(text, sized, "{}", definition.name);
    }
}

proptest! {
    /// Whatever flash holds, what is loaded is legal.
    #[test]
    fn no_bytes_lead_to_illegal_parameters(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let (loaded, _) = Parameters::decode(&bytes);
        check_legal(&loaded)?;
    }

    /// Whatever flash holds, rewriting it keeps what is unknown, as far as there is room, and in order.
    #[test]
    fn rewriting_keeps_what_is_unknown(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let unknown = |item: &[u8]| {
            super::stored::Entries::new(item, super::NAME_KEY)
                .filter(|entry| super::by_key(entry.key).is_none())
                .map(|entry| entry.bytes.to_vec())
                .collect::<std::vec::Vec<_>>()
        };
        let mut buffer = [0; ENCODED_MAX];
        let rewritten = Parameters::default().encode(&bytes, &mut buffer);
        let (before, after) = (unknown(&bytes), unknown(rewritten));
        prop_assert!(before.starts_with(&after));
        if let Some(lost) = before.get(after.len()) {
            prop_assert!(rewritten.len() + lost.len() > ENCODED_MAX);
        }
    }

    /// The same with keys that exist, so that values are reached.
    #[test]
    fn no_values_lead_to_illegal_parameters(
        items in prop::collection::vec((0_u8..20, any::<f32>()), 0..20),
    ) {
        let mut bytes = std::vec::Vec::new();
        for (key, value) in items {
            bytes.push(key);
            bytes.extend(value.to_le_bytes());
        }
        let (loaded, _) = Parameters::decode(&bytes);
        check_legal(&loaded)?;
    }
}

fn check_legal(parameters: &Parameters) -> Result<(), TestCaseError> {
    prop_assert!(parameters.check_consistent().is_ok());
    for definition in &TABLE {
        let value = parameters.number(definition.parameter);
        match definition.domain {
            Domain::Number { .. } => prop_assert!(definition.domain.admits(value)),
            Domain::Switch { .. } => prop_assert!(value == 0.0 || value == 1.0),
            Domain::Text { max_len } => prop_assert!(parameters.name().len() <= max_len),
        }
    }
    Ok(())
}

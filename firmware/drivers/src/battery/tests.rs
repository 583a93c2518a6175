use proptest::prelude::*;

use super::curve::{TABLE, open_circuit_voltage, state_of_charge};
use super::*;

const STANDARD: Config = Config::STANDARD;

fn every_voltage() -> impl Iterator<Item = Millivolts> {
    (0..=u16::MAX).map(Millivolts)
}

/// The voltage at the pin of a pack of `pack_mv`.
fn pin(pack_mv: u16) -> Millivolts {
    STANDARD.divider.pin(Millivolts(pack_mv))
}

/// A gauge that has settled at `pack_mv`.
fn settled(pack_mv: u16) -> (Gauge, Reading) {
    let mut gauge = Gauge::new(STANDARD);
    let reading = gauge.update(pin(pack_mv));
    assert_eq!(gauge.reading(), Some(reading));
    (gauge, reading)
}

#[test]
fn every_pin_voltage_is_scaled_right() {
    for (top, bottom) in [
        (100_000, 47_000),
        (1, 1),
        (220_000, 100_000),
        (u32::MAX, 1 << 20),
        (u32::MAX, u32::MAX),
    ] {
        let divider = Divider::new(top, bottom, Millivolts(u16::MAX)).unwrap();
        let ratio = (f64::from(top) + f64::from(bottom)) / f64::from(bottom);
        for pin in every_voltage() {
            let want = (f64::from(pin.0) * ratio).min(65_535.0);
            let pack = divider.pack(pin);
            assert!((f64::from(pack.0) - want).abs() <= 0.501, "{pin:?}");
            let back = divider.pin(pack);
            assert!(
                pack.0 == u16::MAX || back == pin,
                "{pin:?} came back as {back:?}"
            );
        }
    }
}

#[test]
fn dividers_that_cannot_work_are_refused() {
    let limit = Millivolts(3_100);
    let refused = |top, bottom| Divider::new(top, bottom, limit).unwrap_err();
    assert_eq!(refused(0, 47_000), ConfigError::Resistor);
    assert_eq!(refused(100_000, 0), ConfigError::Resistor);
    // 3.1 V at the pin are 7.85 V of the pack: a full one could not be told.
    assert_eq!(refused(72_000, 47_000), ConfigError::PinRange);
    assert!(Divider::new(84_000, 47_000, limit).is_ok());
    assert_eq!(refused(83_000, 47_000), ConfigError::PinRange);
}

#[test]
fn thresholds_out_of_order_are_refused() {
    let make = |low, critical, hysteresis| {
        Thresholds::new(
            Millivolts(low),
            Millivolts(critical),
            Millivolts(hysteresis),
        )
    };
    for (low, critical, hysteresis, good) in [
        (7_000, 6_600, 200, true),
        (6_800, 6_600, 200, true),
        (6_799, 6_600, 200, false),
        (6_600, 7_000, 200, false),
        (7_000, 6_600, 0, false),
        (7_000, 5_001, 200, true),
        (7_000, 5_000, 200, false),
        (8_200, 6_600, 200, true),
        (8_201, 6_600, 200, false),
        (u16::MAX, u16::MAX, u16::MAX, false),
    ] {
        let made = make(low, critical, hysteresis);
        assert_eq!(made.is_ok(), good, "{low} {critical} {hysteresis}");
        assert!(good || made == Err(ConfigError::Thresholds));
    }
}

#[test]
fn the_table_rises() {
    assert!(TABLE.is_sorted_by(|(v0, p0), (v1, p1)| v0 < v1 && p0 < p1));
    assert_eq!((TABLE[0].1, TABLE[TABLE.len() - 1].1), (0, 100));
}

#[test]
fn every_cell_voltage_has_its_charge() {
    let mut last = Percent::default();
    for cell in every_voltage() {
        let charge = state_of_charge(cell);
        assert!(charge >= last, "falls at {cell:?}");
        last = charge;
        // The same curve in floating point, segment by segment.
        let want = TABLE
            .windows(2)
            .find(|row| (row[0].0..=row[1].0).contains(&cell))
            .map_or(if cell.0 < 3_000 { 0.0 } else { 100.0 }, |row| {
                let part = f64::from(cell.0 - row[0].0.0) / f64::from(row[1].0.0 - row[0].0.0);
                f64::from(row[0].1) + part * f64::from(row[1].1 - row[0].1)
            });
        assert!((f64::from(charge.get()) - want).abs() <= 0.501, "{cell:?}");
    }
    assert_eq!(last, Percent::FULL);
}

#[test]
fn every_charge_survives_the_way_through_its_voltage() {
    for value in 0..=100 {
        let charge = Percent::new(value).unwrap();
        assert_eq!(state_of_charge(open_circuit_voltage(charge)), charge);
    }
}

#[test]
fn every_first_reading_is_classified() {
    // Halves hit each limit to the millivolt, which the standard divider steps over.
    let halves = Config {
        divider: Divider::new(1, 1, Millivolts(u16::MAX)).unwrap(),
        ..STANDARD
    };
    let each = |config| every_voltage().map(move |pin| (config, pin));
    for (config, pin) in each(STANDARD).chain(each(halves)) {
        let pack = config.divider.pack(pin);
        let reading = Gauge::new(config).update(pin);
        let want = match pack.0 {
            0..1_000 => Charge::Absent,
            1_000..5_000 | 8_601.. => Charge::Absurd,
            5_000..6_600 => Charge::Critical,
            6_600..7_000 => Charge::Low,
            7_000..=8_600 => Charge::Ok,
        };
        assert_eq!((reading.charge, reading.pack), (want, pack), "{pin:?}");
        let percent = match want {
            Charge::Absent | Charge::Absurd => Percent::default(),
            Charge::Ok | Charge::Low | Charge::Critical => state_of_charge(Millivolts(pack.0 / 2)),
        };
        assert_eq!(reading.percent, percent);
    }
}

#[test]
fn every_class_has_its_hysteresis() {
    let thresholds = &STANDARD.thresholds;
    for pack in every_voltage() {
        let classify = |before| classify(before, pack, thresholds);
        let fresh = match pack.0 {
            0..6_600 => Charge::Critical,
            6_600..7_000 => Charge::Low,
            7_000.. => Charge::Ok,
        };
        for before in [
            None,
            Some(Charge::Ok),
            Some(Charge::Absent),
            Some(Charge::Absurd),
        ] {
            assert_eq!(classify(before), fresh, "{pack:?} after {before:?}");
        }
        let after_low = match pack.0 {
            0..6_600 => Charge::Critical,
            6_600..7_200 => Charge::Low,
            7_200.. => Charge::Ok,
        };
        assert_eq!(classify(Some(Charge::Low)), after_low, "{pack:?}");
        let after_critical = match pack.0 {
            0..6_800 => Charge::Critical,
            6_800..7_200 => Charge::Low,
            7_200.. => Charge::Ok,
        };
        assert_eq!(classify(Some(Charge::Critical)), after_critical, "{pack:?}");
    }
}

#[test]
fn the_filter_gets_there_and_not_at_once() {
    let (mut gauge, _) = settled(8_000);
    let first = gauge.update(pin(7_200)).pack;
    assert!(
        (7_895..=7_905).contains(&first.0),
        "{first:?}: an eighth of the way"
    );
    for _ in 0..7 {
        gauge.update(pin(7_200));
    }
    // (7/8)^8 = 0.34 of the step is left after one time constant.
    let pack = gauge.reading().unwrap().pack;
    assert!((7_465..=7_483).contains(&pack.0), "{pack:?}");
    for _ in 0..80 {
        gauge.update(pin(7_200));
    }
    let pack = gauge.reading().unwrap().pack;
    assert!(pack.0.abs_diff(7_200) <= 2, "{pack:?}");
}

#[test]
fn the_filter_rests_on_every_level_it_is_given() {
    for start in [5_000, 6_700, 8_600] {
        for level in (5_000..=8_600).map(Millivolts) {
            let mut filter = Filter::start(Millivolts(start));
            for _ in 0..120 {
                filter = filter.push(level);
            }
            assert_eq!(filter.value(), level, "from {start}");
        }
    }
}

#[test]
fn one_glitch_is_no_state() {
    let (mut gauge, before) = settled(7_600);
    for glitch in [0, 300, 4_000, 20_000, u16::MAX] {
        assert_eq!(gauge.update(Millivolts(glitch)), before, "{glitch}");
        assert_eq!(gauge.missed(), before);
        assert_eq!(gauge.update(pin(7_600)), before);
    }
}

#[test]
fn a_pack_that_goes_and_comes_back() {
    let (mut gauge, before) = settled(7_600);
    assert_eq!(gauge.update(Millivolts(5)), before);
    assert_eq!(gauge.update(Millivolts(5)), before);
    let gone = gauge.update(Millivolts(5));
    assert_eq!(gone.charge, Charge::Absent);
    assert_eq!(gone.percent, Percent::default());
    // Once there is nothing to hold, a change counts at once.
    assert_eq!(gauge.update(Millivolts(1_000)).charge, Charge::Absurd);
    // And the filter remembers nothing of the pack before.
    let back = gauge.update(pin(6_700));
    assert_eq!(back.charge, Charge::Low);
    assert!(back.pack.0.abs_diff(6_700) <= 2);
}

#[test]
fn a_converter_that_died_is_a_state() {
    let mut gauge = Gauge::new(STANDARD);
    assert_eq!(gauge.reading(), None);
    assert_eq!(gauge.missed().charge, Charge::Absurd);
    let (mut gauge, before) = settled(7_600);
    for _ in 0..2 {
        assert_eq!(gauge.missed(), before);
    }
    for _ in 0..300 {
        assert_eq!(gauge.missed().charge, Charge::Absurd);
    }
    assert_eq!(gauge.update(pin(7_600)).charge, Charge::Ok);
}

#[test]
fn other_thresholds_count_from_the_next_voltage_on() {
    let limits = |low, critical| {
        Thresholds::new(Millivolts(low), Millivolts(critical), Millivolts(200)).unwrap()
    };
    let (mut gauge, before) = settled(7_400);
    assert_eq!(before.charge, Charge::Ok);
    gauge.set_thresholds(limits(7_800, 7_500));
    assert_eq!(gauge.reading(), Some(before));
    let after = gauge.update(pin(7_400));
    assert_eq!((after.charge, after.pack), (Charge::Critical, before.pack));
    // Within the hysteresis of the new ones, and the class is the old one.
    gauge.set_thresholds(limits(7_700, 7_300));
    assert_eq!(gauge.update(pin(7_400)).charge, Charge::Critical);
    gauge.set_thresholds(limits(7_000, 6_600));
    assert_eq!(gauge.update(pin(7_400)).charge, Charge::Ok);
}

#[test]
fn a_discharge_passes_the_classes_once() {
    let (mut gauge, first) = settled(8_300);
    let mut charge = first.charge;
    let mut seen = std::vec![charge];
    for second in 0..3_000_u16 {
        // Down by 1 mV a second, with the motors' sag of 80 mV every other second.
        let reading = gauge.update(pin(8_300 - second - second % 2 * 80));
        if reading.charge != charge {
            charge = reading.charge;
            seen.push(charge);
        }
    }
    assert_eq!(seen, [Charge::Ok, Charge::Low, Charge::Critical]);
}

proptest! {
    /// Whatever comes in: no panic, percents only where there is a pack, and the classes follow
    /// the voltage told.
    #[test]
    fn a_reading_never_contradicts_itself(
        voltages in prop::collection::vec(prop::option::of(prop_oneof![
            any::<u16>(),
            1_500..3_000_u16,
        ]), 1..60),
    ) {
        let mut gauge = Gauge::new(STANDARD);
        for voltage in voltages {
            let reading = match voltage {
                Some(mv) => gauge.update(Millivolts(mv)),
                None => gauge.missed(),
            };
            prop_assert_eq!(gauge.reading(), Some(reading));
            let pack = reading.pack.0;
            match reading.charge {
                Charge::Ok => prop_assert!((7_000..=8_600).contains(&pack)),
                Charge::Low => prop_assert!((6_600..7_200).contains(&pack)),
                Charge::Critical => prop_assert!((5_000..6_800).contains(&pack)),
                Charge::Absent | Charge::Absurd => {
                    prop_assert_eq!(reading.percent, Percent::default());
                }
            }
        }
    }
}

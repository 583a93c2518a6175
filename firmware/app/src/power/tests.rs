//! What the battery means for driving and for the flash.

use crawler_drivers::battery::Config;
use crawler_hal::Millivolts;
use crawler_protocol::ParameterValue;

use super::Monitor;
use crate::parameters::Parameters;
use crate::perception::{Battery, Charge};

fn pin(pack_mv: u16) -> Millivolts {
    Config::STANDARD.divider.pin(Millivolts(pack_mv))
}

fn settle(monitor: &mut Monitor, pack_mv: u16) -> Battery {
    for _ in 0..100 {
        monitor.observe(Some(pin(pack_mv)));
    }
    monitor.battery()
}

#[test]
fn first_caution_then_a_stop() {
    let mut monitor = Monitor::new(&Parameters::default());
    assert_eq!(monitor.battery().charge, Charge::Unknown);
    assert_eq!(settle(&mut monitor, 7_800).charge, Charge::Good);
    assert_eq!(settle(&mut monitor, 6_900).charge, Charge::Low);
    assert_eq!(settle(&mut monitor, 6_500).charge, Charge::Critical);
    // Recovering a little when the motors stop is not recovering.
    assert_eq!(settle(&mut monitor, 6_700).charge, Charge::Critical);
    assert_eq!(settle(&mut monitor, 7_800).charge, Charge::Good);
}

#[test]
fn limits_follow_the_parameters() {
    let values = [(
        "low_battery_mv".try_into().expect("short"),
        ParameterValue::Number(7_500.0),
    )];
    let values = values.into_iter().collect();
    let parameters = Parameters::default().with(&values).expect("legal");
    let mut monitor = Monitor::new(&Parameters::default());
    assert_eq!(settle(&mut monitor, 7_300).charge, Charge::Good);
    monitor.adjust(&parameters);
    assert_eq!(settle(&mut monitor, 7_300).charge, Charge::Low);
}

#[test]
fn setting_parameters_charges_no_battery() {
    let mut monitor = Monitor::new(&Parameters::default());
    assert_eq!(settle(&mut monitor, 6_500).charge, Charge::Critical);
    assert_eq!(settle(&mut monitor, 6_700).charge, Charge::Critical);
    monitor.adjust(&Parameters::default());
    assert_eq!(monitor.battery().charge, Charge::Critical);
    assert_eq!(settle(&mut monitor, 6_700).charge, Charge::Critical);
}

#[test]
fn the_flash_minds_one_dip() {
    let mut monitor = Monitor::new(&Parameters::default());
    assert!(!settle(&mut monitor, 7_800).brown_out);
    let dip = monitor.observe(Some(pin(5_800)));
    assert!(dip.brown_out, "although the mean is {:?}", dip.voltage);
    assert_eq!(dip.charge, Charge::Good);
    assert!(!settle(&mut monitor, 7_800).brown_out);
}

#[test]
fn usb_alone_is_no_brown_out_and_a_dead_gauge_means_care() {
    let mut monitor = Monitor::new(&Parameters::default());
    let usb = settle(&mut monitor, 0);
    assert_eq!(
        (usb.charge, usb.brown_out, usb.voltage),
        (Charge::Unknown, false, None)
    );
    let mut monitor = Monitor::new(&Parameters::default());
    settle(&mut monitor, 7_800);
    for _ in 0..5 {
        monitor.observe(None);
    }
    let lost = monitor.battery();
    assert_eq!((lost.charge, lost.percent), (Charge::Low, None));
}

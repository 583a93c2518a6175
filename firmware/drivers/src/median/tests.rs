use std::vec::Vec;

use proptest::prelude::*;

use super::*;

fn sorted_middle(window: &[u16]) -> u16 {
    let mut sorted = window.to_vec();
    sorted.sort_unstable();
    sorted[(sorted.len() - 1) / 2]
}

fn check<const N: usize>(ranges: &[u16]) {
    let mut filter = Median::<N>::new();
    for end in 1..=ranges.len() {
        let want = Millimeters(sorted_middle(&ranges[end.saturating_sub(N)..end]));
        assert_eq!(filter.push(Millimeters(ranges[end - 1])), want);
        assert_eq!(filter.median(), Some(want));
    }
}

#[test]
fn every_sequence_of_six_levels() {
    for code in 0..6_u32.pow(6) {
        let ranges: Vec<u16> = (0..6).map(|at| (code / 6_u32.pow(at) % 6) as u16).collect();
        check::<3>(&ranges);
    }
}

#[test]
fn empty_until_the_first_and_again_after_a_gap() {
    let mut filter = Median::<3>::default();
    assert_eq!(filter.median(), None);
    for range in [10, 20, 30, 40] {
        filter.push(Millimeters(range));
    }
    filter.clear();
    assert_eq!(filter.median(), None);
    assert_eq!(filter.push(Millimeters(900)), Millimeters(900));
}

#[test]
fn one_wild_reading_does_not_show() {
    let mut filter = Median::<5>::new();
    for range in [800, 810, 805, 65_535, 795, 0, 800, 790] {
        let median = filter.push(Millimeters(range));
        assert!((790..=810).contains(&median.0), "{median:?}");
    }
}

proptest! {
    #[test]
    fn agrees_with_sorting(ranges in prop::collection::vec(any::<u16>(), 1..40)) {
        check::<1>(&ranges);
        check::<5>(&ranges);
        check::<9>(&ranges);
    }
}

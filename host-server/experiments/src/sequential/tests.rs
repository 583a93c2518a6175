//! What the test promises, exactly where that can be had, and by drawing.

use proptest::prelude::*;

use super::*;

fn test(error: f64, most: u64) -> Test {
    Test::new(error, most).expect("a test")
}

/// Numbers that are the same each time: Steele, Lea and Flood (2014).
struct Draws(u64);

impl Draws {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// What a test comes to where the two succeed with these chances, and after how many pairs.
fn run(test: &Test, draws: &mut Draws, first: f64, second: f64) -> (Standing, Pairs) {
    let mut pairs = Pairs::default();
    loop {
        pairs.add(draws.next() < first, draws.next() < second);
        let standing = test.judge(&pairs);
        if standing != Standing::Open {
            return (standing, pairs);
        }
    }
}

/// With which chance the test ever calls one better within so many pairs in which one alone succeeds, where that is the first
/// with a chance of `first`: all ways together, none left out.
fn decides(test: &Test, pairs: usize, first: f64) -> (f64, f64) {
    let (mut one, mut other) = (0.0, 0.0);
    let mut open = vec![1.0];
    for count in 1..=pairs {
        let mut next = vec![0.0; count + 1];
        for (wins, chance) in open.iter().enumerate() {
            next[wins] += chance * (1.0 - first);
            next[wins + 1] += chance * first;
        }
        // Evidence grows with the distance from half: only ends are decided.
        let told = |wins: usize| {
            test.judge(&Pairs {
                first: wins as u64,
                second: (count - wins) as u64,
                ..Pairs::default()
            })
        };
        for wins in (0..=count)
            .rev()
            .take_while(|&wins| told(wins) == Standing::Better(Side::First))
        {
            one += std::mem::take(&mut next[wins]);
        }
        for wins in (0..=count).take_while(|&wins| told(wins) == Standing::Better(Side::Second)) {
            other += std::mem::take(&mut next[wins]);
        }
        open = next;
    }
    (one, other)
}

#[test]
fn the_bet_is_that_of_krichevsky_and_trofimov() {
    // One after the other: after a of n the next one counts for (a + ½) / (n + 1), against ½.
    for order in ["1101", "0111", "1110"] {
        let (mut evidence, mut wins) = (1.0, 0.0);
        for (n, won) in order.chars().enumerate() {
            let chance = (wins + 0.5) / (n as f64 + 1.0);
            let won = won == '1';
            evidence *= if won { chance } else { 1.0 - chance } / 0.5;
            wins += f64::from(u8::from(won));
        }
        // By hand: ½ · ¾ · ⅚ · ⅛ · 16 = 0.625.
        assert!((evidence - 0.625_f64).abs() < 1e-12, "{order}: {evidence}");
        let pairs = Pairs {
            first: 3,
            second: 1,
            ..Pairs::default()
        };
        assert!((pairs.evidence() - f64::ln(0.625)).abs() < 1e-12);
    }
    assert_eq!(Pairs::default().evidence(), 0.0);
}

#[test]
fn how_many_in_a_row_decide() {
    // n wins in a row come to C(2n, n) / 2ⁿ, which passes 20 at 7 (26.8) and 1,000 at 13 (1,269.6).
    for (error, row) in [(0.05, 7), (0.001, 13)] {
        let test = test(error, 100);
        let mut pairs = Pairs {
            both: 3,
            neither: 5,
            ..Pairs::default()
        };
        for count in 1..=row {
            pairs.add(false, true);
            let wanted = if count < row {
                Standing::Open
            } else {
                Standing::Better(Side::Second)
            };
            assert_eq!(test.judge(&pairs), wanted, "{count}");
        }
    }
}

#[test]
fn where_neither_is_better_it_says_so_seldom_however_often_one_looks() {
    // All of the ways that 4,000 pairs can go: the chance itself, and no estimate of it.
    for error in [0.2, 0.05, 0.01] {
        let (first, second) = decides(&test(error, u64::MAX), 4_000, 0.5);
        assert!((first - second).abs() < 1e-9);
        let wrong = first + second;
        assert!(wrong <= error, "{wrong} for {error}");
        // And not because it never says anything.
        assert!(wrong > error / 5.0, "{wrong} for {error}");
    }
}

#[test]
fn where_one_is_better_it_is_found() {
    // Of pairs that tell, the better one has three of four.
    let (better, worse) = decides(&test(0.05, u64::MAX), 200, 0.75);
    assert!(better > 0.99 && worse < 0.01, "{better} {worse}");
    // A difference that is next to nothing is seldom found, and hardly ever the wrong way round.
    let (better, worse) = decides(&test(0.05, u64::MAX), 200, 0.52);
    assert!(better < 0.2 && worse < 0.025, "{better} {worse}");
}

#[test]
fn what_is_drawn_ends_as_it_should() {
    let test = test(0.05, 1_000);
    let mut draws = Draws(1);
    let mut tell = |first: f64, second: f64| {
        let (mut counts, mut pairs, mut covered) = ([0_u32; 3], 0, 0_usize);
        for _ in 0..1_000 {
            let (standing, told) = run(&test, &mut draws, first, second);
            counts[match standing {
                Standing::Better(Side::First) => 0,
                Standing::Better(Side::Second) => 1,
                Standing::Undecided => 2,
                Standing::Open => unreachable!("it ends"),
            }] += 1;
            assert!(told.count() <= 1_000);
            pairs += told.count();
            let shares = [(Side::First, first), (Side::Second, second)];
            let holds = |(side, share): (Side, f64)| {
                let Interval { low, high } = test.share(told.successes(side), told.count());
                low <= share && share <= high
            };
            covered += usize::from(shares.into_iter().all(holds));
        }
        (counts, pairs / 1_000, covered)
    };
    // Of a thousand tests each: who is called better, after how many pairs, and how often both intervals hold the truth.
    assert_eq!(tell(0.9, 0.9), ([15, 14, 971], 974, 995));
    assert_eq!(tell(0.5, 0.5), ([20, 19, 961], 963, 992));
    assert_eq!(tell(0.96, 0.86), ([1_000, 0, 0], 138, 997));
    assert_eq!(tell(0.81, 0.86), ([1, 456, 543], 773, 998));
}

#[test]
fn shares_are_told_as_far_as_they_are_known() {
    let test = test(0.05, 100);
    assert_eq!(
        test.share(0, 0),
        Interval {
            low: 0.0,
            high: 1.0
        }
    );
    let none = test.share(0, 30);
    assert!(none.low == 0.0 && none.high < 0.3, "{none:?}");
    let all = test.share(30, 30);
    assert!((1.0 - all.high).abs() < 1e-12 && (1.0 - all.low - none.high).abs() < 1e-9);
    // More than there were is all of them.
    assert_eq!(test.share(40, 30), test.share(40, 40));
}

#[test]
fn a_test_has_a_chance_and_an_end() {
    for (error, most) in [(0.0, 1), (1.0, 1), (-0.1, 1), (f64::NAN, 1), (0.05, 0)] {
        assert_eq!(Test::new(error, most), None);
    }
}

proptest! {
    /// Where neither is better a stake does not grow on average: that is what Ville's inequality needs.
    #[test]
    fn a_stake_is_worth_what_comes_after_it(first in 0_u64..5_000, second in 0_u64..5_000, both in 0_u64..100) {
        let pairs = Pairs { both, first, second, neither: 0 };
        let after = |first_won| {
            let mut pairs = pairs;
            pairs.add(first_won, !first_won);
            (pairs.evidence() - Pairs { both, first, second, neither: 0 }.evidence()).exp()
        };
        prop_assert!((f64::midpoint(after(true), after(false)) - 1.0).abs() < 1e-6);
    }

    /// Whatever happens: an end, after no more pairs than asked for, the same for both sides, whoever is called first.
    #[test]
    fn every_test_ends(wins in prop::collection::vec(any::<(bool, bool)>(), 300), most in 1_u64..300, error in 0.001_f64..0.5) {
        let test = test(error, most);
        let (mut pairs, mut turned) = (Pairs::default(), Pairs::default());
        let mut end = None;
        for (first, second) in wins {
            pairs.add(first, second);
            turned.add(second, first);
            let standing = test.judge(&pairs);
            let wanted = match standing {
                Standing::Better(Side::First) => Standing::Better(Side::Second),
                Standing::Better(Side::Second) => Standing::Better(Side::First),
                other => other,
            };
            prop_assert_eq!(test.judge(&turned), wanted);
            if standing != Standing::Open {
                end = Some(pairs);
                break;
            }
        }
        let end = end.expect("it ends");
        prop_assert!(end.count() <= most);
        prop_assert_eq!(end.count(), end.both + end.first + end.second + end.neither);
        // Called better is who has more.
        if let Standing::Better(side) = test.judge(&end) {
            prop_assert_eq!(side == Side::First, end.successes(Side::First) > end.successes(Side::Second));
        }
    }

    /// Ends of an interval are where they should be, and nearer to each other for whoever may be wrong more often.
    #[test]
    fn intervals_hold_what_was_seen(count in 1_u64..100_000, part in 0.0_f64..=1.0, error in 0.001_f64..0.5) {
        let successes = (part * count as f64) as u64;
        let share = successes as f64 / count as f64;
        let wide = test(error, 1).share(successes, count);
        let narrow = test(error * 1.9, 1).share(successes, count);
        prop_assert!(0.0 <= wide.low && wide.low <= share && share <= wide.high && wide.high <= 1.0);
        prop_assert!(wide.low <= narrow.low && narrow.high <= wide.high);
    }
}

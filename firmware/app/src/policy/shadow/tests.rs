//! What is counted, from when, and how far.

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use proptest::prelude::*;
use std::vec::Vec;

use super::*;

type TestShadows = Shadows<NoopRawMutex>;

const DRIVING: u32 = 7;

fn begun(name: &str) -> TestShadows {
    let shadows = TestShadows::new();
    shadows.begin(Some(&PolicyName::new(name).expect("a name")));
    shadows
}

/// Decisions, agreements, vetoes of the candidate and of the policy that drives.
fn counts(shadows: &TestShadows) -> Option<[u32; 4]> {
    let told = shadows.told()?;
    Some([
        told.decisions,
        told.agreed,
        told.vetoes,
        told.driving_vetoes,
    ])
}

fn compared(agree: bool, vetoed: bool, driving_vetoed: bool) -> Compared {
    Compared {
        agree,
        vetoed,
        driving_vetoed,
    }
}

#[test]
fn nothing_is_counted_before_it_begins_nor_after_it_ends() {
    let shadows = TestShadows::new();
    assert_eq!((shadows.candidate(DRIVING), shadows.told()), (None, None));
    let shadows = begun("gather");
    let candidate = shadows.candidate(DRIVING).expect("there is one");
    assert_eq!(candidate.name, named("gather"));
    assert_eq!(
        shadows.candidate(named("gather")),
        None,
        "nobody beside itself"
    );
    shadows.count(candidate, DRIVING, compared(true, true, false));
    assert_eq!(counts(&shadows), Some([1, 1, 1, 0]));
    shadows.begin(None);
    shadows.count(candidate, DRIVING, compared(true, true, false));
    assert_eq!((shadows.candidate(DRIVING), shadows.told()), (None, None));
}

#[test]
fn what_has_begun_anew_counts_nothing_from_before() {
    let shadows = begun("gather");
    let before = shadows.candidate(DRIVING).expect("there is one");
    for _ in 0..2 {
        shadows.count(before, DRIVING, compared(false, false, true));
    }
    assert_eq!(counts(&shadows), Some([2, 0, 0, 2]));
    let again = PolicyName::new("gather").expect("a name");
    let ways: [&dyn Fn(); 2] = [&|| shadows.begin_anew(), &|| shadows.begin(Some(&again))];
    for begin in ways {
        begin();
        assert_eq!(counts(&shadows), Some([0; 4]));
        // Of a network that was under way.
        shadows.count(before, DRIVING, compared(true, true, true));
        assert_eq!(counts(&shadows), Some([0; 4]));
        let now = shadows.candidate(DRIVING).expect("there is one");
        shadows.count(now, DRIVING, compared(true, true, true));
        assert_eq!(counts(&shadows), Some([1; 4]));
        // Another policy drives: that is another comparison.
        shadows.count(now, DRIVING + 1, compared(true, false, false));
        assert_eq!(counts(&shadows), Some([1, 1, 0, 0]));
    }
    TestShadows::new().begin_anew();
}

#[test]
fn counts_stay_where_they_are_once_they_are_full() {
    let shadows = begun("gather");
    let candidate = shadows.candidate(DRIVING).expect("there is one");
    shadows.count(candidate, DRIVING, compared(true, true, false));
    shadows.with(|comparison| {
        let told = &mut comparison.as_mut().expect("begun").told;
        (told.decisions, told.agreed, told.vetoes) = (u32::MAX - 1, u32::MAX - 9, 5);
    });
    for _ in 0..3 {
        shadows.count(candidate, DRIVING, compared(true, true, true));
        assert_eq!(counts(&shadows), Some([u32::MAX, u32::MAX - 8, 6, 1]));
    }
}

proptest! {
    /// Whatever happens, nothing is counted that was not decided, and of each decision what there is to count.
    #[test]
    fn counts_are_those_of_the_decisions_since_it_began(
        happens in prop::collection::vec((0..12_u8, any::<[bool; 3]>(), 0..3_u32), 0..200),
    ) {
        let shadows = begun("gather");
        let (mut since, mut driving): (Vec<Compared>, Option<u32>) = (Vec::new(), None);
        for (what, [agree, vetoed, driving_vetoed], who) in happens {
            if what == 0 {
                shadows.begin_anew();
                (since, driving) = (Vec::new(), None);
            }
            let candidate = shadows.candidate(who).expect("of another name");
            let compared = compared(agree, vetoed, driving_vetoed);
            shadows.count(candidate, who, compared);
            if driving.replace(who) != Some(who) {
                since.clear();
            }
            since.push(compared);
            let of = |what: fn(&Compared) -> bool| since.iter().filter(|one| what(one)).count() as u32;
            let expected = [
                since.len() as u32,
                of(|one| one.agree),
                of(|one| one.vetoed),
                of(|one| one.driving_vetoed),
            ];
            prop_assert_eq!(counts(&shadows), Some(expected));
            prop_assert!(expected[1..].iter().all(|count| *count <= expected[0]));
        }
    }

    /// Who chooses the same is vetoed alike.
    #[test]
    fn vetoes_are_those_of_the_shield(driving in 0..7_u8, candidate in 0..7_u8, ahead: u16, behind: u16) {
        let [driving, candidate] = [driving, candidate].map(|number| Action::of(number).expect("one"));
        let around = Around { ahead, behind };
        let compared = Compared::new(driving, candidate, around);
        prop_assert_eq!(compared.agree, driving == candidate);
        prop_assert_eq!(compared.vetoed, shield(candidate, around).1);
        prop_assert_eq!(compared.driving_vetoed, shield(driving, around).1);
        if compared.agree {
            prop_assert_eq!(compared.vetoed, compared.driving_vetoed);
        }
    }
}

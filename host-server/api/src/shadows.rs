//! How policies that do not drive compare with those that do: on a robot, and of all robots together.

use std::collections::BTreeMap;

use crawler_fleet::Robot;
use crawler_protocol::Shadow;
use crawler_sim::evaluate::of_share;
use serde::Serialize;
use utoipa::ToSchema;

/// A share of decisions, with the interval of Wilson (1927) around it in which the true one lies with 95 %, were decisions
/// independent of each other. Those of one drive are not quite: it is rather wider.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
#[schema(as = DecisionShare)]
pub(super) struct ShareView {
    /// The share, 0 to 1.
    share: f64,
    /// Lower end of the interval.
    low: f64,
    /// Upper end of the interval.
    high: f64,
}

/// Counts of decisions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Counts {
    decisions: u64,
    agreed: u64,
    vetoes: u64,
    driving_vetoes: u64,
}

impl Counts {
    fn new(told: &Shadow) -> Self {
        // A robot that tells more than there were decisions is not believed beyond them.
        let of = |count: u32| count.min(told.decisions).into();
        Self {
            decisions: told.decisions.into(),
            agreed: of(told.agreed),
            vetoes: of(told.vetoes),
            driving_vetoes: of(told.driving_vetoes),
        }
    }

    fn add(&mut self, other: Self) {
        self.decisions += other.decisions;
        self.agreed += other.agreed;
        self.vetoes += other.vetoes;
        self.driving_vetoes += other.driving_vetoes;
    }
}

/// How a policy that does not drive compares with one that does, on the same observations.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Comparison)]
pub(super) struct ComparisonView {
    /// Observations for which both have decided.
    decisions: u64,
    /// For how many of them both chose the same action.
    agreed: u64,
    /// For how many of them the shield would have taken something from the action of the candidate.
    vetoes: u64,
    /// The same of the policy that drives.
    driving_vetoes: u64,
    /// Share of `agreed`; `null` before there is a decision.
    agreement: Option<ShareView>,
    /// Share of `vetoes`.
    veto_share: Option<ShareView>,
    /// Share of `driving_vetoes`.
    driving_veto_share: Option<ShareView>,
}

impl ComparisonView {
    fn new(counts: Counts) -> Self {
        let share = |successes: u64| {
            let estimate = of_share(successes as usize, counts.decisions as usize)?;
            Some(ShareView {
                share: estimate.mean,
                low: estimate.low,
                high: estimate.high,
            })
        };
        Self {
            decisions: counts.decisions,
            agreed: counts.agreed,
            vetoes: counts.vetoes,
            driving_vetoes: counts.driving_vetoes,
            agreement: share(counts.agreed),
            veto_share: share(counts.vetoes),
            driving_veto_share: share(counts.driving_vetoes),
        }
    }
}

/// What a robot compares, as its last heartbeat has it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Shadow)]
pub(super) struct ShadowView {
    /// The candidate: the policy that does not drive.
    policy: String,
    /// How it compares.
    #[serde(flatten)]
    comparison: ComparisonView,
}

fn told(robot: &Robot) -> Option<&Shadow> {
    robot.heartbeat.as_ref()?.shadow.as_ref()
}

/// What a robot compares, if anything.
pub(super) fn of_robot(robot: &Robot) -> Option<ShadowView> {
    let told = told(robot)?;
    Some(ShadowView {
        policy: told.policy.as_str().to_owned(),
        comparison: ComparisonView::new(Counts::new(told)),
    })
}

/// What all robots together have that compare one build of a policy.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = ShadowSum)]
pub(super) struct SumView {
    /// What names the contents of the candidate; `null` for the one that comes with the program.
    build: Option<String>,
    /// How many robots compare it.
    robots: u32,
    /// How it compares, their counts added up.
    #[serde(flatten)]
    comparison: ComparisonView,
}

/// What robots have by the names of the policies that they compare, and by their builds.
#[derive(Debug, Default)]
pub(super) struct Sums(BTreeMap<String, BTreeMap<Option<String>, (u32, Counts)>>);

impl Sums {
    pub(super) fn add(&mut self, robot: &Robot) {
        let Some(told) = told(robot) else {
            return;
        };
        let name = told.policy.as_str();
        let status = robot.status.as_ref();
        let build = status.and_then(|status| {
            let mut models = status.models.iter();
            let (_, build) = models.find(|(model, _)| model.as_str() == name)?;
            Some(build.as_str().to_owned())
        });
        let builds = self.0.entry(name.to_owned()).or_default();
        let (robots, counts) = builds.entry(build).or_default();
        *robots += 1;
        counts.add(Counts::new(told));
    }

    /// Takes out what there is of one.
    pub(super) fn take(&mut self, name: &str) -> Vec<SumView> {
        let builds = self.0.remove(name).unwrap_or_default();
        let view = |(build, (robots, counts))| SumView {
            build,
            robots,
            comparison: ComparisonView::new(counts),
        };
        builds.into_iter().map(view).collect()
    }
}

#[cfg(test)]
mod tests {
    use crawler_protocol::PolicyName;
    use proptest::prelude::*;

    use super::*;

    fn shadow([decisions, agreed, vetoes, driving_vetoes]: [u32; 4]) -> Shadow {
        Shadow {
            policy: PolicyName::new("gather").expect("a name"),
            decisions,
            agreed,
            vetoes,
            driving_vetoes,
        }
    }

    #[test]
    fn shares_are_those_of_wilson_and_none_without_decisions() {
        let view = |counts| ComparisonView::new(Counts::new(&shadow(counts)));
        let none = view([0; 4]);
        assert_eq!((none.agreement, none.veto_share), (None, None));
        let some = view([10, 9, 1, 10]);
        let agreement = some.agreement.expect("ten");
        // Wilson (1927) of 9 in 10: 0.5958 to 0.9821.
        assert!((agreement.share - 0.9).abs() < 1e-12);
        assert!((agreement.low - 0.595_8).abs() < 1e-4, "{agreement:?}");
        assert!((agreement.high - 0.982_1).abs() < 1e-4, "{agreement:?}");
        let all = some.driving_veto_share.expect("ten");
        assert!((all.share - 1.0).abs() < 1e-12 && all.low < 0.8);
    }

    proptest! {
        /// Whatever robots tell: shares of it, and sums of what is believed.
        #[test]
        fn sums_are_bounded_by_their_decisions(told in prop::collection::vec(any::<[u32; 4]>(), 0..20)) {
            let mut sum = Counts::default();
            for counts in &told {
                sum.add(Counts::new(&shadow(*counts)));
            }
            let decisions: u64 = told.iter().map(|counts| u64::from(counts[0])).sum();
            prop_assert_eq!(sum.decisions, decisions);
            let view = ComparisonView::new(sum);
            prop_assert_eq!(view.agreement.is_some(), decisions > 0);
            for share in [view.agreement, view.veto_share, view.driving_veto_share].into_iter().flatten() {
                prop_assert!(0.0 <= share.low && share.low <= share.share + 1e-9);
                prop_assert!(share.share <= share.high + 1e-9 && share.high <= 1.0);
            }
        }
    }
}

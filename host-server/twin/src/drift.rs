//! Whether a body that was certified is still that of its robot: slow gains that leave it for good.
//!
//! A fault is sudden, and is named ([`crate::detect`]); what tyres, gears and batteries lose over weeks is slow, and the filter
//! learns it. Where a gain stays further from the body than three deviations, the certificate is *stale*: the body is to be
//! found anew. Nothing is changed by that.

use serde::{Deserialize, Serialize};

/// Deviations from which on a gain is not that of the body.
const FAR: f64 = 3.0;
/// And within which it is again.
const NEAR: f64 = 2.0;
/// Either is said when it was so over this way, metres.
const LASTS_M: f64 = 5.0;
/// What a body differs by from one day to another, and a certificate is off by, as a logarithm of the speed.
const BODY_SIGMA: f64 = 0.01;

/// How far the gains of both wheels are from the certified body.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Drift {
    /// Of the left and the right wheel, deviations.
    pub deviations: [f64; 2],
    /// The tracker's time from which on the certificate is stale, seconds; `None` where it is not.
    pub stale_since_s: Option<f64>,
}

/// Follows the gains.
#[derive(Debug, Clone, Default)]
pub(crate) struct Watch {
    now: Drift,
    /// Where on the way it became other than what is said.
    other_m: Option<f64>,
}

impl Watch {
    /// Looks at the logarithms of the gains, each with its deviation, after so many metres in all.
    pub(crate) fn look(&mut self, at_s: f64, way_m: f64, gains: [f64; 2], sigmas: [f64; 2]) {
        let deviations = [0, 1].map(|k: usize| gains[k].abs() / sigmas[k].hypot(BODY_SIGMA));
        if !deviations.iter().all(|one| one.is_finite()) {
            return;
        }
        self.now.deviations = deviations;
        let most = deviations[0].max(deviations[1]);
        let is_other = match self.now.stale_since_s {
            None => most > FAR,
            Some(_) => most < NEAR,
        };
        if !is_other {
            self.other_m = None;
        } else if way_m - *self.other_m.get_or_insert(way_m) >= LASTS_M {
            self.other_m = None;
            self.now.stale_since_s = match self.now.stale_since_s {
                None => Some(at_s),
                Some(_) => None,
            };
        }
    }

    pub(crate) const fn now(&self) -> Drift {
        self.now
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_lasts_is_said_and_what_passes_is_not() {
        let mut watch = Watch::default();
        let mut way_m = 0.0;
        let mut drive = |watch: &mut Watch, gain: f64, metres: u32| {
            for _ in 0..metres * 2 {
                way_m += 0.5;
                watch.look(way_m * 3.0, way_m, [0.0, gain], [0.002; 2]);
            }
            watch.now().stale_since_s
        };
        assert_eq!(drive(&mut watch, 0.02, 50), None, "as bodies are");
        assert_eq!(drive(&mut watch, -0.06, 4), None, "not for long");
        assert_eq!(drive(&mut watch, 0.0, 1), None);
        assert_eq!(drive(&mut watch, -0.06, 4), None, "nor again");
        assert!(drive(&mut watch, -0.06, 4).is_some());
        assert!(watch.now().deviations[1] > FAR && watch.now().deviations[0] < 1e-9);
        assert!(drive(&mut watch, 0.026, 20).is_some(), "between both");
        assert!(drive(&mut watch, 0.01, 4).is_some(), "not for long");
        assert_eq!(drive(&mut watch, 0.01, 4), None, "as it was");
        // Who stands is as it was, whatever is said.
        for second in 0..1_000 {
            watch.look(1e4 + f64::from(second), 500.0, [0.2; 2], [0.002; 2]);
        }
        assert_eq!(watch.now().stale_since_s, None);
    }

    proptest! {
        #[test]
        fn gains_within_three_deviations_never_make_a_certificate_stale(
            looks in prop::collection::vec((-1.0..1.0_f64, -1.0..1.0_f64, 0.0..3.0_f64, 1e-4..0.1_f64), 0..200)
        ) {
            let mut watch = Watch::default();
            let mut way_m = 0.0;
            for (left, right, way, sigma) in looks {
                way_m += way;
                let most = FAR * sigma.hypot(BODY_SIGMA) * 0.999;
                watch.look(way_m, way_m, [left * most, right * most], [sigma; 2]);
                prop_assert_eq!(watch.now().stale_since_s, None);
            }
            watch.look(0.0, way_m + 9.0, [f64::NAN, f64::INFINITY], [0.01; 2]);
            prop_assert!(watch.now().deviations.iter().all(|one| one.is_finite()));
        }
    }
}

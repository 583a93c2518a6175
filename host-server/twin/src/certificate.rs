//! A certificate: what a robot's body is, and the proof that it predicts what was not used to find it.

use serde::{Deserialize, Serialize};

use crate::body::Parameters;
use crate::drive::Drive;
use crate::evidence::{Counts, Evidence};
use crate::identify::{COUNT, Identified, NAMES, Unidentified, identify};
use crate::predict::{Score, errors, score};

/// Version of the file.
pub const FORMAT: u32 = 1;
/// Share of a drive, its end, that is held out.
pub const HELD_OUT: f64 = 0.35;
/// Horizons of the validation, seconds. The last one decides.
pub const HORIZONS_S: [f64; 2] = [1.0, 10.0];
/// Fewest held-out predictions over the longest horizon.
const FEWEST: usize = 8;
/// Held-out predictions must drive so far, on average, or they show nothing, metres.
const LEAST_WAY_M: f64 = 0.5;
/// Share of the predictions, side by side, that must be better.
const MAJORITY: f64 = 0.6;
/// Most outliers among the fixes.
const MOST_OUTLIERS: f64 = 0.1;
/// Most that is left of a fit, in deviations of fixes.
const MOST_RESIDUAL: f64 = 1.5;
/// Most refused rows, as a share.
const MOST_REFUSED: f64 = 0.1;
/// Days after which a certificate is to be made anew: tyres and packs age.
pub const VALID_DAYS: u64 = 90;

/// A value of a certificate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Value {
    /// What it is.
    pub name: String,
    /// The value, in the unit of the parameter.
    pub value: f64,
    /// One standard deviation, in the same unit.
    pub sigma: f64,
    /// What the nominal body has.
    pub nominal: f64,
}

/// Held-out predictions over a horizon.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Validation {
    /// By these parameters.
    pub own: Score,
    /// By the nominal ones.
    pub nominal: Score,
    /// By those of the certificate before, if there is one.
    pub previous: Option<Score>,
}

/// What stands in a certificate beside the robot's body.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct About {
    /// The robot.
    pub robot: String,
    /// The robot's program, as it names its build; empty where that is not known.
    #[serde(default)]
    pub build: String,
    /// What the robot drove on, in words; empty where nobody said.
    #[serde(default)]
    pub floor: String,
    /// Unix milliseconds at which the drive began; 0 where that is not known.
    #[serde(default)]
    pub made_ms: u64,
}

/// See the [module](self).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Certificate {
    /// Version of the file: [`FORMAT`].
    pub format: u32,
    /// Whose body, and on what.
    pub about: About,
    /// Name of the evidence: half of its SHA-256.
    pub evidence: String,
    /// Unix milliseconds from which it is to be made anew; 0 where the beginning is not known.
    pub expires_ms: u64,
    /// The body.
    pub parameters: Parameters,
    /// The same with deviations, and what follows from it.
    pub values: Vec<Value>,
    /// Covariance in deviations of the priors, rows in the order of `values`.
    pub covariance: Vec<Vec<f64>>,
    /// The held-out predictions, one entry for each horizon.
    pub validation: Vec<Validation>,
    /// Root mean square of what is left of the fit, in deviations of fixes.
    pub residual: f64,
    /// How much the heading wanders beyond what the body explains, radians for the root of a metre.
    pub wander: f64,
    /// Seconds that the robot's clock was behind the tracker's, by arrivals.
    pub behind_s: Option<f64>,
    /// What was odd about the evidence.
    pub counts: Counts,
    /// Jumps of the tracker or of the robot.
    pub jumps: usize,
}

/// Why there is no certificate. Each is told with what it goes by.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Refused {
    /// Nothing was identified.
    Unidentified(Unidentified),
    /// The clock of the robot or of the tracker jumped.
    ClockJumped(u64),
    /// Too much of the evidence is absurd, doubled or late.
    Unsound {
        /// Share of the rows that were refused.
        refused: f64,
    },
    /// The tracker contradicts itself, or the robot: another one may have been taken for it, it may have been
    /// carried or pushed, or its wheels slid.
    TrackerDoubted {
        /// Share of outliers.
        outliers: f64,
        /// Jumps.
        jumps: usize,
        /// What is left of the fit.
        residual: f64,
    },
    /// Too little was held out, or the robot stood.
    NothingHeldOut {
        /// Predictions.
        count: usize,
        /// Metres driven in each.
        way_m: f64,
    },
    /// Held-out driving is not predicted better than by the nominal body.
    NotBetterThanNominal(Box<Validation>),
    /// Nor than by the certificate before.
    NotBetterThanPrevious(Box<Validation>),
}

impl Refused {
    /// Its name, for programs.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Unidentified(_) => "unidentified",
            Self::ClockJumped(_) => "clock_jumped",
            Self::Unsound { .. } => "unsound",
            Self::TrackerDoubted { .. } => "tracker_doubted",
            Self::NothingHeldOut { .. } => "nothing_held_out",
            Self::NotBetterThanNominal(_) => "not_better_than_nominal",
            Self::NotBetterThanPrevious(_) => "not_better_than_previous",
        }
    }
}

impl std::fmt::Display for Refused {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Unidentified(why) => write!(f, "{why}"),
            Self::ClockJumped(rows) => write!(f, "a clock jumped ({rows} rows)"),
            Self::Unsound { refused } => {
                write!(f, "{:.0} % of the rows cannot be used", refused * 100.0)
            }
            Self::TrackerDoubted {
                outliers,
                jumps,
                residual,
            } => write!(
                f,
                "fixes and duties do not belong together: {:.0} % outliers, {jumps} jumps, {residual:.2} \
                 deviations left; was it the same robot, did it touch anything, was it carried?",
                outliers * 100.0
            ),
            Self::NothingHeldOut { count, way_m } => write!(
                f,
                "too little to validate on: {count} predictions over {way_m:.1} m each"
            ),
            Self::NotBetterThanNominal(v) => write!(
                f,
                "a drive that was held out is not predicted better than by the nominal body: {:.1} cm \
                 against {:.1} cm {:.0} s ahead",
                v.own.median_m * 100.0,
                v.nominal.median_m * 100.0,
                v.own.horizon_s
            ),
            Self::NotBetterThanPrevious(v) => write!(
                f,
                "a drive that was held out is not predicted better than by the certificate before: {:.1} cm \
                 against {:.1} cm {:.0} s ahead",
                v.own.median_m * 100.0,
                v.previous.map_or(0.0, |score| score.median_m * 100.0),
                v.own.horizon_s
            ),
        }
    }
}

impl std::error::Error for Refused {}

/// Identifies a body on the first part of a drive and certifies it on the rest.
///
/// # Errors
/// [`Refused`]: no certificate is better than a wrong one.
pub fn certify(
    evidence: &Evidence,
    about: About,
    previous: Option<&Certificate>,
) -> Result<Certificate, Refused> {
    let missing = Refused::Unidentified(Unidentified::TooLittle);
    let (from_s, to_s) = evidence.span().ok_or(missing)?;
    let cut = to_s - (to_s - from_s) * HELD_OUT;
    let (known, held) = (evidence.part(f64::MIN, cut), evidence.part(cut, f64::MAX));
    certify_on(&known, &held, about, previous)
}

/// The same with a drive to identify on and another one to validate on.
///
/// # Errors
/// See [`certify`].
pub fn certify_on(
    known: &Evidence,
    held: &Evidence,
    about: About,
    previous: Option<&Certificate>,
) -> Result<Certificate, Refused> {
    let counts = sum(known.counts(), held.counts());
    if counts.clock_jumps > 0 {
        return Err(Refused::ClockJumped(counts.clock_jumps));
    }
    let rows = |evidence: &Evidence| {
        evidence.duties().len() + evidence.volts().len() + evidence.fixes().len()
    };
    let bad = counts.absurd + counts.late + counts.beyond;
    let refused = bad as f64 / (bad as f64 + (rows(known) + rows(held)) as f64).max(1.0);
    if refused > MOST_REFUSED {
        return Err(Refused::Unsound { refused });
    }
    let missing = || Refused::Unidentified(Unidentified::TooLittle);
    let drive = Drive::new(known).ok_or_else(missing)?;
    let found = identify(&drive, &Parameters::NOMINAL).map_err(Refused::Unidentified)?;
    if found.outliers > MOST_OUTLIERS || found.residual > MOST_RESIDUAL || found.jumps > 2 {
        return Err(Refused::TrackerDoubted {
            outliers: found.outliers,
            jumps: found.jumps,
            residual: found.residual,
        });
    }
    let held = Drive::new(held).ok_or_else(missing)?;
    let mut validation = Vec::new();
    for horizon_s in HORIZONS_S {
        let decides = horizon_s == HORIZONS_S[HORIZONS_S.len() - 1];
        let own = errors(&held, &found.parameters, horizon_s);
        // Nobody told the nominal body how late the robot's clock is either: without that it is
        // another error, not of the body.
        let nominal = Parameters {
            latency_s: found.parameters.latency_s,
            ..Parameters::NOMINAL
        };
        let nominal = errors(&held, &nominal, horizon_s);
        let before = previous.map(|before| errors(&held, &before.parameters, horizon_s));
        let entry = Validation {
            own: score(&own, horizon_s),
            nominal: score(&nominal, horizon_s),
            previous: before.as_ref().map(|before| score(before, horizon_s)),
        };
        validation.push(entry);
        if !decides {
            continue;
        }
        if own.len() < FEWEST || entry.own.way_m < LEAST_WAY_M {
            let (count, way_m) = (own.len(), entry.own.way_m);
            return Err(Refused::NothingHeldOut { count, way_m });
        }
        if !is_better(&own, &nominal) {
            return Err(Refused::NotBetterThanNominal(Box::new(entry)));
        }
        if before.is_some_and(|before| !is_better(&own, &before)) {
            return Err(Refused::NotBetterThanPrevious(Box::new(entry)));
        }
    }
    let expires = |made: u64| made.saturating_add(VALID_DAYS * 86_400_000);
    Ok(Certificate {
        format: FORMAT,
        evidence: known.hash(),
        expires_ms: if about.made_ms == 0 {
            0
        } else {
            expires(about.made_ms)
        },
        about,
        parameters: found.parameters,
        values: values(&found),
        covariance: found.covariance.iter().map(|row| row.to_vec()).collect(),
        validation,
        residual: found.residual,
        wander: found.wander,
        behind_s: known.behind_s(),
        counts,
        jumps: found.jumps,
    })
}

/// Whether errors are smaller: at the median, at the ninth tenth, and in most pairs of one moment.
fn is_better(own: &[(f64, f64, f64)], other: &[(f64, f64, f64)]) -> bool {
    let (mine, theirs) = (score(own, 0.0), score(other, 0.0));
    let (mut pairs, mut won) = (0, 0);
    for (at_s, error, _) in own {
        let same = other.iter().find(|(at, _, _)| at == at_s);
        if let Some((_, there, _)) = same {
            pairs += 1;
            won += usize::from(error < there);
        }
    }
    mine.median_m < theirs.median_m
        && mine.p90_m < theirs.p90_m
        && pairs >= FEWEST
        && won as f64 >= MAJORITY * pairs as f64
}

fn sum(a: Counts, b: Counts) -> Counts {
    // Parts of one drive have the counts of all of it.
    Counts {
        absurd: a.absurd.max(b.absurd),
        doubled: a.doubled.max(b.doubled),
        reordered: a.reordered.max(b.reordered),
        late: a.late.max(b.late),
        clock_jumps: a.clock_jumps.max(b.clock_jumps),
        beyond: a.beyond.max(b.beyond),
    }
}

/// The identified parameters by name.
pub(crate) fn numbers(p: &Parameters) -> [f64; COUNT] {
    [
        p.speed_per_volt[0],
        p.speed_per_volt[1],
        p.friction_v[0],
        p.friction_v[1],
        p.backward,
        p.lag_straight_s,
        p.lag_turn_s,
        p.coast,
        p.track_m,
        p.latency_s,
        p.internal_ohm,
    ]
}

fn values(found: &Identified) -> Vec<Value> {
    let (own, nominal) = (numbers(&found.parameters), numbers(&Parameters::NOMINAL));
    let value = |k: usize| Value {
        name: NAMES[k].to_owned(),
        value: own[k],
        // Deviations are relative, but for the latency.
        sigma: found.deviation(k) * if k == 9 { 1.0 } else { own[k] },
        nominal: nominal[k],
    };
    (0..COUNT).map(value).collect()
}

impl Certificate {
    /// Reads a certificate. Whatever is in the file is checked before it is believed.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn read(text: &[u8]) -> Result<Self, CertificateError> {
        let read: Self = serde_json::from_slice(text).map_err(CertificateError::Json)?;
        if read.format != FORMAT {
            return Err(CertificateError::Format(read.format));
        }
        if !read.parameters.is_sound() || !(0.0..=1.0).contains(&read.wander) {
            return Err(CertificateError::Unsound);
        }
        Ok(read)
    }

    /// As it is written.
    #[must_use]
    pub fn write(&self) -> String {
        // Numbers that are finite, texts and lists: that can always be written.
        serde_json::to_string_pretty(self).unwrap_or_default()
    }

    /// Its id: the first half of the name of its evidence.
    #[must_use]
    pub fn id(&self) -> &str {
        self.evidence.get(..16).unwrap_or(&self.evidence)
    }

    /// Whether it has to be made anew by `now_ms`.
    #[must_use]
    pub const fn is_expired(&self, now_ms: u64) -> bool {
        self.expires_ms != 0 && now_ms >= self.expires_ms
    }
}

/// Why a file is no certificate.
#[derive(Debug)]
#[non_exhaustive]
pub enum CertificateError {
    /// It is not JSON, or another one.
    Json(serde_json::Error),
    /// It is of another version.
    Format(u32),
    /// Its numbers are those of no robot.
    Unsound,
}

impl std::fmt::Display for CertificateError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Json(error) => write!(f, "no certificate: {error}"),
            Self::Format(format) => write!(
                f,
                "a certificate of format {format}; this program has {FORMAT}"
            ),
            Self::Unsound => f.write_str("a certificate with numbers that no robot has"),
        }
    }
}

impl std::error::Error for CertificateError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Json(error) => Some(error),
            Self::Format(_) | Self::Unsound => None,
        }
    }
}

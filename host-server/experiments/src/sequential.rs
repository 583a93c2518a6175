//! Whether one of two succeeds more often, asked after each pair of tries, and answered as soon as it can be.
//!
//! Two ways are tried in pairs, each in the same circumstances. Pairs in which both succeed or both fail say nothing of which is
//! better; in the others one of them alone succeeds, and if neither were better it would be either with the same chance.
//! Wald (*Sequential Analysis*, 1947, chapter 6) tests these, for a difference that is named beforehand. Here no difference is
//! named: the likelihood is averaged over all chances, by the distribution of Krichevsky and Trofimov (1981), beta with ½ and ½,
//! as in the mixture test of Robbins (1970) that Johari, Koomen, Pekelis and Walsh (*Always Valid Inference*, 2022) have
//! for experiments under way. Over the likelihood of no difference that is a bet whose stake does not grow on average
//! where there is none, so that by Ville's inequality (1939) it ever comes to 1/ε with a chance of at most ε. Whoever looks after each
//! pair, and ends when they like, is wrong no more often.
//!
//! [`Test::share`] turns the same bet round: the shares of success that it does not rule out are an interval that
//! holds the true one at all times at once, which those that ask once (Wilson's) do not.

/// One of the two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The first.
    First,
    /// The second.
    Second,
}

/// What pairs have come to, by which of the two succeeded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Pairs {
    /// Both did.
    pub both: u64,
    /// The first alone.
    pub first: u64,
    /// The second alone.
    pub second: u64,
    /// Neither.
    pub neither: u64,
}

impl Pairs {
    /// Takes in a pair: whether the first of the two succeeded, and the second.
    pub const fn add(&mut self, first: bool, second: bool) {
        let count = match (first, second) {
            (true, true) => &mut self.both,
            (true, false) => &mut self.first,
            (false, true) => &mut self.second,
            (false, false) => &mut self.neither,
        };
        *count = count.saturating_add(1);
    }

    /// How many pairs there are.
    #[must_use]
    pub const fn count(&self) -> u64 {
        let one = self.first.saturating_add(self.second);
        one.saturating_add(self.both).saturating_add(self.neither)
    }

    /// In how many of them one succeeded.
    #[must_use]
    pub const fn successes(&self, side: Side) -> u64 {
        let alone = match side {
            Side::First => self.first,
            Side::Second => self.second,
        };
        self.both.saturating_add(alone)
    }

    /// How many times as likely these pairs are where the two differ as where they do not: natural logarithm.
    #[must_use]
    pub fn evidence(&self) -> f64 {
        bet(self.first, self.second, 0.5)
    }
}

/// How it stands between the two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// More pairs are to be tried.
    Open,
    /// This one succeeds more often.
    Better(Side),
    /// There are as many pairs as may be, and they do not tell.
    Undecided,
}

/// Ends of an interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// The lower one.
    pub low: f64,
    /// The upper one.
    pub high: f64,
}

/// When to stop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Test {
    error: f64,
    most: u64,
}

impl Test {
    /// A test that calls one of two better, where neither is, with a chance of at most `error`, and gives up after `most` pairs.
    /// `None` where `error` is no chance, or rules out nothing.
    #[must_use]
    pub fn new(error: f64, most: u64) -> Option<Self> {
        (error > 0.0 && error < 1.0 && most > 0).then_some(Self { error, most })
    }

    /// After how many pairs it gives up.
    #[must_use]
    pub const fn most(&self) -> u64 {
        self.most
    }

    /// How it stands after these pairs.
    #[must_use]
    pub fn judge(&self, pairs: &Pairs) -> Standing {
        if pairs.evidence() >= self.needed() {
            let first = pairs.first > pairs.second;
            return Standing::Better(if first { Side::First } else { Side::Second });
        }
        if pairs.count() >= self.most {
            return Standing::Undecided;
        }
        Standing::Open
    }

    /// The evidence that decides, as [`Pairs::evidence`] has it.
    #[must_use]
    pub fn needed(&self) -> f64 {
        -libm::log(self.error)
    }

    /// In which interval the true share lies of which there were `successes` in `count` tries, at all times at once but with a
    /// chance of the error.
    #[must_use]
    pub fn share(&self, successes: u64, count: u64) -> Interval {
        let failures = count.saturating_sub(successes);
        let holds = |chance: f64| bet(successes, failures, chance) < self.needed();
        if count == 0 {
            return Interval {
                low: 0.0,
                high: 1.0,
            };
        }
        // Where the bet earns least; it earns ever more to both sides of that.
        let middle = successes as f64 / (successes as f64 + failures as f64);
        let end = |out: f64| {
            if holds(out) {
                return out;
            }
            let (mut inside, mut outside) = (middle, out);
            for _ in 0..60 {
                let between = f64::midpoint(inside, outside);
                if holds(between) {
                    inside = between;
                } else {
                    outside = between;
                }
            }
            outside
        };
        Interval {
            low: end(0.0),
            high: end(1.0),
        }
    }
}

/// What a bet comes to against `chance` being that of success, after these tries: natural logarithm. Infinite where they cannot
/// be.
fn bet(successes: u64, failures: u64, chance: f64) -> f64 {
    let (s, f) = (successes as f64, failures as f64);
    // Γ(½)² is π.
    let averaged = libm::lgamma(s + 0.5) + libm::lgamma(f + 0.5)
        - libm::lgamma(s + f + 1.0)
        - libm::log(std::f64::consts::PI);
    let times = |count: f64, chance: f64| {
        // 0 · ln 0 is 0 here.
        if count > 0.0 {
            count * libm::log(chance)
        } else {
            0.0
        }
    };
    averaged - times(s, chance) - times(f, 1.0 - chance)
}

#[cfg(test)]
mod tests;

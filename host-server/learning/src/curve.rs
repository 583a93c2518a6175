//! The curve of a run: a line for each round.

use crawler_policy::Episode;
use crawler_policy::ppo::Report;

/// Rounds from one checkpoint to the next.
pub(crate) const KEPT_EVERY: u64 = 10;

/// What a round came to, as the curve has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Of the run so far.
    pub round: u64,
    /// Of all agents so far.
    pub steps: u64,
    /// That ended in the round.
    pub episodes: usize,
    /// Mean over them; not a number where there are none.
    pub reward: f32,
    /// Share of them.
    pub success: f32,
    /// Decisions, mean over them.
    pub length: f32,
    /// In nats.
    pub entropy: f64,
    /// Kullback-Leibler.
    pub divergence: f64,
    /// Share of the samples.
    pub clipped: f64,
    /// Half of the squared error of the critic.
    pub critic: f64,
    /// The clipped objective, negative.
    pub loss: f64,
    /// Share of the decisions from which the shield took something.
    pub vetoes: f32,
}

/// First line of the curve.
pub(crate) const COLUMNS: &str = "round,agent_steps,episodes,reward,success,length,entropy,divergence,clipped,critic,loss,vetoes\n";

impl Line {
    pub(crate) fn of(report: &Report, vetoes: f32) -> Self {
        let episodes = &report.episodes;
        let mean = |value: fn(&Episode) -> f32| {
            episodes.iter().map(value).sum::<f32>() / episodes.len() as f32
        };
        Self {
            round: report.round,
            steps: report.agent_steps,
            episodes: episodes.len(),
            reward: mean(|episode| episode.reward),
            success: mean(|episode| f32::from(u8::from(episode.succeeded))),
            length: mean(|episode| episode.length as f32),
            entropy: report.entropy,
            divergence: report.divergence,
            clipped: report.clipped,
            critic: report.value_loss,
            loss: report.policy_loss,
            vetoes,
        }
    }

    /// Whether the run is kept after this round.
    #[must_use]
    pub const fn is_kept(&self) -> bool {
        self.round.is_multiple_of(KEPT_EVERY)
    }

    /// Reads a line of the file; `None` for any other, and for its first one.
    #[must_use]
    pub fn read(line: &str) -> Option<Self> {
        let mut fields = line.trim_end_matches('\n').split(',');
        let mut next = || fields.next();
        // What is not there has no number.
        let number = |text: &str| -> Option<f32> {
            if text.is_empty() {
                return Some(f32::NAN);
            }
            text.parse().ok().filter(|number: &f32| number.is_finite())
        };
        let whole = |text: &str| -> Option<f64> {
            text.parse().ok().filter(|number: &f64| number.is_finite())
        };
        let line = Self {
            round: next()?.parse().ok()?,
            steps: next()?.parse().ok()?,
            episodes: next()?.parse().ok()?,
            reward: number(next()?)?,
            success: number(next()?)?,
            length: number(next()?)?,
            entropy: whole(next()?)?,
            divergence: whole(next()?)?,
            clipped: whole(next()?)?,
            critic: whole(next()?)?,
            loss: whole(next()?)?,
            vetoes: number(next()?)?,
        };
        next().is_none().then_some(line)
    }

    /// The line of the file.
    #[must_use]
    pub fn csv(&self) -> String {
        let Self {
            round,
            steps,
            episodes,
            reward,
            success,
            length,
            entropy,
            divergence,
            clipped,
            critic,
            loss,
            vetoes,
        } = self;
        // What is not there has no number.
        let number = |value: f32| {
            if value.is_nan() {
                String::new()
            } else {
                format!("{value:.4}")
            }
        };
        let (reward, success, length) = (number(*reward), number(*success), number(*length));
        format!(
            "{round},{steps},{episodes},{reward},{success},{length},{entropy:.5},{divergence:.6},\
             {clipped:.5},{critic:.5},{loss:.6},{vetoes:.4}\n"
        )
    }
}

//! What can be wrong with a program.

use std::fmt;
use std::str::FromStr;

/// What is wrong with a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum DefectKind {
    /// It panics, so many milliseconds after each start.
    Panic,
    /// It hangs, so many milliseconds after each start, until the watchdog resets it.
    Hang,
    /// It restarts itself, so many milliseconds after each start.
    Restart,
    /// It never finds the network.
    NeverLink,
    /// It gets no answer from the ranger.
    RangerDead,
    /// Its readings of the ranger are off, by so many millimetres of one standard deviation.
    RangerNoisy,
    /// It misses several control periods, every so many milliseconds.
    MissControl,
}

impl DefectKind {
    /// All of them, in the order of their numbers in a bundle.
    pub const ALL: [Self; 7] = [
        Self::Panic,
        Self::Hang,
        Self::Restart,
        Self::NeverLink,
        Self::RangerDead,
        Self::RangerNoisy,
        Self::MissControl,
    ];

    /// Its name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Panic => "panic",
            Self::Hang => "hang",
            Self::Restart => "restart",
            Self::NeverLink => "never-link",
            Self::RangerDead => "ranger-dead",
            Self::RangerNoisy => "ranger-noisy",
            Self::MissControl => "miss-control",
        }
    }

    /// Its number in a bundle.
    pub(crate) const fn number(self) -> u8 {
        self as u8 + 1
    }

    pub(crate) fn from_number(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.number() == number)
    }

    /// The least and the largest number that goes with it; both 0 where none does.
    const fn range(self) -> (u32, u32) {
        match self {
            // An hour.
            Self::Panic | Self::Hang | Self::Restart => (0, 3_600_000),
            Self::NeverLink | Self::RangerDead => (0, 0),
            // As far as it reaches.
            Self::RangerNoisy => (1, 4_500),
            Self::MissControl => (200, 3_600_000),
        }
    }
}

/// Something that is wrong with the program of some robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Defect {
    /// What.
    pub kind: DefectKind,
    /// How many of a hundred robots it shows at, 1 to 100. Which ones is drawn anew for each build.
    pub percent: u8,
    /// The number that goes with it: see [`DefectKind`]; 0 where none does.
    pub value: u32,
}

impl Defect {
    /// The same at every robot.
    #[must_use]
    pub const fn everywhere(kind: DefectKind, value: u32) -> Self {
        Self {
            kind,
            percent: 100,
            value,
        }
    }

    /// Whether its numbers are within their ranges.
    #[must_use]
    pub const fn is_sound(&self) -> bool {
        let (least, most) = self.kind.range();
        self.value >= least && self.value <= most && matches!(self.percent, 1..=100)
    }
}

/// A text that names no defect.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DefectFault;

impl fmt::Display for DefectFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(
            "must be panic=MS, hang=MS, restart=MS (after the start, at most 3600000), never-link, ranger-dead, \
             ranger-noisy=MM (1 to 4500) or miss-control=MS (every 200 to 3600000), and may end with @PERCENT \
             for a share of the robots, as panic=5000@10%",
        )
    }
}

impl std::error::Error for DefectFault {}

impl FromStr for Defect {
    type Err = DefectFault;

    fn from_str(text: &str) -> Result<Self, DefectFault> {
        let (what, percent) = match text.split_once('@') {
            None => (text, 100),
            Some((what, share)) => {
                let digits = share.strip_suffix('%').ok_or(DefectFault)?;
                (what, number(digits)?)
            }
        };
        let (name, value) = match what.split_once('=') {
            None => (what, None),
            Some((name, value)) => (name, Some(number(value)?)),
        };
        let kind = DefectKind::ALL.into_iter().find(|kind| kind.name() == name);
        let kind = kind.ok_or(DefectFault)?;
        let takes_value = kind.range().1 > 0;
        if takes_value != value.is_some() {
            return Err(DefectFault);
        }
        let defect = Self {
            kind,
            percent: u8::try_from(percent).map_err(|_| DefectFault)?,
            value: value.unwrap_or(0),
        };
        defect.is_sound().then_some(defect).ok_or(DefectFault)
    }
}

fn number(text: &str) -> Result<u32, DefectFault> {
    if text.starts_with('+') {
        return Err(DefectFault);
    }
    text.parse().map_err(|_| DefectFault)
}

impl fmt::Display for Defect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.kind.name())?;
        if self.kind.range().1 > 0 {
            write!(f, "={}", self.value)?;
        }
        if self.percent != 100 {
            write!(f, "@{}%", self.percent)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_name_defects() {
        let part = |kind, value, percent| {
            Ok(Defect {
                kind,
                percent,
                value,
            })
        };
        for (text, expected) in [
            ("panic=5000", part(DefectKind::Panic, 5_000, 100)),
            ("panic=0", part(DefectKind::Panic, 0, 100)),
            ("hang=40@10%", part(DefectKind::Hang, 40, 10)),
            ("never-link", part(DefectKind::NeverLink, 0, 100)),
            ("never-link@1%", part(DefectKind::NeverLink, 0, 1)),
            ("ranger-noisy=300", part(DefectKind::RangerNoisy, 300, 100)),
            (
                "miss-control=200@99%",
                part(DefectKind::MissControl, 200, 99),
            ),
            ("panic", Err(DefectFault)),
            ("panic=", Err(DefectFault)),
            ("panic=+5", Err(DefectFault)),
            ("panic=5000@", Err(DefectFault)),
            ("panic=5000@0%", Err(DefectFault)),
            ("panic=5000@101%", Err(DefectFault)),
            ("panic=5000@50", Err(DefectFault)),
            ("panic=3600001", Err(DefectFault)),
            ("never-link=1", Err(DefectFault)),
            ("ranger-noisy=0", Err(DefectFault)),
            ("miss-control=199", Err(DefectFault)),
            ("melt", Err(DefectFault)),
            ("", Err(DefectFault)),
        ] {
            let defect = text.parse::<Defect>();
            assert_eq!(defect, expected, "{text}");
            if let Ok(defect) = defect {
                assert_eq!(defect.to_string(), text);
            }
        }
    }

    #[test]
    fn numbers_in_a_bundle_are_stable() {
        let numbers = DefectKind::ALL.map(DefectKind::number);
        assert_eq!(numbers, [1, 2, 3, 4, 5, 6, 7]);
        for number in 0..=u8::MAX {
            let kind = DefectKind::from_number(number);
            assert_eq!(
                kind.map(DefectKind::number),
                (1..=7).contains(&number).then_some(number)
            );
        }
    }
}

//! What goes over the wire: bytes, little-endian, with a version.
//!
//! ```text
//! announcement  "TCFA" version u8  round u32  rounds u32  deadline_ms u32  plan [22]  count u32  weights f32 × count
//! update        "TCFU" version u8  round u32  base [8]  report [44]  count u32  scales f32 × ⌈count / 64⌉  numbers i8 × count
//! report        samples u32  episodes u32  success  reward  length  entropy  divergence  clipped  critic  loss  vetoes, each f32
//! plan          seed u64  worlds u16  rounds u16  minibatch u16  units u16  central u8  0 u8  proximal f32
//! ```
//!
//! An update names the announcement that it answers by the first 8 bytes of its SHA-256 (`base`): one that was made for other weights,
//! another round or another plan is told apart from a late one.

use std::error::Error;
use std::fmt;

use sha2::{Digest, Sha256};

use crate::quantise::{BLOCK, Quantised};

/// Longest message, in bytes: what a broker of the project takes at most.
pub const LONGEST: usize = 65_536;
const VERSION: u8 = 1;
const ANNOUNCEMENT: [u8; 4] = *b"TCFA";
const UPDATE: [u8; 4] = *b"TCFU";
/// Bytes of an announcement beside its weights.
const HEAD: usize = 4 + 1 + 12 + 22 + 4;
/// Most weights, for an announcement to fit.
pub const MOST_WEIGHTS: usize = (LONGEST - HEAD) / 4;

/// Which announcement an update answers.
pub type Base = [u8; 8];

/// What every node does in a round.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plan {
    /// Names the run; each node draws from it and from its own name.
    pub seed: u64,
    /// Worlds side by side on each node.
    pub worlds: u16,
    /// Rounds of the learner on a node in each round of the run.
    pub rounds: u16,
    /// Samples in a step of the optimiser. A node has fewer than one that learns alone has, and is to take as many steps.
    pub minibatch: u16,
    /// Units of both hidden layers.
    pub units: u16,
    /// Whether the critic sees what no robot knows.
    pub central: bool,
    /// The proximal term of `FedProx`; 0 for none.
    pub proximal: f32,
}

/// A round begins.
#[derive(Debug, Clone, PartialEq)]
pub struct Announcement {
    /// Rounds that are over: the first one is 0. Equal to `rounds` once the run is over; the weights are what came of it then.
    pub round: u32,
    /// Rounds of the run.
    pub rounds: u32,
    /// How long an answer is waited for, in milliseconds.
    pub deadline_ms: u32,
    /// What to do.
    pub plan: Plan,
    /// From which weights.
    pub weights: Vec<f32>,
}

/// How learning went on a node, in a round. Believed in nothing but [`Aggregation::Success`](crate::Aggregation::Success): it is for
/// people.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Report {
    /// Decisions that it learned from.
    pub samples: u32,
    /// Episodes that came to an end. Of none, the next three are 0.
    pub episodes: u32,
    /// Share of them that reached their goal, 0 to 1.
    pub success: f32,
    /// Their reward, on average.
    pub reward: f32,
    /// Their length in decisions, on average.
    pub length: f32,
    /// How undecided the policy is, in nats.
    pub entropy: f32,
    /// How far the policy has moved: the Kullback-Leibler divergence, estimated.
    pub divergence: f32,
    /// Share of the samples at which the policy was held back, 0 to 1.
    pub clipped: f32,
    /// Half of the squared error of the critic.
    pub critic: f32,
    /// The clipped objective, negative.
    pub loss: f32,
    /// Share of the decisions from which the shield took something, 0 to 1.
    pub vetoes: f32,
}

impl Report {
    fn numbers(&self) -> [f32; 9] {
        [
            self.success,
            self.reward,
            self.length,
            self.entropy,
            self.divergence,
            self.clipped,
            self.critic,
            self.loss,
            self.vetoes,
        ]
    }

    fn encode(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.samples.to_le_bytes());
        out.extend_from_slice(&self.episodes.to_le_bytes());
        for number in self.numbers() {
            out.extend_from_slice(&number.to_le_bytes());
        }
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, MessageError> {
        let report = Self {
            samples: reader.u32()?,
            episodes: reader.u32()?,
            success: reader.f32("success")?,
            reward: reader.f32("reward")?,
            length: reader.f32("length")?,
            entropy: reader.f32("entropy")?,
            divergence: reader.f32("divergence")?,
            clipped: reader.f32("clipped")?,
            critic: reader.f32("critic")?,
            loss: reader.f32("loss")?,
            vetoes: reader.f32("vetoes")?,
        };
        let shares = [
            (report.success, "success"),
            (report.clipped, "clipped"),
            (report.vetoes, "vetoes"),
        ];
        for (share, field) in shares {
            check((0.0..=1.0).contains(&share), field)?;
        }
        check(report.length >= 0.0, "length")?;
        Ok(report)
    }
}

/// What a node made of a round.
#[derive(Debug, Clone, PartialEq)]
pub struct Update {
    /// [`Announcement::round`].
    pub round: u32,
    /// [`Announcement::base`].
    pub base: Base,
    /// How learning went.
    pub report: Report,
    /// New weights less those of the announcement.
    pub change: Quantised,
}

/// Why bytes are no message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum MessageError {
    /// They begin as no message does.
    Foreign,
    /// Of another version.
    Version(u8),
    /// There are fewer bytes, or more, than the message says.
    Length,
    /// A field has a value that no message has.
    Invalid(&'static str),
}

impl fmt::Display for MessageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Foreign => f.write_str("not a message of federated learning"),
            Self::Version(version) => {
                write!(f, "version {version}; this program reads {VERSION}")
            }
            Self::Length => f.write_str("cut off, or too long"),
            Self::Invalid(field) => write!(f, "{field} is invalid"),
        }
    }
}

impl Error for MessageError {}

/// Reads bytes from the front.
pub(crate) struct Reader<'a>(pub(crate) &'a [u8]);

impl<'a> Reader<'a> {
    pub(crate) fn take(&mut self, count: usize) -> Result<&'a [u8], MessageError> {
        let (taken, rest) = self.0.split_at_checked(count).ok_or(MessageError::Length)?;
        self.0 = rest;
        Ok(taken)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], MessageError> {
        let (taken, rest) = self.0.split_first_chunk().ok_or(MessageError::Length)?;
        self.0 = rest;
        Ok(*taken)
    }

    pub(crate) fn u8(&mut self) -> Result<u8, MessageError> {
        self.array().map(u8::from_le_bytes)
    }

    fn u16(&mut self) -> Result<u16, MessageError> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, MessageError> {
        self.array().map(u32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self) -> Result<u64, MessageError> {
        self.array().map(u64::from_le_bytes)
    }

    /// A finite number.
    pub(crate) fn f32(&mut self, field: &'static str) -> Result<f32, MessageError> {
        let number = self.array().map(f32::from_le_bytes)?;
        number
            .is_finite()
            .then_some(number)
            .ok_or(MessageError::Invalid(field))
    }

    fn begin(bytes: &'a [u8], magic: [u8; 4]) -> Result<Self, MessageError> {
        let mut reader = Self(bytes);
        if reader.array() != Ok(magic) {
            return Err(MessageError::Foreign);
        }
        match reader.u8()? {
            VERSION => Ok(reader),
            version => Err(MessageError::Version(version)),
        }
    }

    /// A count of weights that are to follow, `each` bytes in all for a count.
    fn count(&mut self, bytes: impl Fn(usize) -> usize) -> Result<usize, MessageError> {
        let count = self.u32()? as usize;
        if count == 0 || count > MOST_WEIGHTS {
            return Err(MessageError::Invalid("count"));
        }
        if self.0.len() < bytes(count) {
            return Err(MessageError::Length);
        }
        Ok(count)
    }

    /// Nothing follows.
    pub(crate) fn end(&self) -> Result<(), MessageError> {
        self.0.is_empty().then_some(()).ok_or(MessageError::Length)
    }
}

fn check(right: bool, field: &'static str) -> Result<(), MessageError> {
    right.then_some(()).ok_or(MessageError::Invalid(field))
}

impl Plan {
    fn encode(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.seed.to_le_bytes());
        for number in [self.worlds, self.rounds, self.minibatch, self.units] {
            out.extend_from_slice(&number.to_le_bytes());
        }
        out.extend_from_slice(&[u8::from(self.central), 0]);
        out.extend_from_slice(&self.proximal.to_le_bytes());
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self, MessageError> {
        let plan = Self {
            seed: reader.u64()?,
            worlds: reader.u16()?,
            rounds: reader.u16()?,
            minibatch: reader.u16()?,
            units: reader.u16()?,
            central: match reader.array()? {
                [0, 0] => false,
                [1, 0] => true,
                _ => return Err(MessageError::Invalid("central")),
            },
            proximal: reader.f32("proximal")?,
        };
        plan.validate()?;
        Ok(plan)
    }

    /// Whether a node can do it.
    ///
    /// # Errors
    /// With the field that is out of range.
    pub fn validate(&self) -> Result<(), MessageError> {
        check((1..=256).contains(&self.worlds), "worlds")?;
        check((1..=100).contains(&self.rounds), "rounds of a node")?;
        check((16..=8_192).contains(&self.minibatch), "minibatch")?;
        check((4..=64).contains(&self.units), "units")?;
        check((0.0..=10.0).contains(&self.proximal), "proximal")
    }
}

impl Announcement {
    /// Bytes for the wire, [`LONGEST`] at most where there are no more than [`MOST_WEIGHTS`].
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEAD + self.weights.len() * 4);
        bytes.extend_from_slice(&ANNOUNCEMENT);
        bytes.push(VERSION);
        for number in [self.round, self.rounds, self.deadline_ms] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        self.plan.encode(&mut bytes);
        bytes.extend_from_slice(&(self.weights.len() as u32).to_le_bytes());
        for weight in &self.weights {
            bytes.extend_from_slice(&weight.to_le_bytes());
        }
        bytes
    }

    /// Reads what [`to_bytes`](Self::to_bytes) wrote.
    ///
    /// # Errors
    /// When the bytes are no such message.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MessageError> {
        let (announcement, rest) = Self::from_front(bytes)?;
        rest.end()?;
        Ok(announcement)
    }

    /// Reads what [`to_bytes`](Self::to_bytes) wrote, and leaves what follows.
    pub(crate) fn from_front(bytes: &[u8]) -> Result<(Self, Reader<'_>), MessageError> {
        let mut reader = Reader::begin(bytes, ANNOUNCEMENT)?;
        let (round, rounds, deadline_ms) = (reader.u32()?, reader.u32()?, reader.u32()?);
        check(rounds > 0 && round <= rounds, "round")?;
        let plan = Plan::decode(&mut reader)?;
        let count = reader.count(|count| count * 4)?;
        let mut weights = Vec::with_capacity(count);
        for _ in 0..count {
            weights.push(reader.f32("weight")?);
        }
        let announcement = Self {
            round,
            rounds,
            deadline_ms,
            plan,
            weights,
        };
        Ok((announcement, reader))
    }

    /// Whether there is nothing more to do.
    #[must_use]
    pub const fn is_over(&self) -> bool {
        self.round >= self.rounds
    }

    /// What answers to `bytes` name it by.
    #[must_use]
    pub fn base(bytes: &[u8]) -> Base {
        let hash: [u8; 32] = Sha256::digest(bytes).into();
        std::array::from_fn(|place| hash[place])
    }
}

impl Update {
    /// Bytes for the wire.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(128 + self.change.len() * 17 / 16);
        bytes.extend_from_slice(&UPDATE);
        bytes.push(VERSION);
        bytes.extend_from_slice(&self.round.to_le_bytes());
        bytes.extend_from_slice(&self.base);
        self.report.encode(&mut bytes);
        bytes.extend_from_slice(&(self.change.len() as u32).to_le_bytes());
        for scale in self.change.scales() {
            bytes.extend_from_slice(&scale.to_le_bytes());
        }
        bytes.extend(
            self.change
                .numbers()
                .iter()
                .map(|number| number.to_le_bytes()[0]),
        );
        bytes
    }

    /// Reads what [`to_bytes`](Self::to_bytes) wrote. All numbers of it are finite.
    ///
    /// # Errors
    /// When the bytes are no such message.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MessageError> {
        let mut reader = Reader::begin(bytes, UPDATE)?;
        let (round, base) = (reader.u32()?, reader.array()?);
        let report = Report::decode(&mut reader)?;
        let count = reader.count(|count| count.div_ceil(BLOCK) * 4 + count)?;
        let mut scales = Vec::with_capacity(count.div_ceil(BLOCK));
        for _ in 0..count.div_ceil(BLOCK) {
            scales.push(reader.f32("scale")?);
        }
        let numbers = reader.take(count)?;
        let numbers = numbers
            .iter()
            .map(|byte| i8::from_le_bytes([*byte]))
            .collect();
        reader.end()?;
        let change =
            Quantised::from_parts(scales, numbers).ok_or(MessageError::Invalid("scale"))?;
        Ok(Self {
            round,
            base,
            report,
            change,
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn any_plan() -> impl Strategy<Value = Plan> {
        let numbers = (
            any::<u64>(),
            1_u16..=256,
            1_u16..=100,
            16_u16..=8_192,
            4_u16..=64,
        );
        (numbers, any::<bool>(), 0.0_f32..=10.0).prop_map(
            |((seed, worlds, rounds, minibatch, units), central, proximal)| Plan {
                seed,
                worlds,
                rounds,
                minibatch,
                units,
                central,
                proximal,
            },
        )
    }

    fn any_announcement() -> impl Strategy<Value = Announcement> {
        let rounds = (1_u32..10_000).prop_flat_map(|rounds| (0..=rounds, Just(rounds)));
        let weights = prop::collection::vec(-10.0_f32..10.0, 1..200);
        (rounds, any::<u32>(), any_plan(), weights).prop_map(
            |((round, rounds), deadline_ms, plan, weights)| Announcement {
                round,
                rounds,
                deadline_ms,
                plan,
                weights,
            },
        )
    }

    fn any_report() -> impl Strategy<Value = Report> {
        let counts = (any::<u32>(), any::<u32>());
        (
            counts,
            prop::array::uniform3(0.0_f32..=1.0),
            prop::array::uniform6(-100.0_f32..100.0),
        )
            .prop_map(
                |(
                    (samples, episodes),
                    [success, clipped, vetoes],
                    [reward, length, entropy, divergence, critic, loss],
                )| Report {
                    samples,
                    episodes,
                    success,
                    reward,
                    length: length.abs(),
                    entropy,
                    divergence,
                    clipped,
                    critic,
                    loss,
                    vetoes,
                },
            )
    }

    fn any_update() -> impl Strategy<Value = Update> {
        let numbers = prop::collection::vec(-10.0_f32..10.0, 1..200);
        (any::<u32>(), any::<Base>(), any_report(), numbers).prop_map(
            |(round, base, report, numbers)| Update {
                round,
                base,
                report,
                change: Quantised::of(&numbers),
            },
        )
    }

    proptest! {
        #[test]
        fn messages_come_back_as_they_were(announced in any_announcement(), update in any_update()) {
            let bytes = announced.to_bytes();
            prop_assert_eq!(Announcement::from_bytes(&bytes), Ok(announced));
            let bytes = update.to_bytes();
            prop_assert_eq!(Update::from_bytes(&bytes), Ok(update));
        }

        #[test]
        fn bytes_that_were_changed_are_refused_or_another_message(
            announced in any_announcement(), update in any_update(), at: prop::sample::Index, with in 1_u8..,
        ) {
            let mut bytes = announced.to_bytes();
            let place = at.index(bytes.len());
            bytes[place] ^= with;
            if let Ok(read) = Announcement::from_bytes(&bytes) {
                prop_assert_eq!(read.to_bytes(), bytes);
            }
            let mut bytes = update.to_bytes();
            let place = at.index(bytes.len());
            bytes[place] ^= with;
            if let Ok(read) = Update::from_bytes(&bytes) {
                prop_assert!(read.change.values().all(f32::is_finite));
                prop_assert_eq!(read.to_bytes(), bytes);
            }
        }

        #[test]
        fn cut_off_or_longer_is_refused(announced in any_announcement(), update in any_update(), at: prop::sample::Index) {
            for bytes in [announced.to_bytes(), update.to_bytes()] {
                let cut = &bytes[..at.index(bytes.len())];
                prop_assert!(Announcement::from_bytes(cut).is_err() && Update::from_bytes(cut).is_err());
                let longer = [&bytes[..], &[0]].concat();
                prop_assert!(Announcement::from_bytes(&longer).is_err() && Update::from_bytes(&longer).is_err());
            }
        }

        #[test]
        fn no_bytes_make_it_panic(bytes in prop::collection::vec(any::<u8>(), 0..400), which in 0_usize..2) {
            let mut begun = [ANNOUNCEMENT, UPDATE][which].to_vec();
            begun.push(VERSION);
            begun.extend(bytes);
            let _ = Announcement::from_bytes(&begun);
            let _ = Update::from_bytes(&begun);
        }
    }

    #[test]
    fn the_largest_of_each_fits_and_no_count_is_believed() {
        let mut announced = Announcement {
            round: 0,
            rounds: 1,
            deadline_ms: 0,
            plan: Plan {
                seed: 1,
                worlds: 1,
                rounds: 1,
                minibatch: 64,
                units: 64,
                central: true,
                proximal: 0.0,
            },
            weights: vec![0.0; MOST_WEIGHTS],
        };
        assert!(announced.to_bytes().len() <= LONGEST);
        announced.weights.push(0.0);
        let refused = Announcement::from_bytes(&announced.to_bytes());
        assert_eq!(refused, Err(MessageError::Invalid("count")));
        // 30 KB are what a node may send in a round.
        let change = Quantised::of(&vec![1.0; MOST_WEIGHTS]);
        let update = Update {
            round: 0,
            base: [0; 8],
            report: Report::default(),
            change,
        };
        assert!(update.to_bytes().len() <= 30_000 * 6 / 10);
    }

    #[test]
    fn numbers_that_are_none_are_refused() {
        let update = Update {
            round: 0,
            base: [0; 8],
            report: Report::default(),
            change: Quantised::of(&[1.0; 70]),
        };
        let bytes = update.to_bytes();
        let with = |at: usize, number: f32| {
            let mut bytes = bytes.clone();
            bytes[at..at + 4].copy_from_slice(&number.to_le_bytes());
            Update::from_bytes(&bytes)
        };
        let fields = [
            "success",
            "reward",
            "length",
            "entropy",
            "divergence",
            "clipped",
            "critic",
            "loss",
            "vetoes",
        ];
        let places = fields
            .into_iter()
            .enumerate()
            .map(|(place, field)| (25 + 4 * place, field));
        for (at, field) in places.chain([(65, "scale"), (69, "scale")]) {
            for number in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                assert_eq!(with(at, number), Err(MessageError::Invalid(field)));
            }
        }
        for scale in [-1.0, f32::MAX] {
            assert_eq!(with(65, scale), Err(MessageError::Invalid("scale")));
        }
        for (at, share, field) in [
            (25, 1.5, "success"),
            (45, -0.1, "clipped"),
            (57, 2.0, "vetoes"),
            (33, -1.0, "length"),
        ] {
            assert_eq!(with(at, share), Err(MessageError::Invalid(field)));
        }
        assert!(with(65, 0.5).is_ok());
    }
}

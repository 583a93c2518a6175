//! Frames: what is asked, read where it lies, and what hello answers.

use super::{Fault, MAGIC, VERSION};
use crate::environment::{Interface, Seed};

const HELLO: u8 = 1;
const ADVANCE: u8 = 2;
const CLOSE: u8 = 3;
/// Bytes of a hello, without that of its kind.
const HELLO_BYTES: usize = 7;
/// Of a seed.
const SEED_BYTES: usize = 16;

const ACT: u8 = 0;
const TRAIN: u8 = 1;
const EVALUATE: u8 = 2;
const REST: u8 = 3;

/// Of everything: how long frames are follows from it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sizes {
    pub(super) worlds: usize,
    pub(super) interface: Interface,
}

impl Sizes {
    /// Bytes of the longest frame that is asked, with that of its kind.
    pub(super) const fn longest(&self) -> usize {
        let each = 1 + self.interface.agents + SEED_BYTES;
        let advance = self.worlds * each;
        1 + if advance > HELLO_BYTES {
            advance
        } else {
            HELLO_BYTES
        }
    }

    /// Writes what hello answers.
    pub(super) fn describe(&self, name: &str, out: &mut Vec<u8>) {
        let Interface {
            agents,
            observation,
            state,
            actions,
        } = self.interface;
        out.extend(MAGIC);
        out.extend(VERSION.to_le_bytes());
        for number in [self.worlds, agents, observation, state, actions] {
            out.extend((number as u32).to_le_bytes());
        }
        out.extend(name.as_bytes());
    }
}

/// What is asked.
#[derive(Debug)]
pub(super) enum Request<'a> {
    Hello {
        /// Whether to say what a privileged critic sees.
        critic: bool,
    },
    Advance(Advance<'a>),
    Close,
}

impl<'a> Request<'a> {
    /// Reads a frame, without its length.
    ///
    /// # Errors
    /// See [`Fault`].
    pub(super) fn parse(frame: &'a [u8], sizes: &Sizes) -> Result<Self, Fault> {
        let (&kind, body) = frame.split_first().ok_or(Fault::Kind(0))?;
        match kind {
            HELLO => hello(body),
            ADVANCE => Advance::parse(body, sizes).map(Self::Advance),
            CLOSE => sized(kind, body, 0).map(|()| Self::Close),
            kind => Err(Fault::Kind(kind)),
        }
    }
}

fn hello(body: &[u8]) -> Result<Request<'_>, Fault> {
    let Some((&[m, a, g, i, low, high], rest)) = body.split_first_chunk() else {
        return Err(Fault::Foreign);
    };
    let version = u16::from_le_bytes([low, high]);
    if [m, a, g, i] != MAGIC {
        return Err(Fault::Foreign);
    }
    if version != VERSION {
        return Err(Fault::Version(version));
    }
    sized(HELLO, body, HELLO_BYTES)?;
    match rest {
        [flags @ (0 | 1)] => Ok(Request::Hello {
            critic: *flags == 1,
        }),
        rest => Err(Fault::Flags(rest.first().copied().unwrap_or_default())),
    }
}

const fn sized(kind: u8, body: &[u8], wanted: usize) -> Result<(), Fault> {
    let told = body.len();
    if told == wanted {
        Ok(())
    } else {
        Err(Fault::Size { kind, told, wanted })
    }
}

/// What a world is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Told {
    Act,
    Begin(Seed),
    Rest,
}

/// What all worlds are told.
#[derive(Debug, Clone, Copy)]
pub(super) struct Advance<'a> {
    orders: &'a [u8],
    actions: &'a [u8],
    seeds: &'a [u8],
}

impl<'a> Advance<'a> {
    fn parse(body: &'a [u8], sizes: &Sizes) -> Result<Self, Fault> {
        let (worlds, agents) = (sizes.worlds, sizes.interface.agents);
        let fixed = worlds * (1 + agents);
        let (orders, rest) = body.split_at_checked(worlds).unwrap_or((body, &[]));
        let begin = |order: &&u8| matches!(**order, TRAIN | EVALUATE);
        let wanted = fixed + SEED_BYTES * orders.iter().filter(begin).count();
        sized(ADVANCE, body, wanted)?;
        let (actions, seeds) = rest.split_at(worlds * agents);
        let read = Self {
            orders,
            actions,
            seeds,
        };
        read.check(sizes)?;
        Ok(read)
    }

    fn check(&self, sizes: &Sizes) -> Result<(), Fault> {
        let Interface {
            agents, actions, ..
        } = sizes.interface;
        let mut seeds = self.seeds.chunks_exact(SEED_BYTES);
        for (world, &order) in self.orders.iter().enumerate() {
            match order {
                ACT => {
                    let own = &self.actions[world * agents..][..agents];
                    let wrong = own
                        .iter()
                        .position(|&action| usize::from(action) >= actions);
                    if let Some(agent) = wrong {
                        return Err(Fault::Action {
                            world,
                            agent,
                            action: own[agent],
                            actions,
                        });
                    }
                }
                TRAIN => {
                    seeds.next();
                }
                EVALUATE => {
                    if seeds.next().is_some_and(|seed| seed[..12] != [0; 12]) {
                        return Err(Fault::Seed { world });
                    }
                }
                REST => {}
                order => return Err(Fault::Order { world, order }),
            }
        }
        Ok(())
    }

    /// What each world is told.
    pub(super) fn told(self) -> impl Iterator<Item = Told> + 'a {
        let mut seeds = self.seeds.chunks_exact(SEED_BYTES);
        let mut seed = move |training: bool| {
            let mut parts = [0; 4];
            for (part, bytes) in parts.iter_mut().zip(seeds.next()?.chunks_exact(4)) {
                *part = u32::from_le_bytes(bytes.try_into().ok()?);
            }
            let [low, high, environment, episode] = parts;
            let run = u64::from(low) | u64::from(high) << 32;
            Some(Told::Begin(if training {
                Seed::training(run, environment, episode)
            } else {
                Seed::evaluation(episode)
            }))
        };
        // Checked when it was read: as many seeds as worlds that begin.
        self.orders.iter().map(move |order| match *order {
            ACT => Told::Act,
            TRAIN => seed(true).unwrap_or(Told::Rest),
            EVALUATE => seed(false).unwrap_or(Told::Rest),
            _ => Told::Rest,
        })
    }

    /// The actions of all agents, those of the first world first.
    pub(super) const fn actions(&self) -> &'a [u8] {
        self.actions
    }
}

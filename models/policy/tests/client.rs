//! Who asks for worlds over a pipe, from the description of the protocol in `crawler_policy::gym`.

use std::io::{Read, Write};

/// What hello answers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Hello {
    pub(crate) worlds: usize,
    pub(crate) agents: usize,
    pub(crate) observation: usize,
    pub(crate) state: usize,
    pub(crate) actions: usize,
    pub(crate) name: String,
}

/// What a world is told.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Order {
    Act(Vec<u8>),
    /// Run, environment and episode.
    Train(u64, u32, u32),
    Evaluate(u32),
    Rest,
}

/// What all worlds answer.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Worlds {
    pub(crate) observations: Vec<f32>,
    pub(crate) rewards: Vec<f32>,
    pub(crate) states: Vec<f32>,
    pub(crate) statuses: Vec<u8>,
}

/// A frame with this content.
pub(crate) fn frame(kind: u8, body: &[u8]) -> Vec<u8> {
    let mut bytes = (body.len() as u32 + 1).to_le_bytes().to_vec();
    bytes.push(kind);
    bytes.extend(body);
    bytes
}

/// A frame of hello.
pub(crate) fn hello(version: u16, flags: u8) -> Vec<u8> {
    let [low, high] = version.to_le_bytes();
    frame(1, &[b'T', b'C', b'G', b'Y', low, high, flags])
}

/// A frame that tells every world something; `agents` have each.
pub(crate) fn advance(orders: &[Order], agents: usize) -> Vec<u8> {
    let (mut told, mut actions, mut seeds) = (Vec::new(), Vec::new(), Vec::new());
    for order in orders {
        let mut seed = |run: u64, environment: u32, episode: u32| {
            seeds.extend(run.to_le_bytes());
            seeds.extend(environment.to_le_bytes());
            seeds.extend(episode.to_le_bytes());
        };
        let mut own = vec![0; agents];
        told.push(match order {
            Order::Act(actions) => {
                own.clone_from(actions);
                0
            }
            Order::Train(run, environment, episode) => {
                seed(*run, *environment, *episode);
                1
            }
            Order::Evaluate(number) => {
                seed(0, 0, *number);
                2
            }
            Order::Rest => 3,
        });
        actions.extend(own);
    }
    frame(2, &[told, actions, seeds].concat())
}

/// The next frame: its kind, and what belongs to it.
pub(crate) fn read(input: &mut impl Read) -> Option<(u8, Vec<u8>)> {
    let mut length = [0; 4];
    input.read_exact(&mut length).ok()?;
    let mut bytes = vec![0; u32::from_le_bytes(length) as usize];
    input.read_exact(&mut bytes).expect("a whole frame");
    let kind = bytes.remove(0);
    Some((kind, bytes))
}

/// Who asks.
#[derive(Debug)]
pub(crate) struct Client<I, O> {
    input: I,
    output: O,
    pub(crate) hello: Hello,
    critic: bool,
}

impl<I: Read, O: Write> Client<I, O> {
    /// Says hello; `critic` asks for what a privileged critic sees.
    pub(crate) fn new(mut input: I, mut output: O, critic: bool) -> Self {
        output
            .write_all(&hello(1, u8::from(critic)))
            .and_then(|()| output.flush())
            .expect("somebody reads");
        let (kind, body) = read(&mut input).expect("an answer");
        assert_eq!(kind, 1, "{}", String::from_utf8_lossy(&body));
        assert_eq!(&body[..6], b"TCGY\x01\x00");
        let number = |at: usize| {
            let bytes = body[6 + 4 * at..][..4].try_into().expect("four");
            u32::from_le_bytes(bytes) as usize
        };
        let hello = Hello {
            worlds: number(0),
            agents: number(1),
            observation: number(2),
            state: number(3),
            actions: number(4),
            name: String::from_utf8(body[26..].to_vec()).expect("UTF-8"),
        };
        Self {
            input,
            output,
            hello,
            critic,
        }
    }

    /// Tells every world something, and reads what comes of it.
    pub(crate) fn advance(&mut self, orders: &[Order]) -> Worlds {
        let asked = advance(orders, self.hello.agents);
        self.output
            .write_all(&asked)
            .and_then(|()| self.output.flush())
            .expect("somebody reads");
        let (kind, body) = read(&mut self.input).expect("an answer");
        assert_eq!(kind, 2, "{}", String::from_utf8_lossy(&body));
        let all = self.hello.worlds * self.hello.agents;
        let mut values = body.chunks_exact(4).map(|bytes| {
            let bytes = bytes.try_into().expect("four");
            f32::from_le_bytes(bytes)
        });
        let mut take = |count: usize| -> Vec<f32> { values.by_ref().take(count).collect() };
        let observations = take(all * self.hello.observation);
        let rewards = take(all);
        let states = take(if self.critic {
            all * self.hello.state
        } else {
            0
        });
        let floats = observations.len() + rewards.len() + states.len();
        let statuses = body[4 * floats..].to_vec();
        assert_eq!(statuses.len(), self.hello.worlds);
        Worlds {
            observations,
            rewards,
            states,
            statuses,
        }
    }
}

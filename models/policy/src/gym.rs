//! Environments for those who learn elsewhere: a protocol over a pair of pipes.
//!
//! One process serves many environments, here called worlds. All of them are told in one message what to do, and answer
//! in one. Which worlds there are is said when the process is started; nothing here opens a file or a socket.
//!
//! # Frames
//! Numbers are little-endian. A frame is its length as `u32`, without these four bytes; a byte that says what it is; and
//! what belongs to it.
//!
//! | asked | | |
//! |---|---|---|
//! | 1 | hello | `TCGY`, [`VERSION`] as `u16`, a byte of flags: 1 asks for what a privileged critic sees |
//! | 2 | advance | see below |
//! | 3 | close | nothing; so does the end of the input |
//!
//! | answered | | |
//! |---|---|---|
//! | 1 | hello | `TCGY`, [`VERSION`] as `u16`; as `u32` the worlds, the agents of each, the numbers that an agent observes, those that a critic sees, the actions to choose from; then a name in UTF-8 |
//! | 2 | worlds | see below |
//! | 3 | refused | why, in UTF-8: nothing was done, and nothing more is answered |
//!
//! Hello comes first, and once. In any version it begins with these six bytes.
//!
//! *Advance* is a byte for each world: 0 to act, 1 to begin an episode of training, 2 to begin one of evaluation, 3 to
//! leave the world alone; then a byte for each agent of each world: its action, which is not looked at where the world
//! does not act; then 16 bytes for each world that begins an episode, in the order of the worlds: a `u64` and two
//! `u32`, what [`Seed::training`] takes, or 0, 0 and what [`Seed::evaluation`] takes. So whoever asks cannot come by a
//! world of evaluation where it means to learn. A world acts between the beginning and the end of an episode.
//!
//! *Worlds* is, as `f32` and for each agent of each world: what it observes; its reward, 0 where the world did not act;
//! what a critic sees, where hello asked for it. Then a byte for each world: 0 while its episode goes on, 1 when it has come to
//! its end, 2 when it was broken off, 3 before the first one; and 4 more where it has reached its goal.
//!
//! No answer, and no memory here, is larger than the number of worlds makes it, whatever comes in.

mod fault;
mod frame;

use std::io::{self, Read, Write};
use std::num::NonZeroUsize;

pub use fault::{Fault, ServeError};
use frame::{Advance, Request, Sizes, Told};

use crate::compute::Compute;
use crate::environment::{Environment, Interface, Seed, Status};

/// Of the protocol.
pub const VERSION: u16 = 1;

/// What hello begins with, either way.
const MAGIC: [u8; 4] = *b"TCGY";
/// Added to the status of an episode that has reached its goal.
const SUCCEEDED: u8 = 4;
/// A thread is not worth its while for fewer worlds.
const WORLDS_EACH: usize = 8;

/// What a frame is that is answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Answer {
    Hello = 1,
    Worlds = 2,
    Refused = 3,
}

/// Serves `worlds` environments until the input ends. `name` is said in hello; threads change nothing but the time.
///
/// # Errors
/// See [`ServeError`]. What was refused has been answered.
pub fn serve<E: Environment>(
    name: &str,
    worlds: NonZeroUsize,
    make: impl Fn() -> E,
    threads: NonZeroUsize,
    input: impl Read,
    output: impl Write,
) -> Result<(), ServeError> {
    let mut served = Served::new(worlds, make, threads);
    let mut pipe = Pipe {
        input,
        output,
        asked: vec![0; served.sizes.longest()],
        answer: Vec::new(),
    };
    let result = pipe.serve(name, &mut served);
    if let Err(ServeError::Refused(fault)) = &result {
        // Whoever asked may be gone.
        let _ = pipe.answer(Answer::Refused, |out| {
            out.extend(fault.to_string().as_bytes());
        });
    }
    result
}

/// Both ends, and room for one frame each way.
struct Pipe<I, O> {
    input: I,
    output: O,
    asked: Vec<u8>,
    answer: Vec<u8>,
}

impl<I: Read, O: Write> Pipe<I, O> {
    fn serve<E: Environment>(
        &mut self,
        name: &str,
        served: &mut Served<E>,
    ) -> Result<(), ServeError> {
        let mut greeted = false;
        while let Some(length) = self.next()? {
            let asked = &self.asked[..length];
            match (Request::parse(asked, &served.sizes)?, greeted) {
                (Request::Hello { critic }, false) => {
                    greeted = true;
                    served.critic = critic;
                    self.answer(Answer::Hello, |out| served.sizes.describe(name, out))?;
                }
                (Request::Hello { .. }, true) => return Err(Fault::Again.into()),
                (_, false) => return Err(Fault::NoHello.into()),
                (Request::Advance(advance), true) => {
                    served.tell(&advance)?;
                    served.advance();
                    self.answer(Answer::Worlds, |out| served.write(out))?;
                }
                (Request::Close, true) => break,
            }
        }
        Ok(())
    }

    /// Reads a frame; how many bytes it has. `None` when there is none any more.
    fn next(&mut self) -> Result<Option<usize>, ServeError> {
        let mut length = [0; 4];
        match fill(&mut self.input, &mut length)? {
            0 => return Ok(None),
            4 => {}
            _ => return Err(Fault::Cut.into()),
        }
        let told = u32::from_le_bytes(length);
        let most = self.asked.len();
        let length = told as usize;
        let room = self.asked.get_mut(..length).filter(|room| !room.is_empty());
        let room = room.ok_or(Fault::Length { told, most })?;
        if fill(&mut self.input, room)? < length {
            return Err(Fault::Cut.into());
        }
        Ok(Some(length))
    }

    fn answer(&mut self, kind: Answer, write: impl FnOnce(&mut Vec<u8>)) -> Result<(), ServeError> {
        self.answer.clear();
        self.answer.extend([0; 4]);
        self.answer.push(kind as u8);
        write(&mut self.answer);
        let length = u32::try_from(self.answer.len() - 4).map_err(|_| Fault::Worlds)?;
        self.answer[..4].copy_from_slice(&length.to_le_bytes());
        self.output
            .write_all(&self.answer)
            .and_then(|()| self.output.flush())
            .map_err(ServeError::Output)
    }
}

/// Reads until `room` is full or the input ends; how many bytes came.
fn fill(input: &mut impl Read, room: &mut [u8]) -> Result<usize, ServeError> {
    let mut filled = 0;
    while filled < room.len() {
        match input.read(&mut room[filled..]) {
            Ok(0) => break,
            Ok(read) => filled += read,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(ServeError::Input(error)),
        }
    }
    Ok(filled)
}

/// The worlds.
struct Served<E> {
    sizes: Sizes,
    worlds: Vec<World<E>>,
    threads: usize,
    /// Whether to say what a privileged critic sees.
    critic: bool,
}

impl<E: Environment> Served<E> {
    fn new(worlds: NonZeroUsize, make: impl Fn() -> E, threads: NonZeroUsize) -> Self {
        let worlds: Vec<_> = (0..worlds.get()).map(|_| World::new(make())).collect();
        Self {
            sizes: Sizes {
                worlds: worlds.len(),
                // There is at least one, and all are alike.
                interface: worlds[0].environment.interface(),
            },
            threads: threads.get().min(worlds.len().div_ceil(WORLDS_EACH)),
            worlds,
            critic: false,
        }
    }

    /// Tells each world what to do, or none of them.
    fn tell(&mut self, advance: &Advance<'_>) -> Result<(), Fault> {
        for (number, (world, told)) in self.worlds.iter().zip(advance.told()).enumerate() {
            if told == Told::Act && !world.runs() {
                return Err(Fault::NoEpisode { world: number });
            }
        }
        let agents = self.sizes.interface.agents;
        for (number, (world, told)) in self.worlds.iter_mut().zip(advance.told()).enumerate() {
            world.told = told;
            let actions = &advance.actions()[number * agents..][..agents];
            world.actions.copy_from_slice(actions);
        }
        Ok(())
    }

    fn advance(&mut self) {
        let critic = self.critic;
        let mut threads = vec![(); self.threads];
        Compute::spread(&mut self.worlds, &mut threads, |(), worlds| {
            for world in worlds {
                world.advance(critic);
            }
        });
    }

    fn write(&self, out: &mut Vec<u8>) {
        for part in 0..if self.critic { 3 } else { 2 } {
            for world in &self.worlds {
                let values = [&world.observed, &world.rewards, &world.state][part];
                let begin = out.len();
                out.resize(begin + 4 * values.len(), 0);
                for (out, value) in out[begin..].chunks_exact_mut(4).zip(values) {
                    out.copy_from_slice(&value.to_le_bytes());
                }
            }
        }
        out.extend(self.worlds.iter().map(World::status));
    }
}

/// A world with room for what it is told and what it answers.
struct World<E> {
    environment: E,
    interface: Interface,
    /// `None` before the first episode.
    status: Option<Status>,
    told: Told,
    actions: Vec<u8>,
    observed: Vec<f32>,
    rewards: Vec<f32>,
    state: Vec<f32>,
}

impl<E: Environment> World<E> {
    fn new(environment: E) -> Self {
        let interface = environment.interface();
        let agents = interface.agents;
        Self {
            environment,
            interface,
            status: None,
            told: Told::Rest,
            actions: vec![0; agents],
            observed: vec![0.0; agents * interface.observation],
            rewards: vec![0.0; agents],
            state: vec![0.0; agents * interface.state],
        }
    }

    fn runs(&self) -> bool {
        self.status == Some(Status::Running)
    }

    fn advance(&mut self, critic: bool) {
        match self.told {
            Told::Rest => return self.rewards.fill(0.0),
            Told::Act => {
                self.status = Some(self.environment.step(&self.actions, &mut self.rewards));
            }
            Told::Begin(seed) => self.begin(seed),
        }
        let Interface {
            observation, state, ..
        } = self.interface;
        let agents = self.observed.chunks_exact_mut(observation.max(1));
        for (agent, out) in agents.enumerate() {
            self.environment.observe(agent, out);
        }
        if critic {
            let agents = self.state.chunks_exact_mut(state.max(1));
            for (agent, out) in agents.enumerate() {
                self.environment.state(agent, out);
            }
        }
    }

    fn begin(&mut self, seed: Seed) {
        self.environment.reset(seed);
        self.status = Some(Status::Running);
        self.rewards.fill(0.0);
    }

    fn status(&self) -> u8 {
        let status = match self.status {
            Some(Status::Running) => return 0,
            Some(Status::Terminated) => 1,
            Some(Status::Truncated) => 2,
            None => return 3,
        };
        status
            + if self.environment.succeeded() {
                SUCCEEDED
            } else {
                0
            }
    }
}

//! The activity that runs the network of a policy.

use core::convert::Infallible;
use core::ops::Deref;

use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;
use rand_core::Rng;

use crate::context::Robot;
use crate::context::handles::PolicyHandle;
use crate::hold::Hold;
use crate::policy::decisions::named;
use crate::policy::shadow::Compared;
use crate::policy::{
    Action, Also, Asked, Decision, Installed, Mode, Named, NoShelf, Observation, Open, Policy,
    PolicyError, Scratch, Shelf,
};

/// Decides whenever control asks, by a policy; lets others run between two layers of its network.
///
/// Bytes that are no policy are told to whoever asks for the behaviour, and nothing is decided.
///
/// Where somebody wants to know how another policy compares ([`Robot::shadow`]), that one decides as well, on the same
/// observation and after it, unless a newer one waits. What it chooses is counted and goes nowhere else.
///
/// # Cancellation Safety
/// A dropped activity decides no more, and a robot that drives by a policy stands 300 ms later.
pub async fn decide<M: RawMutex, R: Rng>(
    robot: impl Deref<Target = Robot<M>>,
    policy: Named<'_>,
    rng: R,
) -> Infallible {
    run(&*robot, policy, NoShelf, rng).await
}

/// As [`decide()`], also by the policy on the shelf, which has precedence over the one of the program where both are called
/// the same.
///
/// # Cancellation Safety
/// As [`decide()`].
pub async fn decide_with_shelf<M: RawMutex + 'static, R: Rng, H: Hold + 'static>(
    robot: impl Deref<Target = Robot<M>>,
    policy: Named<'_>,
    shelf: impl Deref<Target = Shelf<M, H>>,
    rng: R,
) -> Infallible {
    run(&*robot, policy, shelf, rng).await
}

async fn run<M: RawMutex, R: Rng, A: Also>(
    robot: &Robot<M>,
    policy: Named<'_>,
    also: A,
    mut rng: R,
) -> Infallible {
    let robot = robot.policy_handle();
    let name = named(policy.name);
    let own = Policy::new(policy.blob);
    robot.install(match own {
        Ok(_) => Installed::Policy(name),
        Err(PolicyError::OtherObservation) => Installed::Other(name),
        Err(_) => Installed::Bad(name),
    });
    let own = own.as_ref().ok();
    let (never, newer): (Option<PolicyHandle<'_, M>>, _) = (None, Some(robot));
    loop {
        let (asked, driving) = robot.asked().await;
        let Asked {
            observation,
            around,
            number,
        } = asked;
        let of = |wanted| own.filter(|_| wanted == name);
        let Some((scratch, mode)) = ran(of(driving), &also, driving, &observation, never).await
        else {
            continue;
        };
        let mut drawn = Drawn::default();
        let action = scratch.action(mode, || drawn.note(rng.next_u32() as u8));
        robot.decide(Decision {
            action: action as u8,
            number,
        });
        let Some(candidate) = robot.candidate(driving) else {
            continue;
        };
        // It has what time is left until the next observation, and moves nothing.
        yield_now().await;
        let (own, wanted) = (of(candidate.name), candidate.name);
        let chosen = ran(own, &also, wanted, &observation, newer).await;
        if let Some((scratch, mode)) = chosen {
            let mut bytes = drawn.again(number).into_iter();
            let chosen = scratch.action(mode, || bytes.next().unwrap_or(0));
            robot.count(candidate, driving, Compared::new(action, chosen, around));
        }
    }
}

/// What the network of a policy comes to, and how its action is chosen; nothing where the policy is not there: the one of the
/// program where it is `own`, or that of the name that is `wanted`. Nothing either once there is an observation that it is
/// to give way to.
async fn ran<M: RawMutex, A: Also>(
    own: Option<&Policy<'_>>,
    also: &A,
    wanted: u32,
    observation: &Observation,
    gives_way: Option<PolicyHandle<'_, M>>,
) -> Option<(Scratch, Mode)> {
    let opened = also.open(wanted).await;
    let mut scratch = Scratch::new(observation);
    let mut layer = 0;
    while !gives_way.is_some_and(PolicyHandle::is_asked) {
        let ran = by(own, opened.as_ref(), |policy| {
            policy.layers().nth(layer).map(|layer| scratch.run(layer))
        });
        if ran.flatten().is_none() {
            return by(own, opened.as_ref(), |policy| policy.mode).map(|mode| (scratch, mode));
        }
        layer += 1;
        yield_now().await;
    }
    None
}

/// The random bytes of a decision, for a candidate to decide by as well: whoever has the same network then chooses the
/// same, and the next decision of the policy that drives draws what it would draw without a candidate.
#[derive(Default)]
struct Drawn {
    bytes: [u8; Action::COUNT],
    count: usize,
}

impl Drawn {
    fn note(&mut self, byte: u8) -> u8 {
        if let Some(place) = self.bytes.get_mut(self.count) {
            *place = byte;
        }
        self.count += 1;
        byte
    }

    /// Where nothing was drawn, bytes that go by the number of the observation.
    fn again(&self, number: u16) -> [u8; Action::COUNT] {
        if self.count > 0 {
            return self.bytes;
        }
        let mut state = u32::from(number).wrapping_mul(0x9E37_79B9);
        [(); Action::COUNT].map(|()| {
            // The generator of Numerical Recipes in C (1992), section 7.1, of which the high bits are the good ones.
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        })
    }
}

/// Does something by the policy that was opened, or else by that of the program. Neither is kept while others run: both would
/// have to have room then.
fn by<T>(
    own: Option<&Policy<'_>>,
    opened: Option<&impl Open>,
    with: impl FnOnce(&Policy<'_>) -> T,
) -> Option<T> {
    match opened {
        Some(opened) => opened.policy().map(|policy| with(&policy)),
        None => own.map(with),
    }
}

#[cfg(test)]
mod tests;

//! The activity that runs the network of a policy.

use core::convert::Infallible;
use core::ops::Deref;

use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;
use rand_core::Rng;

use crate::context::Robot;
use crate::hold::Hold;
use crate::policy::decisions::named;
use crate::policy::{
    Also, Asked, Decision, Installed, Named, NoShelf, Open, Policy, PolicyError, Scratch, Shelf,
};

/// Decides whenever control asks, by a policy; lets others run between two layers of its network.
///
/// Bytes that are no policy are told to whoever asks for the behaviour, and nothing is decided.
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
    loop {
        let (asked, wanted) = robot.asked().await;
        let Asked {
            observation,
            number,
        } = asked;
        let opened = also.open(wanted).await;
        let own = own.as_ref().ok().filter(|_| wanted == name);
        let mut scratch = Scratch::new(&observation);
        let mut layer = 0;
        while by(own, opened.as_ref(), |policy| {
            policy.layers().nth(layer).map(|layer| scratch.run(layer))
        })
        .flatten()
        .is_some()
        {
            layer += 1;
            yield_now().await;
        }
        let random = || rng.next_u32() as u8;
        let action = by(own, opened.as_ref(), |policy| {
            scratch.action(policy.mode, random)
        });
        if let Some(action) = action {
            robot.decide(Decision {
                action: action as u8,
                number,
            });
        }
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

//! The activity that runs the network of a policy.

use core::convert::Infallible;
use core::ops::Deref;

use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;
use rand_core::Rng;

use crate::context::Robot;
use crate::policy::decisions::named;
use crate::policy::{Asked, Decision, Installed, Named, Policy, PolicyError, Scratch};

/// Decides whenever control asks, by a policy; lets others run between two layers of its network.
///
/// Bytes that are no policy are told to whoever asks for the behaviour, and nothing is decided.
///
/// # Cancellation Safety
/// A dropped activity decides no more, and a robot that drives by a policy stands 300 ms later.
pub async fn decide<M: RawMutex, R: Rng>(
    robot: impl Deref<Target = Robot<M>>,
    policy: Named<'_>,
    mut rng: R,
) -> Infallible {
    let robot = robot.policy_handle();
    let name = named(policy.name);
    let policy = Policy::new(policy.blob);
    robot.install(match policy {
        Ok(_) => Installed::Policy(name),
        Err(PolicyError::OtherObservation) => Installed::Other,
        Err(_) => Installed::Bad,
    });
    loop {
        let Asked {
            observation,
            number,
        } = robot.asked().await;
        let Ok(policy) = &policy else { continue };
        let mut scratch = Scratch::new(&observation);
        for layer in policy.layers() {
            scratch.run(layer);
            yield_now().await;
        }
        let action = scratch.action(policy.mode, || rng.next_u32() as u8);
        robot.decide(Decision {
            action: action as u8,
            number,
        });
    }
}

#[cfg(test)]
mod tests;

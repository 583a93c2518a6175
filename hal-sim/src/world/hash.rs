//! Fingerprints of state.

use rand_core::Rng;
use rand_pcg::Pcg32;

use super::bodies::{Bodies, Bridge};
use super::movers::Movers;

/// FNV-1a (Fowler, Noll, Vo), 64 bits, over whole words: fixed for ever, unlike `std`'s hasher.
/// Each word is folded once more, because FNV moves nothing downwards.
#[derive(Debug)]
pub(crate) struct Hasher(u64);

impl Hasher {
    pub(crate) const fn new() -> Self {
        Self(0xCBF2_9CE4_8422_2325)
    }

    pub(crate) fn word(&mut self, word: u64) {
        let mixed = (self.0 ^ word).wrapping_mul(0x0000_0100_0000_01B3);
        self.0 = mixed ^ (mixed >> 32);
    }

    fn float(&mut self, value: f32) {
        self.word(u64::from(value.to_bits()));
    }

    /// Where a generator stands, told by what it would give next.
    pub(crate) fn generator(&mut self, rng: &Pcg32) {
        self.word(rng.clone().next_u64());
    }

    fn bridge(&mut self, bridge: Bridge) {
        self.word(u64::from(bridge.duty) | u64::from(bridge.in1) << 8 | u64::from(bridge.in2) << 9);
    }

    pub(crate) const fn finish(&self) -> u64 {
        self.0
    }
}

/// Where the movers are on their paths.
pub(crate) fn movers(hasher: &mut Hasher, movers: &Movers) {
    for k in 0..movers.len() {
        hasher.word(movers.way(k).to_bits());
    }
}

/// Takes in all there is to know of body `i`.
pub(crate) fn body(hasher: &mut Hasher, bodies: &Bodies, i: usize) {
    let seen = &bodies.published;
    for pair in [seen.at[i], seen.heading[i], seen.velocity[i]] {
        hasher.float(pair.x);
        hasher.float(pair.y);
    }
    hasher.float(seen.spin[i]);
    hasher.word(u64::from(seen.contacts_now[i]));
    hasher.word(u64::from(seen.push[i].0));
    hasher.float(seen.push[i].1);
    hasher.word(u64::from(bodies.rolls[i]));
    hasher.word(bodies.energy_j[i].to_bits());
    hasher.float(bodies.left[i]);
    hasher.float(bodies.right[i]);
    hasher.float(bodies.supply_v[i]);
    hasher.word(bodies.charge_as[i].to_bits());
    hasher.bridge(bodies.inputs[i].left);
    hasher.bridge(bodies.inputs[i].right);
    hasher.word(u64::from(bodies.inputs[i].lamp));
    let build = bodies.build[i];
    hasher.float(build.left);
    hasher.float(build.right);
    hasher.float(build.friction[0]);
    hasher.float(build.friction[1]);
    hasher.float(build.mass_kg);
    hasher.float(build.track_m);
    hasher.float(build.internal_ohm);
    let [left, right] = build.shorted.map(u64::from);
    hasher.word(left | right << 1 | u64::from(build.dips) << 2);
    hasher.word(u64::from(bodies.contacts[i]));
    hasher.word(u64::from(bodies.hold[i]));
    hasher.word(seen.presence[i] as u64);
    hasher.word(bodies.next.last_ping[i]);
}

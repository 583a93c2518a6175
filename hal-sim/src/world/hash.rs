//! What of a state goes into its fingerprint.

use super::bodies::{Bodies, Bridge};
use super::fingerprint::StateFingerprint;
use super::movers::Movers;

fn bridge(print: &mut StateFingerprint, bridge: Bridge) {
    print.word(u64::from(bridge.duty) | u64::from(bridge.in1) << 8 | u64::from(bridge.in2) << 9);
}

/// Where the movers are on their paths.
pub(crate) fn movers(print: &mut StateFingerprint, movers: &Movers) {
    for k in 0..movers.len() {
        print.word(movers.way(k).to_bits());
    }
}

/// Takes in all there is to know of body `i`.
pub(crate) fn body(print: &mut StateFingerprint, bodies: &Bodies, i: usize) {
    let seen = &bodies.published;
    for pair in [seen.at[i], seen.heading[i], seen.velocity[i]] {
        print.float(pair.x);
        print.float(pair.y);
    }
    print.float(seen.spin[i]);
    print.word(u64::from(seen.contacts_now[i]));
    print.word(u64::from(seen.push[i].0));
    print.float(seen.push[i].1);
    print.word(u64::from(bodies.rolls[i]));
    print.word(bodies.energy_j[i].to_bits());
    print.float(bodies.left[i]);
    print.float(bodies.right[i]);
    print.float(bodies.supply_v[i]);
    print.word(bodies.charge_as[i].to_bits());
    bridge(print, bodies.inputs[i].left);
    bridge(print, bodies.inputs[i].right);
    print.word(u64::from(bodies.inputs[i].lamp));
    let build = bodies.build[i];
    print.float(build.left);
    print.float(build.right);
    print.float(build.friction[0]);
    print.float(build.friction[1]);
    print.float(build.mass_kg);
    print.float(build.track_m);
    print.float(build.internal_ohm);
    let [left, right] = build.shorted.map(u64::from);
    print.word(left | right << 1 | u64::from(build.dips) << 2);
    print.word(u64::from(bodies.contacts[i]));
    print.word(u64::from(bodies.hold[i]));
    print.word(seen.presence[i] as u64);
    print.word(bodies.next.last_ping[i]);
}

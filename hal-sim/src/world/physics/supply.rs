//! The battery under load.

use super::super::battery::open_circuit_v;
use super::super::bodies::{Drive, Inputs, Presence};
use super::super::space::Space;
use super::{BROWN_OUT_HYSTERESIS_V, Power};

impl Space {
    /// Takes a step's charge out of the pack of robot `i`, and its voltage. Sag and the current
    /// that causes it are solved together, so that no resistance makes them swing. Returns whether
    /// its supply failed or came back.
    pub(super) fn draw_power(
        &mut self,
        i: usize,
        inputs: Inputs,
        power: &mut impl FnMut(usize, Power),
    ) -> bool {
        let bodies = &mut self.bodies;
        let build = &bodies.build[i];
        let pack = &self.parameters.pack;
        let train = &self.train;
        let share = (bodies.charge_as[i] * self.per_capacity) as f32;
        let open_v = open_circuit_v(share);
        let powered = bodies.published.presence[i] == Presence::Present;
        let (mut current, mut volts) = (0.0, open_v);
        if powered {
            current = pack.quiescent_a;
            volts = open_v - build.internal_ohm * current;
            let wheels = [
                (inputs.left, build.left, bodies.left[i]),
                (inputs.right, build.right, bodies.right[i]),
            ];
            // What each motor draws is `per_volt` · supply − `less`; nothing flows back.
            let (mut per_volt, mut less) = (0.0, 0.0);
            let before = bodies.supply_v[i];
            for (bridge, gain, rim) in wheels {
                let sign = match bridge.drive() {
                    Drive::Forward => 1.0,
                    Drive::Backward => -1.0,
                    Drive::Brake => continue,
                };
                let duty = f32::from(bridge.duty) * (1.0 / 255.0);
                let strength = duty * duty * gain * train.per_ohm;
                let back = duty * sign * train.back_v * rim * train.per_ohm
                    + strength * self.parameters.chassis.bridge_drop_v;
                if strength * before > back {
                    per_volt += strength;
                    less += back;
                }
            }
            if per_volt > 0.0 {
                let ohm = build.internal_ohm;
                let loaded = (volts + ohm * less) / (1.0 + ohm * per_volt);
                // A motor that was driven by its wheel a moment ago may be so still.
                let motors = (per_volt * loaded - less).max(0.0);
                volts -= ohm * motors;
                current += motors;
            }
        }
        if build.dips {
            volts = volts.min(pack.brown_out_v - BROWN_OUT_HYSTERESIS_V);
        }
        volts = volts.max(0.0);
        let charge = &mut bodies.charge_as[i];
        let drawn = f64::from(current * self.dt);
        *charge = (*charge - drawn).max(0.0);
        bodies.energy_j[i] += drawn * f64::from(volts);
        bodies.supply_v[i] = volts;
        if powered && volts < pack.brown_out_v {
            bodies.published.presence[i] = Presence::Unpowered;
            // The outputs of a dead microcontroller float, and the bridge pulls its inputs low.
            bodies.inputs[i] = Inputs::default();
            power(i, Power::Lost);
            true
        } else if !powered && volts > pack.brown_out_v + BROWN_OUT_HYSTERESIS_V {
            bodies.published.presence[i] = Presence::Present;
            power(i, Power::Restored);
            true
        } else {
            false
        }
    }
}

//! Breaking a body and mending it, by one call for every device.

use super::ports::Ports;
use crate::faults::{CameraFault, Fault, FaultError, Faults, Part, RangerFault, Wheel};
use crate::world::Space;

/// Breaks something of a body.
pub(crate) fn inject(ports: &Ports, fault: Fault) -> Result<(), FaultError> {
    fault.validate()?;
    mend(ports, Part::of(&fault));
    let mut faults = ports.faults.get();
    let space = &mut *ports.shared.space.borrow_mut();
    let i = ports.index();
    match fault {
        Fault::RangerDead => faults.ranger = Some(RangerFault::Dead),
        Fault::RangerStuck { mm } => faults.ranger = Some(RangerFault::Stuck(mm)),
        Fault::RangerNoisy { mm } => faults.ranger = Some(RangerFault::Noisy(mm)),
        Fault::LineNoise { flips } => faults.bit_flips = flips,
        Fault::LineStuck => faults.line_stuck = true,
        Fault::FlashNoise { seed } => ports.chip.borrow_mut().fill_with_noise(u64::from(seed)),
        Fault::MotorWeak { wheel, strength } => weaken(ports, space, wheel, strength),
        Fault::MotorDead { wheel } => weaken(ports, space, wheel, 0.0),
        Fault::MotorStuckOn { wheel } => {
            space.bodies.build[i].shorted[usize::from(wheel == Wheel::Right)] = true;
        }
        Fault::BrownOut => space.bodies.build[i].dips = true,
        Fault::BatterySag { ohm } => {
            space.bodies.build[i].internal_ohm = ports.sound.internal_ohm + ohm;
        }
        Fault::BatteryAt { charge } => {
            space.bodies.charge_as[i] = f64::from(charge) / space.per_capacity;
        }
        Fault::CameraAbsent => faults.camera = Some(CameraFault::Absent),
        Fault::CameraStalled => faults.camera = Some(CameraFault::Stalled),
        Fault::CameraGarbage => faults.camera = Some(CameraFault::Garbage),
        Fault::FlashPowerCut { after_bytes } => {
            ports
                .chip
                .borrow_mut()
                .cut_power_after(u64::from(after_bytes));
        }
        Fault::LinkLoss { .. } | Fault::HostilePackets { .. } | Fault::ClockStep { .. } => {
            return Err(FaultError::NotOfBody);
        }
    }
    ports.faults.set(faults);
    Ok(())
}

fn weaken(ports: &Ports, space: &mut Space, wheel: Wheel, strength: f32) {
    let build = &mut space.bodies.build[ports.index()];
    match wheel {
        Wheel::Left => build.left = ports.sound.left * strength,
        Wheel::Right => build.right = ports.sound.right * strength,
    }
}

/// Mends one part of a body. What a fault has destroyed stays destroyed: charge that is gone,
/// and what noise has overwritten.
pub(crate) fn mend(ports: &Ports, part: Part) {
    let mut faults = ports.faults.get();
    let space = &mut *ports.shared.space.borrow_mut();
    let build = &mut space.bodies.build[ports.index()];
    match part {
        Part::Ranger => faults.ranger = None,
        Part::LineNoise => faults.bit_flips = 0.0,
        Part::LineStuck => {
            faults.line_stuck = false;
            ports.sonar.borrow_mut().hanging = 0;
        }
        Part::Left => {
            build.left = ports.sound.left;
            build.shorted[0] = false;
        }
        Part::Right => {
            build.right = ports.sound.right;
            build.shorted[1] = false;
        }
        Part::Supply => build.dips = false,
        Part::Sag => build.internal_ohm = ports.sound.internal_ohm,
        Part::FlashPower => ports.chip.borrow_mut().keep_power(),
        Part::Camera => faults.camera = None,
        Part::Link | Part::Packets | Part::Clock | Part::Charge | Part::FlashNoise => {}
    }
    ports.faults.set(faults);
}

/// Mends everything but the charge that is gone.
pub(crate) fn heal(ports: &Ports) {
    ports.faults.set(Faults::NONE);
    ports.sonar.borrow_mut().hanging = 0;
    ports.shared.space.borrow_mut().bodies.build[ports.index()] = ports.sound;
    ports.chip.borrow_mut().keep_power();
}

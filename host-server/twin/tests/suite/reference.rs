//! The reference reality: forces on masses in steps of a millisecond, and what a twin does not model.

use crawler_twin::body::Pose;
use crawler_twin::evidence::{Duty, Evidence, Fix, Row, Supply};

/// Numbers from a seed: `SplitMix64`.
#[derive(Debug, Clone)]
pub(crate) struct Random(u64);

impl Random {
    pub(crate) const fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Evenly from 0 to 1.
    pub(crate) fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Evenly within so much of 1.
    pub(crate) fn about(&mut self, spread: f64) -> f64 {
        1.0 + spread * (2.0 * self.share() - 1.0)
    }

    /// Bell-shaped, with deviation 1.
    pub(crate) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.share()).sum::<f64>() - 6.0
    }
}

/// A hidden robot.
#[derive(Debug, Clone)]
pub(crate) struct Hidden {
    pub(crate) gain: [f64; 2],
    pub(crate) speed_per_volt: f64,
    pub(crate) running_v: [f64; 2],
    pub(crate) breakaway: f64,
    pub(crate) mass: f64,
    pub(crate) gyration: f64,
    pub(crate) rotor: f64,
    pub(crate) per_ohm: f64,
    pub(crate) per_amp: f64,
    pub(crate) drag: f64,
    pub(crate) track: f64,
    pub(crate) internal: f64,
    pub(crate) drop: f64,
    pub(crate) gauge: f64,
    pub(crate) late_s: f64,
    pub(crate) open_v: f64,
    /// Strength of what no twin models: 0 is nothing of it.
    pub(crate) odd: f64,
    /// From a moment on a motor makes so much of its voltage: wheel, second, share.
    pub(crate) weak: Option<(usize, f64, f64)>,
    /// From a moment on a motor loses so much of its voltage each second: wheel, second, share.
    pub(crate) fades: Option<(usize, f64, f64)>,
    pub(crate) seed: u64,
}

impl Hidden {
    /// A robot as the wild ranges of the simulator draw it, and as robots differ.
    pub(crate) fn draw(seed: u64, odd: f64) -> Self {
        let mut random = Random::new(seed);
        let r = &mut random;
        let gain = [1.0 + 0.02 * r.normal(), 1.0 + 0.02 * r.normal()];
        let running = 0.7 * r.about(0.3);
        Self {
            gain,
            speed_per_volt: 0.128 * r.about(0.15),
            running_v: [running * r.about(0.1), running * r.about(0.1)],
            breakaway: 0.9 / 0.7 * r.about(0.1),
            mass: 0.4 * r.about(0.25),
            gyration: 0.07 * r.about(0.2),
            rotor: 0.215 * r.about(0.3),
            per_ohm: 1.0 / (6.6 * r.about(0.15)),
            per_amp: 3.9 * r.about(0.2),
            drag: 0.18 * r.about(0.5),
            track: 0.14 * r.about(0.05),
            internal: 0.18 * r.about(0.5),
            drop: 1.4 * r.about(0.2),
            gauge: 1.0 + 0.01 * r.normal(),
            late_s: 0.005 + 0.29 * r.share(),
            open_v: 7.4 + 0.8 * r.share(),
            odd,
            weak: None,
            fades: None,
            seed,
        }
    }

    #[allow(dead_code, reason = "not everybody who has this file asks for it")]
    /// Speed at which a wheel settles on a pack of `volts`, metres per second.
    pub(crate) fn settled(&self, wheel: usize, duty: f64, volts: f64) -> f64 {
        let motor = duty * (volts - self.drop) * self.gain[wheel];
        (motor - self.running_v[wheel]).max(0.0) * self.speed_per_volt
    }

    /// What the gauge shows of `volts`.
    pub(crate) fn shown(&self, volts: f64) -> f64 {
        volts * self.gauge
    }
}

/// Duties to reach, one after the other: seconds, left, right.
pub(crate) type Script = Vec<(f64, f64, f64)>;

/// Baseline: straights, turns, arcs and creeping, about 75 s.
pub(crate) fn baseline() -> Script {
    let mut script = vec![(2.0, 0.0, 0.0)];
    let mut add = |seconds: f64, left: f64, right: f64| {
        script.push((seconds, left, right));
        script.push((0.7, 0.0, 0.0));
    };
    for speed in [0.3, 0.45, 0.6, 0.8] {
        add(2.2, speed, speed);
        add(2.2, -speed, -speed);
    }
    for speed in [0.3, 0.45, 0.6] {
        add(1.6, -speed, speed);
        add(1.6, speed, -speed);
    }
    for (left, right) in [(0.35, 0.6), (0.6, 0.35), (-0.35, -0.6), (-0.6, -0.35)] {
        add(2.5, left, right);
    }
    for speed in [0.15, 0.18, 0.22, -0.2] {
        add(1.5, speed, speed);
    }
    script
}

/// A drive at random.
pub(crate) fn anyhow(seconds: f64, random: &mut Random) -> Script {
    let (mut script, mut sum) = (Vec::new(), 0.0);
    while sum < seconds {
        let span = 0.8 + 2.2 * random.share();
        let middle = if random.share() < 0.15 {
            -0.4
        } else {
            0.35 + 0.35 * random.share()
        };
        let turn = 0.25 * (2.0 * random.share() - 1.0);
        script.push((span, middle - turn, middle + turn));
        sum += span;
    }
    script
}

/// What is published, and where the robot truly was, by milliseconds.
pub(crate) struct Story {
    pub(crate) duties: Vec<Duty>,
    pub(crate) supply: Vec<Supply>,
    pub(crate) fixes: Vec<Fix>,
    pub(crate) truth: Vec<Pose>,
    /// Way of the middle by milliseconds, metres.
    pub(crate) way: Vec<f64>,
}

impl Story {
    /// All of it in the order in which it arrives.
    #[allow(dead_code, reason = "not everybody who has this file follows a robot")]
    pub(crate) fn rows(&self) -> Vec<Row> {
        let mut rows: Vec<Row> = Vec::new();
        rows.extend(self.duties.iter().copied().map(Row::Duty));
        rows.extend(self.supply.iter().copied().map(Row::Supply));
        rows.extend(self.fixes.iter().copied().map(Row::Fix));
        let at = |row: &Row| row.arrived_s().unwrap_or(0.0);
        rows.sort_by(|a, b| at(a).total_cmp(&at(b)));
        rows
    }

    /// All of it, in order, as evidence.
    pub(crate) fn evidence(&self) -> Evidence {
        let mut evidence = Evidence::default();
        for row in &self.duties {
            evidence.duty(*row).expect("a sound duty");
        }
        for row in &self.supply {
            evidence.supply(*row).expect("a sound voltage");
        }
        for row in &self.fixes {
            evidence.fix(*row).expect("a sound fix");
        }
        evidence
    }
}

/// How often what is said, per second.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rates {
    pub(crate) telemetry: u32,
    pub(crate) fixes: u32,
}

/// How often while a robot is calibrated.
pub(crate) const CALIBRATING: Rates = Rates {
    telemetry: 20,
    fixes: 10,
};

/// A robot drives what one is calibrated on, and some more to validate on, with its motors as they were before any fault.
pub(crate) fn calibration(hidden: &Hidden, rates: Rates) -> Story {
    let mut script = baseline();
    script.extend(anyhow(42.0, &mut Random::new(hidden.seed ^ 7)));
    let healthy = Hidden {
        weak: None,
        fades: None,
        ..hidden.clone()
    };
    drive(&healthy, &script, rates)
}

/// A step, seconds.
const DT: f64 = 1e-3;

/// Lets a hidden robot drive.
pub(crate) fn drive(hidden: &Hidden, script: &Script, rates: Rates) -> Story {
    let (mut stage, mut until) = (0, script[0].0);
    let total: f64 = script.iter().map(|(seconds, _, _)| seconds).sum();
    drive_by(hidden, rates, |now, _, _| {
        while now >= until && stage + 1 < script.len() {
            stage += 1;
            until += script[stage].0;
        }
        let (_, left, right) = script[stage];
        (now < total).then_some([left, right])
    })
}

/// Lets a hidden robot drive by whoever tells duties to reach fifty times a second, from the time, the newest fix and
/// the volts that the gauge shows; until there are none.
pub(crate) fn drive_by(
    hidden: &Hidden,
    rates: Rates,
    mut target: impl FnMut(f64, Option<&Fix>, f64) -> Option<[f64; 2]>,
) -> Story {
    let mut random = Random::new(hidden.seed ^ 0x5eed);
    let mut story = Story {
        duties: Vec::new(),
        supply: Vec::new(),
        fixes: Vec::new(),
        truth: Vec::new(),
        way: Vec::new(),
    };
    let h = hidden;
    let (mut duty, mut rims, mut pose, mut way) =
        ([0.0_f64; 2], [0.0_f64; 2], Pose::default(), 0.0);
    let (mut volts, mut smooth) = (h.open_v, h.open_v);
    let (mut drift, mut kick) = ([0.0_f64; 2], 0.0_f64);
    for ms in 0_u64.. {
        let now = ms as f64 * DT;
        if ms % 20 == 0 {
            let Some([left, right]) = target(now, story.fixes.last(), h.shown(volts)) else {
                break;
            };
            for (duty, target) in duty.iter_mut().zip([left, right]) {
                let goal = if *duty * target < 0.0 { 0.0 } else { target };
                *duty += (goal - *duty).clamp(-0.05, 0.05);
            }
            // What no twin models: gains that wander, and a castor that swings round.
            for drift in &mut drift {
                *drift += -*drift * 0.02 / 8.0 + h.odd * 0.001 * random.normal();
            }
            kick *= 0.9;
            if rims[0] + rims[1] < 0.05 && random.share() < 0.02 {
                kick = h.odd * 0.2 * random.normal();
            }
        }
        // Currents and sag of a millisecond ago will do.
        let motor_v = volts - h.drop;
        let damping = h.per_amp * h.per_ohm / h.speed_per_volt;
        let mut current = 0.15;
        let mut force = [0.0; 2];
        for k in 0..2 {
            let mut gain = h.gain[k] * (1.0 + drift[k]);
            if duty[k] < 0.0 {
                gain *= 1.0 - 0.02 * h.odd;
            }
            if let Some((wheel, from, share)) = h.weak
                && wheel == k
                && now >= from
            {
                gain *= share;
            }
            if let Some((wheel, from, per_s)) = h.fades
                && wheel == k
                && now >= from
            {
                gain *= 1.0 - per_s * (now - from);
            }
            let driven = if duty[k] == 0.0 { h.drag } else { 1.0 };
            let push = duty[k] * motor_v * gain * h.per_amp * h.per_ohm;
            let running = h.running_v[k] * h.per_amp * h.per_ohm;
            force[k] = push - driven * damping * rims[k];
            let limit = if rims[k] == 0.0 {
                running * h.breakaway
            } else {
                running
            };
            if rims[k] == 0.0 && force[k].abs() <= limit {
                force[k] = 0.0;
            } else {
                let way = if rims[k] == 0.0 { force[k] } else { rims[k] };
                force[k] -= running.copysign(way);
            }
            let back = (1.0 - h.drag) / h.speed_per_volt * rims[k];
            current +=
                (duty[k].abs() * (duty[k].abs() * motor_v - back * duty[k].signum()) * h.per_ohm)
                    .max(0.0);
        }
        volts = h.open_v - h.internal * current - 1e-4 * now;
        let ratio = h.gyration * 2.0 / h.track;
        let turn_mass = h.mass * ratio * ratio;
        let (own, other) = (
            h.rotor + (h.mass + turn_mass) * 0.25,
            (h.mass - turn_mass) * 0.25,
        );
        let scale = DT / (own * own - other * other);
        let before = rims;
        rims[0] += (force[0] * own - force[1] * other) * scale;
        rims[1] += (force[1] * own - force[0] * other) * scale;
        for k in 0..2 {
            let held = duty[k].abs() * motor_v * h.gain[k] <= h.running_v[k] * h.breakaway;
            if before[k] * rims[k] < 0.0 || (held && rims[k].abs() < 2e-4) {
                rims[k] = 0.0;
            }
        }
        let speed = (rims[0] + rims[1]) * 0.5;
        // Tyres scrub while they turn: the track acts wider the faster it turns.
        let spin = (rims[1] - rims[0]) / h.track;
        let spin = spin * (1.0 - h.odd * 0.02 * (spin.abs() / 3.0).min(1.0)) + kick * speed;
        pose.theta += spin * DT * 0.5;
        pose.x += speed * pose.theta.cos() * DT;
        pose.y += speed * pose.theta.sin() * DT;
        pose.theta += spin * DT * 0.5;
        way += speed.abs() * DT;
        story.truth.push(pose);
        story.way.push(way);
        if ms % u64::from(1000 / rates.telemetry) == 7 {
            let at_s = ((now - h.late_s) * 1e3).floor() * 1e-3;
            let arrived_s = Some(now + 0.002 + 0.003 * random.share());
            story.duties.push(Duty {
                at_s,
                arrived_s,
                duty,
            });
        }
        if ms % 1000 == 500 {
            smooth += (h.shown(volts) - smooth) * 0.25;
            let at_s = now - h.late_s;
            let volts = smooth + 0.004 * random.normal();
            let arrived_s = Some(now + 0.004);
            story.supply.push(Supply {
                at_s,
                arrived_s,
                volts,
            });
        }
        if ms % u64::from(1000 / rates.fixes) == 3 {
            let fix = Fix {
                at_s: now,
                arrived_s: Some(now + 0.005),
                x: pose.x + 0.01 * random.normal(),
                y: pose.y + 0.01 * random.normal(),
                theta: crawler_twin::body::wrap(pose.theta + 0.02 * random.normal()),
                sigma_m: 0.01,
            };
            story.fixes.push(fix);
        }
    }
    story
}

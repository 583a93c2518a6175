use super::figures::SCHEMES;
use super::survey::Survey;
use super::*;
use crate::world::RadioFigures;

/// Nothing is left to chance.
const PLAIN: RadioFigures = RadioFigures {
    latency_ms: 2.0,
    jitter_ms: 3.0,
    loss: 0.0,
    retransmit_ms: 200.0,
    rssi_dbm: -55.0,
    power_dbm: 18.5,
    first_metre_db: 40.2,
    exponent: 3.0,
    shadowing_db: 0.0,
    fading_db: 0.0,
    noise_db: 3.0,
    overhead_us: 180.0,
    contention: 0.0,
    hysteresis_db: 8.0,
    roaming_ms: 100.0,
    lost_after_ms: 2_000.0,
    joining_ms: 1_500.0,
    spike_share: 0.0,
    spike_ms: 100.0,
};

fn setup(radio: Radio, figures: RadioFigures) -> Setup {
    Setup {
        link: LinkModel::default(),
        radio: Some(radio),
        figures,
        seed: 7,
    }
}

fn medium(radio: Radio, figures: RadioFigures) -> Medium {
    Medium::new(&setup(radio.clone(), figures), radio)
}

fn point(x: f32, channel: u8) -> AccessPoint {
    AccessPoint {
        x,
        y: 0.0,
        channel,
        attenuation_db: 0.0,
    }
}

/// Bytes that each of `senders` gets through in `seconds` when it always has more to say, keeping
/// at most `ahead` bytes waiting.
fn saturate(medium: &mut Medium, senders: usize, seconds: u64, ahead: usize) -> Vec<u64> {
    let mut waiting: Vec<Vec<(u64, usize)>> = vec![Vec::new(); senders];
    let mut through = vec![0; senders];
    let mut sums = Vec::new();
    for now in (0..seconds * 1_000_000).step_by(1_000) {
        for sender in 0..senders {
            let queue = &mut waiting[sender];
            queue.retain(|&(at, len)| {
                let arrived = at <= now;
                through[sender] += if arrived { len as u64 } else { 0 };
                !arrived
            });
            let mut under_way: usize = queue.iter().map(|&(_, len)| len).sum();
            while under_way + 1_460 <= ahead {
                queue.push((medium.send(sender, Direction::Up, 1_460, now), 1_460));
                under_way += 1_460;
            }
        }
        if (now + 1_000).is_multiple_of(WINDOW_US) {
            medium.close_window(now + 1_000, &mut sums);
            medium.open_window(&sums);
        }
    }
    through
}

#[test]
fn senders_share_a_channel_evenly_and_none_of_it_is_given_out_twice() {
    // A segment of 1460 bytes at 65 Mbit/s: two frames of 180 µs, 90 bytes of headers in each
    // direction, the payload.
    let segment_s = 360e-6 + (1_460.0 + 180.0) * 8.0 / 65e6;
    let capacity = 1_460.0 / segment_s;
    for (senders, ahead) in [
        (1, 65_536),
        (2, 65_536),
        (10, 8_192),
        (10, 65_536),
        (40, 8_192),
    ] {
        let mut medium = medium(Radio::default(), PLAIN);
        for number in 0..senders {
            medium.add(number as u32);
        }
        let seconds = 10;
        let through = saturate(&mut medium, senders, seconds, ahead);
        let rates: Vec<f64> = through.iter().map(|&b| b as f64 / seconds as f64).collect();
        let total: f64 = rates.iter().sum();
        assert!(
            (0.9..1.03).contains(&(total / capacity)),
            "{senders} senders, {ahead} ahead: {total:.0} of {capacity:.0} bytes/s"
        );
        for rate in &rates {
            let fair = rate * senders as f64 / total;
            assert!((0.95..1.05).contains(&fair), "{senders} senders: {rates:?}");
        }
    }
}

#[test]
fn a_light_sender_among_greedy_ones_is_heard_at_once() {
    let mut medium = medium(Radio::default(), PLAIN);
    for number in 0..6 {
        medium.add(number);
    }
    saturate(&mut medium, 5, 2, 65_536);
    // The sixth says a word: the five others and it take turns.
    let took = medium.send(5, Direction::Up, 200, 2_000_000) - 2_000_000;
    assert!((1_500..4_000).contains(&took), "{took} µs");
}

#[test]
fn collisions_take_more_the_more_there_are_who_contend() {
    let rate = |senders: usize| -> u64 {
        let mut medium = medium(
            Radio::default(),
            RadioFigures {
                contention: 0.05,
                ..PLAIN
            },
        );
        for number in 0..senders {
            medium.add(number as u32);
        }
        saturate(&mut medium, senders, 5, 65_536).iter().sum()
    };
    let (few, many) = (rate(2), rate(32));
    let ratio = many as f64 / few as f64;
    // Four doublings more.
    assert!((0.74..0.86).contains(&ratio), "{ratio}");
}

#[test]
fn channels_do_not_disturb_each_other_and_parts_add_up() {
    let radio = Radio {
        access_points: vec![point(-5.0, 1), point(5.0, 6), point(15.0, 6)],
        partitions: Vec::new(),
    };
    let mut whole = medium(radio.clone(), PLAIN);
    for number in 0..6 {
        let station = whole.add(number);
        whole.begin(station, ([-5.0, 5.0, 15.0][station % 3], 1.0));
    }
    let through = saturate(&mut whole, 6, 5, 65_536);
    // Two robots have channel 1, four have channel 6.
    let ratio = through[0] as f64 / through[1] as f64;
    assert!((1.9..2.1).contains(&ratio), "{through:?}");
    // The same in two parts that exchange sums: every arrival at the same microsecond.
    let mut parts: Vec<Medium> = (0..2).map(|_| medium(radio.clone(), PLAIN)).collect();
    let mut whole = medium(radio.clone(), PLAIN);
    for number in 0..6_usize {
        let place = ([-5.0, 5.0, 15.0][number % 3], 1.0);
        whole.add(number as u32);
        whole.begin(number, place);
        let part = &mut parts[number % 2];
        let station = part.add(number as u32);
        part.begin(station, place);
    }
    let (mut sums, mut sum) = (Vec::new(), Vec::new());
    for window in 0..200 {
        let now = window * WINDOW_US;
        for number in 0..6_usize {
            let len = 300 + 900 * number;
            let arrives = whole.send(number, Direction::Up, len, now);
            let part = parts[number % 2].send(number / 2, Direction::Up, len, now);
            assert_eq!(arrives, part, "window {window}, robot {number}");
        }
        whole.close_window(now + WINDOW_US, &mut sum);
        let mut total = vec![Airtime::default(); sum.len()];
        for part in &mut parts {
            part.close_window(now + WINDOW_US, &mut sums);
            for (total, sum) in total.iter_mut().zip(&sums) {
                *total += *sum;
            }
        }
        assert_eq!(total, sum);
        whole.open_window(&sum);
        for part in &mut parts {
            part.open_window(&total);
        }
    }
}

#[test]
fn signal_falls_with_distance_and_rate_with_signal() {
    let radio = Radio {
        access_points: vec![point(0.0, 1)],
        partitions: Vec::new(),
    };
    let survey = Survey::new(&setup(radio.clone(), PLAIN), radio);
    assert!((survey.level(0, Some((1.0, 0.0))) + 21.7).abs() < 0.01);
    // Ten times as far: thirty decibels less.
    assert!((survey.level(0, Some((0.0, 10.0))) + 51.7).abs() < 0.01);
    // At the antenna it does not become infinite.
    assert!(survey.level(0, Some((0.0, 0.0))) < 10.0);
    let mut last = u64::MAX;
    for dbm in -95..-40 {
        let quality = survey.quality(dbm as f32, 0.0);
        let airtime = quality.airtime_ns(1_460);
        assert!(airtime <= last, "{dbm} dBm: {airtime} ns after {last}");
        assert!((0.0..=1.0).contains(&quality.loss));
        last = airtime;
    }
    // At the sensitivity of the slowest scheme one frame in ten is lost, and seven attempts make
    // a loss rare.
    let weakest = survey.quality(SCHEMES[0].1 + PLAIN.noise_db, 0.0);
    assert!((weakest.loss - 1e-7).abs() < 1e-8, "{}", weakest.loss);
    assert!((survey.quality(-50.0, 0.1).loss - 0.1).abs() < 1e-6);
    assert!(survey.quality(-95.0, 0.0).loss > 0.3);
}

#[test]
fn shadowing_is_fixed_in_place_smooth_and_as_wide_as_asked() {
    let radio = Radio {
        access_points: vec![point(0.0, 1), point(0.0, 1)],
        partitions: Vec::new(),
    };
    let figures = RadioFigures {
        shadowing_db: 4.0,
        ..PLAIN
    };
    let survey = Survey::new(&setup(radio.clone(), figures), radio.clone());
    let plain = Survey::new(&setup(radio.clone(), PLAIN), radio);
    let shadow = |point, x: f32, y: f32| {
        survey.level(point, Some((x, y))) - plain.level(point, Some((x, y)))
    };
    let (mut sum, mut squares, mut steps) = (0.0, 0.0, 0.0_f32);
    let mut differ = 0;
    let many = 20_000;
    for n in 0..many {
        let (x, y) = (
            (n % 200) as f32 * 0.73 - 70.0,
            (n / 200) as f32 * 0.91 - 40.0,
        );
        let here = shadow(0, x, y);
        assert_eq!(here, shadow(0, x, y));
        sum += here;
        squares += here * here;
        steps = steps.max((shadow(0, x + 0.01, y) - here).abs());
        differ += i32::from((shadow(1, x, y) - here).abs() > 0.1);
    }
    let mean = sum / many as f32;
    let deviation = (squares / many as f32 - mean * mean).sqrt();
    assert!(mean.abs() < 0.3, "{mean}");
    assert!((3.6..4.4).contains(&deviation), "{deviation}");
    assert!(steps < 0.4, "{steps} dB within a centimetre");
    assert!(differ > many * 9 / 10);
}

/// Looks ten times a second from `from_s` on; returns what was told of station 0.
fn watch(
    medium: &mut Medium,
    (from_s, until_s): (f64, f64),
    place: impl Fn(f64) -> (f32, f32),
) -> Vec<(f64, Reach, i8)> {
    let mut told = Vec::new();
    let looks = (from_s * 10.0) as u64 + 1..=(until_s * 10.0) as u64;
    for look in looks {
        let now = look * LOOK_PERIOD_US;
        let seconds = look as f64 / 10.0;
        let mut reached = None;
        medium.look(
            now,
            |_| Some(place(seconds)),
            |_, reach| reached = Some(reach),
        );
        if let Some(reach) = reached {
            assert_eq!(reach, medium.reach(0));
            told.push((seconds, reach, medium.rssi_dbm(0)));
        }
    }
    told
}

#[test]
fn a_robot_that_drives_away_loses_its_link_and_finds_it_again() {
    let radio = Radio {
        access_points: vec![AccessPoint {
            attenuation_db: 40.0,
            ..point(0.0, 1)
        }],
        partitions: Vec::new(),
    };
    let mut medium = medium(radio, PLAIN);
    medium.add(0);
    medium.begin(0, (1.0, 0.0));
    assert_eq!((medium.reach(0), medium.rssi_dbm(0)), (Reach::Up, -62));
    // One metre a second out to forty, and back: at −89.6 dBm, 8.5 m away, nothing is heard.
    let place = |s: f64| ((1.0 + if s < 40.0 { s } else { 80.0 - s }) as f32, 0.0);
    let told = watch(&mut medium, (0.0, 80.0), place);
    let kinds: Vec<Reach> = told.iter().map(|t| t.1).collect();
    assert_eq!(kinds, [Reach::Silent, Reach::Lost, Reach::Up], "{told:?}");
    let times: Vec<f64> = told.iter().map(|t| t.0).collect();
    assert!((7.3..7.7).contains(&times[0]), "{told:?}");
    assert!((times[1] - times[0] - 2.0).abs() < 0.11, "{told:?}");
    // Three decibels nearer, up to a second until it scans, and a second and a half to join.
    assert!((75.0..77.7).contains(&times[2]), "{told:?}");
    assert!(told[0].2 < -85 && told[2].2 > -87, "{told:?}");
}

#[test]
fn a_robot_changes_to_a_much_better_access_point_and_not_to_a_little_better_one() {
    let radio = Radio {
        access_points: vec![point(-10.0, 1), point(10.0, 6)],
        partitions: Vec::new(),
    };
    let mut medium = medium(radio, PLAIN);
    medium.add(0);
    medium.begin(0, (-9.0, 0.0));
    // A little better: eight decibels are a ratio of distances of 1.85.
    let told = watch(&mut medium, (0.0, 5.0), |_| (2.0, 0.0));
    assert_eq!((told.len(), medium.access_point(0)), (0, 0));
    let told = watch(&mut medium, (5.0, 10.0), |_| (4.0, 0.0));
    assert_eq!(medium.access_point(0), 1);
    let kinds: Vec<Reach> = told.iter().map(|t| t.1).collect();
    assert_eq!(kinds, [Reach::Silent, Reach::Up]);
    assert!((told[1].0 - told[0].0 - 0.1).abs() < 0.01, "{told:?}");
    assert_eq!(watch(&mut medium, (10.0, 20.0), |_| (4.0, 0.0)), []);
}

#[test]
fn partitions_take_whom_they_are_for_while_they_last() {
    let everyone = Partition {
        from_s: 1.0,
        until_s: 3.0,
        region: None,
        access_point: None,
        share: 1.0,
        known: false,
    };
    let half = Partition {
        share: 0.5,
        from_s: 5.0,
        until_s: 6.0,
        ..everyone
    };
    let east = Partition {
        region: Some(Region {
            x: 5.0,
            y: 0.0,
            width: 10.0,
            height: 10.0,
        }),
        known: true,
        from_s: 7.0,
        until_s: 8.0,
        ..everyone
    };
    let radio = Radio {
        access_points: Vec::new(),
        partitions: vec![everyone, half, east],
    };
    let mut medium = medium(radio, PLAIN);
    for number in 0..1_000 {
        medium.add(number);
    }
    let mut counts = Vec::new();
    for look in 1..=110 {
        let place = |n: usize| Some((if n.is_multiple_of(4) { 3.0 } else { -3.0 }, 0.0));
        medium.look(look * LOOK_PERIOD_US, place, |_, _| {});
        let count = |reach| (0..1_000).filter(|&n| medium.reach(n) == reach).count();
        let now = (count(Reach::Silent), count(Reach::Lost));
        if counts.last().is_none_or(|&(_, last)| last != now) {
            counts.push((look, now));
        }
    }
    assert_eq!(counts[0], (1, (0, 0)));
    assert_eq!(counts[1], (10, (1_000, 0)));
    assert_eq!(counts[2], (30, (0, 0)));
    let (at, (silent, lost)) = counts[3];
    assert_eq!((at, lost), (50, 0));
    assert!((450..550).contains(&silent), "{silent}");
    assert_eq!(counts[4], (60, (0, 0)));
    assert_eq!(counts[5], (70, (0, 250)));
    // They scan at different tenths of a second after the end, and then have to join.
    let (at, last) = *counts.last().unwrap();
    assert_eq!(last, (0, 0));
    assert!((95..=106).contains(&at), "{at}");
}

#[test]
fn what_a_radio_cannot_be_is_named() {
    let sound = Radio {
        access_points: vec![point(0.0, 1)],
        partitions: vec![Partition {
            from_s: 0.0,
            until_s: 1.0,
            region: None,
            access_point: Some(0),
            share: 1.0,
            known: true,
        }],
    };
    assert_eq!(sound.validate(), Ok(()));
    let wrong = |change: &dyn Fn(&mut Radio)| {
        let mut radio = sound.clone();
        change(&mut radio);
        radio.validate().unwrap_err().0
    };
    let points = |value| move |r: &mut Radio| r.access_points[0].x = value;
    assert_eq!(wrong(&points(f32::NAN)), "access_points[0].x");
    assert_eq!(wrong(&points(1e9)), "access_points[0].x");
    assert_eq!(
        wrong(&|r| r.access_points[0].channel = 14),
        "access_points[0].channel"
    );
    assert_eq!(
        wrong(&|r| r.access_points = vec![point(0.0, 1); 65]),
        "access_points"
    );
    assert_eq!(
        wrong(&|r| r.partitions[0].until_s = -1.0),
        "partitions[0].until_s"
    );
    assert_eq!(
        wrong(&|r| r.partitions[0].share = 1.5),
        "partitions[0].share"
    );
    assert_eq!(
        wrong(&|r| r.partitions[0].access_point = Some(1)),
        "partitions[0].access_point"
    );
    assert_eq!(
        wrong(&|r| r.partitions[0].from_s = f64::NAN),
        "partitions[0].from_s"
    );
}

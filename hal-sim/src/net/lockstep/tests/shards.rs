//! What robots tell each other is the same when several networks share them.

use std::collections::BTreeMap;

use super::*;
use crate::sched::Scheduler;

const ROBOTS: usize = 5;
const STEP_US: u64 = 10_000;

/// What each robot heard, and when.
type Heard = Rc<RefCell<BTreeMap<usize, Vec<(u64, Vec<u8>)>>>>;

fn unsubscribe(filter: &str) -> Vec<u8> {
    let mut body = vec![0, 8, 0, 0, filter.len() as u8];
    body.extend_from_slice(filter.as_bytes());
    frame(0xA2, &body)
}

fn retained(topic: &str, payload: &[u8]) -> Vec<u8> {
    let mut bytes = publish(topic, 1, false, payload);
    bytes[0] |= 1;
    bytes
}

/// One robot: what it says, and when, in microseconds.
fn says(robot: usize) -> Vec<(u64, Vec<u8>)> {
    let own = format!("talk/{robot}");
    let other = format!("talk/{}", (robot + 1) % ROBOTS);
    let name = format!("r{robot}");
    let mut all = vec![
        (0, connect(&name, true)),
        (100_000, subscribe(&other)),
        (200_000, publish(&own, 2, false, b"one")),
        // In one window with others' subscriptions below.
        (
            301_000 + robot as u64 * 700,
            publish(&own, 3, false, b"two"),
        ),
        (400_000, retained(&format!("kept/{robot}"), b"last")),
        (900_000, publish(&own, 4, false, b"three")),
        (900_000, publish("talk/all", 5, false, name.as_bytes())),
    ];
    match robot {
        0 => {
            all.push((301_500, subscribe("talk/#")));
            // It hears itself, however soon.
            all.push((303_500, publish("talk/0", 6, false, b"echo")));
        }
        1 => all.push((398_000, subscribe("kept/+"))),
        2 => all.push((500_000, unsubscribe("talk/3"))),
        3 => all.push((700_000, subscribe("kept/+"))),
        _ => all.push((302_000, subscribe("talk/0"))),
    }
    all.sort_by_key(|&(at, _)| at);
    all
}

async fn talk(network: VirtualNetwork, robot: usize, heard: Heard) {
    let mut interface = network.rejoin(robot);
    let mut stream = interface.connect("broker", 1883).await.unwrap();
    let mut lines = says(robot).into_iter().peekable();
    let mut buf = [0; 256];
    loop {
        let next = lines.peek().map_or(u64::MAX, |&(at, _)| at + 50_000);
        let deadline = Instant::from_micros(next);
        match with_deadline(&network.clock, deadline, stream.read(&mut buf)).await {
            Ok(taken) => {
                let bytes = buf[..taken.unwrap()].to_vec();
                let mut heard = heard.borrow_mut();
                heard.entry(robot).or_default().push((network.now(), bytes));
            }
            Err(_) => {
                if let Some((_, bytes)) = lines.next() {
                    send(&mut stream, &bytes).await;
                }
            }
        }
    }
}

/// What each client heard, and when.
type Log = BTreeMap<usize, Vec<(u64, Vec<u8>)>>;

fn run_shards(shards: usize) -> (Log, u64) {
    let heard = Heard::default();
    let mut all: Vec<(Scheduler, VirtualNetwork)> = Vec::new();
    for shard in 0..shards {
        let clock = SimClock::new();
        let mut sched = Scheduler::new(&clock);
        let network = VirtualNetwork::new(LinkModel::default(), 4, &clock);
        if shards > 1 {
            network.share();
        }
        for robot in 0..ROBOTS {
            assert_eq!(network.add_link(), robot);
            if robot % shards == shard {
                sched.spawn(talk(network.clone(), robot, Rc::clone(&heard)));
            }
        }
        all.push((sched, network));
    }
    let mut news: Vec<News> = (0..shards).map(|_| News::default()).collect();
    for step in 1..=120 {
        let end = Instant::from_micros(step * STEP_US);
        for (sched, network) in &mut all {
            loop {
                network.process();
                sched.run();
                let due = sched.next_due().unwrap_or(Instant::FAR_FUTURE);
                let due = due.min(Instant::from_micros(network.next_due()));
                if due >= end {
                    break;
                }
                sched.advance_to(due);
            }
            sched.advance_to(end);
        }
        if let [(_, network)] = all.as_slice() {
            network.settle();
            continue;
        }
        for ((_, network), news) in all.iter().zip(&mut news) {
            network.report(news);
        }
        for (shard, (_, network)) in all.iter().enumerate() {
            for (other, news) in news.iter().enumerate() {
                network.hear(news, other != shard);
            }
            network.hand_on();
        }
    }
    let sent = all
        .iter()
        .map(|(_, network)| network.statistics().sent)
        .sum();
    drop(all);
    (heard.take(), sent)
}

#[test]
fn robots_hear_the_same_of_each_other_at_the_same_time_whoever_runs_them() {
    let (alone, sent) = run_shards(1);
    for shards in 2..=ROBOTS {
        assert_eq!(run_shards(shards), (alone.clone(), sent), "{shards} shards");
    }
    let text = |robot: usize| {
        let heard = alone[&robot].iter().flat_map(|(_, bytes)| bytes.clone());
        String::from_utf8_lossy(&heard.collect::<Vec<u8>>()).into_owned()
    };
    let count = |robot: usize, what: &str| text(robot).matches(what).count();
    assert_eq!(count(0, "echo"), 1, "what it says itself is heard at once");
    assert_eq!(count(0, "talk/all"), ROBOTS);
    assert_eq!(count(2, "three"), 0, "it has unsubscribed");
    assert_eq!(count(3, "three"), 1);
    for late in [1, 3] {
        assert_eq!(
            count(late, "last"),
            ROBOTS,
            "robot {late} misses nothing kept"
        );
    }
}

#[test]
fn what_nobody_wants_is_not_copied() {
    let (mut sched, network) = start(LinkModel::default());
    network.share();
    let mut interface = network.rejoin(network.add_link());
    let work = async {
        let mut stream = interface.connect("broker", 1883).await.unwrap();
        send(&mut stream, &connect("a", true)).await;
        // How many wait right after the broker got one.
        let waiting = async |number: u64| {
            loop {
                network.clock.sleep(Duration::from_micros(50)).await;
                let state = network.state.borrow();
                if state.peer.statistics().received == number {
                    return state.peer.waiting();
                }
            }
        };
        send(&mut stream, &publish("x", 1, false, b"hello")).await;
        assert_eq!(waiting(1).await, 0);
        send(&mut stream, &subscribe("x")).await;
        network.clock.sleep(Duration::from_millis(30)).await;
        send(&mut stream, &publish("x", 2, false, b"hello")).await;
        assert_eq!(waiting(2).await, 1);
        send(&mut stream, &publish("y", 3, false, b"hello")).await;
        network.clock.sleep(Duration::from_millis(30)).await;
        assert_eq!(network.state.borrow().peer.waiting(), 0);
    };
    sched.block_on(work, ms(1_000)).unwrap();
}

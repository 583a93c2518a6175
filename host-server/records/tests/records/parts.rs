//! What is left to do of experiments, claimed by several workers.

use std::time::Duration;

use crate::support::{Folder, memory, open};
use crawler_records::{
    ExperimentState, Holder, MAX_LOST, NewExperiment, NewTrials, Part, Records, RecordsError,
    StoredTrial, part_size,
};

use ExperimentState::{Paused, Running, Stopped};

const BUILD: &str = "0.3.0 (one)";
const LEASE: Duration = Duration::from_hours(1);
/// It has ended by the next call.
const NONE: Duration = Duration::ZERO;
const FIRST_SEED: u64 = 40;

async fn experiment(records: &Records, seeds: u32) -> i64 {
    let new = NewExperiment {
        kind: crawler_records::ExperimentKind::Evaluation,
        owner: "one".into(),
        name: "shared".into(),
        build: BUILD.into(),
        recipe: "{}".into(),
        metrics: "[]".into(),
        seeds,
        by: "ada".into(),
        created: 1_000,
        start: true,
    };
    let id = records.experiments().add(new).await.unwrap().id;
    records.parts().divide(id, FIRST_SEED).await.unwrap();
    id
}

fn trial(number: u32) -> StoredTrial {
    StoredTrial {
        number,
        seed: FIRST_SEED + u64::from(number),
        success: true,
        reason: None,
        measured: vec![Some(f64::from(number))],
    }
}

async fn claim(records: &Records, worker: &str, id: i64, most: u32, lease: Duration) -> Vec<Part> {
    let claimed = records.parts().claim(worker, id, BUILD, most, lease).await;
    claimed.unwrap()
}

fn numbers(parts: &[Part]) -> Vec<u32> {
    let trials = parts.iter().flat_map(|part| &part.trials);
    trials.map(|(number, _)| *number).collect()
}

#[tokio::test]
async fn what_workers_do_in_any_order_comes_together() {
    let records = memory().await;
    let id = experiment(&records, 300).await;
    let size = part_size(300);
    assert_eq!(size, 4);
    let one = claim(&records, "a#1", id, 2, LEASE).await;
    assert_eq!(numbers(&one), (0..8).collect::<Vec<_>>());
    assert_eq!(one[0].trials[3], (3, FIRST_SEED + 3));
    let two = claim(&records, "b#2", id, 1, LEASE).await;
    assert_eq!(numbers(&two), [8, 9, 10, 11]);
    let parts = records.parts();
    let holders = parts.holders().await.unwrap();
    let holder = |worker: &str, seeds| Holder {
        experiment: id,
        worker: worker.into(),
        seeds,
    };
    assert_eq!(holders, [holder("a#1", 8), holder("b#2", 4)]);

    // The later part comes first, and half of the other one: nothing of it counts yet.
    let done = two[0].trials.iter().map(|(number, _)| trial(*number));
    assert_eq!(parts.store("b#2", id, done.collect()).await.unwrap(), 4);
    let running = parts.running().await.unwrap();
    assert_eq!((running.len(), running[0].id, running[0].done), (1, id, 0));
    assert!(!running[0].ready && running[0].divided && running[0].stuck.is_none());
    let half = vec![trial(2), trial(0)];
    assert_eq!(parts.store("a#1", id, half.clone()).await.unwrap(), 2);
    assert!(parts.running().await.unwrap()[0].ready);
    // The same once more, as after an answer that was lost.
    assert_eq!(parts.store("a#1", id, half).await.unwrap(), 2);
    let stored = records.trials().page(id, 0, 100).await.unwrap();
    let wanted: Vec<_> = [0, 2, 8, 9, 10, 11].map(trial).into();
    assert_eq!(stored, wanted);
    // What b had is done, and a holds what it has begun.
    assert_eq!(parts.holders().await.unwrap(), [holder("a#1", 8)]);

    // It comes to an end: another one takes what is left of the begun parts.
    parts.release("a#1", Some(id), false).await.unwrap();
    assert_eq!(parts.holders().await.unwrap(), []);
    let left = claim(&records, "c#3", id, 2, LEASE).await;
    assert_eq!(numbers(&left), [1, 3, 4, 5, 6, 7]);
}

#[tokio::test]
async fn what_a_worker_does_not_come_back_to_is_taken_by_another() {
    let records = memory().await;
    let id = experiment(&records, 2).await;
    let parts = records.parts();
    assert_eq!(numbers(&claim(&records, "a#1", id, 9, NONE).await), [0, 1]);
    // It is late, and nobody has taken it: it holds on.
    let all: Vec<i64> = claim(&records, "a#1", id, 9, NONE)
        .await
        .iter()
        .map(|part| part.id)
        .collect();
    assert_eq!(parts.renew("a#1", &all, LEASE).await.unwrap(), all);
    assert_eq!(claim(&records, "b#2", id, 9, LEASE).await, []);
    assert_eq!(parts.renew("a#1", &all, NONE).await.unwrap(), all);
    assert_eq!(numbers(&claim(&records, "b#2", id, 1, LEASE).await), [0]);
    assert_eq!(parts.renew("a#1", &all, LEASE).await.unwrap(), all[1..]);
    // It comes back with both, and one is another's: that one does it.
    let both = vec![trial(0), trial(1)];
    assert_eq!(parts.store("a#1", id, both.clone()).await.unwrap(), 1);
    assert_eq!(parts.store("b#2", id, both).await.unwrap(), 1);
    assert_eq!(records.trials().page(id, 0, 9).await.unwrap().len(), 2);
    assert!(!parts.running().await.unwrap()[0].divided);
    // Divided once more, as after a backup was put back: what is stored is not done again.
    parts.divide(id, FIRST_SEED).await.unwrap();
    assert!(parts.running().await.unwrap()[0].divided);
    assert_eq!(claim(&records, "b#2", id, 9, LEASE).await, []);
    assert!(!parts.running().await.unwrap()[0].divided);
}

#[tokio::test]
async fn a_part_that_ends_its_workers_is_not_tried_for_ever() {
    let records = memory().await;
    let id = experiment(&records, 1).await;
    for _ in 0..MAX_LOST - 1 {
        assert_eq!(numbers(&claim(&records, "a#1", id, 1, NONE).await), [0]);
    }
    assert_eq!(records.parts().running().await.unwrap()[0].stuck, None);
    assert_eq!(numbers(&claim(&records, "a#1", id, 1, LEASE).await), [0]);
    // As a server does that starts again under its name.
    records.parts().release("a#1", None, true).await.unwrap();
    assert_eq!(claim(&records, "b#2", id, 1, LEASE).await, []);
    assert_eq!(records.parts().running().await.unwrap()[0].stuck, Some(0));
}

#[tokio::test]
async fn nobody_stores_what_is_not_asked_for() {
    let records = memory().await;
    let (id, other) = (experiment(&records, 3).await, experiment(&records, 3).await);
    let parts = records.parts();
    claim(&records, "a#1", id, 9, LEASE).await;
    let foreign = StoredTrial {
        seed: 7,
        ..trial(0)
    };
    let refused = parts.store("a#1", id, vec![trial(1), foreign]).await;
    assert!(
        matches!(refused, Err(RecordsError::Invalid(_))),
        "{refused:?}"
    );
    let long = StoredTrial {
        measured: vec![None; 65],
        ..trial(0)
    };
    let refused = parts.store("a#1", id, vec![long]).await;
    assert!(
        matches!(refused, Err(RecordsError::Invalid(_))),
        "{refused:?}"
    );
    // Beyond its end, of an experiment that it has nothing of, by somebody who has nothing.
    let far = StoredTrial {
        number: u32::MAX,
        ..trial(0)
    };
    for (worker, experiment, given) in [
        ("a#1", id, far),
        ("a#1", other, trial(0)),
        ("b#2", id, trial(0)),
    ] {
        let stored = parts.store(worker, experiment, vec![given]).await;
        assert_eq!(stored.unwrap(), 0, "{worker} in {experiment}");
    }
    for nowhere in [other + 1, i64::MAX, -1] {
        let refused = parts.store("a#1", nowhere, vec![trial(0)]).await;
        assert!(matches!(refused, Err(RecordsError::NotFound)), "{nowhere}");
        let none = parts.claim("a#1", nowhere, BUILD, 9, LEASE).await.unwrap();
        assert_eq!(none, []);
        assert!(parts.divide(nowhere, 1).await.is_err());
    }
    assert_eq!(records.trials().page(id, 0, 9).await.unwrap(), []);
    for name in ["", &"x".repeat(97), "a\0"] {
        assert!(parts.claim(name, id, BUILD, 1, LEASE).await.is_err());
    }
    // Another program would come to other numbers.
    let none = parts.claim("b#2", other, "0.3.0 (two)", 9, LEASE).await;
    assert_eq!(none.unwrap(), []);
}

#[tokio::test]
async fn an_experiment_that_stands_keeps_nobody_busy() {
    let records = memory().await;
    let id = experiment(&records, 3).await;
    let parts = records.parts();
    let held: Vec<i64> = claim(&records, "a#1", id, 2, LEASE)
        .await
        .iter()
        .map(|part| part.id)
        .collect();
    let moved = |from, to| records.experiments().change_state(id, from, to, None, 9);
    moved(Running, Paused).await.unwrap();
    assert!(parts.renew("a#1", &held, LEASE).await.unwrap().is_empty());
    assert_eq!(claim(&records, "b#2", id, 9, LEASE).await, []);
    let refused = parts.store("a#1", id, vec![trial(0)]).await;
    assert!(matches!(refused, Err(RecordsError::NotFound)));
    moved(Paused, Running).await.unwrap();
    assert_eq!(parts.renew("a#1", &held, LEASE).await.unwrap(), held);
    assert_eq!(numbers(&claim(&records, "b#2", id, 9, LEASE).await), [2]);
    moved(Running, Stopped).await.unwrap();
    assert_eq!(parts.holders().await.unwrap(), []);
    assert_eq!(parts.running().await.unwrap(), []);

    // One that is complete has nothing left either.
    let id = experiment(&records, 2).await;
    claim(&records, "a#1", id, 2, LEASE).await;
    let new = NewTrials {
        experiment: id,
        trials: vec![trial(0), trial(1)],
        results: String::new(),
        completed: Some(5),
    };
    records.trials().add(new).await.unwrap();
    assert_eq!(parts.holders().await.unwrap(), []);
}

#[tokio::test]
async fn a_build_takes_up_what_another_has_not_begun() {
    let records = memory().await;
    let id = experiment(&records, 2).await;
    let parts = records.parts();
    claim(&records, "a#1", id, 2, LEASE).await;
    parts.store("a#1", id, vec![trial(1)]).await.unwrap();
    assert!(!parts.adopt(id, "0.4.0").await.unwrap(), "it runs");
    let moved = |from, to| records.experiments().change_state(id, from, to, None, 9);
    moved(Running, Paused).await.unwrap();
    assert!(parts.adopt(id, "0.4.0").await.unwrap());
    assert_eq!(records.trials().page(id, 0, 9).await.unwrap(), []);
    assert_eq!(moved(Paused, Running).await.unwrap().build, "0.4.0");
    assert_eq!(claim(&records, "a#1", id, 2, LEASE).await, []);
    parts.divide(id, FIRST_SEED).await.unwrap();
    let mine = parts.claim("a#1", id, "0.4.0", 9, LEASE).await.unwrap();
    assert_eq!(numbers(&mine), [0, 1]);
    parts.store("a#1", id, vec![trial(0)]).await.unwrap();
    let new = NewTrials {
        experiment: id,
        trials: vec![trial(0)],
        results: String::new(),
        completed: None,
    };
    records.trials().add(new).await.unwrap();
    moved(Running, Paused).await.unwrap();
    assert!(!parts.adopt(id, BUILD).await.unwrap(), "it has begun");
    assert!(!parts.adopt(i64::MAX, BUILD).await.unwrap());
}

#[tokio::test]
async fn one_server_counts_the_trials() {
    let records = memory().await;
    let id = experiment(&records, 1).await;
    let parts = records.parts();
    assert!(!parts.hand_over(id, "two", "three").await.unwrap());
    assert!(parts.hand_over(id, "one", "two").await.unwrap());
    assert!(!parts.hand_over(id, "one", "three").await.unwrap());
    assert_eq!(parts.running().await.unwrap()[0].owner, "two");
}

/// Whoever claims at the same time as others gets something else, and all of it is given out.
#[tokio::test(flavor = "multi_thread")]
async fn no_part_is_given_to_two() {
    const WORKERS: u32 = 6;
    const SEEDS: u32 = 60;
    let folder = Folder::new();
    let records = open(&folder).await;
    let id = experiment(&records, SEEDS).await;
    let mut claims = tokio::task::JoinSet::new();
    for number in 0..WORKERS {
        // A process of its own, as far as the database knows.
        let records = open(&folder).await;
        claims.spawn(async move {
            let worker = format!("worker#{number}");
            let mut got = Vec::new();
            loop {
                let parts = claim(&records, &worker, id, 3, LEASE).await;
                if parts.is_empty() {
                    break;
                }
                got.extend(numbers(&parts));
            }
            records.close().await;
            got
        });
    }
    let mut all = claims.join_all().await.concat();
    all.sort_unstable();
    assert_eq!(all, (0..SEEDS).collect::<Vec<_>>());
    records.close().await;
}

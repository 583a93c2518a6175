//! Experiments and their trials, as a server keeps them.

use crate::support::{Folder, memory, on_postgres, open};
use crawler_records::{
    ExperimentKind, ExperimentState, MAX_EXPERIMENTS, MAX_TRAININGS, MAX_TRIALS, NewExperiment,
    NewTrials, Records, RecordsError, StoredTrial,
};

use ExperimentState::{Completed, Created, Failed, Paused, Running, Stopped};

const BUILD: &str = "0.3.0 (one)";

fn new(name: &str, seeds: u32, start: bool) -> NewExperiment {
    NewExperiment {
        kind: ExperimentKind::Evaluation,
        owner: "one".into(),
        name: name.into(),
        build: BUILD.into(),
        recipe: r#"{"scenario":"empty"}"#.into(),
        metrics: r#"["success"]"#.into(),
        seeds,
        by: "ada".into(),
        created: 1_000,
        start,
    }
}

fn trial(number: u32) -> StoredTrial {
    StoredTrial {
        number,
        seed: 7 + u64::from(number),
        success: !number.is_multiple_of(3),
        reason: number
            .is_multiple_of(3)
            .then(|| format!("reach: {number} \u{1f916}")),
        measured: vec![Some(f64::from(number) * 0.1), None, Some(-0.0)],
    }
}

fn trials(experiment: i64, numbers: std::ops::Range<u32>, completed: Option<i64>) -> NewTrials {
    NewTrials {
        experiment,
        results: format!("{} of them", numbers.end),
        trials: numbers.map(trial).collect(),
        completed,
    }
}

#[tokio::test]
async fn an_experiment_goes_its_way() {
    let records = memory().await;
    let made = records
        .experiments()
        .add(new("a", 1_201, false))
        .await
        .unwrap();
    assert_eq!((made.state, made.done, made.started), (Created, 0, None));
    let id = made.id;
    let moved = |from, to, now| records.experiments().change_state(id, from, to, None, now);
    let wrong = moved(Running, Paused, 2)
        .await
        .expect_err("it does not run");
    assert!(matches!(wrong, RecordsError::NotFound));
    let early = records.trials().add(trials(id, 0..1, None)).await;
    assert!(matches!(early, Err(RecordsError::NotFound)), "{early:?}");

    let running = moved(Created, Running, 2_000).await.unwrap();
    assert_eq!((running.state, running.started), (Running, Some(2_000)));
    records
        .trials()
        .add(trials(id, 0..1_100, None))
        .await
        .unwrap();
    // The same once more, as after an answer that was lost; but no gap and nothing twice.
    records
        .trials()
        .add(trials(id, 0..1_100, None))
        .await
        .unwrap();
    for odd in [0..5, 1_101..1_102, 1_099..1_101, 1_100..1_202] {
        let refused = records.trials().add(trials(id, odd.clone(), None)).await;
        assert!(matches!(refused, Err(RecordsError::NotFound)), "{odd:?}");
    }
    let paused = moved(Running, Paused, 3_000).await.unwrap();
    assert_eq!(
        (paused.done, paused.results.as_str()),
        (1_100, "1100 of them")
    );
    let again = moved(Paused, Running, 4_000).await.unwrap();
    assert_eq!((again.started, again.ended), (Some(2_000), None));
    records
        .trials()
        .add(trials(id, 1_100..1_201, Some(5_000)))
        .await
        .unwrap();
    let whole = records.experiments().get(id).await.unwrap().unwrap();
    assert_eq!(
        (whole.state, whole.ended, whole.done),
        (Completed, Some(5_000), 1_201)
    );

    let all = records.trials().page(id, 0, 5_000).await.unwrap();
    assert_eq!(all, (0..1_201).map(trial).collect::<Vec<_>>());
    let some = records.trials().page(id, 1_195, 3).await.unwrap();
    assert_eq!(some, (1_195..1_198).map(trial).collect::<Vec<_>>());
    assert_eq!(records.trials().page(id, 1_201, 3).await.unwrap(), []);
    assert_eq!(records.trials().page(id + 1, 0, 3).await.unwrap(), []);
    assert_eq!(records.trials().page(i64::MAX, 0, 3).await.unwrap(), []);
}

#[tokio::test]
async fn pages_states_and_deletion() {
    let records = memory().await;
    let mut ids = Vec::new();
    for n in 0..5 {
        let made = records
            .experiments()
            .add(new(&format!("number {n}"), 3, n % 2 == 0))
            .await
            .unwrap();
        ids.push(made.id);
    }
    let page = |before, limit| records.experiments().page(before, limit);
    let of = |page: Vec<crawler_records::Experiment>| -> Vec<i64> {
        page.iter().map(|experiment| experiment.id).collect()
    };
    assert_eq!(of(page(None, 2).await.unwrap()), [ids[4], ids[3]]);
    assert_eq!(
        of(page(Some(ids[3]), 9).await.unwrap()),
        [ids[2], ids[1], ids[0]]
    );
    let running = records.experiments().in_state(Running).await.unwrap();
    assert_eq!(of(running), [ids[0], ids[2], ids[4]]);
    let mut counts = records.experiments().by_state().await.unwrap();
    counts.sort_by_key(|(_, state, _)| state.name());
    assert_eq!(
        counts,
        [("one".into(), Created, 2), ("one".into(), Running, 3)]
    );

    let busy = records.experiments().delete(ids[4]).await;
    assert!(matches!(busy, Err(RecordsError::NotFound)), "it runs");
    records
        .trials()
        .add(trials(ids[4], 0..2, None))
        .await
        .unwrap();
    let failed = records
        .experiments()
        .change_state(ids[4], Running, Failed, Some(&"why".repeat(300)), 9)
        .await
        .unwrap();
    assert!(failed.reason.unwrap().len() <= 512);
    records.experiments().delete(ids[4]).await.unwrap();
    assert_eq!(records.experiments().get(ids[4]).await.unwrap(), None);
    assert_eq!(records.trials().page(ids[4], 0, 9).await.unwrap(), []);
    let gone = records.experiments().delete(ids[4]).await;
    assert!(matches!(gone, Err(RecordsError::NotFound)));
    let gone = records
        .experiments()
        .change_state(ids[4], Failed, Stopped, None, 9)
        .await;
    assert!(matches!(gone, Err(RecordsError::NotFound)));
    // Its number does not come back.
    let next = records
        .experiments()
        .add(new("next", 1, true))
        .await
        .unwrap();
    assert!(next.id > ids[4]);
}

#[tokio::test]
async fn no_more_than_fits() {
    let records = memory().await;
    for wrong in [
        new("", 1, true),
        new(&"x".repeat(65), 1, true),
        new("a\0b", 1, true),
        new("none", 0, true),
        new("many", 100_001, true),
        NewExperiment {
            recipe: "x".repeat(70_000),
            ..new("long", 1, true)
        },
    ] {
        let name = wrong.name.clone();
        let refused = records.experiments().add(wrong).await;
        assert!(matches!(refused, Err(RecordsError::Invalid(_))), "{name}");
    }
    for n in 0..MAX_TRIALS / 100_000 {
        let made = records
            .experiments()
            .add(new(&"\u{e4}".repeat(64), 100_000, false));
        made.await.unwrap_or_else(|error| panic!("{n}: {error}"));
    }
    let refused = records.experiments().add(new("one more", 1, false)).await;
    assert!(
        matches!(refused, Err(RecordsError::TooMany(_))),
        "{refused:?}"
    );
    for experiment in records.experiments().page(None, 1_000).await.unwrap() {
        records.experiments().delete(experiment.id).await.unwrap();
    }
    for _ in 0..MAX_EXPERIMENTS {
        records
            .experiments()
            .add(new("small", 1, false))
            .await
            .unwrap();
    }
    let refused = records.experiments().add(new("one more", 1, false)).await;
    assert!(
        matches!(refused, Err(RecordsError::TooMany(_))),
        "{refused:?}"
    );
}

/// A training of ten rounds.
fn training(name: &str, start: bool) -> NewExperiment {
    NewExperiment {
        kind: ExperimentKind::Training,
        ..new(name, 10, start)
    }
}

#[tokio::test]
async fn a_training_has_rounds_and_no_parts() {
    let records = memory().await;
    let made = records
        .experiments()
        .add(training("a", true))
        .await
        .unwrap();
    assert_eq!(made.kind, ExperimentKind::Training);
    let other = records.experiments().add(new("b", 3, true)).await.unwrap();
    assert_eq!(other.kind, ExperimentKind::Evaluation);
    // Who works on trials does not see it.
    let running = records.parts().running().await.unwrap();
    assert_eq!(
        running.iter().map(|row| row.id).collect::<Vec<_>>(),
        [other.id]
    );
    let trainings = records.experiments().running_trainings().await.unwrap();
    assert_eq!((trainings.len(), &trainings[0]), (1, &made));

    let note = |id, done, results: &str| {
        records
            .experiments()
            .note_training(id, done, results.to_owned())
    };
    note(made.id, 7, "seven").await.unwrap();
    let now = records.experiments().get(made.id).await.unwrap().unwrap();
    assert_eq!((now.done, now.results.as_str()), (7, "seven"));
    for wrong in [(made.id, 11), (other.id, 1), (other.id + 1, 1)] {
        let refused = note(wrong.0, wrong.1, "").await;
        assert!(matches!(refused, Err(RecordsError::NotFound)), "{wrong:?}");
    }
    let long = note(made.id, 8, &"x".repeat(70_000)).await;
    assert!(matches!(long, Err(RecordsError::Invalid(_))));
    records
        .experiments()
        .change_state(made.id, Running, Paused, None, 2)
        .await
        .unwrap();
    assert_eq!(records.experiments().running_trainings().await.unwrap(), []);
    // Whoever was at it when it was paused has kept one more.
    note(made.id, 8, "eight").await.unwrap();
    records
        .experiments()
        .change_state(made.id, Paused, Stopped, None, 3)
        .await
        .unwrap();
    let late = note(made.id, 9, "").await;
    assert!(matches!(late, Err(RecordsError::NotFound)), "it is over");

    for _ in 1..MAX_TRAININGS {
        let made = records.experiments().add(training("more", false)).await;
        made.unwrap();
    }
    let many = records.experiments().add(training("one more", false)).await;
    assert!(matches!(many, Err(RecordsError::TooMany("trainings"))));
    records.experiments().add(new("c", 3, false)).await.unwrap();
}

#[tokio::test]
async fn what_is_stored_outlasts_the_process() {
    let folder = Folder::new();
    let records = open(&folder).await;
    let made = records
        .experiments()
        .add(new("lasting", 9, true))
        .await
        .unwrap();
    records
        .trials()
        .add(trials(made.id, 0..4, None))
        .await
        .unwrap();
    records.close().await;
    let records: Records = open(&folder).await;
    let there = records.experiments().in_state(Running).await.unwrap();
    assert_eq!((there.len(), there[0].done, there[0].id), (1, 4, made.id));
    assert_eq!(
        records.trials().page(made.id, 0, 10).await.unwrap().len(),
        4
    );
    records.close().await;
}

/// Records as the first version made them, with a setting in them.
async fn first_version(folder: &Folder) {
    const SQLITE: &str = concat!(
        include_str!("../../src/schema/records.1.sql"),
        "INSERT INTO setting VALUES ('from', x'766f7273');
         PRAGMA application_id = 1413698162; PRAGMA user_version = 1;"
    );
    const POSTGRES: &str = concat!(
        include_str!("../../src/schema/postgres.1.sql"),
        "INSERT INTO setting VALUES ('from', decode('766f7273', 'hex'));
         INSERT INTO terracrawler VALUES (1, 1);"
    );
    let sql = if on_postgres() {
        POSTGRES
    } else {
        std::fs::write(folder.path().join(crawler_records::RECORDS_FILE), "").unwrap();
        SQLITE
    };
    folder.tamper(sql).await.unwrap();
}

#[tokio::test]
async fn records_of_the_first_version_get_the_new_tables() {
    let folder = Folder::new();
    first_version(&folder).await;
    let records = open(&folder).await;
    assert_eq!(
        records.settings().get("from").await.unwrap().unwrap(),
        b"vors"
    );
    let made = records
        .experiments()
        .add(new("first", 2, true))
        .await
        .unwrap();
    records
        .trials()
        .add(trials(made.id, 0..2, Some(3)))
        .await
        .unwrap();
    records.close().await;
    let records = open(&folder).await;
    assert_eq!(
        records
            .experiments()
            .get(made.id)
            .await
            .unwrap()
            .unwrap()
            .state,
        Completed
    );
    records.close().await;
}

//! Fences are kept, changed and forgotten, each under a name of its own.

use crate::support::{Folder, fence, memory, open};
use crawler_records::{KeptFence, MAX_FENCES, RecordsError};

#[tokio::test]
async fn fences_outlive_the_process_oldest_first() {
    let folder = Folder::new();
    let records = open(&folder).await;
    assert_eq!(records.fences().all().await.unwrap(), []);
    for n in [3, 1, 2] {
        records.fences().add(&fence(n)).await.unwrap();
    }
    records.close().await;
    let records = open(&folder).await;
    let kept = records.fences().all().await.unwrap();
    assert_eq!(kept, [fence(1), fence(2), fence(3)]);
}

#[tokio::test]
async fn a_change_leaves_who_made_it_and_when() {
    let records = memory().await;
    records.fences().add(&fence(1)).await.unwrap();
    let wish = KeptFence {
        name: "dock".into(),
        kind: "keep_in".into(),
        action: "stop".into(),
        corners: "[[0,0],[2,0],[2,2]]".into(),
        by: "eve".into(),
        made_at: 9,
        ..fence(1)
    };
    let expected = KeptFence {
        by: "ada".into(),
        made_at: fence(1).made_at,
        ..wish.clone()
    };
    assert_eq!(records.fences().change(&wish).await.unwrap(), expected);
    // Its own name is no other's.
    assert_eq!(records.fences().change(&wish).await.unwrap(), expected);
    assert_eq!(records.fences().all().await.unwrap(), [expected]);
    assert_eq!(records.fences().delete(&wish.id).await.unwrap(), "dock");
    assert_eq!(records.fences().all().await.unwrap(), []);
    for refused in [
        records.fences().delete(&wish.id).await.err(),
        records.fences().change(&wish).await.err(),
    ] {
        assert!(matches!(refused, Some(RecordsError::NotFound)));
    }
}

#[tokio::test]
async fn a_name_belongs_to_one_and_there_are_so_many() {
    let records = memory().await;
    for n in 0..MAX_FENCES {
        records.fences().add(&fence(n)).await.unwrap();
    }
    let more = records.fences().add(&fence(MAX_FENCES)).await;
    assert!(matches!(more, Err(RecordsError::TooMany("fences"))));
    records.fences().delete(&fence(5).id).await.unwrap();
    let same = KeptFence {
        name: fence(7).name,
        ..fence(5)
    };
    let refused = records.fences().add(&same).await;
    assert!(matches!(refused, Err(RecordsError::Exists)));
    let refused = records
        .fences()
        .change(&KeptFence {
            name: fence(7).name,
            ..fence(8)
        })
        .await;
    assert!(matches!(refused, Err(RecordsError::Exists)));
    assert_eq!(
        records.fences().all().await.unwrap().len() as i64,
        MAX_FENCES - 1
    );
}

#[tokio::test]
async fn what_cannot_be_a_fence_is_refused() {
    let records = memory().await;
    for wrong in [
        KeptFence {
            name: String::new(),
            ..fence(1)
        },
        KeptFence {
            name: "x".repeat(33),
            ..fence(1)
        },
        KeptFence {
            name: "a\0b".into(),
            ..fence(1)
        },
        KeptFence {
            kind: "moat".into(),
            ..fence(1)
        },
        KeptFence {
            action: "shoot".into(),
            ..fence(1)
        },
        KeptFence {
            corners: " ".repeat(5_000),
            ..fence(1)
        },
    ] {
        let refused = records.fences().add(&wrong).await;
        assert!(
            matches!(refused, Err(RecordsError::Invalid(_))),
            "{wrong:?}"
        );
    }
    let long = KeptFence {
        name: "ä".repeat(32),
        by: "b".repeat(100),
        ..fence(1)
    };
    records.fences().add(&long).await.unwrap();
    let kept = records.fences().all().await.unwrap();
    assert_eq!(kept[0].name, long.name);
    assert!(kept[0].by.len() <= 64);
}

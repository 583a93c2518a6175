//! Releases are kept whole, read in parts, and withdrawn for good.

use crate::support::{Folder, memory, open, release};
use crawler_records::{
    KeptRelease, MAX_RELEASE_BYTES, MAX_RELEASE_GATE, MAX_RELEASES, NewRelease, RELEASE_PIECE,
    Records, RecordsError, Withdrawal,
};
use crawler_release::{ENVELOPE_MAX, MAX_IMAGE};

/// Most bytes of an image.
const IMAGE_MAX: usize = MAX_IMAGE as usize;

fn withdrawal(at: i64) -> Withdrawal {
    Withdrawal {
        by: "eve".into(),
        at,
        why: "it \u{fc}bersteuert".into(),
    }
}

/// What is kept of a release.
fn kept(new: NewRelease) -> KeptRelease {
    KeptRelease {
        id: new.id,
        kind: new.kind,
        name: new.name,
        board: new.board,
        version: new.version,
        build: new.build,
        sequence: new.sequence,
        floor: new.floor,
        expires: new.expires,
        size: new.image.len() as u32,
        envelope: new.envelope,
        passed: None,
        by: new.by,
        added: new.added,
        withdrawn: None,
    }
}

async fn ids(records: &Records, before: Option<&str>, limit: u32) -> Vec<String> {
    let page = records.releases().page(before, limit).await.unwrap();
    page.into_iter().map(|release| release.id).collect()
}

#[tokio::test]
async fn releases_outlive_the_process_newest_first() {
    let folder = Folder::new();
    let records = open(&folder).await;
    assert_eq!(records.releases().page(None, 10).await.unwrap(), []);
    for n in [3, 1, 0, 2] {
        records.releases().add(release(n, 100)).await.unwrap();
    }
    records.close().await;
    let records = open(&folder).await;
    let all = records.releases().page(None, 10).await.unwrap();
    assert_eq!(all, [3, 2, 1, 0].map(|n| kept(release(n, 100))));
    for n in 0..4 {
        let new = release(n, 100);
        let found = records.releases().get(&new.id).await.unwrap();
        assert_eq!(found, Some(kept(new)));
    }
    // Page by page, also where two were added at the same time.
    let [zero, one, two, three] = [0, 1, 2, 3].map(|n| release(n, 1).id);
    assert_eq!(ids(&records, None, 2).await, [&*three, &*two]);
    assert_eq!(ids(&records, Some(&two), 2).await, [&*one, &*zero]);
    assert_eq!(ids(&records, Some(&zero), 2).await, [""; 0]);
    assert_eq!(ids(&records, Some("nobody"), 2).await, [""; 0]);
    assert_eq!(records.releases().get("nobody").await.unwrap(), None);
}

#[tokio::test]
async fn an_image_is_read_in_parts() {
    let records = memory().await;
    let piece = RELEASE_PIECE;
    let new = release(2, 2 * piece + 10);
    records.releases().add(release(1, piece)).await.unwrap();
    records.releases().add(new.clone()).await.unwrap();
    records.releases().add(release(3, piece)).await.unwrap();
    let end = new.image.len();
    for (from, most) in [
        (0, 1),
        (0, piece),
        (0, piece + 1),
        (piece - 1, 2),
        (piece, piece),
        (1_008, 16 * 1_008),
        (2 * piece, 10),
        (2 * piece + 9, 100),
        (end, 1),
        (end + 1, 1),
        (7, 0),
        (0, usize::MAX),
        (u32::MAX as usize, usize::MAX),
    ] {
        let part = records.releases().image(&new.id, from as u32, most).await;
        let wanted =
            &new.image[from.min(end)..from.saturating_add(most).min(end).max(from.min(end))];
        assert!(part.unwrap().as_deref() == Some(wanted), "{from} {most}");
    }
    // A piece that is full to the brim is the last one.
    let whole = records
        .releases()
        .image(&release(1, 1).id, 0, piece + 1)
        .await;
    assert_eq!(whole.unwrap(), Some(release(1, piece).image));
    assert_eq!(
        records.releases().image("nobody", 0, 1).await.unwrap(),
        None
    );
}

#[tokio::test]
async fn a_release_is_withdrawn_once_and_its_image_is_gone() {
    let folder = Folder::new();
    let records = open(&folder).await;
    let (new, other) = (release(1, 100_000), release(2, 100_000));
    records.releases().add(new.clone()).await.unwrap();
    records.releases().add(other.clone()).await.unwrap();
    let done = records.releases().withdraw(&new.id, withdrawal(9)).await;
    let expected = KeptRelease {
        withdrawn: Some(withdrawal(9)),
        ..kept(new.clone())
    };
    assert_eq!(done.unwrap(), expected);
    let in_force = records.releases().in_force().await.unwrap();
    assert_eq!(Vec::from_iter(in_force), std::slice::from_ref(&other.id));
    let again = records.releases().withdraw(&new.id, withdrawal(10)).await;
    assert!(matches!(again, Err(RecordsError::Exists)));
    let nobody = records.releases().withdraw("nobody", withdrawal(9)).await;
    assert!(matches!(nobody, Err(RecordsError::NotFound)));
    assert_eq!(
        records.releases().get(&new.id).await.unwrap(),
        Some(expected)
    );
    assert_eq!(records.releases().image(&new.id, 0, 1).await.unwrap(), None);
    let left = records.releases().image(&other.id, 0, usize::MAX).await;
    assert_eq!(left.unwrap(), Some(other.image));
    // It does not come back.
    let again = records.releases().add(new.clone()).await;
    assert!(matches!(again, Err(RecordsError::Exists)));
    // No piece of it is left: another one finds its place free.
    for again in [
        "INSERT INTO release_piece SELECT '0000000000000001-000', data FROM release_piece
         WHERE place = '0000000000000002-000'",
        "INSERT INTO release_piece SELECT '0000000000000001-001', data FROM release_piece
         WHERE place = '0000000000000002-001'",
    ] {
        folder.tamper(again).await.unwrap();
    }
    let long = Withdrawal {
        by: "b".repeat(100),
        at: 1,
        why: "a\nb\0".repeat(500),
    };
    let cut = records.releases().withdraw(&other.id, long).await.unwrap();
    let cut = cut.withdrawn.unwrap();
    assert!(cut.by.len() <= 64 && cut.why.len() <= 512 && cut.why.starts_with("a b?"));
}

#[tokio::test]
async fn a_report_belongs_to_a_release() {
    let records = memory().await;
    let new = release(1, 10);
    let set = |id: &str, gate: &[u8], passed| {
        let (id, gate) = (id.to_owned(), gate.to_vec());
        let records = &records;
        async move { records.releases().set_gate(&id, gate, passed).await }
    };
    assert!(matches!(
        set(&new.id, b"x", true).await,
        Err(RecordsError::NotFound)
    ));
    records.releases().add(new.clone()).await.unwrap();
    assert_eq!(records.releases().gate(&new.id).await.unwrap(), None);
    for (gate, passed) in [(&b"bad"[..], false), (b"good", true)] {
        set(&new.id, gate, passed).await.unwrap();
        let found = records.releases().gate(&new.id).await.unwrap();
        assert_eq!(found.as_deref(), Some(gate));
        let kept = records.releases().get(&new.id).await.unwrap().unwrap();
        assert_eq!(kept.passed, Some(passed));
    }
    let long = vec![0; MAX_RELEASE_GATE + 1];
    let refused = set(&new.id, &long, true).await;
    assert!(matches!(refused, Err(RecordsError::Invalid(_))));
}

#[tokio::test]
async fn what_cannot_be_a_release_is_refused() {
    let records = memory().await;
    let good = release(1, 10);
    let changes: [fn(&mut NewRelease); 12] = [
        |new| new.id = "1".into(),
        |new| new.id = "../../etc/passwd".into(),
        |new| new.kind = "firmware".into(),
        |new| new.name = Some(String::new()),
        |new| new.board = "b".repeat(17),
        |new| new.version = String::new(),
        |new| new.build = "\u{e4}".into(),
        |new| new.sequence = 0,
        |new| new.floor = new.sequence + 1,
        |new| new.image = Vec::new(),
        |new| new.image = vec![0; IMAGE_MAX + 1],
        |new| new.envelope = vec![0; ENVELOPE_MAX + 1],
    ];
    for (index, change) in changes.into_iter().enumerate() {
        let mut wrong = good.clone();
        change(&mut wrong);
        let refused = records.releases().add(wrong).await;
        assert!(matches!(refused, Err(RecordsError::Invalid(_))), "{index}");
    }
    records.releases().add(good.clone()).await.unwrap();
    let twice = records.releases().add(good).await;
    assert!(matches!(twice, Err(RecordsError::Exists)));
    // The largest numbers are kept as they are.
    let largest = NewRelease {
        sequence: u32::MAX,
        floor: u32::MAX,
        expires: Some(i64::MAX),
        ..release(2, 1)
    };
    records.releases().add(largest.clone()).await.unwrap();
    let found = records.releases().get(&largest.id).await.unwrap();
    assert_eq!(found, Some(kept(largest)));
}

#[tokio::test]
async fn images_have_so_many_bytes_together() {
    let records = memory().await;
    let most = MAX_RELEASE_BYTES as usize / IMAGE_MAX;
    let first = release(0, IMAGE_MAX);
    for n in 0..most as u32 {
        let image = first.image.clone();
        let new = NewRelease {
            image,
            ..release(n, 1)
        };
        records.releases().add(new).await.unwrap();
    }
    let left = MAX_RELEASE_BYTES as usize - most * IMAGE_MAX;
    let full = records.releases().add(release(100, left + 1)).await;
    assert!(matches!(
        full,
        Err(RecordsError::TooMany("bytes of releases"))
    ));
    records.releases().add(release(100, left)).await.unwrap();
    let full = records.releases().add(release(101, 1)).await;
    assert!(matches!(
        full,
        Err(RecordsError::TooMany("bytes of releases"))
    ));
    // What was withdrawn takes no room.
    let withdrawn = records.releases().withdraw(&first.id, withdrawal(1)).await;
    withdrawn.unwrap();
    records.releases().add(release(101, 1)).await.unwrap();
}

#[tokio::test]
async fn the_oldest_that_was_withdrawn_makes_room() {
    let records = memory().await;
    for n in 0..MAX_RELEASES as u32 {
        records.releases().add(release(n, 1)).await.unwrap();
    }
    let newest = release(MAX_RELEASES as u32, 1);
    let full = records.releases().add(newest.clone()).await;
    assert!(matches!(full, Err(RecordsError::TooMany("releases"))));
    for n in [7, 5] {
        let id = release(n, 1).id;
        let done = records.releases().withdraw(&id, withdrawal(1)).await;
        done.unwrap();
    }
    records.releases().add(newest.clone()).await.unwrap();
    let forgotten = records.releases().get(&release(5, 1).id).await.unwrap();
    assert_eq!(forgotten, None);
    for n in [4, 6, 7] {
        assert!(
            records
                .releases()
                .get(&release(n, 1).id)
                .await
                .unwrap()
                .is_some()
        );
    }
    let found = records.releases().get(&newest.id).await.unwrap();
    assert_eq!(found, Some(kept(newest)));
}

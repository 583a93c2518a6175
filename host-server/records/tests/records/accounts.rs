//! Settings, users, invitations, sessions and credentials do what they say, and refuse the rest.

use crate::support::{Folder, digest, memory, name, open, user};
use crawler_access::Role;
use crawler_records::{MAX_SESSIONS, MAX_SETTING, RecordsError, Refreshed};

const DAY: i64 = 24 * 3_600_000;

#[tokio::test]
async fn settings_come_back_after_a_restart() {
    let folder = Folder::new();
    let records = open(&folder).await;
    assert_eq!(records.settings().get("key").await.unwrap(), None);
    records.settings().set("key", b"one").await.unwrap();
    records.settings().set("key", b"two").await.unwrap();
    assert_eq!(
        records
            .settings()
            .get_or_set("key", b"three")
            .await
            .unwrap(),
        b"two"
    );
    assert_eq!(
        records.settings().get_or_set("new", b"four").await.unwrap(),
        b"four"
    );
    records.close().await;
    assert!(matches!(
        records.settings().get("key").await,
        Err(RecordsError::Closed)
    ));
    assert!(matches!(
        records.settings().set("key", b"").await,
        Err(RecordsError::Closed)
    ));

    let records = open(&folder).await;
    assert_eq!(
        records.settings().get("key").await.unwrap().as_deref(),
        Some(&b"two"[..])
    );
}

#[tokio::test]
async fn settings_are_bounded() {
    let records = memory().await;
    let most = vec![1; MAX_SETTING];
    records
        .settings()
        .set(&"k".repeat(64), &most)
        .await
        .unwrap();
    for (key, value) in [
        ("", vec![]),
        (&*"k".repeat(65), vec![]),
        ("k", vec![0; MAX_SETTING + 1]),
    ] {
        for outcome in [
            records.settings().set(key, &value).await,
            records.settings().get_or_set(key, &value).await.map(|_| ()),
        ] {
            assert!(matches!(outcome, Err(RecordsError::Invalid(_))), "{key}");
        }
    }
}

#[tokio::test]
async fn accounts_are_made_changed_and_deleted() {
    let folder = Folder::new();
    let records = open(&folder).await;
    let (ada, bob) = (user("ada", Role::Admin), user("bob", Role::Viewer));
    records.users().add(&ada).await.unwrap();
    records.users().add(&bob).await.unwrap();
    assert!(matches!(
        records.users().add(&user("bob", Role::Admin)).await,
        Err(RecordsError::Exists)
    ));
    assert_eq!(
        records.users().all().await.unwrap(),
        [ada.clone(), bob.clone()],
        "the second bob changed nothing"
    );

    records
        .users()
        .set_password(&bob.name, "another")
        .await
        .unwrap();
    records
        .users()
        .set_role(&bob.name, Role::Operator)
        .await
        .unwrap();
    records
        .users()
        .set_disabled(&bob.name, true, 5)
        .await
        .unwrap();
    records.close().await;

    let records = open(&folder).await;
    let found = records.users().get(&bob.name).await.unwrap().unwrap();
    assert_eq!(found.password.as_deref(), Some("another"));
    assert_eq!((found.role, found.disabled), (Role::Operator, true));
    assert!(!format!("{found:?}").contains("another"), "{found:?}");
    records
        .users()
        .set_disabled(&bob.name, false, 6)
        .await
        .unwrap();
    assert!(
        !records
            .users()
            .get(&bob.name)
            .await
            .unwrap()
            .unwrap()
            .disabled
    );

    records.users().delete(&bob.name, 7).await.unwrap();
    assert_eq!(records.users().get(&bob.name).await.unwrap(), None);
    let nobody = name("nobody");
    for outcome in [
        records.users().set_password(&bob.name, "x").await,
        records.users().set_role(&nobody, Role::Admin).await,
        records.users().set_role(&nobody, Role::Viewer).await,
        records
            .users()
            .set_disabled(&nobody, true, 8)
            .await
            .map(|_| ()),
        records
            .users()
            .set_disabled(&nobody, false, 8)
            .await
            .map(|_| ()),
        records.users().delete(&nobody, 8).await.map(|_| ()),
    ] {
        assert!(
            matches!(outcome, Err(RecordsError::NotFound)),
            "{outcome:?}"
        );
    }
    for hash in ["", &*"x".repeat(513)] {
        assert!(matches!(
            records.users().set_password(&ada.name, hash).await,
            Err(RecordsError::Invalid(_))
        ));
        let mut eve = user("eve", Role::Viewer);
        eve.password = Some(hash.to_owned());
        assert!(matches!(
            records.users().add(&eve).await,
            Err(RecordsError::Invalid(_))
        ));
    }
}

#[tokio::test]
async fn somebody_can_always_administer() {
    let records = memory().await;
    let (ada, bob) = (user("ada", Role::Admin), user("bob", Role::Admin));
    records.users().add(&ada).await.unwrap();
    // Neither an administrator who has no password yet, nor one who is locked out, counts.
    let mut invited = user("invited", Role::Admin);
    invited.password = None;
    records.users().add(&invited).await.unwrap();
    let mut locked = user("locked", Role::Admin);
    locked.disabled = true;
    records.users().add(&locked).await.unwrap();

    for outcome in [
        records.users().set_role(&ada.name, Role::Operator).await,
        records
            .users()
            .set_disabled(&ada.name, true, 1)
            .await
            .map(|_| ()),
        records.users().delete(&ada.name, 1).await.map(|_| ()),
    ] {
        assert!(
            matches!(outcome, Err(RecordsError::LastAdmin)),
            "{outcome:?}"
        );
    }
    assert_eq!(
        records.users().get(&ada.name).await.unwrap(),
        Some(ada.clone())
    );
    records
        .users()
        .set_role(&ada.name, Role::Admin)
        .await
        .unwrap();
    records.users().delete(&invited.name, 1).await.unwrap();
    records.users().delete(&locked.name, 1).await.unwrap();

    // Of two who leave at the same time, one stays.
    records.users().add(&bob).await.unwrap();
    let (one, other) = tokio::join!(
        records.users().delete(&ada.name, 2),
        records.users().set_role(&bob.name, Role::Viewer)
    );
    assert_eq!(
        usize::from(one.is_ok()) + usize::from(other.is_ok()),
        1,
        "{one:?} {other:?}"
    );
}

#[tokio::test]
async fn an_invitation_is_taken_once_and_in_time() {
    let records = memory().await;
    let ada = name("ada");
    records
        .invitations()
        .add(Some(&ada), Role::Admin, digest(1), 100)
        .await
        .unwrap();
    records
        .invitations()
        .add(None, Role::Viewer, digest(2), 100)
        .await
        .unwrap();
    assert!(matches!(
        records
            .invitations()
            .add(None, Role::Admin, digest(2), 900)
            .await,
        Err(RecordsError::Exists)
    ));
    let seen = records
        .invitations()
        .get(digest(1), 99)
        .await
        .unwrap()
        .unwrap();
    assert_eq!((seen.name.as_ref(), seen.role), (Some(&ada), Role::Admin));
    assert_eq!(
        records.invitations().get(digest(1), 100).await.unwrap(),
        None
    );
    assert_eq!(records.invitations().get(digest(9), 0).await.unwrap(), None);

    let (one, other) = tokio::join!(
        records.invitations().take(digest(1), 99),
        records.invitations().take(digest(1), 99)
    );
    let (one, other) = (one.unwrap(), other.unwrap());
    assert!(one.is_some() != other.is_some(), "{one:?} {other:?}");
    assert_eq!(
        records.invitations().take(digest(2), 100).await.unwrap(),
        None,
        "too late"
    );
    assert_eq!(
        records.invitations().take(digest(2), 99).await.unwrap(),
        None,
        "and gone"
    );

    records
        .invitations()
        .add(Some(&ada), Role::Admin, digest(3), 100)
        .await
        .unwrap();
    records.prune(100).await.unwrap();
    assert_eq!(
        records.invitations().get(digest(3), 50).await.unwrap(),
        None
    );
}

#[tokio::test]
async fn a_session_goes_on_with_each_new_token_and_ends_with_a_stolen_one() {
    let records = memory().await;
    let ada = user("ada", Role::Operator);
    records.users().add(&ada).await.unwrap();
    let id = records
        .sessions()
        .open(&ada.name, digest(1), 1_000, 1_000 + DAY, "10.0.0.1")
        .await
        .unwrap();
    assert_eq!(
        records
            .sessions()
            .refresh(digest(1), digest(2), 5_000)
            .await
            .unwrap(),
        Refreshed::Ok {
            session: id,
            user: ada.clone()
        }
    );
    let sessions = records.sessions().all(Some(&ada.name)).await.unwrap();
    assert_eq!(sessions.len(), 1);
    let session = &sessions[0];
    assert_eq!((session.id, &session.user), (id, &ada.name));
    assert_eq!(session.from, "10.0.0.1");
    assert_eq!(
        (session.opened, session.refreshed, session.expires),
        (1_000, 5_000, 5_000 + DAY)
    );
    for unknown in [digest(9), digest(3)] {
        assert_eq!(
            records
                .sessions()
                .refresh(unknown, digest(10), 5_001)
                .await
                .unwrap(),
            Refreshed::Unknown
        );
    }
    assert_eq!(
        records
            .sessions()
            .refresh(digest(1), digest(3), 6_000)
            .await
            .unwrap(),
        Refreshed::Reused {
            session: id,
            user: ada.name.clone()
        }
    );
    // The honest one is out too, and the thief does not get further.
    for token in [digest(2), digest(1), digest(3)] {
        assert_eq!(
            records
                .sessions()
                .refresh(token, digest(4), 6_001)
                .await
                .unwrap(),
            Refreshed::Unknown
        );
    }
    assert!(records.sessions().all(None).await.unwrap().is_empty());
    assert_eq!(records.sessions().revoked_since(6_000).await.unwrap(), [id]);
    assert!(
        records
            .sessions()
            .revoked_since(6_001)
            .await
            .unwrap()
            .is_empty()
    );
    records.prune(6_000 + DAY).await.unwrap();
    assert!(
        records
            .sessions()
            .revoked_since(0)
            .await
            .unwrap()
            .is_empty()
    );
}

#[tokio::test]
async fn a_token_of_an_expired_session_or_a_locked_account_is_worth_nothing() {
    let records = memory().await;
    let ada = user("ada", Role::Operator);
    records.users().add(&ada).await.unwrap();
    let open = async |token, now| {
        records
            .sessions()
            .open(&ada.name, digest(token), now, now + DAY, "x")
            .await
    };
    let first = open(1, 0).await.unwrap();
    assert_eq!(
        records
            .sessions()
            .refresh(digest(1), digest(2), DAY)
            .await
            .unwrap(),
        Refreshed::Unknown
    );
    let second = open(3, DAY).await.unwrap();
    assert!(second > first);
    assert_eq!(
        records
            .users()
            .set_disabled(&ada.name, true, DAY)
            .await
            .unwrap(),
        [first, second]
    );
    assert_eq!(
        records
            .sessions()
            .refresh(digest(3), digest(4), DAY + 1)
            .await
            .unwrap(),
        Refreshed::Unknown
    );
    assert!(matches!(open(5, DAY).await, Err(RecordsError::NotFound)));
    records
        .users()
        .set_disabled(&ada.name, false, DAY)
        .await
        .unwrap();
    let third = open(6, DAY).await.unwrap();
    assert_eq!(
        records.users().delete(&ada.name, DAY).await.unwrap(),
        [third]
    );
    assert!(matches!(open(7, DAY).await, Err(RecordsError::NotFound)));
    // The next of that name does not inherit a session.
    records.users().add(&ada).await.unwrap();
    assert_eq!(
        records
            .sessions()
            .refresh(digest(6), digest(8), DAY + 1)
            .await
            .unwrap(),
        Refreshed::Unknown
    );
    assert!(matches!(
        records
            .sessions()
            .open(&ada.name, digest(9), 5, 5, "x")
            .await,
        Err(RecordsError::Invalid(_))
    ));
}

#[tokio::test]
async fn sessions_end_one_by_one_or_all_but_one_and_are_bounded() {
    let records = memory().await;
    let (ada, bob) = (user("ada", Role::Viewer), user("bob", Role::Viewer));
    records.users().add(&ada).await.unwrap();
    records.users().add(&bob).await.unwrap();
    let bobs = records
        .sessions()
        .open(&bob.name, digest(0), 0, DAY, "b")
        .await
        .unwrap();
    let mut ids = Vec::new();
    for n in 1..=MAX_SESSIONS as u32 + 3 {
        let from = "f".repeat(1_000);
        let id = records
            .sessions()
            .open(&ada.name, digest(n), 0, DAY, &from)
            .await
            .unwrap();
        ids.push(id);
    }
    let live = records.sessions().all(Some(&ada.name)).await.unwrap();
    assert_eq!(live.len() as i64, MAX_SESSIONS);
    assert_eq!(live[0].id, *ids.last().unwrap(), "newest first");
    assert!(live.iter().all(|session| session.from.len() <= 128));
    assert!(live.iter().all(|session| session.id > ids[2]));

    records.sessions().revoke(ids[3], 5).await.unwrap();
    assert!(matches!(
        records.sessions().revoke(ids[3], 5).await,
        Err(RecordsError::NotFound)
    ));
    let keep = ids[10];
    let ended = records
        .sessions()
        .revoke_all(&ada.name, Some(keep), 6)
        .await
        .unwrap();
    assert_eq!(ended.len() as i64, MAX_SESSIONS - 2);
    let left: Vec<u64> = records
        .sessions()
        .all(None)
        .await
        .unwrap()
        .iter()
        .map(|session| session.id)
        .collect();
    assert_eq!(left, [keep, bobs]);
    assert_eq!(
        records
            .sessions()
            .revoke_all(&ada.name, None, 7)
            .await
            .unwrap(),
        [keep]
    );
}

#[tokio::test]
async fn credentials_are_made_replaced_and_revoked() {
    let folder = Folder::new();
    let records = open(&folder).await;
    records
        .credentials()
        .enroll("rover-1", digest(1), 10, "ada")
        .await
        .unwrap();
    records
        .credentials()
        .enroll("simulator-lab", digest(2), 11, &"b".repeat(100))
        .await
        .unwrap();
    records.credentials().revoke("rover-1", 12).await.unwrap();
    for absent in ["rover-1", "rover-2"] {
        assert!(matches!(
            records.credentials().revoke(absent, 13).await,
            Err(RecordsError::NotFound)
        ));
    }
    records.close().await;

    let records = open(&folder).await;
    let found = records.credentials().get("rover-1").await.unwrap().unwrap();
    assert_eq!((found.digest, found.created), (digest(1), 10));
    assert_eq!((found.by.as_str(), found.revoked), ("ada", Some(12)));
    assert_eq!(records.credentials().get("rover-2").await.unwrap(), None);
    let all = records.credentials().all().await.unwrap();
    assert_eq!(all.len(), 2);
    assert!(all[1].by.len() <= 64);

    records
        .credentials()
        .enroll("rover-1", digest(3), 20, "bob")
        .await
        .unwrap();
    let found = records.credentials().get("rover-1").await.unwrap().unwrap();
    assert_eq!((found.digest, found.revoked), (digest(3), None));
    for bad in ["", "Rover", "a/b", "rover#", &*"r".repeat(65)] {
        assert!(
            matches!(
                records.credentials().enroll(bad, digest(4), 0, "x").await,
                Err(RecordsError::Invalid(_))
            ),
            "{bad}"
        );
    }
}

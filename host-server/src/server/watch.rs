//! What another process changes in the records: the console revokes a secret or locks an account, and
//! the sessions at the broker that came of it must end as if the server had done it itself.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hasher as _};

use crawler_records::{Records, RecordsError};

use crawler_broker::Kind;

/// What counted when the records were last looked at, by name.
#[derive(Default)]
pub(super) struct Watch {
    known: Option<HashMap<(Kind, String), u64>>,
}

impl Watch {
    /// The names whose secret, password, role or lock is not what it was the last time, and those
    /// that are new and void already. The first look finds none.
    ///
    /// # Errors
    /// [`RecordsError`] when the records cannot be read; nothing is forgotten then.
    pub(super) async fn changed(
        &mut self,
        records: &Records,
    ) -> Result<Vec<(Kind, String)>, RecordsError> {
        let mut found = HashMap::new();
        let mut void = Vec::new();
        for credential in records.credentials().all().await? {
            let name = (Kind::Machine, credential.name);
            if credential.revoked.is_some() {
                void.push(name.clone());
            }
            let counts = (credential.digest, credential.revoked);
            found.insert(name, fingerprint(counts));
        }
        for user in records.users().all().await? {
            let name = (Kind::Person, user.name.to_string());
            if user.disabled {
                void.push(name.clone());
            }
            let counts = (user.password, user.role, user.disabled);
            found.insert(name, fingerprint(counts));
        }
        let changed = self.known.as_ref().map_or_else(Vec::new, |known| {
            // Between two looks somebody can be enrolled, log in, and be revoked.
            void.retain(|name| !known.contains_key(name));
            known
                .iter()
                .filter(|(name, counts)| found.get(*name) != Some(counts))
                .map(|(name, _)| name.clone())
                .chain(void)
                .collect()
        });
        self.known = Some(found);
        Ok(changed)
    }
}

/// Compared within this process alone.
fn fingerprint(counts: impl std::hash::Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    counts.hash(&mut hasher);
    hasher.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crawler_access::{Role, Secret, UserName};
    use crawler_records::User;

    fn machine(name: &str) -> [(Kind, String); 1] {
        [(Kind::Machine, name.to_owned())]
    }

    fn person(name: &str) -> [(Kind, String); 1] {
        [(Kind::Person, name.to_owned())]
    }

    #[tokio::test]
    async fn what_changes_is_named_once() {
        let records = Records::in_memory().await.expect("records");
        let secret = || Secret::generate().expect("randomness").digest();
        let ada: UserName = "ada".parse().expect("name");
        for name in ["rover-1", "rover-2"] {
            records
                .credentials()
                .enroll(name, secret(), 1, "test")
                .await
                .expect("enrolled");
        }
        let user = User {
            name: ada.clone(),
            role: Role::Viewer,
            password: None,
            created: 1,
            disabled: false,
        };
        records.users().add(&user).await.expect("added");
        let mut watch = Watch::default();
        assert!(watch.changed(&records).await.expect("read").is_empty());
        assert!(watch.changed(&records).await.expect("read").is_empty());

        records
            .credentials()
            .revoke("rover-1", 2)
            .await
            .expect("revoked");
        assert_eq!(
            watch.changed(&records).await.expect("read"),
            machine("rover-1")
        );
        assert!(watch.changed(&records).await.expect("read").is_empty());

        records
            .credentials()
            .enroll("rover-2", secret(), 3, "test")
            .await
            .expect("enrolled");
        assert_eq!(
            watch.changed(&records).await.expect("read"),
            machine("rover-2")
        );
        records
            .users()
            .set_disabled(&ada, true, 4)
            .await
            .expect("locked");
        assert_eq!(watch.changed(&records).await.expect("read"), person("ada"));
        records.users().delete(&ada, 5).await.expect("removed");
        assert_eq!(watch.changed(&records).await.expect("read"), person("ada"));
        // The first secret of somebody new is still good: there is no session to end.
        records
            .credentials()
            .enroll("rover-3", secret(), 6, "test")
            .await
            .expect("enrolled");
        assert!(watch.changed(&records).await.expect("read").is_empty());
    }

    #[tokio::test]
    async fn who_comes_and_is_revoked_between_two_looks_is_named() {
        let records = Records::in_memory().await.expect("records");
        let mut watch = Watch::default();
        assert!(watch.changed(&records).await.expect("read").is_empty());
        let digest = Secret::generate().expect("randomness").digest();
        let enrolled = records
            .credentials()
            .enroll("rover-1", digest, 1, "test")
            .await;
        enrolled.expect("enrolled");
        let revoked = records.credentials().revoke("rover-1", 2).await;
        revoked.expect("revoked");
        assert_eq!(
            watch.changed(&records).await.expect("read"),
            machine("rover-1")
        );
        assert!(watch.changed(&records).await.expect("read").is_empty());
        let user = User {
            name: "ada".parse::<UserName>().expect("name"),
            role: Role::Viewer,
            password: None,
            created: 3,
            disabled: true,
        };
        records.users().add(&user).await.expect("added");
        assert_eq!(watch.changed(&records).await.expect("read"), person("ada"));
        assert!(watch.changed(&records).await.expect("read").is_empty());
    }
}

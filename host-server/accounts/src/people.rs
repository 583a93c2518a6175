//! What an administrator does with accounts.

use crawler_access::password::{self, Weak};
use crawler_access::{Role, Secret, UserName};
use crawler_records::{RecordsError, User};
use serde::Serialize;
use utoipa::ToSchema;

use crate::{Accounts, LoginError, lock};
use crawler_system::clock::now_ms;

/// An account, without what is secret about it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = User)]
pub struct UserView {
    /// Its name.
    name: String,
    /// `viewer`, `operator` or `admin`.
    role: &'static str,
    /// When it was made, in Unix milliseconds.
    created: i64,
    /// Whether it is locked out.
    disabled: bool,
    /// Whether its owner has set no password yet.
    invited: bool,
}

impl UserView {
    fn new(user: &User) -> Self {
        Self {
            name: user.name.to_string(),
            role: user.role.as_str(),
            created: user.created,
            disabled: user.disabled,
            invited: user.password.is_none(),
        }
    }
}

/// What changes about an account.
#[derive(Default)]
pub struct Change {
    /// What it may do from now on.
    pub role: Option<Role>,
    /// Whether it is locked out.
    pub disabled: Option<bool>,
    /// A new password.
    pub password: Option<String>,
}

/// Why an account stays as it is.
#[derive(Debug)]
pub enum PeopleError {
    /// There is none of that name.
    Unknown,
    /// There is one of that name.
    Exists,
    /// Nobody could administer the server any more.
    LastAdmin,
    /// There are as many as may be.
    TooMany,
    /// The password is not good enough.
    Weak(Weak),
    /// Too many passwords are being hashed.
    Busy,
    /// The records cannot be used.
    Records(RecordsError),
    /// Something that cannot happen did.
    Internal(&'static str),
}

impl From<RecordsError> for PeopleError {
    fn from(error: RecordsError) -> Self {
        match error {
            RecordsError::Exists => Self::Exists,
            RecordsError::NotFound => Self::Unknown,
            RecordsError::LastAdmin => Self::LastAdmin,
            RecordsError::TooMany(_) => Self::TooMany,
            error => Self::Records(error),
        }
    }
}

impl From<LoginError> for PeopleError {
    fn from(error: LoginError) -> Self {
        match error {
            LoginError::Records(error) => error.into(),
            LoginError::Exists => Self::Exists,
            LoginError::Weak(weak) => Self::Weak(weak),
            LoginError::Busy => Self::Busy,
            LoginError::Internal(what) => Self::Internal(what),
            _ => Self::Internal("an account could not be changed"),
        }
    }
}

impl Accounts {
    /// Every account.
    ///
    /// # Errors
    /// [`PeopleError`] of the records.
    pub async fn users(&self) -> Result<Vec<UserView>, PeopleError> {
        let users = self.records.users().all().await?;
        Ok(users.iter().map(UserView::new).collect())
    }

    /// Makes an account; without a password, returns the code of an invitation to it.
    ///
    /// # Errors
    /// [`PeopleError`] says why there is none.
    pub async fn add(
        &self,
        name: UserName,
        role: Role,
        password: Option<String>,
    ) -> Result<(UserView, Option<Secret>), PeopleError> {
        let hash = match password {
            Some(password) => Some(self.hash(&name, password).await?),
            None => None,
        };
        let user = User {
            name,
            role,
            password: hash,
            created: now_ms(),
            disabled: false,
        };
        self.records.users().add(&user).await?;
        let code = match user.password {
            Some(_) => None,
            None => Some(self.invite(&user.name, role).await?),
        };
        Ok((UserView::new(&user), code))
    }

    /// Changes an account and ends its sessions: their tokens say what was true before.
    ///
    /// # Errors
    /// [`PeopleError`] says why it stays as it is.
    pub async fn change(&self, name: &UserName, change: Change) -> Result<UserView, PeopleError> {
        let hash = match change.password {
            Some(password) => Some(self.hash(name, password).await?),
            None => None,
        };
        let _changing = self.changing.lock().await;
        let user = self.known(name).await?;
        let mut ends = false;
        if let Some(role) = change.role.filter(|role| *role != user.role) {
            self.records.users().set_role(name, role).await?;
            ends = true;
        }
        if let Some(disabled) = change.disabled {
            self.records
                .users()
                .set_disabled(name, disabled, now_ms())
                .await?;
            ends |= disabled;
        }
        if let Some(hash) = hash {
            self.records.users().set_password(name, &hash).await?;
            ends = true;
        }
        if ends {
            self.end_sessions(name, None).await?;
        }
        let user = self.known(name).await?;
        Ok(UserView::new(&user))
    }

    async fn known(&self, name: &UserName) -> Result<User, PeopleError> {
        let user = self.records.users().get(name).await?;
        user.ok_or(PeopleError::Unknown)
    }

    async fn hash(&self, name: &UserName, password: String) -> Result<String, PeopleError> {
        password::check(name, &password).map_err(PeopleError::Weak)?;
        let hash = self
            .hashing
            .run(move |memory| memory.hash(&password))
            .await
            .map_err(LoginError::from)?;
        Ok(hash.map_err(LoginError::from)?)
    }

    /// Forgets an account. What it did stays in the audit log.
    ///
    /// # Errors
    /// [`PeopleError`] says why it stays as it is.
    pub async fn delete(&self, name: &UserName) -> Result<(), PeopleError> {
        let _changing = self.changing.lock().await;
        let ended = self.records.users().delete(name, now_ms()).await?;
        lock(&self.alive).end_all(name, None, now_ms());
        for session in ended {
            lock(&self.alive).end(session, now_ms());
        }
        Ok(())
    }
}

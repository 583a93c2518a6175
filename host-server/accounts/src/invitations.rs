//! Getting in for the first time: invitations, and that of the first administrator.

use std::net::IpAddr;
use std::time::{Duration, Instant};

use crawler_access::password::{self, Weak};
use crawler_access::{Role, Secret, UserName};
use crawler_records::{RecordsError, User};

use crate::login::new_secret;
use crate::{Accounts, Entered, LoginError, OpenError, lock};
use crawler_system::clock::now_ms;

/// For how long an invitation is good.
const LIFETIME: Duration = Duration::from_hours(24);

impl Accounts {
    /// Makes an invitation to an account; returns its code.
    ///
    /// # Errors
    /// [`LoginError`] of the records, or when there is no randomness.
    pub async fn invite(&self, user: &UserName, role: Role) -> Result<Secret, LoginError> {
        let code = new_secret()?;
        let expires = now_ms().saturating_add(LIFETIME.as_millis() as i64);
        self.records
            .invitations()
            .add(Some(user), role, code.digest(), expires)
            .await?;
        Ok(code)
    }

    /// Makes the invitation of the first administrator, where there is none yet; returns its code.
    /// It is kept in memory alone, so that an old one is worth nothing after a restart.
    ///
    /// # Errors
    /// [`OpenError`] of the records, or when there is no randomness.
    pub async fn invite_first(&self) -> Result<Option<Secret>, OpenError> {
        if self.open || self.has_admin().await? {
            return Ok(None);
        }
        let code = Secret::generate().map_err(|_| OpenError::NoRandomness)?;
        let until = Instant::now() + LIFETIME;
        *lock(&self.first) = Some((code.digest(), until));
        Ok(Some(code))
    }

    async fn has_admin(&self) -> Result<bool, RecordsError> {
        let users = self.records.users().all().await?;
        Ok(users
            .iter()
            .any(|user| user.role == Role::Admin && !user.disabled && user.password.is_some()))
    }

    /// Makes or completes an account by an invitation, and opens a session.
    ///
    /// # Errors
    /// [`LoginError`] says why nobody gets in.
    pub async fn accept(
        &self,
        code: &str,
        name: Option<&str>,
        password: String,
        from: IpAddr,
    ) -> Result<Entered, LoginError> {
        self.failures
            .check(from, Instant::now())
            .map_err(LoginError::Wait)?;
        let name = name
            .map(str::parse::<UserName>)
            .transpose()
            .map_err(|_| LoginError::Name)?;
        if let Some(name) = &name {
            password::check(name, &password).map_err(LoginError::Weak)?;
        } else if password.chars().count() < password::MIN {
            return Err(LoginError::Weak(Weak::TooShort));
        }
        let code: Secret = code.parse().map_err(|_| LoginError::Invitation)?;
        // One at a time: two must not become the first administrator with one code.
        let _changing = self.changing.lock().await;
        let is_first = {
            let mut first = lock(&self.first);
            if first.is_some_and(|(_, until)| until <= Instant::now()) {
                *first = None;
            }
            first.is_some_and(|(digest, _)| digest.matches(&code))
        };
        let result = if is_first {
            self.accept_first(name, password).await
        } else {
            self.accept_kept(&code, name, password).await
        };
        let user = match result {
            Ok(user) => user,
            Err(error) => {
                if matches!(error, LoginError::Invitation) {
                    self.failures.failed(from, Instant::now());
                }
                return Err(error);
            }
        };
        self.enter(&user, from).await
    }

    async fn accept_first(
        &self,
        name: Option<UserName>,
        password: String,
    ) -> Result<User, LoginError> {
        let name = name.ok_or(LoginError::Name)?;
        if self.has_admin().await? {
            *lock(&self.first) = None;
            return Err(LoginError::Invitation);
        }
        let user = self.make(name, Role::Admin, password).await?;
        *lock(&self.first) = None;
        Ok(user)
    }

    async fn make(&self, name: UserName, role: Role, password: String) -> Result<User, LoginError> {
        let hash = self
            .hashing
            .run(move |memory| memory.hash(&password))
            .await??;
        let user = User {
            name,
            role,
            password: Some(hash),
            created: now_ms(),
            disabled: false,
        };
        self.records.users().add(&user).await?;
        Ok(user)
    }

    async fn accept_kept(
        &self,
        code: &Secret,
        name: Option<UserName>,
        password: String,
    ) -> Result<User, LoginError> {
        let taken = self
            .records
            .invitations()
            .take(code.digest(), now_ms())
            .await?;
        let invitation = taken.ok_or(LoginError::Invitation)?;
        let result = match (invitation.name.clone(), name) {
            (Some(invited), Some(name)) if invited != name => Err(LoginError::Name),
            (Some(invited), _) => self.complete(&invited, password).await,
            (None, Some(name)) => self.make(name, invitation.role, password).await,
            (None, None) => Err(LoginError::Name),
        };
        // What can be put right by whoever holds the invitation must not cost it.
        if let Err(LoginError::Name | LoginError::Exists | LoginError::Weak(_) | LoginError::Busy) =
            &result
        {
            self.records
                .invitations()
                .add(
                    invitation.name.as_ref(),
                    invitation.role,
                    code.digest(),
                    invitation.expires,
                )
                .await?;
        }
        result
    }

    /// Gives an account that was made for somebody its password.
    async fn complete(&self, name: &UserName, password: String) -> Result<User, LoginError> {
        password::check(name, &password).map_err(LoginError::Weak)?;
        let user = self.records.users().get(name).await?;
        let user = user
            .filter(|user| !user.disabled)
            .ok_or(LoginError::Invitation)?;
        let hash = self
            .hashing
            .run(move |memory| memory.hash(&password))
            .await??;
        self.records.users().set_password(name, &hash).await?;
        // Whoever was in with an older password is not who was invited.
        self.end_sessions(name, None).await?;
        Ok(User {
            password: Some(hash),
            ..user
        })
    }
}

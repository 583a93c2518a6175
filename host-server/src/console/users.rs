//! Accounts of people.

use crawler_access::{Role, Secret, UserName, password};
use crawler_records::User;
use serde_json::json;

use super::Console;
use super::args::UserTask;
use crate::addresses::Addresses;
use crate::calendar::moment;
use crate::config::Settings;
use crate::terminal;
use crawler_system::cli_error::{CliError, OrSay as _};
use crawler_system::clock::now_ms;

const HOUR_MS: i64 = 3_600_000;

pub(super) async fn run(task: UserTask, settings: &Settings) -> Result<(), CliError> {
    // The first account may be made before the server ever ran.
    let make = matches!(task, UserTask::Add { .. } | UserTask::Invite { .. });
    let console = Console::open(settings, make).await?;
    let result = match task {
        UserTask::Add { name, role } => add(&console, name, role).await,
        UserTask::List => list(&console).await,
        UserTask::Passwd { name } => passwd(&console, &name).await,
        UserTask::Role { name, role } => set_role(&console, &name, role).await,
        UserTask::Disable { name } => set_disabled(&console, &name, true).await,
        UserTask::Enable { name } => set_disabled(&console, &name, false).await,
        UserTask::Remove { name } => remove(&console, &name).await,
        UserTask::Invite { name, role, hours } => {
            invite(&console, settings, name.as_ref(), role, hours).await
        }
    };
    console.close().await;
    result
}

async fn add(console: &Console, name: UserName, role: Role) -> Result<(), CliError> {
    // Before anybody types a password for nothing.
    if console.find(&name).await?.is_some() {
        return Err(CliError::new(format!("{name} has an account already")));
    }
    let user = User {
        password: Some(ask_password(&name)?),
        name,
        role,
        created: now_ms(),
        disabled: false,
    };
    let result = console.records.users().add(&user).await;
    console
        .noted(
            "user.add",
            user.name.as_ref(),
            json!({ "role": role }),
            result,
        )
        .await?;
    println!("{} has an account now, as {role}.", user.name);
    Ok(())
}

async fn list(console: &Console) -> Result<(), CliError> {
    let users = console.records.users().all().await?;
    if users.is_empty() {
        println!("No accounts yet.");
        return Ok(());
    }
    println!("{:<32}  {:<8}  {:<20}  state", "name", "role", "made");
    for user in users {
        let state = match (user.disabled, &user.password) {
            (true, _) => "locked",
            (false, None) => "invited, no password yet",
            (false, Some(_)) => "active",
        };
        println!(
            "{:<32}  {:<8}  {:<20}  {state}",
            user.name,
            user.role.as_str(),
            moment(user.created)
        );
    }
    Ok(())
}

async fn passwd(console: &Console, name: &UserName) -> Result<(), CliError> {
    console.known(name).await?;
    let hash = ask_password(name)?;
    let result = console.records.users().set_password(name, &hash).await;
    console
        .noted("user.password", name.as_ref(), json!({}), result)
        .await?;
    // Whoever knew the old one may still be in.
    let ended = console.end_sessions(name).await?;
    println!("{name} has a new password. {}", ended_text(ended));
    Ok(())
}

async fn set_role(console: &Console, name: &UserName, role: Role) -> Result<(), CliError> {
    console.known(name).await?;
    let result = console.records.users().set_role(name, role).await;
    console
        .noted("user.role", name.as_ref(), json!({ "role": role }), result)
        .await?;
    // A token carries the role it was made with.
    let ended = console.end_sessions(name).await?;
    println!("{name} is {role} now. {}", ended_text(ended));
    Ok(())
}

async fn set_disabled(console: &Console, name: &UserName, disabled: bool) -> Result<(), CliError> {
    console.known(name).await?;
    let action = if disabled {
        "user.disable"
    } else {
        "user.enable"
    };
    let result = console
        .records
        .users()
        .set_disabled(name, disabled, now_ms())
        .await;
    let ended = console
        .noted(action, name.as_ref(), json!({}), result)
        .await?;
    if disabled {
        println!("{name} is locked out. {}", ended_text(ended.len()));
    } else {
        println!("{name} may log in again.");
    }
    Ok(())
}

async fn remove(console: &Console, name: &UserName) -> Result<(), CliError> {
    console.known(name).await?;
    let result = console.records.users().delete(name, now_ms()).await;
    let ended = console
        .noted("user.remove", name.as_ref(), json!({}), result)
        .await?;
    println!(
        "{name} has no account any more. {}",
        ended_text(ended.len())
    );
    Ok(())
}

async fn invite(
    console: &Console,
    settings: &Settings,
    name: Option<&UserName>,
    role: Option<Role>,
    hours: u16,
) -> Result<(), CliError> {
    let role = match name {
        Some(name) => awaited(console, name, role).await?,
        None => role.unwrap_or(Role::Viewer),
    };
    let code = Secret::generate()?;
    let expires = now_ms() + i64::from(hours) * HOUR_MS;
    let result = console
        .records
        .invitations()
        .add(name, role, code.digest(), expires)
        .await;
    console
        .noted(
            "user.invite",
            name.map_or("", AsRef::as_ref),
            json!({ "role": role, "hours": hours }),
            result,
        )
        .await?;
    let page = Addresses::of(settings).page;
    // The page asks for a name where the link has none.
    let named = name.map(|name| format!("&name={name}"));
    println!("{page}#invite={code}{}", named.unwrap_or_default());
    eprintln!(
        "Valid once, until {}. Whoever opens this link becomes {}{role}: send it on a channel that \
         you trust.",
        moment(expires),
        name.map(|name| format!("{name}, ")).unwrap_or_default(),
    );
    Ok(())
}

/// The role of the account that is invited to set a password. Somebody new gets one, which waits for it.
async fn awaited(console: &Console, name: &UserName, role: Option<Role>) -> Result<Role, CliError> {
    let Some(user) = console.find(name).await? else {
        let role = role.unwrap_or(Role::Viewer);
        let user = User {
            name: name.clone(),
            role,
            password: None,
            created: now_ms(),
            disabled: false,
        };
        let result = console.records.users().add(&user).await;
        let detail = json!({ "role": role, "invited": true });
        console
            .noted("user.add", name.as_ref(), detail, result)
            .await?;
        return Ok(role);
    };
    if user.disabled {
        return Err(CliError::new(format!(
            "{name} is locked out and could not log in: `terracrawler user enable {name}` comes first"
        )));
    }
    match role.filter(|role| *role != user.role) {
        Some(role) => Err(CliError::new(format!(
            "{name} is {} already: `terracrawler user role {name} {role}` changes that",
            user.role
        ))),
        None => Ok(user.role),
    }
}

fn ask_password(name: &UserName) -> Result<String, CliError> {
    let password = terminal::new_password(name.as_ref())?;
    password::check(name, &password)?;
    password::Memory::new()
        .hash(&password)
        .map_err(CliError::from)
}

fn ended_text(sessions: usize) -> String {
    match sessions {
        0 => "No session was open.".into(),
        1 => "One session ended.".into(),
        count => format!("{count} sessions ended."),
    }
}

impl Console {
    pub(super) async fn find(&self, name: &UserName) -> Result<Option<User>, CliError> {
        self.records.users().get(name).await.map_err(CliError::from)
    }

    async fn known(&self, name: &UserName) -> Result<User, CliError> {
        self.find(name).await?.ok_or_else(|| {
            CliError::new(format!(
                "{name} has no account; `terracrawler user list` has those there are"
            ))
        })
    }

    async fn end_sessions(&self, name: &UserName) -> Result<usize, CliError> {
        let ended = self
            .records
            .sessions()
            .revoke_all(name, None, now_ms())
            .await;
        ended
            .map(|ended| ended.len())
            .or_say(|error| format!("done, but the open sessions did not end: {error}"))
    }
}

//! Rollouts of models, on a whole server.

use crawler_release::Kind;
use serde_json::{Value, json};

use super::robot::{Program, Robot};
use super::{Home, OVERRIDE, hold, plan};

/// The row of `name` in a rollout that three others have confirmed.
async fn all_confirmed_but(home: &Home, id: &str, name: &str) -> Vec<Value> {
    let rows = home.rows(id).await.into_iter();
    let (left, rows): (Vec<_>, Vec<_>) = rows.partition(|row| row["robot"] == name);
    assert_eq!(rows.len(), 3, "{rows:?}");
    assert!(
        rows.iter().all(|row| row["state"] == "confirmed"),
        "{rows:?}"
    );
    left
}

#[tokio::test(flavor = "multi_thread")]
async fn a_good_model_reaches_every_robot_and_is_told_by_its_status() {
    let mut home = Home::new().await;
    let release = home.release_of(Some("eyes"), 4, 20_000).await;
    let _robots = home.robots(3, &release, Program::Good, 0).await;
    let (port, name) = (home.port.port(), "blind");
    let _blind = Robot::start(port, name, release.clone(), Program::Blind, 0);
    home.http().wait_told(name).await;
    let plan = plan(&release, &[50, 100], &json!({}));
    let id = home.begin(&plan).await;
    home.wait_state(&id, "done").await;
    let left = all_confirmed_but(&home, &id, name).await;
    // Who does not see is left out, and counted nowhere.
    let left: Vec<_> = left
        .iter()
        .map(|row| (&row["state"], &row["reason"], &row["offers"]))
        .collect();
    let not_applicable = (&json!("not_applicable"), &json!("no_vision"), &json!(0));
    assert_eq!(left, [not_applicable]);
    let view = home.rollout(&id).await;
    assert_eq!(view["plan"]["releases"][0]["model"], "eyes", "{view}");
    let overridden = json!({"why": OVERRIDE, "releases": [release.id]});
    assert_eq!(view["plan"]["override_gate"], overridden);
    let robot = home.http().get("/api/v1/robots/r00").await.json();
    assert_eq!(
        (&robot["build"], &robot["models"]),
        (&json!("old"), &json!({"eyes": "eyes-4"}))
    );
    // Whoever has it already is done at once. Sequences of programs are others.
    home.release(9, 10_000).await;
    let again = home.begin(&plan).await;
    home.wait_state(&again, "done").await;
    let rows = home.rows(&again).await;
    let there = rows.iter().filter(|row| row["reason"] == "already_there");
    assert_eq!(there.count(), 3, "{rows:?}");
    home.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bad_model_stops_itself_in_its_first_phase() {
    let mut home = Home::new().await;
    let release = home.release_of(Some("eyes"), 4, 5_000).await;
    let _robots = home.robots(10, &release, Program::Panics, 0).await;
    let id = home
        .begin(&plan(&release, &[40, 100], &json!({"parallel": 1})))
        .await;
    home.wait_state(&id, "paused").await;
    let rows = home.rows(&id).await;
    let failed: Vec<_> = rows
        .iter()
        .filter(|row| row["state"] == "rolled_back")
        .collect();
    assert_eq!(failed.len(), 2, "{rows:?}");
    assert!(
        failed
            .iter()
            .all(|row| row["reason"] == json!({"told": "too_slow"}))
    );
    assert_eq!(home.rollout(&id).await["reason"], "failures");
    home.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn rollouts_of_programs_and_of_models_take_no_robots_from_each_other() {
    let mut home = Home::new().await;
    let program = home.release(9, 30_000).await;
    let model = home.release_of(Some("eyes"), 4, 5_000).await;
    let robots = home.robots(2, &program, Program::Good, 0).await;
    let mixed = json!({"releases": [{"release": program.id}, {"release": model.id}],
        "phases": [{"select": {"share": 100}}]});
    let refused = home
        .http()
        .post("/api/v1/rollouts", &mixed.to_string())
        .await;
    refused.is_problem(422, "invalid_rollout");
    hold(&robots, 1);
    let first = home.begin(&plan(&program, &[100], &json!({}))).await;
    home.wait_count(&first, "receiving", 2).await;
    // Its sequence is below that of the program, which is none of its business.
    let second = home.begin(&plan(&model, &[100], &json!({}))).await;
    hold(&robots, u32::MAX);
    home.wait_state(&first, "done").await;
    let rows = home.rows(&first).await;
    assert!(
        rows.iter().all(|row| row["state"] == "confirmed"),
        "{rows:?}"
    );
    assert_eq!(home.rollout(&second).await["state"], "running");
    let rows = home.rows(&second).await;
    assert!(
        rows.iter().all(|row| row["state"] != "superseded"),
        "{rows:?}"
    );
    // Another one of the same takes them all.
    let newer = home.release_of(Some("eyes"), 5, 5_000).await;
    let third = home.begin(&plan(&newer, &[100], &json!({}))).await;
    home.wait_count(&second, "superseded", 2).await;
    home.act(&format!("{third}/abort")).await;
    home.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_policy_reaches_every_robot_that_has_room_for_one() {
    let mut home = Home::new().await;
    let first = Some("apart");
    let release = home.release_by_kind(Kind::Policy, first, 4, 9_000).await;
    let _robots = home.robots(3, &release, Program::Good, 0).await;
    let (port, name) = (home.port.port(), "full");
    let _full = Robot::start(port, name, release.clone(), Program::Blind, 0);
    home.http().wait_told(name).await;
    let id = home.begin(&plan(&release, &[50, 100], &json!({}))).await;
    home.wait_state(&id, "done").await;
    let left = all_confirmed_but(&home, &id, name).await;
    let left: Vec<_> = left
        .iter()
        .map(|row| (&row["state"], &row["reason"]))
        .collect();
    assert_eq!(left, [(&json!("not_applicable"), &json!("no_policies"))]);
    let view = home.rollout(&id).await;
    let planned = &view["plan"]["releases"][0];
    assert_eq!(
        (&planned["model"], &planned["policy"]),
        (&json!("apart"), &json!(true))
    );
    let robot = home.http().get("/api/v1/robots/r00").await.json();
    assert_eq!(robot["models"], json!({"apart": "apart-4"}));
    let one = home.http().get("/api/v1/policies/apart").await.json();
    assert_eq!(one["builds"], json!([{"build": "apart-4", "robots": 3}]));
    let has: Vec<_> = one["robots"]
        .as_array()
        .expect("robots")
        .iter()
        .map(|one| &one["robot"])
        .collect();
    assert_eq!(has, ["r00", "r01", "r02"]);
    let path = format!("/api/v1/releases/{}", release.id);
    let told = home.http().get(&path).await.json();
    assert_eq!(
        (&told["kind"], &told["name"]),
        (&json!("policy"), &json!("apart"))
    );
    // Policies have one order, whatever they are called, and models another one.
    let below = home
        .release_by_kind(Kind::Policy, Some("together"), 3, 9_000)
        .await;
    let refused = home
        .http()
        .post(
            "/api/v1/rollouts",
            &plan(&below, &[100], &json!({})).to_string(),
        )
        .await;
    refused.is_problem(422, "invalid_rollout");
    let model = home.release_of(Some("eyes"), 1, 5_000).await;
    let id = home.begin(&plan(&model, &[100], &json!({}))).await;
    home.act(&format!("{id}/abort")).await;
    // The next one takes robots from the one before, which is called otherwise.
    let older = home.release_by_kind(Kind::Policy, first, 5, 9_000).await;
    let older = home
        .begin(&plan(&older, &[50, 100], &json!({"parallel": 1})))
        .await;
    let newer = home
        .release_by_kind(Kind::Policy, Some("together"), 6, 9_000)
        .await;
    let newer = home.begin(&plan(&newer, &[100], &json!({}))).await;
    home.wait_count(&older, "superseded", 3).await;
    home.act(&format!("{newer}/abort")).await;
    home.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_policy_is_deployed_to_chosen_robots_by_its_name() {
    const POLICIES: &str = "/api/v1/policies";
    let mut home = Home::new().await;
    let names = async |home: &Home| -> Vec<(Value, Value)> {
        let told = home.http().get(POLICIES).await.json();
        let policies = told["policies"].as_array().expect("policies").clone();
        policies
            .into_iter()
            .map(|one| (one["name"].clone(), one["built_in"].clone()))
            .collect()
    };
    let spread = (json!("spread"), json!(true));
    assert_eq!(names(&home).await, std::slice::from_ref(&spread));
    let older = home
        .release_by_kind(Kind::Policy, Some("apart"), 4, 9_000)
        .await;
    let newer = home
        .release_by_kind(Kind::Policy, Some("apart"), 5, 9_000)
        .await;
    let eyes = home.release_of(Some("eyes"), 1, 5_000).await;
    let _robots = home.robots(3, &newer, Program::Good, 0).await;
    let apart = (json!("apart"), json!(false));
    assert_eq!(names(&home).await, [apart.clone(), spread]);
    let one = home.http().get(&format!("{POLICIES}/apart")).await.json();
    let ids: Vec<_> = one["releases"]
        .as_array()
        .expect("releases")
        .iter()
        .map(|one| &one["id"])
        .collect();
    assert_eq!(ids.len(), 2);
    assert_eq!((&one["builds"], &one["robots"]), (&json!([]), &json!([])));
    for name in ["eyes", "nobody", "%00", "..%2F..", ""] {
        let answer = home.http().get(&format!("{POLICIES}/{name}")).await;
        assert_eq!(answer.status, 404, "{name}");
    }

    let deploy = async |name: &str, body: Value| {
        let path = format!("{POLICIES}/{name}/deploy");
        home.http().post(&path, &body.to_string()).await
    };
    for name in ["spread", "eyes", "nobody"] {
        let refused = deploy(name, json!({"robots": ["r00"]})).await;
        refused.is_problem(404, "unknown_policy");
    }
    let wrong = json!({
        "robots": ["r00", "nobody", "r00", "NO NAME"], "release": eyes.id, "soak_s": 1_000_000,
    });
    let refused = deploy("apart", wrong).await;
    refused.is_problem(422, "invalid_rollout");
    let errors = refused.json()["errors"].as_array().expect("errors").clone();
    let pointers: Vec<_> = errors
        .iter()
        .map(|error| error["pointer"].clone())
        .collect();
    assert_eq!(
        pointers,
        ["/release", "/soak_s", "/robots/1", "/robots/2", "/robots/3"]
    );
    for robots in [json!([]), json!(vec!["r00"; 1_001])] {
        let refused = deploy("apart", json!({ "robots": robots })).await;
        refused.is_problem(422, "invalid_rollout");
        assert_eq!(refused.json()["errors"][0]["pointer"], "/robots");
    }
    for body in [
        json!({}),
        json!({"robots": "r00"}),
        json!({"robots": ["r00"], "share": 1}),
    ] {
        deploy("apart", body).await.is_problem(422, "invalid_body");
    }
    // What a rollout asks for, this one asks for.
    let refused = deploy("apart", json!({"robots": ["r00"]})).await;
    refused.is_problem(422, "gate_missing");

    let body = json!({"robots": ["r02", "r00"], "override_gate": OVERRIDE});
    let begun = deploy("apart", body).await;
    assert_eq!(begun.status, 201, "{}", begun.text());
    let begun = begun.json();
    let releases = begun["plan"]["releases"].as_array().expect("releases");
    assert_eq!(
        (releases.len(), &releases[0]["release"]),
        (1, &json!(newer.id))
    );
    let id = begun["id"].as_str().expect("an id").to_owned();
    home.wait_state(&id, "done").await;
    let rows = home.rows(&id).await;
    let confirmed = rows.iter().filter(|row| row["state"] == "confirmed");
    let confirmed: Vec<_> = confirmed.map(|row| row["robot"].clone()).collect();
    assert_eq!(confirmed, ["r00", "r02"], "{rows:?}");
    let one = home.http().get(&format!("{POLICIES}/apart")).await.json();
    assert_eq!(one["builds"], json!([{"build": "apart-5", "robots": 2}]));
    // One that is older than what was rolled out is refused, as by any rollout.
    let body = json!({"robots": ["r01"], "release": older.id, "override_gate": OVERRIDE});
    let refused = home
        .http()
        .post(&format!("{POLICIES}/apart/deploy"), &body.to_string())
        .await;
    refused.is_problem(422, "invalid_rollout");
    home.stop().await;
}

//! What the server says about itself: descriptions, problem documents, health, pages.

use std::collections::BTreeSet;
use std::path::Path;

use crate::support::Fixture;
use hyper::Method;
use serde_json::{Map, Value, json};

/// What the types of the control room are generated from, by `npm run generate`.
#[tokio::test(flavor = "multi_thread")]
async fn the_control_room_knows_this_interface() {
    let fixture = Fixture::start().await;
    let mut document = fixture.get("/api/v1/openapi.json").await.json();
    fixture.stop().await;
    // The version of the program changes nothing about it.
    document["info"]["version"] = Value::Null;
    let messages: Map<String, Value> = crawler_sim_protocol::schemas()
        .into_iter()
        .map(|(name, schema)| Ok((name.to_owned(), serde_json::to_value(schema)?)))
        .collect::<serde_json::Result<_>>()
        .expect("schemas");
    let told = json!({ "openapi": document, "messages": messages });
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("ui/interface.json");
    if std::env::var_os("UPDATE_INTERFACE").is_some() {
        let text = serde_json::to_string_pretty(&told).expect("JSON");
        std::fs::write(&path, text + "\n").expect("written");
    }
    let kept = std::fs::read(&path).unwrap_or_default();
    let kept: Value = serde_json::from_slice(&kept).unwrap_or_default();
    assert!(
        kept == told,
        "host-server/ui/interface.json is not what this server says of itself: run this test with \
         UPDATE_INTERFACE=1, and `npm run generate` in host-server/ui"
    );
}

/// All that a document refers to.
fn references<'a>(value: &'a Value, found: &mut BTreeSet<&'a str>) {
    match value {
        Value::Object(fields) => {
            for (name, field) in fields {
                match field {
                    Value::String(target) if name == "$ref" => {
                        found.insert(target);
                    }
                    field => references(field, found),
                }
            }
        }
        Value::Array(items) => items.iter().for_each(|item| references(item, found)),
        _ => {}
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn bodies_of_commands_are_described_to_the_last_field() {
    let fixture = Fixture::start().await;
    let document = fixture.get("/api/v1/openapi.json").await.json();
    fixture.stop().await;
    let mut targets = BTreeSet::new();
    references(&document, &mut targets);
    for target in targets {
        let place = target.strip_prefix('#').expect("in the document");
        assert!(document.pointer(place).is_some(), "nothing at {target}");
    }
    let schemas = &document["components"]["schemas"];
    for (schema, field, word) in [
        ("CommandRequest", "speed", "move"),
        ("SimulatorCommand", "factor", "speed"),
    ] {
        let all = schemas[schema]["oneOf"].as_array();
        let all = all.unwrap_or_else(|| panic!("{}", schemas[schema]));
        let one = all.iter().find(|one| one["title"] == word).expect(word);
        let text = one.to_string();
        assert!(text.contains(field), "{text}");
    }
    let values = &schemas["ParameterChanges"]["additionalProperties"]["$ref"];
    assert_eq!(values, "#/components/schemas/CommandRequest.ParameterValue");
    let fault = &schemas["FaultRequest"]["properties"]["fault"]["$ref"];
    assert_eq!(fault, "#/components/schemas/SimulatorCommand.FaultSpec");
}

#[tokio::test(flavor = "multi_thread")]
async fn descriptions_fit_what_is_there() {
    let fixture = Fixture::start().await;
    let document = fixture.get("/api/v1/openapi.json").await.json();
    let paths = document["paths"].as_object().expect("paths");
    let mut calls: Vec<_> = paths
        .iter()
        .flat_map(|(path, item)| {
            let methods = item.as_object().expect("methods").keys();
            methods.map(move |method| format!("{method} {path}"))
        })
        .collect();
    calls.sort();
    assert_eq!(
        calls,
        [
            "delete /api/v1/counterfactuals/{id}",
            "delete /api/v1/experiments/{id}",
            "delete /api/v1/fences/{id}",
            "delete /api/v1/robots/{id}/credential",
            "delete /api/v1/robots/{id}/faults",
            "delete /api/v1/robots/{id}/twin/calibrations/{number}",
            "delete /api/v1/session",
            "delete /api/v1/sessions/{id}",
            "delete /api/v1/users/{name}",
            "get /api/v1/audit",
            "get /api/v1/audit/verify",
            "get /api/v1/commands",
            "get /api/v1/commands/{id}",
            "get /api/v1/counterfactuals",
            "get /api/v1/counterfactuals/{id}",
            "get /api/v1/credentials",
            "get /api/v1/events",
            "get /api/v1/experiments",
            "get /api/v1/experiments/{id}",
            "get /api/v1/experiments/{id}/curve",
            "get /api/v1/experiments/{id}/files/{name}",
            "get /api/v1/experiments/{id}/metrics",
            "get /api/v1/fences",
            "get /api/v1/fleet/gap",
            "get /api/v1/history",
            "get /api/v1/history/frames",
            "get /api/v1/live",
            "get /api/v1/policies",
            "get /api/v1/policies/{name}",
            "get /api/v1/releases",
            "get /api/v1/releases/{id}",
            "get /api/v1/releases/{id}/gate",
            "get /api/v1/robots",
            "get /api/v1/robots/{id}",
            "get /api/v1/robots/{id}/image",
            "get /api/v1/robots/{id}/logs",
            "get /api/v1/robots/{id}/map",
            "get /api/v1/robots/{id}/parameters",
            "get /api/v1/robots/{id}/telemetry",
            "get /api/v1/robots/{id}/twin",
            "get /api/v1/robots/{id}/twin/calibrations",
            "get /api/v1/robots/{id}/twin/calibrations/{number}",
            "get /api/v1/robots/{id}/twin/certificates",
            "get /api/v1/robots/{id}/twin/forecast",
            "get /api/v1/robots/{id}/twin/permit",
            "get /api/v1/rollouts",
            "get /api/v1/rollouts/{id}",
            "get /api/v1/rollouts/{id}/robots",
            "get /api/v1/rollouts/{id}/robots/{robot}",
            "get /api/v1/schema/{message}",
            "get /api/v1/session",
            "get /api/v1/sessions",
            "get /api/v1/simulator",
            "get /api/v1/simulator/scenarios",
            "get /api/v1/simulator/scenarios/{name}",
            "get /api/v1/users",
            "patch /api/v1/users/{name}",
            "post /api/v1/counterfactuals",
            "post /api/v1/experiments",
            "post /api/v1/experiments/{id}/pause",
            "post /api/v1/experiments/{id}/resume",
            "post /api/v1/experiments/{id}/start",
            "post /api/v1/experiments/{id}/stop",
            "post /api/v1/fences",
            "post /api/v1/invitations",
            "post /api/v1/policies/{name}/deploy",
            "post /api/v1/policies/{name}/shadow",
            "post /api/v1/releases",
            "post /api/v1/releases/{id}/gate",
            "post /api/v1/releases/{id}/withdraw",
            "post /api/v1/robots/{id}/commands",
            "post /api/v1/robots/{id}/credential",
            "post /api/v1/robots/{id}/faults",
            "post /api/v1/robots/{id}/twin/calibrations",
            "post /api/v1/rollouts",
            "post /api/v1/rollouts/{id}/abort",
            "post /api/v1/rollouts/{id}/pause",
            "post /api/v1/rollouts/{id}/resume",
            "post /api/v1/rollouts/{id}/robots/{robot}/retry",
            "post /api/v1/rollouts/{id}/robots/{robot}/skip",
            "post /api/v1/session",
            "post /api/v1/session/refresh",
            "post /api/v1/session/ticket",
            "post /api/v1/simulator/commands",
            "post /api/v1/swarm/commands",
            "post /api/v1/users",
            "put /api/v1/fences/{id}",
            "put /api/v1/robots/{id}/parameters",
            "put /api/v1/session/password",
        ]
    );
    let mut names = BTreeSet::new();
    for (path, item) in paths {
        for (method, call) in item.as_object().expect("methods") {
            let name = call["operationId"].as_str().expect("a name");
            assert!(names.insert(name), "{name} is there twice");
            let told = call["responses"].as_object().expect("responses");
            let mut wanted = vec!["400", "401", "403", "429"];
            if !call["requestBody"].is_null() {
                wanted.extend(["413", "415"]);
            }
            for status in wanted {
                assert!(told.contains_key(status), "{method} {path}: {status}");
            }
        }
    }
    // Everything referred to is there.
    let text = document.to_string();
    for reference in text.split("\"#/components/schemas/").skip(1) {
        let name = reference.split('"').next().expect("name");
        assert!(
            document["components"]["schemas"][name].is_object(),
            "{name}"
        );
    }

    for message in [
        "command",
        "command-request",
        "telemetry",
        "status",
        "response",
        "simulator-command",
    ] {
        let schema = fixture.get(&format!("/api/v1/schema/{message}")).await;
        assert_eq!(schema.status, 200);
        assert_eq!(schema.header("content-type"), "application/schema+json");
        assert!(schema.json().is_object());
    }
    let unknown = fixture.get("/api/v1/schema/letter").await;
    unknown.is_problem(404, "unknown_message");
    assert!(unknown.text().contains("telemetry"), "{}", unknown.text());
    fixture.stop().await;
}

/// No body has such a field, and no query such a parameter.
const NO_FIELD: &str = "no such/field";
const NO_PARAMETER: &str = "no_such_parameter";

/// What `schema` refers to.
fn resolved<'a>(document: &'a Value, schema: &'a Value) -> &'a Value {
    match schema["$ref"].as_str() {
        Some(place) => {
            let place = place.trim_start_matches('#');
            resolved(document, document.pointer(place).expect("there"))
        }
        None => schema,
    }
}

/// Wrong bodies for a schema, each with the beginning of the pointer to what is wrong.
fn wrong_bodies(document: &Value, schema: &Value) -> Vec<(Value, String)> {
    let schema = resolved(document, schema);
    // One of several: any of them will do.
    let schema = schema["oneOf"].as_array().map_or(schema, |ways| &ways[0]);
    let fields = schema["properties"].as_object();
    let fields: Vec<_> = fields.into_iter().flatten().collect();
    // What says which of several it is.
    let mut right = Map::new();
    for (name, field) in &fields {
        if let Some(only) = field.get("const") {
            right.insert((*name).clone(), only.clone());
        }
    }
    let with = |name: &str, value: Value| {
        let mut body = right.clone();
        body.insert(name.to_owned(), value);
        Value::Object(body)
    };
    let mut bodies = vec![(with(NO_FIELD, json!(1)), "/no such~1field".to_owned())];
    for (name, field) in fields {
        let field = resolved(document, field);
        let object = field["type"] == "object" || field["oneOf"].is_array();
        let wrong = if object {
            json!(7)
        } else {
            json!({ NO_FIELD: 1 })
        };
        bodies.push((with(name, wrong), format!("/{name}")));
    }
    bodies
}

#[tokio::test(flavor = "multi_thread")]
async fn every_call_points_at_what_is_wrong_in_its_body() {
    let fixture = Fixture::world(false).await;
    let document = fixture.get("/api/v1/openapi.json").await.json();
    let mut tried = BTreeSet::new();
    for (path, item) in document["paths"].as_object().expect("paths") {
        for (method, call) in item.as_object().expect("methods") {
            let schema = &call["requestBody"]["content"]["application/json"]["schema"];
            if schema.is_null() {
                continue;
            }
            let address = path.replace("{id}", "sim-0001").replace("{name}", "ada");
            let method: Method = method.to_uppercase().parse().expect("a method");
            let json_type = [("content-type", "application/json")];
            for (body, pointer) in wrong_bodies(&document, schema) {
                let told = format!("{method} {path} {body}");
                let answer = fixture
                    .call(method.clone(), &address, &json_type, body.to_string())
                    .await;
                assert_eq!(answer.status, 422, "{told}: {}", answer.text());
                let problem = answer.json();
                let errors = problem["errors"].as_array();
                let errors = errors.unwrap_or_else(|| panic!("{told}: {problem}"));
                let named = errors.iter().any(|error| {
                    let at = error["pointer"].as_str().expect("a pointer");
                    let detail = error["detail"].as_str().expect("words");
                    at.starts_with(&pointer) && !detail.is_empty()
                });
                assert!(named, "{told}: nothing at {pointer}: {problem}");
            }
            tried.insert(format!("{method} {path}"));
        }
    }
    assert_eq!(tried.len(), 19, "{tried:?}");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_query_names_what_is_wrong_in_it() {
    let fixture = Fixture::world(false).await;
    let document = fixture.get("/api/v1/openapi.json").await.json();
    let mut tried = 0;
    for (path, item) in document["paths"].as_object().expect("paths") {
        let parameters = item["get"]["parameters"].as_array();
        let mut parameters = parameters
            .into_iter()
            .flatten()
            .filter(|parameter| parameter["in"] == "query")
            .peekable();
        // The ticket of a live feed is no business of anybody who reads over a shoulder.
        if parameters.peek().is_none() || path == "/api/v1/live" {
            continue;
        }
        let address = path.replace("{id}", "sim-0001").replace("{name}", "empty");
        let mut wrong = vec![(NO_PARAMETER.to_owned(), "1")];
        for parameter in parameters {
            let name = parameter["name"].as_str().expect("a name").to_owned();
            if parameter["schema"].to_string().contains("integer") {
                wrong.push((name, "x"));
            }
        }
        for (name, value) in wrong {
            let answer = fixture.get(&format!("{address}?{name}={value}")).await;
            answer.is_problem(400, "bad_query");
            let errors = answer.json()["errors"].clone();
            assert_eq!(errors[0]["parameter"], name, "{path}: {errors}");
            tried += 1;
        }
    }
    assert!(tried > 20, "{tried}");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn errors_are_problem_documents_everywhere() {
    let fixture = Fixture::start().await;
    for path in [
        "/nope",
        "/api/v1/nope",
        "/api/nope",
        "/assets/gone-123.js",
        "/api/v1/robots/a/b/c",
    ] {
        fixture.get(path).await.is_problem(404, "not_found");
    }
    for path in ["/api/v1/robots", "/healthz", "/"] {
        let answer = fixture.call(Method::DELETE, path, &[], "").await;
        answer.is_problem(405, "method_not_allowed");
    }
    let answer = fixture
        .call(Method::DELETE, "/api/v1/robots", &[], "")
        .await;
    assert_eq!(answer.header("allow"), "GET,HEAD");
    fixture
        .get("/api/v1/live")
        .await
        .is_problem(400, "not_a_websocket");

    let foreign = [("host", "evil.example")];
    fixture
        .call(Method::GET, "/api/v1/robots", &foreign, "")
        .await
        .is_problem(403, "foreign_host");
    let page = [
        ("origin", "https://evil.example"),
        ("content-type", "application/json"),
    ];
    fixture
        .call(
            Method::POST,
            "/api/v1/swarm/commands",
            &page,
            r#"{"command":"stop"}"#,
        )
        .await
        .is_problem(403, "foreign_origin");
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn health_metrics_and_pages_are_served() {
    let fixture = Fixture::start().await;
    assert_eq!(fixture.get("/healthz").await.status, 200);
    let ready = fixture.get("/readyz").await;
    assert_eq!(ready.status, 200);
    assert_eq!(ready.json(), json!({"ready": true, "broker": true}));
    let metrics = fixture.get("/metrics").await;
    for name in [
        "terracrawler_robots{status=\"online\"} 0",
        "terracrawler_broker_connected 1",
        "process_cpu_seconds_total ",
        "process_resident_memory_bytes ",
        "terracrawler_embedded_broker_oversize_total 0",
    ] {
        assert!(
            metrics.text().contains(name),
            "{name} in {}",
            metrics.text()
        );
    }
    assert!(metrics.text().ends_with("# EOF\n"));
    assert_eq!(metrics.text().matches("# EOF").count(), 1);

    let page = fixture.get("/").await;
    assert_eq!(page.status, 200);
    assert!(page.text().contains("Terracrawler"));
    assert!(
        page.header("content-security-policy")
            .contains("default-src 'none'")
    );
    assert_eq!(page.header("x-content-type-options"), "nosniff");
    let tag = page.header("etag").to_owned();
    if !tag.is_empty() {
        // The control room is built: a second visit costs nothing.
        let again = [("if-none-match", tag.as_str())];
        let again = fixture.call(Method::GET, "/", &again, "").await;
        assert_eq!(again.status, 304);
        assert!(again.body.is_empty());
    }
    fixture.stop().await;
}

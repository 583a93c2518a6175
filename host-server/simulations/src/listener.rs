//! The ear of a simulated world: commands on `simulator/command`, answers on
//! `simulator/response`.
//!
//! A session of its own, so that a world is steered the same way whether the server is in this
//! process or elsewhere. Commands are taken one after the other; what was published while nobody
//! listened is not obeyed later.

use std::sync::Arc;
use std::time::Duration;

use crawler_protocol::{Fleet, MAX_MESSAGE, Topic};
use crawler_sim::live::ControlError;
use crawler_sim_protocol::SimulatorCommand;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{Packet, Publish};
use rumqttc::v5::{AsyncClient, Event, MqttOptions};
use serde_json::{Value, json};
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;
use tokio_util::task::AbortOnDropHandle;

use crate::{Simulation, SimulatorAnswer, control_code};

const FIRST_PAUSE: Duration = Duration::from_millis(200);
const LONGEST_PAUSE: Duration = Duration::from_secs(5);
/// Commands that may wait; more are answered `busy`.
const WAITING: usize = 64;
/// Answers that may wait for the connection.
const OUTGOING: usize = 256;
/// Bytes of a packet at most: the broker's own messages to us are small.
pub const MAX_PACKET: u32 = 64 * 1024;

/// Where answers go: `simulator/response` of the fleet.
pub fn response_topic(fleet: &Fleet) -> String {
    format!("{}/simulator/response", fleet.as_str())
}

/// Listens for commands until `stop`, in sessions with the options of `session`.
pub async fn listen(
    simulation: Arc<Simulation>,
    session: MqttOptions,
    fleet: Fleet,
    stop: CancellationToken,
) {
    let mut pause = FIRST_PAUSE;
    while !stop.is_cancelled() {
        let begun = tokio::time::Instant::now();
        let reason = tokio::select! {
            () = stop.cancelled() => return,
            reason = serve(&simulation, &session, &fleet) => reason,
        };
        tracing::warn!(
            reason,
            "nobody hears commands to the simulator; connecting again"
        );
        if begun.elapsed() > LONGEST_PAUSE {
            pause = FIRST_PAUSE;
        }
        tokio::select! {
            () = stop.cancelled() => return,
            () = tokio::time::sleep(pause) => {}
        }
        pause = (pause * 2).min(LONGEST_PAUSE);
    }
}

/// One connection, to its end; says why it ended.
async fn serve(simulation: &Arc<Simulation>, session: &MqttOptions, fleet: &Fleet) -> String {
    let (client, mut events) = AsyncClient::new(session.clone(), OUTGOING);
    let (to_world, orders) = mpsc::channel(WAITING);
    let _worker = AbortOnDropHandle::new(tokio::spawn(obey(
        Arc::clone(simulation),
        orders,
        client.clone(),
        response_topic(fleet),
    )));
    let topic = Topic::SimulatorCommand.render(fleet).as_str().to_owned();
    loop {
        match events.poll().await {
            Ok(Event::Incoming(Packet::ConnAck(_))) => {
                if let Err(error) = client.try_subscribe(topic.clone(), QoS::AtLeastOnce) {
                    break error.to_string();
                }
            }
            Ok(Event::Incoming(Packet::Publish(publish))) => {
                // A retained command is one of long ago.
                if !publish.retain && to_world.try_send(publish).is_err() {
                    let answer = refusal(&Value::Null, "busy", "too many commands are waiting");
                    tell(&client, &response_topic(fleet), &answer);
                }
            }
            Ok(_) => {}
            Err(error) => break error.to_string(),
        }
    }
}

/// Has the world do one thing after the other.
async fn obey(
    simulation: Arc<Simulation>,
    mut orders: mpsc::Receiver<Publish>,
    client: AsyncClient,
    topic: String,
) {
    while let Some(publish) = orders.recv().await {
        if let Some(answer) = answer(&simulation, &publish.payload).await {
            tell(&client, &topic, &answer);
        }
    }
}

fn refusal(command: &Value, code: &str, detail: &str) -> Value {
    json!({ "command": command, "status": "rejected", "code": code, "detail": detail })
}

/// Does what a message says. `None` when it was not meant for this world.
async fn answer(simulation: &Simulation, payload: &[u8]) -> Option<Value> {
    if payload.len() > MAX_MESSAGE {
        let text = "the command is too large";
        return Some(refusal(&Value::Null, "too_large", text));
    }
    let command = match SimulatorCommand::from_json(payload) {
        Ok(command) => command,
        Err(error) => {
            let text = error.to_string();
            return Some(refusal(&Value::Null, "invalid_command", &text));
        }
    };
    let name = Value::from(command.name().name());
    // Robots on benches hear them too, and say in their logs what became of it.
    let is_fault = matches!(command, SimulatorCommand::Fault(_));
    match simulation.control(command).await {
        Ok(done) => {
            let done = SimulatorAnswer::new(simulation, &done);
            let mut answer = json!({ "command": name, "status": "completed" });
            if let (Some(answer), Ok(Value::Object(done))) =
                (answer.as_object_mut(), serde_json::to_value(done))
            {
                answer.extend(done);
                // Lists that may be longer than a message.
                if let Some(Value::Object(world)) = answer.get_mut("simulator") {
                    world.remove("dropped");
                    world.remove("bookmarks");
                }
            }
            Some(answer)
        }
        Err(ControlError::NoRobot) if is_fault => None,
        Err(error) => Some(refusal(&name, control_code(&error), &error.to_string())),
    }
}

fn tell(client: &AsyncClient, topic: &str, answer: &Value) {
    if let Err(error) = client.try_publish(topic, QoS::AtLeastOnce, false, answer.to_string()) {
        tracing::warn!(%error, "an answer of the simulator is lost");
    }
}

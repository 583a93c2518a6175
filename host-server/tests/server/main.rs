//! A server as its users meet it, over HTTP, MQTT and WebSocket. One program, since each would take the
//! better part of a minute to link.

mod support;

mod accounts;
mod audit;
mod audit_disk;
mod broker_attacks;
mod broker_floods;
mod broker_rules;
mod calibrations;
mod compression;
mod contract;
mod counterfactuals;
mod deltas;
mod descriptions;
mod experiments;
mod faults;
mod fences;
mod halts;
mod hostile;
mod images;
mod link;
mod live;
mod live_faults;
mod maps;
mod mixed;
mod mqtt_websocket;
mod names;
mod outside;
mod recorded;
mod releases;
mod roles;
mod rollouts;
mod sessions;
mod shadows;
mod sight;
mod simulator;
mod swarm;
mod telemetry;
mod tls;
mod trainings;
mod twins;

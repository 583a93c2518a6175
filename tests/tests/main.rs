//! Every test end to end, and every check of the repository, in one program, so that server and simulator are
//! linked once and not for each file. cargo-nextest gives each test a process of its own all the same.

mod bodies;
mod book;
mod browser;
mod chaos_live;
mod cluster;
mod conformance;
mod deploy;
mod emulated;
mod examples;
mod federated;
mod layering;
mod mosquitto_clients;
mod mosquitto_configurations;
mod outside_broker;
mod pins;
mod postgres;
mod provisioning;
mod repository;
mod robot_tls;
mod rollouts;
mod timeseries;
mod trainings;
mod words;
mod workers;

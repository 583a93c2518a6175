//! Every test end to end, and every check of the repository, in one program: to link server and simulator once
//! takes a fraction of linking them for each file. cargo-nextest gives each test a process of its own all
//! the same.

mod book;
mod browser;
mod chaos_live;
mod cluster;
mod conformance;
mod deploy;
mod emulated;
mod examples;
mod layering;
mod mosquitto_clients;
mod mosquitto_configurations;
mod outside_broker;
mod pins;
mod postgres;
mod provisioning;
mod repository;
mod robot_tls;
mod timeseries;
mod words;

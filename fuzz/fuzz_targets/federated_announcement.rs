//! Fuzzes `federated_announcement`; see `federated.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("federated_announcement", data));

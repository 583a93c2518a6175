//! Fuzzes `simulator_command`; see `simulator.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("simulator_command", data));

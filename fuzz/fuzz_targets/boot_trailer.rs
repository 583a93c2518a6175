//! Fuzzes `boot_trailer`; see `boot.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("boot_trailer", data));

//! Fuzzes `tls_certificate`; see `tls.rs`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| crawler_fuzz::run("tls_certificate", data));

//! A sealed query from anybody, as the service gets it.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| veiloc_fuzz::sealed_query(bytes));

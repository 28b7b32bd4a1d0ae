//! An answer from a service, as a device gets it.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| veiloc_fuzz::answer(bytes));

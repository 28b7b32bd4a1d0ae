//! A file of tokens, as an operator may have written it.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| veiloc_fuzz::tokens(bytes));

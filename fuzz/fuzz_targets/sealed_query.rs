//! A sealed query from any client, as the service receives it.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    veiloc_fuzz::sealed_query(bytes);
});

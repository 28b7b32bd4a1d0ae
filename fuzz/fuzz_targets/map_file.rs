//! A map file; its checksums are corrected, so that the code behind them is reached.
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    veiloc_fuzz::map_file(bytes);
});

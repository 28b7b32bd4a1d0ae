//! Integration tests of `veiloc-descriptor`, one executable to save linking time.

mod oracle;

//! Tests of `hloc`.

mod hostile;
mod oracle;

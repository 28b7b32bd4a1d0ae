//! Tests of `detector`.

mod files;
mod oracle;

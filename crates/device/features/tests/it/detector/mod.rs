//! Tests of `detector`.

mod files;
mod oracle;
mod people;

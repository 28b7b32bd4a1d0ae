//! Tests of `audit`.

mod attack_server;
mod shown_in_browsers;
mod training;

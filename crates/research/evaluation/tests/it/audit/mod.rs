//! Tests of `audit`.

mod attack_server;
mod outsiders;
mod shown_in_browsers;

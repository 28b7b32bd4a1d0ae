//! Tests of `attack_evaluation`.

mod attack_server;
mod inversion;
mod outsiders;
mod real_sessions;
mod shown_in_browsers;

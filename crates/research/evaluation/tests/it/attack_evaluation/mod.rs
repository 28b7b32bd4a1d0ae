//! Tests of `attack_evaluation`.

mod attack_server;
mod inversion;
mod query_only;
mod real_sessions;
mod shown_in_browsers;

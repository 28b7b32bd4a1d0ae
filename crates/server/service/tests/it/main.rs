//! Tests of `veiloc-service` from outside, one executable: linking is what costs.

mod anchors;
mod answers;
mod common;
mod cors;
mod echo;
mod fairness;
mod faults;
mod geopose;
mod lengths;
mod listeners;
mod monitoring;
mod page;
mod privacy;
mod refusals;
mod reload;
mod rig;
mod scopes;
mod shutdown;
mod timing;
mod tls;
mod traces;
mod unknown_clients;
mod web_page;

//! Tests of `solvers`.

mod oracle;
mod p3p;
mod p5lp_radial;
mod p6lp;
mod p6lp_dual_radial;
mod support;
mod u4lp;
mod up2p;
mod wild_input;

//! The Python package `veiloc`: the libraries behind numpy arrays, and the program.
//!
//! Bindings hold no algorithms: every function converts what it is given, calls one of the libraries without the interpreter's
//! lock, and converts what comes back. What Python adds (notebooks, hloc's steps) is in `python/veiloc`.
//!
//! - [`errors`]: the libraries' errors as exceptions. [`arrays`], [`camera`], [`pose`], [`options`]: conversions.
//! - [`waiting`]: long calls, Ctrl-C, progress.
//! - [`solvers`], [`estimate`]: poses from correspondences, called as PoseLib's.
//! - [`images`], [`profile`], [`device`], [`session`]: what a device does. [`map`], [`shares`], [`colmap`], [`answer`]: what a
//!   server does. [`client`]: how one asks the other. [`attacks`]: what leaks.
//! - [`rendered`]: a place to try it all on. [`program`]: the command line.
#![forbid(unsafe_code)]

mod answer;
mod arrays;
mod attacks;
mod camera;
mod client;
mod colmap;
mod device;
mod errors;
mod estimate;
mod hands;
mod images;
mod map;
mod options;
mod pose;
mod posed;
mod profile;
mod program;
mod rendered;
mod session;
mod shares;
mod solvers;
mod waiting;

/// The native part of the package; people import `veiloc`.
#[pyo3::pymodule(gil_used = true)]
mod _native {
    #[pymodule_export]
    use crate::answer::Answer;
    #[pymodule_export]
    use crate::attacks::{attack, attack_names, audit};
    #[pymodule_export]
    use crate::client::Client;
    #[pymodule_export]
    use crate::colmap::{ColmapModel, undistort};
    #[pymodule_export]
    use crate::device::{describe_query, device_limits, extract, obfuscate, seal};
    #[pymodule_export]
    use crate::estimate::{
        anchored_lines, estimate_absolute_pose, estimate_absolute_pose_anchored, estimate_absolute_pose_lines,
    };
    #[pymodule_export]
    use crate::map::Map;
    #[pymodule_export]
    use crate::pose::CameraPose;
    #[pymodule_export]
    use crate::profile::Profile;
    #[pymodule_export]
    use crate::program::run_program;
    #[pymodule_export]
    use crate::rendered::render_place;
    #[pymodule_export]
    use crate::session::Session;
    #[pymodule_export]
    use crate::shares::prepare;
    #[pymodule_export]
    use crate::solvers::{p3p, p5lp_radial, p6lp, p6lp_dual_radial, u4lp, up2p};

    /// Version of the package.
    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");
}

//! The Python package `veiloc`: the libraries with numpy arrays, and the program.
//!
//! The bindings hold no algorithms. Each function converts its arguments, releases the interpreter's lock, calls one
//! library function, and converts the result. Code written in Python (notebooks, hloc's steps) is in `python/veiloc`.
//!
//! - [`errors`]: the libraries' errors as exceptions. [`arrays`], [`camera`], [`pose`], [`options`]: conversions.
//! - [`blocking`], [`worker_threads`]: long calls, Ctrl-C, progress.
//! - [`solvers`], [`estimate`]: poses from correspondences, with PoseLib's calling convention.
//! - [`images`], [`profile`], [`pack`], [`device`], [`sealer`], [`sealed_in`], [`session`]: the device side.
//! - [`map`], [`build_shares`], [`colmap`], [`answer`]: the server side. [`client`]: HTTP client of a service.
//! - [`alignment`]: the map in the frame of odometry or of an AR session.
//! - [`attacks`]: privacy attacks. [`rendered_scene`]: a synthetic scene for experiments. [`program`]: the command
//!   line.
#![forbid(unsafe_code)]

mod alignment;
mod answer;
mod arrays;
mod attacks;
mod blocking;
mod build_shares;
mod camera;
mod client;
mod colmap;
mod device;
mod errors;
mod estimate;
mod images;
mod map;
mod options;
mod pack;
mod pose;
mod posed;
mod profile;
mod program;
mod rendered_scene;
mod sealed_in;
mod sealer;
mod session;
mod solvers;
mod worker_threads;

/// The native part of the package; users import `veiloc`.
#[pyo3::pymodule(gil_used = true)]
mod _native {
    #[pymodule_export]
    use crate::alignment::Alignment;
    #[pymodule_export]
    use crate::answer::{Answer, Doubt};
    #[pymodule_export]
    use crate::attacks::{attack, attack_names, audit};
    #[pymodule_export]
    use crate::build_shares::prepare;
    #[pymodule_export]
    use crate::client::Client;
    #[pymodule_export]
    use crate::colmap::{ColmapModel, cropped_camera, undistort};
    #[pymodule_export]
    use crate::device::{describe_query, device_limits, extract, obfuscate};
    #[pymodule_export]
    use crate::estimate::{
        anchored_lines, estimate_absolute_pose, estimate_absolute_pose_anchored, estimate_absolute_pose_lines,
    };
    #[pymodule_export]
    use crate::images::people_mask;
    #[pymodule_export]
    use crate::map::Map;
    #[pymodule_export]
    use crate::pack::Pack;
    #[pymodule_export]
    use crate::pose::CameraPose;
    #[pymodule_export]
    use crate::posed::read_posed;
    #[pymodule_export]
    use crate::profile::Profile;
    #[pymodule_export]
    use crate::program::run_program;
    #[pymodule_export]
    use crate::rendered_scene::render_room;
    #[pymodule_export]
    use crate::sealer::{Extracted, Sealer, SessionSealer};
    #[pymodule_export]
    use crate::session::Session;
    #[pymodule_export]
    use crate::solvers::{p3p, p5lp_radial, p6lp, p6lp_dual_radial, u4lp, up2p};

    /// Version of the package.
    #[pymodule_export]
    const VERSION: &str = env!("CARGO_PKG_VERSION");
}

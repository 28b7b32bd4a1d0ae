//! Flags of the commands that write a new map.

use veiloc_map::GravityDirection;

use crate::output::targets::OutFile;

/// Gravity of a new map, its output file, and the output format.
#[derive(clap::Args)]
pub(super) struct OutputArgs {
    /// Direction of gravity (down) in the axes of the map: a vector of any length, or an axis (x, -x, y, -y, z, -z). It
    /// is used with the gravity of queries (`seal --gravity`). Default: the direction that the format of `--posed` defines (AR
    /// captures, RealityCapture, OpenSfM with a reference); otherwise not known, and the gravity of queries is not used.
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(super) down: Option<GravityDirection>,
    /// The poses are in metres: lengths in messages and reports are then in m instead of units. Default: if the format of
    /// `--posed` defines it (AR captures, EuRoC, OpenSfM with a reference); otherwise not known.
    #[arg(long)]
    pub(super) metres: bool,
    /// The map file to write.
    #[arg(long, short, value_name = "FILE")]
    pub(super) out: OutFile,
    /// Print facts about the map as JSON.
    #[arg(long)]
    pub(super) json: bool,
}

//! A place with known poses, split into map and queries: what several evaluations start from.

use std::path::PathBuf;

use crate::localization_args::positive;

/// A place with known poses.
#[derive(clap::Args)]
pub(super) struct PlaceArgs {
    /// Folder of a COLMAP model with cameras and poses, text or binary; its points are not used.
    #[arg(long, value_name = "DIR")]
    pub(super) posed: PathBuf,
    /// Folder of the images.
    #[arg(long, value_name = "DIR")]
    pub(super) images: PathBuf,
    /// Names of the images the map is built from, one a line.
    #[arg(long, value_name = "FILE")]
    pub(super) map_list: PathBuf,
    /// Names of the images taken as queries, one a line. `eval scene` seals with the cameras behind the names where
    /// there are any (MODEL W H PARAMS…, as in hloc's query lists), with the model's elsewhere.
    #[arg(long, value_name = "FILE")]
    pub(super) query_list: PathBuf,
}

/// The same where a place may be left out: all of it or nothing.
#[derive(clap::Args)]
pub(super) struct MaybePlaceArgs {
    /// Folder of a COLMAP model with cameras and poses, text or binary; its points are not used.
    #[arg(long, value_name = "DIR", requires_all = ["images", "map_list", "query_list"])]
    posed: Option<PathBuf>,
    /// Folder of the images.
    #[arg(long, value_name = "DIR", requires = "posed")]
    images: Option<PathBuf>,
    /// Names of the images the map is built from, one a line.
    #[arg(long, value_name = "FILE", requires = "posed")]
    map_list: Option<PathBuf>,
    /// Names of the images that are attacked, one a line.
    #[arg(long, value_name = "FILE", requires = "posed")]
    query_list: Option<PathBuf>,
}

impl MaybePlaceArgs {
    pub(super) fn given(&self) -> Option<PlaceArgs> {
        Some(PlaceArgs {
            posed: self.posed.clone()?,
            images: self.images.clone()?,
            map_list: self.map_list.clone()?,
            query_list: self.query_list.clone()?,
        })
    }
}

/// What the devices feel.
#[derive(clap::Args)]
pub(super) struct GravityArgs {
    /// Tell gravity too: the map is told which way is down, and every query is sealed a second time with what an
    /// accelerometer of this standard deviation would feel at its true pose, degrees, at most 16. Default: nothing is told.
    #[arg(long = "gravity", value_name = "SD_DEG", value_parser = positive)]
    pub(super) sd_deg: Option<f64>,
}

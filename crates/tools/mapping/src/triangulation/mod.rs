//! From features of posed images to points: pairs, matches, tracks, triangulation, completion.

pub(crate) mod complete;
pub(crate) mod hold_out;
pub(crate) mod matching;
pub(crate) mod pairs;
pub(crate) mod scene;
pub(crate) mod tracks;
pub(crate) mod triangulate;
pub(crate) mod view;

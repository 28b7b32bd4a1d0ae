//! One pose for one image, or for several images of a device that measured their relative poses: a rig. An image alone
//! is a rig of one frame that is fixed to it.
//!
//! Hypotheses come from each frame's own minimal solver, more often from promising frames, and are transferred to the
//! rig by the odometry (`odometry.rs`); each is scored on all frames (`search.rs`). Local optimisation and the final
//! refinement (`joint.rs`, `polish.rs`) move all poses together: six parameters of the rig and six of each frame that
//! may deviate, constrained by the odometry. Then follow the cameras (`lens.rs`, `cameras.rs`), and what the result is
//! worth (`evidence.rs`, `assess.rs`, `rival.rs`). A frame with too few matches for a pose of its own still contributes,
//! and one that contradicts the others has no influence.

mod assess;
mod cameras;
mod estimate;
mod evidence;
mod focal_lengths;
mod frame;
mod images;
mod joint;
mod lens;
mod odometry;
mod polish;
mod rival;
mod search;

pub use estimate::{FrameEstimate, RigEstimate};
pub use frame::RigFrame;
pub(crate) use images::Images;
pub(crate) use lens::JUMP_HANDICAP;
pub(crate) use polish::FINAL_STEPS;
pub(crate) use search::{LADDER, LADDER_STEPS};

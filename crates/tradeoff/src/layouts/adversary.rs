//! Who attacks, with what, and what they gained.

use std::fmt;

use serde::Serialize;

/// Somebody who reads queries. What they gain is that of the best of their attacks, by [`Adversary::attacks`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Adversary {
    /// Has the query alone, and neighbours predicted by a statistic of descriptors that was learned elsewhere.
    LearnedNeighbours,
    /// The same with a trained network in place of the statistic.
    Network,
    /// Has images of the place, with keypoints.
    NearbyImages,
    /// A server that has found the pose and predicts neighbours; what counts is what its map does not show.
    KnownPose,
    /// The same with the keypoints of all map images.
    KnownPoseAndImages,
    /// A server that has found the poses of several queries of the place, anchors held in each image; counts as the one before.
    SeveralFrames,
    /// Has several seals of one image.
    SeveralSeals,
    /// Is told the true neighbours, which nobody is: nothing protects against it, and it is shown for comparison.
    TrueNeighbours,
}

impl Adversary {
    /// All of them, as the table shows them.
    pub const ALL: [Self; 8] = [
        Self::LearnedNeighbours,
        Self::Network,
        Self::NearbyImages,
        Self::KnownPose,
        Self::KnownPoseAndImages,
        Self::SeveralFrames,
        Self::SeveralSeals,
        Self::TrueNeighbours,
    ];

    /// Whether there is such a one.
    pub const fn is_realistic(self) -> bool {
        !matches!(self, Self::TrueNeighbours)
    }

    /// What documents call it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::LearnedNeighbours => "learned-neighbours",
            Self::Network => "network",
            Self::NearbyImages => "nearby-images",
            Self::KnownPose => "known-pose",
            Self::KnownPoseAndImages => "known-pose-images",
            Self::SeveralFrames => "several-frames",
            Self::SeveralSeals => "several-seals",
            Self::TrueNeighbours => "true-neighbours",
        }
    }

    /// Attacks it tries, by their names in [`veiloc_audit::ATTACKS`].
    pub const fn attacks(self) -> &'static [&'static str] {
        match self {
            // The layout of the graph needs 60 % true neighbours, where descriptors give 5 to 11 (`docs/audit.md`): it is
            // never the best, and takes longest.
            Self::LearnedNeighbours | Self::Network => &["learned-prior", "closed-form-consensus"],
            Self::NearbyImages => &["transfer"],
            Self::KnownPose => &["server-side-points", "iterative"],
            Self::KnownPoseAndImages => &["guided-transfer"],
            Self::SeveralFrames => &["several-frames"],
            Self::SeveralSeals => &["resting-camera"],
            Self::TrueNeighbours => &["closed-form-consensus", "graph"],
        }
    }
}

impl fmt::Display for Adversary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// One adversary on all attacked queries, with the best of their attacks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AdversaryFigures {
    /// Who attacks.
    pub adversary: &'static str,
    /// Whether there is such a one.
    pub realistic: bool,
    /// The best attack.
    pub attack: String,
    /// Frames or seals that it had; absent for attacks on one query.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<usize>,
    /// What it gains over the guess, bits a keypoint.
    pub bits: f64,
    /// Its mean error, pixels.
    pub mean_px: f64,
    /// Its median error, pixels.
    pub median_px: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use veiloc_audit::Attack;

    #[test]
    fn every_attack_of_an_adversary_is_there() {
        for adversary in Adversary::ALL {
            for attack in adversary.attacks() {
                let needs = attack.parse::<Attack>().expect(attack).needs;
                let knows_pose = adversary >= Adversary::KnownPose && adversary <= Adversary::SeveralFrames;
                assert_eq!(needs.pose, knows_pose, "{adversary} {attack}");
            }
        }
    }
}

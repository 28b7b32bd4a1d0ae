//! Adversaries, by their knowledge.

use std::fmt;
use std::str::FromStr;

use serde::Serialize;

use super::super::names::{UnknownName, find};

/// An attacker who reads queries. The adversary's gain is that of its best attack among [`Adversary::attacks`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Adversary {
    /// Holds the query alone, and neighbours predicted by a statistic of descriptors learned on other scenes.
    QueryOnlyStatistic,
    /// The same with a trained network in place of the statistic.
    QueryOnlyNeighbours,
    /// Holds the query alone, and a network trained on other scenes that predicts positions from all its rows.
    QueryOnlyNetwork,
    /// Holds images of the scene with keypoints.
    MapServer,
    /// A server that has found the pose and predicts neighbours; errors are on keypoints without a map point.
    PoseServer,
    /// The same; errors are measured on something in front of the scene that no image of the map shows, such as a
    /// person.
    PoseServerPrivate,
    /// A server that has found the pose, with the keypoints of all map images; errors are measured as for
    /// `pose-server`.
    PoseServerImages,
    /// A server that has found the poses of several queries of the scene, with anchors fixed in each image; errors
    /// are measured as for the previous ones.
    SeveralFrames,
    /// Holds several seals of one image.
    SeveralSeals,
    /// Holds the true neighbours, which no attacker has: no scheme protects against it, and it is shown for
    /// comparison.
    TrueNeighbours,
}

impl Adversary {
    /// All adversaries, in the order of tables.
    pub const ALL: [Self; 10] = [
        Self::QueryOnlyStatistic,
        Self::QueryOnlyNeighbours,
        Self::QueryOnlyNetwork,
        Self::MapServer,
        Self::PoseServer,
        Self::PoseServerPrivate,
        Self::PoseServerImages,
        Self::SeveralFrames,
        Self::SeveralSeals,
        Self::TrueNeighbours,
    ];

    /// Whether such an attacker can exist.
    pub const fn is_realistic(self) -> bool {
        !matches!(self, Self::TrueNeighbours)
    }

    /// Name in documents.
    pub const fn name(self) -> &'static str {
        match self {
            Self::QueryOnlyStatistic => "query-only-statistic",
            Self::QueryOnlyNeighbours => "query-only-neighbours",
            Self::QueryOnlyNetwork => "query-only-network",
            Self::MapServer => "map-server",
            Self::PoseServer => "pose-server",
            Self::PoseServerPrivate => "pose-server-private",
            Self::PoseServerImages => "pose-server-images",
            Self::SeveralFrames => "several-frames",
            Self::SeveralSeals => "several-seals",
            Self::TrueNeighbours => "true-neighbours",
        }
    }

    /// Its knowledge beside the query, in words.
    pub const fn knows(self) -> &'static str {
        match self {
            Self::QueryOnlyStatistic => "a statistic of descriptors, learned on other scenes",
            Self::QueryOnlyNeighbours => "a network that predicts neighbours, trained on other scenes",
            Self::QueryOnlyNetwork => "a network that predicts positions, trained on other scenes",
            Self::MapServer => "images of the map, with keypoints",
            Self::PoseServer => "the map and the query's pose",
            Self::PoseServerPrivate => {
                "the same, measured on a tenth of the keypoints that hides the map, as a person"
            }
            Self::PoseServerImages => "the query's pose and the map's images",
            Self::SeveralFrames => "poses of two or eight queries of the scene",
            Self::SeveralSeals => "eight seals of one image",
            Self::TrueNeighbours => "true neighbours, from an oracle",
        }
    }

    /// Whether it has found the pose.
    pub const fn knows_pose(self) -> bool {
        matches!(
            self,
            Self::PoseServer | Self::PoseServerPrivate | Self::PoseServerImages | Self::SeveralFrames
        )
    }

    /// Whether it needs a map of the scene.
    pub const fn needs_map(self) -> bool {
        self.knows_pose() || matches!(self, Self::MapServer)
    }

    /// Its attacks, by their names in [`crate::attack_evaluation::ATTACKS`].
    pub const fn attacks(self) -> &'static [&'static str] {
        match self {
            // The layout of the graph needs 60 % true neighbours, but descriptors give 5 to 11 % (`docs/results/privacy.md`):
            // it is never the best attack and takes longest; see `slow_attacks`.
            Self::QueryOnlyStatistic | Self::QueryOnlyNeighbours => {
                &["learned-prior", "closed-form-consensus"]
            }
            Self::QueryOnlyNetwork => &["trained-positions"],
            Self::MapServer => &["transfer"],
            Self::PoseServer => &["server-side-points", "iterative"],
            Self::PoseServerPrivate => &["occlusion", "server-side-points", "iterative"],
            Self::PoseServerImages => &["guided-transfer"],
            Self::SeveralFrames => &["several-frames"],
            Self::SeveralSeals => &["static-camera"],
            Self::TrueNeighbours => &["closed-form-consensus", "graph"],
        }
    }

    /// Additional attacks if time does not matter: seconds per image each.
    pub const fn slow_attacks(self) -> &'static [&'static str] {
        match self {
            Self::QueryOnlyStatistic | Self::QueryOnlyNeighbours => {
                &["closed-form", "graph", "graph-near-angles"]
            }
            Self::MapServer => &["transfer-graph"],
            _ => &[],
        }
    }
}

impl fmt::Display for Adversary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// One of [`Adversary::ALL`].
impl FromStr for Adversary {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        find(text, "an adversary", Self::ALL, |adversary| adversary.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attack_evaluation::{Attack, Knowledge};

    #[test]
    fn attacks_of_adversaries_exist() {
        for adversary in Adversary::ALL {
            assert_eq!(adversary.name().parse(), Ok(adversary));
            for attack in adversary.attacks().iter().chain(adversary.slow_attacks()) {
                let attack: Attack = attack.parse().expect(attack);
                let (pose, images) = (attack.needs(Knowledge::Pose), attack.needs(Knowledge::MapImages));
                assert_eq!(pose, adversary.knows_pose(), "{adversary} {attack}");
                assert_eq!(pose || images, adversary.needs_map(), "{adversary} {attack}");
            }
        }
    }
}

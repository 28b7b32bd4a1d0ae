//! Names of the attacks.

use std::fmt;
use std::str::FromStr;

/// An attack that recovers positions of keypoints.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum AttackKind {
    /// The guess that uses no neighbours, keypoints taken to be spread evenly: the zero line of every table.
    Prior,
    /// The same with a density learned from the other images.
    LearnedPrior,
    /// The paper's attack (Eq. 3): infinite lines, answers anywhere.
    ClosedForm,
    /// The same with answers held in the image.
    ClosedFormInImage,
    /// Parts of lines in the image, neighbours of the other anchor only, answers in the image.
    ClosedFormInformed,
    /// [`Self::ClosedFormInformed`] with false neighbours filtered by consensus.
    ClosedFormConsensus,
    /// Positions taken over from the map images that match best, projected on the lines.
    Transfer,
    /// The layout of the whole graph of neighbours.
    Graph,
    /// The same, begun also at the positions of [`Self::Transfer`].
    TransferGraph,
    /// The paper's server-side attack: inliers as points among the neighbours' lines.
    ServerSide,
    /// The same without neighbours' lines where there are points.
    ServerSidePoints,
    /// The paper's iterative server-side attack.
    Iterative,
    /// Map images warped into the query by the flow of the inliers.
    GuidedTransfer,
    /// Several frames of one place, triangulated from their lines.
    SeveralFrames,
}

impl AttackKind {
    /// All of them, weakest first.
    pub const ALL: [Self; 14] = [
        Self::Prior,
        Self::LearnedPrior,
        Self::ClosedForm,
        Self::ClosedFormInImage,
        Self::ClosedFormInformed,
        Self::ClosedFormConsensus,
        Self::Transfer,
        Self::Graph,
        Self::TransferGraph,
        Self::ServerSide,
        Self::ServerSidePoints,
        Self::Iterative,
        Self::GuidedTransfer,
        Self::SeveralFrames,
    ];

    /// Its name in tables and on the command line.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Prior => "prior",
            Self::LearnedPrior => "learned-prior",
            Self::ClosedForm => "closed-form",
            Self::ClosedFormInImage => "closed-form-in-image",
            Self::ClosedFormInformed => "closed-form-informed",
            Self::ClosedFormConsensus => "closed-form-consensus",
            Self::Transfer => "transfer",
            Self::Graph => "graph",
            Self::TransferGraph => "transfer-graph",
            Self::ServerSide => "server-side",
            Self::ServerSidePoints => "server-side-points",
            Self::Iterative => "iterative",
            Self::GuidedTransfer => "guided-transfer",
            Self::SeveralFrames => "several-frames",
        }
    }

    /// Whether it takes positions over from map images.
    pub const fn transfers(self) -> bool {
        matches!(self, Self::Transfer | Self::TransferGraph | Self::GuidedTransfer)
    }

    /// Whether it asks who is a neighbour of whom.
    pub const fn uses_neighbours(self) -> bool {
        !matches!(
            self,
            Self::Prior | Self::LearnedPrior | Self::Transfer | Self::GuidedTransfer | Self::SeveralFrames
        )
    }

    /// Whether it needs a server that has localized the query.
    pub const fn needs_pose(self) -> bool {
        matches!(
            self,
            Self::ServerSide
                | Self::ServerSidePoints
                | Self::Iterative
                | Self::GuidedTransfer
                | Self::SeveralFrames
        )
    }
}

impl fmt::Display for AttackKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// No attack has this name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no attack is called {name:?}; there are {}", AttackKind::ALL.map(AttackKind::name).join(", "))]
pub struct AttackKindError {
    name: String,
}

impl FromStr for AttackKind {
    type Err = AttackKindError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let found = Self::ALL.into_iter().find(|kind| kind.name() == text);
        found.ok_or_else(|| AttackKindError { name: text.to_owned() })
    }
}

//! The table of attacks: name, description, requirements and entry function; one row per attack.

use std::fmt;
use std::str::FromStr;

use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use veiloc_attacks::{
    ClosedFormOptions, GraphOptions, GuidedEstimate, GuidedOptions, KnownImage, LineNeighbours, closed_form,
    graph, guided_transfer, iterative, server_side,
};

use crate::EvalError;
use crate::attack_evaluation::context::{AttackInput, RecoveredPositions};

/// An attack that recovers keypoint positions. The attacks of this crate are in [`ATTACKS`]; a caller adds its own
/// attack as another value of this type in [`crate::attack_evaluation::AttackEvaluation::attacks`].
#[derive(Clone, Copy)]
pub struct Attack {
    /// Name in tables, documents and on the command line; attacks are equal if their names are.
    pub name: &'static str,
    /// Name in sentences.
    pub words: &'static str,
    /// What the attacker must hold beside the sealed query, in words; empty for nothing. Neighbours are described by
    /// [`AttackRequirements::neighbours`].
    pub holds: &'static str,
    /// The same requirements as flags.
    pub needs: AttackRequirements,
    /// Runs the attack. The generator is seeded by image and scheme.
    pub run: fn(&AttackInput<'_>, &mut ChaCha8Rng) -> Result<RecoveredPositions, EvalError>,
}

/// Requirements of an attack beside the sent query.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AttackRequirements {
    /// Neighbour lists.
    pub neighbours: bool,
    /// Predicted neighbours; those with the same anchor are restricted to rows with similar angles. The attack is
    /// skipped for schemes without anchors.
    pub near_angles: bool,
    /// Keypoints of other images of the scene.
    pub other_images: bool,
    /// Map images with descriptors, from which positions are transferred.
    pub map_images: bool,
    /// A server that has localized the query.
    pub pose: bool,
    /// A position network that was trained on other images.
    pub trained: bool,
    /// Several frames of one scene.
    pub frames: bool,
    /// Several seals of one image, or frames of a stationary camera.
    pub seals: bool,
}

impl AttackRequirements {
    /// No requirements: the sealed query alone.
    pub const NOTHING: Self = Self {
        neighbours: false,
        near_angles: false,
        other_images: false,
        map_images: false,
        pose: false,
        trained: false,
        frames: false,
        seals: false,
    };
    /// Neighbour lists only.
    pub const NEIGHBOURS: Self = Self { neighbours: true, ..Self::NOTHING };

    /// Whether keypoints of one image suffice, without descriptors, other images or a server.
    pub const fn one_image(self) -> bool {
        !(self.other_images || self.map_images || self.pose || self.trained || self.frames || self.seals)
    }
}

const OF_SERVER: AttackRequirements = AttackRequirements { pose: true, ..AttackRequirements::NEIGHBOURS };
const SERVER: &str = "a server that has found the pose";

/// All attacks, weakest first.
pub const ATTACKS: [Attack; 18] = [
    Attack::PRIOR,
    Attack {
        name: "learned-prior",
        words: "prior-only baseline with a learned density",
        holds: "keypoints of other images",
        needs: AttackRequirements { other_images: true, ..AttackRequirements::NOTHING },
        run: |a, _| Ok(a.density.expected_positions(a.observations, a.size.0, a.size.1).into()),
    },
    Attack::CLOSED_FORM,
    Attack {
        name: "closed-form-in-image",
        words: "closed form restricted to the image",
        holds: "",
        needs: AttackRequirements::NEIGHBOURS,
        run: |a, _| closed(a, &ClosedFormOptions::in_image()),
    },
    Attack::CLOSED_FORM_INFORMED,
    Attack {
        name: "closed-form-consensus",
        words: "closed form with consensus",
        holds: "",
        needs: AttackRequirements::NEIGHBOURS,
        run: |a, _| closed(a, &ClosedFormOptions::informed().with_consensus(CONSENSUS * f64::from(a.size.0))),
    },
    Attack {
        name: "trained-positions",
        words: "position network on all rows",
        holds: "images of other people for training",
        needs: AttackRequirements { trained: true, ..AttackRequirements::NOTHING },
        run: |a, _| a.by_training(),
    },
    Attack::TRANSFER,
    Attack::GRAPH,
    Attack {
        name: "graph-near-angles",
        words: "layout of the graph of neighbours with similar angles",
        holds: "",
        needs: AttackRequirements { near_angles: true, ..AttackRequirements::NEIGHBOURS },
        run: |a, rng| laid_out(a, &GraphOptions::default(), rng),
    },
    Attack {
        name: "transfer-graph",
        words: "graph layout initialized with positions from a map",
        holds: "other images of the scene",
        needs: AttackRequirements { map_images: true, ..AttackRequirements::NEIGHBOURS },
        run: |a, rng| laid_out(a, &GraphOptions::default().with_initial_positions(a.transferred()), rng),
    },
    Attack {
        name: "server-side",
        words: "the paper's server-side attack",
        holds: SERVER,
        needs: OF_SERVER,
        run: |a, _| served(a, LineNeighbours::Used),
    },
    Attack {
        name: "server-side-points",
        words: "server-side attack with points only",
        holds: SERVER,
        needs: OF_SERVER,
        run: |a, _| served(a, LineNeighbours::Ignored),
    },
    Attack {
        name: "iterative",
        words: "the paper's iterative server-side attack",
        holds: SERVER,
        needs: OF_SERVER,
        run: |a, _| Ok(iterative(a.observations, a.neighbours, a.size.0, a.size.1)?.into()),
    },
    Attack {
        name: "hole",
        words: "rows where the map should have been seen and was not",
        holds: SERVER,
        needs: AttackRequirements { pose: true, ..AttackRequirements::NOTHING },
        run: |a, _| Ok(a.in_the_hole()),
    },
    Attack {
        name: "guided-transfer",
        words: "positions transferred along the flow of inliers",
        holds: "a server that has found the pose, with the keypoints of its map images",
        needs: AttackRequirements { map_images: true, pose: true, ..AttackRequirements::NOTHING },
        run: |a, _| guided(a),
    },
    Attack {
        name: "several-frames",
        words: "triangulation of several frames",
        holds: "several queries of one scene whose poses a server has found",
        needs: AttackRequirements { pose: true, frames: true, ..AttackRequirements::NOTHING },
        run: |a, _| a.by_frames(),
    },
    Attack::RESTING_CAMERA,
];

/// Distance within which neighbours agree, relative to the image's width: 20 px of 640.
const CONSENSUS: f64 = 20.0 / 640.0;

impl Attack {
    /// The prior-only baseline: the best answer for errors in pixels. Bits are relative to the best answer for bits.
    pub const PRIOR: Self = Self {
        name: "prior",
        words: "prior-only baseline, from the single line",
        holds: "",
        needs: AttackRequirements::NOTHING,
        run: |a, _| Ok(a.prior_median().into()),
    };

    /// The paper's attack (Eq. 3): infinite lines, answers anywhere.
    pub const CLOSED_FORM: Self = Self {
        name: "closed-form",
        words: "the paper's attack (closed form)",
        holds: "",
        needs: AttackRequirements::NEIGHBOURS,
        run: |a, _| closed(a, &ClosedFormOptions::default()),
    };

    /// Parts of lines in the image, neighbours of the other anchor only, answers in the image.
    pub const CLOSED_FORM_INFORMED: Self = Self {
        name: "closed-form-informed",
        words: "closed form that knows the scheme",
        holds: "",
        needs: AttackRequirements::NEIGHBOURS,
        run: |a, _| closed(a, &ClosedFormOptions::informed()),
    };

    /// Positions transferred from the best matching map images and projected on the lines.
    pub const TRANSFER: Self = Self {
        name: "transfer",
        words: "positions transferred from a map",
        holds: "other images of the scene, with keypoints and descriptors",
        needs: AttackRequirements { map_images: true, ..AttackRequirements::NOTHING },
        run: |a, _| Ok(a.transferred().into()),
    };

    /// The scatter of the angles of several seals.
    pub const RESTING_CAMERA: Self = Self {
        name: "resting-camera",
        words: "scatter of angles from a stationary camera",
        holds: "several queries of a stationary camera, or of one image",
        needs: AttackRequirements { seals: true, ..AttackRequirements::NOTHING },
        run: |a, _| a.by_scatter(),
    };

    /// The layout of the whole neighbour graph.
    pub const GRAPH: Self = Self {
        name: "graph",
        words: "layout of the neighbour graph",
        holds: "",
        needs: AttackRequirements::NEIGHBOURS,
        run: |a, rng| laid_out(a, &GraphOptions::default(), rng),
    };
}

fn closed(a: &AttackInput<'_>, options: &ClosedFormOptions) -> Result<RecoveredPositions, EvalError> {
    let answers = closed_form(a.observations, a.neighbours, a.size.0, a.size.1, options)?;
    Ok(answers.iter().map(|a| a.pixel).collect::<Vec<_>>().into())
}

fn served(a: &AttackInput<'_>, lines: LineNeighbours) -> Result<RecoveredPositions, EvalError> {
    let answers = server_side(a.observations, a.neighbours, a.size.0, a.size.1, lines)?;
    Ok(answers.iter().map(|a| a.pixel).collect::<Vec<_>>().into())
}

fn laid_out(
    a: &AttackInput<'_>,
    options: &GraphOptions,
    rng: &mut ChaCha8Rng,
) -> Result<RecoveredPositions, EvalError> {
    Ok(graph(a.observations, a.neighbours, a.size.0, a.size.1, options, rng)?.pixels.into())
}

/// Positions from warped map images where the attack accepts them, and positions of the plain transfer otherwise.
fn guided(a: &AttackInput<'_>) -> Result<RecoveredPositions, EvalError> {
    let own = a.images[a.own].descriptors();
    let others = a.images.iter().enumerate().filter(|(i, _)| *i != a.own);
    let map: Vec<KnownImage> = others.map(|(_, p)| p.clone()).collect();
    let found = guided_transfer(own, a.observations, &map, a.size, &GuidedOptions::default())?;
    let plain = a.transferred();
    let accepted = Some(found.iter().map(GuidedEstimate::is_accepted).collect());
    let pixels: Vec<_> = found
        .iter()
        .zip(plain)
        .map(|(g, plain)| g.pixel.filter(|_| g.is_accepted()).unwrap_or(plain))
        .collect();
    Ok(RecoveredPositions { accepted, ..pixels.into() })
}

/// Compares names.
impl PartialEq for Attack {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for Attack {}

/// The prior-only baseline.
impl Default for Attack {
    fn default() -> Self {
        Self::PRIOR
    }
}

impl fmt::Debug for Attack {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Attack({})", self.name)
    }
}

impl fmt::Display for Attack {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

impl Serialize for Attack {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Attack {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Attack".into()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        String::json_schema(generator)
    }
}

/// No attack has this name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{name:?} is not an attack; use one of {}", ATTACKS.map(|a| a.name).join(", "))]
pub struct UnknownAttack {
    name: String,
}

/// One of [`ATTACKS`].
impl FromStr for Attack {
    type Err = UnknownAttack;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let found = ATTACKS.into_iter().find(|attack| attack.name == text);
        found.ok_or_else(|| UnknownAttack { name: text.to_owned() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_parse() {
        for (i, attack) in ATTACKS.iter().enumerate() {
            assert_eq!(attack.name.parse(), Ok(*attack));
            assert!(
                ATTACKS[..i].iter().all(|other| other.name != attack.name && other.words != attack.words)
            );
            // Description and flags must agree.
            let needs = attack.needs;
            let holds = needs.other_images
                || needs.map_images
                || needs.pose
                || needs.trained
                || needs.frames
                || needs.seals;
            assert_eq!(holds, !attack.holds.is_empty(), "{attack}");
        }
        assert!("Graph".parse::<Attack>().is_err_and(|e| e.to_string().contains("several-frames")));
    }
}

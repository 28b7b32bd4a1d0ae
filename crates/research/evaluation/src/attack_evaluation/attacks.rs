//! The table of attacks: name, description, requirements and entry function; one row per attack.

use std::fmt;
use std::str::FromStr;

use serde::Serialize;
use veiloc_attacks::multi_view::{TriangulatedKeypoint, static_camera};
use veiloc_attacks::{
    ClosedFormOptions, GraphOptions, GuidedEstimate, GuidedOptions, LineNeighbours, MapVisibility,
    NeighbourLists, closed_form, graph, guided_transfer, iterative, occlusion, server_side,
};
use veiloc_geometry::Pixel;

use super::context::{AttackContext, RecoveredPositions};
use super::multi_view::by_frames;
use super::names::{UnknownName, find};
use crate::EvalError;

/// An attack that recovers keypoint positions. The attacks of this crate are in [`ATTACKS`]; a caller adds its own
/// attack as another value of this type in [`super::AttackEvaluation::attacks`].
#[derive(Clone, Copy, Debug)]
pub struct Attack {
    /// Name in tables, documents and on the command line; attacks are equal if their names are.
    pub name: &'static str,
    /// Name in sentences.
    pub words: &'static str,
    /// What the attacker must hold beside the sealed query, in words; empty for nothing. Neighbours are described by
    /// [`Knowledge::Neighbours`].
    pub holds: &'static str,
    /// The same as values, by which contradictory options are refused.
    pub needs: &'static [Knowledge],
    /// Runs the attack.
    pub run: fn(&AttackContext<'_>) -> Result<RecoveredPositions, EvalError>,
}

/// What an attack needs beside the sent query.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Knowledge {
    /// Neighbour lists.
    Neighbours,
    /// Predicted neighbours; those with the same anchor are restricted to rows with similar angles. The attack is
    /// skipped for schemes without anchors.
    NearAngles,
    /// Keypoints of other images of the scene.
    OtherImages,
    /// Map images with descriptors, from which positions are transferred.
    MapImages,
    /// A server that has localized the query.
    Pose,
    /// A position network that was trained on other images. The attack is skipped for schemes without a network.
    Network,
    /// Several frames of one scene.
    Frames,
    /// Several seals of one image, or frames of a stationary camera.
    Seals,
}

use Knowledge::{Frames, MapImages, NearAngles, Neighbours, Network, OtherImages, Pose, Seals};

const SERVER: &str = "a server that has found the pose";

/// All attacks, weakest first.
pub const ATTACKS: [Attack; 18] = [
    Attack::PRIOR,
    Attack {
        name: "learned-prior",
        words: "prior-only baseline with a learned density",
        holds: "keypoints of other images",
        needs: &[OtherImages],
        run: |a| Ok(a.density().expected_positions(a.observations(), a.width(), a.height()).into()),
    },
    Attack::CLOSED_FORM,
    Attack {
        name: "closed-form-in-image",
        words: "closed form restricted to the image",
        holds: "",
        needs: &[Neighbours],
        run: |a| closed(a, &ClosedFormOptions::in_image()),
    },
    Attack::CLOSED_FORM_INFORMED,
    Attack {
        name: "closed-form-consensus",
        words: "closed form with consensus",
        holds: "",
        needs: &[Neighbours],
        run: |a| closed(a, &ClosedFormOptions::informed().with_consensus(CONSENSUS * f64::from(a.width()))),
    },
    Attack {
        name: "trained-positions",
        words: "position network on all rows",
        holds: "images of other people for training",
        needs: &[Network],
        run: |a| Ok(a.by_network()?.into()),
    },
    Attack::TRANSFER,
    Attack::GRAPH,
    Attack {
        name: "graph-near-angles",
        words: "layout of the graph of neighbours with similar angles",
        holds: "",
        needs: &[Neighbours, NearAngles],
        run: |a| laid_out(a, &a.neighbours_of_near_angles()?, &GraphOptions::default()),
    },
    Attack {
        name: "transfer-graph",
        words: "graph layout initialized with positions from a map",
        holds: "other images of the scene",
        needs: &[Neighbours, MapImages],
        run: |a| {
            let options = GraphOptions::default().with_initial_positions(a.transferred()?);
            laid_out(a, &a.neighbours()?, &options)
        },
    },
    Attack {
        name: "server-side",
        words: "the paper's server-side attack",
        holds: SERVER,
        needs: &[Pose, Neighbours],
        run: |a| served(a, LineNeighbours::Used),
    },
    Attack {
        name: "server-side-points",
        words: "server-side attack with points only",
        holds: SERVER,
        needs: &[Pose, Neighbours],
        run: |a| served(a, LineNeighbours::Ignored),
    },
    Attack {
        name: "iterative",
        words: "the paper's iterative server-side attack",
        holds: SERVER,
        needs: &[Pose, Neighbours],
        run: |a| Ok(iterative(a.observations(), &a.neighbours()?, a.width(), a.height())?.into()),
    },
    Attack {
        name: "occlusion",
        words: "rows where the map should have been seen and was not",
        holds: SERVER,
        needs: &[Pose],
        run: |a| Ok(in_the_hole(a)),
    },
    Attack {
        name: "guided-transfer",
        words: "positions transferred along the flow of inliers",
        holds: "a server that has found the pose, with the keypoints of its map images",
        needs: &[MapImages, Pose],
        run: guided,
    },
    Attack {
        name: "several-frames",
        words: "triangulation of several frames",
        holds: "several queries of one scene whose poses a server has found",
        needs: &[Pose, Frames],
        run: several_frames,
    },
    Attack::RESTING_CAMERA,
];

/// Distance within which neighbours agree, relative to the image's width: 20 px of 640.
const CONSENSUS: f64 = 20.0 / 640.0;

impl Attack {
    /// Whether the attack needs this.
    pub fn needs(&self, what: Knowledge) -> bool {
        self.needs.contains(&what)
    }

    /// Whether the attack combines several frames or seals.
    pub(super) fn combines_several(&self) -> bool {
        self.needs(Frames) || self.needs(Seals)
    }

    /// Whether keypoints of one image suffice, without descriptors, other images or a server.
    pub(super) fn needs_one_image(&self) -> bool {
        self.needs.iter().all(|what| matches!(what, Neighbours | NearAngles))
    }

    /// The prior-only baseline: the best answer for errors in pixels. Bits are relative to the best answer for bits.
    pub const PRIOR: Self = Self {
        name: "prior",
        words: "prior-only baseline, from the single line",
        holds: "",
        needs: &[],
        run: |a| Ok(a.prior_median().into()),
    };

    /// The paper's attack (Eq. 3): infinite lines, answers anywhere.
    pub const CLOSED_FORM: Self = Self {
        name: "closed-form",
        words: "the paper's attack (closed form)",
        holds: "",
        needs: &[Neighbours],
        run: |a| closed(a, &ClosedFormOptions::default()),
    };

    /// Parts of lines in the image, neighbours of the other anchor only, answers in the image.
    pub const CLOSED_FORM_INFORMED: Self = Self {
        name: "closed-form-informed",
        words: "closed form that knows the scheme",
        holds: "",
        needs: &[Neighbours],
        run: |a| closed(a, &ClosedFormOptions::informed()),
    };

    /// Positions transferred from the best matching map images and projected on the lines.
    pub const TRANSFER: Self = Self {
        name: "transfer",
        words: "positions transferred from a map",
        holds: "other images of the scene, with keypoints and descriptors",
        needs: &[MapImages],
        run: |a| Ok(a.transferred()?.into()),
    };

    /// The scatter of the angles of several seals.
    pub const RESTING_CAMERA: Self = Self {
        name: "static-camera",
        words: "scatter of angles from a stationary camera",
        holds: "several queries of a stationary camera, or of one image",
        needs: &[Seals],
        run: by_scatter,
    };

    /// The layout of the whole neighbour graph.
    pub const GRAPH: Self = Self {
        name: "graph",
        words: "layout of the neighbour graph",
        holds: "",
        needs: &[Neighbours],
        run: |a| laid_out(a, &a.neighbours()?, &GraphOptions::default()),
    };
}

fn closed(a: &AttackContext<'_>, options: &ClosedFormOptions) -> Result<RecoveredPositions, EvalError> {
    let answers = closed_form(a.observations(), &a.neighbours()?, a.width(), a.height(), options)?;
    Ok(answers.iter().map(|a| a.pixel).collect::<Vec<_>>().into())
}

fn served(a: &AttackContext<'_>, lines: LineNeighbours) -> Result<RecoveredPositions, EvalError> {
    let answers = server_side(a.observations(), &a.neighbours()?, a.width(), a.height(), lines)?;
    Ok(answers.iter().map(|a| a.pixel).collect::<Vec<_>>().into())
}

fn laid_out(
    a: &AttackContext<'_>,
    neighbours: &NeighbourLists,
    options: &GraphOptions,
) -> Result<RecoveredPositions, EvalError> {
    Ok(graph(a.observations(), neighbours, a.width(), a.height(), options, &mut a.rng())?.pixels.into())
}

/// Positions from warped map images where the attack accepts them, and positions of the plain transfer otherwise.
fn guided(a: &AttackContext<'_>) -> Result<RecoveredPositions, EvalError> {
    let size = (a.width(), a.height());
    let found = guided_transfer(
        a.descriptors()?,
        a.observations(),
        &a.map_images()?,
        size,
        &GuidedOptions::default(),
    )?;
    let accepted: Vec<bool> = found.iter().map(GuidedEstimate::is_accepted).collect();
    let pixels = found.iter().map(|g| g.pixel.filter(|_| g.is_accepted()));
    Ok(RecoveredPositions { accepted: Some(accepted), ..or_else(pixels, a.transferred()?) })
}

/// Positions from the scatter of several seals' angles.
fn by_scatter(a: &AttackContext<'_>) -> Result<RecoveredPositions, EvalError> {
    let found = static_camera(a.observations(), &a.seals()?, (a.width(), a.height()), &a.angle_codes())?;
    Ok(or_else(found.iter().map(|s| s.pixel), a.prior_only()))
}

/// Positions from several frames.
fn several_frames(a: &AttackContext<'_>) -> Result<RecoveredPositions, EvalError> {
    let prior = a.prior_only();
    let Some(found) = by_frames(a)? else {
        let accepted = Some(vec![false; prior.len()]);
        return Ok(RecoveredPositions { accepted, ..prior.into() });
    };
    let accepted = Some(found.iter().map(TriangulatedKeypoint::is_accepted).collect());
    Ok(RecoveredPositions { accepted, ..or_else(found.iter().map(|s| s.pixel), prior) })
}

/// Positions where the map should have been seen and was not; the prior-only baseline without a pose.
fn in_the_hole(a: &AttackContext<'_>) -> RecoveredPositions {
    let map = a.pose().map_or_else(MapVisibility::default, |pose| MapVisibility {
        expected: pose.expected.clone(),
        confirmed: pose.known.iter().map(|(at, _)| *at).collect(),
    });
    let found = occlusion(a.observations(), &map, a.width(), a.height());
    RecoveredPositions { hiding: Some(found.inside), ..found.pixels.into() }
}

/// The answers of an attack, and others where it has none.
fn or_else(answers: impl Iterator<Item = Option<Pixel>>, others: Vec<Pixel>) -> RecoveredPositions {
    answers.zip(others).map(|(answer, other)| answer.unwrap_or(other)).collect::<Vec<_>>().into()
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

/// One of [`ATTACKS`].
impl FromStr for Attack {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        find(text, "an attack", ATTACKS, |attack| attack.name)
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
            // The description and the values must agree.
            assert_eq!(attack.needs_one_image(), attack.holds.is_empty(), "{attack}");
        }
        assert!("Graph".parse::<Attack>().is_err_and(|e| e.to_string().contains("several-frames")));
    }
}

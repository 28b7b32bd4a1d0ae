//! `veiloc attack`: recovers keypoints from obfuscated queries, with every attack under every scheme.

use std::path::PathBuf;

use veiloc_evaluation::attack_evaluation::{
    Attack, AttackEvaluation, FrameChoice, MeasuredKeypoints, NeighbourSource, PrivateRegion,
    ServerKnowledge, attacks_table, evaluate_attacks,
};
use veiloc_protocol::{AngleBits, Scheme};

use crate::args::json_args::JsonArgs;
use crate::commands::device_args::PackArgs;
use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::stages::Stages;
use crate::output::ui::Ui;

/// Recover keypoints from obfuscated queries, with every attack under every scheme.
///
/// Reads the keypoints of images, obfuscates them as a device would, attacks them, and reports the distance between
/// recovered and true keypoints. The first row of each scheme is the prior-only baseline, which uses no neighbours:
/// only the gain over it counts as the success of an attack.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Keypoints of images, one JSON object per line, plain or gzipped.
    #[arg(value_name = "KEYPOINTS", required_unless_present = "synthetic")]
    files: Vec<PathBuf>,
    /// Also attack N uniformly distributed keypoints in 640 x 480 pixels (the paper's figure: 1500). Default: none.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    synthetic: Option<u32>,
    /// Attack only the first N images of each file. Default: all.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,
    /// Attacks: prior, learned-prior, closed-form (the paper's), closed-form-in-image, closed-form-informed,
    /// closed-form-consensus, trained-positions (--positions), transfer (positions of matches in the file's other
    /// images), graph, transfer-graph. Attacks of a server that knows the pose (--server-matches): server-side and
    /// iterative (the paper's), server-side-points, occlusion (what stands in front of the map), guided-transfer, several-frames. Attack with several sealed queries
    /// of the same image: static-camera.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "prior,learned-prior,closed-form,closed-form-informed,graph",
        value_name = "ATTACK,…"
    )]
    attacks: Vec<Attack>,
    #[command(flatten)]
    adversary: AdversaryArgs,
    #[command(flatten)]
    json: JsonArgs,
}

/// The attacked keypoints and the attacker's knowledge.
#[derive(clap::Args)]
pub(super) struct AdversaryArgs {
    /// Schemes to attack; `dcl:random` has the paper's anchors, one of them at random for each keypoint, as ray clouds do
    /// (only in tables: no query can carry it).
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "random-lines,coordinate-permutation,dcl",
        value_name = "SCHEME,…",
        value_parser = Scheme::of_tables
    )]
    schemes: Vec<Scheme>,
    #[command(flatten)]
    pack: PackArgs,
    /// Source of the neighbour lists.
    #[arg(long, value_enum, default_value = "oracle")]
    neighbours: NeighbourListSource,
    /// Keypoints with descriptors to train the neighbour predictor on; attacked images among them are left out.
    #[arg(long, value_name = "FILE", required_if_eq("neighbours", "predicted"))]
    train: Vec<PathBuf>,
    /// Description (.toml) of a neighbour network, as exported by research/train.
    #[arg(long, value_name = "FILE", required_if_eq("neighbours", "network"))]
    model: Option<PathBuf>,
    /// Descriptions (.toml) of position networks for trained-positions, as exported by research/train, one per scheme.
    /// Schemes without a network are not attacked by trained-positions. Default: none.
    #[arg(long, num_args = 1.., value_name = "FILE")]
    positions: Vec<PathBuf>,
    /// Neighbours per keypoint.
    #[arg(short, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1000))]
    k: u32,
    /// Replace this percentage of the neighbours by random keypoints; several values give a curve.
    #[arg(long, value_delimiter = ',', default_value = "0", value_name = "PERCENT,…", value_parser = percent)]
    corrupt: Vec<f64>,
    /// Matches of the same images with a map (problems.jsonl): the attacker is a server that has localized the images
    /// and knows the positions of their inliers. Errors are measured on the other keypoints. May be given several
    /// times.
    #[arg(long, value_name = "PROBLEMS")]
    server_matches: Vec<PathBuf>,
    /// With --server-matches: this percentage of the keypoints lies in a compact region that the map does not contain,
    /// for example a person in the image. Errors are measured on that region. Default: no such region.
    #[arg(long, value_name = "PERCENT", requires = "server_matches", value_parser = percent)]
    private: Option<f64>,
    /// With --server-matches: as --private, with the region that is black in a mask of each attacked image:
    /// `door/3.jpg.png` for `door/3.jpg`. Default: no such region.
    #[arg(long, value_name = "DIR", requires = "server_matches", conflicts_with = "private")]
    private_masks: Option<PathBuf>,
    /// With --server-matches: this percentage of the image lies in random regions the shape of persons whose descriptors
    /// the device sends rotated, so that they match nothing. Errors are not measured there.
    #[arg(long, default_value_t = 0.0, value_name = "PERCENT", requires = "server_matches", value_parser = percent)]
    rotated_regions: f64,
    /// With --server-matches: the keypoints on which errors are measured.
    #[arg(
        long,
        value_enum,
        default_value = "hidden",
        requires = "server_matches",
        conflicts_with_all = ["private", "private_masks"]
    )]
    measure: MeasureArg,
    /// Number of frames that several-frames combines, including the attacked one, and number of sealed queries for
    /// static-camera; several values give a curve.
    #[arg(long, value_delimiter = ',', default_value = "3", value_name = "N,…")]
    frames: Vec<usize>,
    /// Selection of the frames that several-frames combines.
    #[arg(long, value_enum, default_value = "turn")]
    frame_selection: FrameSelection,
    /// For static-camera: standard deviation of the keypoint detector from frame to frame along each axis, pixels; 0
    /// for several sealed queries of one image.
    #[arg(long, default_value_t = 0.0, value_name = "PX", value_parser = noise)]
    static_noise: f64,
    /// Bits of a line's angle, as set in a profile.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u8).range(6..=16))]
    angle_bits: u8,
    /// Seed of every random choice; equal seeds give equal results.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
}

/// Source of the neighbour lists.
#[derive(Clone, Copy, clap::ValueEnum)]
enum NeighbourListSource {
    /// An oracle that knows the true positions: the worst case.
    Oracle,
    /// Co-occurrence statistics of descriptors, learned from the images of `--train`.
    Predicted,
    /// The network of `--model`.
    Network,
    /// A server that uses the other images of the file as its map.
    Transferred,
}

/// Selection of the frames of a scene that are combined.
#[derive(Clone, Copy, clap::ValueEnum)]
enum FrameSelection {
    /// Frames whose lines give the most information on positions: large rotation, small translation.
    Turn,
    /// Frames with the most matches.
    Nearest,
}

/// Keypoints on which errors are measured.
#[derive(Clone, Copy, clap::ValueEnum)]
enum MeasureArg {
    /// Keypoints whose position the server does not know from its map.
    Hidden,
    /// All keypoints; the server knows the position of the matched ones.
    All,
    /// Keypoints whose position the server knows from its map; the attack does not get these positions.
    Matched,
}

impl AdversaryArgs {
    /// Lowers the arguments to an attack evaluation without data.
    pub(super) fn evaluation(&self, attacks: &[Attack]) -> Result<AttackEvaluation, Failure> {
        if let Some(scheme) = self.schemes.iter().find(|s| !s.hides_positions()) {
            return Err(Failure::with_help(
                format!("{scheme} hides no positions, so there is nothing to attack"),
                "give schemes that hide positions: random-lines, coordinate-permutation, dcl",
            ));
        }
        Ok(AttackEvaluation {
            schemes: self.schemes.clone(),
            attacks: attacks.to_vec(),
            place: self.pack.place()?,
            neighbours: match self.neighbours {
                NeighbourListSource::Oracle => NeighbourSource::Oracle,
                NeighbourListSource::Predicted => NeighbourSource::Predicted { train: self.train.clone() },
                // The parser requires a model for this source.
                NeighbourListSource::Network => {
                    NeighbourSource::Network { model: self.model.clone().unwrap_or_default() }
                }
                NeighbourListSource::Transferred => NeighbourSource::Transferred,
            },
            positions: self.positions.clone(),
            k: self.k as usize,
            corrupt: self.corrupt.clone(),
            server: (!self.server_matches.is_empty()).then(|| ServerKnowledge {
                problems: self.server_matches.clone(),
                map_problems: Vec::new(),
                private: match (&self.private_masks, self.private) {
                    (Some(folder), _) => Some(PrivateRegion::Masks(folder.clone())),
                    (None, percent) => percent.map(|percent| PrivateRegion::Share(percent / 100.0)),
                },
                rotated: self.rotated_regions / 100.0,
                measured: match self.measure {
                    MeasureArg::Hidden => MeasuredKeypoints::Hidden,
                    MeasureArg::All => MeasuredKeypoints::All,
                    MeasureArg::Matched => MeasuredKeypoints::Matched,
                },
            }),
            frames: self.frames.clone(),
            choice: match self.frame_selection {
                FrameSelection::Turn => FrameChoice::Turn,
                FrameSelection::Nearest => FrameChoice::Nearest,
            },
            static_noise_px: self.static_noise,
            angle_bits: AngleBits::new(self.angle_bits)?,
            seed: self.seed,
            ..AttackEvaluation::default()
        })
    }
}

/// Runs `veiloc attack`.
///
/// # Errors
/// An input cannot be read, the inputs contradict each other, or results cannot be written.
pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    let evaluation = AttackEvaluation {
        files: args.files.clone(),
        synthetic: args.synthetic.unwrap_or(0) as usize,
        images: args.limit.map(|n| n as usize),
        ..args.adversary.evaluation(&args.attacks)?
    };
    let document = evaluate_attacks(&evaluation, "Attacking", &Stages::new(ui), &mut |_| {})?;
    args.json.print(&attacks_table(&document), &document, ui)?;
    Ok(Exit::Success)
}

/// Parses a standard deviation in pixels.
fn noise(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if (0.0..=20.0).contains(&value) {
        Ok(value)
    } else {
        Err("a number from 0 to 20 is expected".to_owned())
    }
}

/// Parses a number from 0 to 100.
fn percent(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is not a number"))?;
    if (0.0..=100.0).contains(&value) {
        Ok(value)
    } else {
        Err("a number from 0 to 100 is expected".to_owned())
    }
}

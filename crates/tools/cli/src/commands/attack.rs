//! `veiloc attack`: keypoints recovered from what is sent, by every attack under every scheme.

use std::path::PathBuf;

use veiloc_evaluation::audit::{
    Attack, AttackEvaluation, FrameChoice, Measured, NeighbourSource, ServerKnowledge, attacks_table,
    evaluate_attacks,
};
use veiloc_protocol::{AngleBits, Scheme};

use crate::exit::{Exit, Failure, Outcome};
use crate::json_args::JsonArgs;
use crate::ui::Ui;

/// Recover keypoints from what is sent, by every attack under every scheme.
///
/// Reads keypoints of images, obfuscates them as a device would, attacks them, and says how far the recovered
/// keypoints are from the true ones. The first row of a scheme is the guess that uses no neighbours: an attack
/// counts only by what it gains over that.
#[derive(clap::Args)]
pub(crate) struct Args {
    /// Keypoints of images, one JSON object a line, plain or gzipped.
    #[arg(value_name = "KEYPOINTS", required_unless_present = "synthetic")]
    files: Vec<PathBuf>,
    /// Attack N evenly spread keypoints in 640 x 480 pixels too (the paper's figure: 1500). Default: none.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    synthetic: Option<u32>,
    /// Attack the first N images of each file only. Default: all.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    images: Option<u32>,
    /// Attacks: prior, learned-prior, closed-form (the paper's), closed-form-in-image, closed-form-informed,
    /// closed-form-consensus, trained-positions (--positions), transfer (positions of matches in the file's other images), graph, transfer-graph; and
    /// of a server that knows the pose (--known): server-side and iterative (the paper's), server-side-points,
    /// guided-transfer, several-frames; and of whoever has several seals of one image: resting-camera.
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

/// What is attacked with what knowledge, whoever reports it.
#[derive(clap::Args)]
pub(super) struct AdversaryArgs {
    /// Schemes to attack.
    #[arg(
        long,
        value_delimiter = ',',
        default_value = "random-lines,coordinate-permutation,dcl",
        value_name = "SCHEME,…"
    )]
    schemes: Vec<Scheme>,
    /// Who tells which keypoints are neighbours.
    #[arg(long, value_enum, default_value = "oracle")]
    neighbours: Source,
    /// Keypoints with descriptors that teach the predictor of neighbours; attacked images among them are left out.
    #[arg(long, value_name = "FILE", required_if_eq("neighbours", "predicted"))]
    train: Vec<PathBuf>,
    /// Description (.toml) of a network of neighbours, as research/train exports it.
    #[arg(long, value_name = "FILE", required_if_eq("neighbours", "network"))]
    model: Option<PathBuf>,
    /// Descriptions (.toml) of networks of positions, as research/train exports them, one a scheme, for trained-positions.
    /// Schemes without one are attacked without. Default: none.
    #[arg(long, num_args = 1.., value_name = "FILE")]
    positions: Vec<PathBuf>,
    /// Neighbours a keypoint.
    #[arg(short, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=1000))]
    k: u32,
    /// Replace this many percent of the neighbours by keypoints drawn at random; several for a curve.
    #[arg(long, value_delimiter = ',', default_value = "0", value_name = "PERCENT,…", value_parser = percent)]
    corrupt: Vec<f64>,
    /// Matches of the same images with a map (problems.jsonl): the attacker is a server that has localized them, and
    /// knows the positions of its inliers. Errors are of the other keypoints. May be given several times.
    #[arg(long, value_name = "PROBLEMS")]
    known: Vec<PathBuf>,
    /// With --known: this percentage of the keypoints lies in a compact region that the map does not have, as a person
    /// in the image. Errors are of that region. Default: no such region.
    #[arg(long, value_name = "PERCENT", requires = "known", value_parser = percent)]
    private: Option<f64>,
    /// With --known: on which keypoints errors are measured.
    #[arg(long, value_enum, default_value = "hidden", requires = "known", conflicts_with = "private")]
    measure: MeasureOn,
    /// How many frames of a file several-frames puts together, the attacked one included, and how many seals
    /// resting-camera; several for a curve.
    #[arg(long, value_delimiter = ',', default_value = "3", value_name = "N,…")]
    frames: Vec<usize>,
    /// Which frames of the file several-frames puts together.
    #[arg(long, value_enum, default_value = "turn")]
    choose: Choose,
    /// Of resting-camera: how much the detector errs from frame to frame, standard deviation along each axis, pixels;
    /// 0 for seals of one image.
    #[arg(long, default_value_t = 0.0, value_name = "PX", value_parser = noise)]
    resting_noise: f64,
    /// Bits of a line's angle, as a profile sets them.
    #[arg(long, default_value_t = 12, value_parser = clap::value_parser!(u8).range(6..=16))]
    angle_bits: u8,
    /// Seed of every random choice; equal seeds give equal results.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
}

/// Who tells which keypoints are neighbours.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Source {
    /// One who knows the true positions: the worst case.
    Oracle,
    /// A statistic of which descriptors occur side by side, learned from the images of `--train`.
    Predicted,
    /// The network of `--model`.
    Network,
    /// A server that has the other images of the file for a map.
    Transferred,
}

/// Which frames of a place are put together.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Choose {
    /// Those whose lines tell most of positions: turned much, moved little.
    Turn,
    /// Those with most matches.
    Nearest,
}

/// On which keypoints errors are measured.
#[derive(Clone, Copy, clap::ValueEnum)]
enum MeasureOn {
    /// Those whose position the server does not know from its map.
    Hidden,
    /// All, the known ones with the positions the server has for them.
    All,
    /// Those whose position the server knows from its map, which the attack is not told.
    Matched,
}

impl AdversaryArgs {
    /// Lowers the arguments to an evaluation of these attacks that has no data yet.
    pub(super) fn evaluation(&self, attacks: &[Attack]) -> Result<AttackEvaluation, Failure> {
        if let Some(scheme) = self.schemes.iter().find(|s| !s.hides_positions()) {
            return Err(Failure::with_help(
                format!("{scheme} hides nothing that could be attacked"),
                "name schemes that hide positions: random-lines, coordinate-permutation, dcl",
            ));
        }
        Ok(AttackEvaluation {
            files: Vec::new(),
            synthetic: 0,
            images: None,
            schemes: self.schemes.clone(),
            attacks: attacks.to_vec(),
            neighbours: match self.neighbours {
                Source::Oracle => NeighbourSource::Oracle,
                Source::Predicted => NeighbourSource::Predicted { train: self.train.clone() },
                // The parser asks for a model where there must be one.
                Source::Network => NeighbourSource::Network { model: self.model.clone().unwrap_or_default() },
                Source::Transferred => NeighbourSource::Transferred,
            },
            positions: self.positions.clone(),
            k: self.k as usize,
            corrupt: self.corrupt.clone(),
            server: (!self.known.is_empty()).then(|| ServerKnowledge {
                problems: self.known.clone(),
                private: self.private.map(|percent| percent / 100.0),
                measured: match self.measure {
                    MeasureOn::Hidden => Measured::Hidden,
                    MeasureOn::All => Measured::All,
                    MeasureOn::Matched => Measured::Matched,
                },
            }),
            frames: self.frames.clone(),
            choice: match self.choose {
                Choose::Turn => FrameChoice::Turn,
                Choose::Nearest => FrameChoice::Nearest,
            },
            resting_noise_px: self.resting_noise,
            angle_bits: AngleBits::new(self.angle_bits)?,
            seed: self.seed,
        })
    }
}

/// Runs `veiloc attack`.
///
/// # Errors
/// What was given cannot be read, or makes no sense together; results cannot be written.
pub(crate) fn run(args: &Args, ui: &Ui) -> Outcome {
    let evaluation = AttackEvaluation {
        files: args.files.clone(),
        synthetic: args.synthetic.unwrap_or(0) as usize,
        images: args.images.map(|n| n as usize),
        ..args.adversary.evaluation(&args.attacks)?
    };
    let stage = ui.stage("Attacking", 0);
    let document = evaluate_attacks(&evaluation, |done, total| stage.reach(done as u64, total as u64))?;
    stage.finish();
    args.json.print(&attacks_table(&document), &document, ui)?;
    Ok(Exit::Success)
}

/// A number of pixels that noise may have.
fn noise(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is no number"))?;
    if (0.0..=20.0).contains(&value) {
        Ok(value)
    } else {
        Err("a number from 0 to 20 is expected".to_owned())
    }
}

/// A number from 0 to 100.
fn percent(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("{text:?} is no number"))?;
    if (0.0..=100.0).contains(&value) {
        Ok(value)
    } else {
        Err("a number from 0 to 100 is expected".to_owned())
    }
}

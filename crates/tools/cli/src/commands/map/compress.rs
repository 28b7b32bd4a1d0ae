//! `veiloc map compress`: a map made small.

use std::path::PathBuf;

use veiloc_map::{MapFile, MapModel};
use veiloc_mapping::calibration::{SelfTestOptions, is_testable, self_test_compressed, smallest_within};
use veiloc_mapping::{CompressOptions, Compression, compress};

use super::info::Told;
use crate::exit::{Failure, Outcome};
use crate::stages::Stages;
use crate::ui::Ui;

/// Make a map small: a tenth of the bytes, at hardly any loss.
///
/// Keeps the points that help most to localize, and a few descriptors of each; all other keypoints go. Images, poses and the
/// profile stay, so that queries sealed for the whole map fit the small one. Images can neither join nor leave it: keep the
/// whole map, change that, and compress it again.
#[derive(clap::Args)]
pub(crate) struct CompressArgs {
    /// The map.
    map: PathBuf,
    /// How many times smaller the file is to be. Default: 10.
    #[arg(long, value_name = "TIMES", conflicts_with_all = ["size", "recall_loss"])]
    ratio: Option<f64>,
    /// Largest size of the file, MB. Default: what --ratio says.
    #[arg(long, value_name = "MB", conflicts_with = "recall_loss")]
    size: Option<f64>,
    /// Find the smallest map whose self-test falls at most so many percentage points short of the whole map's. Takes some
    /// self-tests. Default: what --ratio says.
    #[arg(long, value_name = "POINTS")]
    recall_loss: Option<f64>,
    /// Most descriptors that a point keeps.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    descriptors: u32,
    /// Do not test the small map with the images of the whole one: no recall, and covariances calibrated by those of other
    /// maps. Default: it is tested.
    #[arg(long, conflicts_with = "recall_loss")]
    no_self_test: bool,
    /// The map file to write.
    #[arg(long, short, value_name = "FILE")]
    out: PathBuf,
    /// Print facts about the map as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &CompressArgs, ui: &Ui) -> Outcome {
    let file = MapFile::open(&args.map)?;
    let whole = file.to_model();
    let bytes = args.bytes(file.byte_count())?;
    drop(file);
    let options = CompressOptions::new(bytes).with_descriptors(args.descriptors as usize);
    let stages = Stages::new(ui);
    let small = match args.recall_loss {
        None => {
            let mut small = compress(&whole, &options, &stages)?;
            if !args.no_self_test && is_testable(&whole) {
                let test = self_test_compressed(&whole, &small, &SelfTestOptions::default(), &stages)?;
                small.model.self_test = Some(test);
            }
            small
        }
        Some(points) => args.smallest(&whole, points, &options, &stages)?,
    };
    veiloc_map::write(&small.model, &args.out)?;
    Told { json: args.json, ..Told::default() }.info(&args.out, ui)
}

impl CompressArgs {
    /// Bytes that the small map may have.
    fn bytes(&self, whole: u64) -> Result<u64, Failure> {
        let above_zero = |value: f64, option: &str| {
            if value > 0.0 && value.is_finite() {
                return Ok(value);
            }
            let wrong = format!("{option} is {value}");
            Err(Failure::with_help(wrong, "give a finite number above 0"))
        };
        match self.size {
            Some(megabytes) => Ok((above_zero(megabytes, "--size")? * 1e6) as u64),
            None => Ok((whole as f64 / above_zero(self.ratio.unwrap_or(10.0), "--ratio")?) as u64),
        }
    }

    fn smallest(
        &self,
        whole: &MapModel,
        points: f64,
        options: &CompressOptions,
        stages: &Stages<'_>,
    ) -> Result<Compression, Failure> {
        if !(0.0..=100.0).contains(&points) {
            let wrong = format!("--recall-loss is {points}");
            return Err(Failure::with_help(wrong, "give percentage points from 0 to 100"));
        }
        if !is_testable(whole) {
            let wrong = format!("{}: this map cannot test itself", self.map.display());
            return Err(Failure::with_help(wrong, "give --ratio or --size in the place of --recall-loss"));
        }
        let found = smallest_within(whole, points, options, &SelfTestOptions::default(), stages)?;
        found.ok_or_else(|| {
            let wrong = format!("{}: every smaller map loses more than {points} points", self.map.display());
            Failure::with_help(wrong, "allow more with --recall-loss, or choose with --ratio")
        })
    }
}

//! `veiloc map compress`: compresses a map.

use std::path::PathBuf;

use veiloc_map::{MapFile, MapModel};
use veiloc_mapping::calibration::{SelfTestOptions, is_testable, self_test_compressed, smallest_within};
use veiloc_mapping::{CompressOptions, CompressedMap, compress};

use super::edit::{check_anchors, write_with_anchors};
use super::facts::InfoOutput;
use super::self_test::FinishArgs;
use crate::output::exit::{Failure, Outcome};
use crate::output::stages::Stages;
use crate::output::targets::OutFile;
use crate::output::ui::Ui;

/// Compress a map: a tenth of the bytes with almost no loss.
///
/// Keeps the points that contribute most to localization, with a few descriptors each, and removes all other keypoints.
/// Images, poses and the profile stay, so queries sealed for the whole map are valid for the compressed one. Images
/// cannot be added to a compressed map or removed from it: keep the whole map, change it, and compress it again.
#[derive(clap::Args)]
pub(crate) struct CompressArgs {
    /// The map.
    map: PathBuf,
    /// Ratio of the file sizes before and after. Default: 10.
    #[arg(long, value_name = "TIMES", conflicts_with_all = ["size", "recall_loss"])]
    ratio: Option<f64>,
    /// Maximum size of the file, MB. Default: what --ratio says.
    #[arg(long, value_name = "MB", conflicts_with = "recall_loss")]
    size: Option<f64>,
    /// Find the smallest map whose self-test recall is at most this many percentage points below the whole map's. Runs
    /// several self-tests. Default: what --ratio says.
    #[arg(long, value_name = "POINTS", conflicts_with = "no_self_test")]
    recall_loss: Option<f64>,
    /// Maximum number of descriptors per point.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    descriptors: u32,
    #[command(flatten)]
    finish: FinishArgs,
    /// The map file to write.
    #[arg(long, short, value_name = "FILE")]
    out: OutFile,
    /// Print facts about the map as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(args: &CompressArgs, ui: &Ui) -> Outcome {
    let file = MapFile::open(&args.map)?;
    let whole = file.to_model();
    let bytes = args.bytes(file.byte_count())?;
    drop(file);
    check_anchors(&args.map, &args.out, &whole)?;
    let options = CompressOptions::new(bytes).with_descriptors(args.descriptors as usize);
    let stages = Stages::new(ui);
    let small = match args.recall_loss {
        None => {
            let mut small = compress(&whole, &options, &stages)?;
            if args.finish.is_tested() && is_testable(&whole) {
                let test = self_test_compressed(&whole, &small, &SelfTestOptions::default(), &stages)?;
                small.model.self_test = Some(test);
            }
            small
        }
        Some(points) => args.smallest(&whole, points, &options, &stages)?,
    };
    args.finish.check_compressed(&whole, &small.model, &args.out, ui)?;
    let write = || veiloc_map::write(&small.model, &args.out);
    write_with_anchors(&args.map, &args.out, &small.model, |_| Ok(()), write)?;
    InfoOutput { json: args.json, ..InfoOutput::default() }.print(&args.out, ui)
}

impl CompressArgs {
    /// Returns the maximum size of the compressed map in bytes.
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
    ) -> Result<CompressedMap, Failure> {
        if !(0.0..=100.0).contains(&points) {
            let wrong = format!("--recall-loss is {points}");
            return Err(Failure::with_help(wrong, "give percentage points from 0 to 100"));
        }
        if !is_testable(whole) {
            let wrong = format!("{}: this map has no self-test", self.map.display());
            return Err(Failure::with_help(wrong, "give --ratio or --size instead of --recall-loss"));
        }
        let found = smallest_within(whole, points, options, &SelfTestOptions::default(), stages)?;
        found.ok_or_else(|| {
            let wrong = format!(
                "{}: every smaller map loses more than {points} percentage points",
                self.map.display()
            );
            Failure::with_help(wrong, "allow more with --recall-loss, or give --ratio")
        })
    }
}

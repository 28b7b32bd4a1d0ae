//! `veiloc eval dataset`: every scene of a published data set, one after another.

mod adversaries;
mod options;
mod run;
mod submission;

use veiloc_datasets::{aachen, cambridge, seven_scenes};

use crate::output::exit::{Failure, Outcome};
use crate::output::ui::Ui;
use options::{DataSet, PoseKind};
use run::{evaluate, refused};
use submission::write_submissions;

pub(crate) use options::Args;

pub(super) fn run(args: &Args, ui: &Ui) -> Outcome {
    if let Some(option) = args.of_another_data_set() {
        return Err(Failure::with_help(
            format!("--{option} is no option of {}", args.data_set.name()),
            "see `veiloc eval dataset --help` for the data set of each option",
        ));
    }
    args.estimator()?;
    let (root, missing) = (&args.root, args.missing());
    let scenes = |all: &dyn Fn() -> Result<Vec<String>, _>, without: &[&str]| -> Result<_, Failure> {
        let excluded = |name: &String| match &args.exclude {
            Some(names) => names.contains(name),
            // The names that the paper leaves out can still be requested.
            None => args.scenes.is_empty() && without.contains(&name.as_str()),
        };
        let mut names = if args.scenes.is_empty() { all().map_err(refused)? } else { args.scenes.clone() };
        names.retain(|name| !excluded(name));
        Ok(names)
    };
    let (document, exit) = match args.data_set {
        DataSet::SevenScenes => {
            let truth = match (args.poses, &args.pseudo_ground_truth) {
                (Some(PoseKind::Depth), _) => seven_scenes::PoseSource::Depth,
                (_, Some(folder)) => seven_scenes::PoseSource::Sfm(folder.clone()),
                (_, None) => seven_scenes::PoseSource::sfm_beside(root),
            };
            let names = scenes(&|| seven_scenes::scenes(root), &[])?;
            evaluate(&names, &|name| seven_scenes::read_scene(root, name, &truth, missing), args, ui)?
        }
        DataSet::Cambridge => {
            let names = scenes(&|| cambridge::scenes(root), &cambridge::EXCLUDED_SCENES)?;
            let camera = args.camera.as_ref();
            evaluate(&names, &|name| cambridge::read_scene(root, name, camera, missing), args, ui)?
        }
        DataSet::Aachen | DataSet::AachenV1_1 => {
            let is_first = args.data_set == DataSet::Aachen;
            let version = if is_first { aachen::AachenVersion::V1 } else { aachen::AachenVersion::V1_1 };
            let truth = args.truth.as_deref().map(aachen::read_poses).transpose().map_err(refused)?;
            let all = || aachen::CONDITIONS.map(str::to_owned).to_vec();
            let conditions = args.conditions.clone().unwrap_or_else(all);
            let read = |_: &str| aachen::read(root, version, &conditions, truth.as_ref(), missing);
            evaluate(&[version.name().to_owned()], &read, args, ui)?
        }
    };
    if let Some(path) = &args.submission {
        write_submissions(path, &document, ui)?;
    }
    Ok(exit)
}

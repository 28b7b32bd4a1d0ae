//! Result files in the format of visuallocalization.net.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use veiloc_evaluation::results::DataSetEvaluation;
use veiloc_evaluation::results::pose_lines::{base_name, hloc_line};

use crate::output::exit::Failure;
use crate::output::files;
use crate::output::ui::Ui;

/// Writes one file per scheme: for each query with a pose the file name, quaternion and translation, world to camera.
/// Queries without a pose are left out; the site counts them as not localized.
pub(super) fn write_submissions(path: &Path, document: &DataSetEvaluation, ui: &Ui) -> Result<(), Failure> {
    let mut by_scheme: BTreeMap<&str, String> = BTreeMap::new();
    let mut without: BTreeMap<&str, usize> = BTreeMap::new();
    for query in &document.queries {
        let result = &query.result;
        let text = by_scheme.entry(&result.scheme).or_default();
        let Some(pose) = &result.cam_from_world else {
            *without.entry(&result.scheme).or_default() += 1;
            continue;
        };
        let line = hloc_line(base_name(&result.name), pose).ok_or_else(|| {
            Failure::with_help(
                format!(
                    "{}: its name has white space, which separates the fields of a result file",
                    result.name
                ),
                "give the image another name",
            )
        })?;
        text.push_str(&line);
        text.push('\n');
    }
    let one = by_scheme.len() == 1;
    for (scheme, text) in &by_scheme {
        let path = if one { path.to_owned() } else { named(path, scheme) };
        files::write(&path, text.as_bytes())?;
        let lost = without.get(scheme).map_or(String::new(), |n| format!("; {n} queries have no pose"));
        ui.info(format!("{}: {} poses{lost}", path.display(), text.lines().count()));
    }
    Ok(())
}

/// `results.txt` becomes `results-dcl.txt`.
fn named(path: &Path, scheme: &str) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().map_or(String::new(), |ending| format!(".{}", ending.to_string_lossy()));
    let scheme = scheme.replace([':', '/', '='], "-");
    path.with_file_name(format!("{stem}-{scheme}{ending}"))
}

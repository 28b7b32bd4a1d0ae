//! Poses as lines of the text files that other programs read.

use veiloc_geometry::CameraFromWorld;

use crate::results::PoseDocument;

/// `name qw qx qy qz tx ty tz`, world to camera: a line of hloc's result files, and, with [`base_name`], of files for
/// visuallocalization.net. `None` for a name with white space, which a reader could not separate from the numbers.
pub fn hloc_line(name: &str, pose: &PoseDocument) -> Option<String> {
    if name.is_empty() || name.contains(char::is_whitespace) {
        return None;
    }
    let [w, x, y, z] = pose.q;
    let [tx, ty, tz] = pose.t;
    Some(format!("{name} {w} {x} {y} {z} {tx} {ty} {tz}"))
}

/// The file's name: the part after the last `/`.
pub fn base_name(name: &str) -> &str {
    name.rsplit('/').next().unwrap_or(name)
}

/// `stamp tx ty tz qx qy qz qw`, camera to world: a line of a TUM trajectory.
pub fn tum_line(stamp: &str, cam_from_world: &CameraFromWorld) -> String {
    let world_from_cam = cam_from_world.inverse();
    let (t, [w, x, y, z]) = (world_from_cam.translation(), world_from_cam.quaternion());
    format!("{stamp} {} {} {} {x} {y} {z} {w}", t.x, t.y, t.z)
}

/// Time stamps of a TUM trajectory: the seconds in the file names if every file is named by a distinct number, as in
/// TUM's data sets (`rgb/1305031102.175304.png`), else the index in the list, from 0.
pub fn tum_stamps<'a>(names: impl IntoIterator<Item = &'a str> + Clone) -> Vec<String> {
    let times: Option<Vec<String>> = names.clone().into_iter().map(seconds).collect();
    let distinct = |times: &Vec<String>| {
        let mut values: Vec<f64> = times.iter().filter_map(|t| t.parse().ok()).collect();
        values.sort_by(f64::total_cmp);
        values.windows(2).all(|pair| pair[0] < pair[1])
    };
    times
        .filter(distinct)
        .unwrap_or_else(|| names.into_iter().enumerate().map(|(index, _)| index.to_string()).collect())
}

/// The number in a file name, with a decimal point: integers are frame counts.
fn seconds(name: &str) -> Option<String> {
    let base = base_name(name);
    let stem = base.rsplit_once('.').map_or(base, |(stem, _)| stem);
    let (whole, part) = stem.split_once('.')?;
    let digits = |text: &str| !text.is_empty() && text.chars().all(|c| c.is_ascii_digit());
    (digits(whole) && digits(part)).then(|| stem.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quarter turn about z, with the camera at (1, 2, 3).
    fn pose() -> CameraFromWorld {
        let half = 0.5_f64.sqrt();
        CameraFromWorld::from_quaternion([half, 0.0, 0.0, half], [2.0, -1.0, -3.0]).expect("a rotation")
    }

    fn numbers(line: &str) -> Vec<f64> {
        line.split(' ').skip(1).map(|word| word.parse().expect("a number")).collect()
    }

    fn close(a: &[f64], b: &[f64]) -> bool {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12)
    }

    #[test]
    fn hloc_lines_are_cam_from_world_and_tum_lines_world_from_cam() {
        let half = 0.5_f64.sqrt();
        let line = hloc_line("query/a.jpg", &PoseDocument::of(&pose())).expect("a line");
        assert!(line.starts_with("query/a.jpg "), "{line}");
        assert!(close(&numbers(&line), &[half, 0.0, 0.0, half, 2.0, -1.0, -3.0]), "{line}");
        let line = tum_line("12.5", &pose());
        assert!(line.starts_with("12.5 "), "{line}");
        assert!(close(&numbers(&line), &[1.0, 2.0, 3.0, 0.0, 0.0, -half, half]), "{line}");
        assert_eq!(base_name("query/night/IMG_1.jpg"), "IMG_1.jpg");
    }

    #[test]
    fn names_with_white_space_are_refused() {
        for name in ["", "a b.jpg", "a\tb.jpg"] {
            assert_eq!(hloc_line(name, &PoseDocument::of(&pose())), None, "{name:?}");
        }
    }

    #[test]
    fn time_stamps_come_from_distinct_numeric_names() {
        let stamps = |names: &[&str]| tum_stamps(names.iter().copied());
        assert_eq!(
            stamps(&["rgb/1305031102.175304.png", "rgb/1305031102.211214.png"]),
            ["1305031102.175304", "1305031102.211214"]
        );
        assert_eq!(stamps(&["a/1.5.png", "b/1.50.png"]), ["0", "1"], "one time twice");
        assert_eq!(stamps(&["1.5.png", "frame-000001.color.png"]), ["0", "1"]);
        assert_eq!(stamps(&["1.png", "2.png"]), ["0", "1"], "numbers of frames");
    }
}

//! Poses as lines of the text files that other programs read.

use std::collections::BTreeSet;
use std::fmt;

use veiloc_geometry::CameraFromWorld;

use veiloc_protocol::PoseDocument;

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

/// Time stamps of a TUM trajectory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TumStamps {
    /// One per query, as text: exact, where a float would lose nanoseconds.
    pub stamps: Vec<String>,
    /// Where they come from.
    pub source: TimeSource,
}

/// Where time stamps come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TimeSource {
    /// The seconds in the file names, with a decimal point, as in TUM's data sets (`rgb/1305031102.175304.png`).
    Seconds,
    /// The microseconds in the file names: 16 digits.
    Microseconds,
    /// The nanoseconds in the file names, as in EuRoC and ROS: 17 to 19 digits (`1403636579763555584.png`).
    Nanoseconds,
    /// The index in the list, from 0.
    Index,
}

impl fmt::Display for TimeSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Seconds => "times are the seconds in the names",
            Self::Microseconds => "times are the microseconds in the names, in seconds",
            Self::Nanoseconds => "times are the nanoseconds in the names, in seconds",
            Self::Index => {
                "times are the numbers 0, 1, 2, … in the order of the queries, because the names are no distinct times of \
                 one unit"
            }
        })
    }
}

/// Time stamps of a TUM trajectory: the times in the file names if every file is named by a distinct one and all have the
/// same unit, else the index in the list, from 0.
pub fn tum_stamps<'a>(names: impl IntoIterator<Item = &'a str> + Clone) -> TumStamps {
    let times: Option<Vec<(TimeSource, String)>> = names.clone().into_iter().map(time_in).collect();
    let sound = |times: &Vec<(TimeSource, String)>| {
        let plain = |stamp: &'_ str| stamp.trim_matches('0').to_owned();
        let distinct: BTreeSet<String> = times.iter().map(|(_, stamp)| plain(stamp)).collect();
        distinct.len() == times.len() && times.windows(2).all(|pair| pair[0].0 == pair[1].0)
    };
    match times.filter(sound) {
        Some(times) if !times.is_empty() => {
            TumStamps { source: times[0].0, stamps: times.into_iter().map(|(_, stamp)| stamp).collect() }
        }
        _ => TumStamps {
            stamps: names.into_iter().enumerate().map(|(index, _)| index.to_string()).collect(),
            source: TimeSource::Index,
        },
    }
}

/// The time in a file name, in seconds. Integers of fewer digits are frame counts.
fn time_in(name: &str) -> Option<(TimeSource, String)> {
    let base = base_name(name);
    let digits = |text: &str| !text.is_empty() && text.chars().all(|c| c.is_ascii_digit());
    let is_seconds =
        |text: &str| text.split_once('.').is_some_and(|(whole, part)| digits(whole) && digits(part));
    // The name of a sealed query has no extension, so what follows its point is the fraction.
    let has_extension = base.rsplit_once('.').is_some_and(|(_, ending)| !digits(ending));
    let stem = base.rsplit_once('.').filter(|_| has_extension).map_or(base, |(stem, _)| stem);
    if is_seconds(stem) {
        return Some((TimeSource::Seconds, stem.to_owned()));
    }
    let (source, decimals) = match stem.len() {
        16 => (TimeSource::Microseconds, 6),
        17..=19 => (TimeSource::Nanoseconds, 9),
        _ => return None,
    };
    let (whole, part) = stem.split_at_checked(stem.len() - decimals).filter(|_| digits(stem))?;
    Some((source, format!("{whole}.{part}")))
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
        let found = |names: &[&str]| tum_stamps(names.iter().copied());
        let stamps = |names: &[&str]| found(names).stamps;
        assert_eq!(
            stamps(&["rgb/1305031102.175304.png", "rgb/1305031102.211214.png"]),
            ["1305031102.175304", "1305031102.211214"]
        );
        assert_eq!(stamps(&["a/1.5.png", "b/1.50.png"]), ["0", "1"], "one time twice");
        assert_eq!(stamps(&["1.5.png", "frame-000001.color.png"]), ["0", "1"]);
        assert_eq!(stamps(&["1.png", "2.png"]), ["0", "1"], "numbers of frames");
        assert_eq!(
            stamps(&["rgb/1305031102.175304", "rgb/2.5"]),
            ["1305031102.175304", "2.5"],
            "sealed queries"
        );
        let nanoseconds = found(&["cam0/1403636579763555584.jpg", "cam0/1403636579813555456"]);
        assert_eq!(nanoseconds.stamps, ["1403636579.763555584", "1403636579.813555456"]);
        assert_eq!(nanoseconds.source, TimeSource::Nanoseconds);
        let microseconds = found(&["1403636579763555.png", "1403636579813555.png"]);
        assert_eq!(microseconds.stamps, ["1403636579.763555", "1403636579.813555"]);
        assert_eq!(microseconds.source, TimeSource::Microseconds);
        for others in
            [["1403636579763555.png", "1403636579813555456.png"], ["140363657976355x.png", "1.5.png"]]
        {
            assert_eq!(found(&others).source, TimeSource::Index, "{others:?}");
        }
    }
}

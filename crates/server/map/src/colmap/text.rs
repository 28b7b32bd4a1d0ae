//! COLMAP's text files.

use std::fs;
use std::path::{Path, PathBuf};
use std::str::{FromStr, SplitAsciiWhitespace};

use veiloc_geometry::frames::Rigid3;
use veiloc_geometry::{CameraFromWorld, Intrinsics, IntrinsicsError, Pixel, Point3};

use super::binary::NO_POINT;
use super::parts::{Parts, ReadCamera};
use super::records::{ColmapImage, ColmapPoint, ColmapPoint2d};
use super::rigs::{ColmapFrame, ColmapRig, ColmapRigs, ColmapSensor, SensorKind};
use crate::error::{FilePosition, MapError};
use crate::text::text_of;

/// Reads the cameras and images of the model in a folder.
pub(super) fn read(dir: &Path) -> Result<Parts, MapError> {
    let mut parts = Parts::default();
    parts.sort_cameras(cameras(&Text::open(dir.join("cameras.txt"))?)?);
    parts.sort_images(images(&Text::open(dir.join("images.txt"))?)?);
    Ok(parts)
}

/// Reads the points of the model in a folder.
pub(super) fn read_points(dir: &Path) -> Result<Vec<ColmapPoint>, MapError> {
    points(&Text::open(dir.join("points3D.txt"))?)
}

/// A text file and its name.
struct Text {
    path: PathBuf,
    content: String,
}

impl Text {
    fn open(path: PathBuf) -> Result<Self, MapError> {
        let bytes = fs::read(&path).map_err(MapError::io(&path))?;
        match text_of(bytes) {
            Ok(content) => Ok(Self { path, content }),
            Err(error) => {
                let valid = &error.as_bytes()[..error.utf8_error().valid_up_to()];
                let line = valid.split(|b| *b == b'\n').count();
                let reason = "not UTF-8 text; save the model as text again, or as binary".to_owned();
                Err(MapError::Colmap { path, position: FilePosition::Line(line), reason })
            }
        }
    }

    /// Lines with their numbers, from 1.
    fn lines(&self) -> impl Iterator<Item = (usize, &str)> {
        self.content.lines().enumerate().map(|(i, line)| (i + 1, line.trim()))
    }

    /// Lines with content, split into fields.
    fn records(&self) -> impl Iterator<Item = Fields<'_>> {
        self.lines()
            .filter(|(_, text)| !text.is_empty() && !text.starts_with('#'))
            .map(|(line, text)| Fields { text: self, line, rest: text.split_ascii_whitespace() })
    }

    fn refuse(&self, line: usize, reason: impl Into<String>) -> MapError {
        MapError::Colmap {
            path: self.path.clone(),
            position: FilePosition::Line(line),
            reason: reason.into(),
        }
    }
}

/// The fields of one line, taken from left to right.
struct Fields<'a> {
    text: &'a Text,
    line: usize,
    rest: SplitAsciiWhitespace<'a>,
}

impl<'a> Fields<'a> {
    fn word(&mut self, what: &str) -> Result<&'a str, MapError> {
        self.rest
            .next()
            .ok_or_else(|| self.text.refuse(self.line, format!("the line ends before its {what}")))
    }

    fn number<T: FromStr>(&mut self, what: &str) -> Result<T, MapError> {
        let word = self.word(what)?;
        word.parse().map_err(|_| {
            let word: String = word.chars().take(40).collect();
            self.text.refuse(self.line, format!("{what} is {word:?}, which is not such a number"))
        })
    }

    /// A side of an image, pixels.
    fn side(&mut self, what: &str) -> Result<u32, MapError> {
        let side: f64 = self.number(what)?;
        if side.fract() == 0.0 && (0.0..=f64::from(u32::MAX)).contains(&side) {
            return Ok(side as u32);
        }
        Err(self.text.refuse(self.line, format!("{what} is {side}, which is not a number of pixels")))
    }

    fn numbers<const N: usize>(&mut self, what: &str) -> Result<[f64; N], MapError> {
        let mut all = [0.0; N];
        for value in &mut all {
            *value = self.number(what)?;
        }
        Ok(all)
    }

    fn sensor(&mut self) -> Result<ColmapSensor, MapError> {
        let name = self.word("SENSOR_TYPE")?;
        let kind = SensorKind::of_name(name).ok_or_else(|| {
            self.refuse(format!("SENSOR_TYPE is {name:?}; CAMERA and IMU are known; remove the sensor"))
        })?;
        Ok(ColmapSensor { kind, id: self.number("SENSOR_ID")? })
    }

    fn pose<Out, In>(&mut self) -> Result<Rigid3<Out, In>, MapError> {
        let (rotation, translation) = (self.numbers("quaternion")?, self.numbers("translation")?);
        Rigid3::from_quaternion(rotation, translation).ok_or_else(|| {
            self.refuse(
                "the pose is not finite or its quaternion is zero; correct it, or remove the frame or sensor",
            )
        })
    }

    /// Refuses more words.
    fn end(&mut self) -> Result<(), MapError> {
        match self.rest.next() {
            None => Ok(()),
            Some(word) => Err(self.refuse(format!("{word:?} follows the last field of the line"))),
        }
    }

    fn refuse(&self, reason: impl Into<String>) -> MapError {
        self.text.refuse(self.line, reason)
    }
}

/// Reads the rigs and frames of the model in a folder.
pub(super) fn read_rigs(dir: &Path) -> Result<ColmapRigs, MapError> {
    Ok(ColmapRigs {
        rigs: rigs(&Text::open(dir.join("rigs.txt"))?)?,
        frames: frames(&Text::open(dir.join("frames.txt"))?)?,
    })
}

/// `RIG_ID NUM_SENSORS REF_SENSOR_TYPE REF_SENSOR_ID SENSORS[] as (SENSOR_TYPE SENSOR_ID HAS_POSE [QW QX QY QZ TX TY TZ])`
fn rigs(text: &Text) -> Result<Vec<ColmapRig>, MapError> {
    text.records()
        .map(|mut fields| {
            let id = fields.number("RIG_ID")?;
            let count: u32 = fields.number("NUM_SENSORS")?;
            let reference = if count > 0 { Some(fields.sensor()?) } else { None };
            let mut sensors = Vec::new();
            for _ in 1..count {
                let sensor = fields.sensor()?;
                let has_pose: u8 = fields.number("HAS_POSE")?;
                sensors.push((sensor, if has_pose == 0 { None } else { Some(fields.pose()?) }));
            }
            fields.end()?;
            Ok(ColmapRig { id, reference, sensors })
        })
        .collect()
}

/// `FRAME_ID RIG_ID RIG_FROM_WORLD[QW QX QY QZ TX TY TZ] NUM_DATA_IDS DATA_IDS[] as (SENSOR_TYPE SENSOR_ID DATA_ID)`
fn frames(text: &Text) -> Result<Vec<ColmapFrame>, MapError> {
    text.records()
        .map(|mut fields| {
            let (id, rig_id) = (fields.number("FRAME_ID")?, fields.number("RIG_ID")?);
            let rig_from_world = fields.pose()?;
            let count: u32 = fields.number("NUM_DATA_IDS")?;
            let data = (0..count)
                .map(|_| Ok((fields.sensor()?, fields.number("DATA_ID")?)))
                .collect::<Result<_, MapError>>()?;
            fields.end()?;
            Ok(ColmapFrame { id, rig_id, rig_from_world, data })
        })
        .collect()
}

/// `CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]`
fn cameras(text: &Text) -> Result<Vec<ReadCamera>, MapError> {
    text.records()
        .map(|mut fields| {
            let id = fields.number("CAMERA_ID")?;
            let model = fields.word("MODEL")?;
            let (width, height) = (fields.side("WIDTH")?, fields.side("HEIGHT")?);
            let mut params = Vec::new();
            while let Some(word) = fields.rest.next() {
                let number = word.parse::<f64>();
                params.push(number.map_err(|_| fields.refuse("a parameter of the camera is not a number"))?);
            }
            let camera = Intrinsics::new(model, width, height, &params).map_err(|e| match e {
                IntrinsicsError::Panorama => fields.refuse(e.to_string()),
                e => fields.refuse(format!("{e}; undistort the images with COLMAP, or correct the line")),
            });
            Ok((id, camera))
        })
        .collect()
}

/// `IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`, and on the next line `POINTS2D[] as (X Y POINT3D_ID)`, which is
/// present even if empty.
fn images(text: &Text) -> Result<Vec<Result<ColmapImage, MapError>>, MapError> {
    let mut images = Vec::new();
    let mut lines = text.lines();
    while let Some((line, content)) = lines.next() {
        if content.is_empty() || content.starts_with('#') {
            continue;
        }
        let mut fields = Fields { text, line, rest: content.split_ascii_whitespace() };
        let id = fields.number("IMAGE_ID")?;
        let rotation = fields.numbers::<4>("quaternion")?;
        let translation = fields.numbers::<3>("translation")?;
        let camera_id = fields.number("CAMERA_ID")?;
        fields.word("NAME")?;
        let name = after_fields(content, 9).to_owned();
        let pose = CameraFromWorld::from_quaternion(rotation, translation).ok_or_else(|| {
            fields.refuse(
                "the pose is not finite or its quaternion is zero; remove the image or give it a pose",
            )
        });
        let points2d = match lines.next() {
            Some((line, content)) => points2d(text, line, content)?,
            None => Vec::new(),
        };
        images.push(pose.map(|cam_from_world| ColmapImage { id, name, camera_id, cam_from_world, points2d }));
    }
    Ok(images)
}

/// The rest of a line after `count` fields; a name may contain spaces.
fn after_fields(line: &str, count: usize) -> &str {
    let mut rest = line;
    for _ in 0..count {
        rest = rest.trim_start().trim_start_matches(|c: char| !c.is_ascii_whitespace());
    }
    rest.trim()
}

fn points2d(text: &Text, line: usize, content: &str) -> Result<Vec<ColmapPoint2d>, MapError> {
    let mut fields = Fields { text, line, rest: content.split_ascii_whitespace() };
    let count = fields.rest.clone().count();
    if !count.is_multiple_of(3) {
        return Err(fields.refuse(format!(
            "{count} numbers where 2D points (X, Y, POINT3D_ID) should be; every image takes two lines, the second may \
             be empty but not missing"
        )));
    }
    (0..count / 3)
        .map(|_| {
            let [u, v] = fields.numbers("2D point")?;
            let point: i128 = fields.number("POINT3D_ID")?;
            if !(-1..=i128::from(NO_POINT)).contains(&point) {
                return Err(fields.refuse(format!("POINT3D_ID is {point}; it is -1 or the id of a point")));
            }
            let point = u64::try_from(point).ok().filter(|id| *id != NO_POINT);
            Ok(ColmapPoint2d { pixel: Pixel::new(u, v), point })
        })
        .collect()
}

/// `POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID POINT2D_IDX)`
fn points(text: &Text) -> Result<Vec<ColmapPoint>, MapError> {
    text.records()
        .map(|mut fields| {
            let id = fields.number("POINT3D_ID")?;
            let [x, y, z] = fields.numbers("position")?;
            let mut color = [0; 3];
            for channel in &mut color {
                // Some programs write it with decimals.
                let value: f64 = fields.number("color")?;
                if !(0.0..=255.0).contains(&value) {
                    return Err(fields.refuse(format!("color is {value}; it is from 0 to 255")));
                }
                *channel = value.round() as u8;
            }
            let error = fields.number("ERROR")?;
            let count = fields.rest.clone().count();
            if !count.is_multiple_of(2) {
                return Err(fields.refuse("the track is cut: it is made of pairs IMAGE_ID POINT2D_IDX"));
            }
            let track = (0..count / 2)
                .map(|_| Ok((fields.number("IMAGE_ID")?, fields.number("POINT2D_IDX")?)))
                .collect::<Result<_, MapError>>()?;
            Ok(ColmapPoint { id, position: Point3::new(x, y, z), color, error, track })
        })
        .collect()
}

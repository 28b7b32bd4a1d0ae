//! COLMAP's binary files: a count, then little-endian records.

use std::fs;
use std::path::{Path, PathBuf};

use veiloc_geometry::frames::Rigid3;
use veiloc_geometry::{CameraFromWorld, CameraModel, Intrinsics, IntrinsicsError, Pixel, Point3};

use super::parts::{Parts, ReadCamera};
use super::records::{ColmapImage, ColmapPoint, ColmapPoint2d};
use super::rigs::{ColmapFrame, ColmapRig, ColmapRigs, ColmapSensor, SensorKind};
use crate::error::{FilePosition, MapError};

/// COLMAP's `kInvalidPoint3DId`: the keypoint observes no point.
pub(super) const NO_POINT: u64 = u64::MAX;

/// Reads the cameras and images of the model in a folder.
pub(super) fn read(dir: &Path) -> Result<Parts, MapError> {
    let mut parts = Parts::default();
    parts.sort_cameras(Bytes::open(dir.join("cameras.bin"))?.records(24, camera)?);
    parts.sort_images(Bytes::open(dir.join("images.bin"))?.records(73, image)?);
    Ok(parts)
}

/// Reads the points of the model in a folder.
pub(super) fn read_points(dir: &Path) -> Result<Vec<ColmapPoint>, MapError> {
    Bytes::open(dir.join("points3D.bin"))?.records(51, point)
}

/// Reads the rigs and frames of the model in a folder.
pub(super) fn read_rigs(dir: &Path) -> Result<ColmapRigs, MapError> {
    Ok(ColmapRigs {
        rigs: Bytes::open(dir.join("rigs.bin"))?.records(8, rig)?,
        frames: Bytes::open(dir.join("frames.bin"))?.records(68, frame)?,
    })
}

/// A file that is read sequentially.
struct Bytes {
    path: PathBuf,
    content: Vec<u8>,
    at: usize,
}

impl Bytes {
    fn open(path: PathBuf) -> Result<Self, MapError> {
        let content = fs::read(&path).map_err(MapError::io(&path))?;
        Ok(Self { path, content, at: 0 })
    }

    /// Reads the whole file: a count, and that many records of at least `smallest` bytes each.
    fn records<T>(
        mut self,
        smallest: usize,
        read: impl Fn(&mut Self) -> Result<T, MapError>,
    ) -> Result<Vec<T>, MapError> {
        let count = self.count("records", smallest)?;
        let all = (0..count).map(|_| read(&mut self)).collect::<Result<Vec<_>, _>>()?;
        match self.content.len() - self.at {
            0 => Ok(all),
            more => Err(self
                .refuse(format!("{more} bytes follow the last of {count} records; export the model again"))),
        }
    }

    /// Reads a count of elements of at least `smallest` bytes each. The count is checked against the length of the
    /// file before memory is allocated.
    fn count(&mut self, what: &str, smallest: usize) -> Result<usize, MapError> {
        let at = self.at;
        let count = self.u64()?;
        let left = self.content.len() - self.at;
        if count > (left / smallest) as u64 {
            self.at = at;
            return Err(self.refuse(format!(
                "{count} {what} are announced, but only {left} bytes follow: the file is cut short or not COLMAP's; \
                 export the model again"
            )));
        }
        Ok(count as usize)
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], MapError> {
        let bytes = self.content.get(self.at..).and_then(|rest| rest.first_chunk::<N>()).copied();
        let bytes =
            bytes.ok_or_else(|| self.refuse("the file ends within a record; export the model again"))?;
        self.at += N;
        Ok(bytes)
    }

    fn u32(&mut self) -> Result<u32, MapError> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, MapError> {
        self.take().map(u64::from_le_bytes)
    }

    fn f64s<const N: usize>(&mut self) -> Result<[f64; N], MapError> {
        let mut all = [0.0; N];
        for value in &mut all {
            *value = f64::from_le_bytes(self.take()?);
        }
        Ok(all)
    }

    fn sensor(&mut self) -> Result<ColmapSensor, MapError> {
        let number = self.u32()?;
        let kind = SensorKind::of_number(number)
            .ok_or_else(|| self.refuse(format!("{number} is no kind of a sensor; export the model again")))?;
        Ok(ColmapSensor { kind, id: self.u32()? })
    }

    fn pose<Out, In>(&mut self) -> Result<Rigid3<Out, In>, MapError> {
        let (rotation, translation) = (self.f64s()?, self.f64s()?);
        Rigid3::from_quaternion(rotation, translation).ok_or_else(|| {
            self.refuse(
                "the pose is not finite or its quaternion is zero; correct it, or remove the frame or sensor",
            )
        })
    }

    fn refuse(&self, reason: impl Into<String>) -> MapError {
        MapError::Colmap {
            path: self.path.clone(),
            position: FilePosition::Byte(self.at),
            reason: reason.into(),
        }
    }
}

/// `id: u32, sensors: u32, reference: (kind: i32, id: u32), (kind: i32, id: u32, has pose: u8, pose: f64[7] or nothing)[]`
fn rig(bytes: &mut Bytes) -> Result<ColmapRig, MapError> {
    let (id, count) = (bytes.u32()?, bytes.u32()?);
    let reference = if count > 0 { Some(bytes.sensor()?) } else { None };
    let mut sensors = Vec::new();
    for _ in 1..count {
        let sensor = bytes.sensor()?;
        let [has_pose] = bytes.take()?;
        sensors.push((sensor, if has_pose == 0 { None } else { Some(bytes.pose()?) }));
    }
    Ok(ColmapRig { id, reference, sensors })
}

/// `id: u32, rig: u32, pose: f64[7], data: u32, (kind: i32, id: u32, image: u64)[]`
fn frame(bytes: &mut Bytes) -> Result<ColmapFrame, MapError> {
    let (id, rig_id) = (bytes.u32()?, bytes.u32()?);
    let rig_from_world = bytes.pose()?;
    let mut data = Vec::new();
    for _ in 0..bytes.u32()? {
        data.push((bytes.sensor()?, bytes.u64()?));
    }
    Ok(ColmapFrame { id, rig_id, rig_from_world, data })
}

/// `id: u32, model: i32, width: u64, height: u64, params: f64[]`
fn camera(bytes: &mut Bytes) -> Result<ReadCamera, MapError> {
    let id = bytes.u32()?;
    let model = bytes.u32()? as i32;
    let Some((name, count)) = CameraModel::from_colmap_id(model) else {
        let error = CameraModel::unsupported(model);
        let remedy =
            if error == IntrinsicsError::Panorama { "" } else { "; undistort the images with COLMAP" };
        return Err(bytes.refuse(format!("camera {id}: {error}{remedy}")));
    };
    let (width, height) = (bytes.u64()?, bytes.u64()?);
    let (Ok(width), Ok(height)) = (u32::try_from(width), u32::try_from(height)) else {
        return Err(
            bytes.refuse(format!("camera {id} has images of {width} x {height} pixels, which none has"))
        );
    };
    let mut params = Vec::with_capacity(count);
    for _ in 0..count {
        let [value] = bytes.f64s()?;
        params.push(value);
    }
    let camera =
        Intrinsics::new(name, width, height, &params).map_err(|e| bytes.refuse(format!("camera {id}: {e}")));
    Ok((id, camera))
}

/// `id: u32, q: f64[4], t: f64[3], camera: u32, name: bytes to 0, points: u64, (x: f64, y: f64, point: u64)[]`
fn image(bytes: &mut Bytes) -> Result<Result<ColmapImage, MapError>, MapError> {
    let id = bytes.u32()?;
    let (rotation, translation) = (bytes.f64s()?, bytes.f64s()?);
    let pose = CameraFromWorld::from_quaternion(rotation, translation).ok_or_else(|| {
        bytes.refuse(format!(
            "the pose of image {id} is not finite or its quaternion is zero; remove the image or give it a pose"
        ))
    });
    let camera_id = bytes.u32()?;
    let rest = &bytes.content[bytes.at..];
    let Some(length) = rest.iter().position(|b| *b == 0) else {
        return Err(bytes.refuse(format!("the name of image {id} does not end; export the model again")));
    };
    let name = std::str::from_utf8(&rest[..length])
        .map_err(|_| bytes.refuse(format!("the name of image {id} is not UTF-8; rename the image")))?
        .to_owned();
    bytes.at += length + 1;
    let count = bytes.count("2D points", 24)?;
    let mut points2d = Vec::with_capacity(count);
    for _ in 0..count {
        let [u, v] = bytes.f64s()?;
        let point = bytes.u64()?;
        points2d.push(ColmapPoint2d { pixel: Pixel::new(u, v), point: (point != NO_POINT).then_some(point) });
    }
    Ok(pose.map(|cam_from_world| ColmapImage { id, name, camera_id, cam_from_world, points2d }))
}

/// `id: u64, xyz: f64[3], rgb: u8[3], error: f64, track: u64, (image: u32, keypoint: u32)[]`
fn point(bytes: &mut Bytes) -> Result<ColmapPoint, MapError> {
    let id = bytes.u64()?;
    let [x, y, z] = bytes.f64s()?;
    let color = bytes.take()?;
    let [error] = bytes.f64s()?;
    let count = bytes.count("observations of a point", 8)?;
    let mut track = Vec::with_capacity(count);
    for _ in 0..count {
        track.push((bytes.u32()?, bytes.u32()?));
    }
    Ok(ColmapPoint { id, position: Point3::new(x, y, z), color, error, track })
}

//! Metashape's cameras as XML (File, Export, Export Cameras, "Agisoft XML").
//!
//! A camera's `transform` is camera to chunk, 4 × 4 row by row, camera axes right, down, forward. `f`, `cx`, `cy` of a
//! sensor's calibration are pixels, `cx` and `cy` from the middle of the image; `b1` is added to the horizontal focal
//! length. Distortion is Brown's with `p1` and `p2` in the other order than OpenCV's: `x' = … + p1 (r² + 2 x²) + 2 p2 x y`.
//! Skew (`b2`), `k4` of a frame camera and `p3`, `p4` have no model here and are refused. Labels have no folder and often no
//! extension.
//!
//! If the chunk, or the cameras' component, has a `transform` (rotation, translation, scale), it is applied: poses are then
//! in Metashape's world, metres if that was referenced. Of several components, whose frames differ, the one with the most
//! cameras is read.
//!
//! Source: *Agisoft Metashape User Manual*, Appendix D "Camera models", and `nerfstudio/process_data/metashape_utils.py`,
//! which reads these files (but does not exchange `p1` and `p2`).

use std::collections::BTreeMap;
use std::path::Path;

use roxmltree::{Document, Node};
use veiloc_geometry::Intrinsics;
use veiloc_geometry::nalgebra::{Matrix3, Matrix4, Vector3};

use super::cameras::{Brown, intrinsics};
use super::names::ImageNames;
use super::posed_input::{Poses, faulty, pose_of_world_from_cam, text};
use crate::error::MappingError;

pub(super) fn read(path: &Path, names: &ImageNames) -> Result<Poses, MappingError> {
    let content = text(path)?;
    let document = Document::parse(&content).map_err(|e| faulty(path, format!("is not XML: {e}")))?;
    let chunks: Vec<Node<'_, '_>> =
        document.root_element().children().filter(|node| node.has_tag_name("chunk")).collect();
    let file = Xml { path };
    let cameras_of =
        |chunk: &Node<'_, '_>| cameras(*chunk).filter(|c| child(*c, "transform").is_some()).count();
    let chunk = chunks.iter().rev().max_by_key(|chunk| cameras_of(chunk));
    let chunk = *chunk.ok_or_else(|| faulty(path, "has no chunk; export the cameras as Agisoft XML"))?;
    let mut poses = Poses::default();
    if chunks.len() > 1 {
        poses
            .remarks
            .push(format!("{} further chunks are left out: their world frames differ", chunks.len() - 1));
    }
    let mut sensors = BTreeMap::new();
    for sensor in chunk.descendants().filter(|node| node.has_tag_name("sensor")) {
        sensors.insert(sensor.attribute("id").unwrap_or_default(), sensor);
    }
    let posed: Vec<Node<'_, '_>> = cameras(chunk).filter(|c| child(*c, "transform").is_some()).collect();
    let mut by_component: BTreeMap<&str, usize> = BTreeMap::new();
    for camera in &posed {
        *by_component.entry(camera.attribute("component_id").unwrap_or_default()).or_default() += 1;
    }
    let largest = by_component.iter().rev().max_by_key(|(_, count)| **count);
    let component = largest.map(|(id, _)| *id).unwrap_or_default();
    let without_pose = cameras(chunk).count() - posed.len();
    if without_pose > 0 {
        poses.remarks.push(format!("{without_pose} cameras without a pose are left out"));
    }
    let others: usize = posed.len() - by_component.get(component).copied().unwrap_or(0);
    if others > 0 {
        poses.remarks.push(format!("{others} cameras of other components are left out: their frames differ"));
    }
    let (world_from_chunk, scale) = file.world_from_chunk(chunk, component)?;
    let mut lenses: BTreeMap<&str, Intrinsics> = BTreeMap::new();
    for camera in posed {
        if camera.attribute("component_id").unwrap_or_default() != component {
            continue;
        }
        let label = camera.attribute("label").unwrap_or_default();
        let id = camera.attribute("sensor_id").unwrap_or_default();
        let lens = if let Some(lens) = lenses.get(id) {
            *lens
        } else {
            let sensor = sensors.get(id);
            let sensor = sensor
                .ok_or_else(|| faulty(path, format!("camera {label:?}: its sensor {id:?} is missing")))?;
            let lens = file.lens(*sensor)?;
            lenses.insert(id, lens);
            lens
        };
        let matrix = child(camera, "transform").map(|node| file.numbers(node, label)).transpose()?;
        let matrix: [f64; 16] = matrix
            .and_then(|numbers| numbers.try_into().ok())
            .ok_or_else(|| faulty(path, format!("camera {label:?}: its transform has not 16 numbers")))?;
        let mut world_from_cam = world_from_chunk * Matrix4::from_row_slice(&matrix);
        world_from_cam.fixed_view_mut::<3, 3>(0, 0).unscale_mut(scale);
        let pose = pose_of_world_from_cam(&world_from_cam).ok_or_else(|| {
            faulty(path, format!("camera {label:?}: its transform is no rotation and translation"))
        })?;
        poses.push(names.find(path, label), lens, pose, Vec::new());
    }
    Ok(poses)
}

/// The cameras of a chunk, those in groups included.
fn cameras<'a, 'input>(chunk: Node<'a, 'input>) -> impl Iterator<Item = Node<'a, 'input>> {
    let all = chunk.children().filter(|node| node.has_tag_name("cameras"));
    all.flat_map(|node| node.descendants()).filter(|node| node.has_tag_name("camera"))
}

fn child<'a, 'input>(node: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    node.children().find(|child| child.has_tag_name(name))
}

/// The file, for messages.
struct Xml<'a> {
    path: &'a Path,
}

impl Xml<'_> {
    fn numbers(&self, node: Node<'_, '_>, of: &str) -> Result<Vec<f64>, MappingError> {
        let words = node.text().unwrap_or_default().split_whitespace();
        let numbers: Option<Vec<f64>> =
            words.map(|word| word.parse().ok().filter(|n: &f64| n.is_finite())).collect();
        numbers.ok_or_else(|| {
            faulty(self.path, format!("{of}: {} has something else than numbers", node.tag_name().name()))
        })
    }

    /// The number of a child; 0 if it is absent.
    fn number(&self, node: Node<'_, '_>, name: &str) -> Result<f64, MappingError> {
        let Some(node) = child(node, name) else { return Ok(0.0) };
        match self.numbers(node, "calibration")?[..] {
            [number] => Ok(number),
            _ => Err(faulty(self.path, format!("calibration: {name} is not one number"))),
        }
    }

    /// The transform of the component, or else of the chunk, and its scale.
    fn world_from_chunk(
        &self,
        chunk: Node<'_, '_>,
        component: &str,
    ) -> Result<(Matrix4<f64>, f64), MappingError> {
        let of_component = chunk
            .descendants()
            .find(|node| node.has_tag_name("component") && node.attribute("id") == Some(component))
            .and_then(|node| child(node, "transform"));
        let mut matrix = Matrix4::identity();
        let Some(transform) = of_component.or_else(|| child(chunk, "transform")) else {
            return Ok((matrix, 1.0));
        };
        let part =
            |name: &str| child(transform, name).map(|node| self.numbers(node, "transform")).transpose();
        let scale = match part("scale")? {
            Some(scale) => scale.first().copied().filter(|s| *s > 0.0),
            None => Some(1.0),
        };
        let scale = scale.ok_or_else(|| faulty(self.path, "transform: its scale is not positive"))?;
        if let Some(rotation) = part("rotation")?.filter(|numbers| numbers.len() == 9) {
            matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::from_row_slice(&rotation));
        }
        matrix.fixed_view_mut::<3, 3>(0, 0).scale_mut(scale);
        if let Some(translation) = part("translation")?.filter(|numbers| numbers.len() == 3) {
            matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&Vector3::from_row_slice(&translation));
        }
        Ok((matrix, scale))
    }

    /// The camera of a sensor: its adjusted calibration, or else the only one.
    fn lens(&self, sensor: Node<'_, '_>) -> Result<Intrinsics, MappingError> {
        let label = sensor.attribute("label").unwrap_or_default();
        let fault = |reason: String| faulty(self.path, format!("sensor {label:?}: {reason}"));
        let calibrations = || sensor.children().filter(|node| node.has_tag_name("calibration"));
        let calibration = calibrations()
            .find(|node| node.attribute("class") == Some("adjusted"))
            .or_else(|| calibrations().next())
            .ok_or_else(|| fault("it has no calibration; align the photos before the export".to_owned()))?;
        let resolution = child(calibration, "resolution").or_else(|| child(sensor, "resolution"));
        let side = |name: &str| resolution.and_then(|node| node.attribute(name)?.parse::<u32>().ok());
        let (w, h) =
            side("width").zip(side("height")).ok_or_else(|| fault("it has no resolution".to_owned()))?;
        let number = |name: &str| self.number(calibration, name);
        let focal = [number("f")? + number("b1")?, number("f")?];
        let principal = [number("cx")? + 0.5 * f64::from(w), number("cy")? + 0.5 * f64::from(h)];
        let k = [number("k1")?, number("k2")?, number("k3")?, number("k4")?];
        for name in ["b2", "p3", "p4"] {
            if number(name)? != 0.0 {
                return Err(fault(format!(
                    "its {name} is not 0, which no camera model here has; align without it, or export undistorted images"
                )));
            }
        }
        // Exchanged against OpenCV's.
        let p = [number("p2")?, number("p1")?];
        let kind = calibration.attribute("type").or_else(|| sensor.attribute("type")).unwrap_or("frame");
        match kind {
            "frame" => Brown { size: (w, h), focal, principal, k, p }.intrinsics(self.path),
            "fisheye" | "equidistant_fisheye" if p == [0.0; 2] => {
                let params = [focal[0], focal[1], principal[0], principal[1], k[0], k[1], k[2], k[3]];
                intrinsics(self.path, "OPENCV_FISHEYE", (w, h), &params)
            }
            other => Err(fault(format!(
                "its type is {other:?}{}; frame cameras and equidistant fisheyes without p1 and p2 are read",
                if p == [0.0; 2] { "" } else { " with p1 or p2" }
            ))),
        }
    }
}

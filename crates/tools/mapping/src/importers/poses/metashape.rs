//! Metashape's cameras as XML (File, Export, Export Cameras, "Agisoft XML").
//!
//! A camera's `transform` is camera to chunk, 4 × 4 row by row, camera axes right, down, forward. `f`, `cx`, `cy` of a
//! sensor's calibration are pixels, `cx` and `cy` from the middle of the image; `b1` is added to the horizontal focal
//! length. Distortion is Brown's with `p1` and `p2` in the other order than OpenCV's: `x' = … + p1 (r² + 2 x²) + 2 p2 x y`.
//! Skew (`b2`), `k4` of a frame camera, `p1` and `p2` of a fisheye and `p3`, `p4` have no model here: images of sensors where
//! they matter are left out, as are those of panoramas. Labels have no folder and often no extension; of equal labels, the
//! folder is the label of their group.
//!
//! A camera of a rig (`master_id`) without a transform has that of its master, and the `rotation` and `location` of its sensor:
//! slave to master, the location in units of the world.
//!
//! If the chunk, or the cameras' component, has a `transform` (rotation, translation, scale), it is applied: poses are then
//! in Metashape's world, metres if that was referenced. Of several components, whose frames differ, the one with the most
//! cameras is read.
//!
//! Source: *Agisoft Metashape User Manual*, Appendix D "Camera models", and `nerfstudio/process_data/metashape_utils.py`,
//! which reads these files (but does not exchange `p1` and `p2`); rigs: Metashape Expert Manual (community), "The slave-sensor
//! transform".

use std::collections::BTreeMap;
use std::path::Path;

use roxmltree::{Document, Node};
use veiloc_geometry::Intrinsics;
use veiloc_geometry::nalgebra::{Matrix3, Matrix4, Vector3};

use super::cameras::Lens;
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
    let mut labels: BTreeMap<&str, usize> = BTreeMap::new();
    for camera in &posed {
        *by_component.entry(camera.attribute("component_id").unwrap_or_default()).or_default() += 1;
    }
    for camera in cameras(chunk) {
        *labels.entry(camera.attribute("label").unwrap_or_default()).or_default() += 1;
    }
    let largest = by_component.iter().rev().max_by_key(|(_, count)| **count);
    let component = largest.map(|(id, _)| *id).unwrap_or_default();
    let masters: BTreeMap<&str, Node<'_, '_>> =
        posed.iter().map(|camera| (camera.attribute("id").unwrap_or_default(), *camera)).collect();
    let (world_from_chunk, scale) = file.world_from_chunk(chunk, component)?;
    let mut slaves = 0;
    for camera in cameras(chunk) {
        let label = camera.attribute("label").unwrap_or_default();
        let master = if child(camera, "transform").is_none() {
            let master = camera.attribute("master_id").and_then(|id| masters.get(id));
            let Some(master) = master else {
                poses.leave_out("cameras", label, "they have no pose");
                continue;
            };
            Some(*master)
        } else {
            None
        };
        let of_pose = master.unwrap_or(camera);
        if of_pose.attribute("component_id").unwrap_or_default() != component {
            poses.leave_out("cameras", label, "they are of other components, whose frames differ");
            continue;
        }
        let posed = file.transform(of_pose).and_then(|mut chunk_from_cam| {
            let id = camera.attribute("sensor_id").unwrap_or_default();
            let sensor = sensors.get(id);
            let sensor = *sensor.ok_or_else(|| faulty(path, format!("their sensor {id:?} is missing")))?;
            if let Some(master) = master {
                let of_master = master.attribute("sensor_id").unwrap_or_default();
                chunk_from_cam *= file.master_from_slave(sensor, of_master, scale)?;
            }
            let mut world_from_cam = world_from_chunk * chunk_from_cam;
            world_from_cam.fixed_view_mut::<3, 3>(0, 0).unscale_mut(scale);
            let pose = pose_of_world_from_cam(&world_from_cam);
            let pose = pose.ok_or_else(|| faulty(path, "their transform is no rotation and translation"))?;
            Ok((file.lens(sensor)?, pose))
        });
        if let Some((lens, pose)) = poses.keep("cameras", label, posed)? {
            slaves += usize::from(master.is_some());
            // The groups distinguish equal labels.
            let group = camera.ancestors().find(|node| node.has_tag_name("group"));
            let in_group =
                group.and_then(|group| group.attribute("label")).map(|group| format!("{group}/{label}"));
            let is_unique = labels.get(label) == Some(&1) && !names.is_ambiguous(path, label);
            let written = in_group.filter(|_| !is_unique).unwrap_or_else(|| label.to_owned());
            poses.push(names.find(path, &written), lens, pose, Vec::new());
        }
    }
    if slaves > 0 {
        poses.remarks.push(format!(
            "{slaves} cameras of rigs have the pose of their master and the offset of their sensor, taken in units of the world"
        ));
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

    /// The transform of a camera.
    fn transform(&self, camera: Node<'_, '_>) -> Result<Matrix4<f64>, MappingError> {
        let matrix = child(camera, "transform").map(|node| self.numbers(node, "transform")).transpose()?;
        let matrix: Option<[f64; 16]> = matrix.and_then(|numbers| numbers.try_into().ok());
        let matrix = matrix.ok_or_else(|| faulty(self.path, "their transform has not 16 numbers"))?;
        Ok(Matrix4::from_row_slice(&matrix))
    }

    /// The pose of a sensor in the camera of its master, in units of a chunk with this scale.
    fn master_from_slave(
        &self,
        sensor: Node<'_, '_>,
        master: &str,
        scale: f64,
    ) -> Result<Matrix4<f64>, MappingError> {
        if sensor.attribute("master_id").is_some_and(|id| id != master) {
            return Err(faulty(self.path, "their sensor and their camera have different masters"));
        }
        let part = |name: &str| child(sensor, name).map(|node| self.numbers(node, name)).transpose();
        let rotation: Option<[f64; 9]> = part("rotation")?.and_then(|numbers| numbers.try_into().ok());
        let location = match part("location")? {
            Some(location) => Some(location),
            None => part("translation")?,
        };
        let location: Option<[f64; 3]> = location.and_then(|numbers| numbers.try_into().ok());
        let (Some(rotation), Some(location)) = (rotation, location) else {
            let reason = "they have no transform, and their sensor has no rotation and location in the rig";
            return Err(faulty(self.path, reason));
        };
        let mut matrix = Matrix3::from_row_slice(&rotation).to_homogeneous();
        matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&(Vector3::from(location) / scale));
        Ok(matrix)
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
        // The first two exchanged against OpenCV's.
        let p = [number("p2")?, number("p1")?, number("p3")?, number("p4")?];
        let kind = calibration.attribute("type").or_else(|| sensor.attribute("type")).unwrap_or("frame");
        let is_fisheye = match kind {
            "frame" => false,
            "fisheye" | "equidistant_fisheye" => true,
            other => {
                return Err(fault(format!(
                    "its type is {other:?}; frame cameras and equidistant fisheyes are read"
                )));
            }
        };
        Lens { size: (w, h), focal, principal, k, p, skew: number("b2")?, is_fisheye }.intrinsics(self.path)
    }
}

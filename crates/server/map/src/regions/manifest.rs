//! The manifest: the parts of a map that was cut into regions.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use veiloc_geometry::Point3;
use veiloc_geometry::frames::World;
use veiloc_protocol::MapCoordinates;

use crate::regions::object::{ObjectId, ObjectRef};
use crate::{ManifestError, is_map_name};

/// The version of the manifest that this program writes and reads.
pub const MANIFEST_VERSION: u32 = 1;

/// Maximum length of a manifest, bytes: about two hundred thousand regions. It bounds the memory that a hostile
/// manifest can use.
pub const MAX_MANIFEST_BYTES: usize = 64 << 20;

/// Maximum length of an object, bytes: beyond any region, and beyond an index of a hundred million images.
pub const MAX_OBJECT_BYTES: u64 = 1 << 40;

/// The parts of a cut map: its regions, the index of its images and its profile, each an object named by its SHA-256.
///
/// A JSON document (`docs/reference/map-format.md`). Equal maps cut with equal options have equal manifests; the SHA-256 of the
/// bytes is the id of the manifest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`MANIFEST_VERSION`].
    version: u32,
    /// Name under which the map is served.
    pub map: String,
    /// Number of images of the whole map.
    pub images: u64,
    /// Number of points of the whole map.
    pub points: u64,
    /// Metres of a unit of the map, 1; not written if that is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub metres_per_unit: Option<f64>,
    /// Direction of gravity in the map, a unit vector; not written if that is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub down: Option<[f64; 3]>,
    /// The profile with which devices seal queries, the same for the whole map and every region. The first half of
    /// its SHA-256 is its id.
    pub profile: ObjectRef,
    /// The [`RegionIndex`](crate::regions::RegionIndex).
    pub index: ObjectRef,
    /// The regions, each a map file; the index refers to them by their position here.
    pub regions: Vec<RegionEntry>,
}

/// A region of a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RegionEntry {
    /// SHA-256 of its map file.
    pub sha256: ObjectId,
    /// Number of bytes of its map file.
    pub bytes: u64,
    /// Number of its images, including its core.
    pub images: u64,
    /// Number of images in its core.
    pub core_images: u64,
    /// Number of its points.
    pub points: u64,
    /// Mean of the camera centres of its core, in the axes of the map, map units.
    pub center: [f64; 3],
    /// Distance of the farthest camera centre of its core from `center`, map units.
    pub radius: f64,
}

impl RegionEntry {
    /// Reference to its map file.
    pub const fn object(&self) -> ObjectRef {
        ObjectRef { sha256: self.sha256, bytes: self.bytes }
    }

    /// Distance of a position from the ball around the cameras of the core, map units; 0 inside.
    pub fn distance_to(&self, position: &Point3<World>) -> f64 {
        let [x, y, z] = self.center;
        ((position.coords - Point3::<World>::new(x, y, z).coords).norm() - self.radius).max(0.0)
    }
}

impl Manifest {
    /// Combines and checks the parts.
    ///
    /// # Errors
    /// [`ManifestError::Impossible`] with the reason.
    pub fn new(
        map: &str,
        images: u64,
        points: u64,
        coordinates: MapCoordinates,
        profile: ObjectRef,
        index: ObjectRef,
        regions: Vec<RegionEntry>,
    ) -> Result<Self, ManifestError> {
        let manifest = Self {
            version: MANIFEST_VERSION,
            map: map.to_owned(),
            images,
            points,
            metres_per_unit: coordinates.metres_per_unit,
            down: coordinates.down,
            profile,
            index,
            regions,
        };
        manifest.check().map_err(|reason| ManifestError::Impossible { reason })?;
        Ok(manifest)
    }

    /// Decodes a manifest.
    ///
    /// # Errors
    /// [`ManifestError`]: too long, not a manifest, of another version, inconsistent, or not in canonical form.
    pub fn decode(bytes: &[u8]) -> Result<Self, ManifestError> {
        if bytes.len() > MAX_MANIFEST_BYTES {
            return Err(ManifestError::TooLong { most: MAX_MANIFEST_BYTES });
        }
        // The version is read first, so that a newer manifest is reported as such.
        let Head { version } = serde_json::from_slice(bytes)?;
        if version != MANIFEST_VERSION {
            return Err(ManifestError::Version { found: version, supported: MANIFEST_VERSION });
        }
        let manifest: Self = serde_json::from_slice(bytes)?;
        manifest.check().map_err(|reason| ManifestError::Impossible { reason })?;
        if manifest.encode() != bytes {
            return Err(ManifestError::SecondForm);
        }
        Ok(manifest)
    }

    /// Decodes the manifest with this id.
    ///
    /// # Errors
    /// As [`Self::decode`], and [`ManifestError::OtherId`].
    pub fn decode_as(bytes: &[u8], expected: ObjectId) -> Result<Self, ManifestError> {
        // Too long input is not hashed.
        if bytes.len() <= MAX_MANIFEST_BYTES {
            let found = ObjectId::of(bytes);
            if found != expected {
                return Err(ManifestError::OtherId { expected, found });
            }
        }
        Self::decode(bytes)
    }

    /// Encodes the canonical form: JSON with two spaces, fields in the order of [`Manifest`], and a final newline.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes =
            serde_json::to_vec_pretty(self).expect("numbers, text and lists, all finite when checked");
        bytes.push(b'\n');
        bytes
    }

    /// The SHA-256 of its bytes.
    pub fn id(&self) -> ObjectId {
        ObjectId::of(&self.encode())
    }

    /// What the coordinates of the map mean.
    pub const fn coordinates(&self) -> MapCoordinates {
        MapCoordinates { metres_per_unit: self.metres_per_unit, down: self.down }
    }

    /// All objects: profile and index first, then the regions in order.
    pub fn objects(&self) -> impl Iterator<Item = ObjectRef> {
        [self.profile, self.index].into_iter().chain(self.regions.iter().map(RegionEntry::object))
    }

    /// Total length of all objects, bytes.
    pub fn byte_count(&self) -> u64 {
        self.objects().map(|object| object.bytes).sum()
    }

    fn check(&self) -> Result<(), String> {
        if !is_map_name(&self.map) {
            return Err(format!("{:?} is not a valid map name", self.map));
        }
        if self.metres_per_unit.is_some_and(|metres| !(metres.is_finite() && metres > 0.0)) {
            return Err("metres_per_unit is not above 0".to_owned());
        }
        let is_unit = |v: [f64; 3]| (v.iter().map(|c| c * c).sum::<f64>() - 1.0).abs() < 1e-6;
        if self.down.is_some_and(|down| !is_unit(down)) {
            return Err("down is no unit vector".to_owned());
        }
        if self.regions.is_empty() || self.regions.len() > u32::MAX as usize {
            return Err(format!("{} regions", self.regions.len()));
        }
        let mut core = 0_u64;
        let mut names = BTreeSet::new();
        for (number, region) in self.regions.iter().enumerate() {
            if region.core_images == 0 || region.core_images > region.images || region.images > self.images {
                return Err(format!(
                    "region {number} has {} images of {}, {} in its core",
                    region.images, self.images, region.core_images
                ));
            }
            if region.points > self.points {
                return Err(format!("region {number} has {} points of {}", region.points, self.points));
            }
            let is_finite = region.center.iter().all(|c| c.is_finite());
            if !(is_finite && region.radius.is_finite() && region.radius >= 0.0) {
                return Err(format!("region {number} has an invalid centre or radius"));
            }
            if !names.insert(region.sha256) {
                return Err(format!("region {number} appears twice"));
            }
            core = core.saturating_add(region.core_images);
        }
        if core != self.images {
            return Err(format!(
                "regions have {core} images in their cores, and the map has {}",
                self.images
            ));
        }
        match self.objects().find(|object| !(1..=MAX_OBJECT_BYTES).contains(&object.bytes)) {
            Some(object) => Err(format!("an object of {} bytes", object.bytes)),
            None => Ok(()),
        }
    }
}

/// The field that every version has.
#[derive(Deserialize)]
struct Head {
    version: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn manifest() -> Manifest {
        let object = |content: &[u8]| ObjectRef::of(content);
        let region = |content: &[u8], images, core_images| RegionEntry {
            sha256: ObjectId::of(content),
            bytes: 1000,
            images,
            core_images,
            points: 50,
            center: [0.1, -2.5, 1e-7],
            radius: 3.25,
        };
        Manifest::new(
            "kitchen-2",
            30,
            70,
            MapCoordinates::default(),
            object(b"profile"),
            object(b"index"),
            vec![region(b"one", 25, 20), region(b"two", 15, 10)],
        )
        .unwrap()
    }

    #[test]
    fn only_the_canonical_form_is_read() {
        let manifest = manifest();
        let bytes = manifest.encode();
        assert_eq!(Manifest::decode(&bytes).unwrap(), manifest);
        assert_eq!(Manifest::decode_as(&bytes, manifest.id()).unwrap(), manifest);
        let other = Manifest::decode_as(&bytes, ObjectId::of(b"other"));
        assert!(matches!(other, Err(ManifestError::OtherId { found, .. }) if found == manifest.id()));
        let compact = serde_json::to_vec(&manifest).unwrap();
        assert!(matches!(Manifest::decode(&compact), Err(ManifestError::SecondForm)));
        let mut known = manifest.clone();
        (known.metres_per_unit, known.down) = (Some(1.0), Some([0.0, -1.0, 0.0]));
        assert_eq!(Manifest::decode(&known.encode()).unwrap(), known);
        let said =
            String::from_utf8(bytes).unwrap().replacen("\"profile\"", "\"down\": null,\n  \"profile\"", 1);
        assert!(matches!(Manifest::decode(said.as_bytes()), Err(ManifestError::SecondForm)));
        assert_eq!(manifest.byte_count(), 2000 + b"profile".len() as u64 + b"index".len() as u64);
    }

    #[test]
    fn other_versions_have_a_remedy() {
        let text = String::from_utf8(manifest().encode()).unwrap();
        let newer = text.replacen("\"version\": 1", "\"parents\": [], \"version\": 2", 1);
        let error = Manifest::decode(newer.as_bytes()).unwrap_err();
        assert!(matches!(error, ManifestError::Version { found: 2, supported: 1 }), "{error}");
        assert!(error.to_string().contains("publish the map again"), "{error}");
        let unknown = text.replacen("\"map\"", "\"more\": 1, \"map\"", 1);
        assert!(matches!(Manifest::decode(unknown.as_bytes()), Err(ManifestError::Json(_))));
    }

    #[test]
    fn inconsistent_manifests_are_named() {
        let good = || manifest();
        let refused = |change: &dyn Fn(&mut Manifest)| {
            let mut manifest = good();
            change(&mut manifest);
            match Manifest::decode(&manifest.encode()) {
                Err(ManifestError::Impossible { reason }) => reason,
                other => panic!("{other:?}"),
            }
        };
        assert!(refused(&|m| m.map = "../x".to_owned()).contains("not a valid map name"));
        assert!(refused(&|m| m.metres_per_unit = Some(-1.0)).contains("metres_per_unit"));
        assert!(refused(&|m| m.down = Some([0.0, 2.0, 0.0])).contains("down"));
        assert!(refused(&|m| m.regions.clear()).contains("0 regions"));
        assert!(refused(&|m| m.images = 31).contains("30 images in their cores"));
        assert!(refused(&|m| m.regions[0].core_images = 26).contains("region 0"));
        assert!(refused(&|m| m.regions[0].core_images = 0).contains("region 0"));
        assert!(refused(&|m| m.regions[1].core_images = u64::MAX).contains("region 1"));
        assert!(refused(&|m| m.regions[1].points = 71).contains("71 points of 70"));
        assert!(refused(&|m| m.regions[1].radius = -1.0).contains("invalid centre"));
        assert!(refused(&|m| m.regions[1].sha256 = m.regions[0].sha256).contains("twice"));
        assert!(refused(&|m| m.regions[1].bytes = u64::MAX).contains("an object of"));
        assert!(refused(&|m| m.index.bytes = 0).contains("an object of 0"));
        let long = vec![b' '; MAX_MANIFEST_BYTES + 1];
        assert!(matches!(Manifest::decode(&long), Err(ManifestError::TooLong { .. })));
    }

    #[test]
    fn distance_to_a_region() {
        let region = &manifest().regions[0];
        assert_eq!(region.distance_to(&Point3::new(0.1, -2.5, 3.0)), 0.0);
        assert!((region.distance_to(&Point3::new(0.1, -2.5, 10.0)) - (10.0 - 1e-7 - 3.25)).abs() < 1e-12);
    }
}

//! Content anchors: content of apps at poses of a map, as one JSON document.
//!
//! The document is the same in the file beside a map, in the service's list and in every binding. It is checked when it is
//! read and when it is changed, so its poses are finite rotations, its names unique and its length bounded.

use serde::{Deserialize, Serialize};
use serde_json::Value;
use veiloc_geometry::CameraFromWorld;

use crate::{PoseDocument, is_map_name};

/// Content at a place of a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ContentAnchor {
    /// 1 to 64 letters, digits, `-`, `_` and `.`, as of maps. It may be absent where an address names the anchor.
    #[serde(default)]
    pub name: String,
    /// Where the content is in the map.
    pub map_from_anchor: AnchorPose,
    /// Any JSON of the app, at most 4096 bytes; `null` when absent.
    #[serde(default)]
    pub content: Value,
    /// Name of the token that wrote it. The service ignores what a client sends, and tells it of the client's own anchors only,
    /// and to operators.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub owner: Option<String>,
}

/// A pose of content in a map: `x_map = R x_anchor + t`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AnchorPose {
    /// Hamilton unit quaternion `w x y z` of `R`: from the content's axes to the map's, right-handed.
    pub q: [f64; 4],
    /// Position in the map, map units.
    pub t: [f64; 3],
}

impl AnchorPose {
    /// The pose with a quaternion of length 1.
    fn checked(self) -> Result<Self, ContentAnchorError> {
        let length = self.q.iter().map(|c| c * c).sum::<f64>().sqrt();
        // Written so that NaN fails.
        let is_rotation = (length - 1.0).abs() <= MAX_LENGTH_ERROR;
        if !is_rotation {
            return Err(ContentAnchorError::Rotation);
        }
        if !self.t.iter().all(|c| c.abs() <= MAX_COORDINATE) {
            return Err(ContentAnchorError::Position);
        }
        // Kept to the bit when it is a unit quaternion already, so that a document does not change by being read.
        let is_unit = (length - 1.0).abs() <= 4.0 * f64::EPSILON;
        Ok(if is_unit { self } else { Self { q: self.q.map(|c| c / length), ..self } })
    }
}

/// An image of a map and its pose, by which the map's coordinate frame is recognized.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FrameImage {
    /// Name of the image.
    pub name: String,
    /// Its pose, map to camera.
    pub cam_from_world: PoseDocument,
}

/// The content anchors of a map.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ContentAnchors {
    /// Version of the document, 1.
    version: u32,
    /// Some images of the map: with other poses of them, the anchors are of another coordinate frame. Not sent to devices.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    images: Vec<FrameImage>,
    /// In the order of their names.
    anchors: Vec<ContentAnchor>,
}

/// The same before it is checked.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Unchecked {
    version: u32,
    #[serde(default)]
    images: Vec<FrameImage>,
    anchors: Vec<ContentAnchor>,
}

/// Why content anchors were refused. No message repeats a value (rule L8).
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ContentAnchorError {
    /// Not the JSON of an anchor, or of a document of anchors.
    #[error(
        "not the JSON of content anchors: line {line}, column {column}; an anchor has map_from_anchor {{\"q\": [w, x, y, z], \
         \"t\": [x, y, z]}} and content"
    )]
    Json {
        /// From 1.
        line: usize,
        /// From 1.
        column: usize,
    },
    /// A document of another version.
    #[error("content anchors of version {0}, not 1; update the older side")]
    Version(u32),
    /// The name is not valid.
    #[error("an anchor's name has 1 to 64 letters, digits, `-`, `_` and `.`, and is not `.` or `..`")]
    Name,
    /// Two anchors have one name.
    #[error("two anchors have the same name; give each its own")]
    NameTwice,
    /// The rotation is none.
    #[error("map_from_anchor.q is no rotation; give a unit quaternion w x y z")]
    Rotation,
    /// The position is not finite, or far outside any map.
    #[error(
        "map_from_anchor.t is not within {MAX_COORDINATE:e} map units of the map's origin; give map coordinates"
    )]
    Position,
    /// The content is too long.
    #[error(
        "the content of an anchor has at most {} bytes of JSON; keep the rest elsewhere, and its address here",
        ContentAnchors::MAX_CONTENT
    )]
    Content,
    /// Too many anchors.
    #[error("a map has at most {} anchors; delete some", ContentAnchors::MAX_ANCHORS)]
    TooMany,
    /// The document would be too long.
    #[error(
        "the anchors of a map have at most {} bytes together; delete some, or shorten their content",
        ContentAnchors::MAX_BYTES
    )]
    TooLong,
}

impl Default for ContentAnchors {
    fn default() -> Self {
        Self { version: 1, images: Vec::new(), anchors: Vec::new() }
    }
}

impl ContentAnchor {
    /// Most bytes of the JSON of one anchor.
    pub const MAX_BYTES: usize = ContentAnchors::MAX_CONTENT + 1024;

    /// Reads the JSON of one anchor, and gives it this name.
    ///
    /// # Errors
    /// [`ContentAnchorError`]; [`ContentAnchorError::Name`] also for another name in the JSON.
    pub fn decode(name: &str, json: &[u8]) -> Result<Self, ContentAnchorError> {
        let anchor: Self = parse(json, Self::MAX_BYTES)?;
        if !anchor.name.is_empty() && anchor.name != name {
            return Err(ContentAnchorError::Name);
        }
        Self { name: name.to_owned(), ..anchor }.checked()
    }

    /// As JSON.
    pub fn encode(&self) -> Vec<u8> {
        // Strings and finite numbers always serialize; the same below.
        serde_json::to_vec(self).unwrap_or_default()
    }

    /// Distance of the content from a place in the map, map units.
    pub fn distance(&self, place: [f64; 3]) -> f64 {
        let t = self.map_from_anchor.t;
        (0..3).map(|k| (t[k] - place[k]).powi(2)).sum::<f64>().sqrt()
    }

    fn checked(self) -> Result<Self, ContentAnchorError> {
        if !is_map_name(&self.name) {
            return Err(ContentAnchorError::Name);
        }
        if self.content.to_string().len() > ContentAnchors::MAX_CONTENT {
            return Err(ContentAnchorError::Content);
        }
        Ok(Self { map_from_anchor: self.map_from_anchor.checked()?, ..self })
    }
}

impl ContentAnchors {
    /// Most anchors of a map.
    pub const MAX_ANCHORS: usize = 1000;
    /// Most bytes of the content of an anchor, as JSON without spaces.
    pub const MAX_CONTENT: usize = 4096;
    /// Most bytes of the document without recorded images.
    pub const MAX_BYTES: usize = 1 << 20;
    /// Most bytes of the document with them.
    pub const MAX_FILE: usize = Self::MAX_BYTES + (64 << 10);
    /// Images that are recorded, and most bytes of their names: together less than the 64 KiB above.
    const FRAME_IMAGES: usize = 64;
    const FRAME_NAME: usize = 128;

    /// Reads a document.
    ///
    /// # Errors
    /// [`ContentAnchorError`].
    pub fn decode(json: &[u8]) -> Result<Self, ContentAnchorError> {
        let Unchecked { version, images, anchors } = parse(json, Self::MAX_FILE)?;
        if version != 1 {
            return Err(ContentAnchorError::Version(version));
        }
        let mut read = Self { images, ..Self::default() };
        read.replace(anchors)?;
        Ok(read)
    }

    /// The document.
    pub fn encode(&self) -> Vec<u8> {
        serde_json::to_vec(self).unwrap_or_default()
    }

    /// All, in the order of their names.
    pub fn anchors(&self) -> &[ContentAnchor] {
        &self.anchors
    }

    /// The anchor of this name.
    pub fn get(&self, name: &str) -> Option<&ContentAnchor> {
        self.position(name).ok().map(|at| &self.anchors[at])
    }

    /// Adds an anchor, or replaces the one of its name. An error changes nothing.
    ///
    /// # Errors
    /// [`ContentAnchorError`].
    pub fn set(&mut self, anchor: ContentAnchor) -> Result<(), ContentAnchorError> {
        let mut all = self.anchors.clone();
        match self.position(&anchor.name) {
            Ok(at) => all[at] = anchor,
            Err(at) => all.insert(at, anchor),
        }
        self.replace(all)
    }

    /// Adds anchors. An error changes nothing.
    ///
    /// # Errors
    /// [`ContentAnchorError`]; [`ContentAnchorError::NameTwice`] if there is an anchor of one of the names.
    pub fn extend(&mut self, others: &[ContentAnchor]) -> Result<(), ContentAnchorError> {
        self.replace([&self.anchors, others].concat())
    }

    /// Removes the anchor of this name; whether there was one.
    pub fn remove(&mut self, name: &str) -> bool {
        self.position(name).map(|at| self.anchors.remove(at)).is_ok()
    }

    /// Gives every anchor another pose. An error changes nothing.
    ///
    /// # Errors
    /// [`ContentAnchorError`]: a new pose is out of bounds.
    pub fn transform(&mut self, new: impl Fn(&AnchorPose) -> AnchorPose) -> Result<(), ContentAnchorError> {
        let moved = |anchor: &ContentAnchor| ContentAnchor {
            map_from_anchor: new(&anchor.map_from_anchor),
            ..anchor.clone()
        };
        self.replace(self.anchors.iter().map(moved).collect())
    }

    /// All with their distances from a place in the map, the nearest first. For devices, which know where they are: the service
    /// need not learn it.
    pub fn nearest(&self, place: [f64; 3]) -> Vec<(&ContentAnchor, f64)> {
        let mut all: Vec<_> = self.anchors.iter().map(|anchor| (anchor, anchor.distance(place))).collect();
        all.sort_by(|a, b| a.1.total_cmp(&b.1));
        all
    }

    /// What a client gets: no images, and owners only where this is true.
    #[must_use]
    pub fn for_client(mut self, shows: impl Fn(&str) -> bool) -> Self {
        self.images.clear();
        for anchor in &mut self.anchors {
            anchor.owner = anchor.owner.take().filter(|owner| shows(owner));
        }
        self
    }

    /// The recorded images.
    pub fn images(&self) -> &[FrameImage] {
        &self.images
    }

    /// Records the coordinate frame of a map by images of it, evenly spaced.
    pub fn set_frame<'a>(&mut self, images: impl ExactSizeIterator<Item = (&'a str, &'a CameraFromWorld)>) {
        let step = images.len().div_ceil(Self::FRAME_IMAGES).max(1);
        let record = |(name, pose): (&str, &CameraFromWorld)| FrameImage {
            name: name.to_owned(),
            cam_from_world: PoseDocument::of(pose),
        };
        let named = images.step_by(step).filter(|(name, _)| name.len() <= Self::FRAME_NAME);
        self.images = named.map(record).collect();
    }

    /// Whether the anchors are of the coordinate frame of a map with these images: at least one recorded image is among them,
    /// and all that are have the recorded pose. A document without images, or a map without, says nothing against it.
    pub fn is_of_frame<'a>(
        &self,
        images: impl ExactSizeIterator<Item = (&'a str, &'a CameraFromWorld)>,
    ) -> bool {
        if self.images.is_empty() || images.len() == 0 {
            return true;
        }
        let recorded = |name: &str| self.images.iter().find(|image| image.name == name);
        let mut common = images
            .filter_map(|(name, now)| Some((recorded(name)?.cam_from_world.pose(), now)))
            .map(|(then, now)| {
                then.is_some_and(|then| {
                    // The file of a map and this document keep the same numbers up to rounding.
                    let size = now.translation().norm().max(then.translation().norm()).max(1.0);
                    then.rotation_error_degrees(now) <= 1e-4
                        && (then.translation() - now.translation()).norm() <= 1e-6 * size
                })
            })
            .peekable();
        common.peek().is_some() && common.all(|is_same| is_same)
    }

    fn position(&self, name: &str) -> Result<usize, usize> {
        self.anchors.binary_search_by(|anchor| anchor.name.as_str().cmp(name))
    }

    /// Takes these anchors in place of its own, if they are valid.
    fn replace(&mut self, anchors: Vec<ContentAnchor>) -> Result<(), ContentAnchorError> {
        if anchors.len() > Self::MAX_ANCHORS {
            return Err(ContentAnchorError::TooMany);
        }
        let mut anchors: Vec<_> =
            anchors.into_iter().map(ContentAnchor::checked).collect::<Result<_, _>>()?;
        anchors.sort_by(|a, b| a.name.cmp(&b.name));
        if anchors.windows(2).any(|two| two[0].name == two[1].name) {
            return Err(ContentAnchorError::NameTwice);
        }
        let new = Self { anchors, ..Self::default() };
        if new.encode().len() > Self::MAX_BYTES {
            return Err(ContentAnchorError::TooLong);
        }
        self.anchors = new.anchors;
        Ok(())
    }
}

/// Reads JSON of at most this length.
fn parse<'a, T: Deserialize<'a>>(json: &'a [u8], limit: usize) -> Result<T, ContentAnchorError> {
    if json.len() > limit {
        let is_document = limit == ContentAnchors::MAX_FILE;
        return Err(if is_document { ContentAnchorError::TooLong } else { ContentAnchorError::Content });
    }
    serde_json::from_slice(json)
        .map_err(|error| ContentAnchorError::Json { line: error.line(), column: error.column() })
}

/// How far the length of a quaternion may be from 1: quaternions of single precision and of few digits are rotations.
const MAX_LENGTH_ERROR: f64 = 1e-3;
/// Largest coordinate, map units: ten thousand kilometres in metres.
const MAX_COORDINATE: f64 = 1e7;

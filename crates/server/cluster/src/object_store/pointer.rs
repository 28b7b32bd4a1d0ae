//! The pointer: names the current manifest of a map.

use serde::{Deserialize, Serialize};
use veiloc_map::is_map_name;
use veiloc_map::regions::ObjectId;

/// Names the current manifest of a map: the only file in storage that changes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ManifestPointer {
    version: u32,
    /// Name of the map.
    pub map: String,
    /// Id of its manifest.
    pub manifest: ObjectId,
}

const VERSION: u32 = 1;

impl ManifestPointer {
    /// Maximum length, bytes.
    pub(crate) const MAX_BYTES: u64 = 4096;

    /// A pointer to this manifest of this map.
    pub fn new(map: &str, manifest: ObjectId) -> Self {
        Self { version: VERSION, map: map.to_owned(), manifest }
    }

    /// Parses the pointer of a map.
    ///
    /// # Errors
    /// The reason: invalid, of another version, or of another map.
    pub fn decode(bytes: &[u8], map: &str) -> Result<Self, String> {
        let Head { version } =
            serde_json::from_slice(bytes).map_err(|error| format!("no pointer: {error}"))?;
        if version != VERSION {
            return Err(format!(
                "a pointer of version {version}, but this program reads version {VERSION}: publish the map again with this \
                 program, or use the one that published it"
            ));
        }
        let pointer: Self = serde_json::from_slice(bytes).map_err(|error| format!("no pointer: {error}"))?;
        if pointer.map != map || !is_map_name(&pointer.map) {
            return Err(format!("the pointer belongs to map {:?}, expected {map:?}", pointer.map));
        }
        Ok(pointer)
    }

    /// As JSON.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = serde_json::to_vec_pretty(self).expect("text and a number");
        bytes.push(b'\n');
        bytes
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

    #[test]
    fn pointer_checks_map_and_version() {
        let pointer = ManifestPointer::new("kitchen", ObjectId::of(b"manifest"));
        let bytes = pointer.encode();
        assert_eq!(ManifestPointer::decode(&bytes, "kitchen"), Ok(pointer));
        assert!(ManifestPointer::decode(&bytes, "hall").unwrap_err().contains("\"kitchen\""));
        let text = String::from_utf8(bytes).unwrap();
        let newer = text.replace("\"version\": 1", "\"version\": 2, \"more\": 3");
        assert!(ManifestPointer::decode(newer.as_bytes(), "kitchen").unwrap_err().contains("version 2"));
        for wrong in [
            text.replace("kitchen", "../kitchen"),
            text.replace("\"map\"", "\"more\": 1, \"map\""),
            String::new(),
        ] {
            assert!(ManifestPointer::decode(wrong.as_bytes(), "kitchen").is_err(), "{wrong}");
        }
        let outside = text.replace(&ObjectId::of(b"manifest").to_string(), "../../secret");
        assert!(ManifestPointer::decode(outside.as_bytes(), "kitchen").is_err());
    }
}

//! The pointer: which manifest of a map is the current one.

use serde::{Deserialize, Serialize};
use veiloc_map::is_map_name;
use veiloc_map::regions::ObjectId;

/// Names the current manifest of a map: the one thing in storage that changes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pointer {
    version: u32,
    /// Name of the map.
    pub map: String,
    /// Id of its manifest.
    pub manifest: ObjectId,
}

const VERSION: u32 = 1;

impl Pointer {
    /// The longest that is read, bytes.
    pub(crate) const MOST_BYTES: u64 = 4096;

    /// To this manifest of this map.
    pub fn new(map: &str, manifest: ObjectId) -> Self {
        Self { version: VERSION, map: map.to_owned(), manifest }
    }

    /// Reads the pointer of a map.
    ///
    /// # Errors
    /// What is wrong with it: no pointer, of another version, or of another map.
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
            return Err(format!("the pointer of {:?}, where that of {map:?} should be", pointer.map));
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

/// What every version has.
#[derive(Deserialize)]
struct Head {
    version: u32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_of_one_map_and_one_version() {
        let pointer = Pointer::new("kitchen", ObjectId::of(b"manifest"));
        let bytes = pointer.encode();
        assert_eq!(Pointer::decode(&bytes, "kitchen"), Ok(pointer));
        assert!(Pointer::decode(&bytes, "hall").unwrap_err().contains("\"kitchen\""));
        let text = String::from_utf8(bytes).unwrap();
        let newer = text.replace("\"version\": 1", "\"version\": 2, \"more\": 3");
        assert!(Pointer::decode(newer.as_bytes(), "kitchen").unwrap_err().contains("version 2"));
        for wrong in [
            text.replace("kitchen", "../kitchen"),
            text.replace("\"map\"", "\"more\": 1, \"map\""),
            String::new(),
        ] {
            assert!(Pointer::decode(wrong.as_bytes(), "kitchen").is_err(), "{wrong}");
        }
        let elsewhere = text.replace(&ObjectId::of(b"manifest").to_string(), "../../secret");
        assert!(Pointer::decode(elsewhere.as_bytes(), "kitchen").is_err());
    }
}

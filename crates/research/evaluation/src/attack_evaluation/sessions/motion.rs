//! Motion between the frames of an attack.

use std::fmt;
use std::str::FromStr;

use super::super::names::{UnknownName, find};

/// Motion between the frames of an attack.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Motion {
    /// The most informative frames of the trajectory: large rotation, small translation.
    Turning,
    /// Consecutive frames.
    Walking,
    /// Frames of a stationary camera.
    Static,
    /// As turning, but each frame has a session of its own: other users, other days.
    Visiting,
}

impl Motion {
    const WORDS: [(Self, &str); 4] = [
        (Self::Turning, "turning"),
        (Self::Walking, "walking"),
        (Self::Static, "static"),
        (Self::Visiting, "visiting"),
    ];
}

impl fmt::Display for Motion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(Self::WORDS.iter().find(|w| w.0 == *self).map_or("", |w| w.1))
    }
}

impl FromStr for Motion {
    type Err = UnknownName;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        find(text, "a motion", Self::WORDS, |word| word.1).map(|word| word.0)
    }
}

#[cfg(test)]
mod tests {
    use super::Motion;

    #[test]
    fn motions_round_trip() {
        for (motion, word) in Motion::WORDS {
            assert_eq!((word.parse(), motion.to_string()), (Ok(motion), word.to_owned()));
        }
        let refused = "flying".parse::<Motion>().expect_err("no motion");
        assert!(Motion::WORDS.iter().all(|w| refused.to_string().contains(w.1)), "{refused}");
    }
}

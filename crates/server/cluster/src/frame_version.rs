//! Versions of frames, and which of them two machines speak with each other.
//!
//! A frame of one version may get further fields, as long as a program that does not know a field can do without it. When that
//! is impossible, the version rises by one, and the program speaks the version before as well for one release. So each
//! release works with the one before it and the one after it (decision 0056).

use std::fmt;

use crate::ClusterError;

/// The newest version of frames that this program writes and reads.
pub const VERSION: u32 = 2;

/// The oldest version that it writes and reads.
pub const OLDEST_VERSION: u32 = 2;

/// The versions that a machine speaks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct FrameVersions {
    oldest: u32,
    newest: u32,
}

impl FrameVersions {
    /// Those of this program.
    pub const OWN: Self = Self { oldest: OLDEST_VERSION, newest: VERSION };

    /// From the oldest to the newest; `None` if that is older than the oldest, or if there is a version 0.
    pub const fn new(oldest: u32, newest: u32) -> Option<Self> {
        if oldest == 0 || newest < oldest { None } else { Some(Self { oldest, newest }) }
    }

    /// The newest version that both machines speak.
    pub fn common(self, other: Self) -> Option<u32> {
        let newest = self.newest.min(other.newest);
        (newest >= self.oldest.max(other.oldest)).then_some(newest)
    }

    /// The oldest one.
    pub const fn oldest(self) -> u32 {
        self.oldest
    }

    /// The newest one.
    pub const fn newest(self) -> u32 {
        self.newest
    }
}

/// `2`, or `2 to 3`.
impl fmt::Display for FrameVersions {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.oldest == self.newest {
            write!(f, "{}", self.oldest)
        } else {
            write!(f, "{} to {}", self.oldest, self.newest)
        }
    }
}

/// Checks the version of a frame.
pub(crate) const fn check_version(found: u32) -> Result<(), ClusterError> {
    if found >= OLDEST_VERSION && found <= VERSION {
        Ok(())
    } else {
        Err(ClusterError::FrameVersion { found })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn machines_speak_the_newest_common_version() {
        let versions = |oldest, newest| FrameVersions::new(oldest, newest).expect("a range");
        for (one, other, common) in [
            ((2, 2), (2, 2), Some(2)),
            // A release and the next one, which speaks its version too.
            ((2, 2), (2, 3), Some(2)),
            ((2, 3), (3, 4), Some(3)),
            ((2, 3), (2, 3), Some(3)),
            // A release and the one after the next.
            ((1, 2), (3, 4), None),
            ((2, 2), (3, 3), None),
        ] {
            let (one, other) = (versions(one.0, one.1), versions(other.0, other.1));
            assert_eq!((one.common(other), other.common(one)), (common, common), "{one} and {other}");
        }
        assert_eq!((FrameVersions::new(0, 2), FrameVersions::new(3, 2)), (None, None));
        assert_eq!(versions(2, 2).to_string(), "2");
        assert_eq!(versions(2, 3).to_string(), "2 to 3");
        assert_eq!(FrameVersions::OWN.common(FrameVersions::OWN), Some(VERSION));
    }
}

//! The number of rows of a sealed query: one of five (rule L5).

use crate::QueryError;

/// The number of rows of a sealed query. The number of keypoints reveals information about an image; one of five
/// numbers reveals much less, and gives all messages of a class equal length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum SizeClass {
    /// 256 rows; decoys fill up images with fewer keypoints.
    Rows256,
    /// 512 rows.
    Rows512,
    /// 1024 rows.
    Rows1024,
    /// 2048 rows.
    Rows2048,
    /// 4096 rows.
    Rows4096,
}

impl SizeClass {
    /// All classes, smallest first.
    pub const ALL: [Self; 5] = [Self::Rows256, Self::Rows512, Self::Rows1024, Self::Rows2048, Self::Rows4096];
    /// The class that images with fewer keypoints are filled up to.
    pub const SMALLEST: Self = Self::Rows256;

    /// Number of rows.
    pub const fn rows(self) -> usize {
        match self {
            Self::Rows256 => 256,
            Self::Rows512 => 512,
            Self::Rows1024 => 1024,
            Self::Rows2048 => 2048,
            Self::Rows4096 => 4096,
        }
    }

    /// The class with exactly this many rows.
    pub fn from_rows(rows: usize) -> Option<Self> {
        Self::ALL.into_iter().find(|class| class.rows() == rows)
    }

    /// The class of an image with this many usable keypoints: the largest not above the count, or the smallest class
    /// when there are fewer (decoys fill up the rest).
    pub fn for_count(count: usize) -> Self {
        Self::ALL.into_iter().rev().find(|class| class.rows() <= count).unwrap_or(Self::SMALLEST)
    }

    pub(crate) fn from_wire(rows: u32) -> Result<Self, QueryError> {
        Self::from_rows(rows as usize).ok_or(QueryError::Field {
            field: "rows",
            value: rows,
            allowed: "256, 512, 1024, 2048 or 4096",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_by_count() {
        for (count, rows) in [
            (0, 256),
            (255, 256),
            (256, 256),
            (511, 256),
            (512, 512),
            (1023, 512),
            (1024, 1024),
            (2047, 1024),
            (4095, 2048),
            (4096, 4096),
            (usize::MAX, 4096),
        ] {
            assert_eq!(SizeClass::for_count(count).rows(), rows, "{count}");
        }
        assert_eq!(SizeClass::from_rows(300), None);
    }
}

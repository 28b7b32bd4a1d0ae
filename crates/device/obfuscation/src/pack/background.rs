//! The background: descriptors of anywhere, against which a row is measured.

use std::sync::LazyLock;

use veiloc_descriptor::{DescriptorKind, Descriptors, SearchedRows};
use veiloc_features::compact;

use super::KnownPlace;
use crate::SealError;

/// Compact descriptors of photographs that may be used by anyone (`BACKGROUND.md` names them).
static BACKGROUND: LazyLock<SearchedRows> = LazyLock::new(|| {
    let rows = Descriptors::from_packed(DescriptorKind::COMPACT, include_bytes!("background.bin"));
    SearchedRows::new(rows.expect("a test reads it").view())
});

/// Where a row lies between place and background.
pub(super) struct Explanation {
    pub(super) ratio: f32,
    /// The nearest row of the pack.
    pub(super) nearest: usize,
}

/// The rows as the background has them; `None` for a kind that cannot be converted.
pub(super) fn comparable(rows: &Descriptors) -> Option<Descriptors> {
    match rows.kind() {
        DescriptorKind::COMPACT => Some(rows.clone().as_decoded()),
        DescriptorKind::ROOT_SIFT => Some(compact(rows)),
        _ => None,
    }
}

impl KnownPlace {
    pub(super) fn explain(&self, rows: &Descriptors) -> Result<Vec<Explanation>, SealError> {
        let comparable =
            comparable(rows).ok_or_else(|| SealError::PackKind { kind: rows.kind().name().to_owned() })?;
        let there = self.0.rows.two_nearest(comparable.view());
        let elsewhere = BACKGROUND.two_nearest(comparable.view());
        let both = there.into_iter().flatten().zip(elsewhere.into_iter().flatten());
        let explanation = both.map(|(there, elsewhere)| {
            let [place, background] = [there, elsewhere].map(|two| f64::from(two.nearest.distance));
            // A row of the background itself is not of the place.
            let ratio = if background > 0.0 { (place / background).sqrt() } else { f64::INFINITY };
            Explanation { ratio: ratio as f32, nearest: there.nearest.index as usize }
        });
        Ok(explanation.collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn background_is_whole() {
        let rows = Descriptors::from_packed(DescriptorKind::COMPACT, include_bytes!("background.bin"));
        let rows = rows.expect("whole rows");
        assert_eq!(rows.len(), 20_480);
        let length = |row| rows.view().values(row).map(|v| f64::from(v).powi(2)).sum::<f64>().sqrt();
        let norm = f64::from(DescriptorKind::COMPACT.norm());
        // Compact descriptors are not scaled to one length.
        assert!((0..rows.len()).all(|row| (0.5..1.6).contains(&(length(row) / norm))));
    }
}

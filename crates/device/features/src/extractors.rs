//! The extractors of a program, by name and by kind.

use std::sync::Arc;

use veiloc_descriptor::DescriptorKind;

use crate::{Compact, Extractor, FeatureError, Sift};

/// The extractors of a program.
#[derive(Clone)]
pub struct Extractors(Vec<Arc<dyn Extractor>>);

impl std::fmt::Debug for Extractors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Extractors({})", self.names())
    }
}

/// Equal when they make the same kinds of descriptors.
impl PartialEq for Extractors {
    fn eq(&self, other: &Self) -> bool {
        self.0.iter().map(|e| e.kind()).eq(other.0.iter().map(|e| e.kind()))
    }
}

/// The built-in ones: SIFT, and SIFT with compact descriptors.
impl Default for Extractors {
    fn default() -> Self {
        Self(vec![Arc::new(Sift::default()), Arc::new(Compact::default())])
    }
}

impl Extractors {
    /// Default features of new maps, and of images without a map: compact descriptors have a quarter of RootSIFT's
    /// bytes at the same recall and accuracy (`docs/results/features.md`).
    pub const DEFAULT: &'static str = "compact";

    /// The built-in ones as a device uses them for sealing ([`Sift::for_sealing`], [`Compact::for_sealing`]).
    pub fn for_sealing() -> Self {
        Self(vec![Arc::new(Sift::for_sealing()), Arc::new(Compact::for_sealing())])
    }

    /// These as a device uses them for sealing: the built-in ones as in [`Self::for_sealing`]; the others, and stored
    /// features, unchanged.
    #[must_use]
    pub fn sealing(&self) -> Self {
        let own = Self::for_sealing();
        let of = |e: &Arc<dyn Extractor>| {
            let known = own.0.iter().find(|own| own.kind() == e.kind() && e.stored().is_none());
            Arc::clone(known.unwrap_or(e))
        };
        Self(self.0.iter().map(of).collect())
    }

    /// These and one more, which replaces one with the same name.
    #[must_use]
    pub fn with(mut self, extractor: impl Extractor + 'static) -> Self {
        let kind = extractor.kind();
        self.0.retain(|known| known.kind().name() != kind.name());
        self.0.push(Arc::new(extractor));
        self
    }

    /// The extractor with this name, as on the command line.
    ///
    /// # Errors
    /// [`FeatureError::UnknownKind`] with the available names.
    pub fn named(&self, name: &str) -> Result<&dyn Extractor, FeatureError> {
        let found = self.0.iter().find(|extractor| extractor.kind().name() == name);
        found.map(AsRef::as_ref).ok_or_else(|| self.unknown(name))
    }

    /// [`Self::named`], shared.
    ///
    /// # Errors
    /// As [`Self::named`].
    pub fn shared(&self, name: &str) -> Result<Arc<dyn Extractor>, FeatureError> {
        let found = self.0.iter().find(|extractor| extractor.kind().name() == name);
        found.cloned().ok_or_else(|| self.unknown(name))
    }

    /// The extractor for exactly this kind, as a map or a profile requests it.
    ///
    /// # Errors
    /// [`FeatureError::UnknownKind`], also for a known name with other parameters.
    pub fn of_kind(&self, kind: DescriptorKind) -> Result<&dyn Extractor, FeatureError> {
        let found = self.0.iter().find(|extractor| extractor.kind() == kind);
        found.map(AsRef::as_ref).ok_or_else(|| self.unknown(&format!("{kind:?}")))
    }

    fn unknown(&self, requested: &str) -> FeatureError {
        // The requested name may come from a file or a server.
        FeatureError::UnknownKind { requested: requested.chars().take(80).collect(), known: self.names() }
    }

    /// Their names, separated by commas.
    pub fn names(&self) -> String {
        self.0.iter().map(|e| e.kind().name().to_owned()).collect::<Vec<_>>().join(", ")
    }
}

//! Descriptors as rows of bytes, for extraction, messages and storage.

use crate::{DescriptorError, DescriptorKind};

/// Descriptors of one image, `[N, dim]`, row by row.
#[derive(Clone, PartialEq, Eq)]
pub struct Descriptors {
    kind: DescriptorKind,
    bytes: Vec<u8>,
}

// Descriptors reveal the content of an image: only their number may be logged (leak L8).
impl std::fmt::Debug for Descriptors {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Descriptors({}, {})", self.kind, self.len())
    }
}

impl Descriptors {
    /// From consecutive rows.
    ///
    /// # Errors
    /// [`DescriptorError::Length`] when the bytes are not whole rows.
    pub fn new(kind: DescriptorKind, bytes: Vec<u8>) -> Result<Self, DescriptorError> {
        DescriptorView::new(kind, &bytes)?;
        Ok(Self { kind, bytes })
    }

    /// No descriptors.
    pub const fn empty(kind: DescriptorKind) -> Self {
        Self { kind, bytes: Vec::new() }
    }

    /// Borrows all rows.
    pub fn view(&self) -> DescriptorView<'_> {
        DescriptorView { kind: self.kind, bytes: &self.bytes }
    }

    /// Their kind.
    pub const fn kind(&self) -> DescriptorKind {
        self.kind
    }

    /// Number of descriptors.
    pub const fn len(&self) -> usize {
        self.bytes.len() / self.kind.dim()
    }

    /// True when there are none.
    pub const fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// The bytes of descriptor `index`, `[dim]`.
    pub fn row(&self, index: usize) -> &[u8] {
        self.view().row(index)
    }

    /// The selected rows, in the given order.
    pub fn select(&self, indices: impl IntoIterator<Item = usize>) -> Self {
        let bytes = indices.into_iter().flat_map(|i| self.row(i).iter().copied()).collect();
        Self { kind: self.kind, bytes }
    }

    /// Appends one row; its length must be `dim`.
    ///
    /// # Errors
    /// [`DescriptorError::Length`] for another length.
    pub fn push(&mut self, row: &[u8]) -> Result<(), DescriptorError> {
        if row.len() != self.kind.dim() {
            return Err(DescriptorError::Length { bytes: row.len(), dim: self.kind.dim() });
        }
        self.bytes.extend_from_slice(row);
        Ok(())
    }

    /// All rows, consecutive.
    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes
    }
}

/// Borrowed descriptors, for example of a map file; `[N, dim]`, row by row.
#[derive(Clone, Copy)]
pub struct DescriptorView<'a> {
    kind: DescriptorKind,
    bytes: &'a [u8],
}

impl std::fmt::Debug for DescriptorView<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "DescriptorView({}, {})", self.kind, self.len())
    }
}

impl<'a> DescriptorView<'a> {
    /// Borrows consecutive rows.
    ///
    /// # Errors
    /// [`DescriptorError::Length`] when the bytes are not whole rows.
    pub fn new(kind: DescriptorKind, bytes: &'a [u8]) -> Result<Self, DescriptorError> {
        if !bytes.len().is_multiple_of(kind.dim()) {
            return Err(DescriptorError::Length { bytes: bytes.len(), dim: kind.dim() });
        }
        Ok(Self { kind, bytes })
    }

    /// Their kind.
    pub const fn kind(&self) -> DescriptorKind {
        self.kind
    }

    /// Number of descriptors.
    pub const fn len(&self) -> usize {
        self.bytes.len() / self.kind.dim()
    }

    /// True when there are none.
    pub const fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// The bytes of descriptor `index`, `[dim]`.
    pub fn row(&self, index: usize) -> &'a [u8] {
        let dim = self.kind.dim();
        &self.bytes[index * dim..(index + 1) * dim]
    }

    /// The numbers of descriptor `index`, `[dim]`, decoded from its bytes.
    pub fn values(&self, index: usize) -> impl Iterator<Item = i16> + use<'a> {
        let encoding = self.kind.encoding();
        self.row(index).iter().map(move |byte| encoding.value(*byte))
    }

    /// Rows `range`.
    pub fn rows(&self, range: std::ops::Range<usize>) -> Self {
        let dim = self.kind.dim();
        Self { kind: self.kind, bytes: &self.bytes[range.start * dim..range.end * dim] }
    }

    /// All rows, consecutive.
    pub const fn as_bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// A copy that owns its rows.
    pub fn to_owned(&self) -> Descriptors {
        Descriptors { kind: self.kind, bytes: self.bytes.to_vec() }
    }
}

//! A few large numbers at the head of a page.

/// A large number with what it means.
#[derive(Debug, Clone, Default)]
pub struct Card {
    /// With its unit, `"1.2 cm"`.
    pub value: String,
    /// What it is, a few words.
    pub label: String,
    /// One sentence for laypeople.
    pub note: String,
}

//! What a caller may say beside a sealed query.

use veiloc_protocol::PositionHint;

/// What a caller may say beside a sealed query. The default says nothing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct LocalizeRequest {
    /// A doubtful pose is withheld: the answer has its doubts and no pose. It holds of services too that know nothing of
    /// it.
    pub trusted_only: bool,
    /// Where the camera roughly is. It tells the service that much even when no pose is found (`docs/reference/privacy-rules.md`).
    pub near: Option<PositionHint>,
}

impl LocalizeRequest {
    /// As headers of a request. Without wishes there are none.
    pub(crate) fn headers(&self) -> Vec<(&'static str, String)> {
        let trusted_only = self.trusted_only.then(|| ("veiloc-trusted-only", "true".to_owned()));
        let near = self.near.map(|near| ("veiloc-near", near.to_string()));
        trusted_only.into_iter().chain(near).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nothing leaves the device that the caller does not say.
    #[test]
    fn the_default_says_nothing() {
        assert!(LocalizeRequest::default().headers().is_empty());
        let near = Some("1,2,3,0.5".parse().expect("a place"));
        let told = LocalizeRequest { trusted_only: true, near }.headers();
        let names: Vec<&str> = told.iter().map(|(name, _)| *name).collect();
        assert_eq!(names, ["veiloc-trusted-only", "veiloc-near"]);
        assert_eq!(told[1].1.parse().ok(), near);
    }
}

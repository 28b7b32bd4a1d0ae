//! Options of a request beside its sealed query.

use veiloc_protocol::PositionHint;

/// Options of a request beside its sealed query. By default none is sent.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub struct LocalizeRequest {
    /// Withhold doubtful poses: the answer then has its doubts and no pose. The client enforces this also for services
    /// that do not know the option.
    pub trusted_only: bool,
    /// Approximate position of the camera. It reveals that position to the service even when no pose is found
    /// (`docs/reference/privacy-rules.md`).
    pub near: Option<PositionHint>,
}

impl LocalizeRequest {
    /// As headers of a request; empty by default.
    pub(crate) fn headers(&self) -> Vec<(&'static str, String)> {
        let trusted_only = self.trusted_only.then(|| ("veiloc-trusted-only", "true".to_owned()));
        let near = self.near.map(|near| ("veiloc-near", near.to_string()));
        trusted_only.into_iter().chain(near).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The device sends no option that the caller did not set.
    #[test]
    fn default_request_has_no_option_headers() {
        assert!(LocalizeRequest::default().headers().is_empty());
        let near = Some("1,2,3,0.5".parse().expect("a place"));
        let headers = LocalizeRequest { trusted_only: true, near }.headers();
        let names: Vec<&str> = headers.iter().map(|(name, _)| *name).collect();
        assert_eq!(names, ["veiloc-trusted-only", "veiloc-near"]);
        assert_eq!(headers[1].1.parse().ok(), near);
    }
}

//! What the response of a worker means for a query.

use std::num::NonZeroU64;

use reqwest::{Response, StatusCode};
use serde::Deserialize;
use veiloc_protocol::Answer;
use veiloc_service::{LocalizeFailure, NoPose};

/// The reply of a worker.
pub(super) enum Reply {
    /// The pose, or why there is none; another worker would say the same.
    Decided(Box<Result<Answer, LocalizeFailure>>),
    /// The worker cannot answer now; another one may.
    Busy(NonZeroU64),
    /// The worker is stopping; another one may answer.
    Stopping,
    /// The worker does not accept this request; another one may.
    Refused(String),
    /// It could not be reached, or sent something else.
    Failed(String),
}

/// Maximum length of a response, bytes; answers have 4 kB.
const MAX_BYTES: usize = 1 << 16;

/// The fields of a refusal that are needed here (RFC 9457).
#[derive(Deserialize)]
struct Refusal {
    #[serde(rename = "type")]
    kind: String,
    #[serde(default)]
    detail: String,
    #[serde(default)]
    retry_after: Option<NonZeroU64>,
}

impl Reply {
    fn decided(result: Result<Answer, LocalizeFailure>) -> Self {
        Self::Decided(Box::new(result))
    }

    /// Reads a response.
    pub(super) async fn read(response: reqwest::Result<Response>) -> Self {
        let mut response = match response {
            Ok(response) => response,
            Err(error) => return Self::Failed(reason(&error)),
        };
        let status = response.status();
        let mut bytes = Vec::new();
        loop {
            match response.chunk().await {
                Ok(Some(piece)) if bytes.len() + piece.len() <= MAX_BYTES => bytes.extend_from_slice(&piece),
                Ok(Some(_)) => return Self::Failed(format!("a response of more than {MAX_BYTES} bytes")),
                Ok(None) => break,
                Err(error) => return Self::Failed(reason(&error)),
            }
        }
        Self::of(status, &bytes)
    }

    fn of(status: StatusCode, bytes: &[u8]) -> Self {
        if status == StatusCode::OK {
            return match Answer::decode(bytes) {
                Ok(answer) => Self::decided(Ok(answer)),
                Err(error) => Self::Failed(format!("an answer that cannot be read: {error}")),
            };
        }
        let Ok(refusal) = serde_json::from_slice::<Refusal>(bytes) else {
            // Not of a service: a balancer without a worker, for example.
            return Self::Failed(format!("status {}", status.as_u16()));
        };
        let kind = refusal.kind.strip_prefix("urn:veiloc:problem:").unwrap_or_default();
        match kind {
            "not-localized" => Self::decided(Err(LocalizeFailure::NoPose(no_pose(&refusal.detail)))),
            "wrong-profile" => Self::decided(Err(LocalizeFailure::WrongProfile)),
            "empty-map" => Self::decided(Err(LocalizeFailure::EmptyMap)),
            "queue-full" | "overdue" | "rate-limited" => {
                Self::Busy(refusal.retry_after.unwrap_or(NonZeroU64::MIN))
            }
            "stopping" => Self::Stopping,
            _ => Self::Refused(format!("{kind}: {}", refusal.detail)),
        }
    }
}

/// The reason without the address, which log lines have already.
fn reason(error: &reqwest::Error) -> String {
    let mut cause: &dyn std::error::Error = error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    cause.to_string()
}

/// Refusals say it in words only.
fn no_pose(detail: &str) -> NoPose {
    match detail {
        _ if detail.contains("run through one anchor") => NoPose::OneSided,
        _ if detail.contains("too few of its rows") => NoPose::TooFew,
        _ => NoPose::Unsupported,
    }
}

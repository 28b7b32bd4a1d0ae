//! Reads request bodies with a size limit and a time limit.

use std::time::Duration;

use axum::body::{Body, HttpBody as _};
use axum::http::HeaderMap;
use axum::http::header::EXPECT;
use http_body_util::BodyExt as _;

use crate::http::problem::Problem;

/// Maximum number of bytes that are read and discarded.
const MAX_DRAINED: usize = 4 << 20;

/// Reads the whole body.
pub(super) async fn read(body: &mut Body, limit: usize, time: Duration) -> Result<Vec<u8>, Problem> {
    if body.size_hint().lower() > limit as u64 {
        return Err(Problem::TooLarge { limit });
    }
    let all = async {
        let mut bytes = Vec::new();
        while let Some(frame) = body.frame().await {
            let frame = frame.map_err(|_| Problem::Interrupted)?;
            let Ok(data) = frame.into_data() else { continue };
            if bytes.len() + data.len() > limit {
                return Err(Problem::TooLarge { limit });
            }
            bytes.extend_from_slice(&data);
        }
        Ok(bytes)
    };
    tokio::time::timeout(time, all).await.unwrap_or(Err(Problem::TooSlow { seconds: time.as_secs().max(1) }))
}

/// Reads and discards the rest of the body of a refused request.
///
/// If the server closes a connection while the client still writes, the client's system discards the response that it
/// has not read. So the response is sent after the body, unless the client waits for `100 Continue`.
pub(super) async fn drain(mut body: Body, headers: &HeaderMap, time: Duration) {
    if headers.contains_key(EXPECT) {
        return;
    }
    let all = async {
        let mut drained = 0;
        while let Some(Ok(frame)) = body.frame().await {
            drained += frame.data_ref().map_or(0, |data| data.len());
            if drained > MAX_DRAINED {
                break;
            }
        }
    };
    // A client that is too slow is not waited for any longer.
    let _ = tokio::time::timeout(time, all).await;
}

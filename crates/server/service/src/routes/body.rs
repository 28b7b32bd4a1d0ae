//! Reading a body: at most so many bytes, within so much time.

use std::time::Duration;

use axum::body::{Body, HttpBody as _};
use axum::http::HeaderMap;
use axum::http::header::EXPECT;
use http_body_util::BodyExt as _;

use crate::problem::Problem;

/// Most bytes that are read only to be thrown away.
const MAX_DRAINED: usize = 4 << 20;

/// The whole body.
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

/// Reads what is left of a body whose request was refused, without keeping it.
///
/// Closing a connection while the other side still writes makes its system throw away the answer it has not read yet.
/// So the answer comes after the body, unless the client waits to be told whether to send it.
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
    // Too slow to be told in comfort is no reason to wait longer.
    let _ = tokio::time::timeout(time, all).await;
}

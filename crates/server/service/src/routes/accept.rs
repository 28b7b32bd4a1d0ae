//! The format of an answer, from the `Accept` header.

use axum::http::HeaderMap;
use axum::http::header::ACCEPT;

/// Format of an answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum AnswerFormat {
    Json,
    Protobuf,
}

impl AnswerFormat {
    pub(super) const fn content_type(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Protobuf => "application/x-protobuf",
        }
    }

    /// Protobuf if the client names it with a weight above 0, otherwise JSON.
    pub(super) fn negotiate(headers: &HeaderMap) -> Self {
        let is_protobuf = |range: &str| {
            let (name, parameters) = range.split_once(';').unwrap_or((range, ""));
            let weight = parameters.split(';').find_map(|part| part.trim().strip_prefix("q="));
            name.trim().eq_ignore_ascii_case(Self::Protobuf.content_type())
                && weight.is_none_or(|weight| weight.trim().parse::<f32>().is_ok_and(|q| q > 0.0))
        };
        let values = headers.get_all(ACCEPT).into_iter().filter_map(|value| value.to_str().ok());
        if values.flat_map(|value| value.split(',')).any(is_protobuf) { Self::Protobuf } else { Self::Json }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn protobuf_is_sent_to_clients_that_name_it() {
        let chosen = |accept: &[&str]| {
            let mut headers = HeaderMap::new();
            for value in accept {
                headers.append(ACCEPT, value.parse().expect("a header"));
            }
            AnswerFormat::negotiate(&headers)
        };
        for accept in
            ["", "*/*", "text/html", "application/x-protobuf;q=0", "application/x-protobuf;q=NaN", ";;=,q=,;"]
        {
            assert_eq!(chosen(&[accept]), AnswerFormat::Json, "{accept:?}");
        }
        for accept in [
            "application/x-protobuf",
            "Application/X-Protobuf; charset=\"x\"",
            "*/*, application/x-protobuf; q=0.9",
        ] {
            assert_eq!(chosen(&[accept]), AnswerFormat::Protobuf, "{accept:?}");
        }
        assert_eq!(chosen(&[]), AnswerFormat::Json);
        assert_eq!(chosen(&["text/html", "application/x-protobuf"]), AnswerFormat::Protobuf);
    }
}

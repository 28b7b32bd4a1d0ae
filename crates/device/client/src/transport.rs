//! One request, and sending it again: the same bytes, until the service answers or refuses for good (rule L7).

use std::sync::Arc;
use std::time::Duration;

use ureq::http::Response;
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};
use ureq::{Agent, Body};

use crate::address::Address;
use crate::refusal::{Refusal, printable};
use crate::{ClientError, ClientOptions, Notice};

/// What a request got, read whole.
pub(crate) struct Reply {
    pub(crate) status: u16,
    pub(crate) content_type: String,
    pub(crate) retry_after: Option<Duration>,
    pub(crate) body: Vec<u8>,
}

/// Sends requests, each until it is answered.
pub(crate) struct Transport {
    agent: Agent,
    address: Address,
    authorization: Option<String>,
    options: ClientOptions,
}

/// Why an attempt brought no reply.
enum Failed {
    /// Another attempt may bring one.
    ForNow(String),
    /// None will.
    ForGood(ClientError),
}

impl Transport {
    pub(crate) fn new(
        address: Address,
        token: Option<String>,
        options: ClientOptions,
    ) -> Result<Self, ClientError> {
        let mut tls = TlsConfig::builder();
        if let Some(pem) = &options.certificates {
            tls = tls.root_certs(certificates(pem)?);
        }
        let mut agent = Agent::config_builder()
            .tls_config(tls.build())
            // Statuses are told apart here, and a service that redirects is not the one that was meant.
            .http_status_as_error(false)
            .max_redirects(0)
            .timeout_connect(Some(options.connect_timeout))
            .timeout_global(Some(options.timeout))
            .user_agent("veiloc");
        if address.is_local {
            // Plain HTTP was allowed because nobody is on the way: no proxy either.
            agent = agent.proxy(None);
        }
        let agent = agent.build().new_agent();
        let authorization = token.map(|token| format!("Bearer {token}"));
        Ok(Self { agent, address, authorization, options })
    }

    pub(crate) fn address(&self) -> &Address {
        &self.address
    }

    pub(crate) fn options(&self) -> &ClientOptions {
        &self.options
    }

    /// Fetches; `known` goes into `If-None-Match`.
    pub(crate) fn get(&self, url: &str, known: Option<&str>, limit: u64) -> Result<Reply, ClientError> {
        self.until_answered(limit, || {
            let mut request = self.agent.get(url);
            if let Some(authorization) = &self.authorization {
                request = request.header("authorization", authorization);
            }
            if let Some(tag) = known {
                request = request.header("if-none-match", tag);
            }
            request.call()
        })
    }

    /// Sends bytes; whenever they are sent again, they are the same bytes.
    pub(crate) fn post(
        &self,
        url: &str,
        accept: &str,
        headers: &[(&str, String)],
        body: &[u8],
        limit: u64,
    ) -> Result<Reply, ClientError> {
        self.until_answered(limit, || {
            let mut request = self.agent.post(url);
            if let Some(authorization) = &self.authorization {
                request = request.header("authorization", authorization);
            }
            for (name, value) in headers {
                request = request.header(*name, value);
            }
            request.header("accept", accept).send(body)
        })
    }

    fn until_answered(
        &self,
        limit: u64,
        send: impl Fn() -> Result<Response<Body>, ureq::Error>,
    ) -> Result<Reply, ClientError> {
        let policy = self.options.retry;
        let mut retries = 0;
        loop {
            let (reason, asked, error) = match self.attempt(limit, &send) {
                Ok(reply) if matches!(reply.status, 408 | 429 | 503 | 504) => {
                    let refusal = Refusal::new(reply.status, &reply.body);
                    let retry_after = reply.retry_after;
                    (refusal.to_string(), retry_after, ClientError::Busy { refusal, retry_after })
                }
                Ok(reply) => return Ok(reply),
                Err(Failed::ForNow(reason)) => {
                    let server = self.address.base.clone();
                    (reason.clone(), None, ClientError::Network { server, reason })
                }
                Err(Failed::ForGood(error)) => return Err(error),
            };
            // Asking earlier than a busy service wants would only make it busier.
            if retries == policy.retries || asked.is_some_and(|asked| asked > policy.longest_pause) {
                return Err(error);
            }
            retries += 1;
            let pause =
                asked.unwrap_or_else(|| policy.pause.saturating_mul(retries).min(policy.longest_pause));
            self.options.tell(&Notice::Again { reason, pause });
            (self.options.sleep)(pause);
        }
    }

    fn attempt(
        &self,
        limit: u64,
        send: impl Fn() -> Result<Response<Body>, ureq::Error>,
    ) -> Result<Reply, Failed> {
        let mut response = send().map_err(|error| self.failed(&error))?;
        let header = |name: &str| response.headers().get(name).and_then(|value| value.to_str().ok());
        let content_type = header("content-type").unwrap_or_default().to_owned();
        let retry_after = header("retry-after").and_then(|s| s.trim().parse().ok()).map(Duration::from_secs);
        let status = response.status().as_u16();
        let body = response.body_mut().with_config().limit(limit).read_to_vec();
        let body = body.map_err(|error| self.failed(&error))?;
        Ok(Reply { status, content_type, retry_after, body })
    }

    fn failed(&self, error: &ureq::Error) -> Failed {
        use std::io::ErrorKind::{InvalidData, InvalidInput};
        let reason = printable(&error.to_string());
        match error {
            // A certificate nobody vouches for, or bytes that are no TLS: as wrong the next time.
            ureq::Error::Io(e) if !matches!(e.kind(), InvalidData | InvalidInput) => Failed::ForNow(reason),
            ureq::Error::Timeout(_) | ureq::Error::ConnectionFailed => Failed::ForNow(reason),
            ureq::Error::BodyExceedsLimit(limit) => Failed::ForGood(ClientError::BadAnswer {
                what: "what came",
                reason: format!("it is longer than {limit} bytes"),
            }),
            _ => Failed::ForGood(ClientError::Network { server: self.address.base.clone(), reason }),
        }
    }
}

fn certificates(pem: &[u8]) -> Result<RootCerts, ClientError> {
    let all: Vec<_> = parse_pem(pem)
        .filter_map(|item| match item {
            Ok(PemItem::Certificate(certificate)) => Some(certificate),
            _ => None,
        })
        .collect();
    if all.is_empty() {
        return Err(ClientError::Certificates);
    }
    Ok(RootCerts::Specific(Arc::new(all)))
}

//! One request with its retries: the same bytes are sent until the service answers or rejects them for good (rule L7).

use std::sync::Arc;
use std::time::Duration;

use ureq::http::Response;
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};
use ureq::typestate::WithBody;
use ureq::{Agent, Body, RequestBuilder};

use crate::address::Address;
use crate::refusal::{Refusal, printable};
use crate::{ClientError, ClientOptions, Notice};

/// A complete response.
pub(crate) struct Reply {
    pub(crate) status: u16,
    pub(crate) content_type: String,
    pub(crate) retry_after: Option<Duration>,
    pub(crate) body: Vec<u8>,
}

/// Sends requests with retries.
pub(crate) struct Transport {
    agent: Agent,
    address: Address,
    authorization: Option<String>,
    options: ClientOptions,
}

/// Why an attempt gave no response.
enum AttemptError {
    /// A retry may succeed.
    Transient(String),
    /// No retry can succeed.
    Permanent(ClientError),
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
            // This crate handles statuses itself, and does not follow redirects: another service is not the intended
            // one.
            .http_status_as_error(false)
            .max_redirects(0)
            .timeout_connect(Some(options.connect_timeout))
            .timeout_global(Some(options.timeout))
            .user_agent("veiloc");
        if address.is_local {
            // Plain HTTP to this machine is allowed because the network is not involved; a proxy would change that.
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

    /// Sends a GET request; `known` goes into `If-None-Match`.
    pub(crate) fn get(&self, url: &str, known: Option<&str>, limit: u64) -> Result<Reply, ClientError> {
        self.send_with_retries(limit, || {
            let mut request = self.authorized(self.agent.get(url));
            if let Some(tag) = known {
                request = request.header("if-none-match", tag);
            }
            request.call()
        })
    }

    /// Sends bytes; every retry sends the same bytes.
    pub(crate) fn post(
        &self,
        url: &str,
        accept: &str,
        headers: &[(&str, String)],
        body: &[u8],
        limit: u64,
    ) -> Result<Reply, ClientError> {
        self.send_with_retries(limit, || self.with_body(self.agent.post(url), accept, headers, body))
    }

    /// The same with the method PUT.
    pub(crate) fn put(
        &self,
        url: &str,
        accept: &str,
        headers: &[(&str, String)],
        body: &[u8],
        limit: u64,
    ) -> Result<Reply, ClientError> {
        self.send_with_retries(limit, || self.with_body(self.agent.put(url), accept, headers, body))
    }

    /// Sends a DELETE request.
    pub(crate) fn delete(&self, url: &str, limit: u64) -> Result<Reply, ClientError> {
        self.send_with_retries(limit, || self.authorized(self.agent.delete(url)).call())
    }

    fn with_body(
        &self,
        request: RequestBuilder<WithBody>,
        accept: &str,
        headers: &[(&str, String)],
        body: &[u8],
    ) -> Result<Response<Body>, ureq::Error> {
        let mut request = self.authorized(request).header("accept", accept);
        for (name, value) in headers {
            request = request.header(*name, value);
        }
        request.send(body)
    }

    fn authorized<T>(&self, request: RequestBuilder<T>) -> RequestBuilder<T> {
        match &self.authorization {
            Some(authorization) => request.header("authorization", authorization),
            None => request,
        }
    }

    fn send_with_retries(
        &self,
        limit: u64,
        send: impl Fn() -> Result<Response<Body>, ureq::Error>,
    ) -> Result<Reply, ClientError> {
        let policy = self.options.retry;
        let mut retries = 0;
        loop {
            let (reason, requested_pause, error) = match self.attempt(limit, &send) {
                Ok(reply) if matches!(reply.status, 408 | 429 | 503 | 504) => {
                    let refusal = Refusal::new(reply.status, &reply.body);
                    let retry_after = reply.retry_after;
                    (refusal.to_string(), retry_after, ClientError::Busy { refusal, retry_after })
                }
                Ok(reply) => return Ok(reply),
                Err(AttemptError::Transient(reason)) => {
                    let server = self.address.base.clone();
                    (reason.clone(), None, ClientError::Network { server, reason })
                }
                Err(AttemptError::Permanent(error)) => return Err(error),
            };
            // An earlier retry than a busy service requests would increase its load.
            if retries == policy.retries || requested_pause.is_some_and(|pause| pause > policy.longest_pause)
            {
                return Err(error);
            }
            retries += 1;
            let pause = requested_pause
                .unwrap_or_else(|| policy.pause.saturating_mul(retries).min(policy.longest_pause));
            self.options.notify(&Notice::Again { reason, pause });
            (self.options.sleep)(pause);
        }
    }

    fn attempt(
        &self,
        limit: u64,
        send: impl Fn() -> Result<Response<Body>, ureq::Error>,
    ) -> Result<Reply, AttemptError> {
        let mut response = send().map_err(|error| self.failed(&error))?;
        let header = |name: &str| response.headers().get(name).and_then(|value| value.to_str().ok());
        let content_type = header("content-type").unwrap_or_default().to_owned();
        let retry_after = header("retry-after").and_then(|s| s.trim().parse().ok()).map(Duration::from_secs);
        let status = response.status().as_u16();
        let body = response.body_mut().with_config().limit(limit).read_to_vec();
        let body = body.map_err(|error| self.failed(&error))?;
        Ok(Reply { status, content_type, retry_after, body })
    }

    fn failed(&self, error: &ureq::Error) -> AttemptError {
        use std::io::ErrorKind::{InvalidData, InvalidInput};
        let reason = printable(&error.to_string());
        match error {
            // An untrusted certificate, or bytes that are not TLS: a retry cannot help.
            ureq::Error::Io(e) if !matches!(e.kind(), InvalidData | InvalidInput) => {
                AttemptError::Transient(reason)
            }
            ureq::Error::Timeout(_) | ureq::Error::ConnectionFailed => AttemptError::Transient(reason),
            ureq::Error::BodyExceedsLimit(limit) => AttemptError::Permanent(ClientError::BadAnswer {
                what: "the response",
                reason: format!("it is longer than {limit} bytes"),
            }),
            _ => AttemptError::Permanent(ClientError::Network { server: self.address.base.clone(), reason }),
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

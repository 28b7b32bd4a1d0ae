//! The HTTP client: conditional fetch of a profile, and sending sealed bytes until they are answered.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use serde_json::Value;
use ureq::http::Response;
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};
use ureq::{Agent, Body};
use veiloc_query::Answer;

use crate::exit::Failure;
use crate::files;
use crate::ui::Ui;

/// How to reach a service.
#[derive(clap::Args)]
pub(super) struct Connection {
    /// The service, for example `https://places.example:8443`.
    #[arg(long, value_name = "URL")]
    pub(super) server: String,
    /// Token to identify with. Better in a file or in the environment, where other users cannot see it.
    #[arg(long, conflicts_with = "token_file", value_name = "TOKEN")]
    token: Option<String>,
    /// File that holds the token. Default: the environment variable VEILOC_TOKEN, or none.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Certificates to trust instead of the public ones, PEM: for a service with a certificate of its own.
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,
    /// Speak plain HTTP beyond loopback, where everybody on the way can read token and query.
    #[arg(long)]
    insecure_http: bool,
    /// How often to send the same bytes again when the service is busy or the network fails.
    #[arg(long, default_value_t = 4, value_name = "N")]
    retries: u32,
}

/// Most bytes of a profile that are read.
const MAX_PROFILE: u64 = 2 << 20;
/// Most bytes of an answer or a refusal.
const MAX_ANSWER: u64 = 64 << 10;
/// A device would rather tell its user than wait longer.
const LONGEST_WAIT: Duration = Duration::from_secs(20);

/// A connection to a service.
pub(super) struct Client<'a> {
    agent: Agent,
    base: String,
    token: Option<String>,
    retries: u32,
    ui: &'a Ui,
}

/// A profile as it was fetched.
pub(super) enum Fetched {
    /// The one the client has is the current one.
    Unchanged,
    /// Its bytes.
    New(Vec<u8>),
}

impl<'a> Client<'a> {
    pub(super) fn new(args: &Connection, ui: &'a Ui) -> Result<Self, Failure> {
        let base = args.server.trim_end_matches('/').to_owned();
        if let Some(rest) = base.strip_prefix("http://") {
            if !args.insecure_http && !is_loopback(rest) {
                return Err(Failure::with_help(
                    format!("{base}: plain HTTP could be read and changed on the way"),
                    "use https://, or say with --insecure-http that the way is safe",
                ));
            }
        } else if !base.starts_with("https://") {
            let message = format!("{base}: no address of a service");
            return Err(Failure::with_help(message, "begin it with https://"));
        }
        let mut tls = TlsConfig::builder();
        if let Some(path) = &args.ca {
            tls = tls.root_certs(certificates(path)?);
        }
        let agent = Agent::config_builder()
            .tls_config(tls.build())
            // Statuses are told apart here, and a service that redirects is not the one that was meant.
            .http_status_as_error(false)
            .max_redirects(0)
            .timeout_connect(Some(Duration::from_secs(10)))
            .timeout_global(Some(Duration::from_secs(60)))
            .user_agent("veiloc")
            .build()
            .new_agent();
        Ok(Self { agent, base, token: token(args)?, retries: args.retries, ui })
    }

    /// The profile of a map, unless it is still the one with this hash.
    pub(super) fn profile(&self, map: &str, known: Option<&str>) -> Result<Fetched, Failure> {
        let url = format!("{}/v1/maps/{map}/profile", self.base);
        let mut response = self.until_answered(|| {
            let mut request = self.agent.get(&url);
            if let Some(token) = &self.token {
                request = request.header("authorization", format!("Bearer {token}"));
            }
            if let Some(hash) = known {
                request = request.header("if-none-match", format!("\"{hash}\""));
            }
            request.call()
        })?;
        match response.status().as_u16() {
            200 => Ok(Fetched::New(read(&mut response, MAX_PROFILE)?)),
            304 if known.is_some() => Ok(Fetched::Unchanged),
            _ => Err(refusal(&mut response)),
        }
    }

    /// The pose of sealed bytes; whenever they are sent again, they are the same bytes (rule L7).
    pub(super) fn localize(&self, map: &str, sealed: &[u8]) -> Result<Answer, Failure> {
        let url = format!("{}/v1/maps/{map}/localize", self.base);
        let mut response = self.until_answered(|| {
            let mut request = self.agent.post(&url).header("content-type", "application/x-protobuf");
            if let Some(token) = &self.token {
                request = request.header("authorization", format!("Bearer {token}"));
            }
            request.header("accept", "application/x-protobuf").send(sealed)
        })?;
        if response.status().as_u16() != 200 {
            return Err(refusal(&mut response));
        }
        Ok(Answer::decode(&read(&mut response, MAX_ANSWER)?)?)
    }

    /// Sends until the service answers or refuses for good.
    fn until_answered(
        &self,
        send: impl Fn() -> Result<Response<Body>, ureq::Error>,
    ) -> Result<Response<Body>, Failure> {
        let mut attempt = 0;
        loop {
            let sent = send();
            let (reason, wait) = match &sent {
                Ok(response) => match (response.status().as_u16(), wait_asked_for(response)) {
                    (408 | 429 | 503 | 504, asked) => (response.status().to_string(), asked),
                    _ => return sent.map_err(Failure::from),
                },
                Err(ureq::Error::Io(e)) => (e.to_string(), None),
                Err(ureq::Error::Timeout(e)) => (e.to_string(), None),
                Err(error) => return Err(unreachable(&self.base, error)),
            };
            if attempt == self.retries {
                return sent.map_err(|error| unreachable(&self.base, &error));
            }
            attempt += 1;
            let wait = wait.unwrap_or(Duration::from_millis(500) * attempt).min(LONGEST_WAIT);
            self.ui.say(format!("{reason}; sending the same bytes again in {:.1} s", wait.as_secs_f64()));
            std::thread::sleep(wait);
        }
    }
}

fn wait_asked_for(response: &Response<Body>) -> Option<Duration> {
    let seconds = response.headers().get("retry-after")?.to_str().ok()?.parse().ok()?;
    Some(Duration::from_secs(seconds))
}

fn read(response: &mut Response<Body>, limit: u64) -> Result<Vec<u8>, Failure> {
    Ok(response.body_mut().with_config().limit(limit).read_to_vec()?)
}

fn unreachable(base: &str, error: &ureq::Error) -> Failure {
    Failure::with_help(
        format!("{base}: {error}"),
        "check the address and that the service runs; for a certificate of its own give --ca",
    )
}

/// What the service said, with a remedy where there is one.
fn refusal(response: &mut Response<Body>) -> Failure {
    let status = response.status();
    let document: Value = read(response, MAX_ANSWER)
        .ok()
        .and_then(|body| serde_json::from_slice(&body).ok())
        .unwrap_or_default();
    let text = |field: &str| document[field].as_str().map(printable);
    let message = match (text("title"), text("detail")) {
        (Some(title), Some(detail)) => format!("{title} ({}): {detail}", status.as_u16()),
        _ => format!("the service answered {status}"),
    };
    match document["type"].as_str().and_then(|kind| kind.strip_prefix("urn:veiloc:problem:")) {
        Some("unauthenticated") => {
            Failure::with_help(message, "give a token with --token-file or in VEILOC_TOKEN")
        }
        Some("wrong-profile") => Failure::with_help(
            message,
            "the map was exchanged meanwhile; take a new image, this one must not be sealed twice",
        ),
        Some("not-localized") => Failure::with_help(message, "take an image from elsewhere in the place"),
        _ => Failure::refused(message),
    }
}

/// Words of the other side, fit for a terminal.
fn printable(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(500).collect()
}

/// `host[:port][/…]` of this machine.
fn is_loopback(rest: &str) -> bool {
    let host = rest.split('/').next().unwrap_or_default();
    // A name before `@` is not the host.
    let host = host.rsplit('@').next().unwrap_or_default();
    let host = match host.strip_prefix('[') {
        Some(v6) => v6.split(']').next().unwrap_or_default(),
        None => host.split(':').next().unwrap_or_default(),
    };
    host == "localhost" || host.parse::<std::net::IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

fn token(args: &Connection) -> Result<Option<String>, Failure> {
    let token = match (&args.token, &args.token_file) {
        (Some(token), _) => Some(token.clone()),
        (None, Some(path)) => Some(String::from_utf8_lossy(&files::read(path)?).into_owned()),
        (None, None) => std::env::var("VEILOC_TOKEN").ok(),
    };
    let token = token.map(|token| token.trim().to_owned()).filter(|token| !token.is_empty());
    if token.as_ref().is_some_and(|t| !t.chars().all(|c| c.is_ascii_graphic())) {
        return Err(Failure::with_help(
            "the token holds characters that no token has",
            "give one line of letters and digits, as the operator made it",
        ));
    }
    Ok(token)
}

fn certificates(path: &std::path::Path) -> Result<RootCerts, Failure> {
    let bytes = files::read(path)?;
    let all: Vec<_> = parse_pem(&bytes)
        .filter_map(|item| match item {
            Ok(PemItem::Certificate(certificate)) => Some(certificate),
            _ => None,
        })
        .collect();
    if all.is_empty() {
        return Err(Failure::with_help(
            format!("{}: holds no certificate", path.display()),
            "give a PEM file, which begins with -----BEGIN CERTIFICATE-----",
        ));
    }
    Ok(RootCerts::Specific(Arc::new(all)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loopback_is_told_from_the_rest() {
        for ours in ["localhost", "localhost:80", "127.0.0.1:8080/x", "[::1]:80", "127.9.9.9"] {
            assert!(is_loopback(ours), "{ours}");
        }
        for other in
            ["example.org", "localhost.example.org", "10.0.0.1", "[::2]:80", "localhost@evil.example", ""]
        {
            assert!(!is_loopback(other), "{other}");
        }
    }

    #[test]
    fn words_of_the_other_side_cannot_move_the_cursor() {
        assert_eq!(printable("a\u{1b}[2Jb\r\nc"), "a[2Jbc");
    }
}

//! Connection options of a service, and the remedies for connection errors.

use std::path::PathBuf;
use std::sync::Arc;

use veiloc_client::{Client, ClientError, ClientOptions, Notice};
use veiloc_map::text::{text_of, without_mark};
use veiloc_protocol::ProfileId;

use crate::commands::seal::OTHER_ID;
use crate::commands::user_folder::user_cache;
use crate::output::exit::Failure;
use crate::output::files;
use crate::output::ui::Ui;

/// Connection to a service.
#[derive(clap::Args)]
pub(super) struct Connection {
    /// The service, for example `https://places.example:8443`.
    #[arg(long, value_name = "URL")]
    server: String,
    /// Token for authentication. Prefer a file or the environment: other users can see the command line.
    #[arg(long, conflicts_with = "token_file", value_name = "TOKEN")]
    token: Option<String>,
    /// File that holds the token. Default: the environment variable VEILOC_TOKEN, or none.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Certificates to trust instead of the public ones, PEM: for a service with a certificate of its own.
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,
    /// Use plain HTTP beyond loopback; everyone on the network path can then read token and query.
    #[arg(long)]
    insecure_http: bool,
    /// Number of retries with the same bytes if the service is busy or the network fails.
    #[arg(long, default_value_t = 4, value_name = "N")]
    retries: u32,
    /// Cache folder for profiles and packs. Default: the user's cache folder.
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
}

impl Connection {
    /// Returns a client that reports when it waits, and refuses another profile of a map than the given one.
    pub(super) fn client(&self, profile: Option<(&str, ProfileId)>, ui: &Arc<Ui>) -> Result<Client, Failure> {
        let mut options = ClientOptions::default();
        options.profile_ids.extend(profile.map(|(map, id)| (map.to_owned(), id)));
        let certificates = self.ca.as_deref().map(files::read).transpose()?;
        options.certificates = certificates.map(|bytes| without_mark(&bytes).to_vec());
        options.insecure_http = self.insecure_http;
        options.retry.retries = self.retries;
        options.cache = self.cache.clone().or_else(user_cache);
        let ui = ui.clone();
        options.notice = Some(Arc::new(move |notice: &Notice| print_notice(&ui, notice)));
        let token = self.token()?;
        Client::new(&self.server, token.as_deref(), options).map_err(|error| match (&error, &self.ca) {
            // The library has only the bytes; the message needs the name of the file.
            (ClientError::Certificates, Some(path)) => Failure::with_help(
                format!("{}: holds no certificate", path.display()),
                "give a PEM file, which begins with -----BEGIN CERTIFICATE-----",
            ),
            _ => failure(error),
        })
    }

    fn token(&self) -> Result<Option<String>, Failure> {
        Ok(match (&self.token, &self.token_file) {
            (Some(token), _) => Some(token.clone()),
            // Other bytes than text are refused as a token.
            (None, Some(path)) => Some(text_of(files::read(path)?).unwrap_or_default()),
            (None, None) => std::env::var("VEILOC_TOKEN").ok(),
        })
    }
}

fn print_notice(ui: &Ui, notice: &Notice) {
    match notice {
        Notice::Again { reason, pause } => {
            ui.info(format!("{reason}; sending the same bytes again in {:.1} s", pause.as_secs_f64()));
        }
        Notice::Changed { what, map, before, now } => {
            ui.warn(format!(
                "the {what} of the map {map} changed since the last query, from {before} to {now}; compare it with the id \
                 that the operator publishes, and give that with --{what}-id"
            ));
        }
        Notice::CacheWriteFailed { file, reason } => {
            ui.info(format!("{}: could not be cached: {reason}", file.display()));
        }
    }
}

/// Adds a remedy to the error if there is one.
pub(super) fn failure(error: ClientError) -> Failure {
    let help = match &error {
        ClientError::PlainHttp { .. } => {
            "use https://, or give --insecure-http if the network path is \
             secure"
        }
        ClientError::Address { .. } => "give an address of the form https://HOST:PORT/PATH",
        ClientError::Token => "give the token as created by the operator: one line of letters and digits",
        ClientError::Certificates => "give a PEM file with --ca",
        ClientError::Network { reason, .. } if reason.contains("CaUsedAsEndEntity") => {
            "the service shows a certificate of an authority, as `openssl req -x509` makes it by default; its operator \
             makes one of a host with `-addext basicConstraints=critical,CA:FALSE` (docs/guide/service.md)"
        }
        ClientError::Network { reason, .. } if reason.contains("InvalidContentType") => {
            "the service answers plain HTTP on this port: give the address of its TLS port, or http:// with --insecure-http if the \
             network path is secure"
        }
        ClientError::Network { reason, .. } if reason.contains("invalid HTTP version") => {
            "the service does not answer plain HTTP on this port, perhaps because it is its TLS port: use https://"
        }
        ClientError::Network { reason, .. } if reason.contains("not valid for name") => {
            "ask by a name that the certificate states, or have the operator make one that states this name \
             (docs/guide/service.md)"
        }
        ClientError::Network { .. } => {
            "check the address and that the service runs; for a self-signed certificate give --ca"
        }
        ClientError::Busy { .. } => "try again later",
        ClientError::NotLocalized(_) => {
            "a session is --session FILE, an orientation --orientation QW,QX,QY,QZ"
        }
        ClientError::WrongProfile(_) => {
            "the map was replaced in the meantime: send another frame of the same session (--session \
             FILE, with --orientation if the device knows it); without a session do not seal this image \
             twice: move by at least one step and take another image"
        }
        ClientError::OtherId { .. } => OTHER_ID,
        ClientError::Refused(refusal) if refusal.name == "unauthenticated" => {
            "give a token with --token-file or in VEILOC_TOKEN"
        }
        ClientError::BadAnswer { .. } => "check the address; it may belong to another service",
        // The message is complete: it names the map, the query or the image.
        _ => {
            return Failure::refused(error);
        }
    };
    Failure::with_help(error, help)
}

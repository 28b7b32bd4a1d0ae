//! `veiloc token`: the token file, with which a service authenticates clients.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde::Serialize;
use veiloc_map::atomic_file::{Permissions, TargetLock, replace_file};
use veiloc_map::is_map_name;
use veiloc_service::ServerError;
use veiloc_service::auth::{Secret, Timestamp, TokenEntry, TokenFile, TokenList, added, revoked};

use crate::output::exit::{Exit, Failure, Outcome};
use crate::output::targets::OutFile;
use crate::output::ui::Ui;

/// Create, list and revoke tokens of a service.
#[derive(clap::Subcommand)]
pub(crate) enum Command {
    /// Create a token and print it; it cannot be shown again, because the file contains only its hash.
    New(NewArgs),
    /// List the tokens of a file: names, maps and expiry.
    List(ListArgs),
    /// Remove a token from a file. A running service refuses it from its next check of the file (`serve --watch`).
    Revoke(RevokeArgs),
}

#[derive(clap::Args)]
pub(crate) struct NewArgs {
    /// Name of the token: letters, digits, `-`, `_`, `.`, `@`, `+`.
    name: String,
    /// Token file (`serve --tokens`); a new one is readable by its owner only.
    #[arg(long, value_name = "FILE")]
    tokens: PathBuf,
    /// Maps that the token gives access to, separated by commas. Default: all.
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = map_name, conflicts_with = "operator")]
    maps: Vec<String>,
    /// Expiry: a day, which begins in UTC, or a second. Default: never.
    #[arg(long, value_name = "DATE", conflicts_with = "days")]
    expires: Option<Timestamp>,
    /// Days until expiry. Default: never.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    days: Option<u32>,
    /// The token may also read the metrics, which cover every map.
    #[arg(long)]
    operator: bool,
    /// The token may also write content anchors: its own, and with --operator those of others.
    #[arg(long)]
    anchors: bool,
    /// The token is of a gateway (`serve --workers`), which limits the rates of its clients itself: without a limit and without
    /// the delay of --answer-quantum, and its word is taken for which client a query comes from.
    #[arg(long)]
    gateway: bool,
    /// Print a link to the page of `serve --page` at this address: its fragment holds the token, which browsers do not send.
    /// Default: the token alone is printed.
    #[arg(long, value_name = "https://HOST", value_parser = page_address, conflicts_with_all = ["operator", "gateway"])]
    link: Option<String>,
    /// Write the link as a QR code (SVG), readable by its owner only.
    #[arg(long, value_name = "FILE", requires = "link")]
    qr: Option<OutFile>,
    /// File to write the token or link to, readable by its owner only. Default: stdout.
    #[arg(long, short, value_name = "FILE")]
    out: Option<OutFile>,
}

#[derive(clap::Args)]
pub(crate) struct ListArgs {
    /// Token file.
    #[arg(long, value_name = "FILE")]
    tokens: PathBuf,
    /// Print one JSON document.
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args)]
pub(crate) struct RevokeArgs {
    /// The token's name.
    name: String,
    /// Token file.
    #[arg(long, value_name = "FILE")]
    tokens: PathBuf,
}

fn map_name(text: &str) -> Result<String, String> {
    if is_map_name(text) {
        Ok(text.to_owned())
    } else {
        Err("names of maps are expected, separated by commas without spaces: lobby,garage".to_owned())
    }
}

/// The address of a page, without the slash at its end.
fn page_address(text: &str) -> Result<String, String> {
    let (scheme, rest) = text.split_once("://").unwrap_or_default();
    let host = rest.split('/').next().unwrap_or_default();
    let is_own = ["localhost", "127.0.0.1", "[::1]"]
        .iter()
        .any(|own| host.strip_prefix(own).is_some_and(|port| port.is_empty() || port.starts_with(':')));
    let is_valid = (scheme == "https" || (scheme == "http" && is_own))
        && !host.is_empty()
        && text.bytes().all(|byte| byte.is_ascii_graphic() && !b"?#@\"<>".contains(&byte));
    if is_valid {
        Ok(text.trim_end_matches('/').to_owned())
    } else {
        Err("the https address of the page is expected, such as https://places.example:8443".to_owned())
    }
}

pub(crate) fn run(command: &Command, ui: &Ui) -> Outcome {
    match command {
        Command::New(args) => new(args, ui),
        Command::List(args) => list(args, ui),
        Command::Revoke(args) => revoke(args, ui),
    }
}

fn new(args: &NewArgs, ui: &Ui) -> Outcome {
    let now = Timestamp::of(SystemTime::now());
    let expires = match args.days {
        Some(days) => Some(now.plus_days(days).ok_or_else(|| expiry_too_far(days))?),
        None => args.expires,
    };
    if let Some(end) = expires.filter(|end| *end <= now) {
        return Err(Failure::with_help(
            format!("--expires {end}: this time is in the past"),
            "give a future day",
        ));
    }
    let mut random = [0; 32];
    getrandom::fill(&mut random)
        .map_err(|error| Failure::refused(format!("the system has no random numbers: {error}")))?;
    let secret = Secret::of_random(random);
    let wrong =
        |error: &dyn std::fmt::Display| Failure::refused(format!("{}: {error}", args.tokens.display()));
    let mut entry = TokenEntry::new(&args.name, secret.key()).map_err(Failure::refused)?;
    entry.operator = args.operator;
    entry.gateway = args.gateway;
    entry.anchors = args.anchors;
    entry.expires = expires;
    if !args.maps.is_empty() {
        entry.grant_maps(args.maps.iter().map(String::as_str)).map_err(Failure::refused)?;
    }
    let mut file = TokenFile::open(&args.tokens).map_err(|e| read_error(&e))?;
    let text = added(file.text(), &entry).map_err(|e| wrong(&e))?;
    // The token first: a line in the file whose token is lost is worse than a token that is not in force.
    let link = args.link.as_ref().map(|address| format!("{address}/#token={}", secret.reveal()));
    let shown = link.as_deref().unwrap_or(secret.reveal());
    let write = |out: &OutFile, text: &str| {
        write_secret(out, text).map_err(|error| Failure::output(out.display(), &error))
    };
    if let (Some(out), Some(link)) = (&args.qr, &link) {
        write(out, &qr_code(link)?)?;
    }
    if let Some(out) = &args.out {
        write(out, shown)?;
    }
    file.replace(&text).map_err(write_error)?;
    let permissions = describe_permissions(&entry);
    let use_by = match (args.gateway, args.operator) {
        (true, _) => "veiloc serve --worker-token",
        (_, true) => "curl -H 'Authorization: Bearer TOKEN'",
        _ => "veiloc query send --token-file",
    };
    if link.is_some() {
        if args.out.is_none() {
            ui.print(format_args!("{shown}\n"));
        }
        ui.info(format_args!(
            "{} may send requests{permissions}. So may everyone who has the link: `veiloc token revoke {}` ends it.",
            args.name, args.name
        ));
    } else if let Some(out) = &args.out {
        ui.info(format_args!(
            "{} may send requests{permissions}. The token is in {}; send it by `{use_by}`.",
            args.name,
            out.display()
        ));
    } else {
        ui.print(format_args!("{shown}\n"));
        ui.info(format_args!(
            "{} may send requests{permissions}. The line above is the token: it is not stored anywhere, so save it \
             now.\nSend it as `Authorization: Bearer TOKEN`, or save it in a file for `{use_by}`; --out \
             writes a file that only its owner can read.",
            args.name
        ));
    }
    Ok(Exit::Success)
}

/// Writes a line, such as a token as `--token-file` reads it; a new file is readable by its owner only.
fn write_secret(path: &Path, text: &str) -> std::io::Result<()> {
    let lock = TargetLock::acquire(path)?;
    replace_file(&lock, Permissions::OwnerAndGroup, |out| writeln!(out, "{text}"))
}

/// A QR code as SVG, with the quiet zone that scanners need.
fn qr_code(text: &str) -> Result<String, Failure> {
    let code = qrcode::QrCode::new(text)
        .map_err(|error| Failure::refused(format!("--qr: the link is too long for a code: {error}")))?;
    Ok(code.render::<qrcode::render::svg::Color<'_>>().min_dimensions(480, 480).build())
}

fn expiry_too_far(days: u32) -> Failure {
    Failure::with_help(
        format!("--days {days}: this is after the year 9999"),
        "leave it out for a token that does not expire",
    )
}

fn read_error(error: &ServerError) -> Failure {
    Failure::with_help(error, "check that the folder exists, and that file and folder are writable")
}

fn write_error(error: ServerError) -> Failure {
    match error {
        ServerError::Io { path, source } => Failure::output(path.display(), &source),
        other => Failure::refused(other),
    }
}

/// Describes the permissions of a token in words.
fn describe_permissions(entry: &TokenEntry) -> String {
    let mut text = String::new();
    if let Some(maps) = entry.maps() {
        let _ = write!(text, " for {}", maps.collect::<Vec<_>>().join(", "));
    }
    if let Some(end) = entry.expires {
        let _ = write!(text, " until {end}");
    }
    if entry.operator {
        text += ", and read the metrics";
    }
    if entry.gateway {
        text += ", as a gateway";
    }
    if entry.anchors {
        text += ", and write content anchors";
    }
    text
}

/// A token.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct ListedToken {
    /// Name of the token.
    name: String,
    /// The first eight digits of its SHA-256.
    hash: String,
    /// Whether it may read the metrics.
    operator: bool,
    /// Whether it is of a gateway.
    gateway: bool,
    /// Whether it may write content anchors.
    anchors: bool,
    /// Names of the maps that it gives access to; null for all.
    maps: Option<Vec<String>>,
    /// Expiry, `2027-01-31T00:00:00Z`; null for never.
    expires: Option<String>,
    /// Whether it has expired.
    expired: bool,
}

/// The tokens of a file.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub(crate) struct ListDocument {
    /// 1.
    version: u32,
    /// The tokens, in the order of the file.
    tokens: Vec<ListedToken>,
}

fn list(args: &ListArgs, ui: &Ui) -> Outcome {
    let list = read(&args.tokens)?;
    let now = Timestamp::of(SystemTime::now());
    let listed = |entry: &TokenEntry| ListedToken {
        name: entry.name().to_owned(),
        hash: entry.key().beginning(),
        operator: entry.operator,
        gateway: entry.gateway,
        anchors: entry.anchors,
        maps: entry.maps().map(|maps| maps.map(str::to_owned).collect()),
        expires: entry.expires.map(|end| end.to_string()),
        expired: entry.has_expired(now),
    };
    let tokens: Vec<ListedToken> = list.entries().iter().map(listed).collect();
    if args.json {
        ui.json(&ListDocument { version: 1, tokens })?;
        return Ok(Exit::Success);
    }
    if tokens.is_empty() {
        ui.info("no client may send requests");
    }
    let width = tokens.iter().map(|token| token.name.len()).max().unwrap_or(0);
    for token in &tokens {
        let maps = token.maps.as_ref().map_or("all maps".to_owned(), |maps| maps.join(","));
        let end = match (&token.expires, token.expired) {
            (None, _) => "without end".to_owned(),
            (Some(end), false) => format!("until {end}"),
            (Some(end), true) => format!("expired {end}"),
        };
        let operator = if token.operator { "  operator" } else { "" };
        let gateway = if token.gateway { "  gateway" } else { "" };
        let anchors = if token.anchors { "  anchors" } else { "" };
        ui.print(format_args!(
            "{:width$}  {}…  {maps}  {end}{operator}{gateway}{anchors}\n",
            token.name, token.hash
        ));
    }
    Ok(Exit::Success)
}

fn read(path: &Path) -> Result<TokenList, Failure> {
    let bytes =
        fs::read(path).map_err(|source| read_error(&ServerError::Io { path: path.to_owned(), source }))?;
    TokenList::parse(&bytes).map_err(|error| Failure::refused(format!("{}: {error}", path.display())))
}

fn revoke(args: &RevokeArgs, ui: &Ui) -> Outcome {
    // Opening would create a missing file.
    read(&args.tokens)?;
    let mut file = TokenFile::open(&args.tokens).map_err(|e| read_error(&e))?;
    let done = revoked(file.text(), &args.name)
        .map_err(|error| Failure::refused(format!("{}: {}: {error}", args.tokens.display(), args.name)))?;
    file.replace(&done.text).map_err(write_error)?;
    let lines = if done.lines > 1 { format!(", {} lines", done.lines) } else { String::new() };
    let last = if done.was_last { "; it was the last: no client may send requests now" } else { "" };
    ui.info(format_args!("{} revoked{lines}{last}", args.name));
    Ok(Exit::Success)
}

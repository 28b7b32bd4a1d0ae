//! Settings of a command from a file, environment variables and the command line; later layers override earlier ones.
//!
//! The command-line flag is the only definition of a setting. The key in the file (`drain-delay` for `--drain-delay`),
//! the variable (`VEILOC_DRAIN_DELAY`), the TOML type and the check of the value all follow from it, so every flag has
//! all of them. [`layered`] prepares a command for this, [`Settings::of`] merges the layers, and
//! [`Settings::arguments`] returns the merged settings as a command line for the command's own parser.
//!
//! ```
//! use clap::{Arg, Command};
//! use veiloc_cli::args::settings::{Settings, layered};
//!
//! let command = Command::new("serve").arg(Arg::new("queue").long("queue").value_name("N").default_value("32"));
//! let matches = layered(command.clone()).get_matches_from(["serve"]);
//! let variable = |name: &str| (name == "VEILOC_QUEUE").then(|| "64".into());
//! let settings = Settings::of(&command, &matches, &variable)?;
//! assert_eq!(settings.arguments().collect::<Vec<_>>(), ["--queue=64"]);
//! assert_eq!(settings.to_toml()?, "queue = \"64\" # VEILOC_QUEUE\n");
//! # Ok::<(), veiloc_cli::args::settings::SettingsError>(())
//! ```

mod error;
mod file;
mod kind;
mod print;
mod secret;

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::builder::Resettable;
use clap::parser::ValueSource;
use clap::{Arg, ArgAction, ArgMatches, Command, Id};

pub use error::SettingsError;
use kind::{PathPosition, ValueKind, check, normalize};

/// Flags that control the settings and are not settings themselves.
const NOT_SETTINGS: [&str; 4] = [CONFIG, "print-config", "help", "version"];

/// The flag that names the settings file; its variable follows from it.
const CONFIG: &str = "config";

/// Prefix of every variable.
const PREFIX: &str = "VEILOC_";

/// Where a value comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SettingOrigin {
    /// The default of the flag, or no value.
    Default,
    /// A line of the file.
    File {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
    },
    /// An environment variable.
    Variable(String),
    /// The command line.
    Flag,
}

/// One flag and its merged value.
#[derive(Debug, Clone)]
struct Setting {
    key: String,
    kind: ValueKind,
    several: bool,
    paths: PathPosition,
    /// Whether the value is an address, which may contain a secret.
    address: bool,
    /// The flag's help text; it describes the absence of a value.
    help: String,
    /// Empty if not given; `true` or `false` for a switch.
    values: Vec<OsString>,
    origin: SettingOrigin,
}

/// The merged settings of a command.
#[derive(Debug, Clone)]
pub struct Settings {
    all: Vec<Setting>,
}

/// Returns the variable that belongs to a key.
pub fn variable(key: &str) -> String {
    format!("{PREFIX}{}", key.to_uppercase().replace('-', "_"))
}

/// Returns whether this argument is a setting.
pub fn is_setting(argument: &Arg) -> bool {
    argument.get_long().is_some_and(|long| !NOT_SETTINGS.contains(&long)) && !argument.is_global_set()
}

/// Prepares the command for parsing the command line alone: constraints that need all layers (required arguments,
/// conflicts) are not checked yet, and a switch can be turned off again: `--log-json=false`.
pub fn layered(command: Command) -> Command {
    command.mut_args(|argument| {
        if !is_setting(&argument) {
            return argument;
        }
        let argument = unconstrained(argument);
        if matches!(argument.get_action(), ArgAction::SetTrue) {
            argument
                .action(ArgAction::Set)
                .value_parser(clap::value_parser!(bool))
                .value_name("true|false")
                .num_args(0..=1)
                .require_equals(true)
                .default_missing_value("true")
                .default_value("false")
                .hide_default_value(true)
                .hide_possible_values(true)
        } else {
            argument
        }
    })
}

/// Removes all constraints between this argument and others.
fn unconstrained(argument: Arg) -> Arg {
    argument
        .required(false)
        .requires(Resettable::<Id>::Reset)
        .conflicts_with(Resettable::<Id>::Reset)
        .required_unless_present(Resettable::<Id>::Reset)
}

impl Settings {
    /// Merges the layers for `command` (not [`layered`]); `matches` is the command line as parsed by [`layered`].
    ///
    /// `--config` or `VEILOC_CONFIG` may name a file. Relative paths in the file are relative to its folder; relative
    /// paths in variables and flags are relative to the working folder. An empty variable or list counts as absent; a
    /// variable separates several values with `;`.
    ///
    /// # Errors
    /// [`SettingsError`]: the file cannot be read, a key is unknown, a value has the wrong type or is refused by the
    /// flag. The error names file and line, or the variable.
    pub fn of(
        command: &Command,
        matches: &ArgMatches,
        variables: &dyn Fn(&str) -> Option<OsString>,
    ) -> Result<Self, SettingsError> {
        let variables = |key: &str| variables(&variable(key)).filter(|value| !value.is_empty());
        let flag = command.get_arguments().any(|a| a.get_long() == Some(CONFIG));
        let named = flag.then(|| matches.get_one::<PathBuf>(CONFIG).cloned()).flatten();
        let file = match named.or_else(|| variables(CONFIG).map(PathBuf::from)) {
            Some(path) => file::read(&path, command)?,
            None => file::SettingsFile::default(),
        };
        let all = command.get_arguments().filter(|argument| is_setting(argument));
        let all = all.map(|argument| Setting::of(argument, matches, &file, &variables));
        Ok(Self { all: all.collect::<Result<_, _>>()? })
    }

    /// Returns a command line with all settings that differ from their defaults.
    pub fn arguments(&self) -> impl Iterator<Item = OsString> {
        self.all
            .iter()
            .filter(|setting| setting.origin != SettingOrigin::Default)
            .flat_map(Setting::arguments)
    }

    /// Returns the keys and the origin of each value.
    pub fn origins(&self) -> impl Iterator<Item = (&str, &SettingOrigin)> {
        self.all.iter().map(|setting| (setting.key.as_str(), &setting.origin))
    }

    /// Formats all settings as a TOML file that gives the same settings again; a comment names the origin of each
    /// value, and paths are absolute. It contains no secret: keys and tokens are named by their files, and a secret in
    /// an address (a password before `@`, a query string) is replaced by `***` with a remark.
    ///
    /// # Errors
    /// [`SettingsError::NotText`]: a path is not UTF-8, and TOML cannot hold it.
    pub fn to_toml(&self) -> Result<String, SettingsError> {
        self.all.iter().map(print::lines).collect()
    }
}

impl Setting {
    fn of(
        argument: &Arg,
        matches: &ArgMatches,
        file: &file::SettingsFile,
        variables: &dyn Fn(&str) -> Option<OsString>,
    ) -> Result<Self, SettingsError> {
        let key = argument.get_long().unwrap_or_default().to_owned();
        let kind = ValueKind::of(argument);
        let several = matches!(argument.get_action(), ArgAction::Append);
        let paths = PathPosition::of(argument);
        let address = kind::is_address(argument);
        let help = argument.get_help().map(ToString::to_string).unwrap_or_default();
        let mut setting = Self {
            key,
            kind,
            several,
            paths,
            address,
            help,
            values: Vec::new(),
            origin: SettingOrigin::Default,
        };
        // The file's value is checked even if a flag overrides it: otherwise the error would appear as soon as the flag
        // is removed.
        let in_file = file.get(&setting.key).filter(|entry| !entry.values.is_empty());
        let in_file = in_file.map(|entry| {
            let origin = SettingOrigin::File { path: file.path().to_owned(), line: entry.line };
            let values: Vec<OsString> =
                entry.values.iter().map(|value| paths.join(&file.folder(), value.as_ref())).collect();
            (values, origin)
        });
        if let Some((values, origin)) = &in_file {
            for value in values {
                check(argument, kind, value, origin)?;
            }
        }
        let id = argument.get_id().as_str();
        if matches.value_source(id) == Some(ValueSource::CommandLine) {
            setting.origin = SettingOrigin::Flag;
            setting.values = matches.get_raw(id).into_iter().flatten().map(ToOwned::to_owned).collect();
        } else if let Some(value) =
            variables(&setting.key).filter(|v| !several || !split_values(v).is_empty())
        {
            setting.origin = SettingOrigin::Variable(variable(&setting.key));
            setting.values = if several { split_values(&value) } else { vec![value] };
            for value in &setting.values {
                check(argument, kind, value, &setting.origin)?;
            }
        } else if let Some((values, origin)) = in_file {
            (setting.values, setting.origin) = (values, origin);
        } else {
            setting.values = argument.get_default_values().iter().map(|v| v.to_os_string()).collect();
            if kind == ValueKind::Switch {
                setting.values = vec!["false".into()];
            }
        }
        if kind == ValueKind::Switch {
            for value in &mut setting.values {
                *value = normalize(value);
            }
        }
        Ok(setting)
    }

    fn arguments(&self) -> Vec<OsString> {
        let flag = OsString::from(format!("--{}", self.key));
        if self.kind == ValueKind::Switch {
            // A switch that is off is the same as an absent switch.
            let is_on = self.values.last().is_some_and(|value| value == "true");
            return if is_on { vec![flag] } else { Vec::new() };
        }
        let with = |value: &OsString| {
            let mut argument = flag.clone();
            argument.push("=");
            argument.push(value);
            argument
        };
        self.values.iter().map(with).collect()
    }

    /// Returns the values with absolute paths.
    fn absolute(&self) -> impl Iterator<Item = OsString> {
        let here = std::env::current_dir().unwrap_or_default();
        self.values.iter().map(move |value| self.paths.join(&here, value))
    }
}

/// Splits a variable into several values.
fn split_values(value: &OsString) -> Vec<OsString> {
    match value.to_str() {
        Some(text) => {
            text.split(';').map(str::trim).filter(|part| !part.is_empty()).map(Into::into).collect()
        }
        None => vec![value.clone()],
    }
}

/// Resolves a path of the file against the file's folder.
fn resolve_path(base: &Path, path: &Path) -> PathBuf {
    // Removes empty components (`./`).
    base.join(path).components().collect()
}

#[cfg(test)]
mod tests;

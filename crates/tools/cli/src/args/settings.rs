//! Settings of a command from a file, environment variables and the command line, in this order: what comes later wins.
//!
//! There is one definition of each, the flag of the command line. From it follow the key of the file (`drain-delay` for
//! `--drain-delay`), the variable (`VEILOC_DRAIN_DELAY`), the type in TOML and the check of the value, so no flag can be
//! without either. [`layered`] prepares a command for that, [`Settings::of`] finds out what holds, and
//! [`Settings::arguments`] is the command line that says all of it, for the command's own parser.
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
use kind::{Kind, Paths, check, fit};

/// Flags that say where settings come from and go to, and are none themselves.
const NOT_SETTINGS: [&str; 4] = [CONFIG, "print-config", "help", "version"];

/// The flag that names the file, and so its variable.
const CONFIG: &str = "config";

/// What every variable begins with.
const PREFIX: &str = "VEILOC_";

/// Where a value comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Origin {
    /// The flag has it by itself, or does without.
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

/// One flag and what holds for it.
#[derive(Debug, Clone)]
struct Setting {
    key: String,
    kind: Kind,
    several: bool,
    paths: Paths,
    /// Whether it is an address, which may hold a secret.
    address: bool,
    /// What the help says, for a flag without value.
    help: String,
    /// Empty for none; of a switch `true` or `false`.
    values: Vec<OsString>,
    origin: Origin,
}

/// What holds for all flags of a command.
#[derive(Debug, Clone)]
pub struct Settings {
    all: Vec<Setting>,
}

/// The name of the variable of a key.
pub fn variable(key: &str) -> String {
    format!("{PREFIX}{}", key.to_uppercase().replace('-', "_"))
}

/// Whether this argument is a setting.
pub fn is_setting(argument: &Arg) -> bool {
    argument.get_long().is_some_and(|long| !NOT_SETTINGS.contains(&long)) && !argument.is_global_set()
}

/// The command for a first look at the command line: what only the whole of all layers can tell (what is missing, what
/// excludes what) is not asked yet, and a switch can be turned off again: `--log-json=false`.
pub fn layered(command: Command) -> Command {
    command.mut_args(|argument| {
        if !is_setting(&argument) {
            return argument;
        }
        let argument = alone(argument);
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

/// An argument that asks nothing of others.
fn alone(argument: Arg) -> Arg {
    argument
        .required(false)
        .requires(Resettable::<Id>::Reset)
        .conflicts_with(Resettable::<Id>::Reset)
        .required_unless_present(Resettable::<Id>::Reset)
}

impl Settings {
    /// What holds for `command` (as it is, not [`layered`]), of whose command line `matches` is what [`layered`] read.
    ///
    /// The file is the one that `--config` or `VEILOC_CONFIG` names, if any. Relative paths in it are relative to its
    /// folder; those of variables and flags to the working folder. An empty variable or list counts as none; several values stand
    /// in one variable with `;` between them.
    ///
    /// # Errors
    /// [`SettingsError`]: a file that cannot be read, a key that is none, a value of the wrong type or that the flag would
    /// refuse; with file and line, or the variable.
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
            None => file::Found::default(),
        };
        let all = command.get_arguments().filter(|argument| is_setting(argument));
        let all = all.map(|argument| Setting::of(argument, matches, &file, &variables));
        Ok(Self { all: all.collect::<Result<_, _>>()? })
    }

    /// A command line that says all that is not said by default.
    pub fn arguments(&self) -> impl Iterator<Item = OsString> {
        self.all.iter().filter(|setting| setting.origin != Origin::Default).flat_map(Setting::arguments)
    }

    /// The keys, and where the value of each comes from.
    pub fn origins(&self) -> impl Iterator<Item = (&str, &Origin)> {
        self.all.iter().map(|setting| (setting.key.as_str(), &setting.origin))
    }

    /// All of it as a file that says the same, with where each value comes from behind it; paths are absolute. It holds
    /// no secret: keys and tokens are named by their files, and where one stands in an address (a password before an `@`, a
    /// query) `***` is written, with word of it behind.
    ///
    /// # Errors
    /// [`SettingsError::NotText`]: a path that is no UTF-8, which TOML cannot hold.
    pub fn to_toml(&self) -> Result<String, SettingsError> {
        self.all.iter().map(print::lines).collect()
    }
}

impl Setting {
    fn of(
        argument: &Arg,
        matches: &ArgMatches,
        file: &file::Found,
        variables: &dyn Fn(&str) -> Option<OsString>,
    ) -> Result<Self, SettingsError> {
        let key = argument.get_long().unwrap_or_default().to_owned();
        let kind = Kind::of(argument);
        let several = matches!(argument.get_action(), ArgAction::Append);
        let paths = Paths::of(argument);
        let address = kind::is_address(argument);
        let help = argument.get_help().map(ToString::to_string).unwrap_or_default();
        let mut setting =
            Self { key, kind, several, paths, address, help, values: Vec::new(), origin: Origin::Default };
        // What the file says is held against the flag also where it does not hold: a fault that a flag hides comes back.
        let in_file = file.get(&setting.key).filter(|entry| !entry.values.is_empty());
        let in_file = in_file.map(|entry| {
            let origin = Origin::File { path: file.path().to_owned(), line: entry.line };
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
            setting.origin = Origin::Flag;
            setting.values = matches.get_raw(id).into_iter().flatten().map(ToOwned::to_owned).collect();
        } else if let Some(value) = variables(&setting.key).filter(|v| !several || !parts(v).is_empty()) {
            setting.origin = Origin::Variable(variable(&setting.key));
            setting.values = if several { parts(&value) } else { vec![value] };
            for value in &setting.values {
                check(argument, kind, value, &setting.origin)?;
            }
        } else if let Some((values, origin)) = in_file {
            (setting.values, setting.origin) = (values, origin);
        } else {
            setting.values = argument.get_default_values().iter().map(|v| v.to_os_string()).collect();
            if kind == Kind::Switch {
                setting.values = vec!["false".into()];
            }
        }
        if kind == Kind::Switch {
            for value in &mut setting.values {
                *value = fit(value);
            }
        }
        Ok(setting)
    }

    fn arguments(&self) -> Vec<OsString> {
        let flag = OsString::from(format!("--{}", self.key));
        if self.kind == Kind::Switch {
            // Off is how it is without it.
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

    /// The values with absolute paths.
    fn absolute(&self) -> impl Iterator<Item = OsString> {
        let here = std::env::current_dir().unwrap_or_default();
        self.values.iter().map(move |value| self.paths.join(&here, value))
    }
}

/// The values of a variable that holds several.
fn parts(value: &OsString) -> Vec<OsString> {
    match value.to_str() {
        Some(text) => {
            text.split(';').map(str::trim).filter(|part| !part.is_empty()).map(Into::into).collect()
        }
        None => vec![value.clone()],
    }
}

/// A path of the file, from its folder.
fn joined(base: &Path, path: &Path) -> PathBuf {
    // Components that are nothing (`./`) go.
    base.join(path).components().collect()
}

#[cfg(test)]
mod tests;

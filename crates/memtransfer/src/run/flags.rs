//! The flags of `memtransfer run`: those that the table of settings lists, those of them that `memtransfer work` has, and
//! those of one invocation.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, Error, FromArgMatches};
use settings::{KEYS, Key, Layer, MACHINE_KEYS};

/// The settings that were given as flags, each with its text.
#[derive(Debug, Clone, Default)]
pub(crate) struct SettingFlags {
    given: Vec<(&'static str, String)>,
}

impl SettingFlags {
    /// The given values as a layer.
    pub(crate) fn layer(&self) -> Result<Layer> {
        Layer::flags(self.given.iter().map(|(name, text)| (*name, text.as_str())))
    }
}

impl Args for SettingFlags {
    fn augment_args(command: Command) -> Command {
        KEYS.iter().fold(command, add_flag)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for SettingFlags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        Ok(Self { given: given(matches, KEYS) })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

/// The settings among [`MACHINE_KEYS`] that were given as flags.
#[derive(Debug, Clone, Default)]
pub(crate) struct MachineFlags(SettingFlags);

impl MachineFlags {
    /// The given values as a layer.
    pub(crate) fn layer(&self) -> Result<Layer> {
        self.0.layer()
    }
}

fn machine_keys() -> impl Iterator<Item = &'static Key> {
    KEYS.iter().filter(|key| MACHINE_KEYS.contains(&key.name))
}

impl Args for MachineFlags {
    fn augment_args(command: Command) -> Command {
        machine_keys().fold(command, add_flag)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for MachineFlags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        Ok(Self(SettingFlags { given: given(matches, machine_keys()) }))
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

fn add_flag(command: Command, key: &Key) -> Command {
    let arg = Arg::new(key.name).long(key.name).help(key.help_text()).help_heading(key.heading);
    command.arg(if key.is_switch() {
        arg.action(ArgAction::SetTrue)
    } else if key.is_repeated() {
        arg.value_name(key.value_name).action(ArgAction::Append)
    } else {
        // A negative number is reported as out of range, not as an unknown flag.
        arg.value_name(key.value_name).action(ArgAction::Set).allow_negative_numbers(true)
    })
}

fn given(
    matches: &ArgMatches,
    keys: impl IntoIterator<Item = &'static Key>,
) -> Vec<(&'static str, String)> {
    let mut given = Vec::new();
    for key in keys {
        if key.is_switch() {
            given.extend(matches.get_flag(key.name).then(|| (key.name, "true".to_owned())));
        } else {
            let texts = matches.get_many::<String>(key.name).into_iter().flatten();
            given.extend(texts.map(|text| (key.name, text.clone())));
        }
    }
    given
}

/// What concerns one invocation, and not the run.
#[derive(Debug, Default, Args)]
pub(crate) struct RunOptions {
    /// Remove an earlier run from the run's folder, and start over
    #[arg(long)]
    pub(crate) fresh: bool,

    /// Show no progress, only problems
    #[arg(long)]
    pub(crate) quiet: bool,

    /// Write a trace of every process and step for Perfetto (ui.perfetto.dev)
    #[arg(long, value_name = "FILE")]
    pub(crate) trace: Option<PathBuf>,

    /// Print what would run, and stop
    #[arg(long)]
    pub(crate) dry_run: bool,
}

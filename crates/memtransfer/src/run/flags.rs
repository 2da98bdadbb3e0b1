//! The flags of `memtransfer run`: those that the table of settings lists, those of them that `memtransfer work` has, and
//! those of one invocation.

use std::path::PathBuf;

use anyhow::Result;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, Error, FromArgMatches};
use conditions::settings::Effect;
use llm::Source;
use settings::{KEYS, Key, Layer, Origin};

/// Settings that were given as flags, each with its text: any, or [those of a machine](Key::of_machine).
#[derive(Debug, Clone, Default)]
pub(crate) struct KeyFlags<const OF_MACHINE: bool> {
    given: Vec<(&'static str, String)>,
}

pub(crate) type SettingFlags = KeyFlags<false>;
pub(crate) type MachineFlags = KeyFlags<true>;

impl<const OF_MACHINE: bool> KeyFlags<OF_MACHINE> {
    /// The given values as a layer.
    pub(crate) fn layer(&self) -> Result<Layer> {
        Layer::flags(self.given.iter().map(|(name, text)| (*name, text.as_str())))
    }

    fn keys() -> impl Iterator<Item = &'static Key> {
        KEYS.iter().filter(|key| !OF_MACHINE || key.effect == Effect::Machine)
    }
}

impl<const OF_MACHINE: bool> Args for KeyFlags<OF_MACHINE> {
    fn augment_args(command: Command) -> Command {
        Self::keys().fold(command, add_flag)
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl<const OF_MACHINE: bool> FromArgMatches for KeyFlags<OF_MACHINE> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        let mut given = Vec::new();
        for key in Self::keys() {
            if key.is_switch() {
                given.extend(matches.get_flag(key.name).then(|| (key.name, "true".to_owned())));
            } else {
                let texts = matches.get_many::<String>(key.name).into_iter().flatten();
                given.extend(texts.map(|text| (key.name, text.clone())));
            }
        }
        Ok(Self { given })
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

/// What concerns one invocation, and not the run.
#[derive(Debug, Args)]
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

    /// Print what would run, and stop. Starts no program
    #[arg(long)]
    pub(crate) dry_run: bool,

    /// Start the commands that the suite's file names (policy-cmd, memory-cmd, world-cmd); without this they
    /// are shown and refused
    #[arg(long)]
    pub(crate) allow_commands: bool,

    /// Where the model's address was given
    #[arg(skip = Source::SettingsFile)]
    pub(crate) base_url_source: Source,

    /// Where the headers of its requests were given
    #[arg(skip = Source::SettingsFile)]
    pub(crate) header_source: Source,
}

impl RunOptions {
    /// Those of a verb that has no other flag of [`RunOptions`] than `--quiet`.
    pub(crate) fn of(quiet: bool, base_url_source: Source, header_source: Source) -> Self {
        Self {
            fresh: false,
            quiet,
            trace: None,
            dry_run: false,
            allow_commands: false,
            base_url_source,
            header_source,
        }
    }
}

/// Where a setting from `origin` was given.
pub(crate) fn source_of(origin: Option<Origin>) -> Source {
    match origin {
        Some(Origin::CommandLine) => Source::CommandLine,
        Some(Origin::Environment) => Source::Environment,
        Some(Origin::Default | Origin::Policy | Origin::Suite) | None => Source::SettingsFile,
    }
}

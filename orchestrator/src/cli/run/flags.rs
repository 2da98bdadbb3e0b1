//! The flags of `memtransfer run` that the table of settings lists.

use anyhow::Result;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, Error, FromArgMatches};

use crate::settings::{KEYS, Layer};

/// The settings that were given as flags, each with its text.
#[derive(Debug, Clone, Default)]
pub(super) struct SettingFlags {
    given: Vec<(&'static str, String)>,
}

impl SettingFlags {
    /// Their values.
    pub(super) fn layer(&self) -> Result<Layer> {
        Layer::flags(self.given.iter().map(|(name, text)| (*name, text.as_str())))
    }
}

impl Args for SettingFlags {
    fn augment_args(command: Command) -> Command {
        KEYS.iter().fold(command, |command, key| {
            let arg =
                Arg::new(key.name).long(key.name).help(key.help_text()).help_heading(key.heading);
            command.arg(if key.is_switch() {
                arg.action(ArgAction::SetTrue)
            } else if key.is_repeated() {
                arg.value_name(key.value_name).action(ArgAction::Append)
            } else {
                arg.value_name(key.value_name).action(ArgAction::Set)
            })
        })
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for SettingFlags {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, Error> {
        let mut given = Vec::new();
        for key in KEYS {
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

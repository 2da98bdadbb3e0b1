//! The flags that say how the world looks in frames.

use clap::builder::BoolishValueParser;
use clap::{ArgAction, Args};
use domain::Appearance;

/// How the world looks. [`Appearance::flags`] writes these flags.
#[derive(Debug, Clone, Args)]
pub struct AppearanceArgs {
    /// Whether a coloured plate hangs above every item
    #[arg(long, value_name = "on|off", default_value = "off", action = ArgAction::Set,
          value_parser = BoolishValueParser::new(), hide_possible_values = true)]
    plates: bool,
    /// Whether anything is written: names of items, numbers of bays, signs
    #[arg(long, value_name = "on|off", default_value = "on", action = ArgAction::Set,
          value_parser = BoolishValueParser::new(), hide_possible_values = true)]
    labels: bool,
    /// Vary the light and the tints of walls, floor and racks; 0 is the standard look
    #[arg(long, value_name = "N", default_value_t = 0)]
    appearance_seed: u64,
}

impl From<AppearanceArgs> for Appearance {
    fn from(AppearanceArgs { plates, labels, appearance_seed: seed }: AppearanceArgs) -> Self {
        Self { plates, labels, seed }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Flags {
        #[command(flatten)]
        appearance: AppearanceArgs,
    }

    #[test]
    fn flags_are_read_as_they_are_written() {
        let odd = Appearance { plates: true, labels: false, seed: 7 };
        for appearance in [Appearance::STANDARD, odd] {
            let written =
                appearance.flags().into_iter().flat_map(|(flag, value)| [flag.into(), value]);
            let read = Flags::parse_from(std::iter::once("program".to_owned()).chain(written));
            assert_eq!(Appearance::from(read.appearance), appearance);
        }
        let none = Flags::parse_from(["program"]);
        assert_eq!(Appearance::from(none.appearance), Appearance::STANDARD);
    }
}

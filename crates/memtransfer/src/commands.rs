//! Commands that come from a file: shown, and started only if the command line allows it.
//!
//! A suite, which may lie in downloaded assets, and a plan can name programs to start. Its user may not have read it.

use anyhow::{Result, bail};
use domain::names::steers_a_terminal;

/// The flag that allows it. It is no setting, so that no file can hold it.
pub(super) const ALLOW: &str = "--allow-commands";

/// What happens to the commands of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Use {
    /// They are started.
    Start {
        /// Whether the command line allows it.
        allowed: bool,
    },
    /// They are not started.
    Show,
}

/// Shows the `commands` of `file`, each with its key.
///
/// # Errors
/// When they are to be started, and the command line does not allow it.
pub(super) fn check(file: &str, commands: &[(&str, String)], used: Use) -> Result<()> {
    if commands.is_empty() {
        return Ok(());
    }
    let line = |(key, command): &(&str, String)| format!("\n  {key}: {}", on_one_line(command));
    let lines: String = commands.iter().map(line).collect();
    match used {
        Use::Start { allowed: true } => say!("{file} starts these programs:{lines}"),
        Use::Show => say!("{file} starts these programs, if {ALLOW} is given:{lines}"),
        Use::Start { allowed: false } => bail!(
            "{file} starts programs on this machine:{lines}\nThey can do whatever you can. To start them, give {ALLOW}"
        ),
    }
    Ok(())
}

/// The command as it is, but for characters that would hide a part of it.
fn on_one_line(command: &str) -> String {
    let visible = |c: char| match steers_a_terminal(c) {
        true => c.escape_default().to_string(),
        false => c.to_string(),
    };
    command.chars().map(visible).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_of_a_file_are_refused_with_all_of_them_unless_they_are_allowed() {
        let commands =
            [("policy-cmd", "python a.py\n\u{1b}[2J".to_owned()), ("memory-cmd", "b".into())];
        let check =
            |commands, used| check("the suite x", commands, used).map_err(|e| e.to_string());
        insta::assert_snapshot!(check(&commands, Use::Start { allowed: false }).unwrap_err(), @r"
        the suite x starts programs on this machine:
          policy-cmd: python a.py\n\u{1b}[2J
          memory-cmd: b
        They can do whatever you can. To start them, give --allow-commands
        ");
        for (commands, used) in [
            (&commands[..], Use::Start { allowed: true }),
            (&commands, Use::Show),
            (&[], Use::Start { allowed: false }),
        ] {
            assert_eq!(check(commands, used), Ok(()));
        }
    }
}

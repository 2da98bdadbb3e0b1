//! What programs have in common: logging to stderr, the message of a fatal error, the exit status, and the flags that
//! several of them have.

mod appearance;

use std::ffi::OsStr;
use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;

use clap::builder::Resettable;
use clap::{Arg, Command, Parser};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

pub use appearance::AppearanceArgs;

/// The environment variable that sets log levels: `debug`, or `warn,memory_proc=debug`.
const LEVELS_VARIABLE: &str = "RUST_LOG";

/// Sends log messages to stderr, warnings and errors unless `RUST_LOG` says otherwise. An invalid `RUST_LOG` is reported
/// and ignored.
pub fn log_to_stderr() {
    let default = Targets::new().with_default(LevelFilter::WARN);
    let levels = match std::env::var(LEVELS_VARIABLE) {
        Ok(text) if !text.is_empty() => text.parse().unwrap_or_else(|error| {
            eprintln!(
                "{LEVELS_VARIABLE}={text} is not valid ({error}); logging warnings and errors"
            );
            default
        }),
        _ => default,
    };
    let format = tracing_subscriber::fmt::layer()
        .with_ansi(io::stderr().is_terminal())
        .with_writer(io::stderr);
    tracing_subscriber::registry().with(format).with(levels).init();
}

/// Reads the command line. A variable that stands for a flag counts as not set when it is empty.
pub fn parse<T: Parser>() -> T {
    let matches = without_empty_variables(T::command()).get_matches();
    T::from_arg_matches(&matches).unwrap_or_else(|error| error.exit())
}

/// The command without the variables that are empty, which clap would take as values.
fn without_empty_variables(command: Command) -> Command {
    let is_empty = |variable: &OsStr| std::env::var_os(variable).is_some_and(|it| it.is_empty());
    let without = |arg: Arg| match arg.get_env().is_some_and(is_empty) {
        true => arg.env(Resettable::Reset),
        false => arg,
    };
    command.mut_args(without).mut_subcommands(without_empty_variables)
}

/// Runs the main function of the program `name` with logging to stderr. An error is printed and becomes exit status 2.
pub fn run(name: &str, main: impl FnOnce() -> anyhow::Result<ExitCode>) -> ExitCode {
    log_to_stderr();
    main().unwrap_or_else(|error| {
        // `memtransfer cache ls | head` is not an error.
        if is_closed_pipe(&error) {
            return ExitCode::SUCCESS;
        }
        // A terminal that was closed does not change how the program ends.
        let _ = writeln!(io::stderr(), "{name}: {}", printable(&format!("{error:#}")));
        ExitCode::from(2)
    })
}

/// Whether standard output was closed by what read it.
pub fn is_closed_pipe(error: &anyhow::Error) -> bool {
    let io_error = error.downcast_ref::<io::Error>();
    io_error.is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

/// The text with a mark in place of each control character but tabs and line ends: what a model, a server or a run folder
/// from elsewhere says must not steer a terminal.
pub fn printable(text: &str) -> String {
    text.replace(|c: char| c.is_control() && !matches!(c, '\n' | '\t'), "\u{fffd}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_do_not_reach_the_terminal() {
        assert_eq!(
            printable("Größe:\t7\n\u{1b}[2J\r\u{9b}1m"),
            "Größe:\t7\n\u{fffd}[2J\u{fffd}\u{fffd}1m"
        );
    }
}

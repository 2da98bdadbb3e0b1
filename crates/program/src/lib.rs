//! What programs have in common: logging to stderr, the message of a fatal error, the exit status, and the flags that
//! several of them have.

mod appearance;

use std::ffi::{OsStr, OsString};
use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;
use std::sync::Arc;

use clap::builder::Resettable;
use clap::{Arg, Command, Parser};
use domain::names::steers_a_terminal;
use signal_hook::consts::SIGXFSZ;
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;

pub use appearance::AppearanceArgs;

/// The environment variable that sets log levels: `debug`, or `warn,memory_proc=debug`.
const LEVELS_VARIABLE: &str = "RUST_LOG";

/// The environment variable that asks for text without colours (<https://no-color.org>).
const NO_COLOUR_VARIABLE: &str = "NO_COLOR";

/// Sends log messages to stderr, warnings and errors unless `RUST_LOG` says otherwise. An invalid `RUST_LOG` is reported
/// and ignored. Call it first: it also makes a file that grows beyond `ulimit -f` an error instead of the program's end.
pub fn log_to_stderr() {
    // A handler of any kind does; it fails only where the signal does not exist.
    let _ = signal_hook::flag::register(SIGXFSZ, Arc::default());
    let default = Targets::new().with_default(LevelFilter::WARN);
    let levels = match std::env::var(LEVELS_VARIABLE) {
        Ok(text) if !text.is_empty() => text.parse().unwrap_or_else(|error| {
            let message = "is not valid; logging warnings and errors";
            let _ = writeln!(io::stderr(), "{LEVELS_VARIABLE}={text} {message}: {error}");
            default
        }),
        _ => default,
    };
    let is_coloured = is_screen(&io::stderr()) && !is_set(NO_COLOUR_VARIABLE);
    let format = tracing_subscriber::fmt::layer().with_ansi(is_coloured).with_writer(io::stderr);
    tracing_subscriber::registry().with(format).with(levels).init();
}

/// Whether `stream` is a terminal that moves its cursor and erases lines; one with `TERM=dumb` does not.
pub fn is_screen(stream: &impl IsTerminal) -> bool {
    stream.is_terminal() && std::env::var_os("TERM").is_some_and(|term| term != "dumb")
}

/// Whether an environment variable has a value that is not empty.
fn is_set(variable: &str) -> bool {
    std::env::var_os(variable).is_some_and(|value| !value.is_empty())
}

/// Reads the command line. A variable that stands for a flag counts as not set when it is empty.
pub fn parse<T: Parser>() -> T {
    parse_from(std::env::args_os())
}

/// Reads a command line as [`parse`] does. The first argument is the program's name.
pub fn parse_from<T: Parser>(arguments: impl IntoIterator<Item = OsString>) -> T {
    let matches = without_empty_variables(T::command()).get_matches_from(arguments);
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
        let message = with_advice(&in_one_line(&error));
        let _ = writeln!(io::stderr(), "{name}: {}", printable(&message));
        ExitCode::from(2)
    })
}

/// An error and its causes, without causes that an error's own message contains.
pub fn in_one_line(error: &anyhow::Error) -> String {
    error.chain().fold(String::new(), |line, cause| match cause.to_string() {
        cause if line.is_empty() => cause,
        cause if line.contains(&cause) => line,
        cause => format!("{line}: {cause}"),
    })
}

/// Whether standard output was closed by what read it.
pub fn is_closed_pipe(error: &anyhow::Error) -> bool {
    let io_error = error.downcast_ref::<io::Error>();
    io_error.is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

/// The message of an error, with what to do about a limit of the shell that it comes from. Decided by its words, because the
/// message may be another program's.
pub fn with_advice(message: &str) -> String {
    let says = |words: &[&str]| words.iter().any(|words| message.contains(words));
    let advice = if says(&["(os error 24)", "Too many open files", "FileHandleLimit"]) {
        "raise the limit of open files, for example `ulimit -n 4096`"
    } else if says(&["(os error 27)", "File too large"]) {
        "a file may not grow beyond the limit of `ulimit -f`: raise it"
    } else if says(&["(os error 11)"]) {
        "the limit of processes and threads of your user may be too low: see `ulimit -u`"
    } else {
        return message.to_owned();
    };
    // A message may be passed on from program to program.
    if message.contains(advice) { message.to_owned() } else { format!("{message}\n{advice}") }
}

/// The text with a mark in place of each character that steers a terminal but tabs and line ends: what a model, a server or a run folder
/// from elsewhere says must not steer a terminal.
pub fn printable(text: &str) -> String {
    text.replace(|c: char| steers_a_terminal(c) && !matches!(c, '\n' | '\t'), "\u{fffd}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_a_limit_says_which() {
        let error = |code| io::Error::from_raw_os_error(code).to_string();
        for (message, limit) in [
            (error(24), "ulimit -n"),
            (error(27), "ulimit -f"),
            (format!("cannot start a thread: {}", error(11)), "ulimit -u"),
        ] {
            let advised = with_advice(&message);
            assert!(advised.starts_with(&message) && advised.contains(limit), "{advised}");
            assert_eq!(with_advice(&advised), advised);
        }
        assert_eq!(with_advice(&error(2)), error(2));
    }

    #[test]
    fn causes_are_not_repeated() {
        let missing = || io::Error::new(io::ErrorKind::NotFound, "no such file");
        let own = anyhow::Error::from(missing()).context("cannot read x: no such file");
        assert_eq!(in_one_line(&own), "cannot read x: no such file");
        assert_eq!(in_one_line(&own.context("no suite")), "no suite: cannot read x: no such file");
    }

    #[test]
    fn control_characters_do_not_reach_the_terminal() {
        assert_eq!(
            printable("Größe:\t7\n\u{1b}[2J\r\u{9b}1m \u{202e}drow\u{2069}"),
            "Größe:\t7\n\u{fffd}[2J\u{fffd}\u{fffd}1m \u{fffd}drow\u{fffd}"
        );
    }
}

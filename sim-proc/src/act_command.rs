//! `sim-proc act`: acts out episodes and demonstrations that another program names, for as long as it asks.

use std::io::{BufRead, Write};

use anyhow::{Context, Result};
use case_book::act::{ActAnswer, ActRequest};
use warehouse::act::Stage;

use crate::worlds::WorldsArgs;

/// Arguments of `sim-proc act`. Every line of stdin is a request, as JSON (`case_book::act::ActRequest`), and is answered with
/// a line of JSON on stdout (`ActAnswer`). One that cannot be met is answered with an `error`.
#[derive(Debug, clap::Args)]
pub struct ActArgs {
    #[command(flatten)]
    worlds: WorldsArgs,
}

/// Answers until stdin ends.
///
/// # Errors
/// Files of the worlds that cannot be used, lines that cannot be read.
pub fn run(args: &ActArgs) -> Result<()> {
    let mut stage = Stage::new(args.worlds.read()?);
    let mut stdout = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let line = line.context("cannot read the requests")?;
        let mut answer = serde_json::to_vec(&answer(&mut stage, &line))?;
        answer.push(b'\n');
        // A pipe that closed means that no more answers are wanted.
        if stdout.write_all(&answer).and_then(|()| stdout.flush()).is_err() {
            break;
        }
    }
    Ok(())
}

fn answer(stage: &mut Stage, line: &str) -> ActAnswer {
    match serde_json::from_str::<ActRequest>(line) {
        Ok(request) => stage.answer(&request),
        Err(error) => ActAnswer::Error(format!("this is no request: {error}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_met_is_answered_with_an_error_and_the_next_request_is_met() {
        let args = WorldsArgs { assets: None, streams: None, elsewhere: None };
        let mut stage = Stage::new(args.read().unwrap());
        let mut asked = |line: &str| serde_json::to_string(&answer(&mut stage, line)).unwrap();
        let episode = |case: &str, variant: u32, begin: &str, actions: &str| {
            format!(
                r#"{{"episode":{{"case":"{case}","variant":{variant},"reference":null,"begin":{begin},"actions":[{actions}],"stream":null,"parts":{{}}}}}}"#
            )
        };
        for (line, expected) in [
            (String::new(), "this is no request"),
            ("{\"scene\":\"x\"}".to_owned(), "this is no request"),
            ("{\"scene\":7000}".to_owned(), "there is no world variant 7000"),
            (episode("t99-01", 0, "null", ""), "there is no case t99-01"),
            (episode("t01-01", 0, "null", ""), "needs a begin"),
            (episode("t01-01", 0, "[255,255,0]", ""), "not free floor"),
            (episode("t01-01", 0, "[3,12,4]", ""), "4 is not a heading"),
            (episode("t01-01", 0, "[3,12,0]", "0,9"), "9 is not an action"),
        ] {
            let told = asked(&line);
            assert!(told.starts_with("{\"error\":") && told.contains(expected), "{line}: {told}");
        }
        let acted = asked(&episode("t01-01", 0, "[3,12,0]", "0,null"));
        assert!(acted.starts_with("{\"episode\":"), "{acted}");
    }
}

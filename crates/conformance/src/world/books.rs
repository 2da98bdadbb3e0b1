//! What a world says outside of a run: its case book, and episodes that it acts out.

use std::ffi::OsString;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::Ordering;
use std::time::Instant;

use anyhow::Context;
use case_book::act::{ActAnswer, ActRequest};
use case_book::{
    BookFile, BookRequest, CASE_BOOK_FILE, CaseBook, CaseFacts, DEMONSTRATIONS_FILE, Demonstration,
    DemonstrationBook, Reference,
};
use domain::{DemonstrationKind, Demonstrations, Route, Start};
use shm_types::message::Role;
use supervise::{Launch, output_until};

use super::{WorldRole, books_folder};
use crate::Kit;
use crate::subject::{CheckResult, Trouble, wrong};

/// Cases whose references are acted out, at most: some of each part of the book.
const TESTED_CASES: usize = 10;

/// Longest part of what a program has printed, in bytes from its end.
const PRINTED_BYTES: usize = 2000;

/// The case book of the world.
#[derive(Debug)]
pub(crate) struct WorldBooks {
    pub(crate) cases: CaseBook,
    pub(crate) demonstrations: DemonstrationBook,
}

impl WorldBooks {
    fn read(folder: &Path) -> CheckResult<Self> {
        let problem = |error: case_book::BookError| Trouble::Wrong(error.to_string());
        Ok(Self {
            cases: BookFile::read(&folder.join(CASE_BOOK_FILE)).map_err(problem)?.book,
            demonstrations: BookFile::read(&folder.join(DEMONSTRATIONS_FILE))
                .map_err(problem)?
                .book,
        })
    }

    /// The case book that was written before.
    pub(crate) fn of(kit: &Kit<'_, WorldRole>) -> CheckResult<Self> {
        Self::read(&books_folder(kit.run.path()))
    }

    pub(crate) fn is_deterministic(&self) -> bool {
        self.cases.world.declaration.is_deterministic
    }

    /// The cases whose references are acted out, with their indices.
    pub(crate) fn tested(&self) -> Vec<(usize, &CaseFacts)> {
        let (all, some) = (self.cases.cases.len(), self.cases.cases.len().min(TESTED_CASES));
        (0..some)
            .map(|number| number * all / some)
            .map(|index| (index, &self.cases.cases[index]))
            .collect()
    }

    /// The first demonstration at the original start in the unchanged world, with its index.
    pub(crate) fn first_demonstration(&self) -> Option<(u32, &Demonstration)> {
        let is_it = |of: &&Demonstration| (of.kind, of.variant) == (DemonstrationKind::Original, 0);
        let index = self.demonstrations.demonstrations.iter().position(|of| is_it(&of))?;
        Some((index as u32, &self.demonstrations.demonstrations[index]))
    }

    /// The original demonstration of a case.
    pub(crate) fn original(&self, case: usize) -> Option<&Demonstration> {
        let index = self.demonstrations.find(case as u32, DemonstrationKind::Original, 0)?;
        self.demonstrations.demonstrations.get(index as usize)
    }

    /// What [`BookFile`] does not check, in a sentence.
    fn problem(&self) -> Option<String> {
        let Self { cases, demonstrations } = self;
        if cases.cases.is_empty() {
            return Some("it has no cases".to_owned());
        }
        if cases.world.declaration != demonstrations.world {
            return Some("its two files declare different worlds".to_owned());
        }
        let counts = (cases.cases.len(), demonstrations.cases.len());
        if counts.0 != counts.1 {
            return Some(format!("its two files have {} and {} cases", counts.0, counts.1));
        }
        cases.cases.iter().enumerate().find_map(|(index, case)| {
            let problem = self.case_problem(index, case)?;
            Some(format!("case {} {problem}", case.id))
        })
    }

    fn case_problem(&self, index: usize, case: &CaseFacts) -> Option<String> {
        if case.instruction.trim().is_empty() {
            return Some("has no instruction".to_owned());
        }
        if self.cases.world.task(case.task).is_none() {
            return Some(format!("is of task {}, which is not declared", case.task));
        }
        for (start, name) in [(Start::Original, "original"), (Start::New, "new")] {
            if case.reference(start, Route::Unchanged).is_none() {
                return Some(format!("has no reference from its {name} start"));
            }
        }
        let is_short = |of: &&Reference| of.length == 0 || of.length as usize > of.actions.len();
        if let Some(of) = case.references.iter().find(is_short) {
            let (length, actions) = (of.length, of.actions.len());
            return Some(format!("has a reference of length {length} with {actions} actions"));
        }
        let of_set = self.demonstrations.of_case(index as u32, Demonstrations::ORIGINAL);
        (of_set.is_none() || self.original(index).is_none())
            .then(|| "has no demonstration from its original start".to_owned())
    }
}

/// Has the world write its case book, as a run does: once to find out which cases there are, then with all of them.
pub(super) fn write(kit: &Kit<'_, WorldRole>) -> CheckResult<WorldBooks> {
    let folder = books_folder(kit.run.path());
    write_into(kit, &BookRequest::default(), &folder)?;
    let every = WorldBooks::read(&folder)?;
    let ids: Vec<String> = every.cases.ids().into_iter().map(str::to_owned).collect();
    let has_blocked = |case: &CaseFacts| case.reference(Start::New, Route::Blocked).is_some();
    let request = BookRequest {
        blocked: every.cases.cases.iter().any(has_blocked),
        cases: ids,
        demonstrations: vec![Demonstrations::ORIGINAL],
        ..BookRequest::default()
    };
    write_into(kit, &request, &folder)?;
    let books = WorldBooks::read(&folder)?;
    if let Some(problem) = books.problem() {
        return wrong(problem);
    }
    let again = kit.run.path().join("books-again");
    write_into(kit, &request, &again)?;
    for name in [CASE_BOOK_FILE, DEMONSTRATIONS_FILE] {
        let read = |folder: &Path| fs::read(folder.join(name)).context("cannot read a case book");
        if read(&folder)? != read(&again)? {
            return wrong(format_args!("the same request leads to another {name} the second time"));
        }
    }
    Ok(books)
}

fn write_into(kit: &Kit<'_, WorldRole>, request: &BookRequest, out: &Path) -> CheckResult<()> {
    let asked = kit.run.path().join("book-request.json");
    let text = serde_json::to_vec(request).map_err(anyhow::Error::from)?;
    fs::write(&asked, text).context("cannot write a request")?;
    let arguments = ["book".into(), "--request".into(), asked.into(), "--out".into(), out.into()];
    run_verb(kit, "book", arguments, Stdio::null()).map(drop)
}

/// What the world answers to `requests` with its verb `act`.
pub(super) fn act(
    kit: &Kit<'_, WorldRole>,
    requests: &[ActRequest],
) -> CheckResult<Vec<ActAnswer>> {
    let asked: PathBuf = kit.run.path().join("act-requests");
    let lines: Result<Vec<String>, _> = requests.iter().map(serde_json::to_string).collect();
    let lines = lines.map_err(anyhow::Error::from)?.join("\n") + "\n";
    fs::write(&asked, lines).context("cannot write requests")?;
    let stdin = File::open(&asked).context("cannot read requests")?;
    let printed = run_verb(kit, "act", ["act".into()], stdin.into())?;
    let answers: Result<Vec<ActAnswer>, _> = printed.lines().map(serde_json::from_str).collect();
    match answers {
        Ok(answers) if answers.len() == requests.len() => Ok(answers),
        Ok(answers) => wrong(format_args!(
            "`act` has answered {} of {} requests",
            answers.len(),
            requests.len()
        )),
        Err(error) => wrong(format_args!("`act` has printed a line that is no answer: {error}")),
    }
}

/// Runs the world's command with `arguments` until it ends. Returns what it has printed.
fn run_verb(
    kit: &Kit<'_, WorldRole>,
    verb: &str,
    arguments: impl IntoIterator<Item = OsString>,
    stdin: Stdio,
) -> CheckResult<String> {
    let terms = kit.terms;
    let launch = Launch::command(Role::Sim, terms.command)?;
    let mut command = Command::new(&launch.program);
    command.args(launch.args).args(arguments).stdin(stdin);
    let deadline = Instant::now() + terms.start_timeout;
    let is_over = || Instant::now() > deadline || terms.stop.load(Ordering::Relaxed);
    let ended = output_until(&mut command, is_over);
    let ended = ended.with_context(|| {
        let program = launch.program.display();
        format!(
            "cannot start the world command `{}`: there is no program `{program}` that can be run",
            terms.command
        )
    })?;
    terms.check_stop()?;
    let Some(ended) = ended else {
        let seconds = terms.start_timeout.as_secs();
        return wrong(format_args!("`{verb}` has not ended within {seconds} s"));
    };
    if !ended.status.success() {
        let printed = String::from_utf8_lossy(&ended.stderr);
        let start = printed.floor_char_boundary(printed.len().saturating_sub(PRINTED_BYTES));
        return wrong(format_args!(
            "`{verb}` ended with {}: {}",
            ended.status,
            printed[start..].trim()
        ));
    }
    String::from_utf8(ended.stdout).or_else(|_| wrong(format_args!("`{verb}` prints no UTF-8")))
}

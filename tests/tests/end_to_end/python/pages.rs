//! The examples of pages, run as a reader runs them: in a folder with the wheel, its environment and, for pages that name files of the
//! repository, a checkout. Their runs are kept small by `MEMTRANSFER_*` variables.
//!
//! Every fenced block of a page is an example of its language, in the order of the page:
//! - `sh`: run by bash, with the variables that earlier blocks have exported;
//! - `python`: a script that has to run as it stands. After "Save this as `name.py`:" it is written to that file instead, for later blocks;
//! - `rust`: an excerpt of an example of the repository;
//! - `text`: what a program prints, which is not compared.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

use memtransfer_tests::{Bench, Ended, needs, program, repository, write_program};
use rigs::chat_server::{Reaction, Server, completion};
use serde_json::json;

use super::python;
use super::wheel::WHEEL;

/// A command that cannot be run here as it stands, and the nearest one that can.
struct Substitute {
    command: &'static str,
    instead: &'static str,
    reason: &'static str,
}

/// All exceptions. The functions and variables are those of [`PRELUDE`] and [`Reader::new`].
const SUBSTITUTES: [Substitute; 10] = [
    Substitute {
        command: "http://localhost:8000/v1",
        instead: "$OPENAI_BASE_URL",
        reason: "a scripted server on a free port stands for the model's",
    },
    Substitute {
        command: "cargo xtask demo",
        instead: "$XTASK demo --help",
        reason: "it installs and builds, as was done before this test",
    },
    Substitute {
        command: "cargo xtask test",
        instead: "$XTASK test --help",
        reason: "it runs this test",
    },
    Substitute {
        command: "memtransfer view ",
        instead: "until_served memtransfer view --no-browser ",
        reason: "it serves until it is stopped",
    },
    Substitute {
        command: "memtransfer run --policy external",
        instead: "attach 'python python/examples/random_policy.py' memtransfer run --policy external",
        reason: "it waits until the reader starts a policy as it prints",
    },
    Substitute {
        command: "memtransfer run --memory working,external",
        instead: "attach 'python serve_top_three.py' memtransfer run --memory working,external",
        reason: "it waits until the reader starts a memory as it prints",
    },
    Substitute {
        command: "memtransfer run --world external",
        instead: "attach 'python corridor_world.py' memtransfer run --world external",
        reason: "it waits until the reader starts the world as it prints",
    },
    Substitute {
        command: "pip install --require-hashes -r examples/memories/bm25/requirements.txt",
        instead: "use_packages $BM25 examples/memories/bm25/requirements.txt",
        reason: "tests download nothing: set-up has installed the packages into an environment of their own",
    },
    Substitute {
        command: "rerun t01-01.mcap",
        instead: "$EXPORTS -m rerun mcap convert t01-01.mcap -o t01-01.rrd && $EXPORTS -m rerun rrd verify t01-01.rrd",
        reason: "there is no screen: Rerun reads the file without its window",
    },
    Substitute {
        command: "PYTHONPATH=python python benches/baselines/steps.py",
        instead: "python -m py_compile benches/baselines/steps.py",
        reason: "its packages are installed for benches only",
    },
];

/// What substitutes call.
const PRELUDE: &str = r#"
# until_served COMMAND...: starts a server, opens the address that it prints, and stops it.
until_served() {
    "$@" > served.log 2>&1 &
    until address=$(grep --only-matching --max-count 1 'http://[^ ]*' served.log); do
        kill -0 $! || { cat served.log; return 1; }
        sleep 0.1
    done
    python -c 'import sys, urllib.request; urllib.request.urlopen(sys.argv[1])' "$address"
    kill $!
    wait $! || true
}

# attach PROGRAM COMMAND...: starts a run, and PROGRAM with the command line that the run prints.
attach() {
    local program=$1
    shift
    "$@" > run.log 2>&1 &
    until line=$(grep --max-count 1 'MEMTRANSFER_ATTACH=.* your-program' run.log); do
        kill -0 $! || { cat run.log; return 1; }
        sleep 0.1
    done
    eval "${line/your-program/$program}"
    wait $!
}

# use_packages PYTHON REQUIREMENTS: uses the packages of another environment, which has to meet the requirements.
use_packages() {
    $PIP --python "$1" install --dry-run --require-hashes --requirement "$2"
    PYTHONPATH=$("$1" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
    export PYTHONPATH
}

[ ! -e variables ] || . ./variables
set -euo pipefail
"#;

/// Writes the exported variables for the next block.
const EPILOGUE: &str = "\nexport -p > variables\n";

/// A fenced block of a page.
struct Block<'a> {
    /// The line of its first fence, from 1.
    line: usize,
    language: &'a str,
    text: String,
    /// The file that the page says to save it as.
    file: Option<&'a str>,
}

/// The fenced blocks of a page. Panics at an indented block: it would look like an example and not be run.
fn blocks<'a>(page: &str, text: &'a str) -> Vec<Block<'a>> {
    let mut blocks: Vec<Block<'a>> = Vec::new();
    let (mut is_open, mut after_empty, mut paragraph) = (false, false, "");
    for (index, line) in text.lines().enumerate() {
        match (is_open, line.strip_prefix("```")) {
            (false, Some(language)) => {
                let file = paragraph.strip_suffix("`:").and_then(|text| text.rsplit('`').next());
                let file = file.filter(|name| name.ends_with(".py"));
                blocks.push(Block { line: index + 1, language, text: String::new(), file });
                is_open = true;
            }
            (true, Some(_)) => (is_open, paragraph) = (false, ""),
            (true, None) => {
                let block = blocks.last_mut().expect("it is open");
                block.text += line;
                block.text.push('\n');
            }
            (false, None) => {
                let place = format!("{page}:{}", index + 1);
                let is_indented = line.starts_with("    ") || line.starts_with('\t');
                assert!(
                    !(after_empty && is_indented),
                    "{place}: an indented block is not run: fence it"
                );
                assert!(
                    !line.trim_start().starts_with("```"),
                    "{place}: an indented fence is not run"
                );
                if !line.is_empty() {
                    paragraph = line;
                }
            }
        }
        after_empty = line.is_empty();
    }
    assert!(!is_open, "{page}: the last block has no end");
    blocks
}

/// A reader's folder, environment and variables.
struct Reader {
    bench: Bench,
    environment: PathBuf,
    server: Server,
}

impl Reader {
    fn new() -> Self {
        let bench = Bench::new();
        let environment = bench.out("environment");
        python(&["-m", "venv", "--without-pip", environment.to_str().unwrap()], &[]).expect(0);
        // What pip would download: the packages of the tests.
        let packages = |python: &Path| {
            let print = "import sysconfig; print(sysconfig.get_path('purelib'))";
            Ended::run(Command::new(python).args(["-c", print])).expect(0).stdout
        };
        let link =
            PathBuf::from(packages(&environment.join("bin/python")).trim_end()).join("tests.pth");
        fs::write(link, packages(&needs::python())).unwrap();
        let pip = environment.join("bin/pip");
        write_program(&pip, "#!/bin/sh\nexec $PIP --python \"$(dirname \"$0\")/python\" \"$@\"\n");
        for folder in ["benches", "examples", "python"] {
            symlink(repository(folder), bench.out(folder)).unwrap();
        }
        fs::copy(&*WHEEL, bench.folder.path().join(WHEEL.file_name().unwrap())).unwrap();
        let server = Server::start(|request| {
            // `doctor` expects that images count.
            let images = request.body.to_string().matches("\"image_url\":{").count();
            let mut answer = completion("Action: turn left");
            answer["usage"]["prompt_tokens"] = json!(10 + 100 * images);
            Reaction::json(200, &answer)
        });
        Self { bench, environment, server: server.unwrap() }
    }

    /// Runs shell commands and panics unless they succeed. `place` is the page and line.
    fn run(&self, place: &str, commands: &str) {
        let substituted = SUBSTITUTES
            .iter()
            .fold(commands.to_owned(), |text, it| text.replace(it.command, it.instead));
        let path = format!(
            "{}:{}",
            self.environment.join("bin").display(),
            std::env::var("PATH").unwrap()
        );
        let mut bash = Command::new("bash");
        bash.args(["-c", &format!("{PRELUDE}{substituted}{EPILOGUE}")])
            .current_dir(self.bench.folder.path())
            .env("PATH", path)
            .env("MEMTRANSFER_RUN_DIR", self.bench.registry.path())
            .env_remove("MEMTRANSFER_ATTACH")
            // Runs of one case, unless a flag says otherwise, with a few steps and small frames.
            .envs([
                ("MEMTRANSFER_LIMIT", "1"),
                ("MEMTRANSFER_MAX_STEPS", "8"),
                ("MEMTRANSFER_FRAME_SIZE", "64"),
            ])
            .env("OPENAI_BASE_URL", self.server.base_url())
            .env("OPENAI_API_KEY", "none")
            .env("MEMTRANSFER_RESPONSE_CACHE", "./responses")
            // Wheels alone, at hand alone.
            .envs([
                ("PIP_NO_INDEX", "1"),
                ("PIP_NO_DEPS", "1"),
                ("PIP_DISABLE_PIP_VERSION_CHECK", "1"),
            ])
            .env("PIP", format!("{} -m pip", needs::python().display()))
            .env("PYTHONDONTWRITEBYTECODE", "1")
            .env("BM25", needs::memory_python("bm25"))
            .env("EXPORTS", needs::exports_python())
            .env("XTASK", program("xtask"));
        let ended = Ended::run(&mut bash);
        let output = format!("{}\n{}", ended.stdout, ended.stderr);
        assert_eq!(ended.status, Some(0), "{place}:\n{substituted}\n{output}");
        // pip only warns of an extra that the package does not have.
        assert!(!output.contains("does not provide the extra"), "{place}:\n{output}");
    }
}

/// The pages, each with what its examples take as done before.
const PAGES: [(&str, &str); 8] = [
    ("README.md", ""),
    ("docs/memory.md", ""),
    ("docs/python.md", ""),
    ("docs/own-world.md", ""),
    ("docs/gymnasium.md", ""),
    ("docs/external-policies.md", INSTALL),
    ("docs/exports.md", EXPORTED_RUNS),
    ("python/README.md", INSTALL),
];

const INSTALL: &str = "pip install memtransfer-*.whl";

const EXPORTED_RUNS: &str = "\
pip install memtransfer-*.whl
memtransfer demo --cases t01-01
memtransfer run --suite rq1 --policy openai --model NAME --base-url $OPENAI_BASE_URL --documents extractive";

/// Runs the blocks of one of the [`PAGES`].
fn check(page: &str) {
    let (_, before) = PAGES.iter().find(|(name, _)| *name == page).expect("a page of the list");
    let text = fs::read_to_string(repository(page)).unwrap();
    let reader = Reader::new();
    reader.run(&format!("before {page}"), before);
    for Block { line, language, text, file } in blocks(page, &text) {
        let place = format!("{page}:{line}");
        match (language, file) {
            ("sh", None) => reader.run(&place, &text),
            ("python", Some(file)) => fs::write(reader.bench.out(file), text).unwrap(),
            ("python", None) => {
                let script = format!("line_{line}.py");
                fs::write(reader.bench.out(&script), text).unwrap();
                reader.run(&place, &format!("python {script}"));
            }
            ("rust", None) => assert!(is_excerpt(&text), "{place}: no Rust example has this text"),
            ("text", None) => assert!(!has_command(&text), "{place}: fence commands as `sh`"),
            other => panic!("{place}: blocks of {other:?} are not run"),
        }
    }
    assert_eq!(reader.bench.leftovers(), Vec::<String>::new());
}

/// Whether an example of the repository in Rust contains this text.
fn is_excerpt(text: &str) -> bool {
    ["rust-policy", "rust-memory", "rust-world"].iter().any(|example| {
        let source = repository(&format!("examples/{example}/src/main.rs"));
        fs::read_to_string(source).unwrap().contains(text)
    })
}

fn has_command(text: &str) -> bool {
    let commands = ["cargo ", "export ", "memtransfer ", "pip ", "python "];
    text.lines().any(|line| commands.iter().any(|command| line.starts_with(command)))
}

#[test]
fn examples_of_the_readme_run() {
    check("README.md");
}

#[test]
fn examples_of_the_page_of_memories_run() {
    check("docs/memory.md");
}

#[test]
fn examples_of_the_page_of_python_run() {
    check("docs/python.md");
}

#[test]
fn examples_of_the_page_of_worlds_run() {
    check("docs/own-world.md");
}

#[test]
fn examples_of_the_page_of_gymnasium_run() {
    check("docs/gymnasium.md");
}

#[test]
fn examples_of_the_page_of_external_policies_run() {
    check("docs/external-policies.md");
}

#[test]
fn examples_of_the_page_of_exports_run() {
    check("docs/exports.md");
}

#[test]
fn examples_of_the_packages_readme_run() {
    check("python/README.md");
}

#[test]
fn every_substitute_is_of_a_command_in_a_page() {
    let pages = PAGES.map(|(page, _)| fs::read_to_string(repository(page)).unwrap());
    for Substitute { command, reason, .. } in &SUBSTITUTES {
        let is_used = pages.iter().any(|page| page.contains(command));
        assert!(is_used, "no page has `{command}`, whose substitute is there because {reason}");
    }
}

#[test]
#[should_panic(expected = "page:3: an indented block is not run")]
fn an_indented_block_is_refused() {
    blocks("page", "Run this:\n\n    memtransfer demo\n");
}

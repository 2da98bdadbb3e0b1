//! The program of a world: what it does is said by its arguments, which a run adds to its command.

use std::io::{BufRead, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use case_book::act::{ActAnswer, ActRequest};
use case_book::{
    BookFile, BookRequest, CASE_BOOK_FILE, DEMONSTRATIONS_FILE, DemonstrationBook, GREY_VARIANT,
    WorldDeclaration,
};
use domain::{ActionCode, Mismatch};
use shm_types::clock::{Instant, sleep};
use shm_types::message::Role;
use shm_types::process::check_shared_memory;
use shm_types::{Attach, Bus, WORLD_INDEX_VARIABLE};

use super::acting::ActingSimulator;
use super::book::write_books;
use super::serving::serve_watched;
use super::simulated::SimulatedWorld;
use super::simulator::{CaseDeclaration, Simulator, TrajectoryName};
use super::stage::{Stage, StageBegin};
use super::{GREY, RenderSetup, World, WorldFailure};
use crate::error::ServeError;
use crate::run::{Until, folder_from_environment, serve_generations};

/// How long to wait for the shared memory of the generation before.
const ROOM_TIMEOUT: Duration = Duration::from_secs(30);

/// How the program of a world is used.
pub const USAGE: &str = "\
usage: WORLD VERB, as `memtransfer run --world-cmd WORLD` adds it

  book --out DIR [--request FILE]            write the case book: all of it, or what a run asks for
  serve --demonstrations FILE                take part in the run that MEMTRANSFER_ATTACH names until it stops
  act                                        act out the episodes that stdin names, a line of JSON each
  views --size WIDTHxHEIGHT                  draw what each line of stdin names, CASE.TRAJECTORY.LETTERS, as RGBA to stdout
";

/// Does what `arguments` say, which do not begin with the name of the program.
///
/// # Errors
/// Arguments that are not understood, with the usage; files that cannot be read or written; what is wrong with the world; a run
/// that cannot be joined or that ends early.
pub fn run(
    simulator: &(impl Simulator + ?Sized),
    arguments: &[String],
) -> Result<(), WorldFailure> {
    let (verb, rest) = arguments.split_first().ok_or(USAGE)?;
    match verb.as_str() {
        "book" => {
            if let Ok([out]) = paths(rest, ["--out"]) {
                // For any run: what is stale on blocked routes, too.
                let all = BookRequest { blocked: true, ..BookRequest::default() };
                return book(simulator, &all, &out);
            }
            let [request, out] = paths(rest, ["--request", "--out"])?;
            let text = durable::input::read_text(&request)
                .map_err(|error| format!("cannot read {}: {error}", request.display()))?;
            let request: BookRequest = serde_json::from_str(&text)
                .map_err(|error| format!("this is no request for a case book: {error}"))?;
            book(simulator, &request, &out)
        }
        "serve" => {
            let [demonstrations] = paths(rest, ["--demonstrations"])?;
            let attach = folder_from_environment(Role::Sim)?;
            Ok(serve(simulator, &attach, &demonstrations)?)
        }
        "act" if rest.is_empty() => act(simulator),
        "views" => match rest {
            [flag, size] if flag == "--size" => views(simulator, size),
            _ => Err(USAGE.into()),
        },
        "--help" | "-h" => {
            print!("{USAGE}");
            Ok(())
        }
        _ => Err(USAGE.into()),
    }
}

/// The values of these flags, which have to be there and are the only ones.
fn paths<const N: usize>(
    arguments: &[String],
    flags: [&str; N],
) -> Result<[PathBuf; N], WorldFailure> {
    let pairs: Vec<&[String]> = arguments.chunks(2).collect();
    let value = |flag: &str| {
        let named = pairs.iter().find(|pair| pair[0] == flag);
        named.and_then(|pair| pair.get(1)).map(PathBuf::from)
    };
    let values: Option<Vec<PathBuf>> = flags.into_iter().map(value).collect();
    let values = values.filter(|_| pairs.len() == N).ok_or(USAGE)?;
    values.try_into().map_err(|_| USAGE.into())
}

fn book(
    simulator: &(impl Simulator + ?Sized),
    request: &BookRequest,
    out: &Path,
) -> Result<(), WorldFailure> {
    let (cases, demonstrations) = write_books(simulator, request)?;
    std::fs::create_dir_all(out)?;
    let files = [
        (CASE_BOOK_FILE, BookFile::new(cases)?.text),
        (DEMONSTRATIONS_FILE, BookFile::new(demonstrations)?.text),
    ];
    for (name, text) in files {
        let path = out.join(name);
        durable::replace(&path, &path.with_extension("json.draft"), text.as_bytes())
            .map_err(|error| format!("cannot write {}: {error}", path.display()))?;
    }
    Ok(())
}

/// Serves `simulator` in the run whose folder is `folder`, in every generation.
fn serve(
    simulator: &(impl Simulator + ?Sized),
    folder: &Path,
    demonstrations: &Path,
) -> Result<(), ServeError> {
    let demonstrations = BookFile::<DemonstrationBook>::read(demonstrations)?.book;
    let (now, then) = (simulator.declaration(), &demonstrations.world);
    if now != *then {
        return Err(WorldFailure::from(format!(
            "the case book is of {} {} with another declaration than this program's {} {}: write it again with `book`",
            then.name, then.version, now.name, now.version
        ))
        .into());
    }
    serve_world(
        folder,
        false,
        |attach| SimulatedWorld::new(simulator, attach, demonstrations.clone()),
        |world, attach| world.rendering(attach),
    )
}

/// Serves the world that `make` makes, as the one of the run's worlds whose index the environment tells, with the renderers that `open` opens, in every generation of the run whose folder is
/// `folder`; for `warm_views` see [`serve_generation`](super::serve_generation). It ends with the orchestrator, which need not
/// have started it.
///
/// # Errors
/// When there is no such run, it cannot be joined or does not fit into shared memory, it ends without a stop message, or the world
/// fails.
pub fn serve_world<W: World>(
    folder: &Path,
    warm_views: bool,
    make: impl Fn(&Attach) -> Result<W, WorldFailure>,
    open: impl Fn(&mut W, &Attach) -> Result<RenderSetup<W::Picture>, WorldFailure>,
) -> Result<(), ServeError> {
    let index = match std::env::var(WORLD_INDEX_VARIABLE) {
        Ok(text) => text.parse().map_err(|error| {
            WorldFailure::from(format!("{WORLD_INDEX_VARIABLE}={text}: {error}"))
        })?,
        Err(_) => 0,
    };
    let join = |attach: Attach| Bus::join_as(attach, Role::Sim, index);
    serve_generations(folder, Until::RunEnds, join, |bus, run| {
        let attach = bus.attach();
        wait_for_room(attach)?;
        let mut world = make(attach)?;
        serve_watched(&bus, &mut world, warm_views, Some(run), |world| open(world, attach))
    })
}

/// Waits until the frames of this generation fit into shared memory: processes of the one before may use theirs for a moment
/// longer.
fn wait_for_room(attach: &Attach) -> Result<(), ServeError> {
    let patience = if attach.generation > 1 { ROOM_TIMEOUT } else { Duration::ZERO };
    let deadline = Instant::now() + patience;
    while let Err(error) = check_shared_memory(attach.shared_memory_bytes()) {
        if Instant::now() >= deadline {
            return Err(WorldFailure::from(error).into());
        }
        sleep(Duration::from_millis(50));
    }
    Ok(())
}

/// Draws what lines of stdin name: what is seen at the begin of a trajectory of a case and after actions; or, for the number of no
/// variant and a state, grey.
fn views(simulator: &(impl Simulator + ?Sized), size: &str) -> Result<(), WorldFailure> {
    let edges = size.split_once('x').map(|(width, height)| (width.parse(), height.parse()));
    let Some((Ok(width), Ok(height))) = edges else { return Err(USAGE.into()) };
    let (world, cases) = (simulator.declaration(), simulator.cases()?);
    let mut stage = Stage::new(simulator.environment()?);
    let mut pixels = vec![0; width as usize * height as usize * 4];
    let mut stdout = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        if line.starts_with(&format!("{GREY_VARIANT} ")) {
            pixels.as_chunks_mut().0.fill(GREY);
        } else {
            let (begin, actions) = named_view(&world, &cases, &line)
                .ok_or_else(|| format!("{line:?} is no view: write CASE.TRAJECTORY.LETTERS"))?;
            stage.render(&cases, begin, &actions, (width, height), &mut pixels)?;
        }
        // A pipe that closed means that no more views are wanted.
        if stdout.write_all(&pixels).and_then(|()| stdout.flush()).is_err() {
            break;
        }
    }
    Ok(())
}

/// The begin and the actions that a line names: `reach-7.new.aab`, or `reach-7.new-light.aab` with a mismatch.
fn named_view(
    world: &WorldDeclaration,
    cases: &[CaseDeclaration],
    line: &str,
) -> Option<(StageBegin, Vec<ActionCode>)> {
    let (case, rest) = line.split_once('.')?;
    let (name, letters) = rest.split_once('.')?;
    let (name, mismatch) = match name.split_once('-') {
        Some((name, mismatch)) => (name, mismatch.parse().ok()?),
        None => (name, Mismatch::None),
    };
    let name: TrajectoryName = name.parse().ok()?;
    let case = cases.iter().position(|known| known.id == case)? as u32;
    let begin = StageBegin { mismatch, ..StageBegin::of(case, name) };
    let actions: Option<Vec<_>> = letters.chars().map(|letter| world.action_of(letter)).collect();
    Some((begin, actions?))
}

fn act(simulator: &(impl Simulator + ?Sized)) -> Result<(), WorldFailure> {
    let mut acting = ActingSimulator::new(simulator)?;
    let mut stdout = std::io::stdout().lock();
    for line in std::io::stdin().lock().lines() {
        let answer = match serde_json::from_str::<ActRequest>(&line?) {
            Ok(request) => acting.answer(&request),
            Err(error) => ActAnswer::Error(format!("this is no request: {error}")),
        };
        let mut answer = serde_json::to_vec(&answer)?;
        answer.push(b'\n');
        // A pipe that closed means that no more answers are wanted.
        if stdout.write_all(&answer).and_then(|()| stdout.flush()).is_err() {
            break;
        }
    }
    Ok(())
}

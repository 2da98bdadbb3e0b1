//! The kill grid: each process of a run is killed before and after each kind of call with which it changes shared memory, a
//! socket or the folder of live runs, and each kind of call fails. Calls for other files are those of `drill-sim`. An external world
//! is disturbed in runs of its own, of which only its calls are taken.

use std::collections::BTreeMap;
use std::{fmt, fs};

use memtransfer_tests::Ended;

use crate::harness::{EXTERNAL_WORLD, RunWorld, Sandbox, Trial, execute};
use crate::report::Report;
use crate::{Extent, Random};

pub(crate) const TEXT: &str = "A library that is loaded into every process of a run lists the calls that change shared memory, a socket or the \
     folder of live runs. Then, for each program, each call and each kind of path, one process is killed before or after \
     the first, second, middle or last such call, or the call fails with ENOSPC or EMFILE. The run, or the same command \
     again, must end with the log of an undisturbed run, and leave nothing behind.";

/// Cells of a quick drill.
const QUICK: usize = 8;

/// Errors with which a call fails.
const ERRORS: [(&str, i32); 2] = [("EMFILE", 24), ("ENOSPC", 28)];

/// A call of a program: what the library needs to find it.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Call {
    program: String,
    /// The operation and the pattern of the path.
    call: String,
}

impl Call {
    fn is_of_external_world(&self) -> bool {
        self.program.starts_with(EXTERNAL_WORLD)
    }
}

/// A disturbance at one point of the protocol.
#[derive(Clone)]
struct Cell {
    call: Call,
    /// Where the call is among the calls of its kind.
    place: &'static str,
    number: u64,
    action: String,
    class: String,
}

impl Cell {
    /// The cell that [`Display`](fmt::Display) writes as `text`.
    fn parse(text: &str) -> Result<Self, String> {
        let parse = || {
            let (action, rest) = text.split_once(' ')?;
            let (call, rest) = rest.rsplit_once(" no. ")?;
            let (number, program) = rest.split_once(" of ")?;
            let call = Call { program: program.to_owned(), call: call.to_owned() };
            let action = action.to_owned();
            let (number, class) = (number.parse().ok()?, action.clone());
            Some(Self { call, place: "as named", number, class, action })
        };
        parse().ok_or_else(|| {
            format!("{text:?} is not a cell: they are like \"28 open /tmp/mt# no. 2 of sim-proc\"")
        })
    }
}

impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { call: Call { program, call }, number, action, .. } = self;
        write!(f, "{action} {call} no. {number} of {program}")
    }
}

pub(crate) fn drill(extent: &Extent, report: &mut Report) -> Result<(), String> {
    let worlds = [RunWorld::Warehouse, RunWorld::External];
    let mut sandboxes = Sandbox::several(extent.jobs, &worlds)?;
    let mut listed = calls(&mut sandboxes[0], RunWorld::Warehouse)?;
    let in_external = calls(&mut sandboxes[0], RunWorld::External)?;
    listed.extend(in_external.into_iter().filter(|(call, _)| call.is_of_external_world()));
    for program in
        ["memtransfer", "sim-proc", "memory-proc", "policy-proc", "misbehaving-mem", EXTERNAL_WORLD]
    {
        if !listed.keys().any(|call| call.program.starts_with(program)) {
            return Err(format!("no call of {program} is listed"));
        }
    }
    let mut cells = match &extent.cell {
        Some(text) => vec![Cell::parse(text)?],
        None => cells(&listed),
    };
    let is_chosen = |text: &str| text.contains(&extent.only);
    cells.retain(|cell| is_chosen(&cell.class) || is_chosen(role(&cell.call.program)));
    report.add("points of the protocol", listed.len() as f64);
    // In an order of their own for each seed, so that a drill that is ended early has tried a bit of everything. How often a
    // call is made varies a little, and must not change which cells come first.
    cells.sort_by_cached_key(|cell| {
        let Cell { call: Call { program, call }, place, action, .. } = cell;
        Random::of(extent.seed, &format!("{program} {call} {place} {action}")).next()
    });
    if extent.is_quick {
        cells.truncate(QUICK);
    }
    let trials = cells.into_iter().map(|cell| {
        let (name, class) = (cell.to_string(), cell.class.clone());
        Trial::new(name, class, move |sandbox| disturb(sandbox, &cell))
    });
    execute(extent, report, sandboxes, u64::MAX, trials);
    Ok(())
}

/// The calls of each program in an undisturbed run, and how often one process makes each.
fn calls(sandbox: &mut Sandbox, world: RunWorld) -> Result<BTreeMap<Call, u64>, String> {
    let list = sandbox.folder().join(format!("calls-{world:?}.txt"));
    let run = sandbox.run_in_world(world);
    let ended = Ended::of(sandbox.start(&run, &[("DRILL_LIST", list.display().to_string())])?);
    if ended.status != Some(0) {
        return Err(format!("a run whose calls are listed fails: {}", ended.stderr));
    }
    sandbox.check_log(&run)?;
    let text =
        fs::read_to_string(&list).map_err(|error| format!("no calls are listed: {error}"))?;
    let mut calls = BTreeMap::new();
    for line in text.lines() {
        if let Some((program, call)) = line.split_once(' ') {
            let (program, call) = (program.to_owned(), call.to_owned());
            *calls.entry(Call { program, call }).or_default() += 1;
        }
    }
    Ok(calls)
}

fn cells(calls: &BTreeMap<Call, u64>) -> Vec<Cell> {
    let mut cells = Vec::new();
    for (call, &count) in calls {
        let mut places = vec![("first", 1), ("last", count), ("second", 2), ("middle", count / 2)];
        places.retain(|(_, number)| (1..=count).contains(number));
        places.sort_by_key(|(_, number)| *number);
        places.dedup_by_key(|(_, number)| *number);
        for &(place, number) in &places {
            for action in ["kill-before", "kill-after"] {
                let class = format!("{} killed", role(&call.program));
                let action = action.to_owned();
                cells.push(Cell { call: call.clone(), place, number, action, class });
            }
        }
        for (name, error) in ERRORS {
            for &(place, number) in places.iter().filter(|(_, number)| [1, count].contains(number))
            {
                let (class, action) = (format!("a call fails with {name}"), error.to_string());
                cells.push(Cell { call: call.clone(), place, number, action, class });
            }
        }
    }
    cells
}

/// What a program is in a run.
fn role(program: &str) -> &str {
    match program {
        "memtransfer" => "orchestrator",
        "sim-proc" => "simulator",
        "memory-proc" => "memory",
        "policy-proc" => "policy",
        _ if program.starts_with(EXTERNAL_WORLD) => "external world",
        _ => "external memory",
    }
}

/// Executes a cell. Returns whether its point was reached.
fn disturb(sandbox: &mut Sandbox, cell: &Cell) -> Result<bool, String> {
    let is_of_world = cell.call.is_of_external_world();
    let run =
        sandbox.run_in_world(if is_of_world { RunWorld::External } else { RunWorld::Warehouse });
    let token = sandbox.folder().join("acted");
    let _ = fs::remove_file(&token);
    let faults = [
        ("DRILL_PROGRAM", cell.call.program.clone()),
        ("DRILL_CALL", cell.call.call.clone()),
        ("DRILL_NUMBER", cell.number.to_string()),
        ("DRILL_ACTION", cell.action.clone()),
        ("DRILL_TOKEN", token.display().to_string()),
    ];
    let ended = Ended::of(sandbox.start(&run, &faults)?);
    let was_reached = token.exists();
    let was_killed = was_reached && cell.action.starts_with("kill");
    sandbox.check_recovery(&run, &ended, was_killed)?;
    Ok(was_reached)
}

//! Reads and writes a set of cases as a text file, `cases.toml`.
//!
//! A case lists its task by type number and names, and six trajectories as a start pose and a letter for each action.
//! Reading checks that names, cells and actions are valid in a warehouse; the [validator](crate::validate()) checks the
//! constraints on cases.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::LazyLock;

use domain::{Action, Cell, DemonstrationKind, MAX_STEPS, Mixture, Pose};
use serde::Deserialize;

use crate::asset::{AssetError, Problem, invalid, read, toml};
use crate::case::{Case, CaseSet, History, TrajectoryKind};
use crate::catalogue::Catalogue;
use crate::task::{Task, TaskSubject};
use crate::task_type::TaskType;
use crate::trajectory::Trajectory;
use crate::world::{CATALOGUE_FILE, LAYOUT_FILE, SHIPPED_CATALOGUE, SHIPPED_LAYOUT, Warehouse};

/// The name of the file in an assets folder.
pub const CASES_FILE: &str = "cases.toml";

const SHIPPED_CASES: &str = include_str!("../../../assets/cases.toml");

/// The texts of layout, catalogue and cases in the folder `assets`, or of those that are compiled in, by name.
///
/// # Errors
/// A file that cannot be read.
pub fn file_texts(
    assets: Option<&Path>,
) -> Result<[(&'static str, Cow<'static, str>); 3], AssetError> {
    let text = |file: &str, shipped: &'static str| match assets {
        None => Ok(Cow::Borrowed(shipped)),
        Some(folder) => read(&folder.join(file)).map(Cow::Owned),
    };
    Ok([
        ("layout", text(LAYOUT_FILE, SHIPPED_LAYOUT)?),
        ("catalogue", text(CATALOGUE_FILE, SHIPPED_CATALOGUE)?),
        ("cases", text(CASES_FILE, SHIPPED_CASES)?),
    ])
}

/// Maximum number of cases of a set.
const MAX_CASES: usize = 100_000;

/// Maximum number of bytes of a case's id, which becomes part of file names and log keys.
const MAX_ID: usize = 32;

const HEADER: &str = "\
# The cases: a task each, four demonstrations, and the two references that tests are scored against.
# Generated from the seed; do not edit, the program checks that this file is what the seed gives.
#
# A trajectory is a start pose (column,row,heading) and its actions, one letter each:
#   moves  f forward  b backward  l left  r right      turns  L left  R right  U around
# `barricade` lists the cells closed in the blocked variant.
# `irrelevant` and `confusable` list two demonstrations of other tasks each: the case and its start.
";

/// The version of the rules by which cases are drawn: the same version and seed give the same cases. Since version 2 an item is
/// in view when its volume, plate or label is ([`crate::sight`]).
const VERSION: u32 = 2;

const fn first_version() -> u32 {
    1
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CasesFile {
    /// Absent in files of version 1.
    #[serde(default = "first_version")]
    version: u32,
    seed: u64,
    case: Vec<CaseEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CaseEntry {
    id: String,
    #[serde(rename = "type")]
    number: u8,
    a: Option<String>,
    b: Option<String>,
    c: Option<String>,
    original: String,
    opposite: String,
    nearby: String,
    distant: String,
    test: String,
    blocked: String,
    barricade: Vec<Cell>,
    irrelevant: [String; 2],
    confusable: [String; 2],
}

impl CaseSet {
    /// The cases that are compiled in, for [`Warehouse::shipped`].
    pub fn shipped() -> Self {
        static SHIPPED: LazyLock<CaseSet> =
            LazyLock::new(|| match CaseSet::parse(SHIPPED_CASES, &Warehouse::shipped()) {
                Ok(cases) => cases,
                Err(problem) => unreachable!("the shipped cases are tested: {problem}"),
            });
        SHIPPED.clone()
    }

    /// The warehouse and the cases in the folder `assets`, or those that are compiled in.
    ///
    /// # Errors
    /// As [`Warehouse::load`] and [`Self::load`].
    pub fn with_warehouse(assets: Option<&Path>) -> Result<(Warehouse, Self), AssetError> {
        let Some(folder) = assets else { return Ok((Warehouse::shipped(), Self::shipped())) };
        let warehouse = Warehouse::load(folder)?;
        let cases = Self::load(&folder.join(CASES_FILE), &warehouse)?;
        Ok((warehouse, cases))
    }

    /// Reads the file at `path`, whose cases belong to `warehouse`.
    ///
    /// # Errors
    /// A file that cannot be read, or a case that is invalid in `warehouse`; the message names the case and the field.
    pub fn load(path: &Path, warehouse: &Warehouse) -> Result<Self, AssetError> {
        Self::parse(&read(path)?, warehouse).map_err(invalid(path.display()))
    }

    fn parse(text: &str, warehouse: &Warehouse) -> Result<Self, Problem> {
        let file: CasesFile = toml(text)?;
        if !(1..=VERSION).contains(&file.version) {
            return Err(format!("version {}; this program reads 1 to {VERSION}", file.version));
        }
        if file.case.is_empty() || file.case.len() > MAX_CASES {
            return Err(format!("{} cases; must be 1 to {MAX_CASES}", file.case.len()));
        }
        let mut indices = BTreeMap::new();
        for (index, CaseEntry { id, .. }) in file.case.iter().enumerate() {
            let plain = id.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'-' || b == b'_');
            if id.is_empty() || id.len() > MAX_ID || !plain {
                return Err(format!(
                    "case {id:?}: an id has 1 to {MAX_ID} letters, digits, hyphens and underscores"
                ));
            }
            if indices.insert(id.clone(), index).is_some() {
                return Err(format!("case {id:?} is listed twice"));
            }
        }
        let read = |entry: CaseEntry| {
            let id = entry.id.clone();
            entry.read(warehouse, &indices).map_err(|problem| format!("case {id:?}: {problem}"))
        };
        let cases = file.case.into_iter().map(read).collect::<Result<_, Problem>>()?;
        Ok(Self { seed: file.seed, cases, elsewhere: None })
    }

    /// The text of the file, from which [`load`](Self::load) reads the same set.
    pub fn to_toml(&self, catalogue: &Catalogue) -> String {
        let mut text = format!("{HEADER}\nversion = {VERSION}\nseed = {}\n", self.seed);
        for case in &self.cases {
            write_case(&mut text, case, self, catalogue);
        }
        text
    }
}

fn write_case(text: &mut String, case: &Case, set: &CaseSet, catalogue: &Catalogue) {
    let type_name = |index: usize| &catalogue.types[index].name;
    let mut names = match case.task.subject() {
        TaskSubject::Category(c) => vec![format!("c = {:?}", catalogue.categories[c].name)],
        TaskSubject::Type(a) => vec![format!("a = {:?}", type_name(a))],
        TaskSubject::Types(a, b) => {
            vec![format!("a = {:?}", type_name(a)), format!("b = {:?}", type_name(b))]
        }
    };
    let mut lines = vec![
        format!("\n# {}\n[[case]]", case.task.instruction(catalogue)),
        format!("id = {:?}", case.id),
        format!("type = {}", case.task.task_type().number()),
    ];
    lines.append(&mut names);
    for start in TrajectoryKind::ALL {
        lines.push(format!("{} = \"{}\"", start.name(), trajectory_text(case.trajectory(start))));
    }
    let cells: Vec<String> =
        case.barricade.iter().map(|cell| format!("[{}, {}]", cell.x, cell.y)).collect();
    lines.push(format!("barricade = [{}]", cells.join(", ")));
    for mixture in Mixture::ALL {
        let [one, two] = case.mixed(mixture).map(|history| history_text(set, history));
        lines.push(format!("{} = [{one:?}, {two:?}]", mixture.name()));
    }
    for line in lines {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{line}");
    }
}

/// A history in the file: the case's id and the demonstration's name.
fn history_text(set: &CaseSet, History { case, kind }: History) -> String {
    let id = set.cases.get(case).map_or("?", |case| &case.id);
    format!("{id} {}", kind.name())
}

impl CaseEntry {
    fn read(
        self,
        warehouse: &Warehouse,
        indices: &BTreeMap<String, usize>,
    ) -> Result<Case, Problem> {
        let task = self.task(&warehouse.catalogue)?;
        let trajectory = |start: TrajectoryKind, text: &str| {
            parse_trajectory(text, warehouse)
                .map_err(|problem| format!("{}: {problem}", start.name()))
        };
        check_barricade(&self.barricade, warehouse)
            .map_err(|problem| format!("barricade: {problem}"))?;
        let histories = |mixture: Mixture, texts: &[String; 2]| -> Result<[History; 2], Problem> {
            let read = |text: &String| {
                parse_history(text, indices)
                    .map_err(|problem| format!("{}: {problem}", mixture.name()))
            };
            Ok([read(&texts[0])?, read(&texts[1])?])
        };
        Ok(Case {
            irrelevant: histories(Mixture::Irrelevant, &self.irrelevant)?,
            confusable: histories(Mixture::Confusable, &self.confusable)?,
            task,
            original: trajectory(TrajectoryKind::Original, &self.original)?,
            opposite: trajectory(TrajectoryKind::Opposite, &self.opposite)?,
            nearby: trajectory(TrajectoryKind::Nearby, &self.nearby)?,
            distant: trajectory(TrajectoryKind::Distant, &self.distant)?,
            test: trajectory(TrajectoryKind::Test, &self.test)?,
            blocked: trajectory(TrajectoryKind::Blocked, &self.blocked)?,
            barricade: self.barricade,
            id: self.id,
        })
    }

    fn task(&self, catalogue: &Catalogue) -> Result<Task, Problem> {
        let item_type = |field: &str, name: &Option<String>| {
            let name = name.as_deref().ok_or_else(|| missing(field, self.number))?;
            let names = catalogue.types.iter().map(|item_type| item_type.name.as_str());
            catalogue.type_named(name).ok_or_else(|| unknown(field, name, "type", names))
        };
        let a = || item_type("a", &self.a);
        let b = || item_type("b", &self.b);
        let c = || {
            let name = self.c.as_deref().ok_or_else(|| missing("c", self.number))?;
            let names = catalogue.categories.iter().map(|category| category.name.as_str());
            catalogue.category_named(name).ok_or_else(|| unknown("c", name, "category", names))
        };
        let task_type =
            TaskType::try_from(self.number).map_err(|error| format!("type: {error}"))?;
        let task = match task_type {
            TaskType::FindType => Task::FindType { a: a()? },
            TaskType::FindCategory => Task::FindCategory { c: c()? },
            TaskType::EveryOfType => Task::EveryOfType { a: a()? },
            TaskType::EveryOfCategory => Task::EveryOfCategory { c: c()? },
            TaskType::BothTypes => Task::BothTypes { a: a()?, b: b()? },
            TaskType::InOrder => Task::InOrder { a: a()?, b: b()? },
            TaskType::FindAndReturn => Task::FindAndReturn { a: a()? },
            TaskType::EveryAndReturn => Task::EveryAndReturn { a: a()? },
            TaskType::Revisit => Task::Revisit { a: a()?, b: b()? },
            TaskType::InOrderAndReturn => Task::InOrderAndReturn { a: a()?, b: b()? },
        };
        let (wants_a, wants_b) = match task.subject() {
            TaskSubject::Category(_) => (false, false),
            TaskSubject::Type(_) => (true, false),
            TaskSubject::Types(..) => (true, true),
        };
        for (field, given, wanted) in [
            ("a", self.a.is_some(), wants_a),
            ("b", self.b.is_some(), wants_b),
            ("c", self.c.is_some(), !wants_a),
        ] {
            if given && !wanted {
                return Err(format!("{field}: a task of type {} has none; remove it", self.number));
            }
        }
        if wants_b && self.a == self.b {
            return Err(format!(
                "b: must differ from a, and both are {:?}",
                self.b.as_deref().unwrap_or("")
            ));
        }
        Ok(task)
    }
}

fn missing(field: &str, number: u8) -> Problem {
    format!("{field}: missing; a task of type {number} needs it")
}

fn unknown<'n>(
    field: &str,
    name: &str,
    what: &str,
    known: impl Iterator<Item = &'n str>,
) -> Problem {
    let near = known.min_by_key(|known| strsim::levenshtein(known, name)).unwrap_or_default();
    format!("{field}: the catalogue has no {what} {name:?}; the nearest is {near:?}")
}

/// A trajectory in a file: its start pose and a letter for each action.
pub(crate) fn trajectory_text(Trajectory { start, actions }: &Trajectory) -> String {
    let letters: String = actions.iter().map(|action| action.letter()).collect();
    format!("{start} {letters}")
}

/// Reads [`trajectory_text`].
pub(crate) fn parse_trajectory(text: &str, warehouse: &Warehouse) -> Result<Trajectory, Problem> {
    let (pose, letters) = text.split_once(' ').unwrap_or((text, ""));
    let start: Pose = pose.parse().map_err(|error: domain::pose::UnknownCode| error.to_string())?;
    if !warehouse.layout.is_free(start.cell) {
        return Err(format!("starts on {}, which is not a free cell", start.cell));
    }
    let action = |(at, letter)| {
        Action::from_letter(letter).ok_or_else(|| {
            format!("action {} is {letter:?}, which is none of f b l r L R U", at + 1)
        })
    };
    let actions = letters.chars().enumerate().map(action).collect::<Result<Vec<_>, _>>()?;
    // A final turn towards the rack may follow the last step that counts.
    if actions.is_empty() || actions.len() > MAX_STEPS as usize + 1 {
        return Err(format!("{} actions; must be 1 to {}", actions.len(), MAX_STEPS + 1));
    }
    Ok(Trajectory { start, actions })
}

/// A demonstration, not a reference, of a case in the file.
fn parse_history(text: &str, indices: &BTreeMap<String, usize>) -> Result<History, Problem> {
    let (id, name) = text.split_once(' ').unwrap_or((text, ""));
    let case = indices.get(id).copied();
    let case = case.ok_or_else(|| format!("{text:?}: there is no case {id:?} in this file"))?;
    let kind = DemonstrationKind::OWN.into_iter().find(|kind| kind.name() == name);
    let kind = kind.ok_or_else(|| {
        let known = DemonstrationKind::OWN.map(DemonstrationKind::name).join(", ");
        format!("{text:?}: {name:?} is not a demonstration; a case has {known}")
    })?;
    Ok(History { case, kind })
}

fn check_barricade(cells: &[Cell], warehouse: &Warehouse) -> Result<(), Problem> {
    if cells.is_empty() {
        return Err("closes no cell; list the cells of a passage".into());
    }
    if let Some(pair) = cells.windows(2).find(|pair| pair[0] >= pair[1]) {
        return Err(format!(
            "{} comes before {}; list the cells sorted, each once",
            pair[0], pair[1]
        ));
    }
    match cells.iter().find(|&&cell| !warehouse.layout.is_free(cell)) {
        Some(cell) => Err(format!("{cell} is not a free cell")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CASE: &str = r#"
seed = 18446744073709551615

[[case]]
id = "t06-01"
type = 6
a = "blue barrel"
b = "red barrel"
original = "2,1,N fRf"
opposite = "2,1,S f"
nearby = "2,1,N f"
distant = "2,1,N f"
test = "2,1,N f"
blocked = "2,1,N f"
barricade = [[2, 3], [3, 3]]
irrelevant = ["t06-01 nearby", "t06-01 distant"]
confusable = ["t06-01 original", "t06-01 opposite"]
"#;

    #[test]
    fn a_written_case_reads_back_the_same() {
        let warehouse = Warehouse::shipped();
        let cases = CaseSet::parse(CASE, &warehouse).unwrap();
        assert_eq!(cases.seed, u64::MAX);
        let case = cases.case("t06-01").unwrap();
        assert_eq!(
            case.task.instruction(&warehouse.catalogue),
            "Visit a blue barrel, then a red barrel."
        );
        assert_eq!(case.original.start, Pose::new(2, 1, domain::Heading::N));
        assert_eq!(case.original.actions, [Action::Forward, Action::TurnRight, Action::Forward]);
        let text = cases.to_toml(&warehouse.catalogue);
        assert_eq!(CaseSet::parse(&text, &warehouse).unwrap(), cases);
        assert!(
            text.starts_with(HEADER) && text.ends_with(&CASE[CASE.find("[[case]]").unwrap()..])
        );
    }

    #[test]
    fn a_broken_case_is_named_with_its_field() {
        let warehouse = Warehouse::shipped();
        for (from, to, expected) in [
            ("t06-01", "", "case \"\": an id has 1 to 32 letters"),
            ("t06-01", "../x", "case \"../x\": an id has 1 to 32 letters"),
            ("type = 6", "type = 11", "case \"t06-01\": type: 11 is not a task type"),
            ("type = 6", "type = 1", "b: a task of type 1 has none"),
            ("type = 6", "type = 2", "c: missing; a task of type 2 needs it"),
            ("type = 6", "type = 300", "300"),
            (
                "\"blue barrel\"",
                "\"blue barel\"",
                "no type \"blue barel\"; the nearest is \"blue barrel\"",
            ),
            ("\"red barrel\"", "\"blue barrel\"", "b: must differ from a"),
            ("b = \"red barrel\"\n", "", "b: missing; a task of type 6 needs it"),
            ("\"2,1,N fRf\"", "\"2,1 fRf\"", "original: 2,1 is not a pose"),
            ("\"2,1,N fRf\"", "\"2,1,N fRx\"", "original: action 3 is 'x', which is none of"),
            ("\"2,1,N fRf\"", "\"2,1,N\"", "original: 0 actions; must be 1 to 201"),
            (
                "\"2,1,N fRf\"",
                "\"0,0,N f\"",
                "original: starts on (0, 0), which is not a free cell",
            ),
            ("[[2, 3], [3, 3]]", "[]", "barricade: closes no cell"),
            ("[[2, 3], [3, 3]]", "[[3, 3], [2, 3]]", "barricade: (3, 3) comes before (2, 3)"),
            ("[[2, 3], [3, 3]]", "[[2, 3], [2, 3]]", "barricade: (2, 3) comes before (2, 3)"),
            ("[[2, 3], [3, 3]]", "[[1, 3]]", "barricade: (1, 3) is not a free cell"),
            ("[[2, 3], [3, 3]]", "[[2, 3000]]", "3000"),
            (
                "t06-01 nearby",
                "t06-02 nearby",
                "irrelevant: \"t06-02 nearby\": there is no case \"t06-02\"",
            ),
            (
                "t06-01 original",
                "t06-01 test",
                "confusable: \"t06-01 test\": \"test\" is not a demonstration; a case has original,",
            ),
            (", \"t06-01 distant\"]", "]", "irrelevant"),
            ("test = ", "tset = ", "tset"),
            ("blocked = \"2,1,N f\"\n", "", "blocked"),
            ("seed = 18446744073709551615", "", "seed"),
            ("seed = 18446744073709551615", "version = 3\nseed = 1", "version 3"),
            ("seed = 18446744073709551615", "version = 0\nseed = 1", "version 0"),
            ("seed = 18446744073709551615", "seed = -1", "-1"),
            ("[[case]]", "[[case", "case"),
        ] {
            assert!(CASE.contains(from), "{from}");
            let problem = CaseSet::parse(&CASE.replacen(from, to, 1), &warehouse).unwrap_err();
            assert!(problem.contains(expected), "{from} -> {to}: {problem}");
        }
        let long = CASE.replace("fRf", &"f".repeat(202));
        assert!(CaseSet::parse(&long, &warehouse).unwrap_err().contains("202 actions"));
        let twice = format!("{CASE}{}", &CASE[CASE.find("[[case]]").unwrap()..]);
        assert!(CaseSet::parse(&twice, &warehouse).unwrap_err().contains("listed twice"));
        assert!(CaseSet::parse("seed = 1\ncase = []", &warehouse).unwrap_err().contains("0 cases"));
    }

    #[test]
    fn a_missing_file_is_named() {
        let error = CaseSet::load(Path::new("no/cases.toml"), &Warehouse::shipped()).unwrap_err();
        assert!(error.to_string().contains("cannot read no/cases.toml"), "{error}");
    }

    proptest::proptest! {
        #[test]
        fn a_mangled_case_is_refused_or_scored_but_never_panics(
            at in 0..CASE.len(), to in "[ -~]{0,2}",
        ) {
            let warehouse = Warehouse::shipped();
            let text = format!("{}{to}{}", &CASE[..at], &CASE[at + 1..]);
            if let Ok(cases) = CaseSet::parse(&text, &warehouse) {
                let report = crate::validate::check(&warehouse, &cases);
                proptest::prop_assert!(!report.is_clean());
            }
        }
    }
}

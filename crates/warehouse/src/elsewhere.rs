//! Another warehouse, in which the tasks of a set of cases are demonstrated, so that what memory knows in general can be told
//! from what it knows about one place.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::asset::{self, AssetError, Problem};
use crate::case::{CaseSet, Trajectory};
use crate::case_file::{parse_trajectory, trajectory_text};
use crate::draw::Draw;
use crate::dynamics::Variant;
use crate::generate::Generator;
use crate::generate_world::GeneratedWorld;
use crate::task::Task;
use crate::world::{CATALOGUE_FILE, LAYOUT_FILE, Warehouse};

pub use case_book::ELSEWHERE_VARIANT;

/// Warehouses that are drawn until one fits.
const TRIES: u64 = 20;

/// The draws of starts, and of the seeds of warehouses.
const STARTS: u64 = 3 << 56;
const WORLDS: u64 = 4 << 56;

/// Another warehouse with one demonstration of each case's task.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Elsewhere {
    layout: String,
    catalogue: String,
    warehouse: Warehouse,
    /// By case: its task with the indices of the other catalogue, and the demonstration.
    shown: Vec<(Task, Trajectory)>,
}

/// Why there is no other warehouse.
#[derive(Debug, thiserror::Error)]
pub enum ElsewhereError {
    /// A file that cannot be used.
    #[error(transparent)]
    Asset(#[from] AssetError),
    /// It does not fit the cases.
    #[error("{0}")]
    Unfit(Problem),
}

/// The content of the file, one line of JSON.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ElsewhereFile {
    layout: String,
    catalogue: String,
    demonstrations: Vec<String>,
}

impl Elsewhere {
    /// Draws a warehouse from `seed`, of the same size and with the same categories as `tested`, and demonstrations of the
    /// tasks of `cases` there. Where a task cannot be demonstrated, or the floor plan is that of `tested`, another warehouse
    /// is drawn.
    ///
    /// # Errors
    /// When the categories of `tested` cannot be drawn, or none of 20 warehouses fits.
    pub fn generate(
        tested: &Warehouse,
        cases: &CaseSet,
        seed: u64,
    ) -> Result<Self, ElsewhereError> {
        let mut problem = Problem::new();
        let found = (0..TRIES).find_map(|attempt| {
            let world = Draw::new(seed, WORLDS | attempt).below(u32::MAX as usize) as u64;
            let drawn = GeneratedWorld::like(tested, world).map_err(|error| error.to_string());
            let shown = drawn.and_then(|GeneratedWorld { layout, catalogue, warehouse }| {
                if warehouse.layout.free_cells().eq(tested.layout.free_cells()) {
                    return Err("its floor plan is that of the tested warehouse".to_owned());
                }
                Self::demonstrate((layout, catalogue, warehouse), tested, cases, seed)
            });
            shown.map_err(|why| problem = why).ok()
        });
        found.ok_or_else(|| {
            ElsewhereError::Unfit(format!(
                "no other warehouse for demonstrations found for seed {seed} in {TRIES} draws; the last: {problem}; give \
                 one with --elsewhere DIR, or choose another --seed"
            ))
        })
    }

    /// The warehouse in the folder `assets`, and demonstrations of the tasks of `cases` there from starts drawn from `seed`.
    ///
    /// # Errors
    /// Files that cannot be used, a warehouse in which a task cannot be demonstrated, or the one that is tested.
    pub fn load(
        assets: &Path,
        tested: &Warehouse,
        cases: &CaseSet,
        seed: u64,
    ) -> Result<Self, ElsewhereError> {
        let [layout, catalogue] =
            [LAYOUT_FILE, CATALOGUE_FILE].map(|file| asset::read(&assets.join(file)));
        let warehouse = Warehouse::load(assets)?;
        Self::demonstrate((layout?, catalogue?, warehouse), tested, cases, seed)
            .map_err(|problem| ElsewhereError::Unfit(format!("{}: {problem}", assets.display())))
    }

    fn demonstrate(
        (layout, catalogue, warehouse): (String, String, Warehouse),
        tested: &Warehouse,
        cases: &CaseSet,
        seed: u64,
    ) -> Result<Self, Problem> {
        if warehouse.layout == tested.layout && warehouse.items == tested.items {
            return Err("it is the warehouse that is tested".to_owned());
        }
        let tasks = translated(cases, tested, &warehouse)?;
        let generator = Generator::new(&warehouse, seed);
        let show = |(index, task): (usize, Task)| {
            let mut draw = Draw::new(seed, STARTS | index as u64);
            let trajectory = generator.demonstration(&task, &mut draw).ok_or_else(|| {
                format!("the task of case {} cannot be demonstrated there", cases.cases[index].id)
            })?;
            Ok((task, trajectory))
        };
        let shown = tasks.into_iter().enumerate().map(show).collect::<Result<_, Problem>>()?;
        drop(generator);
        Ok(Self { layout, catalogue, warehouse, shown })
    }

    /// Reads the file at `path` for `cases` in the warehouse `tested`.
    ///
    /// # Errors
    /// As [`parse`](Self::parse); also when there is no such file.
    pub fn read(path: &Path, tested: &Warehouse, cases: &CaseSet) -> Result<Self, ElsewhereError> {
        let in_file = |error| match error {
            ElsewhereError::Unfit(problem) => {
                ElsewhereError::Unfit(format!("{}: {problem}", path.display()))
            }
            other => other,
        };
        Self::parse(&asset::read(path)?, tested, cases).map_err(in_file)
    }

    /// Reads [`to_text`](Self::to_text) for `cases` in the warehouse `tested`.
    ///
    /// # Errors
    /// A text that is not of this form, or does not fit the cases.
    pub fn parse(text: &str, tested: &Warehouse, cases: &CaseSet) -> Result<Self, ElsewhereError> {
        let ElsewhereFile { layout, catalogue, demonstrations } =
            serde_json::from_str(text).map_err(|error| ElsewhereError::Unfit(error.to_string()))?;
        let warehouse =
            Warehouse::parse(LAYOUT_FILE.into(), &layout, CATALOGUE_FILE.into(), &catalogue)?;
        let tasks = translated(cases, tested, &warehouse).map_err(ElsewhereError::Unfit)?;
        let (given, needed) = (demonstrations.len(), tasks.len());
        if given != needed {
            let problem = format!("{given} demonstrations for {needed} cases");
            return Err(ElsewhereError::Unfit(problem));
        }
        let read = |(index, (task, text)): (usize, (Task, &String))| {
            let trajectory = parse_trajectory(text, &warehouse).and_then(|trajectory| {
                let replay = trajectory.replay(&warehouse, &task, &Variant::UNCHANGED);
                replay.length.ok_or("its task is not complete at the end")?;
                Ok(trajectory)
            });
            let trajectory = trajectory.map_err(|problem| {
                format!("demonstration of case {}: {problem}", cases.cases[index].id)
            });
            Ok((task, trajectory?))
        };
        let shown = tasks.into_iter().zip(&demonstrations).enumerate().map(read);
        let shown = shown.collect::<Result<_, Problem>>().map_err(ElsewhereError::Unfit)?;
        Ok(Self { layout, catalogue, warehouse, shown })
    }

    /// The text of its file: one line of JSON.
    pub fn to_text(&self) -> String {
        let file = ElsewhereFile {
            layout: self.layout.clone(),
            catalogue: self.catalogue.clone(),
            demonstrations: self.shown.iter().map(|(_, shown)| trajectory_text(shown)).collect(),
        };
        match serde_json::to_string(&file) {
            Ok(text) => text + "\n",
            Err(error) => unreachable!("texts can always be written: {error}"),
        }
    }

    /// The texts of its `layout.toml` and `catalogue.toml`.
    pub fn files(&self) -> [&str; 2] {
        [&self.layout, &self.catalogue]
    }

    /// The other warehouse.
    pub fn warehouse(&self) -> &Warehouse {
        &self.warehouse
    }

    /// The task of a case, with the indices of this warehouse's catalogue, and its demonstration here.
    pub fn demonstration(&self, case: usize) -> Option<(&Task, &Trajectory)> {
        self.shown.get(case).map(|(task, trajectory)| (task, trajectory))
    }
}

/// The tasks of `cases` with the indices of the catalogue of `other`.
fn translated(
    cases: &CaseSet,
    tested: &Warehouse,
    other: &Warehouse,
) -> Result<Vec<Task>, Problem> {
    let task = |case: &crate::case::Case| {
        case.task
            .translated(&tested.catalogue, &other.catalogue)
            .map_err(|name| format!("it has no {name}, which case {} asks for", case.id))
    };
    cases.cases.iter().map(task).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constraints::{completes_task, target_in_view};

    #[test]
    fn every_task_is_demonstrated_in_a_drawn_warehouse_of_the_same_size() {
        let (tested, cases) = (Warehouse::shipped(), CaseSet::shipped());
        for seed in [1, 2] {
            let other = Elsewhere::generate(&tested, &cases, seed).unwrap();
            let (there, here) = (&other.warehouse.layout, &tested.layout);
            assert_eq!((there.width(), there.height()), (here.width(), here.height()));
            assert_ne!(other.warehouse.items, tested.items);
            for (index, case) in cases.cases.iter().enumerate() {
                let (task, shown) = other.demonstration(index).unwrap();
                assert_eq!(
                    task.instruction(&other.warehouse.catalogue),
                    case.task.instruction(&tested.catalogue)
                );
                let replay = shown.replay(&other.warehouse, task, &Variant::UNCHANGED);
                assert!((10..=80).contains(&completes_task(&replay).unwrap()));
                let targets = task.targets(&other.warehouse);
                assert!(target_in_view(&other.warehouse, shown.start, &targets).is_none());
            }
            assert_eq!(Elsewhere::generate(&tested, &cases, seed).unwrap(), other);
            assert_eq!(Elsewhere::parse(&other.to_text(), &tested, &cases).unwrap(), other);
        }
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let (tested, cases) = (Warehouse::shipped(), CaseSet::shipped());
        let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../assets");
        let error = Elsewhere::load(&assets, &tested, &cases, 1).unwrap_err().to_string();
        assert!(error.ends_with("it is the warehouse that is tested"), "{error}");
        let text = Elsewhere::generate(&tested, &cases, 1).unwrap().to_text();
        for (from, to, expected) in [
            ("\"layout\"", "\"layuot\"", "unknown field `layuot`"),
            ("blue barrel", "blue drum", "it has no blue barrel, which case"),
            (
                "\"demonstrations\":[",
                "\"demonstrations\":[\"1,1,N f\",",
                "101 demonstrations for 100",
            ),
        ] {
            let error = Elsewhere::parse(&text.replace(from, to), &tested, &cases);
            let error = error.unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        let start = text.find("\"demonstrations\":[\"").unwrap() + 19;
        let end = start + text[start..].find('"').unwrap();
        let cut = format!(
            "{}f{}",
            &text[..start + text[start..end].find(' ').unwrap() + 1],
            &text[end..]
        );
        let error = Elsewhere::parse(&cut, &tested, &cases).unwrap_err().to_string();
        assert!(
            error.contains("demonstration of case t01-01: its task is not complete"),
            "{error}"
        );
    }
}

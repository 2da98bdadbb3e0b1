//! Tables of episodes and steps.

use std::collections::BTreeSet;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use case_book::act::EpisodeParts;
use report::{DataFrame, FrameFile, TableFormat, episodes_frame, steps_frame, world_facts};
use run_log::{EpisodeRecord, RunParts};
use scores::Successes;
use world_client::{EpisodeTimeline, RecordedRun};

use crate::files::write_whole;

/// Episodes whose rows are written at once.
const EPISODES: usize = 1 << 13;
/// Steps whose rows are written at once: a row group of a Parquet file.
const STEPS: usize = 1 << 17;

/// Writes the tables `episodes` and `steps` of the episodes in `parts` into the folder `dir`. A part of them is in memory at a time. The log of
/// their `run` is not read. Returns the files.
///
/// # Errors
/// When an episode does not fit the world, or the system refuses.
pub fn write_tables(
    run: &RecordedRun,
    parts: &RunParts,
    format: TableFormat,
    dir: &Path,
) -> Result<Vec<PathBuf>> {
    let RecordedRun { successes, world, .. } = run;
    let mut facts = BTreeSet::new();
    for record in parts.episodes() {
        facts.append(&mut world_facts([&record?]));
    }
    let file = |name: &str| dir.join(format!("{name}.{}", format.extension()));
    let (episodes, steps) = (file("episodes"), file("steps"));
    let head = parts.head();
    write_frames(&episodes, format, |write| {
        // Then those that were given up, which are beside the parts.
        for part in parts.parts(EPISODES, |_| 1).chain([Ok(head.clone())]) {
            write(&episodes_frame(&[(&part?, successes)], &facts))?;
        }
        Ok(())
    })?;
    write_frames(&steps, format, |write| {
        let moments = |record: &EpisodeRecord| record.steps as usize + 1;
        // Without an episode there are columns, too.
        write(&steps_frame(head, world.declaration(), &[]))?;
        for part in parts.parts(STEPS, moments) {
            let part = part?;
            // Nothing of a step says how the episode compares with successes.
            let none = Successes::default();
            let records = part.episodes.iter();
            let timelines = records
                .map(|record| EpisodeTimeline::new(world, record, &none, EpisodeParts::default()));
            let timelines: Vec<_> = timelines.collect::<Result<_>>()?;
            write(&steps_frame(&part, world.declaration(), &timelines))?;
        }
        Ok(())
    })?;
    Ok(vec![episodes, steps])
}

/// Writes the file `path` of the frames that `each` makes; all have the same columns.
fn write_frames(
    path: &Path,
    format: TableFormat,
    each: impl FnOnce(&mut dyn FnMut(&DataFrame<'_>) -> Result<()>) -> Result<()>,
) -> Result<()> {
    let written = || format!("cannot write {}", path.display());
    write_whole(path, |draft| {
        let out = durable::output::create(draft).with_context(written)?;
        let (mut out, mut file) = (Some(BufWriter::new(out)), None);
        each(&mut |frame| {
            if let Some(out) = out.take() {
                file = Some(FrameFile::create(format, frame, out).with_context(written)?);
            }
            file.as_mut().map_or(Ok(()), |file| file.write(frame)).with_context(written)
        })?;
        file.map_or(Ok(()), FrameFile::finish).with_context(written)
    })
}

#[cfg(test)]
mod tests {
    use rigs::records::{log, record};
    use scores::Successes;

    use super::*;

    #[test]
    fn every_column_is_described() {
        let page = include_str!("../../../docs/exports.md");
        let log = log(vec![record("t01-01", true)]);
        let facts = world_facts(&log.episodes);
        let world = warehouse::declaration();
        let frames = [
            ("episodes", episodes_frame(&[(&log, &Successes::default())], &facts)),
            ("steps", steps_frame(&log, &world, &[])),
        ];
        let described = described_columns(page);
        for (table, frame) in frames {
            let columns: Vec<(String, &str)> = frame
                .columns
                .iter()
                .map(|column| (column.name.clone(), column.values.type_name()))
                .collect();
            for (name, type_name) in &columns {
                let found: Vec<&str> = described
                    .iter()
                    .filter(|(of, column, _)| [table, "both"].contains(of) && column == name)
                    .map(|(_, _, type_name)| *type_name)
                    .collect();
                assert_eq!(found, [*type_name], "docs/exports.md, `{name}` of {table}");
            }
        }
    }

    /// The rows of the tables of columns in docs/exports.md: table, column and type.
    fn described_columns(page: &str) -> Vec<(&str, &str, &str)> {
        let mut table = "";
        let mut columns = Vec::new();
        for line in page.lines() {
            table = match line {
                "### Both" => "both",
                "### `episodes`" => "episodes",
                "### `steps`" => "steps",
                _ if line.starts_with('#') => "",
                _ => table,
            };
            let cells: Vec<&str> = line.split(" | ").collect();
            if let [names, type_name, ..] = cells[..]
                && !table.is_empty()
                && names.starts_with("| `")
            {
                let names = names.split('`').skip(1).step_by(2);
                columns.extend(names.map(|name| (table, name, type_name)));
            }
        }
        columns
    }
}

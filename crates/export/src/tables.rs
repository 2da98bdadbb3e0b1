//! Tables of episodes and steps.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use case_book::act::EpisodeParts;
use report::{episodes_frame, steps_frame};
use world_client::{EpisodeTimeline, RecordedRun};

use crate::files::write_whole;

/// A format of tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TableFormat {
    /// Text; an absent value is an empty field.
    Csv,
    /// Typed columns with nulls.
    Parquet,
}

/// Writes `episodes` and `steps` of `run` into the folder `dir`. Returns the files.
///
/// # Errors
/// When an episode does not fit the world, or the system refuses.
pub fn write_tables(run: &RecordedRun, format: TableFormat, dir: &Path) -> Result<Vec<PathBuf>> {
    let extension = match format {
        TableFormat::Csv => "csv",
        TableFormat::Parquet => "parquet",
    };
    let RecordedRun { log, successes, world, .. } = run;
    let timeline = |record| EpisodeTimeline::new(world, record, successes, EpisodeParts::default());
    let episodes: Vec<_> = log.episodes.iter().map(timeline).collect::<Result<_>>()?;
    let frames = [
        ("episodes", episodes_frame(&[(log, successes)])),
        ("steps", steps_frame(log, world.declaration(), &episodes)),
    ];
    let mut files = Vec::new();
    for (name, frame) in frames {
        let path = dir.join(format!("{name}.{extension}"));
        write_whole(&path, |draft| {
            let write = || {
                let mut file = BufWriter::new(durable::output::create(draft)?);
                match format {
                    TableFormat::Csv => frame.write_csv(&mut file)?,
                    TableFormat::Parquet => frame.write_parquet(&mut file)?,
                }
                file.flush()
            };
            write().with_context(|| format!("cannot write {}", path.display()))
        })?;
        files.push(path);
    }
    Ok(files)
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
        for frame in [
            episodes_frame(&[(&log, &Successes::default())]),
            steps_frame(&log, &warehouse::declaration(), &[]),
        ] {
            for column in &frame.columns {
                let name = format!("`{}`", column.name);
                assert!(page.contains(&name), "docs/exports.md does not describe {name}");
            }
        }
    }
}

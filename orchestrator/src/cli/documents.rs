//! The documents of a run: which it needs, and having them before it begins.

use std::collections::BTreeMap;

use anyhow::Result;

use crate::documents::{Builder, DocumentName, Library, State, Supply, needed};
use crate::progress::BuildProgress;
use crate::signals::Signals;
use results::log::RunFolder;
use results::settings::{DocumentSource, RunSettings};

/// The documents that a run needs, and where they come from.
#[derive(Debug)]
pub(super) struct Documents {
    needed: Vec<DocumentName>,
    library: Library,
    /// The run's own copies, once it has episodes.
    own: Library,
    has_episodes: bool,
}

impl Documents {
    /// Those of a run with `settings`.
    pub(super) fn of(settings: &RunSettings) -> Self {
        let (folder, builder) = match &settings.documents {
            DocumentSource::Extractive => (None, Builder::Extractive),
            DocumentSource::Model => (None, Builder::Anyone { of: "model" }),
            DocumentSource::Folder(path) => {
                (Some(path.clone()), Builder::Anyone { of: "extractive" })
            }
        };
        let library = |folder, builder| Library {
            folder,
            assets: settings.assets.clone(),
            frame_size: settings.frame_size,
            builder,
        };
        let remembers = settings.policy.has_process();
        let conditions = settings.conditions();
        let own = RunFolder::documents_of(&settings.out);
        Self {
            needed: if remembers { needed(&conditions) } else { Vec::new() },
            library: library(folder, builder),
            own: library(Some(own), Builder::Anyone { of: "extractive" }),
            has_episodes: RunFolder::has_episodes(&settings.out),
        }
    }

    /// What a run that goes on was supplied with so far, if that is all it needs.
    pub(super) fn kept(&self) -> Result<Option<Supply>> {
        if self.needed.is_empty() {
            return Ok(Some(Supply::nothing()));
        }
        if !self.has_episodes {
            return Ok(None);
        }
        let holdings = self.own.ask(Some(&self.needed), false)?;
        let all = holdings.documents.iter().all(|document| document.state == State::Current);
        Ok(all.then(|| Supply::kept(holdings)))
    }

    /// The documents, built where they are missing or out of date. `None` when a signal asked to stop.
    pub(super) fn supply(&self, signals: &Signals, quiet: bool) -> Result<Option<Supply>> {
        if self.needed.is_empty() {
            return Ok(Some(Supply::nothing()));
        }
        let mut progress = BuildProgress::new(quiet);
        let supply =
            self.library.ensure(&self.needed, false, signals.stop(), &mut |s| progress.show(s));
        progress.close();
        let supply = supply?;
        if let Some(Supply { built, folder, .. }) = &supply
            && !(built.is_empty() || quiet)
        {
            eprintln!("built {} in {}", listed(built), folder.display());
        }
        Ok(supply)
    }

    /// Bytes of the texts of those that are there; nothing where that cannot be told.
    pub(super) fn sizes(&self) -> BTreeMap<DocumentName, u64> {
        if self.needed.is_empty() {
            return BTreeMap::new();
        }
        // Why it cannot be told is said by `plan`.
        let documents = self.library.ask(Some(&self.needed), false).map(|found| found.documents);
        let documents = documents.unwrap_or_default().into_iter();
        documents.filter_map(|document| Some((document.name, document.bytes?))).collect()
    }

    /// A line for a dry run, or nothing where no documents are needed.
    pub(super) fn plan(&self) -> String {
        if self.needed.is_empty() {
            return String::new();
        }
        let holdings = match self.library.ask(Some(&self.needed), false) {
            Ok(holdings) => holdings,
            Err(error) => {
                return format!(
                    "\nDocuments: {}; which are there cannot be told: {error:#}",
                    listed(&self.needed)
                );
            }
        };
        let (current, others): (Vec<_>, Vec<_>) =
            holdings.documents.iter().partition(|document| document.state == State::Current);
        let names = |documents: Vec<&crate::documents::Holding>| {
            listed(&documents.iter().map(|document| document.name).collect::<Vec<_>>())
        };
        let mut plan = format!("\nDocuments of {}:", holdings.folder.display());
        if !current.is_empty() {
            plan.push_str(&format!(" {} there;", names(current)));
        }
        if !others.is_empty() {
            let verb = match self.library.builder {
                Builder::Extractive => "to be built",
                Builder::Model(_) | Builder::Anyone { .. } => "missing or out of date",
            };
            plan.push_str(&format!(" {} {verb};", names(others)));
        }
        plan.pop();
        plan.push('.');
        plan
    }
}

fn listed(names: &[DocumentName]) -> String {
    names.iter().map(DocumentName::to_string).collect::<Vec<_>>().join(", ")
}

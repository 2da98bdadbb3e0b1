//! How a run's memories are named for people: in tables, legends and pages.
//!
//! Summary, semantic and hybrid memory supply documents, and who wrote them matters as much as what a memory is. So wherever
//! figures of these memories are shown, their label names an author who is not the run's own model. Names of conditions, and
//! keys in logs and JSON, have no label.

use std::collections::BTreeSet;
use std::fmt;

use conditions::settings::DocumentSource;
use domain::{MemoryKind, Representation};

use crate::manifest::{DocumentFacts, Manifest};

/// Who wrote a document, as far as a manifest says.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum DocumentAuthor {
    /// A builder that asks no model, by its name: `extractive`.
    Script(String),
    /// A model; `None` where an earlier version did not record its name.
    Model(Option<String>),
}

impl DocumentAuthor {
    /// As part of a label: `extractive`, `by NAME`.
    fn words(&self) -> String {
        match self {
            Self::Script(builder) => builder.clone(),
            Self::Model(Some(name)) => format!("by {name}"),
            Self::Model(None) => "by a model".to_owned(),
        }
    }
}

impl fmt::Display for DocumentAuthor {
    /// As the value of a setting: `extractive`, `the model NAME`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Script(builder) => f.write_str(builder),
            Self::Model(Some(name)) => write!(f, "the model {name}"),
            Self::Model(None) => f.write_str("a model"),
        }
    }
}

/// The name of a memory: of a representation as in the paper, of an external memory its own.
pub fn memory_title(memory: MemoryKind) -> String {
    let representation = match memory {
        MemoryKind::External(name) => return name.to_string(),
        MemoryKind::BuiltIn(representation) => representation,
    };
    let title = match representation {
        Representation::Working => "Working memory",
        Representation::FullContext => "Full-context",
        Representation::Summary => "Summary",
        Representation::Semantic => "Semantic",
        Representation::Hybrid => "Hybrid",
        Representation::Episodic => "Episodic",
        Representation::Adaptive => "Adaptive",
    };
    title.to_owned()
}

/// Authors in words, for a message; empty for none.
pub fn author_words(authors: &BTreeSet<DocumentAuthor>) -> String {
    authors.iter().map(DocumentAuthor::words).collect::<Vec<_>>().join(", ")
}

impl Manifest {
    /// Who wrote the document.
    pub fn document_author(&self, document: &DocumentFacts) -> DocumentAuthor {
        if document.builder != "model" {
            return DocumentAuthor::Script(document.builder.clone());
        }
        let asked_for = match &self.settings.documents {
            DocumentSource::Model(Some(name)) => Some(name),
            _ => None,
        };
        DocumentAuthor::Model(document.model.as_ref().or(asked_for).cloned())
    }

    /// Who wrote the documents that a memory supplies; empty for a memory without.
    pub fn document_authors(&self, memory: MemoryKind) -> BTreeSet<DocumentAuthor> {
        let kinds = memory.describe().map_or(&[][..], |info| info.documents);
        let is_supplied = |name: &str| {
            let kind = name.split('/').next();
            kinds.iter().any(|known| kind == Some(known.word()))
        };
        let supplied = self.documents.iter().filter(|(name, _)| is_supplied(name));
        supplied.map(|(_, document)| self.document_author(document)).collect()
    }

    /// The name of a memory of the run. Those whose documents are not all by the run's own model say whose they are:
    /// `Summary (extractive)`, `Hybrid (by NAME)`.
    pub fn memory_label(&self, memory: MemoryKind) -> String {
        let (title, authors) = (memory_title(memory), self.document_authors(memory));
        let own = self.settings.model.as_ref().map(|model| model.model.clone());
        let own = own.map(|name| BTreeSet::from([DocumentAuthor::Model(Some(name))]));
        if authors.is_empty() || own.as_ref() == Some(&authors) {
            return title;
        }
        format!("{title} ({})", author_words(&authors))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::records::{manifest, model_document, model_settings, script_document};

    #[test]
    fn a_label_says_who_wrote_the_documents_unless_it_was_the_run_s_model() {
        let label = |own: Option<&str>, memory: Representation, documents: &[(&str, &str)]| {
            let mut manifest = manifest();
            manifest.settings.model = own.map(model_settings);
            let facts = documents.iter().map(|(name, author)| {
                let facts = match *author {
                    "extractive" => script_document(),
                    "" => DocumentFacts { model: None, ..model_document("") },
                    author => model_document(author),
                };
                ((*name).to_owned(), facts)
            });
            manifest.documents = facts.collect();
            manifest.memory_label(memory.into())
        };
        use Representation::{Episodic, Hybrid, Semantic, Summary};
        let script = [("summary/4", "extractive"), ("semantic/4", "extractive")];
        let own = [("summary/4", "m"), ("semantic/4", "m")];
        let mixed = [("summary/4", "m"), ("summary/original", "extractive"), ("semantic/4", "n")];
        let unnamed = [("summary/4", "")];
        for (model, memory, documents, expected) in [
            (None, Summary, &script[..], "Summary (extractive)"),
            (Some("m"), Semantic, &script, "Semantic (extractive)"),
            (Some("m"), Hybrid, &script, "Hybrid (extractive)"),
            (Some("m"), Episodic, &script, "Episodic"),
            (Some("m"), Hybrid, &own, "Hybrid"),
            (Some("n"), Hybrid, &own, "Hybrid (by m)"),
            (None, Summary, &own, "Summary (by m)"),
            (Some("m"), Hybrid, &mixed, "Hybrid (extractive, by m, by n)"),
            (Some("m"), Semantic, &mixed, "Semantic (by n)"),
            // Of an earlier version.
            (Some("m"), Summary, &unnamed, "Summary (by a model)"),
            (Some("m"), Summary, &[], "Summary"),
        ] {
            assert_eq!(label(model, memory, documents), expected);
        }
    }
}

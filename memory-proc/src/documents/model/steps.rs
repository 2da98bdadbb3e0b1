//! What a model was asked and answered while a document is made, kept as files beside the document, so that a
//! build that was stopped goes on where it was.
//!
//! A file holds one request with its reply, and is used again only for the same request to the same model. A
//! request that got no usable reply leaves no file.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::chat::{Reply, Request};
use super::prompt::Stage;
use crate::documents::transcript::hex;

/// A file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    /// SHA-256 of the model asked for and the request.
    request_sha256: String,
    request: Request,
    reply: Reply,
}

/// The steps of one document, in order.
#[derive(Debug)]
pub(super) struct Steps {
    folder: PathBuf,
    /// The model that is asked for.
    model: String,
    /// Names of the files that belong to this document.
    used: BTreeSet<OsString>,
}

impl Steps {
    /// The steps kept in `folder`, which is made if it is missing, of asking `model`.
    pub(super) fn open(folder: &Path, model: &str) -> anyhow::Result<Self> {
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))?;
        Ok(Self { folder: folder.to_owned(), model: model.to_owned(), used: BTreeSet::new() })
    }

    /// The reply to the next request: the one that is kept, else what `ask` gives, which is kept from then on.
    pub(super) fn next(
        &mut self,
        stage: Stage,
        request: &Request,
        ask: impl FnOnce() -> anyhow::Result<Reply>,
    ) -> anyhow::Result<Reply> {
        let name = format!("{:03}-{}.json", self.used.len() + 1, stage.name());
        let path = self.folder.join(&name);
        self.used.insert(name.into());
        let request_sha256 = self.sha256(request)?;
        if let Some(kept) = load(&path)?.filter(|kept| kept.request_sha256 == request_sha256) {
            return Ok(kept.reply);
        }
        let reply = ask()?;
        let kept = Kept { request_sha256, request: request.clone(), reply };
        save(&path, &kept).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(kept.reply)
    }

    /// Removes the files of the folder that are no steps of this document: those of an earlier one.
    pub(super) fn finish(self) -> anyhow::Result<()> {
        let stale = || -> io::Result<()> {
            for entry in fs::read_dir(&self.folder)? {
                let entry = entry?;
                if !self.used.contains(&entry.file_name()) && is_step(&entry.path()) {
                    fs::remove_file(entry.path())?;
                }
            }
            Ok(())
        };
        stale().with_context(|| format!("cannot clear {}", self.folder.display()))
    }

    fn sha256(&self, request: &Request) -> anyhow::Result<String> {
        let mut hasher = Sha256::new();
        hasher.update((self.model.len() as u64).to_le_bytes());
        hasher.update(&self.model);
        hasher.update(serde_json::to_vec(request)?);
        Ok(hex(&hasher.finalize()))
    }
}

/// Whether this is a file that steps are kept in, complete or not. Others are somebody else's.
fn is_step(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
    let numbered = name.split_once('-').is_some_and(|(number, _)| {
        number.len() >= 3 && number.bytes().all(|digit| digit.is_ascii_digit())
    });
    numbered && (name.ends_with(".json") || name.ends_with(".json.new"))
}

/// The step at `path`, if there is one. One that cannot be read costs a request and is said, no more.
fn load(path: &Path) -> anyhow::Result<Option<Kept>> {
    let bytes = match fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error).with_context(|| format!("cannot read {}", path.display())),
    };
    match serde_json::from_slice(&bytes) {
        Ok(kept) => Ok(Some(kept)),
        Err(error) => {
            tracing::warn!("{} is broken ({error}): asking again", path.display());
            Ok(None)
        }
    }
}

/// All of it or nothing, and durably: a reply may have cost money.
fn save(path: &Path, kept: &Kept) -> io::Result<()> {
    let draft = path.with_extension("json.new");
    let mut file = File::create(&draft)?;
    serde_json::to_writer_pretty(&mut file, kept)?;
    file.write_all(b"\n")?;
    file.sync_all()?;
    fs::rename(&draft, path)
}

#[cfg(test)]
mod tests {
    use anyhow::bail;

    use super::super::chat::Outcome;
    use super::*;

    fn request(limit: &str) -> Request {
        Stage::Extract.request(9, &[("limit", limit)])
    }

    fn reply(text: &str) -> Reply {
        let (outcome, model) = (Outcome::Text, Some("m".to_owned()));
        Reply { text: text.into(), outcome, model, prompt_tokens: None, completion_tokens: Some(1) }
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
        let mut names: Vec<_> = entries.map(|name| name.into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_reply_is_used_again_for_the_same_request_to_the_same_model_only() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("summary-4.steps");
        let next = |model, limit, answer: Option<&str>| {
            let mut steps = Steps::open(&folder, model).unwrap();
            let ask = || match answer {
                Some(text) => Ok(reply(text)),
                None => bail!("nobody there"),
            };
            steps.next(Stage::Extract, &request(limit), ask).map(|reply| reply.text)
        };
        assert!(next("m", "1", None).is_err());
        assert_eq!(names(&folder), [""; 0], "a failure leaves nothing");
        assert_eq!(next("m", "1", Some("a")).unwrap(), "a");
        assert_eq!(names(&folder), ["001-extract.json"]);
        assert_eq!(next("m", "1", None).unwrap(), "a");
        assert!(next("m", "2", None).is_err());
        assert!(next("n", "1", None).is_err());
        assert_eq!(next("n", "1", Some("b")).unwrap(), "b");
        fs::write(folder.join("001-extract.json"), "{").unwrap();
        assert_eq!(next("n", "1", Some("c")).unwrap(), "c");
    }

    #[test]
    fn finishing_clears_what_an_earlier_document_left_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["002-refine.json", "003-extract.json.new", "notes.txt", "a-b.json"] {
            fs::write(folder.path().join(name), "x").unwrap();
        }
        let mut steps = Steps::open(folder.path(), "m").unwrap();
        steps.next(Stage::Summary, &request("1"), || Ok(reply("a"))).unwrap();
        steps.finish().unwrap();
        assert_eq!(names(folder.path()), ["001-summary.json", "a-b.json", "notes.txt"]);
    }
}

//! A limit on the requests in flight to an endpoint that holds for all processes together.
//!
//! An endpoint has a folder with a file for each slot, and a request needs the lock of one of them while it is in flight.
//! The system releases the locks of a process that ends, however it ends. Machines that share the folder share the limit
//! where the file system shares locks.

use std::fs::{self, File, TryLockError};
use std::io;
use std::path::PathBuf;

/// How many requests may be in flight to each endpoint, and where the processes agree on it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EndpointLimit {
    /// Maximum number of requests in flight to one endpoint, from all processes that use the folder.
    pub most: u32,
    /// The folder, which need not exist. It has a folder for each endpoint.
    pub folder: PathBuf,
}

/// The slots of one endpoint.
#[derive(Debug)]
pub(crate) struct Slots {
    most: u32,
    folder: PathBuf,
}

/// The right to send a request, until it is dropped.
#[derive(Debug)]
pub(crate) struct Slot(#[expect(dead_code, reason = "the open file holds the lock")] File);

impl Slots {
    /// The slots of `endpoint`: the same address, written in the same way, has the same slots.
    pub(crate) fn of(limit: &EndpointLimit, endpoint: &str) -> Self {
        let plain = |c: char| if c.is_ascii_alphanumeric() || c == '.' { c } else { '-' };
        let name: String = endpoint.chars().map(plain).collect();
        Self { most: limit.most, folder: limit.folder.join(name) }
    }

    /// A free slot; `None` when requests of this or other processes have all of them.
    ///
    /// # Errors
    /// When a slot's file cannot be created or locked.
    pub(crate) fn take(&self) -> io::Result<Option<Slot>> {
        fs::create_dir_all(&self.folder)?;
        for number in 0..self.most {
            let path = self.folder.join(number.to_string());
            let file = durable::output::open_lock(&path)?;
            match file.try_lock() {
                Ok(()) => return Ok(Some(Slot(file))),
                Err(TryLockError::WouldBlock) => {}
                Err(TryLockError::Error(error)) => return Err(error),
            }
        }
        Ok(None)
    }

    /// What to do when [`take`](Self::take) fails.
    pub(crate) fn failed(&self, error: &io::Error) -> String {
        let folder = self.folder.display();
        format!(
            "cannot limit requests in {folder}: {error}; choose another --endpoint-limit-folder"
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_endpoint_has_as_many_slots_as_the_limit_says() {
        let folder = tempfile::tempdir().unwrap();
        let limit = EndpointLimit { most: 2, folder: folder.path().join("limits") };
        let one = Slots::of(&limit, "http://a:1/v1/chat/completions");
        let same = Slots::of(&limit, "http://a:1/v1/chat/completions");
        let other = Slots::of(&limit, "http://a:2/v1/chat/completions");
        let first = one.take().unwrap();
        let second = same.take().unwrap();
        assert!(first.is_some() && second.is_some());
        assert!(one.take().unwrap().is_none() && same.take().unwrap().is_none());
        assert!(other.take().unwrap().is_some());
        drop(first);
        assert!(same.take().unwrap().is_some());
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_an_error() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let limit = EndpointLimit { most: 1, folder: file.path().to_owned() };
        let slots = Slots::of(&limit, "e");
        let why = slots.failed(&slots.take().unwrap_err());
        assert!(why.contains("--endpoint-limit-folder"), "{why}");
    }
}

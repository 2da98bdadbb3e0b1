//! The files of views: whole, and as thumbnails.

use anyhow::Result;
use world_client::frames::{ViewFormat, ViewKey, file_name, half, jpeg, of_file_name};

use crate::file::File;

/// Views and the images of prompts.
pub(crate) const VIEW_FORMAT: ViewFormat = ViewFormat { edge: 320, quality: 56 };

/// The quality of thumbnails, in percent.
const SMALL_QUALITY: u8 = 50;

/// The end of the name of a thumbnail.
const SMALL: &str = "-small.jpg";

/// A file of a view.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ViewFile {
    /// What it shows.
    pub view: ViewKey,
    /// Whether it is a thumbnail, of half the width and height.
    pub is_small: bool,
}

impl ViewFile {
    /// Its name.
    pub(crate) fn name(&self) -> String {
        let name = file_name(&self.view);
        if self.is_small { name.replace(".jpg", SMALL) } else { name }
    }

    /// The file with this name.
    pub(crate) fn of_name(name: &str) -> Option<Self> {
        let small = name.strip_suffix(SMALL);
        let view = match small {
            Some(start) => of_file_name(&format!("{start}.jpg")),
            None => of_file_name(name),
        };
        Some(Self { view: view?, is_small: small.is_some() })
    }

    /// Its content, made of the pixels of the whole view.
    pub(crate) fn encode(&self, rgba: &[u8]) -> Result<File> {
        let ViewFormat { edge, quality } = VIEW_FORMAT;
        let bytes = if self.is_small {
            jpeg((edge / 2, edge / 2), SMALL_QUALITY, &half(edge, rgba))?
        } else {
            jpeg((edge, edge), quality, rgba)?
        };
        Ok(File { kind: "image/jpeg", bytes })
    }
}

#[cfg(test)]
mod tests {
    use domain::State;

    use super::*;

    #[test]
    fn files_are_found_by_their_names() {
        for is_small in [false, true] {
            let file = ViewFile {
                view: ViewKey::State(3, State::new(&[5.0, 8.0, 0.0]).unwrap()),
                is_small,
            };
            assert_eq!(ViewFile::of_name(&file.name()), Some(file));
        }
        for name in ["", "-small.jpg", "3-5_8_0-small-small.jpg", "3-5_8_0-small"] {
            assert_eq!(ViewFile::of_name(name), None, "{name}");
        }
    }
}

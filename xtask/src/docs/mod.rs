//! The documents: links of all Markdown files, the navigation of the site, and the site itself.
//!
//! The Markdown files stay where they are and are written for a code host. What the site needs otherwise, it gets in the
//! copies that are built.

mod commands;
mod foreign;
mod links;
mod markdown;
mod navigation;
mod reference;
mod rendering;
mod site;

pub(crate) use site::{build, check};

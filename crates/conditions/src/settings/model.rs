//! Settings of a model that is asked over the network: `--policy openai`.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use domain::names::{UnknownName, serde_as_text};
use domain::{ImageFormat, ReasoningRequest, SecretHeader, SystemRole};
use serde::{Deserialize, Serialize};

use crate::cost::Money;

/// How the model is asked. `memtransfer run --help` describes each field under the same name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "each field is documented once, as a flag of `memtransfer run`")]
pub struct ModelSettings {
    pub model: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base_url: Option<String>,
    pub image_format: ImageFormat,
    pub image_budget: u32,
    pub answer_tokens: u32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prompt: Option<PathBuf>,
    #[serde(default = "reasoning_off")]
    pub reasoning: ReasoningRequest,
    #[serde(default = "role_of_system")]
    pub system_role: SystemRole,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub extra_body: Option<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub header: Vec<SecretHeader>,
    pub max_connections: u32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub endpoint_limit: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub endpoint_limit_folder: Option<PathBuf>,
    pub max_retries: u32,
    pub request_timeout: u32,
    #[serde(default)]
    pub server_patience: u32,
    #[serde(default = "answers_before_a_stop")]
    pub stop_without_action: u32,
    pub response_cache: ResponseCache,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prices: Option<PathBuf>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_tokens_total: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_cost: Option<Money>,
}

/// What requests said about reasoning before it was a setting.
const fn reasoning_off() -> ReasoningRequest {
    ReasoningRequest::Off
}

/// The role of the rules before it was a setting.
const fn role_of_system() -> SystemRole {
    SystemRole::System
}

/// The default of `stop-without-action`, in manifests of earlier versions.
const fn answers_before_a_stop() -> u32 {
    100
}

/// Where answers are cached. Written `on`, `off`, or as a path, which has a slash.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum ResponseCache {
    /// In the cache folder.
    On,
    /// Nowhere.
    Off,
    /// In this folder.
    Folder(PathBuf),
}

/// A text that is not a place for responses.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}; a folder is named by its path, for example ./responses")]
pub struct UnknownCache(UnknownName);

impl FromStr for ResponseCache {
    type Err = UnknownCache;

    fn from_str(text: &str) -> Result<Self, UnknownCache> {
        match text {
            "on" => Ok(Self::On),
            "off" => Ok(Self::Off),
            path if path.contains('/') => Ok(Self::Folder(path.into())),
            word => Err(UnknownCache(UnknownName::new("response cache", word, ["on", "off"]))),
        }
    }
}

impl fmt::Display for ResponseCache {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::On => f.pad("on"),
            Self::Off => f.pad("off"),
            Self::Folder(path) => f.pad(&path.display().to_string()),
        }
    }
}

serde_as_text!(ResponseCache);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn caches_are_written_as_they_are_read() {
        for text in ["on", "off", "./mine"] {
            assert_eq!(text.parse::<ResponseCache>().unwrap().to_string(), text);
        }
        insta::assert_snapshot!("of".parse::<ResponseCache>().unwrap_err(), @"unknown response cache `of`: did you mean `off`? (known: on, off); a folder is named by its path, for example ./responses");
    }
}

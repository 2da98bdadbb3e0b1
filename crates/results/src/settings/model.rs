//! What concerns a model that is asked over the network: `--policy openai`.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::conditions::ImageFormat;
use crate::names::UnknownName;

/// The keys of [`ModelSettings`]: a run with another policy has none of them.
pub const MODEL_KEYS: &[&str] = &[
    "model",
    "base-url",
    "image-format",
    "image-budget",
    "answer-tokens",
    "max-connections",
    "max-retries",
    "request-timeout",
    "response-cache",
    "prices",
    "max-tokens-total",
    "max-cost",
];

/// How a model is asked. Every field is described where it is written: [`Layer`](super::Layer).
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[expect(missing_docs, reason = "each field is documented once, as a flag in `Layer`")]
pub struct ModelSettings {
    pub model: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub base_url: Option<String>,
    pub image_format: ImageFormat,
    pub image_budget: u32,
    pub answer_tokens: u32,
    pub max_connections: u32,
    pub max_retries: u32,
    pub request_timeout: u32,
    pub response_cache: ResponseCache,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prices: Option<PathBuf>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_tokens_total: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_cost: Option<Amount>,
}

/// Where answers are kept. Written `on`, `off`, or as a path, which has a slash.
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

/// A word that says neither yes nor no nor where.
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

impl TryFrom<String> for ResponseCache {
    type Error = UnknownCache;

    fn try_from(text: String) -> Result<Self, UnknownCache> {
        text.parse()
    }
}

impl From<ResponseCache> for String {
    fn from(cache: ResponseCache) -> Self {
        cache.to_string()
    }
}

/// An amount of money, exact to millionths of whatever currency the prices are in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(try_from = "f64", into = "f64")]
pub struct Amount {
    /// Millionths.
    pub millionths: u64,
}

/// What is no amount of money.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no amount of money: it should look like 5 or 0.25")]
pub struct NoAmount(String);

impl TryFrom<f64> for Amount {
    type Error = NoAmount;

    fn try_from(amount: f64) -> Result<Self, NoAmount> {
        if (0.0..=1e12).contains(&amount) {
            Ok(Self { millionths: (amount * 1e6).round() as u64 })
        } else {
            Err(NoAmount(amount.to_string()))
        }
    }
}

impl From<Amount> for f64 {
    fn from(amount: Amount) -> Self {
        amount.millionths as Self / 1e6
    }
}

impl FromStr for Amount {
    type Err = NoAmount;

    fn from_str(text: &str) -> Result<Self, NoAmount> {
        let amount: f64 = text.trim().parse().map_err(|_| NoAmount(text.to_owned()))?;
        Self::try_from(amount).map_err(|_| NoAmount(text.to_owned()))
    }
}

impl fmt::Display for Amount {
    /// Two digits after the point, or as many as it takes.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fraction = format!("{:06}", self.millionths % 1_000_000);
        let digits = fraction.trim_end_matches('0').len().max(2);
        write!(f, "{}.{}", self.millionths / 1_000_000, &fraction[..digits])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_are_exact_and_read_as_written() {
        for (text, millionths, shown) in
            [("5", 5_000_000, "5.00"), ("0.25", 250_000, "0.25"), ("0.0001", 100, "0.0001")]
        {
            let amount: Amount = text.parse().unwrap();
            assert_eq!((amount.millionths, amount.to_string().as_str()), (millionths, shown));
        }
        for text in ["-1", "NaN", "free", "1e30", ""] {
            assert!(text.parse::<Amount>().is_err(), "{text}");
        }
    }

    #[test]
    fn caches_are_written_as_they_are_read() {
        for text in ["on", "off", "./mine"] {
            assert_eq!(text.parse::<ResponseCache>().unwrap().to_string(), text);
        }
        insta::assert_snapshot!("of".parse::<ResponseCache>().unwrap_err(), @"unknown response cache `of`: did you mean `off`? (known: on, off); a folder is named by its path, for example ./responses");
    }
}

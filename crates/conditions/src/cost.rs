//! Prices of a model's tokens.
//!
//! Amounts are integers of millionths, and a price is an amount for a million tokens, so a sum over a run does not
//! depend on the order of its requests. The manifest records the prices of the run.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};

use domain::names::UnknownName;

/// The file of `--prices`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct PriceFile {
    currency: String,
    model: Vec<PriceEntry>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct PriceEntry {
    name: String,
    prompt: Money,
    cached_prompt: Option<Money>,
    completion: Money,
}

/// The prices of a million tokens of one model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct ModelPrices {
    /// The currency, for example `USD`.
    pub currency: String,
    /// Prompt tokens.
    pub prompt: Money,
    /// Prompt tokens that the server took from its own cache. Absent: the price of `prompt`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cached_prompt: Option<Money>,
    /// Completion tokens.
    pub completion: Money,
}

impl ModelPrices {
    /// Reads the prices of `model` from the file `path`.
    ///
    /// # Errors
    /// When the file cannot be read, is not a price file, or has no price of the model.
    pub fn read(path: &Path, model: &str) -> Result<Self> {
        let text = durable::input::read_text(path)
            .with_context(|| format!("cannot read the prices in {}", path.display()))?;
        Self::parse(&text, model).with_context(|| format!("the prices in {}", path.display()))
    }

    /// The prices of `model` in the text of a price file.
    ///
    /// # Errors
    /// When it is not a price file, or has no price of the model.
    pub fn parse(text: &str, model: &str) -> Result<Self> {
        let PriceFile { currency, model: models } = toml::from_str(text)?;
        for (index, entry) in models.iter().enumerate() {
            if models[..index].iter().any(|other| other.name == entry.name) {
                bail!("the model `{}` is listed twice", entry.name);
            }
        }
        let found = models.iter().find(|entry| entry.name == model);
        let Some(PriceEntry { prompt, cached_prompt, completion, .. }) = found else {
            let known = models.iter().map(|entry| entry.name.clone());
            return Err(UnknownName::new("model", model, known).into());
        };
        let (prompt, cached_prompt, completion) = (*prompt, *cached_prompt, *completion);
        Ok(Self { currency, prompt, cached_prompt, completion })
    }
}

/// An amount of money in the currency of the prices, exact to a millionth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(try_from = "f64", into = "f64")]
pub struct Money {
    /// Millionths.
    pub millionths: u64,
}

/// A text or number that is not an amount of money.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not an amount of money (write it like 5 or 0.25)")]
pub struct BadAmount(String);

impl TryFrom<f64> for Money {
    type Error = BadAmount;

    fn try_from(amount: f64) -> Result<Self, BadAmount> {
        if (0.0..=1e12).contains(&amount) {
            Ok(Self { millionths: (amount * 1e6).round() as u64 })
        } else {
            Err(BadAmount(amount.to_string()))
        }
    }
}

impl From<Money> for f64 {
    fn from(amount: Money) -> Self {
        amount.millionths as Self / 1e6
    }
}

impl FromStr for Money {
    type Err = BadAmount;

    fn from_str(text: &str) -> Result<Self, BadAmount> {
        let amount: f64 = text.trim().parse().map_err(|_| BadAmount(text.to_owned()))?;
        Self::try_from(amount).map_err(|_| BadAmount(text.to_owned()))
    }
}

impl fmt::Display for Money {
    /// Writes at least two digits after the point, and as many more as the amount has.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fraction = format!("{:06}", self.millionths % 1_000_000);
        let digits = fraction.trim_end_matches('0').len().max(2);
        write!(f, "{}.{}", self.millionths / 1_000_000, &fraction[..digits])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = r#"
currency = "USD"
[[model]]
name = "small"
prompt = 0.4
cached-prompt = 0.1
completion = 1.6
[[model]]
name = "Large/1"
prompt = 3
completion = 15
"#;

    #[test]
    fn a_model_without_a_price_is_named_with_those_that_have_one() {
        fn error(text: &str, model: &str) -> String {
            format!("{:#}", ModelPrices::parse(text, model).unwrap_err())
        }
        insta::assert_snapshot!(error(FILE, "smal"), @"unknown model `smal`: did you mean `small`? (known: small, Large/1)");
        assert!(error("currency = 1", "small").contains("expected a string"));
        assert!(
            error(&FILE.replace("prompt = 3", "prompt = -3"), "small")
                .contains("not an amount of money")
        );
        assert!(error(&FILE.replace("Large/1", "small"), "small").contains("listed twice"));
    }

    #[test]
    fn amounts_are_exact_and_read_as_written() {
        for (text, millionths, shown) in
            [("5", 5_000_000, "5.00"), ("0.25", 250_000, "0.25"), ("0.0001", 100, "0.0001")]
        {
            let amount: Money = text.parse().unwrap();
            assert_eq!((amount.millionths, amount.to_string().as_str()), (millionths, shown));
        }
        for text in ["-1", "NaN", "free", "1e30", ""] {
            assert!(text.parse::<Money>().is_err(), "{text}");
        }
    }
}

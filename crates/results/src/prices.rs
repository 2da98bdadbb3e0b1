//! What a model's tokens cost: read from a file, reckoned exactly.
//!
//! Amounts are integers of millionths, and a price is an amount for a million tokens, so a sum over a run does
//! not depend on the order of its requests. What a run was reckoned with is in its manifest.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};

use crate::names::UnknownName;
use crate::settings::Amount;
use crate::spending::Spending;

/// A file of prices.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct PriceFile {
    currency: String,
    model: Vec<Entry>,
}

/// A model in it.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
struct Entry {
    name: String,
    prompt: Amount,
    cached_prompt: Option<Amount>,
    completion: Amount,
}

/// What a million tokens of one model cost.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct ModelPrices {
    /// What amounts are in, for example `USD`.
    pub currency: String,
    /// A million tokens of prompts.
    pub prompt: Amount,
    /// A million tokens of prompts that the server took from its own cache. Absent: as others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cached_prompt: Option<Amount>,
    /// A million tokens of answers.
    pub completion: Amount,
}

impl ModelPrices {
    /// The prices of `model` in the file `path`.
    ///
    /// # Errors
    /// When the file cannot be read, says something else than prices, or has none of the model.
    pub fn read(path: &Path, model: &str) -> Result<Self> {
        let text = fs::read_to_string(path)
            .with_context(|| format!("cannot read the prices in {}", path.display()))?;
        Self::parse(&text, model).with_context(|| format!("the prices in {}", path.display()))
    }

    fn parse(text: &str, model: &str) -> Result<Self> {
        let PriceFile { currency, model: models } = toml::from_str(text)?;
        for (index, entry) in models.iter().enumerate() {
            if models[..index].iter().any(|other| other.name == entry.name) {
                bail!("the model `{}` is there twice", entry.name);
            }
        }
        let found = models.iter().find(|entry| entry.name == model);
        let Some(Entry { prompt, cached_prompt, completion, .. }) = found else {
            let known = models.iter().map(|entry| entry.name.clone());
            return Err(UnknownName::new("model", model, known).into());
        };
        let (prompt, cached_prompt, completion) = (*prompt, *cached_prompt, *completion);
        Ok(Self { currency, prompt, cached_prompt, completion })
    }

    /// What so many tokens cost, rounded to a millionth.
    pub fn cost(&self, spending: &Spending) -> Amount {
        let Spending { prompt_tokens, cached_tokens, completion_tokens, .. } = *spending;
        let cached = cached_tokens.min(prompt_tokens);
        let each = |tokens: u64, price: Amount| u128::from(tokens) * u128::from(price.millionths);
        let sum = each(prompt_tokens - cached, self.prompt)
            + each(cached, self.cached_prompt.unwrap_or(self.prompt))
            + each(completion_tokens, self.completion);
        let millionths = (sum + 500_000) / 1_000_000;
        Amount { millionths: u64::try_from(millionths).unwrap_or(u64::MAX) }
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
    fn costs_by_hand() {
        let spending = Spending {
            prompt_tokens: 1_000_000,
            cached_tokens: 250_000,
            completion_tokens: 30_000,
            ..Spending::default()
        };
        // 0.75 x 0.4 + 0.25 x 0.1 + 0.03 x 1.6 = 0.3 + 0.025 + 0.048.
        let small = ModelPrices::parse(FILE, "small").unwrap();
        assert_eq!(small.cost(&spending).to_string(), "0.373");
        // Without a price of its own, what was cached costs as the rest: 3 + 0.03 x 15.
        let large = ModelPrices::parse(FILE, "Large/1").unwrap();
        assert_eq!(large.cost(&spending).to_string(), "3.45");
    }

    #[test]
    fn a_model_without_a_price_is_named_with_those_that_have_one() {
        fn error(text: &str, model: &str) -> String {
            format!("{:#}", ModelPrices::parse(text, model).unwrap_err())
        }
        insta::assert_snapshot!(error(FILE, "smal"), @"unknown model `smal`: did you mean `small`? (known: small, Large/1)");
        assert!(error("currency = 1", "small").contains("expected a string"));
        assert!(
            error(&FILE.replace("prompt = 3", "prompt = -3"), "small")
                .contains("no amount of money")
        );
        assert!(error(&FILE.replace("Large/1", "small"), "small").contains("there twice"));
    }
}

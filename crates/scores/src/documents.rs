//! What writing the documents of a run took of models. It is no part of the tokens per 100 cases, as in the paper.

use std::collections::BTreeMap;

use serde::Serialize;

use conditions::cost::Money;
use run_log::Manifest;
use run_log::usage::UsageTotals;

/// What a model took to write documents of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DocumentScore {
    /// The model.
    pub model: String,
    /// Whether the run had them written. Otherwise they were there before.
    pub built: bool,
    /// The documents, by name.
    pub documents: Vec<String>,
    /// Requests and tokens.
    #[serde(flatten)]
    pub usage: UsageTotals,
    /// The cost. Absent without prices of this model, or where token counts are unknown.
    pub cost: Option<Money>,
}

impl DocumentScore {
    /// An entry for each model, and for what the run had it write. Empty where no model has written a document, and where earlier
    /// versions have not recorded what it took.
    pub fn of_run(manifest: &Manifest) -> Vec<Self> {
        let mut by_model: BTreeMap<(&str, bool), (Vec<String>, UsageTotals)> = BTreeMap::new();
        for (name, document) in &manifest.documents {
            let (Some(model), Some(usage)) = (&document.model, document.usage) else { continue };
            let (names, sum) = by_model.entry((model, document.built)).or_default();
            names.push(name.clone());
            sum.merge(&usage.totals());
        }
        let own = manifest.settings.model.as_ref().map(|model| model.model.as_str());
        let score = |((model, built), (documents, usage)): ((&str, bool), _)| {
            let usage: UsageTotals = usage;
            let prices = manifest.prices.as_ref();
            // The prices of a run are those of its own model.
            let prices = prices.filter(|_| usage.unknown == 0 && own == Some(model));
            let cost = prices.map(|prices| usage.cost(prices));
            Self { model: model.to_owned(), built, documents, usage, cost }
        };
        by_model.into_iter().map(score).collect()
    }
}

#[cfg(test)]
mod tests {
    use conditions::cost::ModelPrices;
    use rigs::records::{manifest, model_document, model_settings, script_document};
    use run_log::{DocumentFacts, DocumentUsage};

    use super::*;

    #[test]
    fn documents_are_summed_by_model_and_by_who_had_them_written() {
        let mut manifest = manifest();
        assert_eq!(DocumentScore::of_run(&manifest), []);
        let unmeasured =
            DocumentUsage { requests: 2, prompt_tokens: None, completion_tokens: None };
        let amount = |text: &str| text.parse::<Money>().unwrap();
        manifest.settings.model = Some(model_settings("m"));
        manifest.prices = Some(ModelPrices {
            currency: "USD".to_owned(),
            prompt: amount("1"),
            cached_prompt: None,
            completion: amount("10"),
        });
        manifest.documents = [
            ("summary/original", model_document("m")),
            ("semantic/original", model_document("m")),
            ("summary/4", DocumentFacts { built: false, ..model_document("m") }),
            ("semantic/4", DocumentFacts { usage: Some(unmeasured), ..model_document("n") }),
            ("summary/nearby", script_document()),
            ("semantic/nearby", DocumentFacts { usage: None, model: None, ..model_document("") }),
        ]
        .map(|(name, facts)| (name.to_owned(), facts))
        .into();
        let found: Vec<_> = DocumentScore::of_run(&manifest)
            .into_iter()
            .map(|one| {
                let usage = one.usage;
                let tokens = (usage.unknown == 0).then(|| usage.tokens());
                let cost = one.cost.map(|cost| cost.to_string());
                (one.model, one.built, one.documents.len(), usage.requests, tokens, cost)
            })
            .collect();
        let m = || "m".to_owned();
        assert_eq!(
            found,
            [
                (m(), false, 1, 5, Some(1100), Some("0.002".to_owned())),
                // 2 x (1000 x 1 + 100 x 10) millionths.
                (m(), true, 2, 10, Some(2200), Some("0.004".to_owned())),
                ("n".to_owned(), true, 1, 2, None, None),
            ]
        );
    }
}

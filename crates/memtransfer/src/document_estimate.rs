//! What building documents by a model would take, as a table: requests, images, tokens, money.

use conditions::cost::{ModelPrices, Money};
use documents::DocumentName;
use documents::asking::BuildEstimate;
use orchestrator::run_documents::totals;
use report::table::table;

/// What they would cost, at least and at most, if the server's own cache served nothing.
fn cost(estimate: &BuildEstimate, prices: &ModelPrices) -> [Money; 2] {
    totals(estimate).map(|usage| usage.cost(prices))
}

/// The estimates of documents, one a line, their sum, and what the figures are based on.
pub(crate) fn document_table(
    estimates: &[(DocumentName, BuildEstimate)],
    prices: Option<&ModelPrices>,
) -> String {
    let millions = |count: u64| format!("{:.2}", count as f64 / 1e6);
    let mut header: Vec<String> =
        ["document", "requests", "at most", "images", "Mtok", "at most"].map(str::to_owned).into();
    if let Some(prices) = prices {
        header.extend([format!("{}, least", prices.currency), "at most".to_owned()]);
    }
    let mut table = table(&header, 1);
    let all: BuildEstimate = estimates.iter().map(|(_, estimate)| *estimate).sum();
    let named = estimates.iter().map(|(name, estimate)| (name.to_string(), estimate));
    for (name, estimate) in named.chain([("all".to_owned(), &all)]) {
        let mut row = vec![name];
        row.extend(estimate.requests.map(|requests| requests.to_string()));
        row.push(estimate.images.to_string());
        row.extend(estimate.tokens().map(millions));
        let costs = prices.map(|prices| cost(estimate, prices));
        row.extend(costs.into_iter().flatten().map(|amount| millions(amount.millionths)));
        table.add_row(row);
    }
    let costs = match prices {
        Some(_) => "Costs: without discounts for the server's own cache.",
        None => "Costs: unknown; give --prices FILE (docs/costs.md).",
    };
    format!(
        "{table}\n\
         An estimate. Mtok: million tokens of prompts and answers. From empty answers to answers of --max-tokens\n\
         each; a token is 4 characters of the prompts' own words or 2.3 of demonstrations and answers, an image\n\
         256 tokens. Answers stored by an earlier attempt are not asked for again.\n{costs}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn documents_are_summed_and_priced() {
        let estimate = |requests, images| BuildEstimate {
            requests,
            images,
            prompt_tokens: requests.map(|count| count * 30_000),
            answer_tokens: [0, requests[1] * 16_000],
        };
        let estimates = [
            ("summary/original".parse().unwrap(), estimate([17, 20], 800)),
            ("semantic/4".parse().unwrap(), estimate([69, 140], 3200)),
        ];
        let prices = ModelPrices {
            currency: "USD".to_owned(),
            prompt: Money { millionths: 400_000 },
            cached_prompt: None,
            completion: Money { millionths: 1_600_000 },
        };
        insta::assert_snapshot!(document_table(&estimates, Some(&prices)), @r#"
        ───────────────────────────────────────────────────────────────────────────────
        document          requests  at most  images  Mtok  at most  USD, least  at most
        ───────────────────────────────────────────────────────────────────────────────
        summary/original        17       20     800  0.51     0.92        0.20     0.75
        semantic/4              69      140    3200  2.07     6.44        0.83     5.26
        all                     86      160    4000  2.58     7.36        1.03     6.02
        ───────────────────────────────────────────────────────────────────────────────
        An estimate. Mtok: million tokens of prompts and answers. From empty answers to answers of --max-tokens
        each; a token is 4 characters of the prompts' own words or 2.3 of demonstrations and answers, an image
        256 tokens. Answers stored by an earlier attempt are not asked for again.
        Costs: without discounts for the server's own cache.
        "#);
        assert!(document_table(&estimates, None).ends_with("give --prices FILE (docs/costs.md)."));
    }
}

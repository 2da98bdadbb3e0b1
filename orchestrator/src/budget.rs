//! How much a run may spend, and when it has: `--max-tokens-total` and `--max-cost`.
//!
//! What earlier sessions spent counts, also on episodes that were walked again.

use results::cost::Amount;
use results::cost::ModelPrices;
use results::log::RequestRecord;
use results::settings::ModelSettings;
use results::usage::UsageTotals;

/// What a run has spent, and may.
#[derive(Debug, Clone, Default)]
pub struct Budget {
    spent: UsageTotals,
    max_tokens: Option<u64>,
    max_cost: Option<(Amount, ModelPrices)>,
}

impl Budget {
    /// What `model`'s settings allow, with `past` spent already. A bound on the cost is kept where there are
    /// prices.
    pub fn new(
        model: Option<&ModelSettings>,
        prices: Option<&ModelPrices>,
        past: &[RequestRecord],
    ) -> Self {
        let max_cost = model.and_then(|model| model.max_cost).zip(prices.cloned());
        let max_tokens = model.and_then(|model| model.max_tokens_total);
        Self { spent: UsageTotals::of(past), max_tokens, max_cost }
    }

    /// Counts a request.
    pub fn add(&mut self, request: &RequestRecord) {
        self.spent.add(request);
    }

    /// Why nothing more may be spent, if that is so.
    pub fn exceeded(&self) -> Option<String> {
        let Self { spent, max_tokens, max_cost } = self;
        if spent.unknown > 0 && (max_tokens.is_some() || max_cost.is_some()) {
            return Some(
                "the server does not tell how many tokens its answers took, so --max-tokens-total and --max-cost \
                 cannot be kept to: run without them"
                    .to_owned(),
            );
        }
        let used = spent.tokens();
        if let Some(most) = max_tokens.filter(|most| used >= *most) {
            return Some(format!(
                "the run has used {used} tokens, and --max-tokens-total is {most}: a larger one goes on"
            ));
        }
        if let Some((most, prices)) = max_cost {
            let cost = prices.cost(spent);
            if cost >= *most {
                let currency = &prices.currency;
                return Some(format!(
                    "the run has cost {cost} {currency}, and --max-cost is {most}: a larger one goes on"
                ));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use results::log::testing::request;

    fn budget(max_tokens: Option<u64>, max_cost: Option<&str>, past: &[RequestRecord]) -> Budget {
        let amount = |text: &str| text.parse::<Amount>().unwrap();
        let prices = ModelPrices {
            currency: "EUR".to_owned(),
            prompt: amount("1"),
            cached_prompt: None,
            completion: amount("10"),
        };
        let max_cost = max_cost.map(|most| (amount(most), prices));
        Budget { spent: UsageTotals::of(past), max_tokens, max_cost }
    }

    #[test]
    fn a_run_stops_when_it_has_spent_what_it_may_earlier_sessions_included() {
        let past = [request("a", 0), request("b", 0)];
        assert_eq!(budget(None, None, &past).exceeded(), None);
        let mut tokens = budget(Some(3000), Some("1"), &past);
        assert_eq!(tokens.exceeded(), None);
        tokens.add(&RequestRecord { replayed: true, ..request("c", 0) });
        assert_eq!(tokens.exceeded(), None, "what was kept costs nothing");
        tokens.add(&request("c", 1));
        let said =
            "the run has used 3009 tokens, and --max-tokens-total is 3000: a larger one goes on";
        assert_eq!(tokens.exceeded().as_deref(), Some(said));
        let mut cost = budget(None, Some("0.003"), &past);
        assert_eq!(cost.exceeded(), None);
        cost.add(&request("c", 1));
        // 3 x (1000 x 1 + 3 x 10) millionths.
        let said = "the run has cost 0.00309 EUR, and --max-cost is 0.003: a larger one goes on";
        assert_eq!(cost.exceeded().as_deref(), Some(said));
    }

    #[test]
    fn a_bound_that_cannot_be_watched_stops_the_run() {
        let untold = [RequestRecord { prompt_tokens: None, ..request("a", 0) }];
        assert_eq!(budget(None, None, &untold).exceeded(), None);
        let said = budget(Some(10), None, &untold).exceeded().unwrap();
        assert!(said.starts_with("the server does not tell how many tokens"), "{said}");
    }
}

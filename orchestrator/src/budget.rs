//! The limits on what a run may spend: `--max-tokens-total` and `--max-cost`.
//!
//! Requests of earlier sessions count, also those of episodes that were repeated, and those for documents that the run has had
//! its model write.

use conditions::cost::{ModelPrices, Money};
use conditions::settings::ModelSettings;
use run_log::RequestRecord;
use run_log::usage::UsageTotals;

/// What a run has used, and its limits.
#[derive(Debug, Clone, Default)]
pub(crate) struct Budget {
    used: UsageTotals,
    max_tokens: Option<u64>,
    max_cost: Option<(Money, ModelPrices)>,
}

impl Budget {
    /// The limits in `model`, with the requests in `past` counted. Costs are limited only with `prices`.
    pub(crate) fn new(
        model: Option<&ModelSettings>,
        prices: Option<&ModelPrices>,
        past: &[RequestRecord],
    ) -> Self {
        let max_cost = model.and_then(|model| model.max_cost).zip(prices.cloned());
        let max_tokens = model.and_then(|model| model.max_tokens_total);
        Self { used: UsageTotals::of(past), max_tokens, max_cost }
    }

    /// Counts what other requests took: those for documents.
    pub(crate) fn count(&mut self, usage: &UsageTotals) {
        self.used.merge(usage);
    }

    /// Counts a request.
    pub(crate) fn add(&mut self, request: &RequestRecord) {
        self.used.add(request);
    }

    /// Why `part`, which takes at least `least`, is not begun, if a limit does not allow for it.
    pub(crate) fn too_small(&self, part: &str, least: &UsageTotals) -> Option<String> {
        let mut after = self.used;
        after.merge(least);
        let (tokens, so_far) = (least.tokens(), self.used.tokens());
        if let Some(most) = self.max_tokens.filter(|most| after.tokens() > *most) {
            return Some(format!(
                "{part} takes about {tokens} tokens at least, the run has used {so_far}, and --max-tokens-total is {most}: raise \
                 it to continue"
            ));
        }
        let (most, prices) = self.max_cost.as_ref()?;
        (after.cost(prices) > *most).then(|| {
            let (cost, so_far) = (least.cost(prices), self.used.cost(prices));
            let currency = &prices.currency;
            format!(
                "{part} costs about {cost} {currency} at least, the run has cost {so_far}, and --max-cost is {most}: raise it to \
                 continue"
            )
        })
    }

    /// Why the run has to stop, if a limit is reached.
    pub(crate) fn exceeded(&self) -> Option<String> {
        let Self { used, max_tokens, max_cost } = self;
        if used.unknown > 0 && (max_tokens.is_some() || max_cost.is_some()) {
            return Some(
                "the server does not report tokens, so --max-tokens-total and --max-cost cannot be enforced: run \
                 without them"
                    .to_owned(),
            );
        }
        let tokens = used.tokens();
        if let Some(most) = max_tokens.filter(|most| tokens >= *most) {
            return Some(format!(
                "the run has used {tokens} tokens, and --max-tokens-total is {most}: raise it to continue"
            ));
        }
        if let Some((most, prices)) = max_cost {
            let cost = used.cost(prices);
            if cost >= *most {
                let currency = &prices.currency;
                return Some(format!(
                    "the run has cost {cost} {currency}, and --max-cost is {most}: raise it to continue"
                ));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rigs::records::request;

    fn budget(max_tokens: Option<u64>, max_cost: Option<&str>, past: &[RequestRecord]) -> Budget {
        let amount = |text: &str| text.parse::<Money>().unwrap();
        let prices = ModelPrices {
            currency: "EUR".to_owned(),
            prompt: amount("1"),
            cached_prompt: None,
            completion: amount("10"),
        };
        let max_cost = max_cost.map(|most| (amount(most), prices));
        Budget { used: UsageTotals::of(past), max_tokens, max_cost }
    }

    #[test]
    fn a_run_stops_at_its_limit_earlier_sessions_included() {
        let past = [request("a", 0), request("b", 0)];
        assert_eq!(budget(None, None, &past).exceeded(), None);
        let mut tokens = budget(Some(3000), Some("1"), &past);
        assert_eq!(tokens.exceeded(), None);
        tokens.add(&RequestRecord { replayed: true, ..request("c", 0) });
        assert_eq!(tokens.exceeded(), None, "a cached reply costs nothing");
        tokens.add(&request("c", 1));
        let said =
            "the run has used 3009 tokens, and --max-tokens-total is 3000: raise it to continue";
        assert_eq!(tokens.exceeded().as_deref(), Some(said));
        let mut cost = budget(None, Some("0.003"), &past);
        assert_eq!(cost.exceeded(), None);
        cost.add(&request("c", 1));
        // 3 x (1000 x 1 + 3 x 10) millionths.
        let said = "the run has cost 0.00309 EUR, and --max-cost is 0.003: raise it to continue";
        assert_eq!(cost.exceeded().as_deref(), Some(said));
    }

    #[test]
    fn what_a_limit_does_not_allow_for_is_not_begun() {
        let past = [request("a", 0)];
        let least = UsageTotals { prompt_tokens: 2000, ..UsageTotals::default() };
        let refused = |tokens, cost| budget(tokens, cost, &past).too_small("it", &least);
        assert_eq!(refused(None, None), None);
        assert_eq!(refused(Some(3003), Some("0.00303")), None);
        insta::assert_snapshot!(refused(Some(3002), None).unwrap(), @"it takes about 2000 tokens at least, the run has used 1003, and --max-tokens-total is 3002: raise it to continue");
        insta::assert_snapshot!(refused(None, Some("0.00302")).unwrap(), @"it costs about 0.002 EUR at least, the run has cost 0.00103, and --max-cost is 0.00302: raise it to continue");
    }

    #[test]
    fn a_limit_that_cannot_be_enforced_stops_the_run() {
        let unmeasured = [RequestRecord { prompt_tokens: None, ..request("a", 0) }];
        assert_eq!(budget(None, None, &unmeasured).exceeded(), None);
        let said = budget(Some(10), None, &unmeasured).exceeded().unwrap();
        assert!(said.starts_with("the server does not report tokens"), "{said}");
    }
}

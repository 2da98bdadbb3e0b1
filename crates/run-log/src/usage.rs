//! Requests and tokens of a set of requests to a model.

use serde::Serialize;

use crate::RequestRecord;
use conditions::cost::{ModelPrices, Money};

/// Sums over requests. Answers from the response cache cost nothing and are only counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct UsageTotals {
    /// Requests that the server answered.
    pub requests: u64,
    /// Attempts made for them, failed ones included; one for a request whose attempts are unknown.
    pub attempts: u64,
    /// Requests answered from the response cache.
    pub replayed: u64,
    /// Answered requests whose token counts are unknown; they are not in the sums.
    pub unknown: u64,
    /// Prompt tokens.
    pub prompt_tokens: u64,
    /// Prompt tokens that the server took from its own cache, where it reports them.
    pub cached_tokens: u64,
    /// Completion tokens.
    pub completion_tokens: u64,
}

impl UsageTotals {
    /// Sums up `requests`.
    pub fn of<'a>(requests: impl IntoIterator<Item = &'a RequestRecord>) -> Self {
        let mut sum = Self::default();
        requests.into_iter().for_each(|request| sum.add(request));
        sum
    }

    /// Adds a request.
    pub fn add(&mut self, request: &RequestRecord) {
        if request.replayed {
            self.replayed += 1;
            return;
        }
        self.requests += 1;
        self.attempts += u64::from(request.attempts.unwrap_or(1));
        let (Some(prompt), Some(completion)) = (request.prompt_tokens, request.completion_tokens)
        else {
            self.unknown += 1;
            return;
        };
        self.prompt_tokens += u64::from(prompt);
        self.completion_tokens += u64::from(completion);
        self.cached_tokens += u64::from(request.cached_tokens.unwrap_or(0));
    }

    /// Adds the totals of other requests.
    pub fn merge(&mut self, other: &Self) {
        self.requests += other.requests;
        self.attempts += other.attempts;
        self.replayed += other.replayed;
        self.unknown += other.unknown;
        self.prompt_tokens += other.prompt_tokens;
        self.cached_tokens += other.cached_tokens;
        self.completion_tokens += other.completion_tokens;
    }

    /// Attempts beyond the first of each request.
    pub const fn retries(&self) -> u64 {
        self.attempts.saturating_sub(self.requests)
    }

    /// Prompt and completion tokens together.
    pub const fn tokens(&self) -> u64 {
        self.prompt_tokens + self.completion_tokens
    }

    /// The cost at `prices`, rounded to a millionth.
    pub fn cost(&self, prices: &ModelPrices) -> Money {
        let Self { prompt_tokens, cached_tokens, completion_tokens, .. } = *self;
        let cached = cached_tokens.min(prompt_tokens);
        let each = |tokens: u64, price: Money| u128::from(tokens) * u128::from(price.millionths);
        let sum = each(prompt_tokens - cached, prices.prompt)
            + each(cached, prices.cached_prompt.unwrap_or(prices.prompt))
            + each(completion_tokens, prices.completion);
        let millionths = (sum + 500_000) / 1_000_000;
        Money { millionths: u64::try_from(millionths).unwrap_or(u64::MAX) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::records::request;

    #[test]
    fn cached_answers_cost_nothing_and_unknown_counts_are_counted() {
        let replayed = RequestRecord { replayed: true, attempts: Some(0), ..request("a", 0) };
        let unknown = RequestRecord { completion_tokens: None, ..request("a", 1) };
        let retried = RequestRecord { attempts: Some(3), cached_tokens: None, ..request("a", 2) };
        let sum = UsageTotals::of(&[request("a", 0), replayed, unknown, retried]);
        assert_eq!((sum.requests, sum.attempts, sum.replayed, sum.unknown), (3, 5, 1, 1));
        assert_eq!((sum.prompt_tokens, sum.cached_tokens, sum.completion_tokens), (2000, 200, 6));
        assert_eq!(sum.tokens(), 2006);
    }

    #[test]
    fn costs_by_hand() {
        let usage = UsageTotals {
            prompt_tokens: 1_000_000,
            cached_tokens: 250_000,
            completion_tokens: 30_000,
            ..UsageTotals::default()
        };
        let cost = |prompt: &str, cached: Option<&str>, completion: &str| {
            let amount = |text: &str| text.parse::<Money>().unwrap();
            let prices = ModelPrices {
                currency: "USD".to_owned(),
                prompt: amount(prompt),
                cached_prompt: cached.map(amount),
                completion: amount(completion),
            };
            usage.cost(&prices).to_string()
        };
        // 0.75 x 0.4 + 0.25 x 0.1 + 0.03 x 1.6 = 0.3 + 0.025 + 0.048.
        assert_eq!(cost("0.4", Some("0.1"), "1.6"), "0.373");
        // Without a price of its own, what was cached costs as the rest: 3 + 0.03 x 15.
        assert_eq!(cost("3", None, "15"), "3.45");
    }
}

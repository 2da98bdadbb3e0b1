//! What questions to a model came to: requests, tokens. Pure sums over the run folder's `requests.jsonl`.

use serde::Serialize;

use crate::log::RequestRecord;

/// What was spent on requests. Answers that had been kept from earlier cost nothing and are only counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Spending {
    /// Questions that a server answered.
    pub requests: u64,
    /// Requests that were sent for them, failed ones included.
    pub attempts: u64,
    /// Questions that were answered from the response cache.
    pub replayed: u64,
    /// Questions whose tokens nobody told: they are not in the sums.
    pub untold: u64,
    /// Tokens of prompts.
    pub prompt_tokens: u64,
    /// Those of them that the server took from its own cache, as far as it told.
    pub cached_tokens: u64,
    /// Tokens of answers.
    pub completion_tokens: u64,
}

impl Spending {
    /// What `requests` came to.
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
        self.attempts += u64::from(request.attempts);
        let (Some(prompt), Some(completion)) = (request.prompt_tokens, request.completion_tokens)
        else {
            self.untold += 1;
            return;
        };
        self.prompt_tokens += u64::from(prompt);
        self.completion_tokens += u64::from(completion);
        self.cached_tokens += u64::from(request.cached_tokens.unwrap_or(0));
    }

    /// Tokens of prompts and answers.
    pub const fn tokens(&self) -> u64 {
        self.prompt_tokens + self.completion_tokens
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::testing::request;

    #[test]
    fn what_was_kept_costs_nothing_and_what_was_not_told_is_counted() {
        let replayed = RequestRecord { replayed: true, attempts: 0, ..request("a", 0) };
        let untold = RequestRecord { completion_tokens: None, ..request("a", 1) };
        let retried = RequestRecord { attempts: 3, cached_tokens: None, ..request("a", 2) };
        let sum = Spending::of(&[request("a", 0), replayed, untold, retried]);
        assert_eq!((sum.requests, sum.attempts, sum.replayed, sum.untold), (3, 5, 1, 1));
        assert_eq!((sum.prompt_tokens, sum.cached_tokens, sum.completion_tokens), (2000, 200, 6));
        assert_eq!(sum.tokens(), 2006);
    }
}

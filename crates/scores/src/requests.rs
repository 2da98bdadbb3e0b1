//! Tokens, latency and cost of requests to a model, from `requests.jsonl`: those of episodes that were run again are
//! included.

use std::collections::BTreeMap;

use domain::MemoryKind;
use serde::Serialize;

use conditions::cost::Money;
use conditions::key::EpisodeKey;
use run_log::usage::UsageTotals;
use run_log::{RequestRecord, RunLog, Unread};

/// Figures of a set of requests. A sum is absent when one of the requests that the server answered was not measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RequestScore {
    /// Requests and tokens.
    #[serde(flatten)]
    pub usage: UsageTotals,
    /// Mean tokens of a prompt.
    pub prompt_tokens_each: Option<f64>,
    /// Percentage of the prompt tokens that are injected memory, as the policy estimates it.
    pub memory_share: Option<f64>,
    /// Percentage of the prompt tokens that a server can reuse from the request before, as the policy estimates it.
    pub reusable_share: Option<f64>,
    /// Percentage of the prompt tokens that the server took from its own cache.
    pub cached_share: Option<f64>,
    /// Images that the policy was asked to look at.
    pub images_asked: u64,
    /// Images that were left out because they exceeded the budget.
    pub images_dropped: u64,
    /// Answers in which no action could be read.
    pub unread: Unread,
    /// Median latency in milliseconds, of the attempt that was answered.
    pub latency_p50_ms: Option<f64>,
    /// 90th percentile of the same.
    pub latency_p90_ms: Option<f64>,
    /// The cost. Absent without prices, or where token counts are unknown.
    pub cost: Option<Money>,
}

impl RequestScore {
    /// All requests of a run; `None` when no model was asked.
    pub fn of_run(log: &RunLog) -> Option<Self> {
        Self::of(log, &log.requests.iter().collect::<Vec<_>>())
    }

    /// The requests of each memory.
    pub fn by_memory(log: &RunLog) -> Vec<(MemoryKind, Self)> {
        let mut by_memory: BTreeMap<MemoryKind, Vec<&RequestRecord>> = BTreeMap::new();
        for request in &log.requests {
            if let Some(key) = EpisodeKey::read(&request.key) {
                by_memory.entry(key.condition.memory).or_default().push(request);
            }
        }
        let of = |(memory, requests): (_, Vec<_>)| Some((memory, Self::of(log, &requests)?));
        by_memory.into_iter().filter_map(of).collect()
    }

    fn of(log: &RunLog, requests: &[&RequestRecord]) -> Option<Self> {
        if requests.is_empty() {
            return None;
        }
        let usage = UsageTotals::of(requests.iter().copied());
        let sent = || requests.iter().filter(|request| !request.replayed);
        let sum = |count: fn(&RequestRecord) -> Option<u32>| {
            sent().map(|request| count(request).map(u64::from)).sum::<Option<u64>>()
        };
        let prompt = sum(|request| request.prompt_tokens).filter(|tokens| *tokens > 0);
        let share = |part: Option<u64>| Some(100.0 * part? as f64 / prompt? as f64);
        let mut latencies: Vec<u64> = sent().filter_map(|request| request.latency_us).collect();
        latencies.sort_unstable();
        let images = |count: fn(&RequestRecord) -> Option<u32>| -> u64 {
            requests.iter().filter_map(|request| count(request)).map(u64::from).sum()
        };
        let prices = log.manifest.prices.as_ref().filter(|_| usage.unknown == 0);
        Some(Self {
            prompt_tokens_each: prompt.map(|tokens| tokens as f64 / usage.requests as f64),
            memory_share: share(sum(|request| request.memory_tokens)),
            reusable_share: share(sum(|request| request.reusable_tokens)),
            cached_share: share(sum(|request| request.cached_tokens)),
            images_asked: images(|request| request.images_asked),
            images_dropped: images(|request| {
                Some(request.images_asked?.saturating_sub(request.images?))
            }),
            unread: unread(requests),
            latency_p50_ms: quantile(&latencies, 50).map(|us| us as f64 / 1000.0),
            latency_p90_ms: quantile(&latencies, 90).map(|us| us as f64 / 1000.0),
            cost: prices.map(|prices| usage.cost(prices)),
            usage,
        })
    }
}

fn unread(requests: &[&RequestRecord]) -> Unread {
    let mut unread = Unread::default();
    requests.iter().for_each(|request| unread.add(request.outcome));
    unread
}

/// The smallest of the `sorted` values that at least `percent` of a hundred do not exceed.
fn quantile(sorted: &[u64], percent: usize) -> Option<u64> {
    let rank = (sorted.len() * percent).div_ceil(100);
    sorted.get(rank.max(1) - 1).copied()
}

#[cfg(test)]
mod tests {
    use domain::Outcome;

    use super::*;
    use rigs::records::{log, manifest, record, request};

    #[test]
    fn shares_latencies_and_costs_by_hand() {
        let key = record("t01-01", true).key;
        let of = |latency_us, cached| RequestRecord {
            latency_us: Some(latency_us),
            cached_tokens: Some(cached),
            ..request(&key, 0)
        };
        let mut requests: Vec<_> = (1..=9).map(|n| of(n * 1000, 100)).collect();
        requests.push(RequestRecord {
            outcome: Outcome::Empty,
            images: Some(5),
            ..of(90_000, 100)
        });
        requests.push(RequestRecord { replayed: true, latency_us: None, ..request(&key, 0) });
        let mut manifest = manifest();
        manifest.prices = Some(conditions::cost::ModelPrices {
            currency: "EUR".to_owned(),
            prompt: "1".parse().unwrap(),
            cached_prompt: Some("0".parse().unwrap()),
            completion: "10".parse().unwrap(),
        });
        let mut log = RunLog { manifest, requests, ..log(Vec::new()) };
        let found = RequestScore::of_run(&log).unwrap();
        assert_eq!((found.usage.requests, found.usage.replayed), (10, 1));
        assert_eq!((found.prompt_tokens_each, found.memory_share), (Some(1000.0), Some(30.0)));
        assert_eq!((found.reusable_share, found.cached_share), (Some(25.0), Some(10.0)));
        assert_eq!((found.latency_p50_ms, found.latency_p90_ms), (Some(5.0), Some(9.0)));
        assert_eq!((found.unread.empty, found.unread.total(), found.images_dropped), (1, 1, 2));
        // 10 x (900 x 1 + 3 x 10) millionths.
        assert_eq!(found.cost.unwrap().to_string(), "0.0093");
        assert_eq!(
            RequestScore::by_memory(&log),
            [(domain::Representation::Episodic.into(), found)]
        );

        // A policy that does not count attempts and images.
        let request =
            RequestRecord { attempts: None, images: None, images_asked: None, ..request(&key, 1) };
        let mut unmeasured = log.clone();
        unmeasured.requests = vec![request];
        let none = RequestScore::of_run(&unmeasured).unwrap();
        assert_eq!((none.usage.retries(), none.images_asked, none.images_dropped), (0, 0, 0));

        // A sum over some would look like one over all.
        log.requests[3].cached_tokens = None;
        let found = RequestScore::of_run(&log).unwrap();
        assert_eq!((found.cached_share, found.memory_share), (None, Some(30.0)));
        log.requests[3].prompt_tokens = None;
        let found = RequestScore::of_run(&log).unwrap();
        assert_eq!((found.memory_share, found.cost), (None, None));
        log.requests.clear();
        assert_eq!(RequestScore::of_run(&log), None);
    }
}

//! `memtransfer run --dry-run`: what would run, without touching anything.

use std::collections::BTreeMap;

use anyhow::Result;
use conditions::cost::ModelPrices;
use orchestrator::plan::PlannedEpisode;
use orchestrator::run_documents::{RunDocuments, listed};
use orchestrator::run_plan::RunPlan;
use report::table;
use run_log::{EpisodeRecord, LogError, RunLog};

use crate::document_estimate::document_table;
use crate::estimate::{Basis, RunEstimate};

/// What would run: conditions, episodes, requests, and the estimated cost of a model.
pub(super) fn describe(plan: &RunPlan, fresh: bool) -> Result<String> {
    let RunPlan { settings, books, episodes, prices, .. } = plan;
    let documents = RunDocuments::of(settings, books, fresh);
    let done = if fresh { Vec::new() } else { finished(plan, &documents)? };
    let is_done = |episode: &PlannedEpisode| {
        let key = episode.key.to_string();
        done.binary_search_by(|record| record.key.cmp(&key)).is_ok()
    };
    let sizes = if settings.model.is_some() { documents.largest_sizes() } else { BTreeMap::new() };
    let basis = settings.model.as_ref().map(|model| Basis {
        settings,
        model,
        books,
        documents: &sizes,
        done: &done,
    });
    // At most: every episode takes all steps, every window is full.
    let most_requests = |episodes: u64| {
        if settings.policy.has_process() { episodes * u64::from(settings.max_steps) } else { 0 }
    };
    let image_budget = settings.model.as_ref().map_or(u32::MAX, |model| model.image_budget);
    let header = ["condition", "runs", "episodes", "done", "requests", "images/req", "images"];
    let mut table = table::table(&header, 1);
    let (mut missing, mut images) = (0, 0);
    let mut estimates = Vec::new();
    for (condition, runs) in settings.runs() {
        let planned: Vec<&PlannedEpisode> =
            episodes.iter().filter(|episode| episode.key.condition == condition).collect();
        let left: Vec<&PlannedEpisode> =
            planned.iter().copied().filter(|episode| !is_done(episode)).collect();
        let requests = most_requests(left.len() as u64);
        let images_each = u64::from(settings.images(&condition).min(image_budget));
        missing += left.len() as u64;
        images += requests * images_each;
        if let Some(basis) = &basis {
            estimates.push((condition.to_string(), basis.estimate(&condition, &left)));
        }
        table.add_row([
            condition.to_string(),
            runs.to_string(),
            planned.len().to_string(),
            (planned.len() - left.len()).to_string(),
            requests.to_string(),
            images_each.to_string(),
            (requests * images_each).to_string(),
        ]);
    }
    let mut text = format!(
        "{table}\n\n{missing} of {} episodes of {} conditions would run with policy {}, into {}.\n\
         At most {} requests with {images} images.{}",
        episodes.len(),
        settings.conditions().len(),
        settings.policy,
        settings.out.display(),
        most_requests(missing),
        about_documents(&documents),
    );
    let of_documents = documents.estimates();
    if !of_documents.is_empty() {
        let table = document_table(&of_documents, prices.as_ref());
        text += &format!("\n\nThe model would write first, whatever the episodes take:\n{table}");
    }
    if !estimates.is_empty() {
        text += &cost_table(&estimates, prices.as_ref());
        if !of_documents.is_empty() {
            text += "\nA document that is not written yet counts with the most tokens that an answer may have.";
        }
    }
    Ok(text)
}

/// The line about documents; empty if none are needed.
fn about_documents(documents: &RunDocuments) -> String {
    let state = if documents.builds_missing() { "to be built" } else { "missing" };
    let parts = [(documents.ready(), "ready"), (documents.missing(), state)];
    let parts = parts.iter().filter(|(names, _)| !names.is_empty());
    let parts: Vec<String> =
        parts.map(|(names, state)| format!("{} {state}", listed(names))).collect();
    if parts.is_empty() { String::new() } else { format!("\nDocuments: {}.", parts.join("; ")) }
}

/// The finished episodes of the run in the folder, which has to match this one.
fn finished(plan: &RunPlan, documents: &RunDocuments) -> Result<Vec<EpisodeRecord>> {
    let out = &plan.settings.out;
    if !out.join("manifest.json").exists() {
        return Ok(Vec::new());
    }
    let log = RunLog::read(out)?;
    if log.episodes.is_empty() {
        return Ok(Vec::new());
    }
    let mut manifest = plan.manifest()?;
    manifest.documents = documents.facts_now();
    let differences = manifest.differences(&log.manifest);
    if !differences.is_empty() {
        return Err(LogError::OtherSettings { dir: out.clone(), differences }.into());
    }
    log.check_planned(&plan.keys())?;
    Ok(log.episodes)
}

/// The estimate of what would be sent to a model.
fn cost_table(estimates: &[(String, RunEstimate)], prices: Option<&ModelPrices>) -> String {
    let absent = || "-".to_owned();
    let millions = |count: u64| format!("{:.2}", count as f64 / 1e6);
    let range = |range: Option<[u64; 2]>| match range {
        Some(range) => range.map(millions).to_vec(),
        None => vec![absent(), absent()],
    };
    let sum = |sum: Option<[u64; 2]>, more: Option<[u64; 2]>| {
        let ([a, b], [c, d]) = (sum?, more?);
        Some([a + c, b + d])
    };
    let mut header: Vec<String> =
        ["condition", "requests", "at most", "images/req", "tokens/req", "Mtok", "at most"]
            .map(str::to_owned)
            .to_vec();
    if let Some(prices) = prices {
        header.extend([format!("{}, least", prices.currency), "at most".to_owned()]);
    }
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let mut table = table::table(&header, 1);
    let (mut requests, mut tokens, mut costs) = ([0; 2], Some([0; 2]), Some([0; 2]));
    for (condition, estimate) in estimates {
        let cost = prices
            .and_then(|prices| estimate.cost(prices))
            .map(|cost| cost.map(|amount| amount.millionths));
        requests = [0, 1].map(|end: usize| requests[end] + estimate.requests[end]);
        tokens = sum(tokens, estimate.tokens());
        costs = sum(costs, cost);
        let mut row = vec![condition.clone()];
        row.extend(estimate.requests.map(|requests| requests.to_string()));
        row.push(estimate.images_each.to_string());
        row.push(estimate.prompt_each.map_or_else(absent, |tokens| tokens.to_string()));
        row.extend(range(estimate.tokens()));
        row.extend(prices.into_iter().flat_map(|_| range(cost)));
        table.add_row(row);
    }
    let mut total = vec!["all".to_owned()];
    total.extend(requests.map(|requests| requests.to_string()));
    total.extend([absent(), absent()]);
    total.extend(range(tokens));
    total.extend(prices.into_iter().flat_map(|_| range(costs)));
    table.add_row(total);
    format!("\n\n{table}\n{}", explanation(estimates, tokens.is_some(), prices.is_some()))
}

/// What the figures of an estimate are based on.
fn explanation(estimates: &[(String, RunEstimate)], has_tokens: bool, has_prices: bool) -> String {
    let all = estimates.len();
    let steps = estimates.iter().filter(|(_, one)| one.measured_steps).count();
    let tokens = estimates.iter().filter(|(_, one)| one.measured_tokens).count();
    let mut text = format!(
        "An estimate; nothing has been sent. Mtok: million tokens of prompts and answers.\n\
         Requests: from the length of the reference to --max-steps; for {steps} of {all} conditions the mean of\n\
         finished episodes. Tokens per request: measured for {tokens} of {all} conditions, otherwise from the\n\
         length of the prompt. A model may count otherwise."
    );
    if !has_tokens {
        text += "\n-: unknown, because a document is not built yet.";
    }
    text += match has_prices {
        true => "\nCosts: without discounts for the server's own cache.",
        false => "\nCosts: unknown; give --prices FILE (docs/costs.md).",
    };
    text
}

//! How a model is asked.

use std::time::Duration;

use domain::{REQUEST_FIELDS, ReasoningRequest, SystemRole};
use serde_json::{Map, Value};

use crate::slots::EndpointLimit;

/// What all requests to a model have in common, which changes its answers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RequestOptions {
    /// What requests say about reasoning.
    pub reasoning: ReasoningRequest,
    /// How the rules of a conversation are sent.
    pub system_role: SystemRole,
    /// Further fields of the body. They replace those of the same name; one that is null is left out.
    pub extra_body: Map<String, Value>,
}

impl Default for RequestOptions {
    fn default() -> Self {
        let (reasoning, system_role) = (ReasoningRequest::Off, SystemRole::System);
        Self { reasoning, system_role, extra_body: Map::new() }
    }
}

/// Further fields of a body: a JSON object.
///
/// # Errors
/// When the text is none, or has a field that is the run's own.
pub fn extra_body(text: &str) -> Result<Map<String, Value>, String> {
    let fields: Map<String, Value> = serde_json::from_str(text)
        .map_err(|error| format!("it is not a JSON object such as {{\"top_k\": 1}}: {error}"))?;
    match REQUEST_FIELDS.iter().find(|own| fields.contains_key(**own)) {
        Some(own) => Err(format!("the run sets {own:?} itself")),
        None => Ok(fields),
    }
}

/// How a model is asked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChatSettings {
    /// The model, by the name that the server knows it by.
    pub model: String,
    /// What all requests have in common.
    pub options: RequestOptions,
    /// The time of one attempt, from the look-up of the host to the last byte of the answer. Attempts on a server that
    /// answers more slowly get more, up to eight times this.
    pub request_timeout: Duration,
    /// How many times a request is sent again after a transient failure.
    pub max_retries: u32,
    /// Maximum number of requests in flight to one endpoint, at least 1. Fewer while the server cannot keep up.
    pub max_connections: u32,
    /// A limit that holds for other processes too.
    pub endpoint_limit: Option<EndpointLimit>,
    /// How long to wait for a server that has answered before and is unreachable now.
    pub server_patience: Duration,
}

impl ChatSettings {
    /// The defaults, for `model`.
    pub fn new(model: impl Into<String>) -> Self {
        Self {
            model: model.into(),
            options: RequestOptions::default(),
            request_timeout: Duration::from_secs(120),
            max_retries: 5,
            max_connections: 16,
            endpoint_limit: None,
            server_patience: Duration::from_secs(600),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn further_fields_are_an_object_without_the_runs_own() {
        assert_eq!(extra_body(r#"{"top_k": 1}"#).unwrap()["top_k"], 1);
        for (text, expected) in [
            ("top_k=1", "it is not a JSON object such as"),
            ("[1]", "it is not a JSON object such as"),
            (r#"{"messages": []}"#, "the run sets \"messages\" itself"),
        ] {
            let error = extra_body(text).unwrap_err();
            assert!(error.starts_with(expected), "{error}");
        }
    }
}

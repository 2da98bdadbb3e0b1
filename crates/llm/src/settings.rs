//! How a model is asked.

use std::time::Duration;

use crate::slots::EndpointLimit;

/// How a model is asked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChatSettings {
    /// The model, by the name that the server knows it by.
    pub model: String,
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
            request_timeout: Duration::from_secs(120),
            max_retries: 5,
            max_connections: 16,
            endpoint_limit: None,
            server_patience: Duration::from_secs(600),
        }
    }
}

//! Single attempts over HTTP.

use std::collections::hash_map::RandomState;
use std::fmt;
use std::hash::BuildHasher;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, SystemTime};

use ureq::Agent;
use ureq::http::header::{AUTHORIZATION, CONTENT_TYPE, DATE, LOCATION, RETRY_AFTER, SERVER};
use ureq::http::{HeaderName, Response};
use ureq::tls::{RootCerts, TlsConfig, TlsProvider};

use crate::endpoint::Endpoint;
use crate::error::{AttemptError, RequestError, Transient};
use crate::reply::{self, ChatReply, UnusableReply};
use crate::request::{ChatRequest, Dialect};
use crate::server;
use crate::settings::ChatSettings;

/// Maximum number of bytes that are read of an answer.
const LARGEST_ANSWER: u64 = 16 << 20;

/// Maximum number of connections that are kept open for later requests.
const IDLE_CONNECTIONS: usize = 256;

/// The outcome of sending a request in one dialect.
enum SendOutcome {
    Reply(Box<ChatReply>),
    /// The server refuses optional fields; this dialect leaves them out.
    OtherDialect(Dialect),
}

/// A page of the server.
pub(crate) struct ServerPage {
    pub(crate) status: u16,
    /// The `Server` header, with the key masked.
    pub(crate) server: Option<String>,
    /// As it came: the key has to be masked in what is shown of it.
    pub(crate) body: Vec<u8>,
}

/// Sends single requests. Threads share it; each waits for its own answer.
pub(crate) struct HttpClient {
    agent: Agent,
    endpoint: Endpoint,
    settings: ChatSettings,
    /// The [`Dialect`] of the server, as far as its refusals show.
    dialect: AtomicU32,
}

impl fmt::Debug for HttpClient {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("HttpClient")
            .field("endpoint", &self.endpoint)
            .field("settings", &self.settings)
            .finish_non_exhaustive()
    }
}

impl HttpClient {
    pub(crate) fn new(endpoint: Endpoint, settings: ChatSettings) -> Self {
        let tls = TlsConfig::builder()
            .provider(TlsProvider::Rustls)
            .root_certs(RootCerts::PlatformVerifier)
            .unversioned_rustls_crypto_provider(Arc::new(rustls::crypto::ring::default_provider()))
            .build();
        let mut config = Agent::config_builder();
        if endpoint.is_local() {
            // A proxy would look for the server on its own machine.
            config = config.proxy(None);
        }
        let agent = config
            .tls_config(tls)
            .http_status_as_error(false)
            // A redirected POST would become a GET without the key.
            .max_redirects(0)
            .max_idle_connections(IDLE_CONNECTIONS)
            .max_idle_connections_per_host(IDLE_CONNECTIONS)
            .user_agent(concat!("memtransfer/", env!("CARGO_PKG_VERSION")))
            .accept("application/json")
            .build()
            .new_agent();
        Self { agent, endpoint, settings, dialect: AtomicU32::new(Dialect::default().0) }
    }

    pub(crate) fn endpoint(&self) -> &Endpoint {
        &self.endpoint
    }

    /// The dialect of the server, as far as its refusals show.
    pub(crate) fn dialect(&self) -> Dialect {
        Dialect(self.dialect.load(Ordering::Relaxed))
    }

    /// Sends a request once and waits for the answer until `deadline` has passed. A server that refuses an optional
    /// field is asked again at once without it.
    pub(crate) fn attempt(
        &self,
        request: &ChatRequest,
        deadline: Duration,
    ) -> Result<ChatReply, AttemptError> {
        loop {
            let dialect = self.dialect();
            match self.send(dialect, request, deadline)? {
                SendOutcome::Reply(reply) => return Ok(*reply),
                // Each bit is set once, so this ends.
                SendOutcome::OtherDialect(dialect) => {
                    self.dialect.fetch_or(dialect.0, Ordering::Relaxed);
                }
            }
        }
    }

    fn send(
        &self,
        dialect: Dialect,
        request: &ChatRequest,
        deadline: Duration,
    ) -> Result<SendOutcome, AttemptError> {
        let body = serde_json::to_vec(&dialect.body(&self.settings.model, request));
        let body = body.map_err(|error| {
            AttemptError::Final(RequestError::Unserializable(error.to_string()))
        })?;
        let mut post =
            self.agent.post(self.endpoint.completions()).header(CONTENT_TYPE, "application/json");
        if let Some(authorization) = self.endpoint.authorization() {
            post = post.header(AUTHORIZATION, authorization.clone());
        }
        let post = post.config().timeout_global(Some(deadline)).build();
        let transient = |error| AttemptError::Transient(transient(error, deadline), None);
        let mut response = post.send(&body).map_err(transient)?;
        let answer = response.body_mut().with_config().limit(LARGEST_ANSWER).read_to_vec();
        let answer = answer.map_err(transient)?;
        match response.status().as_u16() {
            200..=299 => {
                self.read(&response, &answer).map(|reply| SendOutcome::Reply(Box::new(reply)))
            }
            status => {
                let message = String::from_utf8_lossy(&answer);
                match dialect.after(request, &message).filter(|_| matches!(status, 400 | 422)) {
                    Some((other, fields)) => {
                        let fields = fields.join(", ");
                        tracing::warn!("{} refuses {fields}: not sent again", self.endpoint);
                        Ok(SendOutcome::OtherDialect(other))
                    }
                    None => Err(self.refused(request, status, &response, &answer)),
                }
            }
        }
    }

    /// Fetches a page of the server, with the key, within `timeout`.
    pub(crate) fn get(&self, url: &str, timeout: Duration) -> Result<ServerPage, Transient> {
        let mut get = self.agent.get(url);
        if let Some(authorization) = self.endpoint.authorization() {
            get = get.header(AUTHORIZATION, authorization.clone());
        }
        let get = get.config().timeout_global(Some(timeout)).build();
        let failed = |error| transient(error, timeout);
        let mut response = get.call().map_err(failed)?;
        let body = response.body_mut().with_config().limit(LARGEST_ANSWER).read_to_vec();
        Ok(ServerPage {
            status: response.status().as_u16(),
            server: header(&response, SERVER).map(|server| self.endpoint.masked(server)),
            body: body.map_err(failed)?,
        })
    }

    /// The reply in a response with status 2xx. It is read as it came, since a key may be any word: only then are the
    /// texts in it masked.
    fn read<T>(&self, response: &Response<T>, answer: &[u8]) -> Result<ChatReply, AttemptError> {
        let media_type = header(response, CONTENT_TYPE).unwrap_or_default();
        // A missing content type is no reason to reject an answer that can be read.
        if !media_type.is_empty() && !media_type.to_ascii_lowercase().contains("json") {
            let media_type = media_type.split(';').next().unwrap_or_default();
            return Err(self.not_chat(format!("{}, not JSON", self.endpoint.masked(media_type))));
        }
        match reply::read(answer) {
            Ok(mut reply) => {
                reply.mask(|text| self.endpoint.masked(text));
                Ok(reply)
            }
            Err(UnusableReply { problem, code }) => {
                let message =
                    reply::error_message(problem.as_bytes(), |it| self.endpoint.masked(it));
                let failure = match code {
                    Some(status @ server::TOO_MANY_REQUESTS) => {
                        Transient::Status { status, message }
                    }
                    _ => Transient::Unreadable(message),
                };
                Err(AttemptError::Transient(failure, None))
            }
        }
    }

    /// The error for a status that is not 2xx.
    fn refused<T>(
        &self,
        request: &ChatRequest,
        status: u16,
        response: &Response<T>,
        answer: &[u8],
    ) -> AttemptError {
        if (300..=399).contains(&status) {
            let target = header(response, LOCATION).unwrap_or("nowhere");
            return self.not_chat(format!("a redirection to {}", self.endpoint.masked(target)));
        }
        let message = reply::error_message(answer, |text| self.endpoint.masked(text));
        if server::is_transient(status) {
            let pause = header(response, RETRY_AFTER).and_then(|value| {
                server::retry_after(value, header(response, DATE), SystemTime::now())
            });
            return match pause {
                Some(retry_after) if retry_after > server::LONGEST_RETRY_AFTER => {
                    AttemptError::Transient(Transient::Busy { status, message, retry_after }, None)
                }
                pause => AttemptError::Transient(Transient::Status { status, message }, pause),
            };
        }
        let advice = self.advice(status, request);
        let endpoint = self.endpoint.to_string();
        AttemptError::Final(RequestError::Refused { endpoint, status, message, advice })
    }

    fn not_chat(&self, what: String) -> AttemptError {
        AttemptError::Final(RequestError::NotChat { endpoint: self.endpoint.to_string(), what })
    }

    fn advice(&self, status: u16, request: &ChatRequest) -> String {
        let images = request.images();
        match status {
            401 | 403 if self.endpoint.authorization().is_none() => {
                "set OPENAI_API_KEY in the environment or in a .env file".to_owned()
            }
            401 | 403 => "check OPENAI_API_KEY".to_owned(),
            404 => "check the model's name and the base URL, which usually ends in /v1".to_owned(),
            _ if images > 0 => format!(
                "the request has {images} images: lower --image-budget, or raise the server's context or its bound on \
                 images"
            ),
            _ => {
                "check that the server knows the model and takes requests of this length".to_owned()
            }
        }
    }
}

fn transient(error: ureq::Error, deadline: Duration) -> Transient {
    match error {
        ureq::Error::Timeout(_) => Transient::Timeout(deadline),
        ureq::Error::BodyExceedsLimit(bytes) => {
            Transient::Unreadable(format!("it has more than {bytes} bytes"))
        }
        ureq::Error::HostNotFound | ureq::Error::ConnectionFailed => {
            Transient::Unreachable(error.to_string())
        }
        ureq::Error::Io(error) if never_connected(error.kind()) => {
            Transient::Unreachable(error.to_string())
        }
        error => Transient::Connection(error.to_string()),
    }
}

fn never_connected(kind: io::ErrorKind) -> bool {
    use io::ErrorKind::{ConnectionRefused, HostUnreachable, NetworkUnreachable};
    matches!(kind, ConnectionRefused | HostUnreachable | NetworkUnreachable)
}

fn header<T>(response: &Response<T>, name: HeaderName) -> Option<&str> {
    response.headers().get(name)?.to_str().ok()
}

/// A number from 0 to 1 that differs from call to call. It only decides on the length of pauses.
pub(crate) fn jitter(attempt: u32) -> f64 {
    RandomState::new().hash_one(attempt) as f64 / u64::MAX as f64
}

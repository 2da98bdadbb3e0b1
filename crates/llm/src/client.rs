//! The client: asks an endpoint a question, patiently.

use std::collections::hash_map::RandomState;
use std::fmt;
use std::hash::BuildHasher;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, SystemTime};

use ureq::Agent;
use ureq::http::Response;
use ureq::http::header::{AUTHORIZATION, CONTENT_TYPE, DATE, LOCATION, RETRY_AFTER, SERVER};
use ureq::tls::{RootCerts, TlsConfig, TlsProvider};

use super::endpoint::Endpoint;
use super::error::{ChatError, Failure, Passing};
use super::message::{Dialect, Question};
use super::reply::{self, Reply};
use super::retry;

/// Most bytes of an answer that are read.
const LARGEST_ANSWER: u64 = 16 << 20;

/// Most connections that are kept for the next request.
const IDLE_CONNECTIONS: usize = 256;

/// How a model is asked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// The model, by the name that the server knows it by.
    pub model: String,
    /// Longest that one attempt may take, from looking up the host to the last byte of the answer.
    pub timeout: Duration,
    /// How many times a request that failed for a passing reason is sent again.
    pub max_retries: u32,
}

/// What a server says that takes part in the conversation.
enum Heard {
    Reply(Box<Reply>),
    /// Not in this way, but in that one.
    Understands(Dialect),
}

/// A page of the server's, without the key wherever it stood in it.
pub(super) struct Page {
    pub(super) status: u16,
    /// What the server calls itself.
    pub(super) server: Option<String>,
    pub(super) body: String,
}

/// Asks one model of one endpoint. Threads may share it; each waits for its own answer.
pub struct Client {
    agent: Agent,
    endpoint: Endpoint,
    settings: Settings,
    /// The bits of the dialect that the server understands, as far as is known.
    dialect: AtomicU32,
    sleep: Box<dyn Fn(Duration) + Send + Sync>,
}

impl fmt::Debug for Client {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Client")
            .field("endpoint", &self.endpoint)
            .field("settings", &self.settings)
            .finish_non_exhaustive()
    }
}

impl Client {
    /// A client that has not connected yet.
    pub fn new(endpoint: Endpoint, settings: Settings) -> Self {
        Self::sleeping_with(endpoint, settings, std::thread::sleep)
    }

    /// A client that passes its pauses with `sleep`.
    fn sleeping_with(
        endpoint: Endpoint,
        settings: Settings,
        sleep: impl Fn(Duration) + Send + Sync + 'static,
    ) -> Self {
        let tls = TlsConfig::builder()
            .provider(TlsProvider::Rustls)
            .root_certs(RootCerts::PlatformVerifier)
            .unversioned_rustls_crypto_provider(Arc::new(rustls::crypto::ring::default_provider()))
            .build();
        let mut config = Agent::config_builder();
        if endpoint.is_here() {
            // A proxy from the environment is somewhere else, and would look for the server there.
            config = config.proxy(None);
        }
        let agent = config
            .tls_config(tls)
            .http_status_as_error(false)
            // A redirected POST would become a GET without the key.
            .max_redirects(0)
            .timeout_global(Some(settings.timeout))
            .max_idle_connections(IDLE_CONNECTIONS)
            .max_idle_connections_per_host(IDLE_CONNECTIONS)
            .user_agent(concat!("memtransfer/", env!("CARGO_PKG_VERSION")))
            .accept("application/json")
            .build()
            .new_agent();
        let dialect = AtomicU32::new(Dialect::default().0);
        Self { agent, endpoint, settings, dialect, sleep: Box::new(sleep) }
    }

    /// Who is asked, and how.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Where.
    pub fn endpoint(&self) -> &Endpoint {
        &self.endpoint
    }

    /// Asks, at temperature 0 and with reasoning off, and waits for the answer: at most
    /// `(max_retries + 1) * timeout` and the pauses between.
    ///
    /// # Errors
    /// When the server refuses the request, or fails for as long as anybody asks.
    pub fn ask(&self, question: &Question) -> Result<Reply, ChatError> {
        let mut attempts = 0;
        loop {
            let (last, wish) = match self.attempt(question) {
                Ok(reply) => return Ok(reply),
                Err(Failure::Final(error)) => return Err(error),
                Err(Failure::Passing(last, wish)) => (last, wish),
            };
            attempts += 1;
            if attempts > self.settings.max_retries || matches!(last, Passing::Busy { .. }) {
                return Err(self.gave_up(attempts, last));
            }
            let pause = retry::pause(attempts - 1, wish, jitter(attempts));
            tracing::warn!(
                "attempt {attempts} of {}: {last}; again in {:.1} s",
                self.settings.max_retries + 1,
                pause.as_secs_f64()
            );
            (self.sleep)(pause);
        }
    }

    /// The error of a question that was asked for the last time.
    pub(super) fn gave_up(&self, attempts: u32, last: Passing) -> ChatError {
        ChatError::GaveUp { endpoint: self.endpoint.to_string(), attempts, last }
    }

    /// Asks once, within the deadline. To be told that the server wants to be spoken to in another way is no
    /// failed attempt: it is asked again at once, in that way.
    pub(super) fn attempt(&self, question: &Question) -> Result<Reply, Failure> {
        loop {
            let dialect = Dialect(self.dialect.load(Ordering::Relaxed));
            match self.send(dialect, question)? {
                Heard::Reply(reply) => return Ok(*reply),
                // Each bit is set once, so this ends.
                Heard::Understands(dialect) => {
                    self.dialect.fetch_or(dialect.0, Ordering::Relaxed);
                }
            }
        }
    }

    fn send(&self, dialect: Dialect, question: &Question) -> Result<Heard, Failure> {
        let body = serde_json::to_vec(&dialect.body(&self.settings.model, question));
        let body = body.map_err(|error| Failure::Final(ChatError::Unsaid(error.to_string())))?;
        let mut request =
            self.agent.post(self.endpoint.completions()).header(CONTENT_TYPE, "application/json");
        if let Some(authorization) = self.endpoint.authorization() {
            request = request.header(AUTHORIZATION, authorization.clone());
        }
        let passing = |error| Failure::Passing(self.passing(error), None);
        let mut response = request.send(&body).map_err(passing)?;
        // An answer may be long in coming.
        drop(body);
        let answer = response
            .body_mut()
            .with_config()
            .limit(LARGEST_ANSWER)
            .read_to_vec()
            .map_err(passing)?;
        // Nothing that is made of an answer can hold the key, should the server repeat it.
        let answer = self.endpoint.masked(&String::from_utf8_lossy(&answer)).into_bytes();
        match response.status().as_u16() {
            200..=299 => self.read(&response, &answer).map(|reply| Heard::Reply(Box::new(reply))),
            status => self.refused(dialect, status, &response, &answer).map(Heard::Understands),
        }
    }

    /// Fetches a page of the server's, with the key and within `timeout`.
    pub(super) fn get(&self, url: &str, timeout: Duration) -> Result<Page, Passing> {
        let timeout = timeout.min(self.settings.timeout);
        let mut request = self.agent.get(url);
        if let Some(authorization) = self.endpoint.authorization() {
            request = request.header(AUTHORIZATION, authorization.clone());
        }
        let request = request.config().timeout_global(Some(timeout)).build();
        let passing = |error| match self.passing(error) {
            Passing::Timeout(_) => Passing::Timeout(timeout),
            other => other,
        };
        let mut response = request.call().map_err(passing)?;
        let body = response.body_mut().with_config().limit(LARGEST_ANSWER).read_to_vec();
        Ok(Page {
            status: response.status().as_u16(),
            server: header(&response, SERVER).map(|server| self.endpoint.masked(server)),
            body: self.endpoint.masked(&String::from_utf8_lossy(&body.map_err(passing)?)),
        })
    }

    fn read<T>(&self, response: &Response<T>, answer: &[u8]) -> Result<Reply, Failure> {
        let media_type = header(response, CONTENT_TYPE).unwrap_or_default();
        // One that is missing is not held against a server whose answer can be read.
        if !media_type.is_empty() && !media_type.to_ascii_lowercase().contains("json") {
            let media_type = media_type.split(';').next().unwrap_or_default();
            return Err(self.not_chat(format!("{}, not JSON", self.endpoint.masked(media_type))));
        }
        reply::read(answer).map_err(|problem| {
            Failure::Passing(Passing::Unreadable(self.endpoint.masked(&problem)), None)
        })
    }

    /// What the server would understand, or why it does not answer.
    fn refused<T>(
        &self,
        dialect: Dialect,
        status: u16,
        response: &Response<T>,
        answer: &[u8],
    ) -> Result<Dialect, Failure> {
        if (300..=399).contains(&status) {
            let target = header(response, LOCATION).unwrap_or("nowhere");
            return Err(self.not_chat(format!("a redirection to {}", self.endpoint.masked(target))));
        }
        let message = self.endpoint.masked(&reply::error_message(answer));
        if retry::is_passing(status) {
            let wish = header(response, RETRY_AFTER).and_then(|retry_after| {
                retry::wish(retry_after, header(response, DATE), SystemTime::now())
            });
            return Err(match wish {
                Some(wish) if wish > retry::LONGEST_WISH => {
                    Failure::Passing(Passing::Busy { status, message, wish }, None)
                }
                wish => Failure::Passing(Passing::Status { status, message }, wish),
            });
        }
        if matches!(status, 400 | 422)
            && let Some((understood, fields)) = dialect.after(&String::from_utf8_lossy(answer))
        {
            tracing::warn!(
                "{} refuses {}, which is left out or said in another way from now on: {message}",
                self.endpoint,
                fields.join(", ")
            );
            return Ok(understood);
        }
        Err(Failure::Final(ChatError::Refused {
            endpoint: self.endpoint.to_string(),
            status,
            message,
            advice: self.advice(status),
        }))
    }

    fn not_chat(&self, what: String) -> Failure {
        Failure::Final(ChatError::NotChat { endpoint: self.endpoint.to_string(), what })
    }

    pub(super) fn passing(&self, error: ureq::Error) -> Passing {
        match error {
            ureq::Error::Timeout(_) => Passing::Timeout(self.settings.timeout),
            ureq::Error::BodyExceedsLimit(bytes) => {
                Passing::Unreadable(format!("it has more than {bytes} bytes"))
            }
            ureq::Error::HostNotFound | ureq::Error::ConnectionFailed => {
                Passing::Unreachable(error.to_string())
            }
            ureq::Error::Io(error) if never_connected(error.kind()) => {
                Passing::Unreachable(error.to_string())
            }
            error => Passing::Connection(error.to_string()),
        }
    }

    fn advice(&self, status: u16) -> &'static str {
        match status {
            401 | 403 if self.endpoint.authorization().is_none() => {
                "set OPENAI_API_KEY in the environment or in a .env file"
            }
            401 | 403 => "check OPENAI_API_KEY",
            404 => "check the model's name and the base URL, which usually ends in /v1",
            413 => "ask for less at once",
            _ => "see whether the server knows the model and takes requests of this length",
        }
    }
}

fn header<T>(response: &Response<T>, name: ureq::http::HeaderName) -> Option<&str> {
    response.headers().get(name)?.to_str().ok()
}

fn never_connected(kind: io::ErrorKind) -> bool {
    use io::ErrorKind::{ConnectionRefused, HostUnreachable, NetworkUnreachable};
    matches!(kind, ConnectionRefused | HostUnreachable | NetworkUnreachable)
}

/// A number from 0 to 1 that differs from call to call. Nothing but the length of a pause depends on it.
pub(super) fn jitter(attempt: u32) -> f64 {
    RandomState::new().hash_one(attempt) as f64 / u64::MAX as f64
}

#[cfg(test)]
mod tests;

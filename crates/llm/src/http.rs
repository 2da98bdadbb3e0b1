//! Single attempts over HTTP.

use std::collections::hash_map::RandomState;
use std::fmt;
use std::hash::BuildHasher;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, SystemTime};

use ureq::Agent;
use ureq::http::header::{CONTENT_ENCODING, CONTENT_TYPE, DATE, LOCATION, RETRY_AFTER, SERVER};
use ureq::http::{HeaderName, Response};
use ureq::tls::{RootCerts, TlsConfig, TlsProvider};
use ureq::{Body, Proxy};

use crate::body::{self, LARGEST_ANSWER};
use crate::endpoint::Endpoint;
use crate::error::{AttemptError, RequestError, Transient};
use crate::proxy;
use crate::refusal::Refusal;
use crate::reply::{self, ChatReply, UnusableReply};
use crate::request::{ChatRequest, Dialect};
use crate::server;
use crate::settings::ChatSettings;

/// Maximum number of connections that are kept open for later requests.
const IDLE_CONNECTIONS: usize = 256;

/// The outcome of sending a request in one dialect.
pub(crate) enum SendOutcome {
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
    /// Why no request can be sent.
    problem: Option<String>,
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
        // A proxy would look for a local server on its own machine.
        let proxy = match endpoint.is_local() {
            true => None,
            false => proxy::of(endpoint.completions(), |name| std::env::var(name).ok()),
        };
        let proxy = proxy.map(|(name, url)| {
            // The URL may hold a password.
            Proxy::new(&url).map_err(|_| format!("{name} is no URL of an HTTP proxy"))
        });
        let (proxy, problem) = match proxy {
            None => (None, None),
            Some(Ok(proxy)) => (Some(proxy), None),
            Some(Err(problem)) => (None, Some(problem)),
        };
        let agent = Agent::config_builder()
            .proxy(proxy)
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
        let dialect = AtomicU32::new(Dialect::default().0);
        Self { agent, endpoint, settings, problem, dialect }
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
            match self.send(self.dialect(), request, deadline)? {
                SendOutcome::Reply(reply) => return Ok(*reply),
                // Each bit is set once, so this ends.
                SendOutcome::OtherDialect(dialect) => {
                    let before = self.dialect.fetch_or(dialect.0, Ordering::Relaxed);
                    let refused = Dialect(dialect.0 & !before).refused();
                    if !refused.is_empty() {
                        let fields = refused.join(", ");
                        tracing::warn!("{} refuses {fields}: not sent again", self.endpoint);
                    }
                }
            }
        }
    }

    /// Sends a request once in this dialect.
    pub(crate) fn send(
        &self,
        dialect: Dialect,
        request: &ChatRequest,
        deadline: Duration,
    ) -> Result<SendOutcome, AttemptError> {
        let sent = serde_json::to_vec(&dialect.body(&self.settings, request));
        let sent = sent.map_err(|error| {
            AttemptError::Final(RequestError::Unserializable(error.to_string()))
        })?;
        if let Some(problem) = &self.problem {
            return Err(self.out_of_reach(problem.clone()));
        }
        let mut post =
            self.agent.post(self.endpoint.completions()).header(CONTENT_TYPE, "application/json");
        for (name, value) in self.endpoint.headers() {
            post = post.header(name, value);
        }
        let post = post.config().timeout_global(Some(deadline)).build();
        let failed = |error| self.failed(error, deadline);
        let mut response = post.send(&sent).map_err(failed)?;
        let answer = read_body(&mut response).map_err(failed)?;
        let status = response.status().as_u16();
        if let 200..=299 = status {
            let reply = match answer {
                Ok(answer) => self.read(request, sent.len(), &response, &answer)?,
                Err(problem) => {
                    return Err(AttemptError::Transient(Transient::Unreadable(problem), None));
                }
            };
            return Ok(SendOutcome::Reply(Box::new(reply)));
        }
        let answer = answer.unwrap_or_default();
        let refusal = Refusal::new(status, &answer);
        let other = dialect.after(&self.settings.options, request, &refusal);
        match other.filter(|_| matches!(status, 400 | 422)) {
            Some(other) => Ok(SendOutcome::OtherDialect(other)),
            None => Err(self.refused(request, sent.len(), &refusal, &response, &answer)),
        }
    }

    /// What a failure without a response means.
    fn failed(&self, error: ureq::Error, deadline: Duration) -> AttemptError {
        match problem_of_the_way(&error.to_string()) {
            Some(problem) => self.out_of_reach(problem),
            None => AttemptError::Transient(transient(error, deadline), None),
        }
    }

    fn out_of_reach(&self, problem: String) -> AttemptError {
        let endpoint = self.endpoint.to_string();
        AttemptError::Final(RequestError::OutOfReach { endpoint, problem })
    }

    /// Fetches a page of the server, with the key, within `timeout`.
    pub(crate) fn get(&self, url: &str, timeout: Duration) -> Result<ServerPage, AttemptError> {
        if let Some(problem) = &self.problem {
            return Err(self.out_of_reach(problem.clone()));
        }
        let mut get = self.agent.get(url);
        for (name, value) in self.endpoint.headers() {
            get = get.header(name, value);
        }
        let get = get.config().timeout_global(Some(timeout)).build();
        let failed = |error| self.failed(error, timeout);
        let mut response = get.call().map_err(failed)?;
        let body = read_body(&mut response).map_err(failed)?;
        Ok(ServerPage {
            status: response.status().as_u16(),
            server: header(&response, SERVER).map(|server| self.endpoint.masked(server)),
            body: body.unwrap_or_default(),
        })
    }

    /// The reply in a response with status 2xx. It is read as it came, since a key may be any word: only then are the
    /// texts in it masked. Its content type says nothing: some proxies give another one.
    fn read<T>(
        &self,
        request: &ChatRequest,
        bytes: usize,
        response: &Response<T>,
        answer: &[u8],
    ) -> Result<ChatReply, AttemptError> {
        let UnusableReply { problem, code, is_reported } = match reply::read(answer) {
            Ok(mut reply) => {
                reply.mask(|text| self.endpoint.masked(text));
                return Ok(reply);
            }
            Err(unusable) => unusable,
        };
        let media_type = header(response, CONTENT_TYPE).unwrap_or_default();
        if body::is_page(answer) || media_type.to_ascii_lowercase().contains("html") {
            let page = reply::error_message(answer, |text| self.endpoint.masked(text));
            return Err(self.not_chat(format!("a web page: {page}")));
        }
        let message = reply::error_message(problem.as_bytes(), |it| self.endpoint.masked(it));
        let refusal = Refusal::new(code.unwrap_or(500), answer);
        if is_reported && refusal.is_final() {
            let message = message.trim_start_matches(reply::REPORTED).to_owned();
            return Err(self.end(request, bytes, &refusal, message));
        }
        let failure = match code {
            Some(status @ server::TOO_MANY_REQUESTS) => Transient::Status { status, message },
            _ => Transient::Unreadable(message),
        };
        Err(AttemptError::Transient(failure, None))
    }

    /// The error for a status that is not 2xx.
    fn refused<T>(
        &self,
        request: &ChatRequest,
        bytes: usize,
        refusal: &Refusal<'_>,
        response: &Response<T>,
        answer: &[u8],
    ) -> AttemptError {
        let status = refusal.status;
        if (300..=399).contains(&status) {
            let target = header(response, LOCATION).unwrap_or("nowhere");
            return self.not_chat(format!("a redirection to {}", self.endpoint.masked(target)));
        }
        let message = reply::error_message(answer, |text| self.endpoint.masked(text));
        if refusal.is_final() {
            return self.end(request, bytes, refusal, message);
        }
        let pause = header(response, RETRY_AFTER).and_then(|value| {
            server::retry_after(value, header(response, DATE), SystemTime::now())
        });
        match pause {
            Some(retry_after) if retry_after > server::LONGEST_RETRY_AFTER => {
                AttemptError::Transient(Transient::Busy { status, message, retry_after }, None)
            }
            pause => AttemptError::Transient(Transient::Status { status, message }, pause),
        }
    }

    /// The error for a refusal that another attempt does not change.
    fn end(
        &self,
        request: &ChatRequest,
        bytes: usize,
        refusal: &Refusal<'_>,
        message: String,
    ) -> AttemptError {
        AttemptError::Final(RequestError::Refused {
            endpoint: self.endpoint.to_string(),
            status: refusal.status,
            message: message.trim_end_matches('.').to_owned(),
            advice: refusal.advice(request, bytes, self.endpoint.has_key()),
            permanent: refusal.is_permanent(),
        })
    }

    fn not_chat(&self, what: String) -> AttemptError {
        AttemptError::Final(RequestError::NotChat { endpoint: self.endpoint.to_string(), what })
    }
}

/// The body of a response without its compression, or what is wrong with it.
fn read_body(response: &mut Response<Body>) -> Result<Result<Vec<u8>, String>, ureq::Error> {
    let bytes = response.body_mut().with_config().limit(LARGEST_ANSWER).read_to_vec()?;
    Ok(body::decompressed(bytes, header(response, CONTENT_ENCODING).unwrap_or_default()))
}

/// Why a failure without a response, in the words of ureq and rustls, meets every other request too, and what to do. `None`
/// where another attempt may succeed.
fn problem_of_the_way(text: &str) -> Option<String> {
    if text.contains("certificate") {
        let advice = match text {
            _ if text.contains("CaUsedAsEndEntity") => {
                "it is that of an authority, which SSL_CERT_FILE does not help: let it sign one for the server, or make a \
                 self-signed one with -addext basicConstraints=critical,CA:FALSE"
            }
            _ if text.contains("not valid for name") => {
                "use one of the names that it is valid for in the base URL"
            }
            _ if text.contains("xpired") => "check its dates and the clock of this machine",
            _ => {
                "add the authority that signed it to those of the system, or name its file in SSL_CERT_FILE"
            }
        };
        return Some(format!("its certificate is not trusted ({text}): {advice}"));
    }
    if text.contains("InvalidContentType") {
        return Some("it does not use TLS: try http://".to_owned());
    }
    let status = text.split_once("CONNECT proxy failed: proxy server responded ")?.1.get(..3)?;
    let advice = match status {
        "407" => "give the name and password in the URL of the proxy",
        status if status.starts_with('4') => {
            "let the proxy pass CONNECT to this host and port, or name the host in NO_PROXY"
        }
        _ => return None,
    };
    Some(format!("the proxy refuses to connect to it with status {status}: {advice}"))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_fits_what_is_wrong_on_the_way() {
        for (text, expected) in [
            ("io: invalid peer certificate: UnknownIssuer", "name its file in SSL_CERT_FILE"),
            (
                "io: invalid peer certificate: Other(OtherError(CaUsedAsEndEntity))",
                "self-signed one with -addext basicConstraints=critical,CA:FALSE",
            ),
            (
                "io: invalid peer certificate: certificate not valid for name \"vm\"; certificate is only valid for DnsName(\"a\")",
                "use one of the names",
            ),
            ("io: invalid peer certificate: Expired", "check its dates"),
            ("io: received corrupt message of type InvalidContentType", "try http://"),
            (
                "CONNECT proxy failed: proxy server responded 403/403",
                "with status 403: let the proxy pass CONNECT to this host and port",
            ),
            (
                "CONNECT proxy failed: proxy server responded 407/407",
                "name and password in the URL",
            ),
        ] {
            let problem = problem_of_the_way(text).unwrap();
            assert!(problem.contains(expected), "{problem}");
        }
        for text in
            ["io: Connection refused", "CONNECT proxy failed: proxy server responded 502/502"]
        {
            assert_eq!(problem_of_the_way(text), None);
        }
    }
}

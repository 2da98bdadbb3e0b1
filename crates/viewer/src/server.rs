//! A site over HTTP: on the loopback interface without, elsewhere with a token.

use std::cell::RefCell;
use std::convert::Infallible;
use std::fs::File as SystemFile;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::rc::Rc;
use std::str::FromStr;
use std::time::Duration;

use anyhow::{Context, Result};
use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{self, HeaderName, HeaderValue};
use hyper::http::uri::Authority;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use rustix::io::Errno;
use tokio::runtime;
use tokio::task::{LocalSet, spawn_local};

use crate::file::File;
use crate::site::Site;

/// How long a connection may be open without a request.
const IDLE: Duration = Duration::from_secs(60);

/// How long the server waits when it has as many connections as it can have.
const PAUSE: Duration = Duration::from_millis(100);

/// Where a server listens.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Address(SocketAddr);

impl Default for Address {
    /// A free port of the loopback interface.
    fn default() -> Self {
        Self(SocketAddr::from(([127, 0, 0, 1], 0)))
    }
}

impl FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = text.parse().or_else(|_| Ok(SocketAddr::new(text.parse::<IpAddr>()?, 0)));
        parsed.map(Self).map_err(|_: std::net::AddrParseError| {
            "expected an address and a port, for example 127.0.0.1:8080 or 0.0.0.0:8080".to_owned()
        })
    }
}

/// A server that listens, and serves nothing yet.
pub struct ViewServer {
    listener: TcpListener,
    address: SocketAddr,
    /// What a client must know, if the server listens beyond this machine.
    token: Option<String>,
}

impl std::fmt::Debug for ViewServer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Server").field("address", &self.address).finish_non_exhaustive()
    }
}

impl ViewServer {
    /// Listens at `address`.
    ///
    /// # Errors
    /// When the address is in use or not this machine's.
    pub fn listen(address: Address) -> Result<Self> {
        let Address(wanted) = address;
        let listener =
            TcpListener::bind(wanted).with_context(|| format!("cannot listen at {wanted}"))?;
        listener.set_nonblocking(true).context("cannot listen")?;
        let address = listener.local_addr().context("a server without an address")?;
        let token = if wanted.ip().is_loopback() { None } else { Some(random_token()?) };
        Ok(Self { listener, address, token })
    }

    /// The address to open in a browser.
    pub fn url(&self) -> String {
        let query = self.token.as_ref().map(|token| format!("?token={token}"));
        let host = match self.address.ip().is_unspecified() {
            // Other machines reach this one under its name.
            true => format!("{}:{}", host_name(), self.address.port()),
            false => self.address.to_string(),
        };
        format!("http://{host}/{}", query.unwrap_or_default())
    }

    /// Answers requests, one at a time, until the process ends.
    ///
    /// # Errors
    /// When no connection can be accepted.
    pub fn serve(self, site: Site) -> Result<()> {
        let runtime = runtime::Builder::new_current_thread().enable_io().enable_time().build();
        let runtime = runtime.context("cannot serve")?;
        LocalSet::new().block_on(&runtime, self.accept(site)).context("cannot accept a connection")
    }

    async fn accept(self, site: Site) -> std::io::Result<()> {
        let listener = tokio::net::TcpListener::from_std(self.listener)?;
        let answers = Rc::new(SiteService {
            address: self.address,
            token: self.token,
            site: RefCell::new(site),
        });
        loop {
            let stream = match listener.accept().await {
                Ok((stream, _)) => stream,
                Err(error) if error.kind() == ErrorKind::ConnectionAborted => continue,
                // Too many connections: some will end.
                Err(error)
                    if matches!(
                        Errno::from_io_error(&error),
                        Some(Errno::MFILE | Errno::NFILE)
                    ) =>
                {
                    tokio::time::sleep(PAUSE).await;
                    continue;
                }
                Err(error) => return Err(error),
            };
            let answers = Rc::clone(&answers);
            spawn_local(async move {
                let answer = service_fn(|request| {
                    let answer = answers.answer(&request);
                    async { Ok::<_, Infallible>(answer) }
                });
                // A client that has gone needs no answer.
                let mut server = http1::Builder::new();
                server.timer(TokioTimer::new()).header_read_timeout(IDLE);
                let _ = server.serve_connection(TokioIo::new(stream), answer).await;
            });
        }
    }
}

type HttpResponse = Response<Full<Bytes>>;

/// What is answered to whom.
struct SiteService {
    address: SocketAddr,
    token: Option<String>,
    site: RefCell<Site>,
}

/// The name of this machine.
fn host_name() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}

impl SiteService {
    fn answer(&self, request: &Request<Incoming>) -> HttpResponse {
        if !matches!(*request.method(), Method::GET | Method::HEAD) {
            return status(StatusCode::METHOD_NOT_ALLOWED, "only GET is answered");
        }
        let url = request.uri().path_and_query().map_or("", |url| url.as_str());
        let path = url.trim_start_matches('/');
        match &self.token {
            // Another site's page may reach a loopback server under a name of its own.
            None if !is_loopback(text(request, &header::HOST)) => {
                return status(
                    StatusCode::FORBIDDEN,
                    "this server is for this machine only: it answers under localhost and loopback addresses, under any port; \
                     `memtransfer view RUN --serve 0.0.0.0:8080` serves other machines",
                );
            }
            Some(token) => {
                if path.strip_prefix("?token=").is_some_and(|given| is_same(given, token)) {
                    let cookie = self.cookie_name();
                    let cookie = format!("{cookie}={token}; HttpOnly; SameSite=Strict; Path=/");
                    let headers = [(header::SET_COOKIE, cookie.as_str()), (header::LOCATION, "/")];
                    return answer(StatusCode::SEE_OTHER, Vec::new(), &headers);
                }
                let (cookies, name) = (text(request, &header::COOKIE), self.cookie_name());
                let given =
                    cookies.split("; ").find_map(|one| one.strip_prefix(&name)?.strip_prefix('='));
                if !given.is_some_and(|given| is_same(given, token)) {
                    return status(
                        StatusCode::FORBIDDEN,
                        "open the address that `memtransfer view` printed: it has the token",
                    );
                }
            }
            None => {}
        }
        match self.site.borrow_mut().file(path) {
            Ok(Some(file)) => page(path, file),
            Ok(None) => status(StatusCode::NOT_FOUND, "there is no such file"),
            Err(error) => {
                // The terminal may be closed.
                let _ = writeln!(io::stderr(), "memtransfer: {path}: {error:#}");
                status(StatusCode::INTERNAL_SERVER_ERROR, &format!("{error:#}"))
            }
        }
    }

    /// The name of the cookie with the token. A browser sends a cookie to all ports of a host, so the name has the port.
    fn cookie_name(&self) -> String {
        format!("memtransfer-token-{}", self.address.port())
    }
}

/// Whether `host`, as a client writes it, is localhost or an address of the loopback interface. The port may be another one
/// than the server's: `ssh -L` and `kubectl port-forward` choose it. No other site has such a name.
fn is_loopback(host: &str) -> bool {
    let Ok(authority) = host.parse::<Authority>() else { return false };
    let name = authority.host();
    let address = name.trim_start_matches('[').trim_end_matches(']').parse::<IpAddr>();
    name.eq_ignore_ascii_case("localhost") || address.is_ok_and(|address| address.is_loopback())
}

/// The rules for what a page may load: only from this server. The report has its style inside.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
                      frame-src 'self'; frame-ancestors 'self'; base-uri 'none'; form-action 'none'";
const REPORT_POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'self'; \
                             base-uri 'none'; form-action 'none'";

fn page(path: &str, file: File) -> HttpResponse {
    let policy = if path.ends_with("report.html") { REPORT_POLICY } else { POLICY };
    let cache = if path.contains("/views/") { "max-age=3600" } else { "no-store" };
    let headers = [
        (header::CONTENT_TYPE, file.kind),
        (header::CONTENT_SECURITY_POLICY, policy),
        (header::CACHE_CONTROL, cache),
    ];
    answer(StatusCode::OK, file.bytes, &headers)
}

fn status(code: StatusCode, text: &str) -> HttpResponse {
    let headers = [
        (header::CONTENT_TYPE, "text/plain; charset=utf-8"),
        (header::CONTENT_SECURITY_POLICY, "default-src 'none'"),
    ];
    answer(code, format!("{text}\n").into_bytes(), &headers)
}

fn answer(code: StatusCode, content: Vec<u8>, headers: &[(HeaderName, &str)]) -> HttpResponse {
    let always = [
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ];
    let mut answer = Response::new(Full::from(content));
    *answer.status_mut() = code;
    for (name, value) in headers.iter().chain(&always) {
        if let Ok(value) = HeaderValue::from_str(value) {
            answer.headers_mut().insert(name, value);
        }
    }
    answer
}

/// The value of a header; empty if there is none.
fn text<'a>(request: &'a Request<Incoming>, name: &HeaderName) -> &'a str {
    request.headers().get(name).and_then(|value| value.to_str().ok()).unwrap_or_default()
}

/// Compares in a time that does not depend on where the texts differ.
fn is_same(one: &str, other: &str) -> bool {
    let differing = one.bytes().zip(other.bytes()).fold(0, |found, (a, b)| found | (a ^ b));
    one.len() == other.len() && differing == 0
}

/// 16 random bytes as hexadecimal digits.
fn random_token() -> Result<String> {
    let mut bytes = [0; 16];
    let mut source = SystemFile::open("/dev/urandom").context("cannot open /dev/urandom")?;
    source.read_exact(&mut bytes).context("cannot read /dev/urandom")?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loopback_names_are_answered_under_any_port_and_others_under_none() {
        for host in [
            "localhost",
            "LOCALHOST:9000",
            "localhost:80",
            "127.0.0.1",
            "127.0.0.1:8080",
            "127.0.0.2:1",
            "[::1]",
            "[::1]:9000",
        ] {
            assert!(is_loopback(host), "{host}");
        }
        for host in [
            "",
            "example.org",
            "localhost.example.org:9000",
            "127.0.0.1.example.org",
            "localhost@example.org",
            "127.0.0.1@example.org:8080",
            "0.0.0.0:8080",
            "192.168.0.1:8080",
            "[::]:8080",
            "localhost, example.org",
        ] {
            assert!(!is_loopback(host), "{host}");
        }
    }
}

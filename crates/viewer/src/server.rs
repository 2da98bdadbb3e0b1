//! A site over HTTP: on the loopback interface without, elsewhere with a token.

use std::fs::File as SystemFile;
use std::io::Read;
use std::net::{IpAddr, SocketAddr};
use std::str::FromStr;

use anyhow::{Context, Result, anyhow};
use tiny_http::{Header, Method, Request, Response};

use crate::site::{File, Site};

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
pub struct Server {
    http: tiny_http::Server,
    address: SocketAddr,
    /// What a client must know, if the server listens beyond this machine.
    token: Option<String>,
}

impl std::fmt::Debug for Server {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Server").field("address", &self.address).finish_non_exhaustive()
    }
}

/// The name of the cookie with the token.
const COOKIE: &str = "memtransfer-token";

impl Server {
    /// Listens at `address`.
    ///
    /// # Errors
    /// When the address is in use or not this machine's.
    pub fn listen(address: Address) -> Result<Self> {
        let Address(wanted) = address;
        let http = tiny_http::Server::http(wanted)
            .map_err(|error| anyhow!("cannot listen at {wanted}: {error}"))?;
        let address = http.server_addr().to_ip().context("a server without an address")?;
        let token = if wanted.ip().is_loopback() { None } else { Some(random_token()?) };
        Ok(Self { http, address, token })
    }

    /// The address to open in a browser.
    pub fn url(&self) -> String {
        let query = self.token.as_ref().map(|token| format!("?token={token}"));
        format!("http://{}/{}", self.address, query.unwrap_or_default())
    }

    /// Answers requests until the process ends.
    pub fn serve(self, site: &mut Site) {
        for request in self.http.incoming_requests() {
            let response = self.answer(site, &request);
            // A client that has gone needs no answer.
            let _ = request.respond(response);
        }
    }

    fn answer(&self, site: &mut Site, request: &Request) -> Response<std::io::Cursor<Vec<u8>>> {
        if !matches!(request.method(), Method::Get | Method::Head) {
            return status(405, "only GET is answered");
        }
        let path = request.url().trim_start_matches('/');
        match &self.token {
            // Another site's page may reach a loopback server under a name of its own: only ours is answered.
            None if !self.is_own_name(request) => {
                return status(403, "this server is for this machine only");
            }
            Some(token) => {
                if path.strip_prefix("?token=").is_some_and(|given| is_same(given, token)) {
                    let cookie = format!("{COOKIE}={token}; HttpOnly; SameSite=Strict; Path=/");
                    return headed(
                        Response::from_data(Vec::new()).with_status_code(303),
                        &[("Set-Cookie", &cookie), ("Location", "/")],
                    );
                }
                let cookies = header(request, "Cookie").unwrap_or_default();
                let given =
                    cookies.split("; ").find_map(|one| one.strip_prefix(COOKIE)?.strip_prefix('='));
                if !given.is_some_and(|given| is_same(given, token)) {
                    return status(
                        403,
                        "open the address that `memtransfer view` printed: it has the token",
                    );
                }
            }
            None => {}
        }
        match site.file(path) {
            Ok(Some(file)) => page(path, file),
            Ok(None) => status(404, "there is no such file"),
            Err(error) => {
                eprintln!("memtransfer: {path}: {error:#}");
                status(500, &format!("{error:#}"))
            }
        }
    }

    fn is_own_name(&self, request: &Request) -> bool {
        let port = self.address.port();
        let own = [self.address.to_string(), format!("localhost:{port}")];
        header(request, "Host").is_some_and(|host| own.contains(&host))
    }
}

/// The rules for what a page may load: only from this server. The report has its style inside.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
                      frame-src 'self'; frame-ancestors 'self'; base-uri 'none'; form-action 'none'";
const REPORT_POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'self'; \
                             base-uri 'none'; form-action 'none'";

fn page(path: &str, file: File) -> Response<std::io::Cursor<Vec<u8>>> {
    let policy = if path.ends_with("report.html") { REPORT_POLICY } else { POLICY };
    let cache = if path.contains("/views/") { "max-age=3600" } else { "no-store" };
    headed(
        Response::from_data(file.bytes),
        &[
            ("Content-Type", file.kind),
            ("Content-Security-Policy", policy),
            ("Cache-Control", cache),
        ],
    )
}

fn status(code: u16, text: &str) -> Response<std::io::Cursor<Vec<u8>>> {
    let response = Response::from_data(format!("{text}\n")).with_status_code(code);
    headed(
        response,
        &[
            ("Content-Type", "text/plain; charset=utf-8"),
            ("Content-Security-Policy", "default-src 'none'"),
        ],
    )
}

fn headed(
    mut response: Response<std::io::Cursor<Vec<u8>>>,
    headers: &[(&str, &str)],
) -> Response<std::io::Cursor<Vec<u8>>> {
    let always = [
        ("X-Content-Type-Options", "nosniff"),
        ("Referrer-Policy", "no-referrer"),
        ("Cross-Origin-Resource-Policy", "same-origin"),
    ];
    for (name, value) in headers.iter().chain(&always) {
        if let Ok(header) = Header::from_bytes(name.as_bytes(), value.as_bytes()) {
            response.add_header(header);
        }
    }
    response
}

fn header(request: &Request, name: &'static str) -> Option<String> {
    let found = request.headers().iter().find(|header| header.field.equiv(name));
    found.map(|header| header.value.as_str().to_owned())
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

//! The address of a chat server and its key: from a flag, the environment or a `.env` file.

use std::fmt;
use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};

use ureq::http::Uri;
use ureq::http::header::HeaderValue;

use crate::api_key::ApiKey;

/// Variables that hold the base URL; the first one set wins.
pub const BASE_URL_VARIABLES: [&str; 2] = ["OPENAI_BASE_URL", "OPENAI_API_BASE"];

/// The variable that holds the key.
pub const KEY_VARIABLE: &str = "OPENAI_API_KEY";

/// The file in the working folder that supplies variables missing from the environment.
pub const ENV_FILE: &str = ".env";

/// The path of chat completions below the base URL.
const COMPLETIONS: &str = "/chat/completions";

/// The address of a server with OpenAI's chat completions interface.
#[derive(Debug, Clone)]
pub struct Endpoint {
    completions: Uri,
    authorization: Option<HeaderValue>,
    key: Option<ApiKey>,
}

/// Why no endpoint can be used.
#[derive(Debug, thiserror::Error)]
pub enum EndpointError {
    /// No base URL is given.
    #[error(
        "no chat endpoint is given: pass --base-url or set OPENAI_BASE_URL, for example to http://localhost:8000/v1"
    )]
    NoBaseUrl,
    /// The base URL cannot be used. It is not repeated, since it may hold a password.
    #[error(
        "the base URL {problem}: it should look like http://localhost:8000/v1 or https://api.openai.com/v1"
    )]
    BaseUrl {
        /// What is wrong with it.
        problem: &'static str,
    },
    /// The key cannot be sent in a header.
    #[error("OPENAI_API_KEY holds a character that a header cannot carry: set it again")]
    Key,
    /// The `.env` file cannot be read. Its lines are never shown: one may hold the key.
    #[error("cannot read {}: {problem}", path.display())]
    EnvFile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
}

impl Endpoint {
    /// The endpoint at `base_url`, which usually ends in `/v1`; a trailing slash is ignored.
    ///
    /// # Errors
    /// When the URL is not absolute, is not HTTP, or holds credentials, a query or a fragment; when `key` cannot be
    /// sent in a header.
    pub fn new(base_url: &str, key: Option<ApiKey>) -> Result<Self, EndpointError> {
        let wrong = |problem| EndpointError::BaseUrl { problem };
        let base = base_url.trim().trim_end_matches('/');
        let completions: Uri =
            format!("{base}{COMPLETIONS}").parse().map_err(|_| wrong("is no URL"))?;
        if !matches!(completions.scheme_str(), Some("http" | "https")) {
            return Err(wrong("does not begin with http:// or https://"));
        }
        let authority = completions.authority().ok_or_else(|| wrong("names no host"))?;
        if authority.as_str().contains('@') {
            return Err(wrong("holds a name or password: the key goes into OPENAI_API_KEY"));
        }
        if base.contains(['?', '#']) {
            return Err(wrong("holds a query or a fragment"));
        }
        let authorization = match &key {
            None => None,
            Some(key) => {
                let mut value = HeaderValue::try_from(format!("Bearer {}", key.expose()))
                    .map_err(|_| EndpointError::Key)?;
                value.set_sensitive(true);
                Some(value)
            }
        };
        Ok(Self { completions, authorization, key })
    }

    /// The endpoints at `base_url`, else at the URL in the environment, else at the URL in `folder/.env`; the key is
    /// looked up in the same order. A blank variable counts as not set. Several URLs are separated by commas; they share
    /// the key.
    ///
    /// # Errors
    /// When none of them names a base URL, or a value cannot be used.
    pub fn from_environment(
        base_url: Option<&str>,
        folder: &Path,
    ) -> Result<(Self, Vec<Self>), EndpointError> {
        Self::resolve(base_url, |name| std::env::var(name).ok(), &folder.join(ENV_FILE))
    }

    fn resolve(
        base_url: Option<&str>,
        environment: impl Fn(&str) -> Option<String>,
        env_file: &Path,
    ) -> Result<(Self, Vec<Self>), EndpointError> {
        let file = read_env_file(env_file)?;
        let given = |value: &String| !value.trim().is_empty();
        let variable = |name: &str| {
            environment(name).filter(given).or_else(|| {
                let (_, value) = file.iter().rfind(|(key, _)| key == name)?;
                Some(value.clone()).filter(given)
            })
        };
        let base_urls = base_url
            .map(str::to_owned)
            .or_else(|| BASE_URL_VARIABLES.into_iter().find_map(variable))
            .ok_or(EndpointError::NoBaseUrl)?;
        let key = variable(KEY_VARIABLE).as_deref().and_then(ApiKey::new);
        let mut endpoints = base_urls.split(',').map(|base_url| Self::new(base_url, key.clone()));
        let first = endpoints.next().ok_or(EndpointError::NoBaseUrl)??;
        Ok((first, endpoints.collect::<Result<_, _>>()?))
    }

    /// The URL of chat completions.
    pub(crate) fn completions(&self) -> &Uri {
        &self.completions
    }

    /// Another page of the interface; `path` begins with a slash.
    pub(crate) fn page(&self, path: &str) -> String {
        format!("{}{path}", self.base())
    }

    /// A page of the server outside `/v1`.
    pub(crate) fn server_page(&self, path: &str) -> String {
        let base = self.base();
        format!("{}{path}", base.strip_suffix("/v1").unwrap_or(&base))
    }

    /// The base URL.
    pub fn base(&self) -> String {
        let completions = self.completions.to_string();
        completions.strip_suffix(COMPLETIONS).unwrap_or(&completions).to_owned()
    }

    /// Whether the host name or address is this machine's.
    pub(crate) fn is_local(&self) -> bool {
        let host = self.completions.host().unwrap_or_default();
        let address = host.trim_matches(['[', ']']).parse::<IpAddr>();
        host == "localhost" || address.is_ok_and(|address| address.is_loopback())
    }

    /// The header that carries the key.
    pub(crate) fn authorization(&self) -> Option<&HeaderValue> {
        self.authorization.as_ref()
    }

    /// `text` from the server with the key masked.
    pub(crate) fn masked(&self, text: &str) -> String {
        match &self.key {
            None => text.to_owned(),
            Some(key) => key.masked_in(text),
        }
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.completions.fmt(f)
    }
}

/// The variables of a `.env` file; none when the file does not exist.
fn read_env_file(path: &Path) -> Result<Vec<(String, String)>, EndpointError> {
    let failed = |problem: String| EndpointError::EnvFile { path: path.to_owned(), problem };
    let lines = match dotenvy::from_path_iter(path) {
        Ok(lines) => lines,
        Err(dotenvy::Error::Io(error)) if error.kind() == io::ErrorKind::NotFound => {
            return Ok(Vec::new());
        }
        Err(dotenvy::Error::Io(error)) => return Err(failed(error.to_string())),
        Err(_) => return Err(failed(NOT_A_VARIABLE.to_owned())),
    };
    lines
        .map(|line| {
            line.map_err(|error| match error {
                dotenvy::Error::Io(error) => failed(error.to_string()),
                // Its own message would show the line.
                _ => failed(NOT_A_VARIABLE.to_owned()),
            })
        })
        .collect()
}

const NOT_A_VARIABLE: &str = "one of its lines is not NAME=value";

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "sk-very-secret";

    fn resolve(
        flag: Option<&str>,
        environment: &[(&str, &str)],
        env_file: &str,
    ) -> Result<Endpoint, EndpointError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(ENV_FILE);
        if !env_file.is_empty() {
            std::fs::write(&path, env_file).unwrap();
        }
        let variable = |name: &str| {
            environment.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned())
        };
        Endpoint::resolve(flag, variable, &path).map(|(first, _)| first)
    }

    #[test]
    fn flag_before_environment_before_file() {
        let (both, file) = (
            [("OPENAI_BASE_URL", "http://b/v1"), ("OPENAI_API_BASE", "http://a/v1")],
            "OPENAI_BASE_URL=http://f/v1/",
        );
        for (flag, environment, env_file, expected) in [
            (Some("http://flag/v1//"), &both[..], file, "http://flag/v1/chat/completions"),
            (None, &both[..], file, "http://b/v1/chat/completions"),
            (None, &both[1..], "", "http://a/v1/chat/completions"),
            (None, &[("OPENAI_BASE_URL", " ")][..], file, "http://f/v1/chat/completions"),
            (
                None,
                &[][..],
                "export OPENAI_API_BASE='https://x/v1' # y",
                "https://x/v1/chat/completions",
            ),
        ] {
            assert_eq!(resolve(flag, environment, env_file).unwrap().to_string(), expected);
        }
    }

    #[test]
    fn several_urls_are_separated_by_commas_and_share_the_key() {
        let key = |name: &str| (name == KEY_VARIABLE).then(|| KEY.to_owned());
        let urls = "http://a/v1, http://b:2/v1/";
        let (first, others) = Endpoint::resolve(Some(urls), key, Path::new("/none")).unwrap();
        let all: Vec<_> = std::iter::once(&first).chain(&others).collect();
        assert_eq!(
            all.iter().map(|endpoint| endpoint.to_string()).collect::<Vec<_>>(),
            ["http://a/v1/chat/completions", "http://b:2/v1/chat/completions"]
        );
        assert!(all.iter().all(|endpoint| endpoint.authorization().is_some()));
        assert!(Endpoint::resolve(Some("http://a/v1,"), key, Path::new("/none")).is_err());
    }

    #[test]
    fn pages_beside_and_above() {
        for (base_url, page, server_page) in [
            ("http://a:1/v1/", "http://a:1/v1/models", "http://a:1/version"),
            ("https://x/api/v1", "https://x/api/v1/models", "https://x/api/version"),
            ("https://x/openai", "https://x/openai/models", "https://x/openai/version"),
        ] {
            let endpoint = Endpoint::new(base_url, None).unwrap();
            assert_eq!(endpoint.page("/models"), page);
            assert_eq!(endpoint.server_page("/version"), server_page);
        }
    }

    #[test]
    fn the_key_is_in_the_header_and_never_printed() {
        let endpoint =
            resolve(Some("http://a/v1"), &[], &format!("OPENAI_API_KEY=\"{KEY}\"\n")).unwrap();
        assert_eq!(endpoint.authorization().unwrap(), &format!("Bearer {KEY}"));
        let printed = format!("{endpoint} {endpoint:?} {}", endpoint.masked(KEY));
        assert!(!printed.contains(KEY), "{printed}");
    }

    #[test]
    fn which_servers_are_local() {
        for (base_url, here) in [
            ("http://localhost:8000/v1", true),
            ("http://127.0.0.1/v1", true),
            ("http://[::1]:80/v1", true),
            ("https://api.openai.com/v1", false),
            ("http://10.0.0.1:8000/v1", false),
        ] {
            assert_eq!(Endpoint::new(base_url, None).unwrap().is_local(), here, "{base_url}");
        }
    }

    #[test]
    fn errors_show_no_secret() {
        for (base_url, environment, env_file, expected) in [
            (None, ("", ""), "", "no chat endpoint is given"),
            (Some("localhost:8000/v1"), ("", ""), "", "is no URL"),
            (Some("ftp://a/v1"), ("", ""), "", "does not begin with http"),
            (Some("https://me:sk-very-secret@a/v1"), ("", ""), "", "OPENAI_API_KEY"),
            (Some("https://a/v1?key=sk-very-secret"), ("", ""), "", "a query"),
            (
                Some("http://a/v1"),
                (KEY_VARIABLE, "sk-very-secret\u{7}x"),
                "",
                "a header cannot carry",
            ),
            (Some("http://a/v1"), ("", ""), "OPENAI_API_KEY sk-very-secret", "not NAME=value"),
        ] {
            let error = resolve(base_url, &[environment], env_file).unwrap_err();
            let printed = format!("{error} {error:?}");
            assert!(printed.contains(expected) && !printed.contains(KEY), "{printed}");
        }
    }
}

//! The addresses of chat servers and the key for them: from a flag, the environment, a `.env` file, or a suite or plan.
//!
//! A key goes to an address that was given in the same place as the key, or by a flag. Otherwise a file that comes from
//! elsewhere, such as a `.env` in a downloaded folder, would name the server that this user's key is sent to. There is no
//! exception for addresses of this machine, where other users have servers, too.

use std::fmt;
use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use domain::SecretHeader;
use ureq::http::Uri;
use ureq::http::header::{AUTHORIZATION, HeaderName, HeaderValue};

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
    /// The base URL, without a slash or query at its end.
    base: String,
    /// `?api-version=...`, or nothing.
    query: String,
    /// The headers of each request: that of the key, and those that the user gave.
    headers: Vec<(HeaderName, HeaderValue)>,
    has_key: bool,
    /// What is masked in texts.
    secrets: Vec<ApiKey>,
}

/// The query of a base URL, which Azure's servers need. They have a header of their own for the key, too.
const API_VERSION: &str = "api-version=";

/// The header of a key of a server that needs [`API_VERSION`].
const API_KEY: HeaderName = HeaderName::from_static("api-key");

/// Where an address or a key was given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Source {
    /// A flag of the command line.
    CommandLine,
    /// A variable of the environment.
    Environment,
    /// The file [`ENV_FILE`] in the working folder.
    EnvFile,
    /// A suite or a plan.
    SettingsFile,
}

impl Source {
    const ALL: [Self; 4] =
        [Self::CommandLine, Self::Environment, Self::EnvFile, Self::SettingsFile];

    /// Its name as the value of a flag.
    pub const fn word(self) -> &'static str {
        match self {
            Self::CommandLine => "command-line",
            Self::Environment => "environment",
            Self::EnvFile => "env-file",
            Self::SettingsFile => "settings-file",
        }
    }
}

impl FromStr for Source {
    type Err = String;

    fn from_str(word: &str) -> Result<Self, Self::Err> {
        let known = || Self::ALL.map(Self::word).join(", ");
        let found = Self::ALL.into_iter().find(|source| source.word() == word);
        found.ok_or_else(|| format!("{word} is none of {}", known()))
    }
}

impl fmt::Display for Source {
    /// As part of a sentence.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::CommandLine => "the command line",
            Self::Environment => "the environment",
            Self::EnvFile => "the file .env",
            Self::SettingsFile => "the suite or plan",
        })
    }
}

/// The servers of one model, which share its requests and get the same key.
#[derive(Debug, Clone)]
pub struct Servers {
    /// The first.
    pub first: Endpoint,
    /// The others.
    pub others: Vec<Endpoint>,
    /// Where the addresses were given.
    pub source: Source,
    /// Where the key was given; `None` without one.
    pub key_source: Option<Source>,
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
    #[error(
        "OPENAI_API_KEY holds a character that a header cannot carry, such as a typographic dash or quote: copy it again"
    )]
    Key,
    /// A header of the user's cannot be sent. Its value is not repeated.
    #[error("the header {name} {problem}")]
    Header {
        /// Its name.
        name: String,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// A header would be sent to an address that a file names.
    #[error(
        "--header is given and the address {base_urls} comes from {address}: headers may hold keys, so give --base-url \
         {base_urls} to send them there, or leave them out"
    )]
    HeaderElsewhere {
        /// The base URLs, separated by commas.
        base_urls: String,
        /// Where they were given.
        address: Source,
    },
    /// The key would be sent to an address that was given elsewhere.
    #[error(
        "OPENAI_API_KEY was given in {key} and the address {base_urls} in {address}, and a key is sent only to an address \
         that was given in the same place or with --base-url: give --base-url {base_urls} to send it there, or unset the key"
    )]
    KeyFromElsewhere {
        /// The base URLs, separated by commas.
        base_urls: String,
        /// Where they were given.
        address: Source,
        /// Where the key was given.
        key: Source,
    },
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
    /// The endpoint at `base_url`, which usually ends in `/v1`; a trailing slash or `/chat/completions` is ignored.
    ///
    /// # Errors
    /// When the URL is not absolute, is not HTTP, has a port that is none, or holds credentials, a fragment, or another query
    /// than `?api-version=...`; when `key` cannot be sent in a header.
    pub fn new(base_url: &str, key: Option<ApiKey>) -> Result<Self, EndpointError> {
        let wrong = |problem| EndpointError::BaseUrl { problem };
        let (base, query) = match base_url.trim().split_once('?') {
            None => (base_url.trim(), String::new()),
            Some((base, query)) => {
                let version = query.strip_prefix(API_VERSION);
                let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.');
                if !version.is_some_and(|version| version.chars().all(is_plain)) {
                    return Err(wrong("holds a query that is not ?api-version=VERSION"));
                }
                (base, format!("?{query}"))
            }
        };
        let base = base.trim_end_matches('/');
        let base = base.strip_suffix(COMPLETIONS).unwrap_or(base).trim_end_matches('/').to_owned();
        if base.contains('#') {
            return Err(wrong("holds a fragment"));
        }
        let completions: Uri =
            format!("{base}{COMPLETIONS}{query}").parse().map_err(|_| wrong("is no URL"))?;
        if !matches!(completions.scheme_str(), Some("http" | "https")) {
            return Err(wrong("does not begin with http:// or https://"));
        }
        let authority = completions.authority().ok_or_else(|| wrong("names no host"))?;
        if authority.as_str().contains('@') {
            return Err(wrong("holds a name or password: the key goes into OPENAI_API_KEY"));
        }
        let after_host = authority.as_str().rsplit(']').next().unwrap_or_default();
        if after_host.contains(':') && authority.port_u16().is_none_or(|port| port == 0) {
            return Err(wrong("has a port that is not from 1 to 65535"));
        }
        let mut headers = Vec::new();
        if let Some(key) = &key {
            let (name, value) = match query.is_empty() {
                true => (AUTHORIZATION, format!("Bearer {}", key.expose())),
                false => (API_KEY, key.expose().to_owned()),
            };
            let value = Some(value).filter(|value| value.is_ascii());
            let value = value.and_then(|value| HeaderValue::try_from(value).ok());
            let mut value = value.ok_or(EndpointError::Key)?;
            value.set_sensitive(true);
            headers.push((name, value));
        }
        let (has_key, secrets) = (key.is_some(), key.into_iter().collect());
        Ok(Self { completions, base, query, headers, has_key, secrets })
    }

    /// The endpoint with further headers in each request. They replace that of the key where they have its name, and their
    /// values are masked in texts as a key is.
    ///
    /// # Errors
    /// When a header cannot be sent.
    pub fn with_headers(mut self, headers: &[SecretHeader]) -> Result<Self, EndpointError> {
        for header in headers {
            let wrong = |problem| EndpointError::Header { name: header.name().to_owned(), problem };
            let secret = header
                .value()
                .ok_or(wrong("has no value here, since values are kept nowhere: give it again"))?;
            let name =
                HeaderName::try_from(header.name()).map_err(|_| wrong("has no valid name"))?;
            if ["content-type", "content-length", "content-encoding", "transfer-encoding", "host"]
                .contains(&name.as_str())
            {
                return Err(wrong("describes the body of a request, which is the run's"));
            }
            let value = Some(secret).filter(|value| value.is_ascii());
            let value = value.and_then(|value| HeaderValue::try_from(value).ok());
            let mut value = value.ok_or(wrong("holds a character that a header cannot carry"))?;
            value.set_sensitive(true);
            self.headers.retain(|(known, _)| *known != name);
            self.headers.push((name, value));
            // A scheme such as Bearer is before the secret.
            let words = [Some(secret), secret.split_once(' ').map(|(_, secret)| secret)];
            self.secrets.extend(words.into_iter().flatten().filter_map(ApiKey::new));
        }
        Ok(self)
    }

    /// The URL of chat completions.
    pub(crate) fn completions(&self) -> &Uri {
        &self.completions
    }

    /// Another page of the interface; `path` begins with a slash.
    pub(crate) fn page(&self, path: &str) -> String {
        format!("{}{path}{}", self.base, self.query)
    }

    /// The base URL.
    pub fn base(&self) -> String {
        format!("{}{}", self.base, self.query)
    }

    /// Whether the host name or address is this machine's.
    pub(crate) fn is_local(&self) -> bool {
        let host = self.completions.host().unwrap_or_default();
        let address = host.trim_matches(['[', ']']).parse::<IpAddr>();
        host == "localhost" || address.is_ok_and(|address| address.is_loopback())
    }

    /// The headers that each request carries, the key's among them.
    pub(crate) fn headers(&self) -> impl Iterator<Item = (&HeaderName, &HeaderValue)> {
        self.headers.iter().map(|(name, value)| (name, value))
    }

    /// Whether requests carry a key.
    pub(crate) const fn has_key(&self) -> bool {
        self.has_key
    }

    /// `text` from the server with the key and the values of headers masked.
    pub(crate) fn masked(&self, text: &str) -> String {
        self.secrets.iter().fold(text.to_owned(), |text, secret| secret.masked_in(&text))
    }
}

impl Servers {
    /// The servers at the URL `given`, else at the URL in the environment, else at the URL in `folder/.env`. A blank variable
    /// counts as not set. Several URLs are separated by commas. The key is that of the place of the URL; a URL of the command
    /// line gets that of the environment, else that of `folder/.env`.
    ///
    /// # Errors
    /// When no place has a base URL, a value cannot be used, or there is a key in another place only.
    pub fn from_environment(
        given: Option<(&str, Source)>,
        folder: &Path,
    ) -> Result<Self, EndpointError> {
        Self::resolve(given, |name| std::env::var(name).ok(), &folder.join(ENV_FILE))
    }

    fn resolve(
        given: Option<(&str, Source)>,
        environment: impl Fn(&str) -> Option<String>,
        env_file: &Path,
    ) -> Result<Self, EndpointError> {
        let (file, mut problem) = match read_env_file(env_file) {
            Ok(file) => (file, None),
            Err(error) => (Vec::new(), Some(error)),
        };
        let variable = |source, name: &str| {
            let value = match source {
                Source::Environment => environment(name),
                Source::EnvFile => {
                    file.iter().rfind(|(key, _)| key == name).map(|(_, value)| value.clone())
                }
                Source::CommandLine | Source::SettingsFile => None,
            };
            value.filter(|value| !value.trim().is_empty())
        };
        let places = [Source::Environment, Source::EnvFile];
        let named = |source| {
            let url = BASE_URL_VARIABLES.into_iter().find_map(|name| variable(source, name));
            url.map(|url| (url, source))
        };
        let (base_urls, source) = given
            .map(|(url, source)| (url.to_owned(), source))
            .or_else(|| places.into_iter().find_map(named))
            .ok_or_else(|| problem.take().unwrap_or(EndpointError::NoBaseUrl))?;
        if let Some(problem) = problem {
            // It may be another program's, and the server may need no key.
            tracing::warn!("{problem}; it is not used");
        }
        let key_in = |source| variable(source, KEY_VARIABLE).as_deref().and_then(ApiKey::new);
        let found = places.into_iter().find_map(|place| Some((key_in(place)?, place)));
        let key = match source {
            Source::CommandLine => found,
            other => match (key_in(other), found) {
                (Some(key), _) => Some((key, other)),
                (None, None) => None,
                (None, Some((_, key))) => {
                    // Read first: an address that cannot be used may hold a password, and is not shown.
                    let bases = base_urls.split(',').map(|base_url| Endpoint::new(base_url, None));
                    let bases: Vec<String> =
                        bases.map(|one| Ok(one?.base())).collect::<Result<_, EndpointError>>()?;
                    let (base_urls, address) = (bases.join(","), other);
                    return Err(EndpointError::KeyFromElsewhere { base_urls, address, key });
                }
            },
        };
        if let Some((key, Source::EnvFile)) = &key
            && key.expose().contains("${")
        {
            tracing::warn!(
                "{KEY_VARIABLE} in {} contains ${{...}}, and is sent as it is written: variables are not replaced",
                env_file.display()
            );
        }
        let (key, key_source) = key.unzip();
        let mut all = base_urls.split(',').map(|base_url| Endpoint::new(base_url, key.clone()));
        let first = all.next().ok_or(EndpointError::NoBaseUrl)??;
        Ok(Self { first, others: all.collect::<Result<_, _>>()?, source, key_source })
    }

    /// The servers with further headers in each request. Headers that the user gave, on the command line or in the environment,
    /// are not sent to an address that a file names.
    ///
    /// # Errors
    /// When a header cannot be sent, or not to this address.
    pub fn with_headers(
        self,
        headers: &[SecretHeader],
        of_file: bool,
    ) -> Result<Self, EndpointError> {
        let address = self.source;
        if !headers.is_empty()
            && !of_file
            && matches!(address, Source::EnvFile | Source::SettingsFile)
        {
            let bases: Vec<String> = self.all().map(Endpoint::base).collect();
            return Err(EndpointError::HeaderElsewhere { base_urls: bases.join(","), address });
        }
        let others = self.others.into_iter().map(|endpoint| endpoint.with_headers(headers));
        Ok(Self {
            first: self.first.with_headers(headers)?,
            others: others.collect::<Result<_, _>>()?,
            ..self
        })
    }

    /// Where the addresses and the key were given, for messages.
    pub fn places(&self) -> String {
        let key = match self.key_source {
            Some(source) => format!("with the key of {source}"),
            None => "without a key".to_owned(),
        };
        format!("from {}, {key}", self.source)
    }

    /// All of them.
    pub fn all(&self) -> impl Iterator<Item = &Endpoint> {
        std::iter::once(&self.first).chain(&self.others)
    }
}

impl fmt::Display for Servers {
    /// The addresses, where they and the key come from.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let bases: Vec<String> = self.all().map(Endpoint::base).collect();
        write!(f, "{} ({})", bases.join(" and "), self.places())
    }
}

impl fmt::Display for Endpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.completions.fmt(f)
    }
}

/// The variables of a `.env` file; none when the file does not exist.
///
/// # Errors
/// When the file cannot be read, or a line is not `NAME=value`.
pub fn read_env_file(path: &Path) -> Result<Vec<(String, String)>, EndpointError> {
    let failed = |problem: String| EndpointError::EnvFile { path: path.to_owned(), problem };
    let text = match durable::input::read_text(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        read => read.map_err(|error| failed(error.to_string()))?,
    };
    let mut variables = Vec::new();
    // Some editors begin a file with a byte order mark.
    for (number, line) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
        // Other lines are other programs', which may read them in another way.
        let Some((name, rest)) = own_variable(line) else { continue };
        let value = rest.strip_prefix('=').and_then(value_of);
        let value = value.ok_or_else(|| {
            failed(format!("{name} in line {number} is not NAME=value, with every quote closed and nothing after it"))
        })?;
        variables.push((name.to_owned(), value.to_owned()));
    }
    Ok(variables)
}
/// The name and what follows it, in a line of a `.env` file that is about a variable of this module, perhaps after `export`.
fn own_variable(line: &str) -> Option<(&'static str, &str)> {
    let line = line.trim();
    let line = match line.strip_prefix("export") {
        Some(rest) if rest.starts_with(char::is_whitespace) => rest.trim_start(),
        _ => line,
    };
    let is_of_a_name = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    BASE_URL_VARIABLES.into_iter().chain([KEY_VARIABLE]).find_map(|name| {
        let rest = line.strip_prefix(name)?;
        // Without more, `export NAME` sets nothing.
        let is_own = !rest.is_empty() && !rest.starts_with(is_of_a_name);
        is_own.then_some((name, rest.trim_start()))
    })
}

/// The value in what follows the equals sign: `value`, `'value'` or `"value"`, before an optional comment. It is taken as it is
/// written: if the variables that it mentions were replaced, a file from elsewhere could take the environment's key and send it
/// to an address of its own.
fn value_of(text: &str) -> Option<&str> {
    let text = text.trim();
    for quote in ['\'', '"'] {
        if let Some(quoted) = text.strip_prefix(quote) {
            let (value, rest) = quoted.split_once(quote)?;
            let rest = rest.trim_start();
            return (rest.is_empty() || rest.starts_with('#')).then_some(value);
        }
    }
    let starts_comment = |&(index, _): &(usize, &str)| {
        text[..index].chars().next_back().is_none_or(char::is_whitespace)
    };
    let end = text.match_indices('#').find(starts_comment).map_or(text.len(), |(index, _)| index);
    Some(text[..end].trim_end())
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "sk-very-secret";

    fn resolve(
        given: Option<(&str, Source)>,
        environment: &[(&str, &str)],
        env_file: &str,
    ) -> Result<Servers, EndpointError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(ENV_FILE);
        if !env_file.is_empty() {
            std::fs::write(&path, env_file).unwrap();
        }
        let variable = |name: &str| {
            environment.iter().find(|(key, _)| *key == name).map(|(_, value)| (*value).to_owned())
        };
        Servers::resolve(given, variable, &path)
    }

    /// The headers of the user's requests.
    fn sent(endpoint: &Endpoint) -> Vec<String> {
        let shown = |(name, value): (&HeaderName, &HeaderValue)| {
            format!("{name}: {}", value.to_str().unwrap())
        };
        endpoint.headers().map(shown).collect()
    }

    /// An address of the command line.
    fn flag(url: &str) -> Option<(&str, Source)> {
        Some((url, Source::CommandLine))
    }

    #[test]
    fn a_key_goes_to_an_address_of_the_same_place_or_of_the_command_line() {
        const URL: &str = "http://127.0.0.1:9/v1";
        use Source::{CommandLine, EnvFile, Environment, SettingsFile};
        let file_with = |names: &[&str]| {
            let line = |name: &&str| match *name {
                KEY_VARIABLE => format!("{KEY_VARIABLE}={KEY}\n"),
                name => format!("{name}={URL}\n"),
            };
            names.iter().map(line).collect::<String>()
        };
        let (address, key) = (("OPENAI_BASE_URL", URL), (KEY_VARIABLE, KEY));
        let (in_file, both) = ("OPENAI_BASE_URL", ["OPENAI_BASE_URL", KEY_VARIABLE]);
        // Given; in the environment; in .env: where the address and the key are taken from, or the place of the key that is
        // not sent.
        for (given, environment, env_file, expected) in [
            (None, &[address, key][..], &[][..], Ok((Environment, Some(Environment)))),
            (None, &[address], &[], Ok((Environment, None))),
            (None, &[], &both, Ok((EnvFile, Some(EnvFile)))),
            (None, &[], &[in_file], Ok((EnvFile, None))),
            // What a downloaded folder could ask for, and its opposite.
            (None, &[key], &[in_file], Err((EnvFile, Environment))),
            (None, &[address], &[KEY_VARIABLE], Err((Environment, EnvFile))),
            // Each place has a pair: the address decides.
            (None, &[address, key], &both, Ok((Environment, Some(Environment)))),
            (None, &[key], &both, Ok((EnvFile, Some(EnvFile)))),
            (Some(CommandLine), &[key], &[], Ok((CommandLine, Some(Environment)))),
            (Some(CommandLine), &[], &[KEY_VARIABLE], Ok((CommandLine, Some(EnvFile)))),
            (Some(CommandLine), &[], &[], Ok((CommandLine, None))),
            (Some(Environment), &[key], &[], Ok((Environment, Some(Environment)))),
            (Some(Environment), &[], &both, Err((Environment, EnvFile))),
            (Some(SettingsFile), &[], &[], Ok((SettingsFile, None))),
            (Some(SettingsFile), &[key], &[], Err((SettingsFile, Environment))),
            (Some(SettingsFile), &[], &both, Err((SettingsFile, EnvFile))),
        ] {
            let context = format!("{given:?} {environment:?} {env_file:?}");
            let given = given.map(|source| (URL, source));
            match (resolve(given, environment, &file_with(env_file)), expected) {
                (Ok(servers), Ok((source, key_source))) => {
                    assert_eq!((servers.source, servers.key_source), (source, key_source));
                    let is_sent = servers.first.has_key();
                    assert_eq!(is_sent, key_source.is_some(), "{context}");
                }
                (Err(error), Err((address, key))) => {
                    let printed = error.to_string();
                    for part in [&address.to_string(), &key.to_string(), "--base-url http://127"] {
                        assert!(printed.contains(part), "{context}: {printed}");
                    }
                    assert!(!printed.contains(KEY), "{printed}");
                }
                (found, _) => panic!("{context}: {found:?}"),
            }
        }
    }

    #[test]
    fn servers_are_shown_with_the_places_that_name_them() {
        let both = [("OPENAI_BASE_URL", "http://a/v1,http://b/v1/"), (KEY_VARIABLE, KEY)];
        let shown = |given, environment| resolve(given, environment, "").unwrap().to_string();
        assert_eq!(
            shown(None, &both),
            "http://a/v1 and http://b/v1 (from the environment, with the key of the environment)"
        );
        assert_eq!(
            shown(flag("http://a/v1"), &[]),
            "http://a/v1 (from the command line, without a key)"
        );
    }

    #[test]
    fn sources_are_read_by_their_words() {
        for source in Source::ALL {
            assert_eq!(source.word().parse(), Ok(source));
        }
        let error = "file".parse::<Source>().unwrap_err();
        assert_eq!(error, "file is none of command-line, environment, env-file, settings-file");
    }

    #[test]
    fn flag_before_environment_before_file() {
        let (both, file) = (
            [("OPENAI_BASE_URL", "http://b/v1"), ("OPENAI_API_BASE", "http://a/v1")],
            "OPENAI_BASE_URL=http://f/v1/",
        );
        for (given, environment, env_file, expected) in [
            (flag("http://flag/v1//"), &both[..], file, "http://flag/v1/chat/completions"),
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
            let servers = resolve(given, environment, env_file).unwrap();
            assert_eq!(servers.first.to_string(), expected);
        }
    }

    #[test]
    fn a_value_of_the_file_takes_nothing_from_the_environment() {
        for name in [KEY_VARIABLE, "PATH"] {
            for value in [format!("${{{name}}}"), format!("${name}")] {
                for quote in ["", "'", "\""] {
                    let line = format!("{KEY_VARIABLE}={quote}{value}{quote} # comment\n");
                    let text = format!("{line}OPENAI_BASE_URL=http://a/v1\n");
                    let servers = resolve(None, &[], &text).unwrap();
                    assert_eq!(
                        sent(&servers.first),
                        [format!("authorization: Bearer {value}")],
                        "{line}"
                    );
                }
            }
        }
        // The environment's key is neither put into the address nor sent there.
        let text = "OPENAI_BASE_URL=http://a/${OPENAI_API_KEY}/v1";
        assert!(resolve(None, &[(KEY_VARIABLE, KEY)], text).is_err());
    }

    #[test]
    fn lines_of_an_env_file() {
        for (text, expected) in [
            ("b", Some("b")),
            (" b c ", Some("b c")),
            ("", Some("")),
            (" # none", Some("")),
            ("b#c # d", Some("b#c")),
            ("\"b # $c\" # d", Some("b # $c")),
            ("'b\"=c'", Some("b\"=c")),
            ("'b' c", None),
            ("\"b", None),
        ] {
            assert_eq!(value_of(text), expected, "{text}");
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(ENV_FILE);
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            read_env_file(&path).map_err(|error| error.to_string())
        };
        let key = || vec![(KEY_VARIABLE.to_owned(), "b".to_owned())];
        assert_eq!(read("\u{feff}OPENAI_API_KEY=b\r\n# c\r\n"), Ok(key()));
        for other in [
            "export",
            "export OTHER",
            "FOO-BAR=1",
            "=b",
            "secret",
            "X=\"a\\\"b\"",
            "CERTIFICATE=\"-----BEGIN-----\nabc=\n-----END-----\"",
            "OPENAI_API_KEYS='x",
            "OPENAI_API_KEY-OLD='x",
            "export OPENAI_API_KEY",
            "# OPENAI_API_KEY='x",
        ] {
            assert_eq!(read(&format!("{other}\n export OPENAI_API_KEY = b\n{other}")), Ok(key()));
        }
        for name in [KEY_VARIABLE, "OPENAI_BASE_URL", "OPENAI_API_BASE"] {
            for malformed in ["=\"secret", " secret", ": secret", "='secret' x", "+=secret"] {
                let problem = read(&format!("# comment\n\n{name}{malformed}\n")).unwrap_err();
                assert!(problem.contains(&format!(".env: {name} in line 3 is not")), "{problem}");
                assert!(!problem.contains("secret"), "{problem}");
            }
        }
        let problem = read_env_file(Path::new("/dev/zero")).unwrap_err().to_string();
        assert!(problem.contains("not a regular file"), "{problem}");
    }

    #[test]
    fn several_urls_are_separated_by_commas_and_share_the_key() {
        let key = |name: &str| (name == KEY_VARIABLE).then(|| KEY.to_owned());
        let urls = "http://a/v1, http://b:2/v1/";
        let servers = Servers::resolve(flag(urls), key, Path::new("/none")).unwrap();
        let all: Vec<_> = servers.all().collect();
        assert_eq!(
            all.iter().map(|endpoint| endpoint.to_string()).collect::<Vec<_>>(),
            ["http://a/v1/chat/completions", "http://b:2/v1/chat/completions"]
        );
        assert!(all.iter().all(|endpoint| endpoint.has_key()));
        assert!(Servers::resolve(flag("http://a/v1,"), key, Path::new("/none")).is_err());
    }

    #[test]
    fn the_other_pages_are_beside_chat_completions() {
        for (base_url, page) in [
            ("http://a:1/v1/", "http://a:1/v1/models"),
            ("https://x/openai", "https://x/openai/models"),
            ("https://x/v1/chat/completions/", "https://x/v1/models"),
            ("https://x/d?api-version=2024-10-21", "https://x/d/models?api-version=2024-10-21"),
        ] {
            assert_eq!(Endpoint::new(base_url, None).unwrap().page("/models"), page);
        }
    }

    #[test]
    fn the_key_is_in_the_header_and_never_printed() {
        let endpoint =
            resolve(flag("http://a/v1"), &[], &format!("OPENAI_API_KEY=\"{KEY}\"\n")).unwrap();
        let endpoint = endpoint.first;
        assert_eq!(sent(&endpoint), [format!("authorization: Bearer {KEY}")]);
        let printed = format!("{endpoint} {endpoint:?} {}", endpoint.masked(KEY));
        assert!(!printed.contains(KEY), "{printed}");
    }

    #[test]
    fn an_address_with_a_version_gets_the_key_as_azure_wants_it() {
        let base = "https://x.openai.azure.com/openai/deployments/d?api-version=2024-10-21";
        let endpoint = Endpoint::new(base, ApiKey::new(KEY)).unwrap();
        assert_eq!(endpoint.base(), base);
        assert_eq!(
            endpoint.to_string(),
            "https://x.openai.azure.com/openai/deployments/d/chat/completions?api-version=2024-10-21"
        );
        assert_eq!(sent(&endpoint), [format!("api-key: {KEY}")]);
    }

    #[test]
    fn headers_of_the_user_are_sent_and_masked_and_not_to_an_address_of_a_file() {
        let header = |text: &str| text.parse::<SecretHeader>().unwrap();
        let headers = [header("X-Team: seven"), header("authorization: Bearer sk-another-secret")];
        let servers = |source| {
            resolve(Some(("http://a/v1", source)), &[], "").unwrap().with_headers(&headers, false)
        };
        let endpoint = servers(Source::CommandLine).unwrap().first;
        assert_eq!(sent(&endpoint), ["x-team: seven", "authorization: Bearer sk-another-secret"]);
        assert_eq!(endpoint.masked("no sk-another-secret of seven"), "no [key] of seven");
        assert!(!format!("{endpoint:?} {headers:?}").contains("another"));
        let error = servers(Source::SettingsFile).unwrap_err().to_string();
        assert!(error.contains("give --base-url http://a/v1 to send them there"), "{error}");
        let endpoint = || Endpoint::new("http://a/v1", None).unwrap();
        for (text, expected) in [
            ("X: [key]", "has no value here"),
            ("Content-Type: text/plain", "the run's"),
            ("X Y: z", "no valid name"),
            ("X: \u{2013}", "cannot carry"),
        ] {
            let error = endpoint().with_headers(&[header(text)]).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn a_file_of_another_program_does_not_stop_a_server_that_is_given() {
        for text in ["OPENAI_API_KEY='of\nseveral lines'", "OPENAI_API_KEY: yaml"] {
            let servers = resolve(flag("http://a/v1"), &[], text).unwrap();
            assert!(!servers.first.has_key());
            assert!(resolve(None, &[], text).is_err());
        }
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
            (
                Some(("http://me:sk-very-secret@a/v1", Source::SettingsFile)),
                (KEY_VARIABLE, KEY),
                "",
                "holds a name or password",
            ),
            (flag("localhost:8000/v1"), ("", ""), "", "is no URL"),
            (flag("ftp://a/v1"), ("", ""), "", "does not begin with http"),
            (flag("https://me:sk-very-secret@a/v1"), ("", ""), "", "OPENAI_API_KEY"),
            (flag("https://a/v1?key=sk-very-secret"), ("", ""), "", "a query"),
            (
                flag("http://a/v1"),
                (KEY_VARIABLE, "sk-very-secret\u{7}x"),
                "",
                "a header cannot carry",
            ),
            (
                flag("http://a/v1"),
                (KEY_VARIABLE, "sk-very\u{2013}secret"),
                "",
                "a typographic dash",
            ),
            (flag("http://a:99999/v1"), ("", ""), "", "a port that is not from 1 to 65535"),
            (flag("http://[::1]:/v1"), ("", ""), "", "a port that is not from 1 to 65535"),
            (None, ("", ""), "OPENAI_API_KEY sk-very-secret", "is not NAME=value"),
        ] {
            let error = resolve(base_url, &[environment], env_file).unwrap_err();
            let printed = format!("{error} {error:?}");
            assert!(printed.contains(expected) && !printed.contains(KEY), "{printed}");
        }
    }
}

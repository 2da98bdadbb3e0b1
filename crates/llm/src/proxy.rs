//! Which proxy leads to a server, read from the environment as curl reads it.

use ureq::http::Uri;

/// The URL of the proxy for `target`, and the variable that names it: that of its scheme, else `ALL_PROXY`, unless `NO_PROXY`
/// lists its host. `HTTP_PROXY` counts in lower case only, since web servers set the other one from a header.
pub(crate) fn of(
    target: &Uri,
    variable: impl Fn(&str) -> Option<String>,
) -> Option<(&'static str, String)> {
    let set =
        |name: &'static str| Some((name, variable(name).filter(|value| !value.trim().is_empty())?));
    let of_scheme: &[&str] = match target.scheme_str() {
        Some("https") => &["https_proxy", "HTTPS_PROXY"],
        _ => &["http_proxy"],
    };
    let names = of_scheme.iter().chain(&["all_proxy", "ALL_PROXY"]);
    let (name, proxy) = names.copied().find_map(set)?;
    let excluded = ["no_proxy", "NO_PROXY"].into_iter().find_map(set);
    let host = target.host().unwrap_or_default();
    if excluded.is_some_and(|(_, list)| is_listed(host, &list)) {
        return None;
    }
    let proxy = proxy.trim();
    Some((name, if proxy.contains("://") { proxy.to_owned() } else { format!("http://{proxy}") }))
}

/// Whether a host, or a domain that it is in, is in a list with commas or spaces.
fn is_listed(host: &str, list: &str) -> bool {
    let host = host.trim_matches(['[', ']']).trim_end_matches('.').to_ascii_lowercase();
    list.split([',', ' ']).map(|entry| entry.trim().trim_start_matches('.')).any(|entry| {
        let entry = entry.trim_matches(['[', ']']).trim_end_matches('.').to_ascii_lowercase();
        let is_within = || host.strip_suffix(&entry).is_some_and(|rest| rest.ends_with('.'));
        entry == "*" || !entry.is_empty() && (host == entry || is_within())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn proxies_are_those_of_curl() {
        let (http, https) = ("http://a.example.com:8000/v1", "https://a.example.com/v1");
        for (url, environment, expected) in [
            (http, &[("HTTPS_PROXY", "http://p:1"), ("HTTP_PROXY", "http://p:2")][..], None),
            (http, &[("http_proxy", "p:2")], Some("http://p:2")),
            (
                https,
                &[("HTTPS_PROXY", "http://p:1"), ("ALL_PROXY", "http://p:3")],
                Some("http://p:1"),
            ),
            (https, &[("https_proxy", " "), ("all_proxy", "http://p:3")], Some("http://p:3")),
            (https, &[("HTTPS_PROXY", "p:1"), ("NO_PROXY", "b.org, .example.com")], None),
            (https, &[("HTTPS_PROXY", "p:1"), ("NO_PROXY", "a.example.com")], None),
            (
                https,
                &[("HTTPS_PROXY", "p:1"), ("no_proxy", "xample.com,b.a.example.com")],
                Some("http://p:1"),
            ),
            (https, &[("HTTPS_PROXY", "p:1"), ("NO_PROXY", "*")], None),
            ("http://[::1]:8/v1", &[("ALL_PROXY", "p:1"), ("NO_PROXY", "::1")], None),
        ] {
            let variable = |name: &str| {
                environment
                    .iter()
                    .find(|(key, _)| *key == name)
                    .map(|(_, value)| (*value).to_owned())
            };
            let found = of(&url.parse().unwrap(), variable);
            assert_eq!(
                found.as_ref().map(|(_, proxy)| proxy.as_str()),
                expected,
                "{environment:?}"
            );
        }
    }
}

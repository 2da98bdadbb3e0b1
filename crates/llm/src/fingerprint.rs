//! What a server reports about itself: software, version, model file, context length. It can explain differences
//! between scores and has no other use.
//!
//! Only fields known to be harmless are copied, since some servers list their own keys on these pages.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::endpoint::Endpoint;
use crate::error::Transient;
use crate::http::HttpClient;
use crate::reply;

/// Time limit for one page.
const PAGE_TIMEOUT: Duration = Duration::from_secs(10);

/// Fields of the list of models: OpenAI's; vLLM's; those of hosted servers; llama.cpp's.
const MODEL_FIELDS: [&str; 6] =
    ["id", "owned_by", "root", "max_model_len", "context_length", "meta"];

/// Pages outside the interface, and the fields copied from them.
const PAGES: [(&str, &[&str]); 6] = [
    // vLLM.
    ("/version", &["/version"]),
    // llama.cpp.
    (
        "/props",
        &[
            "/build_info",
            "/model_path",
            "/total_slots",
            "/modalities",
            "/default_generation_settings/n_ctx",
            "/chat_template",
        ],
    ),
    // SGLang.
    ("/get_model_info", &["/model_path"]),
    ("/get_server_info", &["/version", "/quantization", "/dtype", "/context_length"]),
    // TGI.
    (
        "/info",
        &["/version", "/sha", "/model_id", "/model_sha", "/model_dtype", "/max_total_tokens"],
    ),
    // Ollama.
    ("/api/version", &["/version"]),
];

/// Longer texts, such as a chat template, are replaced by their hash.
const LONGEST_TEXT: usize = 200;

/// The server of a model.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Fingerprint {
    /// The `Server` header.
    pub server: Option<String>,
    /// The model's entry in the list of models.
    pub model: Option<Value>,
    /// Facts from the server's own pages, by page and field.
    pub pages: BTreeMap<String, Value>,
}

/// The server's answer to the question for its models.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum ModelList {
    /// Their names, as they came.
    Listed(Vec<String>),
    /// The server refuses: status and message.
    Refused(u16, String),
    /// The answer is no list.
    Unreadable,
}

/// The fingerprint without the server's own pages, and the list of models.
pub(crate) fn models(client: &HttpClient) -> Result<(Fingerprint, ModelList), Transient> {
    let page = client.get(&client.endpoint().page("/models"), PAGE_TIMEOUT)?;
    let mut fingerprint = Fingerprint { server: page.server, ..Fingerprint::default() };
    if page.status != 200 {
        let message = reply::error_message(&page.body, |text| client.endpoint().masked(text));
        return Ok((fingerprint, ModelList::Refused(page.status, message)));
    }
    let list: Value = serde_json::from_slice(&page.body).unwrap_or_default();
    let Some(models) = list["data"].as_array() else {
        return Ok((fingerprint, ModelList::Unreadable));
    };
    let name = |model: &Value| model["id"].as_str().map(str::to_owned);
    let asked = models.iter().find(|model| model["id"] == client.settings().model);
    fingerprint.model = asked.map(|model| {
        let fields = MODEL_FIELDS.iter().filter(|field| !model[**field].is_null());
        let masked = |field: &str| masked(client.endpoint(), model[field].clone());
        fields.map(|field| ((*field).to_owned(), masked(field))).collect()
    });
    Ok((fingerprint, ModelList::Listed(models.iter().filter_map(name).collect())))
}

/// Adds the facts from the server's own pages, as far as it has them.
pub(crate) fn read_pages(client: &HttpClient, fingerprint: &mut Fingerprint) {
    for (path, fields) in PAGES {
        let Ok(page) = client.get(&client.endpoint().server_page(path), PAGE_TIMEOUT) else {
            continue;
        };
        let Ok(facts) = serde_json::from_slice::<Value>(&page.body) else { continue };
        for field in fields.iter().filter(|_| page.status == 200) {
            if let Some(value) = facts.pointer(field).filter(|value| !value.is_null()) {
                let value = masked(client.endpoint(), shortened(value));
                fingerprint.pages.insert(format!("{path}{field}"), value);
            }
        }
    }
}

/// `value` with the key masked in its texts.
fn masked(endpoint: &Endpoint, value: Value) -> Value {
    match value {
        Value::String(text) => endpoint.masked(&text).into(),
        Value::Array(items) => items.into_iter().map(|item| masked(endpoint, item)).collect(),
        Value::Object(fields) => fields
            .into_iter()
            .map(|(name, field)| (endpoint.masked(&name), masked(endpoint, field)))
            .collect(),
        other => other,
    }
}

fn shortened(value: &Value) -> Value {
    match value.as_str() {
        Some(text) if text.len() > LONGEST_TEXT => {
            json!(format!("blake3:{}", blake3::hash(text.as_bytes())))
        }
        _ => value.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scripted::{Reaction, Server};
    use crate::{ApiKey, ChatSettings};

    const KEY: &str = "sk-very-secret";

    fn client(server: &Server) -> HttpClient {
        let endpoint = Endpoint::new(&server.base_url(), ApiKey::new(KEY)).unwrap();
        HttpClient::new(endpoint, ChatSettings::new("m"))
    }

    #[test]
    fn facts_are_copied_and_secrets_are_not() {
        let server = Server::start(|request| match &*request.line {
            "GET /v1/models HTTP/1.1" => Reaction::json(
                200,
                &json!({"data": [
                    {"id": "l", "owned_by": "us"},
                    {"id": "m", "owned_by": "them", "max_model_len": 4096, "created": 7, "secret": KEY},
                ]}),
            )
            .with("Server: uvicorn"),
            "GET /version HTTP/1.1" => Reaction::json(200, &json!({"version": "0.11"})),
            "GET /props HTTP/1.1" => Reaction::json(
                200,
                &json!({"chat_template": "x".repeat(201), "api_key": KEY, "build_info": "b1",
                        "model_path": format!("/models/{KEY}")}),
            ),
            "GET /get_server_info HTTP/1.1" => Reaction::json(200, &json!("up")),
            _ => Reaction::json(404, &json!({"version": "of nothing"})),
        })
        .unwrap();
        let client = client(&server);
        let (mut fingerprint, models) = models(&client).unwrap();
        assert_eq!(models, ModelList::Listed(vec!["l".into(), "m".into()]));
        read_pages(&client, &mut fingerprint);
        let written = serde_json::to_string_pretty(&fingerprint).unwrap();
        insta::assert_snapshot!(written, @r#"
        {
          "server": "uvicorn",
          "model": {
            "id": "m",
            "max_model_len": 4096,
            "owned_by": "them"
          },
          "pages": {
            "/props/build_info": "b1",
            "/props/chat_template": "blake3:797a6886ee23af6719817aacb898d54a4656a575c3cd9113d3027b4f60b891ee",
            "/props/model_path": "/models/[key]",
            "/version/version": "0.11"
          }
        }
        "#);
        assert!(!written.contains(KEY));
    }

    #[test]
    fn a_server_without_these_pages_has_an_empty_fingerprint() {
        for (turn, expected) in [
            (
                Reaction::json(404, &json!({"detail": "Not Found"})),
                ModelList::Refused(404, "Not Found".into()),
            ),
            (Reaction::json(200, &json!([])), ModelList::Unreadable),
            (
                Reaction::Answer { status: 200, headers: vec![], body: "<html>".into() },
                ModelList::Unreadable,
            ),
        ] {
            let server = Server::start(move |_| turn.clone()).unwrap();
            let client = client(&server);
            let (mut fingerprint, models) = models(&client).unwrap();
            assert_eq!(models, expected);
            read_pages(&client, &mut fingerprint);
            assert_eq!(fingerprint, Fingerprint::default());
        }
        let gone = Server::turns([]).unwrap();
        let client = client(&gone);
        drop(gone);
        assert!(matches!(models(&client), Err(Transient::Unreachable(_))));
    }
}

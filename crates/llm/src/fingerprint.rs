//! What can be known about whoever serves a model, since it moves scores: the software, its version, which
//! file it loaded, how long a prompt may be. Data for a manifest, not for a decision.
//!
//! Only fields that are known to be harmless are taken over: some servers list their own keys on these pages.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::client::Client;
use super::error::Passing;
use super::reply;

/// Longest that a page of the server's may take.
const PATIENCE: Duration = Duration::from_secs(10);

/// Fields of the list of models: the interface's own; vLLM; hosted ones; llama.cpp.
const MODEL_FIELDS: [&str; 6] =
    ["id", "owned_by", "root", "max_model_len", "context_length", "meta"];

/// Pages of the server's own, and what is taken from them.
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

/// Longer texts, such as a chat template, are named by their hash.
const LONGEST_TEXT: usize = 200;

/// Who serves a model.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Fingerprint {
    /// What the server calls itself in its answers' headers.
    pub server: Option<String>,
    /// What the list of models says about the one that is asked; `None` when it is not in it.
    pub model: Option<Value>,
    /// What the server's own pages say, by page and field; empty when nobody asked for them.
    pub pages: BTreeMap<String, Value>,
}

/// The list of models.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Models {
    /// Their names.
    Listed(Vec<String>),
    /// The server does not want to say: the status, and its message.
    Refused(u16, String),
    /// Something else came.
    Unreadable,
}

/// The cheap part: one request, for the list of models. What cannot be had is left out.
pub fn of(client: &Client) -> Fingerprint {
    models(client).map_or_else(|_| Fingerprint::default(), |(fingerprint, _)| fingerprint)
}

/// The same, and what the list of models says.
pub(super) fn models(client: &Client) -> Result<(Fingerprint, Models), Passing> {
    let page = client.get(&client.endpoint().page("/models"), PATIENCE)?;
    let mut fingerprint = Fingerprint { server: page.server, ..Fingerprint::default() };
    if page.status != 200 {
        let message = reply::error_message(page.body.as_bytes());
        return Ok((fingerprint, Models::Refused(page.status, message)));
    }
    let list: Value = serde_json::from_str(&page.body).unwrap_or_default();
    let Some(models) = list["data"].as_array() else {
        return Ok((fingerprint, Models::Unreadable));
    };
    let name = |model: &Value| model["id"].as_str().map(str::to_owned);
    let asked = models.iter().find(|model| model["id"] == client.settings().model);
    fingerprint.model = asked.map(|model| {
        let fields = MODEL_FIELDS.iter().filter(|field| !model[**field].is_null());
        fields.map(|field| ((*field).to_owned(), model[*field].clone())).collect()
    });
    Ok((fingerprint, Models::Listed(models.iter().filter_map(name).collect())))
}

/// Adds what the server's own pages say, of which it has some or none.
pub(super) fn read_pages(client: &Client, fingerprint: &mut Fingerprint) {
    for (path, fields) in PAGES {
        let Ok(page) = client.get(&client.endpoint().server_page(path), PATIENCE) else { continue };
        let Ok(facts) = serde_json::from_str::<Value>(&page.body) else { continue };
        for field in fields.iter().filter(|_| page.status == 200) {
            if let Some(value) = facts.pointer(field).filter(|value| !value.is_null()) {
                fingerprint.pages.insert(format!("{path}{field}"), shortened(value));
            }
        }
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
    use super::super::client::Settings;
    use super::super::endpoint::Endpoint;
    use super::super::scripted::{Server, Turn};
    use super::super::secret::Secret;
    use super::*;

    const KEY: &str = "sk-very-secret";

    fn client(server: &Server) -> Client {
        let endpoint = Endpoint::new(&server.base_url(), Secret::new(KEY)).unwrap();
        let timeout = Duration::from_secs(60);
        Client::new(endpoint, Settings { model: "m".into(), timeout, max_retries: 0 })
    }

    #[test]
    fn what_servers_tell_about_themselves() {
        let server = Server::start(|request| match &*request.line {
            "GET /v1/models HTTP/1.1" => Turn::json(
                200,
                &json!({"data": [
                    {"id": "l", "owned_by": "us"},
                    {"id": "m", "owned_by": "them", "max_model_len": 4096, "created": 7, "secret": KEY},
                ]}),
            )
            .with("Server: uvicorn"),
            "GET /version HTTP/1.1" => Turn::json(200, &json!({"version": "0.11"})),
            "GET /props HTTP/1.1" => Turn::json(
                200,
                &json!({"chat_template": "x".repeat(201), "api_key": KEY, "build_info": "b1",
                        "model_path": format!("/models/{KEY}")}),
            ),
            "GET /get_server_info HTTP/1.1" => Turn::json(200, &json!("up")),
            _ => Turn::json(404, &json!({"version": "of nothing"})),
        })
        .unwrap();
        let client = client(&server);
        let (mut fingerprint, models) = models(&client).unwrap();
        assert_eq!(models, Models::Listed(vec!["l".into(), "m".into()]));
        assert_eq!(of(&client), fingerprint);
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
    fn a_server_without_such_pages_is_none_the_worse() {
        for (turn, expected) in [
            (
                Turn::json(404, &json!({"detail": "Not Found"})),
                Models::Refused(404, "Not Found".into()),
            ),
            (Turn::json(200, &json!([])), Models::Unreadable),
            (
                Turn::Answer { status: 200, headers: vec![], body: "<html>".into() },
                Models::Unreadable,
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
        assert_eq!(of(&client), Fingerprint::default());
    }
}

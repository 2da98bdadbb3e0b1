//! A proxy between a run and a model's server, which writes down what passes: an account of requests and replies that is
//! neither the client's nor the server's.

use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::sync::atomic::{AtomicUsize, Ordering::SeqCst};
use std::sync::{Arc, Mutex, PoisonError};

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use png_file::RgbaImage;
use rigs::chat_server::{Reaction, Received, Server};
use serde_json::Value;

/// A part of a message: adjacent texts of a message are one part.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum MessagePart {
    /// A text, after the message's role.
    Text(String, String),
    /// An image, by the hash of its pixels: the first 16 bytes of BLAKE3 of red, green, blue and alpha, in hexadecimal.
    Image(String),
}

/// A chat completion that was answered.
#[derive(Debug, Clone)]
pub struct PassedRequest {
    /// The parts of all messages, in order.
    pub parts: Vec<MessagePart>,
    /// Requests under way when it came, itself included.
    pub in_flight: usize,
    /// The HTTP status.
    pub status: u16,
    /// The body of the answer.
    pub reply: Value,
}

impl PassedRequest {
    /// Number of images.
    pub fn images(&self) -> usize {
        self.parts.iter().filter(|part| matches!(part, MessagePart::Image(_))).count()
    }
}

/// A running proxy.
pub struct LoggingProxy {
    front: Server,
    passed: Arc<Mutex<Vec<PassedRequest>>>,
}

impl LoggingProxy {
    /// A proxy in front of the server at `address`, a host and a port.
    pub fn start(address: &str) -> Self {
        let address = address.to_owned();
        let passed = Arc::<Mutex<Vec<PassedRequest>>>::default();
        let (log, in_flight) = (Arc::clone(&passed), AtomicUsize::new(0));
        let front = Server::concurrent(move |request| {
            let now = 1 + in_flight.fetch_add(1, SeqCst);
            let answered = forward(&address, request);
            in_flight.fetch_sub(1, SeqCst);
            let Ok((status, headers, body)) = answered else { return Reaction::Close };
            if request.line.starts_with("POST ") && request.line.contains("/chat/completions") {
                let reply = serde_json::from_str(&body).unwrap_or(Value::Null);
                let parts = parts(&request.body);
                let passed = PassedRequest { parts, in_flight: now, status, reply };
                log.lock().unwrap_or_else(PoisonError::into_inner).push(passed);
            }
            Reaction::Answer { status, headers, body }
        });
        Self { front: front.expect("a free port"), passed }
    }

    /// The base URL, up to `/v1`.
    pub fn base_url(&self) -> String {
        self.front.base_url()
    }

    /// What passed since the last call.
    pub fn take(&self) -> Vec<PassedRequest> {
        std::mem::take(&mut self.passed.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Sends a request to `address` on a connection of its own. Returns status, header lines and body.
fn forward(address: &str, request: &Received) -> io::Result<(u16, Vec<String>, String)> {
    let body = if request.body.is_null() { String::new() } else { request.body.to_string() };
    let mut stream = TcpStream::connect(address)?;
    let head = format!(
        "{}\r\nHost: {address}\r\nConnection: close\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n",
        request.line,
        body.len()
    );
    stream.write_all((head + &body).as_bytes())?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    let broken = || io::Error::from(io::ErrorKind::UnexpectedEof);
    let (head, body) = answer.split_once("\r\n\r\n").ok_or_else(broken)?;
    let mut lines = head.lines();
    let status = lines.next().and_then(|line| line.split(' ').nth(1)?.parse().ok());
    let of_the_message = |line: &&str| {
        let name = line.split(':').next().unwrap_or_default().to_lowercase();
        assert_ne!(name, "transfer-encoding", "the proxy does not read chunks");
        !["connection", "content-length", "keep-alive"].contains(&&*name)
    };
    let headers = lines.filter(of_the_message).map(str::to_owned).collect();
    Ok((status.ok_or_else(broken)?, headers, body.to_owned()))
}

/// The parts of the messages of a request's body.
pub fn parts(body: &Value) -> Vec<MessagePart> {
    let mut parts = Vec::new();
    for message in body["messages"].as_array().into_iter().flatten() {
        let role = message["role"].as_str().unwrap_or_default();
        match &message["content"] {
            Value::String(text) => add_text(&mut parts, role, text),
            content => {
                for part in content.as_array().into_iter().flatten() {
                    match part["image_url"]["url"].as_str() {
                        Some(url) => parts.push(MessagePart::Image(pixel_hash(url))),
                        None => {
                            add_text(&mut parts, role, part["text"].as_str().unwrap_or_default())
                        }
                    }
                }
            }
        }
    }
    parts
}

/// Appends a text to the last part if that is a text of the same role, else adds a part.
pub fn add_text(parts: &mut Vec<MessagePart>, role: &str, text: &str) {
    match parts.last_mut() {
        Some(MessagePart::Text(of, so_far)) if of == role => so_far.push_str(text),
        _ => parts.push(MessagePart::Text(role.to_owned(), text.to_owned())),
    }
}

/// The hash of the pixels of a PNG image in a data URL.
fn pixel_hash(url: &str) -> String {
    let (_, data) = url.split_once("base64,").expect("a data URL");
    let file = BASE64_STANDARD.decode(data).expect("base64");
    hash_of(&RgbaImage::decode(&file).expect("a PNG image"))
}

/// The name of an image in a prompt log.
pub fn hash_of(image: &RgbaImage) -> String {
    blake3::hash(image.as_bytes()).to_hex()[..32].to_owned()
}

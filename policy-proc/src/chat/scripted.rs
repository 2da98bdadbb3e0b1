//! A chat server that follows a script, for tests: real sockets, no model.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use serde_json::{Value, json};

/// A request as the server saw it.
#[derive(Debug, Clone, PartialEq)]
pub struct Received {
    /// Method and path.
    pub line: String,
    /// Header lines as they came.
    pub headers: Vec<String>,
    /// The body.
    pub body: Value,
}

/// What the server does about a request.
#[derive(Debug, Clone)]
pub enum Turn {
    /// Answers.
    Answer {
        /// The HTTP status.
        status: u16,
        /// Further header lines.
        headers: Vec<String>,
        /// The body.
        body: String,
    },
    /// Promises this body and sends the first half of it.
    Half(String),
    /// Says nothing, and keeps the connection.
    Hang,
    /// Closes the connection.
    Close,
}

impl Turn {
    /// An answer in JSON.
    pub fn json(status: u16, body: &Value) -> Self {
        let headers = vec!["Content-Type: application/json".to_owned()];
        Self::Answer { status, headers, body: body.to_string() }
    }

    /// A model called `scripted` that says `text`: 10 tokens of prompt, 5 of answer.
    pub fn says(text: &str) -> Self {
        Self::json(200, &completion(text))
    }

    /// The same with a further header line.
    #[must_use]
    pub fn with(mut self, header: &str) -> Self {
        if let Self::Answer { headers, .. } = &mut self {
            headers.push(header.to_owned());
        }
        self
    }
}

/// A completion in full.
pub fn completion(text: &str) -> Value {
    json!({
        "id": "1", "object": "chat.completion", "model": "scripted",
        "choices": [{"index": 0, "message": {"role": "assistant", "content": text}, "finish_reason": "stop"}],
        "usage": {"prompt_tokens": 10, "completion_tokens": 5, "total_tokens": 15},
    })
}

/// A server on a port of its own, until it is dropped. It takes one request from each connection.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    received: Arc<Mutex<Vec<Received>>>,
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Starts a server that does about each request what `script` says.
    ///
    /// # Errors
    /// When there is no port to listen on.
    pub fn start(mut script: impl FnMut(&Received) -> Turn + Send + 'static) -> io::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let address = listener.local_addr()?;
        let (received, over) =
            (Arc::<Mutex<Vec<Received>>>::default(), Arc::new(AtomicBool::new(false)));
        let (log, ends) = (Arc::clone(&received), Arc::clone(&over));
        let thread = thread::spawn(move || {
            let mut hanging = Vec::new();
            for stream in listener.incoming() {
                if ends.load(Ordering::SeqCst) {
                    break;
                }
                // A client that has gone is its own affair, and some scripts are about that.
                let Ok(stream) = stream else { continue };
                let Ok(request) = read(&stream) else { continue };
                log.lock().unwrap_or_else(PoisonError::into_inner).push(request.clone());
                if let Ok(Some(stream)) = answer(stream, script(&request)) {
                    hanging.push(stream);
                }
            }
        });
        Ok(Self { address, received, over, thread: Some(thread) })
    }

    /// A server that takes one turn after the other, and closes connections when there are none left.
    ///
    /// # Errors
    /// When there is no port to listen on.
    pub fn turns(turns: impl IntoIterator<Item = Turn>) -> io::Result<Self> {
        let mut turns = turns.into_iter().collect::<Vec<_>>().into_iter();
        Self::start(move |_| turns.next().unwrap_or(Turn::Close))
    }

    /// What to pass as the base URL.
    pub fn base_url(&self) -> String {
        format!("http://{}/v1", self.address)
    }

    /// The requests so far, in order.
    pub fn received(&self) -> Vec<Received> {
        self.received.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.over.store(true, Ordering::SeqCst);
        // Wakes the thread; that nobody listens any more means that it has ended already.
        drop(TcpStream::connect(self.address));
        if let Some(thread) = self.thread.take() {
            // A script that panicked has failed its test by answering nothing.
            drop(thread.join());
        }
    }
}

fn read(stream: &TcpStream) -> io::Result<Received> {
    let mut reader = BufReader::new(stream);
    let mut lines = Vec::new();
    loop {
        let mut line = String::new();
        reader.read_line(&mut line)?;
        match line.trim_end() {
            "" => break,
            line => lines.push(line.to_owned()),
        }
    }
    if lines.is_empty() {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    let headers = lines.split_off(1);
    let length = headers.iter().find_map(|header| {
        let (name, value) = header.split_once(':')?;
        name.eq_ignore_ascii_case("content-length").then(|| value.trim().parse().ok())?
    });
    let mut body = vec![0; length.unwrap_or(0)];
    reader.read_exact(&mut body)?;
    let body = serde_json::from_slice(&body).unwrap_or(Value::Null);
    Ok(Received { line: lines.concat(), headers, body })
}

/// Takes a turn; the stream when it is to hang.
fn answer(mut stream: TcpStream, turn: Turn) -> io::Result<Option<TcpStream>> {
    let (status, headers, body, sent) = match turn {
        Turn::Hang => return Ok(Some(stream)),
        Turn::Close => return Ok(None),
        Turn::Half(body) => {
            (200, vec!["Content-Type: application/json".to_owned()], body.clone(), body.len() / 2)
        }
        Turn::Answer { status, headers, body } => {
            let sent = body.len();
            (status, headers, body, sent)
        }
    };
    write!(
        stream,
        "HTTP/1.1 {status} Status\r\nContent-Length: {}\r\nConnection: close\r\n",
        body.len()
    )?;
    for header in headers {
        write!(stream, "{header}\r\n")?;
    }
    stream.write_all(b"\r\n")?;
    stream.write_all(&body.as_bytes()[..sent])?;
    Ok(None)
}

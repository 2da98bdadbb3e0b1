//! A chat server that follows a script, for tests: real sockets, no model.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use serde_json::{Value, json};

/// A request as the server received it.
#[derive(Debug, Clone, PartialEq)]
pub struct Received {
    /// Method and path.
    pub line: String,
    /// The header lines.
    pub headers: Vec<String>,
    /// The body.
    pub body: Value,
}

/// How the server reacts to a request.
#[derive(Debug, Clone)]
pub enum Reaction {
    /// Sends a response.
    Answer {
        /// The HTTP status.
        status: u16,
        /// Further header lines.
        headers: Vec<String>,
        /// The body.
        body: String,
    },
    /// Sends a response with status 200 whose body is no text.
    Bytes {
        /// Further header lines.
        headers: Vec<String>,
        /// The body.
        body: Vec<u8>,
    },
    /// Announces this body and sends the first half of it.
    Half(String),
    /// Sends this body a byte at a time, and announces one byte more.
    Trickle(String),
    /// Sends nothing and keeps the connection open.
    Hang,
    /// Closes the connection.
    Close,
}

impl Reaction {
    /// A JSON response.
    pub fn json(status: u16, body: &Value) -> Self {
        let headers = vec!["Content-Type: application/json".to_owned()];
        Self::Answer { status, headers, body: body.to_string() }
    }

    /// A reply of the model `scripted`: 10 prompt tokens, 5 completion tokens.
    pub fn says(text: &str) -> Self {
        Self::json(200, &completion(text))
    }

    /// The response with another header line.
    #[must_use]
    pub fn with(mut self, header: &str) -> Self {
        if let Self::Answer { headers, .. } = &mut self {
            headers.push(header.to_owned());
        }
        self
    }
}

/// A complete response body.
pub fn completion(text: &str) -> Value {
    json!({
        "id": "1", "object": "chat.completion", "model": "scripted",
        "choices": [{"index": 0, "message": {"role": "assistant", "content": text}, "finish_reason": "stop"}],
        "usage": {"prompt_tokens": 10, "completion_tokens": 5, "total_tokens": 15},
    })
}

/// A server on a free port, until it is dropped. Each connection has a thread.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    log: Arc<ServerLog>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct ServerLog {
    received: Mutex<Vec<Received>>,
    connections: Mutex<Vec<TcpStream>>,
    over: AtomicBool,
}

impl Server {
    /// Starts a server that calls `script` for each request, one at a time.
    ///
    /// # Errors
    /// When no port is free.
    pub fn start(script: impl FnMut(&Received) -> Reaction + Send + 'static) -> io::Result<Self> {
        let script = Mutex::new(script);
        Self::concurrent(move |request| {
            let mut script = script.lock().unwrap_or_else(PoisonError::into_inner);
            script(request)
        })
    }

    /// Starts a server that calls `script` for several requests at once, so the script may block.
    ///
    /// # Errors
    /// When no port is free.
    pub fn concurrent(
        script: impl Fn(&Received) -> Reaction + Send + Sync + 'static,
    ) -> io::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let address = listener.local_addr()?;
        let (log, script) = (Arc::<ServerLog>::default(), Arc::new(script));
        let accepting = Arc::clone(&log);
        let thread = thread::spawn(move || {
            for stream in listener.incoming() {
                if accepting.over.load(Ordering::SeqCst) {
                    break;
                }
                // A client may have closed the connection; some scripts are about that.
                let Ok(stream) = stream else { continue };
                let Ok(shared) = stream.try_clone() else { continue };
                accepting.connections.lock().unwrap_or_else(PoisonError::into_inner).push(shared);
                let (log, script) = (Arc::clone(&accepting), Arc::clone(&script));
                thread::spawn(move || serve(&stream, &log, &*script));
            }
        });
        Ok(Self { address, log, thread: Some(thread) })
    }

    /// Starts a server that takes these turns in order, then closes connections.
    ///
    /// # Errors
    /// When no port is free.
    pub fn turns(turns: impl IntoIterator<Item = Reaction>) -> io::Result<Self> {
        let mut turns = turns.into_iter().collect::<Vec<_>>().into_iter();
        Self::start(move |_| turns.next().unwrap_or(Reaction::Close))
    }

    /// The base URL.
    pub fn base_url(&self) -> String {
        format!("http://{}/v1", self.address)
    }

    /// The requests so far.
    pub fn received(&self) -> Vec<Received> {
        self.log.received.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Number of connections so far.
    pub fn connections(&self) -> usize {
        self.log.connections.lock().unwrap_or_else(PoisonError::into_inner).len()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.log.over.store(true, Ordering::SeqCst);
        // Wakes the accepting thread; an error means that it has ended.
        drop(TcpStream::connect(self.address));
        if let Some(thread) = self.thread.take() {
            drop(thread.join());
        }
        let connections = self.log.connections.lock().unwrap_or_else(PoisonError::into_inner);
        for connection in connections.iter() {
            // An error means that the client has closed it.
            drop(connection.shutdown(Shutdown::Both));
        }
    }
}

/// Serves a connection until either side closes it. A script that panics answers nothing, and so fails its test.
fn serve(
    stream: &TcpStream,
    log: &ServerLog,
    script: &(dyn Fn(&Received) -> Reaction + Send + Sync),
) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let mut reader = BufReader::new(stream);
    loop {
        let request = read(&mut reader)?;
        log.received.lock().unwrap_or_else(PoisonError::into_inner).push(request.clone());
        answer(stream, script(&request))?;
    }
}

fn read(reader: &mut impl BufRead) -> io::Result<Received> {
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

/// Takes a turn; returns an error to end the connection.
fn answer(mut stream: &TcpStream, turn: Reaction) -> io::Result<()> {
    let json = || vec!["Content-Type: application/json".to_owned()];
    let over = || io::Error::from(io::ErrorKind::ConnectionAborted);
    match turn {
        Reaction::Answer { status, headers, body } => {
            stream.write_all((head(status, &headers, body.len()) + &body).as_bytes())
        }
        Reaction::Bytes { headers, body } => {
            stream.write_all(head(200, &headers, body.len()).as_bytes())?;
            stream.write_all(&body)
        }
        Reaction::Half(body) => {
            let answer = head(200, &json(), body.len()) + &body[..body.len() / 2];
            stream.write_all(answer.as_bytes())?;
            stream.shutdown(Shutdown::Both)?;
            Err(over())
        }
        Reaction::Trickle(body) => {
            stream.write_all(head(200, &json(), body.len() + 1).as_bytes())?;
            for byte in body.into_bytes() {
                stream.write_all(&[byte])?;
                thread::sleep(TRICKLE);
            }
            await_close(stream)
        }
        Reaction::Hang => await_close(stream),
        Reaction::Close => {
            stream.shutdown(Shutdown::Both)?;
            Err(over())
        }
    }
}

/// The pause between trickled bytes.
const TRICKLE: Duration = Duration::from_millis(20);

fn head(status: u16, headers: &[String], length: usize) -> String {
    let headers: String = headers.iter().map(|header| format!("{header}\r\n")).collect();
    format!("HTTP/1.1 {status} Status\r\nContent-Length: {length}\r\n{headers}\r\n")
}

/// Waits until the client closes the connection.
fn await_close(mut stream: &TcpStream) -> io::Result<()> {
    while stream.read(&mut [0; 64])? > 0 {}
    Err(io::ErrorKind::ConnectionAborted.into())
}

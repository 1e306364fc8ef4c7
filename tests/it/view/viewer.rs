//! A program with a live view, and a viewer without a browser.

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream};

/// A program with a live view; its SUMO goes with it.
pub struct Viewed {
    pub child: Child,
    /// `127.0.0.1:PORT`.
    pub address: String,
    pub said: mpsc::Receiver<String>,
}

impl Viewed {
    pub fn start(args: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_wad-cosim"))
            .args(args)
            .args(["--view", "127.0.0.1:0"])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .process_group(0)
            .spawn()
            .expect("the binary runs");
        let lines = BufReader::new(child.stderr.take().expect("its stderr")).lines();
        let (sender, said) = mpsc::channel();
        std::thread::spawn(move || lines.map_while(Result::ok).for_each(|line| drop(sender.send(line))));
        let mut all = String::new();
        let address = loop {
            let line =
                said.recv_timeout(Duration::from_secs(60)).unwrap_or_else(|_| panic!("no view: {all}"));
            if let Some(url) = line.strip_prefix("live view: http://") {
                break url.trim_end_matches('/').to_string();
            }
            all += &line;
        };
        Self { child, address, said }
    }

    pub fn url(&self) -> String {
        format!("http://{}/", self.address)
    }

    pub fn said(&self, text: &str) -> bool {
        let until = Instant::now() + Duration::from_secs(10);
        while let Ok(line) = self.said.recv_timeout(until.saturating_duration_since(Instant::now())) {
            if line.contains(text) {
                return true;
            }
        }
        false
    }

    /// Ctrl-C, and its exit code.
    pub fn stop(mut self) -> Option<i32> {
        if let Ok(pid) = i32::try_from(self.child.id()) {
            // SAFETY: kill() only takes numbers; the process is this test's own.
            unsafe { libc::kill(pid, libc::SIGINT) };
        }
        self.child.wait().expect("it ends").code()
    }
}

impl Drop for Viewed {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A viewer without a browser.
pub struct Viewer {
    pub runtime: tokio::runtime::Runtime,
    pub socket: WebSocketStream<MaybeTlsStream<tokio::net::TcpStream>>,
    pub hello: Value,
}

impl Viewer {
    pub fn join(address: &str) -> Self {
        Self::join_at(&format!("ws://{address}/ws"))
    }

    pub fn join_at(url: &str) -> Self {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let began = Instant::now();
        let socket = loop {
            // The page opens when the town is built.
            match runtime.block_on(tokio_tungstenite::connect_async(url)) {
                Ok((socket, _)) => break socket,
                Err(error) => assert!(began.elapsed() < Duration::from_secs(60), "{error}"),
            }
            std::thread::sleep(Duration::from_millis(50));
        };
        let mut viewer = Self { runtime, socket, hello: Value::Null };
        viewer.hello = viewer.text();
        assert_eq!(viewer.hello["type"], "hello");
        viewer
    }

    pub fn receive(&mut self) -> Option<Result<Message, Error>> {
        let limit = Duration::from_secs(20);
        let socket = &mut self.socket;
        self.runtime
            .block_on(async { tokio::time::timeout(limit, socket.next()).await })
            .expect("a message within 20 s")
    }

    pub fn text(&mut self) -> Value {
        match self.receive() {
            Some(Ok(Message::Text(text))) => serde_json::from_str(&text).expect("JSON"),
            other => panic!("{other:?}"),
        }
    }

    /// Who has the wheel, by the next heartbeat that says so.
    pub fn until_holder(&mut self, holder: &Value) {
        let began = Instant::now();
        loop {
            match self.receive() {
                Some(Ok(Message::Text(text))) => {
                    let said: Value = serde_json::from_str(&text).expect("JSON");
                    if said["type"] == "beat" && said["holder"] == *holder {
                        return;
                    }
                }
                Some(Ok(Message::Binary(_))) => self.send(json!({ "do": "shown", "seq": 0 })),
                Some(Ok(_)) => {}
                other => panic!("{other:?}"),
            }
            assert!(began.elapsed() < Duration::from_secs(30), "never held by {holder}");
        }
    }

    /// The state that the next tick shows, and its pictures.
    pub fn tick(&mut self) -> (Value, Vec<u8>) {
        loop {
            match self.receive() {
                Some(Ok(Message::Binary(bytes))) => {
                    let length = u32::from_le_bytes(bytes[..4].try_into().expect("a length")) as usize;
                    let state: Value = serde_json::from_slice(&bytes[4..4 + length]).expect("JSON");
                    self.send(json!({ "do": "shown", "seq": state["seq"] }));
                    return (state, bytes[4 + length..].to_vec());
                }
                Some(Ok(_)) => {}
                other => panic!("{other:?}"),
            }
        }
    }

    pub fn until(&mut self, what: &str, is: impl Fn(&Value) -> bool) -> Value {
        let began = Instant::now();
        loop {
            let (state, _) = self.tick();
            if is(&state) {
                return state;
            }
            assert!(began.elapsed() < Duration::from_secs(30), "never {what}: {state}");
        }
    }

    pub fn send(&mut self, request: Value) {
        self.send_raw(Message::text(request.to_string()));
    }

    pub fn send_raw(&mut self, message: Message) {
        let socket = &mut self.socket;
        // One that was sent away finds out when it listens.
        let _ = self.runtime.block_on(socket.send(message));
    }

    pub fn drive(&mut self, steer: f64, throttle: f64) {
        self.send(json!({ "do": "drive", "steer": steer, "throttle": throttle, "brake": 0 }));
    }

    /// Whether the server ends the connection.
    pub fn is_sent_away(&mut self) -> bool {
        let began = Instant::now();
        while began.elapsed() < Duration::from_secs(10) {
            match self.receive() {
                Some(Ok(Message::Close(_)) | Err(_)) | None => return true,
                _ => {}
            }
        }
        false
    }
}

pub fn run_in(folder: &Path, extra: &[&str]) -> Viewed {
    let out = folder.join("run").display().to_string();
    let mut args = vec!["run", "town5", "--traffic", "8,8", "--seed", "3", "--out", &out];
    args.extend(extra);
    Viewed::start(&args)
}

/// The status line of a plain HTTP request.
pub fn request(address: &str, path: &str, headers: &str) -> String {
    let mut stream = TcpStream::connect(address).expect("it listens");
    let text = format!("GET {path} HTTP/1.1\r\n{headers}Connection: close\r\n\r\n");
    stream.write_all(text.as_bytes()).expect("it reads");
    let mut answer = String::new();
    let _ = stream.read_to_string(&mut answer);
    answer.lines().next().unwrap_or_default().to_string()
}

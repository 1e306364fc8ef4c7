//! A small client of the Chrome DevTools Protocol: enough to open pages, press keys and look.

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use tokio::net::TcpStream;
use tokio::runtime::Runtime;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream};

const NAMES: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
const FLAGS: [&str; 12] = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--disable-dev-shm-usage",
    "--mute-audio",
    "--remote-debugging-port=0",
];

/// A Chromium of this test's own.
pub struct Browser {
    child: Child,
    runtime: Runtime,
    socket: WebSocketStream<MaybeTlsStream<TcpStream>>,
    next: u64,
    /// What pages wrote to their consoles as errors or warnings, and what went wrong in them.
    pub complaints: Vec<String>,
    _profile: TempDir,
}

/// An open page.
#[derive(Clone)]
pub struct Page {
    session: String,
    target: String,
}

fn program() -> String {
    let own = std::env::var("WAD_COSIM_CHROMIUM").ok();
    let runs = |name: &String| {
        let answer = Command::new(name).arg("--version").stdin(Stdio::null()).output();
        answer.is_ok_and(|answer| answer.status.success())
    };
    own.into_iter().chain(NAMES.map(str::to_string)).find(runs).expect(
        "a Chromium that runs: `scripts/setup --test` installs Debian's, WAD_COSIM_CHROMIUM names another",
    )
}

impl Browser {
    pub fn start() -> Self {
        let profile = tempfile::tempdir().expect("a folder");
        let mut child = Command::new(program())
            .args(FLAGS)
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg("about:blank")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .process_group(0)
            .spawn()
            .expect("Chromium starts");
        let mut lines = BufReader::new(child.stderr.take().expect("its stderr")).lines();
        let mut said = String::new();
        let url = loop {
            let line =
                lines.next().unwrap_or_else(|| panic!("Chromium does not start: {said}")).expect("text");
            if let Some(url) = line.strip_prefix("DevTools listening on ") {
                break url.trim().to_string();
            }
            said += &line;
        };
        std::thread::spawn(move || lines.for_each(drop));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let config = WebSocketConfig::default().max_message_size(None).max_frame_size(None);
        let connecting = tokio_tungstenite::connect_async_with_config(url, Some(config), false);
        let (socket, _) = runtime.block_on(connecting).expect("Chromium's DevTools");
        Self { child, runtime, socket, next: 0, complaints: Vec::new(), _profile: profile }
    }

    fn command(&mut self, session: Option<&Page>, method: &str, params: Value) -> Value {
        let mut answer = self.try_command(session, method, params);
        assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
        answer["result"].take()
    }

    /// The whole answer, which may be an error.
    fn try_command(&mut self, session: Option<&Page>, method: &str, params: Value) -> Value {
        self.next += 1;
        let id = self.next;
        let mut message = json!({ "id": id, "method": method, "params": params });
        if let Some(page) = session {
            message["sessionId"] = json!(page.session);
        }
        let (socket, complaints) = (&mut self.socket, &mut self.complaints);
        let answer = async {
            socket.send(Message::text(message.to_string())).await.expect("Chromium listens");
            loop {
                let Message::Text(text) = socket.next().await.expect("Chromium answers").expect("a message")
                else {
                    continue;
                };
                let value: Value = serde_json::from_str(&text).expect("JSON");
                if value["id"] == id {
                    return value;
                }
                complaints.extend(complaint(value["method"].as_str().unwrap_or(""), &value["params"]));
            }
        };
        let limit = Duration::from_secs(30);
        self.runtime
            .block_on(async { tokio::time::timeout(limit, answer).await })
            .unwrap_or_else(|_| panic!("no answer to {method}"))
    }

    /// A page of that size, at `url`.
    pub fn open(&mut self, url: &str, (width, height): (u32, u32)) -> Page {
        let target = self.command(None, "Target.createTarget", json!({ "url": "about:blank" }));
        let target = target["targetId"].as_str().expect("an id").to_string();
        let params = json!({ "targetId": target, "flatten": true });
        let session = self.command(None, "Target.attachToTarget", params);
        let page = Page { session: session["sessionId"].as_str().expect("an id").to_string(), target };
        for domain in ["Runtime.enable", "Page.enable", "Log.enable"] {
            self.command(Some(&page), domain, json!({}));
        }
        let size = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": false });
        self.command(Some(&page), "Emulation.setDeviceMetricsOverride", size);
        self.command(Some(&page), "Page.navigate", json!({ "url": url }));
        page
    }

    pub fn reload(&mut self, page: &Page) {
        self.command(Some(page), "Page.reload", json!({}));
    }

    pub fn close(&mut self, page: &Page) {
        self.command(None, "Target.closeTarget", json!({ "targetId": page.target }));
    }

    /// The value of a JavaScript expression.
    pub fn ask(&mut self, page: &Page, expression: &str) -> Value {
        let params = json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let mut answer = self.command(Some(page), "Runtime.evaluate", params);
        assert!(answer["exceptionDetails"].is_null(), "{expression}: {}", answer["exceptionDetails"]);
        answer["result"]["value"].take()
    }

    /// Waits until an expression is true. It may fail meanwhile: the page is being loaded.
    pub fn wait(&mut self, page: &Page, expression: &str) {
        let began = Instant::now();
        let params = json!({ "expression": format!("Boolean({expression})"), "returnByValue": true });
        while self.try_command(Some(page), "Runtime.evaluate", params.clone())["result"]["result"]["value"]
            != true
        {
            assert!(began.elapsed() < Duration::from_secs(30), "never true: {expression}");
            std::thread::sleep(Duration::from_millis(30));
        }
    }

    /// Presses or releases a key.
    pub fn key(&mut self, page: &Page, key: &str, code: &str, down: bool) {
        let kind = if down { "keyDown" } else { "keyUp" };
        let params = json!({ "type": kind, "key": key, "code": code });
        self.command(Some(page), "Input.dispatchKeyEvent", params);
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        if let Ok(group) = i32::try_from(self.child.id()) {
            // SAFETY: kill() only takes numbers; the group is this browser's own.
            unsafe { libc::kill(-group, libc::SIGKILL) };
        }
        let _ = self.child.wait();
    }
}

/// What a console says that no page should say.
fn complaint(method: &str, params: &Value) -> Option<String> {
    match method {
        "Runtime.exceptionThrown" => Some(params["exceptionDetails"].to_string()),
        "Runtime.consoleAPICalled"
            if ["error", "warning", "assert"].iter().any(|kind| params["type"] == *kind) =>
        {
            Some(params["args"].to_string())
        }
        "Log.entryAdded" if params["entry"]["level"] == "error" || params["entry"]["level"] == "warning" => {
            Some(params["entry"].to_string())
        }
        _ => None,
    }
}

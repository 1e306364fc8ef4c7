//! The web server: the page, the street map, and a WebSocket for each viewer.

use super::guard::{Budget, Guard, Refusal, Token};
use super::hub::{Hub, Viewer};
use super::protocol::{LONGEST_REQUEST, Request};
use crate::cores::Cores;
use axum::Router;
use axum::extract::ws::{CloseFrame, Message, Utf8Bytes, WebSocket, WebSocketUpgrade, close_code};
use axum::extract::{Request as HttpRequest, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use bytes::Bytes;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use serde_json::json;
use std::collections::VecDeque;
use std::net::{SocketAddr, TcpListener};
use std::str::FromStr;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio::task::JoinHandle;

/// Why the live view cannot start.
#[derive(Debug, thiserror::Error)]
pub enum ViewError {
    /// The port is in use.
    #[error("{address} is in use already, perhaps by another run; {}", free_port(*.free))]
    Busy {
        /// The address.
        address: SocketAddr,
        /// A free port near by.
        free: Option<SocketAddr>,
    },
    /// The address cannot be listened on.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The cause.
        source: std::io::Error,
    },
    /// The address is open to other machines, and there is no token.
    #[error(
        "{address} can be reached from other machines: give a secret that viewers must know with --view-token, or stay \
         on 127.0.0.1"
    )]
    Open {
        /// The address.
        address: SocketAddr,
    },
    /// The view's thread cannot be started.
    #[error("the view's thread cannot be started: {0}")]
    Thread(std::io::Error),
    /// The camera cannot be made.
    #[error(transparent)]
    Camera(#[from] crate::camera::CameraError),
    /// Perception cannot be made.
    #[error(transparent)]
    Perception(#[from] crate::perception::PerceptionError),
}

fn free_port(free: Option<SocketAddr>) -> String {
    free.map_or("name another with --view HOST:PORT".to_string(), |free| {
        format!("{free} is free: --view {free}")
    })
}

/// `--view`'s value: where to listen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewAddress(pub SocketAddr);

impl FromStr for ViewAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let local = |port: &str| port.parse().ok().map(|port| SocketAddr::from(([127, 0, 0, 1], port)));
        let named = text.strip_prefix("localhost:").and_then(local);
        (text.parse().ok().or(named).or_else(|| local(text))).map(Self).ok_or_else(|| {
            format!(
                "`{text}` is not an address: expected HOST:PORT with an IP address or localhost, e.g. 127.0.0.1:8765, or a \
                 port (CONFIG goes before --view)"
            )
        })
    }
}

/// A bound port, taken before anything else is done.
pub struct Listener {
    listener: TcpListener,
    address: SocketAddr,
    guard: Guard,
    cores: Option<Cores>,
}

impl Listener {
    /// Listens on `address`.
    ///
    /// # Errors
    /// The port is in use ([`ViewError::Busy`] names a free one near by), or the address is open to other machines and
    /// there is no token.
    pub fn bind(address: ViewAddress, token: Option<Token>) -> Result<Self, ViewError> {
        let address = address.0;
        let loopback = address.ip().is_loopback();
        if !loopback && token.is_none() {
            return Err(ViewError::Open { address });
        }
        let listener = TcpListener::bind(address).map_err(|source| match source.kind() {
            std::io::ErrorKind::AddrInUse => ViewError::Busy { address, free: next_free(address) },
            _ => ViewError::Listen { address, source },
        })?;
        let fail = |source| ViewError::Listen { address, source };
        listener.set_nonblocking(true).map_err(fail)?;
        let address = listener.local_addr().map_err(fail)?;
        Ok(Self { listener, address, guard: Guard { loopback, token }, cores: Cores::allowed() })
    }

    /// The page's address.
    pub fn url(&self) -> String {
        let mut shown = self.address;
        if shown.ip().is_unspecified() {
            shown.set_ip(std::net::Ipv4Addr::LOCALHOST.into());
        }
        match &self.guard.token {
            Some(token) => format!("http://{shown}/?token={}", token.as_str()),
            None => format!("http://{shown}/"),
        }
    }

    /// The address that it listens on.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The cores for all but the simulation, which is on the calling thread's.
    pub(super) fn cores(&mut self) -> Option<Cores> {
        if let (Some(all), Some(simulation)) = (self.cores, Cores::allowed()) {
            self.cores = all.without(&simulation).or(self.cores);
        }
        self.cores
    }

    /// Serves `hub` on a thread of its own until that closes.
    pub(super) fn serve(self, hub: Arc<Hub>) -> Result<std::thread::JoinHandle<()>, ViewError> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(ViewError::Thread)?;
        let Self { listener, guard, cores, .. } = self;
        let work = move || {
            // Not on the core that the simulation shares with SUMO.
            if let Some(cores) = cores {
                cores.confine(0);
            }
            runtime.block_on(async {
                if let Err(error) = serve(listener, hub, guard).await {
                    tracing::warn!("the live view has ended: {error}");
                }
            });
            // Viewers that do not disconnect are not waited for.
            runtime.shutdown_timeout(Duration::from_millis(300));
        };
        std::thread::Builder::new().name("view server".to_string()).spawn(work).map_err(ViewError::Thread)
    }
}

/// The next free port after a busy one.
fn next_free(address: SocketAddr) -> Option<SocketAddr> {
    let port = |n: u16| address.port().checked_add(n).map(|port| SocketAddr::new(address.ip(), port));
    (1..50).filter_map(port).find(|address| TcpListener::bind(address).is_ok())
}

type Shared = (Arc<Hub>, Guard);

async fn serve(listener: TcpListener, hub: Arc<Hub>, guard: Guard) -> std::io::Result<()> {
    let mut closing = hub.closing.subscribe();
    let shared = Arc::new((Arc::clone(&hub), guard));
    let app = Router::new()
        .route("/", get(|| file("text/html; charset=utf-8", include_str!("page/index.html"))))
        .route("/view.css", get(|| file("text/css; charset=utf-8", include_str!("page/view.css"))))
        .route("/view.js", get(|| script(include_str!("page/view.js"))))
        .route("/map.js", get(|| script(include_str!("page/map.js"))))
        .route("/plots.js", get(|| script(include_str!("page/plots.js"))))
        .route("/drive.js", get(|| script(include_str!("page/drive.js"))))
        .route("/icon.svg", get(|| file("image/svg+xml", include_str!("page/icon.svg"))))
        .route("/map.json", get(map))
        .route("/ws", get(upgrade))
        .layer(from_fn_with_state(Arc::clone(&shared), check))
        .with_state(shared);
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEADER_TIME);
    // Viewers are not among them: a connection leaves when it becomes a WebSocket.
    let mut open: VecDeque<JoinHandle<()>> = VecDeque::new();
    loop {
        let stream = tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok((stream, _)) => stream,
                Err(error) => {
                    // Out of files, or the other side has gone: it may be better soon.
                    tracing::debug!("no connection: {error}");
                    tokio::time::sleep(PULSE).await;
                    continue;
                }
            },
            () = closed(&mut closing) => break,
        };
        // A frame of a few hundred bytes must not wait for the next one.
        if let Err(error) = stream.set_nodelay(true) {
            tracing::debug!("TCP_NODELAY: {error}");
        }
        open.retain(|connection| !connection.is_finished());
        if open.len() >= MOST_OPEN
            && let Some(oldest) = open.pop_front()
        {
            oldest.abort();
        }
        let service = TowerToHyperService::new(app.clone());
        let connection = http.serve_connection(TokioIo::new(stream), service).with_upgrades();
        open.push_back(tokio::spawn(async move {
            if let Err(error) = connection.await {
                tracing::debug!("a connection ended: {error}");
            }
        }));
    }
    // Time for the last messages; somebody who keeps a connection open does not keep the run.
    let until = tokio::time::Instant::now() + LEAVE;
    while hub.viewers() > 0 && tokio::time::Instant::now() < until {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    Ok(())
}

/// Checks access; scripts and styles hold no secrets and need no token.
async fn check(State(shared): State<Arc<Shared>>, request: HttpRequest, next: Next) -> Response {
    let mut response = match refusal(&shared.1, request.uri(), request.headers()) {
        Some(refusal) => {
            tracing::info!("refused a request for {}: {}", request.uri().path(), refusal.text());
            (StatusCode::FORBIDDEN, format!("Refused: {}.\n", refusal.text())).into_response()
        }
        None => next.run(request).await,
    };
    let headers = response.headers_mut();
    let policy = "default-src 'self'; img-src 'self' blob: data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'";
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(policy));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}

fn refusal(guard: &Guard, uri: &Uri, headers: &HeaderMap) -> Option<Refusal> {
    let text = |name| headers.get(name).and_then(|value: &HeaderValue| value.to_str().ok());
    let host = text(header::HOST).or_else(|| uri.host());
    let secret = matches!(uri.path(), "/" | "/map.json" | "/ws");
    let refusal = guard.check(host, text(header::ORIGIN), uri.query()).err()?;
    (secret || refusal != Refusal::Token).then_some(refusal)
}

async fn file(
    kind: &'static str,
    text: &'static str,
) -> ([(header::HeaderName, &'static str); 1], &'static str) {
    ([(header::CONTENT_TYPE, kind)], text)
}

async fn script(text: &'static str) -> impl IntoResponse {
    file("text/javascript; charset=utf-8", text).await
}

async fn map(State(shared): State<Arc<Shared>>) -> impl IntoResponse {
    let mut headers = HeaderMap::new();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
    (headers, shared.0.map())
}

async fn upgrade(State(shared): State<Arc<Shared>>, upgrade: WebSocketUpgrade) -> Response {
    if shared.0.viewers() >= MOST_VIEWERS {
        return (StatusCode::SERVICE_UNAVAILABLE, "Too many viewers.\n").into_response();
    }
    let hub = Arc::clone(&shared.0);
    upgrade
        .max_message_size(LONGEST_REQUEST)
        .max_frame_size(LONGEST_REQUEST)
        .on_upgrade(move |socket| talk(socket, hub))
}

/// How often the browser of a driver is asked whether it is there.
const PULSE: Duration = Duration::from_millis(200);
/// How often viewers are told that the server is there.
const HEARTBEAT: Duration = Duration::from_millis(500);
/// Time to send the last message to viewers.
const LEAVE: Duration = Duration::from_millis(300);
const MOST_VIEWERS: usize = 64;
/// Time for the header of a request, and between two requests of a connection.
const HEADER_TIME: Duration = Duration::from_secs(10);
/// Open connections that are not viewers. One more, and the oldest is closed: those that are opened and not used
/// keep nobody out.
const MOST_OPEN: usize = 64;
/// How often a viewer is asked whether it is there, and the time without a word after which it counts as gone.
const ROLL_CALL: Duration = Duration::from_secs(5);
const SILENT: Duration = Duration::from_secs(30);
/// Packets that a viewer has not drawn yet; what comes meanwhile is left out.
const IN_FLIGHT: u64 = 2;
/// Time without a received message after which a viewer counts as gone.
const STUCK: Duration = Duration::from_secs(10);
/// Malformed messages after which a viewer is disconnected.
const MOST_WRONG: u32 = 20;

/// One viewer, from its first message to its last.
async fn talk(mut socket: WebSocket, hub: Arc<Hub>) {
    let mut viewer = Viewer::join(&hub);
    let reason = serve_viewer(&mut socket, &hub, &mut viewer).await;
    tracing::info!(
        "viewer {} has gone{}",
        viewer.id,
        if reason.is_empty() { "" } else { ": " }.to_string() + reason
    );
    drop(viewer);
    if !reason.is_empty() {
        let code = if reason == OVER { close_code::AWAY } else { close_code::POLICY };
        let frame = CloseFrame { code, reason: Utf8Bytes::from_static(reason) };
        let _ = tokio::time::timeout(STUCK, socket.send(Message::Close(Some(frame)))).await;
    }
}

const OVER: &str = "the run has ended";
const GONE: &str = "it takes nothing any more";
const QUIET: &str = "it says nothing any more";

/// Why it ended; empty if the viewer disconnected.
async fn serve_viewer(socket: &mut WebSocket, hub: &Arc<Hub>, viewer: &mut Viewer) -> &'static str {
    let (mut greeting, mut refusal) = (hub.greeting.subscribe(), hub.refusal.subscribe());
    if !greet(socket, hub, viewer.id).await {
        return "";
    }
    let mut packets = hub.packets.subscribe();
    let mut closing = hub.closing.subscribe();
    let mut budget = Budget::new(Instant::now());
    let (mut wrong, mut in_flight, mut route) = (0_u32, 0_u64, 0_u64);
    let mut pulse = tokio::time::interval(PULSE);
    let mut heartbeat = tokio::time::interval(HEARTBEAT);
    let (mut roll_call, mut heard) = (tokio::time::interval(ROLL_CALL), Instant::now());
    viewer.ask(Request::Refresh);
    loop {
        tokio::select! {
            message = socket.recv() => {
                viewer.is_there();
                heard = Instant::now();
                let text = match message {
                    Some(Ok(Message::Text(text))) => text,
                    Some(Ok(Message::Ping(_) | Message::Pong(_))) => continue,
                    Some(Ok(Message::Binary(_))) => Utf8Bytes::from_static("binary"),
                    Some(Ok(Message::Close(_))) | None => return "",
                    // Too long, or no WebSocket at all.
                    Some(Err(error)) => {
                        tracing::info!("viewer {}: {error}", viewer.id);
                        return "a message was too long or broken";
                    }
                };
                if !budget.spend(Instant::now()) {
                    return "too many messages";
                }
                match Request::parse(&text) {
                    Ok(Request::Shown { seq: _ }) => in_flight = in_flight.saturating_sub(1),
                    Ok(request) => {
                        if !viewer.ask(request) && !refuse(socket, "the run is busy; try again").await {
                            return "";
                        }
                    }
                    Err(why) => {
                        wrong += 1;
                        if wrong > MOST_WRONG {
                            return "too many malformed messages";
                        }
                        if !refuse(socket, &why).await {
                            return "";
                        }
                    }
                }
            }
            changed = packets.changed(), if in_flight < IN_FLIGHT => {
                if changed.is_err() {
                    return OVER;
                }
                let Some(packet) = packets.borrow_and_update().clone() else { continue };
                if packet.route_id != route {
                    let (id, line) = hub.route();
                    route = id;
                    if !send(socket, Message::Text(line.into())).await {
                        return GONE;
                    }
                }
                if !send(socket, Message::Binary(packet.bytes.clone())).await {
                    return GONE;
                }
                in_flight += 1;
            }
            _ = pulse.tick(), if viewer.drives() => {
                if !send(socket, Message::Ping(Bytes::new())).await {
                    return GONE;
                }
            }
            _ = roll_call.tick() => {
                if heard.elapsed() > SILENT {
                    return QUIET;
                }
                if !send(socket, Message::Ping(Bytes::new())).await {
                    return GONE;
                }
            }
            _ = heartbeat.tick() => {
                if !send(socket, Message::Text(beat(hub).into())).await {
                    return GONE;
                }
            }
            Ok(()) = greeting.changed() => {
                if !greet(socket, hub, viewer.id).await {
                    return GONE;
                }
                viewer.ask(Request::Refresh);
            }
            Ok(()) = refusal.changed() => {
                let why = refusal.borrow_and_update().clone();
                if !refuse(socket, &why).await {
                    return GONE;
                }
            }
            () = closed(&mut closing) => return OVER,
        }
    }
}

/// That the server is there, and who has the wheel: the last tick's answer is old when the simulation hangs.
fn beat(hub: &Hub) -> String {
    json!({ "type": "beat", "holder": hub.holder() }).to_string()
}

/// Says what is shown.
async fn greet(socket: &mut WebSocket, hub: &Hub, viewer: u64) -> bool {
    let mut hello = hub.hello();
    hello["type"] = json!("hello");
    hello["you"] = json!(viewer);
    hello["history"] = json!(hub.history());
    send(socket, Message::Text(hello.to_string().into())).await
}

async fn closed(closing: &mut watch::Receiver<bool>) {
    // A sender that is gone has closed too.
    let _ = closing.wait_for(|closing| *closing).await;
}

async fn refuse(socket: &mut WebSocket, why: &str) -> bool {
    send(socket, Message::Text(json!({ "type": "refused", "why": why }).to_string().into())).await
}

async fn send(socket: &mut WebSocket, message: Message) -> bool {
    matches!(tokio::time::timeout(STUCK, socket.send(message)).await, Ok(Ok(())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_in_the_forms_that_people_write() {
        let read = |text: &str| text.parse::<ViewAddress>().map(|a| a.0.to_string());
        assert_eq!(read("127.0.0.1:8765").unwrap(), "127.0.0.1:8765");
        assert_eq!(read("localhost:80").unwrap(), "127.0.0.1:80");
        assert_eq!(read("9000").unwrap(), "127.0.0.1:9000");
        assert_eq!(read("[::1]:9000").unwrap(), "[::1]:9000");
        assert!(read("town5").unwrap_err().contains("CONFIG goes before"));
    }

    #[test]
    fn a_busy_port_is_named_with_a_free_one_and_an_open_one_wants_a_token() {
        let listen =
            |address: SocketAddr| Listener::bind(ViewAddress(address), None).err().map(|e| e.to_string());
        let taken = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = taken.local_addr().unwrap();
        let text = listen(address).unwrap();
        assert!(text.contains(&address.to_string()) && text.contains("--view 127.0.0.1:"), "{text}");
        let text = listen("0.0.0.0:0".parse().unwrap()).unwrap();
        assert!(text.contains("--view-token"), "{text}");
        assert_eq!(listen("127.0.0.1:0".parse().unwrap()), None);
    }
}

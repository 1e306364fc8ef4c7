//! Simulated viewers that show every frame, to measure how much viewers slow down the simulation.

use crate::cores::Cores;
use serde_json::Value;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::io::{AsyncReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;

/// A number of viewers on their own thread.
pub struct Crowd {
    stop: Arc<AtomicBool>,
    told: Arc<Told>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Told {
    frames: AtomicU64,
    bytes: AtomicU64,
    late: Mutex<Vec<f64>>,
}

/// The data that viewers received.
#[derive(Clone, Debug)]
pub struct Got {
    /// Frames received.
    pub frames: u64,
    /// Bytes received.
    pub bytes: u64,
    /// From the end of a tick to having its message (ms), each frame.
    pub late_ms: Vec<f64>,
}

impl Crowd {
    /// Starts viewers of the page at `address`, on these cores.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn watch(address: SocketAddr, viewers: usize, cores: Option<Cores>) -> std::io::Result<Self> {
        let (stop, told) = (Arc::new(AtomicBool::new(false)), Arc::new(Told::default()));
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
        let (halt, tell) = (Arc::clone(&stop), Arc::clone(&told));
        let work = move || {
            if let Some(cores) = cores {
                cores.confine(0);
            }
            runtime.block_on(async {
                for _ in 0..viewers {
                    let tell = Arc::clone(&tell);
                    tokio::spawn(async move {
                        // It ends when the server does.
                        if let Err(error) = view(address, &tell).await {
                            tracing::debug!("a viewer: {error}");
                        }
                    });
                }
                while !halt.load(Ordering::Relaxed) {
                    tokio::time::sleep(Duration::from_millis(5)).await;
                }
            });
        };
        let thread = std::thread::Builder::new().name("viewers".to_string()).spawn(work)?;
        Ok(Self { stop, told, thread: Some(thread) })
    }

    /// Ends them; returns what each received.
    pub fn leave(mut self) -> Got {
        self.end();
        let late_ms = std::mem::take(&mut *self.told.late.lock().unwrap_or_else(PoisonError::into_inner));
        Got {
            frames: self.told.frames.load(Ordering::Relaxed),
            bytes: self.told.bytes.load(Ordering::Relaxed),
            late_ms,
        }
    }

    fn end(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // Its panic is in the log already.
            let _ = thread.join();
        }
    }
}

impl Drop for Crowd {
    fn drop(&mut self) {
        self.end();
    }
}

/// One viewer: a WebSocket by hand, as plain as the protocol allows.
async fn view(address: SocketAddr, told: &Told) -> std::io::Result<()> {
    let mut stream = TcpStream::connect(address).await?;
    stream.set_nodelay(true)?;
    let hello = format!(
        "GET /ws HTTP/1.1\r\nHost: {address}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    );
    stream.write_all(hello.as_bytes()).await?;
    let mut stream = BufReader::with_capacity(1 << 16, stream);
    let mut end = [0; 4];
    while end != *b"\r\n\r\n" {
        end.rotate_left(1);
        end[3] = stream.read_u8().await?;
    }
    send(&mut stream, br#"{"do":"look","chase":false,"stages":true}"#).await?;
    let mut body = Vec::new();
    loop {
        let (kind, length) = (stream.read_u8().await? & 0x0f, stream.read_u8().await? & 0x7f);
        let length = match length {
            126 => u64::from(stream.read_u16().await?),
            127 => stream.read_u64().await?,
            short => u64::from(short),
        };
        body.resize(usize::try_from(length).unwrap_or(0), 0);
        stream.read_exact(&mut body).await?;
        if kind != 2 {
            continue;
        }
        let Some((head, rest)) = body.split_first_chunk::<4>() else { continue };
        let head = rest.get(..u32::from_le_bytes(*head) as usize).unwrap_or_default();
        let state: Value = serde_json::from_slice(head)?;
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64() * 1000.0);
        told.frames.fetch_add(1, Ordering::Relaxed);
        told.bytes.fetch_add(length, Ordering::Relaxed);
        let late = now - state["at"].as_f64().unwrap_or(now);
        told.late.lock().unwrap_or_else(PoisonError::into_inner).push(late);
        send(&mut stream, format!(r#"{{"do":"shown","seq":{}}}"#, state["seq"]).as_bytes()).await?;
    }
}

/// A short text message, masked with zeros: over loopback no proxy could misread it.
async fn send(stream: &mut BufReader<TcpStream>, text: &[u8]) -> std::io::Result<()> {
    let mut frame = vec![0x81, 0x80 | (text.len() as u8 & 0x7f), 0, 0, 0, 0];
    frame.extend_from_slice(text);
    stream.write_all(&frame).await
}

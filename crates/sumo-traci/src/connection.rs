//! Whole messages over any byte stream.

use bytes::{Buf, Bytes, BytesMut};
use std::io;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};

/// Messages over 1 GiB are refused; a garbage length is mostly larger.
const MAX_MESSAGE: usize = 1 << 30;
/// The inbox grows by at most this much ahead of what has arrived.
const READ_AHEAD: usize = 256 * 1024;

/// Why a message could not be exchanged.
#[derive(Debug, thiserror::Error)]
pub enum ConnectionError {
    /// The stream ended or failed.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// What came is not a message.
    #[error("{0}")]
    Garbage(String),
    /// An earlier exchange did not finish, so what comes next belongs to it.
    #[error("an earlier message did not finish")]
    Unusable,
}

/// A stream of length-prefixed messages: one write each, one answer each.
#[derive(Debug)]
pub struct Connection<S> {
    stream: S,
    inbox: BytesMut,
    /// An exchange has begun and not ended; stays set when it fails or its future is dropped.
    unfinished: bool,
}

impl<S: AsyncRead + AsyncWrite + Unpin> Connection<S> {
    /// Wraps a stream.
    pub fn new(stream: S) -> Self {
        Self { stream, inbox: BytesMut::with_capacity(64 * 1024), unfinished: false }
    }

    /// Writes `message` (with its length field) at once and reads the answer (without its length field).
    ///
    /// # Errors
    /// After any error, and when the future was dropped half way, the connection is unusable.
    pub async fn exchange(&mut self, message: &[u8]) -> Result<Bytes, ConnectionError> {
        if self.unfinished {
            return Err(ConnectionError::Unusable);
        }
        self.unfinished = true;
        if !self.inbox.is_empty() {
            let stray = self.inbox.len();
            return Err(ConnectionError::Garbage(format!("{stray} bytes before any request")));
        }
        self.stream.write_all(message).await?;
        self.stream.flush().await?;
        let answer = self.read().await?;
        self.unfinished = false;
        Ok(answer)
    }

    /// Declares the stream unusable: its answers no longer make sense.
    pub fn give_up(&mut self) {
        self.unfinished = true;
    }

    async fn read(&mut self) -> Result<Bytes, ConnectionError> {
        self.fill(4).await?;
        let length = self.inbox.get_i32();
        let body = usize::try_from(length).ok().and_then(|n| n.checked_sub(4)).filter(|&n| n <= MAX_MESSAGE);
        let Some(body) = body else {
            return Err(ConnectionError::Garbage(format!("a message length of {length} bytes")));
        };
        self.fill(body).await?;
        Ok(self.inbox.split_to(body).freeze())
    }

    /// Reads until at least `n` bytes are in the inbox.
    async fn fill(&mut self, n: usize) -> Result<(), ConnectionError> {
        while self.inbox.len() < n {
            self.inbox.reserve((n - self.inbox.len()).clamp(4096, READ_AHEAD));
            if self.stream.read_buf(&mut self.inbox).await? == 0 {
                let (found, wanted) = (self.inbox.len(), n);
                let text = format!("the stream ended after {found} of {wanted} bytes");
                return Err(io::Error::new(io::ErrorKind::UnexpectedEof, text).into());
            }
        }
        Ok(())
    }
}

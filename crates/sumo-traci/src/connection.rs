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
    /// An earlier exchange failed or did not finish, so what comes next belongs to it.
    #[error("an earlier message did not finish")]
    Unusable,
}

/// A stream of length-prefixed messages: one write each, one answer each.
#[derive(Debug)]
pub struct Connection<S> {
    stream: S,
    inbox: BytesMut,
    /// The rest of the message that is being sent.
    outbox: BytesMut,
    state: State,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    /// Between messages.
    Idle,
    /// Within an exchange; stays so when its future is dropped.
    Busy,
    /// The stream makes no sense any more.
    Broken,
}

impl<S: AsyncRead + AsyncWrite + Unpin> Connection<S> {
    /// Wraps a stream.
    pub fn new(stream: S) -> Self {
        let (inbox, outbox) = (BytesMut::with_capacity(64 * 1024), BytesMut::with_capacity(64 * 1024));
        Self { stream, inbox, outbox, state: State::Idle }
    }

    /// Writes `message` (with its length field) at once and reads the answer (without its length field).
    ///
    /// # Errors
    /// After any error the connection is unusable; so it is when the future was dropped half way,
    /// until [`Connection::settle`].
    pub async fn exchange(&mut self, message: &[u8]) -> Result<Bytes, ConnectionError> {
        if self.state != State::Idle {
            return Err(ConnectionError::Unusable);
        }
        if !self.inbox.is_empty() {
            self.state = State::Broken;
            let stray = self.inbox.len();
            return Err(ConnectionError::Garbage(format!("{stray} bytes before any request")));
        }
        self.outbox.clear();
        self.outbox.extend_from_slice(message);
        self.state = State::Busy;
        self.finish().await
    }

    /// Finishes an exchange whose future was dropped half way, and throws its answer away. The connection is
    /// between messages again.
    ///
    /// # Errors
    /// The stream failed, now or before.
    pub async fn settle(&mut self) -> Result<(), ConnectionError> {
        match self.state {
            State::Idle => Ok(()),
            State::Busy => self.finish().await.map(drop),
            State::Broken => Err(ConnectionError::Unusable),
        }
    }

    /// Declares the stream unusable: its answers no longer make sense.
    pub fn give_up(&mut self) {
        self.state = State::Broken;
    }

    /// Sends what is left of the message and reads the answer. Goes on where a dropped future of its own stopped.
    async fn finish(&mut self) -> Result<Bytes, ConnectionError> {
        let answer = self.write_and_read().await;
        self.state = if answer.is_ok() { State::Idle } else { State::Broken };
        answer
    }

    async fn write_and_read(&mut self) -> Result<Bytes, ConnectionError> {
        while self.outbox.has_remaining() {
            if self.stream.write_buf(&mut self.outbox).await? == 0 {
                return Err(io::Error::from(io::ErrorKind::WriteZero).into());
            }
        }
        self.stream.flush().await?;
        self.fill(0, 4).await?;
        // Left in the inbox until the body is there too: the future may be dropped in between.
        let length = self.inbox.as_ref().get_i32();
        let body = usize::try_from(length).ok().and_then(|n| n.checked_sub(4)).filter(|&n| n <= MAX_MESSAGE);
        let Some(body) = body else {
            return Err(ConnectionError::Garbage(format!("a message length of {length} bytes")));
        };
        self.fill(4, body).await?;
        self.inbox.advance(4);
        Ok(self.inbox.split_to(body).freeze())
    }

    /// Reads until the inbox has `n` bytes after the first `read`.
    async fn fill(&mut self, read: usize, n: usize) -> Result<(), ConnectionError> {
        while self.inbox.len() < read + n {
            self.inbox.reserve((read + n - self.inbox.len()).clamp(4096, READ_AHEAD));
            if self.stream.read_buf(&mut self.inbox).await? == 0 {
                let found = self.inbox.len() - read;
                let text = format!("the stream ended after {found} of {n} bytes");
                return Err(io::Error::new(io::ErrorKind::UnexpectedEof, text).into());
            }
        }
        Ok(())
    }
}

//! Errors: fatal ones of the connection, and refusals of one command.

use super::post_mortem::PostMortem;
use std::io;
use std::time::Duration;

/// SUMO refused one command, or answered it with something else than asked for.
/// The connection goes on.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{command}{}: {message}", quoted(object))]
pub struct CommandError {
    /// Which command, in words: "set vehicle move_to_xy".
    pub command: String,
    /// Id of the object it was for; empty where there is none.
    pub object: String,
    /// SUMO's own message, or what was wrong with its answer.
    pub message: String,
}

fn quoted(object: &str) -> String {
    if object.is_empty() { String::new() } else { format!(" '{object}'") }
}

/// Errors of a TraCI client.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No server answers at this address.
    #[error("no TraCI server at {address}: {source}. Start SUMO with --remote-port, or check host and port")]
    Connect {
        /// Host and port.
        address: String,
        /// The system's error.
        source: io::Error,
    },
    /// The connection broke.
    #[error("SUMO closed the connection during {pending}: {source}")]
    Closed {
        /// The commands of the message, in words.
        pending: String,
        /// The system's error.
        source: io::Error,
    },
    /// The server's answer is not valid TraCI.
    #[error("not a TraCI reply to {pending}: {what}. Is the other side SUMO 1.28 or newer?")]
    Protocol {
        /// The commands of the message, in words.
        pending: String,
        /// What is wrong with it.
        what: String,
    },
    /// No answer within the time limit.
    #[error(
        "SUMO hangs: no answer to {pending} within {:.1} s. If a step may take longer, raise the time limit",
        limit.as_secs_f64()
    )]
    Timeout {
        /// The time limit.
        limit: Duration,
        /// The commands of the message, in words.
        pending: String,
    },
    /// An API version that this client does not know.
    #[error(
        "TraCI API version {found} ({server}) where {expected} or newer is needed: use SUMO 1.28.0 (scripts/setup installs it)"
    )]
    Version {
        /// The oldest version that is good enough.
        expected: i32,
        /// The server's.
        found: i32,
        /// What the server calls itself.
        server: String,
    },
    /// An earlier message failed or was cancelled half way: replies can no longer be matched to messages.
    #[error("this TraCI connection failed in the middle of an earlier message: open a new connection")]
    Unusable,
    /// The batch would crash SUMO or give stale answers. Nothing was sent.
    #[error("batch not sent: {0}")]
    Batch(&'static str),
    /// SUMO refused a command.
    #[error(transparent)]
    Command(#[from] CommandError),
    /// SUMO, our own child process, is dead.
    #[error("{source}\n{post_mortem}")]
    Died {
        /// How it ended.
        post_mortem: PostMortem,
        /// The error by which it was noticed.
        source: Box<Error>,
    },
}

impl Error {
    /// False where the connection can go on.
    pub fn is_fatal(&self) -> bool {
        !matches!(self, Self::Command(_) | Self::Batch(_))
    }

    /// True where the other side is gone.
    pub fn is_closed(&self) -> bool {
        matches!(self, Self::Closed { .. } | Self::Died { .. })
    }
}

//! The client: handshake, batches, and single commands for convenience.

use super::batch::{Batch, Expect, Ticket};
use super::codec::{Decode, Encode, Reader};
use super::connection::{Connection, ConnectionError};
use super::domains::simulation;
use super::error::Error;
use super::replies::Replies;
use super::variable::{Argument, Domain, Query, Setter, Variable};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;

/// The TraCI API version of SUMO 1.28.
///
/// Servers with a lower number are refused. Higher ones are accepted with a warning in the
/// log: SUMO raises the number when it adds commands, and keeps the old commands.
pub const API_VERSION: i32 = 22;
/// Time limit per message unless changed.
pub const DEFAULT_TIMEOUT: Duration = Duration::from_secs(60);

/// How long closing waits for the answer to a message that nobody waits for any more.
const SETTLE: Duration = Duration::from_secs(5);

const CMD_GET_VERSION: u8 = 0x00;
const CMD_LOAD: u8 = 0x01;
const CMD_SET_ORDER: u8 = 0x03;
const CMD_CLOSE: u8 = 0x7F;

/// What the server says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Version {
    /// TraCI API version.
    pub api: i32,
    /// "SUMO 1.28.0".
    pub software: String,
}

/// A TraCI client over any stream.
#[derive(Debug)]
pub struct Client<S> {
    connection: Connection<S>,
    timeout: Option<Duration>,
    version: Version,
}

/// A TraCI client over TCP.
pub type TcpClient = Client<TcpStream>;

impl Client<TcpStream> {
    /// Connects to a SUMO that listens at `address` ("host:port") as its only or first client.
    ///
    /// # Errors
    /// No server listens there, or it is not a SUMO of a known version.
    pub async fn attach(address: &str) -> Result<Self, Error> {
        Self::attach_within(address, DEFAULT_TIMEOUT).await
    }

    /// Like [`Client::attach`], with another time limit: SUMO listens before it has loaded its network,
    /// and answers after.
    ///
    /// # Errors
    /// As [`Client::attach`], and no answer within `limit`.
    pub async fn attach_within(address: &str, limit: Duration) -> Result<Self, Error> {
        let failed = |source| Error::Connect { address: address.to_owned(), source };
        let stream = match tokio::time::timeout(limit, TcpStream::connect(address)).await {
            Ok(stream) => stream.map_err(failed)?,
            Err(elapsed) => return Err(failed(elapsed.into())),
        };
        stream.set_nodelay(true).map_err(failed)?;
        Self::handshake(stream, 1, limit).await
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> Client<S> {
    /// The first messages on a fresh stream: asks for the version, waits at most `limit` for it, and takes
    /// place `order` (from 1) among the server's clients.
    ///
    /// # Errors
    /// The other side is not a SUMO of a known version.
    pub async fn handshake(stream: S, order: i32, limit: Duration) -> Result<Self, Error> {
        let version = Version { api: 0, software: String::new() };
        let connection = Connection::new(stream);
        let mut client = Self { connection, timeout: Some(limit), version };

        let mut batch = Batch::new();
        let ticket = batch.control(Expect::Version, CMD_GET_VERSION, ["get", "version", ""], |_| ());
        let replies = client.send(&batch).await?;
        let mut reader = Reader::new(replies.raw(ticket)?);
        let garbage =
            |e: super::codec::DecodeError| Error::Protocol { pending: batch.summary(), what: e.to_string() };
        let found = reader.i32().map_err(garbage)?;
        let server = String::from_utf8_lossy(reader.str_bytes().map_err(garbage)?).into_owned();
        if found < API_VERSION {
            return Err(Error::Version { expected: API_VERSION, found, server });
        }
        if found > API_VERSION {
            tracing::warn!("TraCI API version {found} ({server}); this client was made for {API_VERSION}");
        }
        client.version = Version { api: found, software: server };

        batch.clear();
        let words = ["set", "client", "order"];
        batch.control(Expect::Status, CMD_SET_ORDER, words, |out| out.extend(order.to_be_bytes()));
        client.send(&batch).await?.check()?;
        client.timeout = Some(DEFAULT_TIMEOUT);
        Ok(client)
    }

    /// The server's own version.
    pub fn version(&self) -> &Version {
        &self.version
    }

    /// How long one message may take, or None for no limit. 60 s at first.
    pub fn set_timeout(&mut self, timeout: Option<Duration>) {
        self.timeout = timeout;
    }

    /// Sends a batch and waits for the answers. A refused command is an error in its own slot. For an empty
    /// batch nothing is sent.
    ///
    /// # Errors
    /// Fatal ones: the connection broke, no answer in time, an answer that is not TraCI; the client is
    /// unusable afterwards. It can only be closed when this future is dropped half way. Or the batch is not
    /// one that may be sent ([`Error::Batch`]); then nothing was.
    pub async fn send(&mut self, batch: &Batch) -> Result<Replies, Error> {
        let message = batch.message().map_err(Error::Batch)?;
        if batch.is_empty() {
            return Ok(Replies::none(batch));
        }
        let exchange = self.connection.exchange(message);
        let answer = match self.timeout {
            Some(limit) => match tokio::time::timeout(limit, exchange).await {
                Ok(answer) => answer,
                Err(_) => {
                    self.connection.give_up();
                    return Err(Error::Timeout { limit, pending: batch.summary() });
                }
            },
            None => exchange.await,
        };
        let answer = answer.map_err(|error| told(error, || batch.summary()))?;
        Replies::parse(batch, answer).map_err(|error| {
            self.connection.give_up();
            Error::Protocol { pending: batch.summary(), what: error.to_string() }
        })
    }

    async fn send_one<T: Decode>(&mut self, batch: Batch, ticket: Ticket<T>) -> Result<T, Error> {
        Ok(self.send(&batch).await?.get(ticket)?)
    }

    /// One variable in a message of its own. Put many into a [`Batch`].
    ///
    /// # Errors
    /// As [`Client::send`], and SUMO's refusal.
    pub async fn get<D: Domain, T: Decode>(
        &mut self,
        variable: Variable<D, T>,
        id: &str,
    ) -> Result<T, Error> {
        let mut batch = Batch::new();
        let ticket = batch.get(variable, id);
        self.send_one(batch, ticket).await
    }

    /// One variable with a parameter, in a message of its own.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub async fn get_with<D: Domain, T: Decode, P: Argument>(
        &mut self,
        query: Query<D, T, P>,
        id: &str,
    ) -> Result<T, Error> {
        let mut batch = Batch::new();
        let ticket = batch.get_with(query, id);
        self.send_one(batch, ticket).await
    }

    /// Sets one variable in a message of its own.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub async fn set<D: Domain, T: Encode>(
        &mut self,
        setter: Setter<D, T>,
        id: &str,
        value: T::Arg<'_>,
    ) -> Result<(), Error> {
        let mut batch = Batch::new();
        let ticket = batch.set(setter, id, value);
        self.send_one(batch, ticket).await
    }

    /// One simulation step, without anything else.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub async fn step(&mut self) -> Result<Replies, Error> {
        let mut batch = Batch::new();
        batch.step();
        let replies = self.send(&batch).await?;
        replies.check()?;
        Ok(replies)
    }

    /// Lets SUMO start over with other command-line options (without the program's name).
    ///
    /// # Errors
    /// As [`Client::get`]; SUMO ends where the options are wrong.
    pub async fn load(&mut self, options: &[&str]) -> Result<(), Error> {
        let mut batch = Batch::new();
        let ticket = batch
            .control(Expect::Status, CMD_LOAD, ["load", "", ""], |out| Vec::<String>::encode(options, out));
        self.send_one(batch, ticket).await
    }

    /// Saves the simulation's state to a file (.xml, .xml.gz). Persons and random generators are only
    /// in it where SUMO runs with `--save-state.transportables` and `--save-state.rng`.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub async fn save_state(&mut self, file: &str) -> Result<(), Error> {
        self.set(simulation::SAVE_STATE, "", file).await
    }

    /// Loads a state saved on the same network.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub async fn load_state(&mut self, file: &str) -> Result<(), Error> {
        self.set(simulation::LOAD_STATE, "", file).await
    }

    /// Ends the simulation: SUMO writes its outputs and exits. If the future of an earlier message was dropped
    /// half way, waits up to 5 s for its answer first: SUMO reads no message while it works on another.
    ///
    /// # Errors
    /// As [`Client::get`].
    pub async fn close(mut self) -> Result<(), Error> {
        let pending = || "the message before the command: close".to_owned();
        match tokio::time::timeout(SETTLE, self.connection.settle()).await {
            Ok(settled) => settled.map_err(|error| told(error, pending))?,
            Err(_) => return Err(Error::Timeout { limit: SETTLE, pending: pending() }),
        }
        let mut batch = Batch::new();
        let ticket = batch.control(Expect::Status, CMD_CLOSE, ["close", "", ""], |_| ());
        self.send_one(batch, ticket).await
    }
}

fn told(error: ConnectionError, pending: impl FnOnce() -> String) -> Error {
    match error {
        ConnectionError::Io(source) => Error::Closed { pending: pending(), source },
        ConnectionError::Garbage(what) => Error::Protocol { pending: pending(), what },
        ConnectionError::Unusable => Error::Unusable,
    }
}

//! Replies: one slot per command of the batch, decoded when asked for.

use super::batch::{Batch, Command, Expect, Ticket};
use super::codec::{Decode, DecodeError, Reader};
use super::error::CommandError;
use super::subscription::{ObjectSpan, Results, Subscribed, SubscriptionSpan, Subscriptions};
use super::variable::Borrow;
use bytes::Bytes;
use std::ops::Range;

const OK: u8 = 0x00;
const NOT_IMPLEMENTED: u8 = 0x01;
const ERROR: u8 = 0xFF;

#[derive(Clone, Debug)]
enum Slot {
    /// Where the answer's value is (empty where there is only a status).
    Value(Range<usize>),
    /// Index into `subscriptions`.
    Subscription(usize),
    Failed(CommandError),
}

/// The answers to a batch. Values are decoded when asked for, straight from the message.
#[derive(Clone, Debug)]
pub struct Replies {
    data: Bytes,
    serial: u64,
    slots: Vec<Slot>,
    subscriptions: Vec<SubscriptionSpan>,
    objects: Vec<ObjectSpan>,
    /// Index of the first subscription that came with the step.
    with_step: usize,
}

/// Why a message is not an answer to the batch.
#[derive(Debug, PartialEq, thiserror::Error)]
pub(super) enum ReplyError {
    #[error("reply to command {index}: {source}")]
    Decode { index: usize, source: DecodeError },
    #[error("reply to command {index}: expected {what} 0x{expected:02x}, found 0x{found:02x}")]
    Mismatch { index: usize, what: &'static str, expected: u8, found: u8 },
    #[error("{0} bytes after the last reply")]
    Trailing(usize),
}

/// A command's or answer's frame: the slice after its length field.
fn frame<'a>(reader: &mut Reader<'a>) -> Result<(Reader<'a>, usize), DecodeError> {
    let at = reader.position();
    let (length, header) = match reader.u8()? {
        0 => {
            let count = reader.i32()?;
            (usize::try_from(count).map_err(|_| DecodeError::NegativeCount { count, at })?, 5)
        }
        length => (usize::from(length), 1),
    };
    let body =
        length.checked_sub(header).ok_or(DecodeError::Truncated { needed: header, left: length, at })?;
    let start = reader.position();
    Ok((Reader::new(reader.bytes(body)?), start))
}

impl Replies {
    /// Size of the message (bytes).
    pub fn bytes(&self) -> usize {
        self.data.len()
    }

    /// No answers yet to `batch`.
    pub(super) fn none(batch: &Batch) -> Self {
        Self {
            serial: batch.serial(),
            slots: Vec::with_capacity(batch.len()),
            subscriptions: Vec::new(),
            objects: Vec::new(),
            with_step: 0,
            data: Bytes::new(),
        }
    }

    /// Parses `data`, a message without its length field, as the answer to `batch`.
    pub(super) fn parse(batch: &Batch, data: Bytes) -> Result<Self, ReplyError> {
        let mut replies = Self::none(batch);
        let mut reader = Reader::new(&data);
        for (index, command) in batch.commands().iter().enumerate() {
            let slot = replies.parse_one(batch, command, index, &mut reader)?;
            replies.slots.push(slot);
        }
        if reader.remaining() > 0 {
            return Err(ReplyError::Trailing(reader.remaining()));
        }
        replies.data = data;
        Ok(replies)
    }

    fn parse_one(
        &mut self,
        batch: &Batch,
        command: &Command,
        index: usize,
        reader: &mut Reader<'_>,
    ) -> Result<Slot, ReplyError> {
        let decode = |source| ReplyError::Decode { index, source };
        let check = |what, expected: u8, found: u8| match expected == found {
            true => Ok(()),
            false => Err(ReplyError::Mismatch { index, what, expected, found }),
        };
        let (mut status, _) = frame(reader).map_err(decode)?;
        check("status of command", command.command, status.u8().map_err(decode)?)?;
        let result = status.u8().map_err(decode)?;
        let message = String::from_utf8_lossy(status.str_bytes().map_err(decode)?);
        status.finish().map_err(decode)?;
        match result {
            OK => {}
            ERROR | NOT_IMPLEMENTED => {
                let message = match (result, message.is_empty()) {
                    (_, false) => message.into_owned(),
                    (NOT_IMPLEMENTED, true) => "this SUMO does not have this command".to_owned(),
                    (_, true) => "refused without a message".to_owned(),
                };
                // A refused variable subscription still lists what it could and could not read.
                let response = command.command.wrapping_add(0x10);
                let mut ahead = *reader;
                if command.expect == Expect::Variables
                    && frame(&mut ahead).is_ok_and(|(mut body, _)| body.u8() == Ok(response))
                {
                    *reader = ahead;
                }
                let object = batch.object(command).to_owned();
                return Ok(Slot::Failed(CommandError { command: batch.words(command), object, message }));
            }
            found => return Err(ReplyError::Mismatch { index, what: "status", expected: OK, found }),
        }
        if command.expect == Expect::Status {
            return Ok(Slot::Value(0..0));
        }
        if command.expect == Expect::Step {
            self.with_step = self.subscriptions.len();
            for _ in 0..reader.count(1).map_err(decode)? {
                let (mut body, start) = frame(reader).map_err(decode)?;
                self.parse_subscription(&mut body, start).map_err(decode)?;
                body.finish().map_err(decode)?;
            }
            return Ok(Slot::Value(0..0));
        }
        let (mut body, start) = frame(reader).map_err(decode)?;
        match command.expect {
            Expect::Variables | Expect::Context => {
                self.parse_subscription(&mut body, start).map_err(decode)?;
                body.finish().map_err(decode)?;
                self.with_step = self.subscriptions.len();
                Ok(Slot::Subscription(self.subscriptions.len() - 1))
            }
            Expect::Version => {
                check("answer", command.command, body.u8().map_err(decode)?)?;
                Ok(Slot::Value(start + body.position()..start + body.position() + body.remaining()))
            }
            _ => {
                check("answer", command.command.wrapping_add(0x10), body.u8().map_err(decode)?)?;
                check("variable", command.variable, body.u8().map_err(decode)?)?;
                body.str_bytes().map_err(decode)?;
                let at = start + body.position();
                Ok(Slot::Value(at..at + body.remaining()))
            }
        }
    }

    /// Notes where the objects of one subscription's answer are.
    fn parse_subscription(&mut self, body: &mut Reader<'_>, start: usize) -> Result<(), DecodeError> {
        let response = body.u8()?;
        let id_len = body.str()?.len();
        let id = start + body.position() - id_len..start + body.position();
        // Context answers are those to the commands 0x80..0x8f (and 0x04..0x09), which name the domain found.
        let is_context = matches!(response, 0x90..=0x9f | 0x14..=0x1f);
        let context = if is_context { Some(body.u8()?) } else { None };
        let variables = body.u8()?;
        let first = self.objects.len();
        if is_context {
            for _ in 0..body.count(4)? {
                let id_len = body.str()?.len();
                let id = start + body.position() - id_len..start + body.position();
                self.parse_object(body, start, id, variables)?;
            }
        } else {
            self.parse_object(body, start, id.clone(), variables)?;
        }
        self.subscriptions.push(SubscriptionSpan {
            response,
            context,
            id,
            objects: first..self.objects.len(),
        });
        Ok(())
    }

    fn parse_object(
        &mut self,
        body: &mut Reader<'_>,
        start: usize,
        id: Range<usize>,
        variables: u8,
    ) -> Result<(), DecodeError> {
        let from = start + body.position();
        for _ in 0..variables {
            body.bytes(2)?; // variable and status
            body.skip()?;
        }
        self.objects.push(ObjectSpan { id, values: from..start + body.position() });
        Ok(())
    }

    fn slot<T>(&self, ticket: Ticket<T>) -> Result<&Slot, CommandError> {
        let foreign = || local_error("the ticket belongs to another batch, or to this one before clear()");
        if ticket.serial != self.serial {
            return Err(foreign());
        }
        match self.slots.get(ticket.index).ok_or_else(foreign)? {
            Slot::Failed(error) => Err(error.clone()),
            slot => Ok(slot),
        }
    }

    fn value_bytes<T>(&self, ticket: Ticket<T>) -> Result<&[u8], CommandError> {
        match self.slot(ticket)? {
            Slot::Value(range) => Ok(&self.data[range.clone()]),
            _ => Ok(&[]),
        }
    }

    pub(super) fn raw<T>(&self, ticket: Ticket<T>) -> Result<&[u8], CommandError> {
        self.value_bytes(ticket)
    }

    /// The value that a getter brought, or that a command without value succeeded.
    ///
    /// # Errors
    /// SUMO refused this command, or answered with another type.
    pub fn get<T: Decode>(&self, ticket: Ticket<T>) -> Result<T, CommandError> {
        T::decode_all(self.value_bytes(ticket)?).map_err(|e| local_error(&e.to_string()))
    }

    /// Like [`Replies::get`] for text and text lists, without copying.
    ///
    /// # Errors
    /// As [`Replies::get`].
    pub fn get_ref<T: Borrow>(&self, ticket: Ticket<T>) -> Result<T::Ref<'_>, CommandError> {
        let mut reader = Reader::new(self.value_bytes(ticket)?);
        let value = T::borrow(&mut reader).and_then(|value| reader.finish().map(|()| value));
        value.map_err(|e| local_error(&e.to_string()))
    }

    /// The first refusal, if any.
    ///
    /// # Errors
    /// SUMO refused a command of the batch.
    pub fn check(&self) -> Result<(), CommandError> {
        self.failures().next().map_or(Ok(()), |error| Err(error.clone()))
    }

    /// All refusals, in the order of the commands.
    pub fn failures(&self) -> impl Iterator<Item = &CommandError> {
        self.slots.iter().filter_map(|slot| match slot {
            Slot::Failed(error) => Some(error),
            _ => None,
        })
    }

    /// What the subscriptions brought with the step.
    pub fn subscriptions(&self) -> Subscriptions<'_> {
        Subscriptions::new(&self.data, &self.objects, &self.subscriptions[self.with_step..])
    }

    /// What a subscription answered at once, before any step.
    ///
    /// # Errors
    /// SUMO refused it.
    pub fn subscribed(&self, ticket: Ticket<Subscribed>) -> Result<Results<'_>, CommandError> {
        match self.slot(ticket)? {
            Slot::Subscription(index) => {
                Ok(Results::new(&self.data, &self.objects, &self.subscriptions[*index]))
            }
            _ => Err(local_error("this ticket is not a subscription's")),
        }
    }
}

fn local_error(message: &str) -> CommandError {
    CommandError { command: "reading a reply".to_owned(), object: String::new(), message: message.to_owned() }
}

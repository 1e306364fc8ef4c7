//! Batches: many commands in one message, written at once.

use super::codec::{Encode, put_str};
use super::subscription::{Filter, Subscribed};
use super::variable::{Argument, Domain, Query, Setter, Variable, VariableId};
use std::marker::PhantomData;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

pub(super) const CMD_SIMSTEP: u8 = 0x02;
const CMD_EXECUTE_MOVE: u8 = 0x7d;
const CMD_ADD_SUBSCRIPTION_FILTER: u8 = 0x7e;
/// Begin and end of a subscription that never ends (SUMO's "no value" double).
const ALWAYS: f64 = -1_073_741_824.0;

/// The claim to one command's answer, redeemed at [`super::Replies::get`].
#[derive(Debug)]
pub struct Ticket<T> {
    pub(super) serial: u64,
    pub(super) index: usize,
    kind: PhantomData<fn() -> T>,
}

impl<T> Clone for Ticket<T> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<T> Copy for Ticket<T> {}

/// What SUMO answers a command with, besides its status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Expect {
    Status,
    Value,
    Variables,
    Context,
    Step,
    Version,
}

#[derive(Clone, Debug)]
pub(super) struct Command {
    pub expect: Expect,
    /// TraCI's command number.
    pub command: u8,
    pub variable: u8,
    /// "get vehicle", "set person", ...
    verb: &'static str,
    domain: &'static str,
    name: &'static str,
    /// Where the object's id is in the message.
    id: Range<usize>,
}

/// Commands that travel in one message. Reuse it with [`Batch::clear`]: it then allocates nothing.
///
/// ```
/// use sumo_traci::{Batch, vehicle};
/// let mut batch = Batch::new();
/// let speed = batch.get(vehicle::SPEED, "ego");   // redeemed when the reply is there
/// batch.set(vehicle::SET_SPEED, "other", 3.0);
/// batch.step();                                   // the last command
/// assert_eq!(batch.len(), 3);
/// # let _ = speed;
/// ```
#[derive(Debug)]
pub struct Batch {
    /// The message, its length field first.
    message: Vec<u8>,
    commands: Vec<Command>,
    serial: u64,
    stepped: bool,
    misuse: Option<&'static str>,
    /// By how many bytes the last command moved when its length field shrank to one byte.
    moved: usize,
}

impl Default for Batch {
    fn default() -> Self {
        Self::new()
    }
}

fn next_serial() -> u64 {
    static SERIAL: AtomicU64 = AtomicU64::new(0);
    SERIAL.fetch_add(1, Ordering::Relaxed)
}

impl Batch {
    /// An empty batch.
    pub fn new() -> Self {
        Self {
            message: vec![0; 4],
            commands: Vec::new(),
            serial: next_serial(),
            stepped: false,
            misuse: None,
            moved: 0,
        }
    }

    /// Empties the batch and keeps its memory. Its old tickets are void.
    pub fn clear(&mut self) {
        self.message.truncate(4);
        self.commands.clear();
        self.serial = next_serial();
        self.stepped = false;
        self.misuse = None;
    }

    /// Number of commands.
    pub fn len(&self) -> usize {
        self.commands.len()
    }

    /// True without commands.
    pub fn is_empty(&self) -> bool {
        self.commands.is_empty()
    }

    /// Asks for a variable of object `id` ("" for lists and counts of a domain, and in the simulation domain).
    pub fn get<D: Domain, T>(&mut self, variable: Variable<D, T>, id: &str) -> Ticket<T> {
        let command = self.describe(Expect::Value, D::GET, variable.code, ["get", D::NAME, variable.name]);
        self.variable_command(command, id, |_| ())
    }

    /// Asks for a variable that takes a parameter.
    pub fn get_with<D: Domain, T, P: Argument>(&mut self, query: Query<D, T, P>, id: &str) -> Ticket<T> {
        let Variable { code, name, .. } = query.variable;
        let command = self.describe(Expect::Value, D::GET, code, ["get", D::NAME, name]);
        self.variable_command(command, id, |out| query.param.put(out))
    }

    /// Sets a variable of object `id`.
    pub fn set<D: Domain, T: Encode>(
        &mut self,
        setter: Setter<D, T>,
        id: &str,
        value: T::Arg<'_>,
    ) -> Ticket<()> {
        let command = self.describe(Expect::Status, D::SET, setter.code, ["set", D::NAME, setter.name]);
        self.variable_command(command, id, |out| T::encode(value, out))
    }

    /// Sets with any argument, for commands that no typed function covers.
    pub fn set_raw<D: Domain>(
        &mut self,
        _domain: D,
        code: u8,
        name: &'static str,
        id: &str,
        argument: impl Argument,
    ) -> Ticket<()> {
        let command = self.describe(Expect::Status, D::SET, code, ["set", D::NAME, name]);
        self.variable_command(command, id, |out| argument.put(out))
    }

    /// A setter that carries nothing but the object's id.
    pub(super) fn set_bare<D: Domain>(
        &mut self,
        _domain: D,
        code: u8,
        name: &'static str,
        id: &str,
    ) -> Ticket<()> {
        let command = self.describe(Expect::Status, D::SET, code, ["set", D::NAME, name]);
        self.variable_command(command, id, |_| ())
    }

    /// Subscribes to variables of object `id`: their values come with every step, until
    /// the object leaves. A second subscription to the same object adds its variables to the first.
    pub fn subscribe<D: Domain>(
        &mut self,
        _domain: D,
        id: &str,
        variables: &[VariableId<'_, D>],
    ) -> Ticket<Subscribed> {
        if let Some(why) = bad_count(variables.len()) {
            return self.refuse(why);
        }
        self.subscription(Expect::Variables, D::SUBSCRIBE, ["subscribe", D::NAME, "variables"], id, |out| {
            put_variables(out, variables)
        })
    }

    /// Subscribes to variables of all objects of domain `context` within `radius` (m) of object `id`,
    /// itself included where it is one of them. A second one with the same object and context adds its
    /// variables to the first. SUMO has none for traffic lights: subscribe to each.
    pub fn subscribe_context<D: Domain, C: Domain>(
        &mut self,
        _domain: D,
        id: &str,
        _context: C,
        radius: f64,
        variables: &[VariableId<'_, C>],
    ) -> Ticket<Subscribed> {
        if let Some(why) = bad_count(variables.len()) {
            return self.refuse(why);
        }
        let words = ["subscribe", D::NAME, "context"];
        self.subscription(Expect::Context, D::SUBSCRIBE_CONTEXT, words, id, |out| {
            out.push(C::GET);
            out.extend_from_slice(&radius.to_be_bytes());
            put_variables(out, variables);
        })
    }

    /// Ends the subscription to variables of object `id`.
    pub fn unsubscribe<D: Domain>(&mut self, _domain: D, id: &str) -> Ticket<()> {
        self.subscription(Expect::Status, D::SUBSCRIBE, ["unsubscribe", D::NAME, "variables"], id, |out| {
            out.push(0)
        })
    }

    /// Ends the subscription to objects of domain `context` round object `id`.
    pub fn unsubscribe_context<D: Domain, C: Domain>(
        &mut self,
        _domain: D,
        id: &str,
        _context: C,
        radius: f64,
    ) -> Ticket<()> {
        let words = ["unsubscribe", D::NAME, "context"];
        self.subscription(Expect::Status, D::SUBSCRIBE_CONTEXT, words, id, |out| {
            out.push(C::GET);
            out.extend_from_slice(&radius.to_be_bytes());
            out.push(0);
        })
    }

    /// Narrows the vehicle context subscription made just before.
    pub fn add_filter(&mut self, filter: &Filter<'_>) -> Ticket<()> {
        let words = ["add", "subscription", filter.name()];
        let command = self.describe(Expect::Status, CMD_ADD_SUBSCRIPTION_FILTER, 0, words);
        self.push(command, |out| filter.put(out))
    }

    /// One simulation step. It must be the last command: SUMO answers later ones with the
    /// state before the step, and two steps in one message crash it. The batch is refused otherwise.
    pub fn step(&mut self) -> Ticket<()> {
        self.step_to(0.0)
    }

    /// Steps until simulation time `time` (s); 0 is one step. Must be the last command.
    pub fn step_to(&mut self, time: f64) -> Ticket<()> {
        if self.stepped {
            return self.refuse("two simulation steps (they crash SUMO): one step per message");
        }
        let command = self.describe(Expect::Step, CMD_SIMSTEP, 0, ["simulation", "step", ""]);
        let ticket = self.push(command, |out| out.extend_from_slice(&time.to_be_bytes()));
        self.stepped = true;
        ticket
    }

    /// The first half of a step: vehicles move, and the second half follows with the next step.
    pub fn execute_move(&mut self) -> Ticket<()> {
        let command = self.describe(Expect::Status, CMD_EXECUTE_MOVE, 0, ["execute", "move", ""]);
        self.push(command, |_| ())
    }

    /// A command outside the domains.
    pub(super) fn control(
        &mut self,
        expect: Expect,
        command: u8,
        words: [&'static str; 3],
        put: impl FnOnce(&mut Vec<u8>),
    ) -> Ticket<()> {
        let command = self.describe(expect, command, 0, words);
        self.push(command, put)
    }

    fn describe(&self, expect: Expect, command: u8, variable: u8, words: [&'static str; 3]) -> Command {
        let [verb, domain, name] = words;
        Command { expect, command, variable, verb, domain, name, id: 0..0 }
    }

    fn variable_command<T>(
        &mut self,
        command: Command,
        id: &str,
        put: impl FnOnce(&mut Vec<u8>),
    ) -> Ticket<T> {
        let variable = command.variable;
        let mut at = 0;
        let ticket = self.push(command, |out| {
            out.push(variable);
            put_str(out, id);
            at = out.len();
            put(out);
        });
        self.note_id(at, id.len());
        ticket
    }

    fn subscription<T>(
        &mut self,
        expect: Expect,
        command: u8,
        words: [&'static str; 3],
        id: &str,
        put: impl FnOnce(&mut Vec<u8>),
    ) -> Ticket<T> {
        let mut at = 0;
        let ticket = self.push(self.describe(expect, command, 0, words), |out| {
            out.extend_from_slice(&ALWAYS.to_be_bytes());
            out.extend_from_slice(&ALWAYS.to_be_bytes());
            put_str(out, id);
            at = out.len();
            put(out);
        });
        self.note_id(at, id.len());
        ticket
    }

    /// Remembers that the last command's id ended at `end` when it was written, before the
    /// command's length field found its final size.
    fn note_id(&mut self, end: usize, len: usize) {
        let Some(command) = self.commands.last_mut() else { return };
        let end = end - self.moved;
        command.id = end - len..end;
    }

    fn refuse<T>(&mut self, why: &'static str) -> Ticket<T> {
        self.misuse.get_or_insert(why);
        Ticket { serial: self.serial, index: usize::MAX, kind: PhantomData }
    }

    fn push<T>(&mut self, command: Command, put: impl FnOnce(&mut Vec<u8>)) -> Ticket<T> {
        if self.stepped {
            self.misuse.get_or_insert("a command after the simulation step: step() must be the last command");
        }
        // The length is one byte, or 0 and four more where one is not enough.
        let start = self.message.len();
        self.message.extend_from_slice(&[0; 5]);
        self.message.push(command.command);
        put(&mut self.message);
        let long = self.message.len() - start;
        self.moved = match u8::try_from(long - 4) {
            Ok(short) => {
                self.message.copy_within(start + 5.., start + 1);
                self.message.truncate(start + long - 4);
                self.message[start] = short;
                4
            }
            Err(_) => {
                let length = i32::try_from(long).unwrap_or(i32::MAX);
                self.message[start + 1..start + 5].copy_from_slice(&length.to_be_bytes());
                0
            }
        };
        let total = i32::try_from(self.message.len()).unwrap_or_else(|_| {
            self.misuse.get_or_insert("more than 2 GiB in one message");
            i32::MAX
        });
        self.message[..4].copy_from_slice(&total.to_be_bytes());
        self.commands.push(command);
        Ticket { serial: self.serial, index: self.commands.len() - 1, kind: PhantomData }
    }

    pub(super) fn serial(&self) -> u64 {
        self.serial
    }

    pub(super) fn commands(&self) -> &[Command] {
        &self.commands
    }

    /// The finished message, or why it must not be sent.
    pub(super) fn message(&self) -> Result<&[u8], &'static str> {
        match self.misuse {
            Some(misuse) => Err(misuse),
            None => Ok(&self.message),
        }
    }

    /// The object's id of a command.
    pub(super) fn object(&self, command: &Command) -> &str {
        self.message.get(command.id.clone()).and_then(|b| std::str::from_utf8(b).ok()).unwrap_or("")
    }

    /// A command in words.
    pub(super) fn words(&self, command: &Command) -> String {
        format!("{} {} {}", command.verb, command.domain, command.name).trim_end().to_owned()
    }

    /// The whole batch in a few words.
    pub(super) fn summary(&self) -> String {
        let named = |c: &Command| match self.object(c) {
            "" => self.words(c),
            id => format!("{} '{id}'", self.words(c)),
        };
        match self.commands.as_slice() {
            [] => "an empty message".to_owned(),
            [one] => format!("the command: {}", named(one)),
            [first, .., last] => {
                format!("{} commands ({} ... {})", self.commands.len(), named(first), named(last))
            }
        }
    }
}

fn bad_count(variables: usize) -> Option<&'static str> {
    match variables {
        0 => Some("a subscription without variables (unsubscribe ends one)"),
        1..=255 => None,
        _ => Some("a subscription to more than 255 variables"),
    }
}

fn put_variables<D>(out: &mut Vec<u8>, variables: &[VariableId<'_, D>]) {
    out.push(variables.len() as u8);
    variables.iter().for_each(|v| v.put(out));
}

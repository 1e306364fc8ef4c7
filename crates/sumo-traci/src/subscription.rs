//! Subscriptions: results that come with every step, and filters on them.

use super::codec::{Decode, DecodeError, Encode, Reader, StringList};
use super::error::CommandError;
use super::variable::{Borrow, Domain, Variable};
use std::cell::Cell;
use std::ops::Range;

/// Marks a subscription's ticket.
#[derive(Clone, Copy, Debug)]
pub struct Subscribed;

#[derive(Clone, Debug)]
pub(super) struct ObjectSpan {
    pub id: Range<usize>,
    pub values: Range<usize>,
}

#[derive(Clone, Debug)]
pub(super) struct SubscriptionSpan {
    pub response: u8,
    pub context: Option<u8>,
    pub id: Range<usize>,
    pub objects: Range<usize>,
}

/// All subscription results of one step.
#[derive(Clone, Copy, Debug)]
pub struct Subscriptions<'a> {
    data: &'a [u8],
    objects: &'a [ObjectSpan],
    spans: &'a [SubscriptionSpan],
}

impl<'a> Subscriptions<'a> {
    pub(super) fn new(data: &'a [u8], objects: &'a [ObjectSpan], spans: &'a [SubscriptionSpan]) -> Self {
        Self { data, objects, spans }
    }

    /// Number of subscriptions that brought something.
    pub fn len(&self) -> usize {
        self.spans.len()
    }

    /// True where none brought anything.
    pub fn is_empty(&self) -> bool {
        self.spans.is_empty()
    }

    /// All of them, in SUMO's order.
    pub fn iter(&self) -> impl Iterator<Item = Results<'a>> + 'a {
        let Self { data, objects, spans } = *self;
        spans.iter().map(move |span| Results::new(data, objects, span))
    }

    /// Results of all variable subscriptions of a domain, one per object.
    pub fn objects<D: Domain>(&self, _domain: D) -> impl Iterator<Item = ObjectResults<'a>> + 'a {
        let response = D::SUBSCRIBE.wrapping_add(0x10);
        self.iter().filter(move |r| r.span.response == response).flat_map(|r| r.objects())
    }

    /// Result of the variable subscription to object `id` of a domain; None once the object has left.
    pub fn object<D: Domain>(&self, domain: D, id: &str) -> Option<ObjectResults<'a>> {
        self.objects(domain).find(|object| object.id() == id)
    }

    /// Objects of domain `context` round object `id` of domain `domain`; empty without such a subscription.
    pub fn context<D: Domain, C: Domain>(
        &self,
        _domain: D,
        id: &str,
        _context: C,
    ) -> impl Iterator<Item = ObjectResults<'a>> + 'a {
        let response = D::SUBSCRIBE_CONTEXT.wrapping_add(0x10);
        let id = id.to_owned();
        self.iter()
            .filter(move |r| r.span.response == response && r.span.context == Some(C::GET) && r.id() == id)
            .flat_map(|r| r.objects())
    }
}

/// What one subscription brought.
#[derive(Clone, Copy, Debug)]
pub struct Results<'a> {
    data: &'a [u8],
    all: &'a [ObjectSpan],
    span: &'a SubscriptionSpan,
}

impl<'a> Results<'a> {
    pub(super) fn new(data: &'a [u8], all: &'a [ObjectSpan], span: &'a SubscriptionSpan) -> Self {
        Self { data, all, span }
    }

    /// Id of the object that was subscribed to.
    pub fn id(&self) -> &'a str {
        text(self.data, &self.span.id)
    }

    /// True for a context subscription.
    pub fn is_context(&self) -> bool {
        self.span.context.is_some()
    }

    /// The objects: the subscribed one, or the objects round it.
    pub fn objects(&self) -> impl ExactSizeIterator<Item = ObjectResults<'a>> + use<'a> {
        let data = self.data;
        self.all[self.span.objects.clone()].iter().map(move |span| ObjectResults {
            id: text(data, &span.id),
            values: &data[span.values.clone()],
            next: Cell::new(0),
        })
    }
}

fn text<'a>(data: &'a [u8], range: &Range<usize>) -> &'a str {
    // Checked to be UTF-8 when the message was parsed.
    std::str::from_utf8(&data[range.clone()]).unwrap_or_default()
}

/// The subscribed values of one object.
///
/// Reading them in the order of the subscription costs nothing but their decoding.
#[derive(Clone, Debug)]
pub struct ObjectResults<'a> {
    id: &'a str,
    values: &'a [u8],
    /// Where the next value in order begins.
    next: Cell<usize>,
}

impl<'a> ObjectResults<'a> {
    /// The object's id.
    pub fn id(&self) -> &'a str {
        self.id
    }

    /// A value.
    ///
    /// # Errors
    /// The variable was not subscribed to, SUMO could not give it, or it has another type.
    pub fn value<D: Domain, T: Decode>(&self, variable: Variable<D, T>) -> Result<T, CommandError> {
        self.read(variable, T::decode)
    }

    /// A text or text list, without copying.
    ///
    /// # Errors
    /// As [`ObjectResults::value`].
    pub fn value_ref<D: Domain, T: Borrow>(
        &self,
        variable: Variable<D, T>,
    ) -> Result<T::Ref<'a>, CommandError> {
        self.read(variable, T::borrow)
    }

    /// A text, without copying.
    ///
    /// # Errors
    /// As [`ObjectResults::value`].
    pub fn str<D: Domain>(&self, variable: Variable<D, String>) -> Result<&'a str, CommandError> {
        self.value_ref(variable)
    }

    /// A text list, without copying.
    ///
    /// # Errors
    /// As [`ObjectResults::value`].
    pub fn strings<D: Domain>(
        &self,
        variable: Variable<D, Vec<String>>,
    ) -> Result<StringList<'a>, CommandError> {
        self.value_ref(variable)
    }

    fn read<D: Domain, T, R>(
        &self,
        variable: Variable<D, T>,
        decode: impl FnOnce(&mut Reader<'a>) -> Result<R, DecodeError>,
    ) -> Result<R, CommandError> {
        let error = |message: String| CommandError {
            command: format!("subscribed {} {}", D::NAME, variable.name),
            object: self.id.to_owned(),
            message,
        };
        let from = self.next.get();
        let found = match self.find(variable.code, from, self.values.len()) {
            Some(found) => Some(found),
            None => self.find(variable.code, 0, from),
        };
        let Some((at, ok)) = found else {
            return Err(error("not among the variables subscribed to".to_owned()));
        };
        let mut reader = Reader::new(&self.values[at..]);
        if !ok {
            let message = reader.string().unwrap_or("no value");
            return Err(error(message.to_owned()));
        }
        let value = decode(&mut reader).map_err(|e| error(e.to_string()))?;
        self.next.set(at + reader.position());
        Ok(value)
    }

    /// Where the value of variable `code` begins, and whether its status is good.
    fn find(&self, code: u8, from: usize, to: usize) -> Option<(usize, bool)> {
        let mut reader = Reader::new(&self.values[from..]);
        while from + reader.position() < to {
            let head = reader.bytes(2).ok()?;
            if head[0] == code {
                return Some((from + reader.position(), head[1] == 0));
            }
            reader.skip().ok()?;
        }
        None
    }
}

/// Narrows a vehicle context subscription to what matters to a driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Filter<'a> {
    /// Only these lanes, relative to the vehicle's own (left positive).
    Lanes(&'a [i8]),
    /// Leave out the opposite direction's lanes.
    NoOpposite,
    /// How far ahead (m).
    DownstreamDistance(f64),
    /// How far behind (m).
    UpstreamDistance(f64),
    /// Only leaders and followers.
    LeadFollow,
    /// Only vehicles that matter for the next junction; foes up to this distance (m) before it.
    Turn(f64),
    /// Only these vehicle classes.
    VehicleClasses(&'a [&'a str]),
    /// Only these vehicle types.
    VehicleTypes(&'a [&'a str]),
    /// Only within this opening angle ahead (degrees).
    FieldOfVision(f64),
    /// Only within this lateral distance of the route (m).
    LateralDistance(f64),
}

impl Filter<'_> {
    pub(super) fn name(&self) -> &'static str {
        match self {
            Self::Lanes(_) => "filter lanes",
            Self::NoOpposite => "filter no_opposite",
            Self::DownstreamDistance(_) => "filter downstream_distance",
            Self::UpstreamDistance(_) => "filter upstream_distance",
            Self::LeadFollow => "filter lead_follow",
            Self::Turn(_) => "filter turn",
            Self::VehicleClasses(_) => "filter vehicle_classes",
            Self::VehicleTypes(_) => "filter vehicle_types",
            Self::FieldOfVision(_) => "filter field_of_vision",
            Self::LateralDistance(_) => "filter lateral_distance",
        }
    }

    pub(super) fn put(&self, out: &mut Vec<u8>) {
        match *self {
            Self::Lanes(lanes) => {
                let lanes = &lanes[..lanes.len().min(255)];
                out.extend_from_slice(&[0x01, lanes.len() as u8]);
                out.extend(lanes.iter().map(|&lane| lane as u8));
            }
            Self::NoOpposite => out.push(0x02),
            Self::LeadFollow => out.push(0x05),
            Self::DownstreamDistance(v) => put_double(out, 0x03, v),
            Self::UpstreamDistance(v) => put_double(out, 0x04, v),
            Self::Turn(v) => put_double(out, 0x07, v),
            Self::FieldOfVision(v) => put_double(out, 0x0A, v),
            Self::LateralDistance(v) => put_double(out, 0x0B, v),
            Self::VehicleClasses(v) => put_strings(out, 0x08, v),
            Self::VehicleTypes(v) => put_strings(out, 0x09, v),
        }
    }
}

fn put_double(out: &mut Vec<u8>, filter: u8, value: f64) {
    out.push(filter);
    f64::encode(value, out);
}

fn put_strings(out: &mut Vec<u8>, filter: u8, value: &[&str]) {
    out.push(filter);
    Vec::<String>::encode(value, out);
}

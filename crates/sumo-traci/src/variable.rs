//! Typed variables: a number, a domain and a type.

use super::codec::{DecodeError, Encode, Reader, StringList, put_compound};
use std::marker::PhantomData;

/// A TraCI domain: a kind of object, and the commands that reach it.
pub trait Domain: Copy + Default + std::fmt::Debug {
    /// Name for messages.
    const NAME: &'static str;
    /// Command "get variable".
    const GET: u8;
    /// Command "set variable".
    const SET: u8 = Self::GET + 0x20;
    /// Command "subscribe to variables".
    const SUBSCRIBE: u8 = Self::GET + 0x30;
    /// Command "subscribe to variables of objects round an object".
    const SUBSCRIBE_CONTEXT: u8 = Self::GET - 0x20;
}

/// A variable of domain `D` that is read as `T`.
#[derive(Debug)]
pub struct Variable<D, T> {
    pub(super) code: u8,
    pub(super) name: &'static str,
    kind: PhantomData<fn() -> (D, T)>,
}

// Derives would require `D: Copy, T: Copy`.
impl<D, T> Clone for Variable<D, T> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<D, T> Copy for Variable<D, T> {}

impl<D, T> Variable<D, T> {
    /// The variable with TraCI's number `code`; `name` is for messages.
    pub const fn new(code: u8, name: &'static str) -> Self {
        Self { code, name, kind: PhantomData }
    }

    /// TraCI's number.
    pub const fn code(self) -> u8 {
        self.code
    }

    /// This variable in a list of variables to subscribe to.
    pub const fn id(self) -> VariableId<'static, D> {
        VariableId { code: self.code, param: None, domain: PhantomData }
    }

    /// This variable with a parameter.
    pub const fn with<P>(self, param: P) -> Query<D, T, P> {
        Query { variable: self, param }
    }
}

/// A variable that can be set; `T` says what with.
#[derive(Debug)]
pub struct Setter<D, T> {
    pub(super) code: u8,
    pub(super) name: &'static str,
    kind: PhantomData<fn() -> (D, T)>,
}

impl<D, T> Clone for Setter<D, T> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<D, T> Copy for Setter<D, T> {}

impl<D, T> Setter<D, T> {
    /// The setter with TraCI's number `code`; `name` is for messages.
    pub const fn new(code: u8, name: &'static str) -> Self {
        Self { code, name, kind: PhantomData }
    }
}

/// A variable together with the parameter that its getter needs.
#[derive(Clone, Copy, Debug)]
pub struct Query<D, T, P> {
    pub(super) variable: Variable<D, T>,
    pub(super) param: P,
}

impl<D, T, P: Copy> Query<D, T, P> {
    /// The variable without its parameter: what names the value among subscription results.
    pub const fn variable(self) -> Variable<D, T> {
        self.variable
    }
}

impl<D, T> Query<D, T, f64> {
    /// This variable, with its parameter, in a list of variables to subscribe to.
    pub const fn id(self) -> VariableId<'static, D> {
        VariableId { code: self.variable.code, param: Some(Param::Double(self.param)), domain: PhantomData }
    }
}

impl<'a, D, T> Query<D, T, &'a str> {
    /// This variable, with its parameter, in a list of variables to subscribe to.
    pub const fn id(self) -> VariableId<'a, D> {
        VariableId { code: self.variable.code, param: Some(Param::Text(self.param)), domain: PhantomData }
    }
}

/// What a command carries besides the object's id: one typed value, or a tuple as a compound.
pub trait Argument {
    /// Appends the typed value.
    fn put(&self, out: &mut Vec<u8>);
}

impl Argument for f64 {
    fn put(&self, out: &mut Vec<u8>) {
        f64::encode(*self, out);
    }
}

impl Argument for i32 {
    fn put(&self, out: &mut Vec<u8>) {
        i32::encode(*self, out);
    }
}

impl Argument for u8 {
    fn put(&self, out: &mut Vec<u8>) {
        u8::encode(*self, out);
    }
}

impl Argument for i8 {
    fn put(&self, out: &mut Vec<u8>) {
        i8::encode(*self, out);
    }
}

impl Argument for &str {
    fn put(&self, out: &mut Vec<u8>) {
        String::encode(self, out);
    }
}

impl Argument for &[String] {
    fn put(&self, out: &mut Vec<u8>) {
        let borrowed: Vec<&str> = self.iter().map(String::as_str).collect();
        Vec::<String>::encode(&borrowed, out);
    }
}

impl Argument for &[super::types::Position2D] {
    fn put(&self, out: &mut Vec<u8>) {
        Vec::<super::types::Position2D>::encode(self, out);
    }
}

impl Argument for super::types::Color {
    fn put(&self, out: &mut Vec<u8>) {
        Self::encode(*self, out);
    }
}

impl Argument for &[f64] {
    fn put(&self, out: &mut Vec<u8>) {
        Vec::<f64>::encode(self, out);
    }
}

impl Argument for &[&str] {
    fn put(&self, out: &mut Vec<u8>) {
        Vec::<String>::encode(self, out);
    }
}

impl Argument for super::types::Position2D {
    fn put(&self, out: &mut Vec<u8>) {
        Self::encode(*self, out);
    }
}

impl Argument for super::types::GeoPosition {
    fn put(&self, out: &mut Vec<u8>) {
        Self::encode(*self, out);
    }
}

impl Argument for &super::types::RoadPosition {
    fn put(&self, out: &mut Vec<u8>) {
        super::types::RoadPosition::encode(self, out);
    }
}

/// No items: an empty compound.
impl Argument for () {
    fn put(&self, out: &mut Vec<u8>) {
        put_compound(out, 0);
    }
}

macro_rules! compound_argument {
    ($n:literal: $($name:ident $index:tt),+) => {
        impl<$($name: Argument),+> Argument for ($($name,)+) {
            fn put(&self, out: &mut Vec<u8>) {
                put_compound(out, $n);
                $(self.$index.put(out);)+
            }
        }
    };
}
compound_argument!(1: A 0);
compound_argument!(2: A 0, B 1);
compound_argument!(3: A 0, B 1, C 2);
compound_argument!(4: A 0, B 1, C 2, E 3);
compound_argument!(5: A 0, B 1, C 2, E 3, F 4);
compound_argument!(6: A 0, B 1, C 2, E 3, F 4, G 5);
compound_argument!(7: A 0, B 1, C 2, E 3, F 4, G 5, H 6);
compound_argument!(9: A 0, B 1, C 2, E 3, F 4, G 5, H 6, I 7, J 8);
compound_argument!(13: A 0, B 1, C 2, E 3, F 4, G 5, H 6, I 7, J 8, K 9, L 10, M 11, N 12);
compound_argument!(14: A 0, B 1, C 2, E 3, F 4, G 5, H 6, I 7, J 8, K 9, L 10, M 11, N 12, O 13);

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Param<'a> {
    Double(f64),
    Text(&'a str),
}

/// A variable in a subscription, whatever its type.
#[derive(Debug)]
pub struct VariableId<'a, D> {
    code: u8,
    param: Option<Param<'a>>,
    domain: PhantomData<fn() -> D>,
}

impl<D> Clone for VariableId<'_, D> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<D> Copy for VariableId<'_, D> {}

impl<D> VariableId<'_, D> {
    pub(super) fn put(&self, out: &mut Vec<u8>) {
        out.push(self.code);
        match self.param {
            None => {}
            Some(Param::Double(value)) => f64::encode(value, out),
            Some(Param::Text(text)) => String::encode(text, out),
        }
    }
}

/// Types that can be read without copying out of the reply.
pub trait Borrow {
    /// The borrowed form.
    type Ref<'a>;
    /// Reads one typed value.
    fn borrow<'a>(reader: &mut Reader<'a>) -> Result<Self::Ref<'a>, DecodeError>;
}

impl Borrow for String {
    type Ref<'a> = &'a str;
    fn borrow<'a>(reader: &mut Reader<'a>) -> Result<&'a str, DecodeError> {
        reader.string()
    }
}

impl Borrow for Vec<String> {
    type Ref<'a> = StringList<'a>;
    fn borrow<'a>(reader: &mut Reader<'a>) -> Result<StringList<'a>, DecodeError> {
        reader.strings()
    }
}

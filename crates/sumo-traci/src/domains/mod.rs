//! One module per TraCI domain: its variables, setters, and the structures that they carry.

/// Defines a domain's marker type and what every domain has.
macro_rules! domain {
    ($(#[$doc:meta])* $domain:ident, $name:literal, $get:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct $domain;

        impl $crate::variable::Domain for $domain {
            const NAME: &'static str = $name;
            const GET: u8 = $get;
        }

        /// Ids of all objects of this domain (ask with id "").
        pub const ID_LIST: $crate::Variable<$domain, Vec<String>> =
            $crate::Variable::new(0x00, "id_list");
        /// Number of objects of this domain (ask with id "").
        pub const ID_COUNT: $crate::Variable<$domain, i32> =
            $crate::Variable::new(0x01, "id_count");

        /// A generic parameter by its key; empty where it is not set.
        pub const fn parameter(key: &str) -> $crate::Query<$domain, String, &str> {
            $crate::Variable::new(0x7e, "parameter").with(key)
        }

        /// A generic parameter with its key: the form to subscribe to.
        pub const fn parameter_with_key(
            key: &str,
        ) -> $crate::Query<$domain, $crate::domains::KeyValue, &str> {
            $crate::Variable::new(0x3e, "parameter_with_key").with(key)
        }

        /// Sets a generic parameter.
        pub fn set_parameter(
            batch: &mut $crate::Batch,
            id: &str,
            key: &str,
            value: &str,
        ) -> $crate::Ticket<()> {
            batch.set_raw($domain, 0x7e, "parameter", id, (key, value))
        }
    };
}

/// Variables of one domain.
macro_rules! variables {
    ($domain:ident: $($(#[$doc:meta])* $name:ident: $type:ty = $code:literal;)*) => {
        $(
            $(#[$doc])*
            #[doc = concat!("TraCI's variable `", stringify!($code), "`.")]
            pub const $name: $crate::Variable<$domain, $type> =
                $crate::Variable::new($code, stringify!($name));
        )*
    };
}

/// Setters of one domain.
macro_rules! setters {
    ($domain:ident: $($(#[$doc:meta])* $name:ident: $type:ty = $code:literal;)*) => {
        $(
            $(#[$doc])*
            #[doc = concat!("TraCI's setter `", stringify!($code), "`.")]
            pub const $name: $crate::Setter<$domain, $type> =
                $crate::Setter::new($code, stringify!($name));
        )*
    };
}

pub mod edge;
pub mod gui;
pub mod junction;
pub mod lane;
pub mod person;
pub mod poi;
pub mod polygon;
pub mod route;
pub mod simulation;
mod stage;
pub mod traffic_light;
pub mod vehicle;
mod vehicle_structs;
pub mod vehicle_type;

pub use stage::{Stage, StageKind};

use super::codec::{Decode, DecodeError, Reader};

/// SUMO's "no value" for doubles, and the default of many parameters.
pub const INVALID_DOUBLE: f64 = -1_073_741_824.0;
/// SUMO's "no value" for integers.
pub const INVALID_INT: i32 = -1_073_741_824;

/// Why an object is removed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(i8)]
pub enum RemoveReason {
    /// It was teleported.
    Teleport = 0,
    /// It parks.
    Parking = 1,
    /// It reached its destination.
    Arrived = 2,
    /// Counted nowhere: the one for objects that a program manages.
    #[default]
    Vaporized = 3,
    /// It was teleported and arrived.
    TeleportArrived = 4,
}

/// A generic parameter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KeyValue {
    /// Its name.
    pub key: String,
    /// Its value.
    pub value: String,
}

impl Decode for KeyValue {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.compound_of(2)?;
        Ok(Self { key: reader.string()?.to_owned(), value: reader.string()?.to_owned() })
    }
}

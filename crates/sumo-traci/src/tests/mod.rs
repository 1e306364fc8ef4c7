//! The protocol without a SUMO: bytes, properties, and faulty servers.

mod goldens;
mod properties;
mod wire;

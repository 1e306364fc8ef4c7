//! A stage of a person's plan, or of a route that SUMO has found.

use super::{INVALID_DOUBLE, INVALID_INT};
use crate::codec::{Decode, DecodeError, Reader};
use crate::variable::Argument;

/// What is done in a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StageKind {
    /// Before its departure.
    WaitingForDepart,
    /// Standing for a time.
    Waiting,
    /// On foot.
    Walking,
    /// Riding a vehicle.
    Driving,
    /// Between a stop and the road.
    Access,
    /// Not yet routed.
    Trip,
    /// Goods changing vehicles.
    Tranship,
    /// A number that this client does not know; a found route has none of the above.
    Other(i32),
}

impl StageKind {
    /// From TraCI's number.
    pub fn from_code(code: i32) -> Self {
        match code {
            0 => Self::WaitingForDepart,
            1 => Self::Waiting,
            2 => Self::Walking,
            3 => Self::Driving,
            4 => Self::Access,
            5 => Self::Trip,
            6 => Self::Tranship,
            other => Self::Other(other),
        }
    }

    /// TraCI's number.
    pub fn code(self) -> i32 {
        match self {
            Self::WaitingForDepart => 0,
            Self::Waiting => 1,
            Self::Walking => 2,
            Self::Driving => 3,
            Self::Access => 4,
            Self::Trip => 5,
            Self::Tranship => 6,
            Self::Other(code) => code,
        }
    }
}

/// A stage. SUMO's "no value" is below -1e9.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// What is done.
    pub kind: StageKind,
    /// Type of the vehicle that is ridden.
    pub vehicle_type: String,
    /// Line or vehicle id.
    pub line: String,
    /// Bus stop at the end.
    pub destination_stop: String,
    /// Edges on the way.
    pub edges: Vec<String>,
    /// s.
    pub travel_time: f64,
    /// What the router took it to cost.
    pub cost: f64,
    /// m.
    pub length: f64,
    /// Intended vehicle.
    pub intended: String,
    /// s.
    pub depart: f64,
    /// m.
    pub depart_position: f64,
    /// m.
    pub arrival_position: f64,
    /// SUMO's own words for it.
    pub description: String,
}

impl Default for Stage {
    fn default() -> Self {
        Self {
            kind: StageKind::Other(INVALID_INT),
            vehicle_type: String::new(),
            line: String::new(),
            destination_stop: String::new(),
            edges: Vec::new(),
            travel_time: INVALID_DOUBLE,
            cost: INVALID_DOUBLE,
            length: INVALID_DOUBLE,
            intended: String::new(),
            depart: INVALID_DOUBLE,
            depart_position: INVALID_DOUBLE,
            arrival_position: INVALID_DOUBLE,
            description: String::new(),
        }
    }
}

impl Decode for Stage {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.compound_of(13)?;
        Ok(Self {
            kind: StageKind::from_code(reader.integer()?),
            vehicle_type: reader.string()?.to_owned(),
            line: reader.string()?.to_owned(),
            destination_stop: reader.string()?.to_owned(),
            edges: Vec::decode(reader)?,
            travel_time: reader.double()?,
            cost: reader.double()?,
            length: reader.double()?,
            intended: reader.string()?.to_owned(),
            depart: reader.double()?,
            depart_position: reader.double()?,
            arrival_position: reader.double()?,
            description: reader.string()?.to_owned(),
        })
    }
}

impl Decode for Vec<Stage> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        // One compound with all stages in it.
        let n = reader.compound()?;
        (0..n).map(|_| Stage::decode(reader)).collect()
    }
}

impl Argument for &Stage {
    fn put(&self, out: &mut Vec<u8>) {
        (
            self.kind.code(),
            self.vehicle_type.as_str(),
            self.line.as_str(),
            self.destination_stop.as_str(),
            self.edges.as_slice(),
            self.travel_time,
            self.cost,
            self.length,
            self.intended.as_str(),
            self.depart,
            self.depart_position,
            self.arrival_position,
            self.description.as_str(),
        )
            .put(out);
    }
}

//! The structures of vehicle variables and commands.

use super::INVALID_DOUBLE;
use crate::codec::{Decode, DecodeError, Encode, Reader, tag};
use crate::variable::Argument;

/// A vehicle ahead or behind.
#[derive(Clone, Debug, PartialEq)]
pub struct Leader {
    /// Vehicle id.
    pub id: String,
    /// Bumper to bumper, less the follower's min_gap (m).
    pub gap: f64,
}

impl Decode for Option<Leader> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.compound_of(2)?;
        let (id, gap) = (reader.string()?, reader.double()?);
        Ok((!id.is_empty()).then(|| Leader { id: id.to_owned(), gap }))
    }
}

impl Decode for Vec<Leader> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        // The items of this one compound have no type tags.
        reader.expect(tag::COMPOUND)?;
        let n = reader.count(12)?;
        (0..n).map(|_| Ok(Leader { id: reader.str()?.to_owned(), gap: reader.f64()? })).collect()
    }
}

/// How good a lane of the current edge is for the route.
#[derive(Clone, Debug, PartialEq)]
pub struct BestLane {
    /// Lane id.
    pub lane: String,
    /// How far it can be driven without a change (m).
    pub length: f64,
    /// Traffic on that way (vehicle lengths with gaps, m).
    pub occupation: f64,
    /// Lanes to the best one, left positive.
    pub offset: i8,
    /// Whether it allows going on along the route.
    pub allows_continuation: bool,
    /// The lanes to follow.
    pub continuation: Vec<String>,
}

impl Decode for Vec<BestLane> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.compound()?;
        let n = reader.typed_count()?;
        let lane = |_| {
            Ok(BestLane {
                lane: reader.string()?.to_owned(),
                length: reader.double()?,
                occupation: reader.double()?,
                offset: reader.byte()?,
                allows_continuation: reader.ubyte()? != 0,
                continuation: Vec::decode(reader)?,
            })
        };
        (0..n).map(lane).collect()
    }
}

/// A traffic light on the way.
#[derive(Clone, Debug, PartialEq)]
pub struct NextTrafficLight {
    /// Traffic light's id.
    pub id: String,
    /// Index into the light's state string.
    pub link_index: i32,
    /// To the stop line (m).
    pub distance: f64,
    /// A character of SUMO's state string.
    pub state: u8,
}

impl Decode for Vec<NextTrafficLight> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.compound()?;
        let n = reader.typed_count()?;
        let light = |_| {
            Ok(NextTrafficLight {
                id: reader.string()?.to_owned(),
                link_index: reader.integer()?,
                distance: reader.double()?,
                state: reader.byte()? as u8,
            })
        };
        (0..n).map(light).collect()
    }
}

/// A way out of the current lane.
#[derive(Clone, Debug, PartialEq)]
pub struct NextLink {
    /// The lane it leads to.
    pub approached_lane: String,
    /// The internal lane over the junction; may be empty.
    pub via: String,
    /// Others must wait for it.
    pub has_priority: bool,
    /// Free right now.
    pub is_open: bool,
    /// A foe is on the junction.
    pub has_foe: bool,
    /// One character of SUMO's link states.
    pub state: String,
    /// One character of SUMO's link directions: s, t, l, r, L, R.
    pub direction: String,
    /// m.
    pub length: f64,
}

impl Decode for Vec<NextLink> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.compound()?;
        let n = reader.typed_count()?;
        let link = |_| {
            let approached_lane = reader.string()?.to_owned();
            let via = reader.string()?.to_owned();
            let has_priority = reader.ubyte()? != 0;
            let is_open = reader.ubyte()? != 0;
            let has_foe = reader.ubyte()? != 0;
            let state = reader.string()?.to_owned();
            let direction = reader.string()?.to_owned();
            let length = reader.double()?;
            Ok(NextLink { approached_lane, via, has_priority, is_open, has_foe, state, direction, length })
        };
        (0..n).map(link).collect()
    }
}

/// A vehicle whose way crosses this one's.
#[derive(Clone, Debug, PartialEq)]
pub struct JunctionFoe {
    /// The foe's vehicle id.
    pub id: String,
    /// This vehicle's and the foe's distance to the conflict (m).
    pub ego_distance: f64,
    /// The foe's distance to the conflict (m).
    pub foe_distance: f64,
    /// Distances to leaving the conflict (m).
    pub ego_exit_distance: f64,
    /// The foe's distance to leaving it (m).
    pub foe_exit_distance: f64,
    /// Internal lane of this vehicle.
    pub ego_lane: String,
    /// Internal lane of the foe.
    pub foe_lane: String,
    /// The vehicle that must wait.
    pub ego_response: bool,
    /// Whether the foe must wait.
    pub foe_response: bool,
}

impl Decode for Vec<JunctionFoe> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.compound()?;
        let n = reader.typed_count()?;
        let foe = |_| {
            Ok(JunctionFoe {
                id: reader.string()?.to_owned(),
                ego_distance: reader.double()?,
                foe_distance: reader.double()?,
                ego_exit_distance: reader.double()?,
                foe_exit_distance: reader.double()?,
                ego_lane: reader.string()?.to_owned(),
                foe_lane: reader.string()?.to_owned(),
                ego_response: reader.ubyte()? != 0,
                foe_response: reader.ubyte()? != 0,
            })
        };
        (0..n).map(foe).collect()
    }
}

/// A stop on the way. Times in s, positions in m; SUMO's "no value" is below -1e9.
#[derive(Clone, Debug, PartialEq)]
pub struct Stop {
    /// Lane id.
    pub lane: String,
    /// Where the stop ends on the lane (m).
    pub end_position: f64,
    /// Id of the bus stop, parking area, ... where it is one.
    pub stopping_place: String,
    /// Bits, as in [`SetStop::flags`].
    pub flags: i32,
    /// How long to stand (s).
    pub duration: f64,
    /// Not to leave before (s of simulation time).
    pub until: f64,
    /// Where the stop begins on the lane (m).
    pub start_position: f64,
    /// Arrival by the timetable (s).
    pub intended_arrival: f64,
    /// When it arrived (s).
    pub arrival: f64,
    /// When it departed (s).
    pub depart: f64,
    /// Train that is split off here.
    pub split: String,
    /// Train that is joined here.
    pub join: String,
    /// Activity, for outputs.
    pub act_type: String,
    /// Trip id, for outputs.
    pub trip_id: String,
    /// Public transport line from here on.
    pub line: String,
    /// Speed while passing, where the stop is a waypoint (m/s).
    pub speed: f64,
}

impl Decode for Vec<Stop> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.compound()?;
        let n = reader.typed_count()?;
        let stop = |_| {
            Ok(Stop {
                lane: reader.string()?.to_owned(),
                end_position: reader.double()?,
                stopping_place: reader.string()?.to_owned(),
                flags: reader.integer()?,
                duration: reader.double()?,
                until: reader.double()?,
                start_position: reader.double()?,
                intended_arrival: reader.double()?,
                arrival: reader.double()?,
                depart: reader.double()?,
                split: reader.string()?.to_owned(),
                join: reader.string()?.to_owned(),
                act_type: reader.string()?.to_owned(),
                trip_id: reader.string()?.to_owned(),
                line: reader.string()?.to_owned(),
                speed: reader.double()?,
            })
        };
        (0..n).map(stop).collect()
    }
}

/// Bits of SUMO's lane-change actions (LCA).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LaneChangeState {
    /// What the model wants.
    pub without_traci: i32,
    /// The state under TraCI's commands.
    pub with_traci: i32,
}

impl Decode for LaneChangeState {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.compound_of(2)?;
        Ok(Self { without_traci: reader.integer()?, with_traci: reader.integer()? })
    }
}

/// The raw marker of a distance along the roads.
#[derive(Clone, Copy, Debug)]
pub struct DrivingDistance;

impl Argument for DrivingDistance {
    fn put(&self, out: &mut Vec<u8>) {
        out.push(0x01);
    }
}

/// A new vehicle. Texts have the values of SUMO's route files ("now", "random", "base", ...).
#[derive(Clone, Copy, Debug)]
pub struct Add<'a> {
    /// Route id; "" puts it on a random edge.
    pub route: &'a str,
    /// Vehicle-type id.
    pub vehicle_type: &'a str,
    /// s, or "now", "triggered".
    pub depart: &'a str,
    /// Index, "first", "best", "free", "random", "allowed".
    pub depart_lane: &'a str,
    /// m, "base", "free", "random", "last".
    pub depart_pos: &'a str,
    /// m/s, "max", "random", "desired", "speedLimit".
    pub depart_speed: &'a str,
    /// Index, "current", "random", "first".
    pub arrival_lane: &'a str,
    /// m, "max", "random".
    pub arrival_pos: &'a str,
    /// m/s, "current".
    pub arrival_speed: &'a str,
    /// District to start in; "" for none.
    pub from_taz: &'a str,
    /// District to arrive in; "" for none.
    pub to_taz: &'a str,
    /// Public transport line; "" for none.
    pub line: &'a str,
    /// Seats.
    pub person_capacity: i32,
    /// Persons on board from the start.
    pub person_number: i32,
}

impl Default for Add<'_> {
    fn default() -> Self {
        Self {
            route: "",
            vehicle_type: "DEFAULT_VEHTYPE",
            depart: "now",
            depart_lane: "first",
            depart_pos: "base",
            depart_speed: "0",
            arrival_lane: "current",
            arrival_pos: "max",
            arrival_speed: "current",
            from_taz: "",
            to_taz: "",
            line: "",
            person_capacity: 0,
            person_number: 0,
        }
    }
}

/// Where to put a vehicle: SUMO's frame, front bumper's centre.
#[derive(Clone, Copy, Debug)]
pub struct MoveToXy<'a> {
    /// A hint which edge and lane is meant; "" and -1 for none.
    pub edge: &'a str,
    /// Index of that lane; -1 for none.
    pub lane_index: i32,
    /// m.
    pub x: f64,
    /// m.
    pub y: f64,
    /// Degrees clockwise from north.
    pub angle_deg: f64,
    /// Bits: 1 keep the route, 2 exact place and off the road too, 4 any lane. 3 is for an external ego.
    pub keep_route: i8,
    /// How far the road may be away (m).
    pub match_threshold: f64,
}

impl Default for MoveToXy<'_> {
    fn default() -> Self {
        Self {
            edge: "",
            lane_index: -1,
            x: 0.0,
            y: 0.0,
            angle_deg: INVALID_DOUBLE,
            keep_route: 3,
            match_threshold: 100.0,
        }
    }
}

/// A stop to make.
#[derive(Clone, Copy, Debug)]
pub struct SetStop<'a> {
    /// Edge id, or id of the stopping place of the kind in `flags`.
    pub place: &'a str,
    /// Where to stop on the lane (m).
    pub position: f64,
    /// 0 is the rightmost lane.
    pub lane_index: i8,
    /// s; 0 takes the stop away.
    pub duration: f64,
    /// Bits: 1 parking, 2 triggered, 4 container-triggered, 8 bus stop, 16 container stop, 32 charging, 64 parking area.
    pub flags: u8,
    /// Begin of the stopping range (m).
    pub start_position: f64,
    /// s of simulation time.
    pub until: f64,
}

impl Default for SetStop<'_> {
    fn default() -> Self {
        Self {
            place: "",
            position: 1.0,
            lane_index: 0,
            duration: INVALID_DOUBLE,
            flags: 0,
            start_position: INVALID_DOUBLE,
            until: INVALID_DOUBLE,
        }
    }
}

/// Encodes like any typed value, for use in tuples.
impl Argument for String {
    fn put(&self, out: &mut Vec<u8>) {
        String::encode(self, out);
    }
}

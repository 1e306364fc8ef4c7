//! Traffic lights: state strings, programs, and what they control.

use crate::codec::{Decode, DecodeError, Reader, put_compound};
use crate::variable::Argument;
use crate::{Batch, Query, Ticket, Variable};

domain!(
    /// The traffic light domain. SUMO has no context subscriptions to it.
    TrafficLight, "trafficlight", 0xa2
);

variables! { TrafficLight:
    /// One character a link: r, y, g, G, u, o, O, s.
    STATE: String = 0x20;
    /// Index of the phase in the program.
    PHASE: i32 = 0x28;
    /// Length of the current phase (s).
    PHASE_DURATION: f64 = 0x24;
    PHASE_NAME: String = 0x1b;
    PROGRAM: String = 0x29;
    /// s of simulation time.
    NEXT_SWITCH: f64 = 0x2d;
    /// s spent in the current phase.
    SPENT_DURATION: f64 = 0x38;
    /// Lane per link, in the order of the state.
    CONTROLLED_LANES: Vec<String> = 0x26;
    /// Links per character of the state.
    CONTROLLED_LINKS: Vec<Vec<ControlledLink>> = 0x27;
    CONTROLLED_JUNCTIONS: Vec<String> = 0x2a;
    PROGRAMS: Vec<Program> = 0x2b;
}

setters! { TrafficLight:
    /// The state until another program is chosen.
    SET_STATE: String = 0x20;
    SET_PHASE: i32 = 0x22;
    /// Rest of the current phase (s).
    SET_PHASE_DURATION: f64 = 0x24;
    SET_PHASE_NAME: String = 0x1b;
    /// "off" switches it off.
    SET_PROGRAM: String = 0x23;
    SET_PROGRAM_DEFINITION: Program = 0x2c;
}

/// Vehicles that wait on foes' account at a link (rail signals).
pub const fn blocking_vehicles(link_index: i32) -> Query<TrafficLight, Vec<String>, i32> {
    Variable::new(0x25, "blocking_vehicles").with(link_index)
}

/// Persons that wait at the crossing of a link.
pub const fn waiting_persons(link_index: i32) -> Query<TrafficLight, i32, i32> {
    Variable::new(0x67, "waiting_persons").with(link_index)
}

/// A link over a signalled junction.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ControlledLink {
    /// Lane that leads to it.
    pub from_lane: String,
    /// Lane that it leads to.
    pub to_lane: String,
    /// Internal lane over the junction.
    pub via_lane: String,
}

impl Decode for Vec<Vec<ControlledLink>> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.compound()?;
        let signals = reader.typed_count()?;
        let mut all = Vec::new();
        for _ in 0..signals {
            let links = reader.typed_count()?;
            let mut signal = Vec::new();
            for _ in 0..links {
                let mut lanes = reader.strings()?.map(str::to_owned);
                let mut lane = || lanes.next().unwrap_or_default();
                signal.push(ControlledLink { from_lane: lane(), to_lane: lane(), via_lane: lane() });
            }
            all.push(signal);
        }
        Ok(all)
    }
}

/// A signal program.
#[derive(Clone, Debug, PartialEq)]
pub struct Program {
    /// Program id.
    pub id: String,
    /// 0 static, 3 actuated, 4 NEMA, 5 delay-based.
    pub kind: i32,
    /// Index of the running phase.
    pub current_phase: i32,
    /// In their order.
    pub phases: Vec<Phase>,
    /// Keys and values of generic parameters.
    pub parameters: Vec<(String, String)>,
}

/// A phase of a signal program; times in s.
#[derive(Clone, Debug, PartialEq)]
pub struct Phase {
    /// How long it lasts (s).
    pub duration: f64,
    /// State string: one character for each signal.
    pub state: String,
    /// Shortest duration (s), where it is actuated.
    pub min_duration: f64,
    /// Longest duration (s), where it is actuated.
    pub max_duration: f64,
    /// Phases that may follow; empty for the next one.
    pub next: Vec<i32>,
    /// Its name; may be empty.
    pub name: String,
}

impl Decode for Phase {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.compound_of(6)?;
        let duration = reader.double()?;
        let state = reader.string()?.to_owned();
        let (min_duration, max_duration) = (reader.double()?, reader.double()?);
        let count = reader.compound()?;
        let next = (0..count).map(|_| reader.integer()).collect::<Result<_, _>>()?;
        Ok(Self { duration, state, min_duration, max_duration, next, name: reader.string()?.to_owned() })
    }
}

impl Decode for Program {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        reader.compound_of(5)?;
        let id = reader.string()?.to_owned();
        let (kind, current_phase) = (reader.integer()?, reader.integer()?);
        let count = reader.compound()?;
        let phases = (0..count).map(|_| Phase::decode(reader)).collect::<Result<_, _>>()?;
        let count = reader.compound()?;
        let pair = |_| {
            let mut pair = reader.strings()?.map(str::to_owned);
            Ok((pair.next().unwrap_or_default(), pair.next().unwrap_or_default()))
        };
        let parameters = (0..count).map(pair).collect::<Result<_, _>>()?;
        Ok(Self { id, kind, current_phase, phases, parameters })
    }
}

impl Decode for Vec<Program> {
    fn decode(reader: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let n = reader.compound()?;
        (0..n).map(|_| Program::decode(reader)).collect()
    }
}

impl crate::codec::Encode for Program {
    type Arg<'a> = &'a Program;
    fn encode(program: &Program, out: &mut Vec<u8>) {
        put_compound(out, 5);
        program.id.as_str().put(out);
        program.kind.put(out);
        program.current_phase.put(out);
        put_compound(out, program.phases.len());
        for phase in &program.phases {
            put_compound(out, 6);
            phase.duration.put(out);
            phase.state.as_str().put(out);
            phase.min_duration.put(out);
            phase.max_duration.put(out);
            put_compound(out, phase.next.len());
            phase.next.iter().for_each(|next| next.put(out));
            phase.name.as_str().put(out);
        }
        put_compound(out, program.parameters.len());
        for (key, value) in &program.parameters {
            [key.as_str(), value.as_str()].as_slice().put(out);
        }
    }
}

/// Replaces or adds a program, and switches to it.
pub fn set_program_definition(batch: &mut Batch, id: &str, program: &Program) -> Ticket<()> {
    batch.set(SET_PROGRAM_DEFINITION, id, program)
}

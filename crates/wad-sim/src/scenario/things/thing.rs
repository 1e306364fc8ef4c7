//! A scenario's obstacles and events as they are.

use crate::tasks::ObstacleKind;
use crate::traffic::{Model, Walker};
use sumo_network::geometry::{Point, Pose};
use sumo_network::network::{LaneId, LanePosition};
use sumo_network::world::ActorKind;

/// When an event begins: at the start of the scenario where both are None, else when the first holds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trigger {
    /// The ego is this near (m).
    pub distance: Option<f64>,
    /// s since the start.
    pub time: Option<f64>,
}

/// A stretch of a lane that is closed, from `s` over `length` (m of its shape).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closure {
    /// Where it begins.
    pub at: LanePosition,
    /// Its length (m).
    pub length: f64,
}

/// The kind of a thing, with its parameters.
#[derive(Clone, Debug)]
pub enum Kind {
    /// A vehicle parked in a lane.
    Vehicle(&'static Model),
    /// A standing person.
    Person(&'static Walker),
    /// A barrier or a cone.
    Object {
        /// Barrier or cone.
        shape: ObjectShape,
        /// Width (m).
        width: f64,
    },
    /// A bench beside the road.
    Bench,
    /// Lanes under a polygon, fenced off.
    RoadWorks(Vec<Closure>),
    /// A person who steps off the kerb and crosses the road.
    Pedestrian {
        /// The kind of person.
        walker: &'static Walker,
        /// Walking speed (m/s).
        speed: f64,
        /// Length of the way (m).
        way: f64,
        /// When the person starts.
        trigger: Trigger,
    },
    /// A vehicle ahead of the ego brakes hard here.
    Brake {
        /// The vehicle that brakes.
        leader: Leader,
        /// Deceleration (m/s2).
        deceleration: f64,
        /// How long it stands (s).
        duration: f64,
    },
    /// Two vehicles that ran into each other.
    Accident([&'static Model; 2]),
    /// A traffic light out of order.
    SignalOff {
        /// SUMO's id of the traffic light.
        light: String,
        /// When the light fails.
        trigger: Trigger,
    },
    /// A lane is closed during the run.
    LaneClosed {
        /// The closed stretch.
        closure: Closure,
        /// When it is closed.
        trigger: Trigger,
    },
}

/// Which vehicle brakes.
#[derive(Clone, Debug)]
pub enum Leader {
    /// One of the scenario's own, by id.
    Drawn(String),
    /// One that drives `gap` (m) ahead of the ego, bumper to bumper, from the start.
    Ahead {
        /// The vehicle's model.
        model: &'static Model,
        /// Distance to the ego (m).
        gap: f64,
    },
}

/// Objects on the road other than vehicles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObjectShape {
    /// A striped barrier across a lane.
    Barrier,
    /// A traffic cone.
    Cone,
}

impl ObjectShape {
    /// Its SUMO vehicle type.
    pub fn type_id(self) -> &'static str {
        match self {
            Self::Barrier => "wad_object_barrier",
            Self::Cone => "wad_object_cone",
        }
    }

    /// Length, height and default width (m).
    pub fn sizes(self) -> (f64, f64, f64) {
        match self {
            Self::Barrier => (0.5, 1.0, 2.4),
            Self::Cone => (0.4, 0.75, 0.4),
        }
    }
}

/// A thing and its place.
#[derive(Clone, Debug)]
pub struct Thing {
    /// The point's or polygon's id.
    pub id: String,
    /// Obstacle or event, with its parameters.
    pub kind: Kind,
    /// Where the author put it.
    pub point: Point,
    /// The nearest lane for cars.
    pub lane: LaneId,
    /// The nearest place on that lane (m).
    pub s: f64,
    /// Offset to the left of the lane's middle (m).
    pub d: f64,
    /// The place on the lane's middle, in the lane's direction.
    pub pose: Pose,
}

impl Thing {
    /// Its kind of obstacle for the obstacle task.
    pub fn obstacle_kind(&self) -> Option<ObstacleKind> {
        Some(match &self.kind {
            Kind::Person(_) => ObstacleKind::Person,
            Kind::Vehicle(model) => match model.kind {
                ActorKind::Truck => ObstacleKind::Truck,
                ActorKind::Bus => ObstacleKind::Bus,
                ActorKind::Motorcycle => ObstacleKind::Motorcycle,
                ActorKind::Bicycle => ObstacleKind::Bicycle,
                _ => ObstacleKind::Car,
            },
            _ => return None,
        })
    }
}

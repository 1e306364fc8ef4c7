//! Bundled towns with road users put where a test wants them.

use crate::scene::Look;
use crate::tests::towns;
use crate::{Camera, CameraConfig, Outputs, Town, Weather};
use std::sync::Arc;
use sumo_network::geometry::Pose;
use sumo_network::network::{EdgeKind, Lane, Network, Shapes, VehicleClass};
use sumo_network::world::{Actor, ActorKind, ActorType, VehicleSignals, WorldState};

/// Kinds with the type and the sizes (m) that SUMO would give.
pub const KINDS: [(ActorKind, &str, [f64; 3]); 8] = [
    (ActorKind::Car, "car.hatchback", [4.19, 1.80, 1.47]),
    (ActorKind::Car, "car.suv", [4.86, 1.94, 1.72]),
    (ActorKind::Van, "van.delivery", [5.92, 1.99, 2.56]),
    (ActorKind::Truck, "truck.box", [7.2, 2.4, 3.1]),
    (ActorKind::Bus, "bus.city", [10.27, 2.5, 3.1]),
    (ActorKind::Motorcycle, "motorcycle.sport", [2.03, 0.8, 1.55]),
    (ActorKind::Bicycle, "bicycle.city", [1.84, 0.6, 1.75]),
    (ActorKind::Pedestrian, "pedestrian", [0.3, 0.5, 1.75]),
];

/// A network and its town.
pub struct Place {
    pub network: Network,
    pub town: Town,
}

impl Place {
    pub fn bundled(name: &str) -> Self {
        let net = towns::net(name);
        let network = Network::load(&net).unwrap();
        let shapes = Shapes::load(&net.with_file_name(format!("{name}.poly.xml")), &network).unwrap();
        Self::of(network, &shapes)
    }

    pub fn of(network: Network, shapes: &Shapes) -> Self {
        let town = Town::new(&network, shapes, Look::of(0));
        Self { network, town }
    }

    /// Road users at these poses, by index into [`KINDS`].
    pub fn put(&mut self, users: &[(usize, Pose)]) {
        let mut world = WorldState { time: 12.0, ..WorldState::default() };
        for (n, &(index, pose)) in users.iter().enumerate() {
            let (kind, id, [length, width, height]) = KINDS[index];
            let actor_type = Arc::new(ActorType { id: id.into(), kind, length, width, height, min_gap: 2.0 });
            let actor = Actor {
                id: Arc::from(format!("{n}").as_str()),
                key: 17 * n as u64 + 3,
                actor_type,
                pose,
                speed: 1.4,
                signals: VehicleSignals(if n % 2 == 0 { VehicleSignals::BRAKE_LIGHT } else { 0 }),
                lane: None,
                lane_position: 0.0,
            };
            if kind == ActorKind::Pedestrian { &mut world.pedestrians } else { &mut world.vehicles }
                .push(actor);
        }
        world.traffic_lights = self
            .network
            .traffic_lights
            .iter()
            .map(|light| Some(Arc::from("rGyg".repeat(light.signals.div_ceil(4)).as_str())))
            .collect();
        self.town.follow(&world, None);
    }

    /// All that a camera sees from `pose`.
    pub fn shoot(&self, size: usize, pose: &Pose, weather: impl Into<Weather>) -> crate::Frame {
        let mut camera = Camera::new(CameraConfig::sized(size, size)).unwrap();
        camera.render(self.town.scene(), self.town.actors(), pose, &weather.into(), Outputs::ALL).clone()
    }

    /// Lanes for cars that run straight for at least `length` (m).
    pub fn straight_lanes(&self, length: f64) -> impl Iterator<Item = &Lane> {
        self.network.lanes.iter().filter(move |lane| {
            let shape = &lane.shape;
            let ends = (shape.at(0.0).position - shape.at(shape.length()).position).norm();
            self.network.edge(lane.edge).kind == EdgeKind::Normal
                && lane.permissions.allows(VehicleClass::Passenger)
                && shape.length() >= length
                && shape.length() - ends < 0.01
        })
    }
}

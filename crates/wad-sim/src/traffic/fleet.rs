//! The fleet: which vehicles and pedestrians there are, how large, and how they drive.
//!
//! Sizes follow CARLA 0.9's vehicle catalogue. Widths are without mirrors (CARLA's boxes hold
//! them, and its bus would not fit a lane); trucks and buses have the size of the vehicle that
//! the model stands for.

use super::draw::pick_weighted;
use rand_chacha::ChaCha8Rng;
use sumo_network::network::VehicleClass;
use sumo_network::seeds::normal;
use sumo_network::world::ActorKind;
use sumo_traci::{Batch, vehicle_type};

/// An opaque colour: red, green, blue.
pub type Rgb = [u8; 3];

/// A normal distribution cut off at both ends, redrawn when outside (SUMO's `normc`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normc {
    /// The mean.
    pub mean: f64,
    /// The standard deviation.
    pub deviation: f64,
    /// The lower bound.
    pub min: f64,
    /// The upper bound.
    pub max: f64,
}

impl Normc {
    const fn new(mean: f64, deviation: f64, min: f64, max: f64) -> Self {
        Self { mean, deviation, min, max }
    }

    /// One draw.
    pub fn draw(self, rng: &mut ChaCha8Rng) -> f64 {
        for _ in 0..64 {
            let value = self.mean + self.deviation * normal(rng);
            if (self.min..=self.max).contains(&value) {
                return value;
            }
        }
        self.mean
    }
}

/// A vehicle model of the fleet: one SUMO vehicle type.
#[derive(Clone, Copy, Debug)]
pub struct Model {
    /// SUMO's vehicle type id.
    pub id: &'static str,
    /// The kind of road user.
    pub kind: ActorKind,
    /// SUMO's vehicle class, which says where it may drive.
    pub class: VehicleClass,
    /// SUMO's `guiShape`.
    pub shape: &'static str,
    /// Share of the fleet (per thousand).
    pub share: u32,
    /// Front to rear (m).
    pub length: f64,
    /// Side to side (m).
    pub width: f64,
    /// Above the ground (m).
    pub height: f64,
    /// Largest acceleration (m/s2).
    pub accel: f64,
    /// Comfortable deceleration (m/s2).
    pub decel: f64,
    /// Hardest braking (m/s2).
    pub emergency_decel: f64,
    /// Top speed (m/s).
    pub max_speed: f64,
    /// Gap kept when standing (m).
    pub min_gap: f64,
    /// Krauss' driver imperfection, 0..1.
    pub sigma: f64,
    /// Wanted speed over the speed limit, drawn per vehicle.
    pub speed_factor: Normc,
    palette: &'static [(u32, Rgb)],
}

/// Colours of cars with their shares (per cent), as sold over the last ten years.
const CAR_COLOURS: &[(u32, Rgb)] = &[
    (26, [236, 238, 238]),
    (21, [26, 27, 30]),
    (17, [104, 109, 115]),
    (13, [184, 188, 192]),
    (8, [36, 72, 132]),
    (4, [74, 122, 176]),
    (5, [166, 28, 32]),
    (2, [120, 18, 30]),
    (1, [50, 92, 62]),
    (1, [190, 172, 140]),
    (1, [212, 176, 36]),
    (1, [204, 92, 30]),
];
const VAN_COLOURS: &[(u32, Rgb)] = &[
    (55, [238, 238, 234]),
    (15, [176, 180, 184]),
    (10, [44, 60, 98]),
    (10, [214, 178, 52]),
    (10, [92, 150, 162]),
];
const TRUCK_COLOURS: &[(u32, Rgb)] =
    &[(40, [232, 232, 228]), (20, [44, 96, 72]), (20, [176, 40, 34]), (20, [42, 66, 116])];
const FIRE_COLOURS: &[(u32, Rgb)] = &[(1, [186, 24, 22])];
const BUS_COLOURS: &[(u32, Rgb)] = &[(50, [212, 174, 44]), (30, [186, 44, 40]), (20, [232, 234, 236])];
const BIKE_COLOURS: &[(u32, Rgb)] = &[
    (40, [34, 35, 38]),
    (20, [160, 34, 34]),
    (15, [40, 84, 160]),
    (15, [44, 124, 62]),
    (10, [206, 208, 210]),
];

const CAR_SPEED: Normc = Normc::new(1.0, 0.1, 0.8, 1.2);
const VAN_SPEED: Normc = Normc::new(0.97, 0.08, 0.8, 1.1);
const HEAVY_SPEED: Normc = Normc::new(0.92, 0.06, 0.8, 1.0);
// Of a cyclist's 20 km/h, SUMO's own wanted speed of the class.
const CITY_BIKE_SPEED: Normc = Normc::new(0.9, 0.1, 0.65, 1.2);
const ROAD_BIKE_SPEED: Normc = Normc::new(1.15, 0.12, 0.85, 1.4);

/// A car; the cars differ in size, acceleration and share alone.
const fn car(id: &'static str, shape: &'static str, share: u32, size: [f64; 3], accel: f64) -> Model {
    Model {
        id,
        kind: ActorKind::Car,
        class: VehicleClass::Passenger,
        shape,
        share,
        length: size[0],
        width: size[1],
        height: size[2],
        accel,
        decel: 4.5,
        emergency_decel: 9.0,
        max_speed: 50.0,
        min_gap: 2.5,
        sigma: 0.4,
        speed_factor: CAR_SPEED,
        palette: CAR_COLOURS,
    }
}

/// The fleet: cars 68 %, vans 9 %, trucks 4 %, buses 2 %, motorcycles 10 %, bicycles 7 %.
pub const FLEET: &[Model] = &[
    car("wad_car_mini", "passenger/hatchback", 100, [3.71, 1.70, 1.52], 2.4),
    car("wad_car_hatchback", "passenger/hatchback", 150, [4.19, 1.80, 1.47], 2.6),
    car("wad_car_saloon", "passenger/sedan", 160, [4.79, 1.85, 1.46], 2.8),
    car("wad_car_saloon_long", "passenger/sedan", 70, [5.36, 1.90, 1.43], 2.6),
    car("wad_car_estate", "passenger/wagon", 80, [4.61, 1.82, 1.56], 2.5),
    car("wad_car_suv", "passenger/wagon", 80, [4.86, 1.94, 1.72], 2.6),
    car("wad_car_coupe", "passenger/sedan", 40, [4.18, 1.84, 1.36], 3.2),
    Model {
        kind: ActorKind::Van,
        speed_factor: VAN_SPEED,
        palette: VAN_COLOURS,
        max_speed: 36.0,
        ..car("wad_van_camper", "passenger/van", 40, [4.48, 1.80, 2.05], 1.9)
    },
    Model {
        kind: ActorKind::Van,
        class: VehicleClass::Delivery,
        speed_factor: VAN_SPEED,
        palette: VAN_COLOURS,
        max_speed: 40.0,
        ..car("wad_van_delivery", "delivery", 50, [5.92, 1.99, 2.56], 1.9)
    },
    Model {
        kind: ActorKind::Truck,
        class: VehicleClass::Truck,
        speed_factor: HEAVY_SPEED,
        palette: TRUCK_COLOURS,
        decel: 4.0,
        emergency_decel: 7.0,
        max_speed: 25.0,
        ..car("wad_truck_box", "truck", 30, [7.20, 2.40, 3.10], 1.3)
    },
    Model {
        kind: ActorKind::Truck,
        class: VehicleClass::Truck,
        speed_factor: HEAVY_SPEED,
        palette: FIRE_COLOURS,
        decel: 4.0,
        emergency_decel: 7.0,
        max_speed: 28.0,
        ..car("wad_truck_fire", "truck", 10, [8.47, 2.50, 3.40], 1.4)
    },
    Model {
        kind: ActorKind::Bus,
        class: VehicleClass::Bus,
        speed_factor: HEAVY_SPEED,
        palette: BUS_COLOURS,
        decel: 4.0,
        emergency_decel: 7.0,
        max_speed: 24.0,
        ..car("wad_bus", "bus", 20, [10.27, 2.50, 3.10], 1.2)
    },
    Model {
        kind: ActorKind::Motorcycle,
        class: VehicleClass::Motorcycle,
        palette: BIKE_COLOURS,
        decel: 6.0,
        min_gap: 2.0,
        ..car("wad_motorcycle_cruiser", "motorcycle", 40, [2.35, 0.85, 1.60], 4.0)
    },
    Model {
        kind: ActorKind::Motorcycle,
        class: VehicleClass::Motorcycle,
        palette: BIKE_COLOURS,
        decel: 6.0,
        min_gap: 2.0,
        ..car("wad_motorcycle_sport", "motorcycle", 30, [2.04, 0.80, 1.55], 4.5)
    },
    Model {
        kind: ActorKind::Motorcycle,
        class: VehicleClass::Motorcycle,
        palette: BIKE_COLOURS,
        decel: 5.0,
        min_gap: 2.0,
        max_speed: 25.0,
        ..car("wad_motorcycle_scooter", "moped", 30, [1.80, 0.75, 1.65], 2.4)
    },
    Model {
        kind: ActorKind::Bicycle,
        class: VehicleClass::Bicycle,
        speed_factor: CITY_BIKE_SPEED,
        palette: BIKE_COLOURS,
        decel: 3.0,
        emergency_decel: 5.0,
        max_speed: 7.0,
        min_gap: 1.0,
        ..car("wad_bicycle_city", "bicycle", 40, [1.84, 0.60, 1.75], 1.0)
    },
    Model {
        kind: ActorKind::Bicycle,
        class: VehicleClass::Bicycle,
        speed_factor: ROAD_BIKE_SPEED,
        palette: BIKE_COLOURS,
        decel: 3.5,
        emergency_decel: 5.5,
        max_speed: 8.0,
        min_gap: 1.0,
        ..car("wad_bicycle_road", "bicycle", 30, [1.65, 0.55, 1.70], 1.2)
    },
];

/// A kind of pedestrian: one SUMO vehicle type.
#[derive(Clone, Copy, Debug)]
pub struct Walker {
    /// SUMO's vehicle type id.
    pub id: &'static str,
    /// Share of all pedestrians (per cent).
    pub share: u32,
    /// Side to side (m).
    pub width: f64,
    /// Above the ground (m).
    pub height: f64,
    /// Wanted walking speed (m/s), drawn per pedestrian.
    pub speed: Normc,
}

/// Adults, children and older people.
pub const WALKERS: &[Walker] = &[
    Walker {
        id: "wad_pedestrian_adult",
        share: 72,
        width: 0.5,
        height: 1.75,
        speed: Normc::new(1.34, 0.2, 0.9, 1.9),
    },
    Walker {
        id: "wad_pedestrian_child",
        share: 13,
        width: 0.4,
        height: 1.25,
        speed: Normc::new(1.2, 0.2, 0.8, 1.8),
    },
    Walker {
        id: "wad_pedestrian_senior",
        share: 15,
        width: 0.5,
        height: 1.68,
        speed: Normc::new(1.0, 0.12, 0.7, 1.3),
    },
];

/// Clothes' colours.
const CLOTHES: &[(u32, Rgb)] = &[
    (20, [40, 42, 48]),
    (15, [54, 74, 118]),
    (12, [110, 112, 116]),
    (12, [206, 204, 198]),
    (10, [140, 44, 44]),
    (8, [66, 98, 64]),
    (8, [176, 142, 96]),
    (8, [86, 62, 46]),
    (4, [196, 160, 40]),
    (3, [150, 90, 140]),
];

/// Draws one of the models that `possible` accepts (by its index in [`FLEET`]);
/// None if none is possible.
pub fn draw_model(rng: &mut ChaCha8Rng, possible: impl Fn(usize) -> bool) -> Option<usize> {
    pick_weighted(
        rng,
        FLEET.iter().enumerate().map(|(i, m)| if possible(i) { f64::from(m.share) } else { 0.0 }),
    )
}

/// Draws a colour for a model.
pub fn draw_colour(rng: &mut ChaCha8Rng, model: &Model) -> Rgb {
    draw_from(rng, model.palette)
}

/// Draws a kind of pedestrian and its clothes' colour.
pub fn draw_walker(rng: &mut ChaCha8Rng) -> (&'static Walker, Rgb) {
    let kind = pick_weighted(rng, WALKERS.iter().map(|w| f64::from(w.share))).unwrap_or(0);
    (&WALKERS[kind], draw_from(rng, CLOTHES))
}

fn draw_from(rng: &mut ChaCha8Rng, palette: &[(u32, Rgb)]) -> Rgb {
    let chosen = pick_weighted(rng, palette.iter().map(|c| f64::from(c.0)));
    chosen.map_or([128, 128, 128], |i| palette[i].1)
}

/// Defines every vehicle and pedestrian type in SUMO.
pub(super) fn define(batch: &mut Batch) {
    for model in FLEET {
        let base = if model.kind == ActorKind::Bicycle { "DEFAULT_BIKETYPE" } else { "DEFAULT_VEHTYPE" };
        vehicle_type::copy(batch, base, model.id);
        batch.set(vehicle_type::SET_VEHICLE_CLASS, model.id, model.class.sumo_name());
        batch.set(vehicle_type::SET_SHAPE_CLASS, model.id, model.shape);
        for (setter, value) in [
            (vehicle_type::SET_LENGTH, model.length),
            (vehicle_type::SET_WIDTH, model.width),
            (vehicle_type::SET_HEIGHT, model.height),
            (vehicle_type::SET_ACCEL, model.accel),
            (vehicle_type::SET_DECEL, model.decel),
            (vehicle_type::SET_EMERGENCY_DECEL, model.emergency_decel),
            (vehicle_type::SET_APPARENT_DECEL, model.decel),
            (vehicle_type::SET_MAX_SPEED, model.max_speed),
            (vehicle_type::SET_MIN_GAP, model.min_gap),
            (vehicle_type::SET_IMPERFECTION, model.sigma),
        ] {
            batch.set(setter, model.id, value);
        }
    }
    for walker in WALKERS {
        vehicle_type::copy(batch, "DEFAULT_PEDTYPE", walker.id);
        batch.set(vehicle_type::SET_WIDTH, walker.id, walker.width);
        batch.set(vehicle_type::SET_HEIGHT, walker.id, walker.height);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use std::collections::BTreeMap;

    #[test]
    fn the_mix_is_carlas() {
        assert_eq!(FLEET.iter().map(|m| m.share).sum::<u32>(), 1000);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut seen = BTreeMap::new();
        for _ in 0..20_000 {
            let model = &FLEET[draw_model(&mut rng, |_| true).unwrap()];
            *seen.entry(format!("{:?}", model.kind)).or_insert(0) += 1;
        }
        let share = |kind: &str| f64::from(seen[kind]) / 20_000.0;
        for (kind, expected) in [
            ("Car", 0.68),
            ("Van", 0.09),
            ("Truck", 0.04),
            ("Bus", 0.02),
            ("Motorcycle", 0.10),
            ("Bicycle", 0.07),
        ] {
            assert!((share(kind) - expected).abs() < 0.015, "{kind}: {}", share(kind));
        }
    }

    #[test]
    fn what_the_net_forbids_is_never_drawn() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let no_heavy = |i: usize| !matches!(FLEET[i].kind, ActorKind::Truck | ActorKind::Bus);
        for _ in 0..2000 {
            assert!(no_heavy(draw_model(&mut rng, no_heavy).unwrap()));
        }
        assert_eq!(draw_model(&mut rng, |_| false), None);
    }

    #[test]
    fn drawn_factors_stay_within_their_bounds() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let draws: Vec<f64> = (0..5000).map(|_| CAR_SPEED.draw(&mut rng)).collect();
        assert!(draws.iter().all(|f| (0.8..=1.2).contains(f)));
        let mean = draws.iter().sum::<f64>() / draws.len() as f64;
        assert!((mean - 1.0).abs() < 0.01, "{mean}");
        assert!(draws.iter().any(|f| *f > 1.12) && draws.iter().any(|f| *f < 0.88));
    }
}

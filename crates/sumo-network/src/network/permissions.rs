//! Which vehicle classes may use a lane.

use std::fmt;

/// SUMO's vehicle classes; the bit of a class is its position here.
const CLASSES: [&str; 33] = [
    "passenger",
    "delivery",
    "truck",
    "bus",
    "motorcycle",
    "bicycle",
    "pedestrian",
    "private",
    "emergency",
    "authority",
    "army",
    "vip",
    "hov",
    "taxi",
    "coach",
    "trailer",
    "tram",
    "rail_urban",
    "rail",
    "rail_electric",
    "rail_fast",
    "moped",
    "evehicle",
    "ship",
    "container",
    "cable_car",
    "subway",
    "aircraft",
    "wheelchair",
    "scooter",
    "drone",
    "custom1",
    "custom2",
];

/// Vehicle classes as a bit set (SUMO's SVCPermissions, our own bit order).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Permissions(pub u64);

impl Permissions {
    /// Every class.
    pub const ALL: Self = Self((1 << CLASSES.len()) - 1);
    /// No class.
    pub const NONE: Self = Self(0);

    /// Whether `class` is in the set.
    pub fn allows(self, class: VehicleClass) -> bool {
        self.0 & class.bit() != 0
    }

    /// The set that `allow` and `disallow` attributes give: `allow` wins, neither means all.
    pub fn from_attributes(allow: Option<&str>, disallow: Option<&str>) -> Self {
        match (allow.map(str::trim), disallow.map(str::trim)) {
            (Some(allow), _) if !allow.is_empty() => Self::parse(allow),
            (_, Some(disallow)) if !disallow.is_empty() => Self(Self::ALL.0 & !Self::parse(disallow).0),
            _ => Self::ALL,
        }
    }

    /// A space-separated list of SUMO's class names; unknown names are ignored.
    fn parse(list: &str) -> Self {
        list.split_ascii_whitespace().fold(Self::NONE, |set, name| Self(set.0 | Self::bits_of(name)))
    }

    fn bits_of(name: &str) -> u64 {
        // Names that old nets use, and their modern ones.
        let name = match name {
            "all" => return Self::ALL.0,
            "public_emergency" => "emergency",
            "public_authority" => "authority",
            "public_army" => "army",
            "public_transport" => "bus",
            "transport" => "truck",
            "lightrail" => "tram",
            "cityrail" => "rail_urban",
            "rail_slow" => "rail",
            "taxi_pt" => "taxi",
            other => other,
        };
        CLASSES.iter().position(|&c| c == name).map_or(0, |bit| 1 << bit)
    }
}

/// SUMO's abstract vehicle classes that the bridge distinguishes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum VehicleClass {
    /// Cars.
    Passenger,
    /// Delivery vans.
    Delivery,
    /// Lorries.
    Truck,
    /// Buses.
    Bus,
    /// Motorcycles.
    Motorcycle,
    /// Bicycles.
    Bicycle,
    /// Pedestrians.
    Pedestrian,
}

impl VehicleClass {
    /// All of them, in the order of their numbers.
    pub const EVERY: [Self; 7] = [
        Self::Passenger,
        Self::Delivery,
        Self::Truck,
        Self::Bus,
        Self::Motorcycle,
        Self::Bicycle,
        Self::Pedestrian,
    ];

    fn bit(self) -> u64 {
        1 << self as u32
    }

    /// SUMO's name of the class.
    pub fn sumo_name(self) -> &'static str {
        CLASSES[self as usize]
    }

    /// SUMO's default top speed of the class (m/s).
    pub fn max_speed(self) -> f64 {
        match self {
            Self::Passenger | Self::Delivery | Self::Motorcycle => 55.56,
            Self::Truck => 36.11,
            Self::Bus => 27.78,
            Self::Bicycle => 5.56,
            Self::Pedestrian => 1.39,
        }
    }
}

impl fmt::Display for VehicleClass {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.sumo_name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn allow_wins_over_disallow_and_neither_means_all() {
        assert_eq!(Permissions::from_attributes(None, None), Permissions::ALL);
        assert_eq!(Permissions::from_attributes(Some(""), None), Permissions::ALL);
        let bus = Permissions::from_attributes(Some("bus coach"), Some("all"));
        assert!(bus.allows(VehicleClass::Bus) && !bus.allows(VehicleClass::Passenger));
        let road = Permissions::from_attributes(None, Some("pedestrian tram no_such_class"));
        assert!(road.allows(VehicleClass::Passenger) && !road.allows(VehicleClass::Pedestrian));
        assert_eq!(Permissions::from_attributes(None, Some("all")), Permissions::NONE);
    }

    #[test]
    fn class_names_are_those_of_their_bits() {
        for class in VehicleClass::EVERY {
            assert!(Permissions::from_attributes(Some(class.sumo_name()), None).allows(class));
        }
        assert_eq!(VehicleClass::Pedestrian.sumo_name(), "pedestrian");
    }
}

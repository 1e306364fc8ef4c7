//! The bodies of cars and vans: their lines, and which one a vehicle type gets.

use super::body::BodyLines;

/// A kind of car body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Body {
    Hatchback,
    Saloon,
    Estate,
    Suv,
    Coupe,
    Minivan,
    PanelVan,
}

impl Body {
    pub const ALL: [Self; 7] =
        [Self::Hatchback, Self::Saloon, Self::Estate, Self::Suv, Self::Coupe, Self::Minivan, Self::PanelVan];

    /// The body for a car of these sizes (m); the type's name may decide.
    pub fn of(id: &str, length: f64, height: f64, key: u64) -> Self {
        let named = [
            ("hatch", Self::Hatchback),
            ("mini", Self::Hatchback),
            ("saloon", Self::Saloon),
            ("sedan", Self::Saloon),
            ("estate", Self::Estate),
            ("wagon", Self::Estate),
            ("suv", Self::Suv),
            ("coupe", Self::Coupe),
            ("camper", Self::Minivan),
        ];
        if let Some((_, body)) = named.into_iter().find(|(name, _)| id.contains(name)) {
            return body;
        }
        match (length, height) {
            (_, h) if h > 2.2 => Self::PanelVan,
            (_, h) if h > 1.85 => Self::Minivan,
            (_, h) if h > 1.62 => Self::Suv,
            (l, _) if l < 4.1 => Self::Hatchback,
            // SUMO's default car, 5 m long and 1.5 m high, is any of these.
            _ => [Self::Saloon, Self::Hatchback, Self::Estate, Self::Saloon, Self::Suv, Self::Coupe]
                [(key >> 7) as usize % 6],
        }
    }

    pub fn lines(self) -> BodyLines {
        let saloon = BodyLines {
            length: 4.75,
            width: 1.85,
            height: 1.45,
            floor: 0.21,
            nose: 0.70,
            cowl: 0.98,
            shoulder: 0.97,
            tail: 0.98,
            screen: 0.88,
            roof_front: 0.18,
            roof_rear: -1.02,
            deck: -1.68,
            front_axle: 1.42,
            rear_axle: -1.36,
            wheel: 0.325,
            tyre: 0.215,
            roof_width: 0.72,
            pillars: &[0.72, -0.36, -1.30],
            panel_van: false,
        };
        match self {
            Self::Saloon => saloon,
            Self::Hatchback => BodyLines {
                length: 4.05,
                width: 1.78,
                height: 1.48,
                nose: 0.72,
                cowl: 1.0,
                shoulder: 0.99,
                tail: 0.98,
                screen: 0.86,
                roof_front: 0.22,
                roof_rear: -1.42,
                deck: -1.90,
                front_axle: 1.26,
                rear_axle: -1.26,
                wheel: 0.31,
                tyre: 0.20,
                roof_width: 0.74,
                pillars: &[0.72, -0.34, -1.30],
                ..saloon
            },
            Self::Estate => BodyLines {
                length: 4.65,
                width: 1.82,
                height: 1.50,
                tail: 1.0,
                roof_front: 0.26,
                screen: 0.92,
                roof_rear: -1.78,
                deck: -2.18,
                front_axle: 1.40,
                rear_axle: -1.34,
                roof_width: 0.75,
                pillars: &[0.78, -0.30, -1.32],
                ..saloon
            },
            Self::Suv => BodyLines {
                length: 4.65,
                width: 1.92,
                height: 1.70,
                floor: 0.27,
                nose: 0.88,
                cowl: 1.14,
                shoulder: 1.14,
                tail: 1.12,
                screen: 0.98,
                roof_front: 0.34,
                roof_rear: -1.72,
                deck: -2.14,
                front_axle: 1.40,
                rear_axle: -1.36,
                wheel: 0.365,
                tyre: 0.24,
                roof_width: 0.76,
                pillars: &[0.84, -0.28, -1.30],
                ..saloon
            },
            Self::Coupe => BodyLines {
                length: 4.3,
                width: 1.84,
                height: 1.34,
                floor: 0.17,
                nose: 0.64,
                cowl: 0.92,
                shoulder: 0.93,
                tail: 0.94,
                screen: 0.68,
                roof_front: -0.04,
                roof_rear: -0.86,
                deck: -1.68,
                front_axle: 1.32,
                rear_axle: -1.26,
                roof_width: 0.70,
                pillars: &[0.52, -0.80],
                ..saloon
            },
            Self::Minivan => BodyLines {
                length: 4.5,
                width: 1.84,
                height: 2.0,
                nose: 0.92,
                cowl: 1.18,
                shoulder: 1.16,
                tail: 1.10,
                screen: 1.40,
                roof_front: 0.74,
                roof_rear: -2.02,
                deck: -2.20,
                front_axle: 1.42,
                rear_axle: -1.40,
                roof_width: 0.82,
                pillars: &[1.20, 0.34, -0.78, -1.80],
                ..saloon
            },
            Self::PanelVan => BodyLines {
                length: 5.9,
                width: 2.0,
                height: 2.5,
                floor: 0.28,
                nose: 1.02,
                cowl: 1.36,
                shoulder: 1.34,
                tail: 1.30,
                screen: 2.26,
                roof_front: 1.36,
                roof_rear: -2.82,
                deck: -2.90,
                front_axle: 2.0,
                rear_axle: -1.68,
                wheel: 0.35,
                tyre: 0.22,
                roof_width: 0.85,
                pillars: &[1.95, 0.98],
                panel_van: true,
            },
        }
    }
}

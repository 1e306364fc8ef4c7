//! What of a town its net and polygons leave open.

/// How a town looks. [`Look::of`] is how agents and networks know the bundled towns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// The seed of façades, colours, kinds and places of trees, models and colours of parked cars.
    pub seed: u64,
    /// Share of the paint that is left (0..1). Below 1 stripes are paler and some are missing.
    pub paint: f32,
    /// Cars parked along streets: 0 none, 1 as usual, 1.5 on every street that has room.
    pub parked: f32,
    /// Trees along streets: 0 none, 1 as usual, 2 on every street and with crowns over the road.
    pub trees: f32,
    /// Many more signs stand along the roads, and say anything: for those who learn to read them. Drivers do not obey
    /// them.
    pub many_signs: bool,
}

impl Look {
    /// As usual, with this seed.
    pub const fn of(seed: u64) -> Self {
        Self { seed, paint: 1.0, parked: 1.0, trees: 1.0, many_signs: false }
    }
}

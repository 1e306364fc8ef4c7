//! The background population.

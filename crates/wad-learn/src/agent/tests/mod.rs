//! The algorithms against plain arithmetic, and on a pendulum.

mod pendulum;
mod reference;
mod updates;

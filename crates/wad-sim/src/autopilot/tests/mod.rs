//! Closed-loop tests: the autopilot drives the real vehicle along a real route of a small net (a signalled
//! cross and an unsignalled T junction) among scripted others.

mod drive;
mod junctions;
mod road;
mod walkers;

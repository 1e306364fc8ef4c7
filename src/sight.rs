//! What a run looks like: its town, followed tick by tick, for any camera to look at.

use crate::bridge::{Bridge, Ego};
use crate::camera::Town;
use crate::network::Shapes;
use crate::replay::Body;
use crate::world::Actor;

/// The town of a bridge's network, with the buildings of its config's additional files.
pub fn town(bridge: &Bridge, seed: u64) -> Town {
    let network = bridge.network();
    let mut shapes = Shapes::default();
    for file in bridge.config().additional_files() {
        match Shapes::load(&file, network) {
            Ok(found) => {
                shapes.polygons.extend(found.polygons);
                shapes.points.extend(found.points);
            }
            Err(error) => tracing::warn!("no polygons from an additional file: {error}"),
        }
    }
    Town::new(network, &shapes, seed)
}

/// Moves the town's road users to where `ego` sees them, and the ego itself for outside views.
pub fn follow(town: &mut Town, ego: &Ego) {
    town.follow(ego.world(), Some(&from_outside(ego)));
}

/// The ego as others see it.
pub fn from_outside(ego: &Ego) -> Actor {
    let params = ego.params();
    Body { length: params.length, width: params.width, height: params.height }.actor(&ego.state())
}

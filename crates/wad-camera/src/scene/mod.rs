//! The town without its road users, built once from a network and its polygons.
//!
//! Deterministic from the network, the polygons and a seed. Nothing stands on lanes, crossings or
//! walkingareas: `ground` knows the use of each half metre, and every builder checks it first.

mod areas;
mod bridges;
mod buildings;
mod furniture;
mod ground;
mod look;
mod markings;
mod materials;
mod polygon;
mod roads;
mod signals;
mod street;
#[cfg(test)]
mod tests;
mod tiles;
mod trees;

pub use look::Look;
pub use markings::painted_sides;

use super::actors::Cast;
use super::model::Scene;
use furniture::Furniture;
use ground::{Ground, Terrain};
use materials::Materials;
use street::{Dice, Site};
use sumo_network::network::{Network, Shapes};
use tiles::Tiles;
use trees::Plants;

/// Fewer building polygons than this per road kilometre, and buildings are grown beside the roads too.
const SPARSE: f64 = 2.0;

/// The scene of a network, and the road users' models in its library. Equal looks give equal scenes.
pub fn build(network: &Network, shapes: &Shapes, look: Look) -> (Scene, Cast) {
    let mut scene = Scene::default();
    let library = &mut scene.library;
    let materials = Materials::new(library);
    let furniture = Furniture::new(library, &materials);
    let plants = Plants::new(library, &materials);
    let cast = Cast::new(library);

    let terrain = Terrain::of(network);
    let mut ground = Ground::of_ways(network);
    roads::mark(network, &mut ground);
    bridges::clear(network, &terrain, &mut ground);
    let seed = look.seed;
    let mut tiles = Tiles::new(look);
    roads::build(network, &ground, &terrain, &materials, &mut tiles);
    bridges::build(network, &terrain, &materials, &mut tiles);
    markings::build(network, seed, &mut tiles);
    if !terrain.flat {
        roads::terrain(&terrain, &materials, &mut tiles);
    }

    let mut site = Site {
        network,
        ground,
        terrain: &terrain,
        tiles,
        materials: &materials,
        furniture: &furniture,
        plants: &plants,
        cast: &cast,
        dice: Dice::new(seed, "town"),
        look,
        statics: 0,
        signs: Vec::new(),
    };
    areas::lay(&mut site, &shapes.polygons);
    areas::islands(&mut site);
    signals::build(&mut site);
    street::signs(&mut site);
    let Site { mut ground, mut tiles, dice, statics, signs, .. } = site;
    let into = (&mut tiles, &mut scene.library, &materials);
    let built = buildings::from_polygons(&shapes.polygons, &mut ground, &terrain, into, seed);
    let kilometres = network
        .edges
        .iter()
        .filter_map(|e| e.lanes.first())
        .map(|&l| network.lane(l).shape.length())
        .sum::<f64>()
        / 1000.0;
    if (built as f64) < SPARSE * kilometres {
        let into = (&mut tiles, &mut scene.library, &materials);
        buildings::grow(network, &mut ground, &terrain, into, seed);
    }
    let mut site = Site {
        network,
        ground,
        terrain: &terrain,
        tiles,
        materials: &materials,
        furniture: &furniture,
        plants: &plants,
        cast: &cast,
        dice,
        look,
        statics,
        signs,
    };
    areas::benches(&mut site, &shapes.points);
    street::build(&mut site);
    areas::plant(&mut site, &shapes.polygons);
    let Site { mut tiles, signs, .. } = site;
    scene.signs = signs;
    areas::horizon(network, terrain.low, (&materials.hills, materials.skyline), seed, &mut tiles);

    scene.ground = Some((materials.grass, terrain.low - if terrain.flat { 0.05 } else { 6.0 }));
    scene.chunks = tiles.finish(&scene.library, &|p| terrain.at(p));
    scene.index();
    (scene, cast)
}

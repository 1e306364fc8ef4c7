//! Signs copied from picture to picture (Ghiasi et al. 2021, "Simple Copy-Paste"): in a street few are near enough to be
//! read, most of them at the same places.

use super::{SIDE, Sample, plain};
use crate::dataset::DatasetError;
use rand::RngExt;
use wad_see::perception::SignTruth;
use wad_see::perception::centernet::decode::SIGN_BAND;
use wad_see::perception::centernet::reader::between;

/// Copies that are tried in each picture; one that would touch another sign is left out.
const COPIES: usize = 10;
/// A plate is copied that is at least this wide (pixels).
const SOURCE: f32 = 14.0;
/// Its copies are at least and at most this wide, and no wider than it (pixels).
const LEAST: f32 = 12.0;
const MOST: f32 = 40.0;

/// A sign's plate: its label, and the pixels of its box.
#[derive(Clone, Debug)]
pub struct Plate {
    sign: SignTruth,
    side: usize,
    rgb: Vec<u8>,
}

impl Plate {
    /// From the camera's picture; None where it is small or cut.
    fn of(sign: &SignTruth, picture: &[u8]) -> Option<Self> {
        let [l, t, r, b] = sign.bounds;
        if r - l < SOURCE || l < 0.0 || r >= SIDE as f32 || t < 0.0 || b >= SIDE as f32 {
            return None;
        }
        let side = (r - l).round() as usize;
        let (left, upper) = (l.round() as usize, t.round() as usize);
        let rows = (upper..upper + side).map(|y| picture.get(3 * (y * SIDE + left)..)?.get(..3 * side));
        Some(Self { sign: *sign, side, rgb: rows.collect::<Option<Vec<_>>>()?.concat() })
    }

    /// Paints its disc, `wide` pixels across, round (x, y) of the camera's picture, and says what is then there.
    fn paint(&self, picture: &mut [u8], top: usize, (x, y): (f32, f32), wide: f32) -> SignTruth {
        let radius = 0.5 * wide;
        let scale = self.side as f32 / wide;
        let middle = 0.5 * self.side as f32 - 0.5;
        for row in (y - radius) as usize..=(y + radius) as usize {
            for column in (x - radius) as usize..=(x + radius) as usize {
                let (dx, dy) = (column as f32 + 0.5 - x, row as f32 + 0.5 - y);
                let place = row.checked_sub(top).map(|row| 3 * (row * SIDE + column));
                let pixel = place.and_then(|at| picture.get_mut(at..at + 3));
                if let Some(pixel) = pixel.filter(|_| dx.hypot(dy) <= radius) {
                    let at = [middle + dx * scale, middle + dy * scale];
                    pixel.copy_from_slice(&between(&self.rgb, self.side, at).map(|value| value as u8));
                }
            }
        }
        let bounds = [x - radius, y - radius, x + radius, y + radius];
        SignTruth { bounds, distance: self.sign.distance * scale, ..self.sign }
    }
}

/// The plates of all signs that are large and plain enough.
///
/// # Errors
/// A picture is damaged.
pub fn plates(samples: &[Sample]) -> Result<Vec<Plate>, DatasetError> {
    let mut plates = Vec::new();
    for sample in samples {
        if plain(sample.road.as_ref()).any(|sign| sign.bounds[2] - sign.bounds[0] >= SOURCE) {
            let picture = sample.rgb()?;
            plates.extend(plain(sample.road.as_ref()).filter_map(|sign| Plate::of(sign, &picture)));
        }
    }
    Ok(plates)
}

/// Paints some of `plates` into a picture, which begins with row `top` of the camera's, and adds them to its `signs`.
pub(super) fn copy(
    plates: &[Plate],
    picture: &mut [u8],
    top: usize,
    signs: &mut Vec<SignTruth>,
    rng: &mut impl RngExt,
) {
    for _ in 0..COPIES {
        let plate = &plates[rng.random_range(0..plates.len())];
        let wide = rng.random_range(LEAST..=MOST.min(plate.side as f32));
        let x = rng.random_range(wide..SIDE as f32 - wide);
        let y = rng.random_range(SIGN_BAND[0] as f32 + wide..SIGN_BAND[1] as f32 - wide);
        let is_free = |other: &SignTruth| {
            let [l, t, r, b] = other.bounds;
            let away = 0.5 * wide + 4.0;
            x + away < l || x - away > r || y + away < t || y - away > b
        };
        if signs.iter().all(is_free) {
            signs.push(plate.paint(picture, top, (x, y), wide));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumo_network::seeds;
    use wad_camera::model::Sign;

    #[test]
    fn copies_are_where_their_labels_say_and_touch_no_other_sign() {
        let (top, rows) = (96, 320);
        let sign = |[x, y]: [f32; 2]| SignTruth {
            sign: Sign::Stop,
            bounds: [x - 10.0, y - 10.0, x + 10.0, y + 10.0],
            distance: 9.0,
            is_plain: true,
        };
        let plate = Plate::of(&sign([300.0, 200.0]), &vec![200; 3 * SIDE * SIDE]).unwrap();
        assert!(Plate::of(&sign([505.0, 200.0]), &vec![200; 3 * SIDE * SIDE]).is_none(), "cut");
        let mut picture = vec![0; 3 * SIDE * rows];
        let mut signs = vec![SignTruth { sign: Sign::GiveWay, ..sign([100.0, 220.0]) }];
        copy(&[plate], &mut picture, top, &mut signs, &mut seeds::rng(1, "copies"));
        assert!(signs.len() > 4, "{}", signs.len());
        for (at, one) in signs.iter().enumerate().skip(1) {
            let [l, t, r, b] = one.bounds;
            let apart =
                |o: &SignTruth| o.bounds[0] > r || o.bounds[2] < l || o.bounds[1] > b || o.bounds[3] < t;
            assert!(one.sign == Sign::Stop && signs[..at].iter().all(apart));
            let (x, y) = (0.5 * (l + r), 0.5 * (t + b));
            let lit = |x: f32, y: f32| picture[3 * ((y as usize - top) * SIDE + x as usize)] > 150;
            let radius = 0.5 * (r - l);
            assert!(lit(x, y) && lit(x - 0.8 * radius, y) && !lit(x - 1.2 * radius - 1.0, y), "{one:?}");
            assert!((one.distance * (r - l) - 9.0 * 20.0).abs() < 0.1, "as far as it is small");
        }
    }
}

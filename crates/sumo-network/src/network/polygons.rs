//! Buildings, parks and other shapes of SUMO's additional files (`.poly.xml`, `.add.xml`).

use super::parse::{is_true, points};
use super::xml::{Element, Step, Walk, read_text};
use super::{Network, NetworkError};
use crate::geometry::{Point, Vector};
use std::path::Path;

/// A `<poly>`.
#[derive(Clone, Debug, PartialEq)]
pub struct Polygon {
    /// SUMO's id.
    pub id: String,
    /// SUMO's `type`, e.g. `building`; empty where none was given.
    pub kind: String,
    /// Red, green, blue, opacity.
    pub colour: [u8; 4],
    /// Higher layers lie over lower ones.
    pub layer: f64,
    /// An area, not a line.
    pub fill: bool,
    /// Height (m) that a `<param key="height">` gives a building.
    pub height: Option<f64>,
    /// Corners (m); an area closes from the last to the first.
    pub shape: Vec<Point>,
}

/// A `<poi>`.
#[derive(Clone, Debug, PartialEq)]
pub struct PointOfInterest {
    /// SUMO's id.
    pub id: String,
    /// SUMO's `type`; empty where none was given.
    pub kind: String,
    /// Red, green, blue, opacity.
    pub colour: [u8; 4],
    /// Higher layers lie over lower ones.
    pub layer: f64,
    /// m.
    pub position: Point,
}

/// The shapes of an additional file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shapes {
    /// Lines and areas, in the file's order.
    pub polygons: Vec<Polygon>,
    /// Points of interest, in the file's order.
    pub points: Vec<PointOfInterest>,
}

impl Shapes {
    /// Reads an additional file, plain or gzipped. Other elements are ignored, and so are shapes without usable
    /// coordinates or in longitude and latitude.
    /// `network` places points that are given by lane.
    ///
    /// # Errors
    /// The file cannot be read, is not XML, or is cut off.
    pub fn load(path: &Path, network: &Network) -> Result<Self, NetworkError> {
        Self::from_xml(path, &read_text(path)?, network)
    }

    /// The shapes of a document; `path` is what errors call it.
    ///
    /// # Errors
    /// When it is no XML or is cut off.
    pub fn from_xml(path: &Path, text: &str, network: &Network) -> Result<Self, NetworkError> {
        let mut shapes = Self::default();
        let mut walk = Walk::new(path, text);
        // Whether the last shape was a polygon that parameters belong to.
        let mut open = false;
        while let Some(step) = walk.next()? {
            let Step::Open(element) = step else { continue };
            match element.name() {
                "poly" => {
                    let polygon = polygon(&element);
                    open = polygon.is_some();
                    shapes.polygons.extend(polygon);
                }
                "param" => {
                    let [key, value] = element.read(["key", "value"]);
                    let height = value.and_then(|v| v.trim().parse::<f64>().ok()).filter(|h| h.is_finite());
                    if let (true, Some("height"), Some(polygon)) =
                        (open, key.as_deref(), shapes.polygons.last_mut())
                    {
                        polygon.height = height.filter(|&h| h > 0.0);
                    }
                }
                "poi" => {
                    open = false;
                    shapes.points.extend(point(&element, network));
                }
                _ => open = false,
            }
        }
        Ok(shapes)
    }
}

/// SUMO's colour of shapes that give none.
const RED: [u8; 4] = [255, 0, 0, 255];

fn polygon(element: &Element<'_>) -> Option<Polygon> {
    let [id, kind, colour, layer, fill, shape, geo] =
        element.read(["id", "type", "color", "layer", "fill", "shape", "geo"]);
    if geo.is_some_and(|g| is_true(&g)) {
        return None;
    }
    let shape: Vec<Point> = points(&shape?)?.iter().map(|p| p.xy()).collect();
    if shape.len() < 2 {
        return None;
    }
    Some(Polygon {
        id: id?.into_owned(),
        kind: kind.unwrap_or_default().into_owned(),
        colour: colour.and_then(|c| parse_colour(&c)).unwrap_or(RED),
        layer: layer.and_then(|l| l.trim().parse().ok()).filter(|l: &f64| l.is_finite()).unwrap_or(0.0),
        fill: fill.is_some_and(|f| is_true(&f)),
        height: None,
        shape,
    })
}

fn point(element: &Element<'_>, network: &Network) -> Option<PointOfInterest> {
    let [id, kind, colour, layer, x, y, lane, along, across] =
        element.read(["id", "type", "color", "layer", "x", "y", "lane", "pos", "posLat"]);
    let number = |v: Option<std::borrow::Cow<'_, str>>| {
        v.and_then(|v| v.trim().parse::<f64>().ok()).filter(|v| v.is_finite())
    };
    let position = match (number(x), number(y), lane) {
        (Some(x), Some(y), _) => Point::new(x, y),
        (_, _, Some(lane)) => {
            let lane = network.lane(network.lane_by_id(&lane)?);
            let pos = number(along).unwrap_or(0.0);
            // A negative position counts from the lane's end; a positive posLat is to the left.
            let pos = if pos < 0.0 { lane.length + pos } else { pos };
            let offset = Vector::new(0.0, number(across).unwrap_or(0.0));
            lane.shape.at(lane.arc_length(pos)).to_world(offset)
        }
        _ => return None,
    };
    Some(PointOfInterest {
        id: id?.into_owned(),
        kind: kind.unwrap_or_default().into_owned(),
        colour: colour.and_then(|c| parse_colour(&c)).unwrap_or(RED),
        layer: number(layer).unwrap_or(0.0),
        position,
    })
}

/// SUMO's ways to write a colour: a name, `#rrggbb[aa]`, or 3 or 4 numbers up to 255 or up to 1.
fn parse_colour(text: &str) -> Option<[u8; 4]> {
    let text = text.trim();
    if let Some(hex) = text.strip_prefix('#') {
        let value = u32::from_str_radix(hex, 16).ok()?;
        return match hex.len() {
            6 => Some((value << 8 | 255).to_be_bytes()),
            8 => Some(value.to_be_bytes()),
            _ => None,
        };
    }
    if text.contains(',') {
        let parts: Vec<f64> = text.split(',').map(|p| p.trim().parse().ok()).collect::<Option<_>>()?;
        let fractions = text.contains('.') || parts.iter().all(|&p| p <= 1.0);
        let byte = |v: f64| (if fractions { v * 255.0 } else { v }).clamp(0.0, 255.0).round() as u8;
        return match parts[..] {
            [r, g, b] => Some([byte(r), byte(g), byte(b), 255]),
            [r, g, b, a] => Some([byte(r), byte(g), byte(b), byte(a)]),
            _ => None,
        };
    }
    let [r, g, b] = match text {
        "red" => [255, 0, 0],
        "green" => [0, 255, 0],
        "blue" => [0, 0, 255],
        "yellow" => [255, 255, 0],
        "cyan" => [0, 255, 255],
        "magenta" => [255, 0, 255],
        "orange" => [255, 128, 0],
        "white" => [255, 255, 255],
        "black" => [0, 0, 0],
        "grey" | "gray" => [128, 128, 128],
        "invisible" => return Some([0, 0, 0, 0]),
        _ => return None,
    };
    Some([r, g, b, 255])
}

#[cfg(test)]
mod tests {
    use super::*;

    const NET: &str = r#"<net><junction id="a" type="priority" x="0" y="0"/><junction id="b" type="priority" x="9" y="0"/>
        <edge id="e" from="a" to="b"><lane id="e_0" index="0" speed="10" length="100" shape="0,0 100,0"/></edge></net>"#;

    #[test]
    fn shapes_are_read_and_broken_ones_left_out() {
        let path = Path::new("town.poly.xml");
        let network = Network::from_xml(path, NET).unwrap();
        let shapes = Shapes::from_xml(
            path,
            r##"<additional><location/><poly id="house" type="building" color="128,64,0" fill="1" layer="4" shape="0,0 10,0 10,10"><param key="height" value="12.5"/></poly>
                <poly id="line" color="#0a0b0c" shape="0,0,5 10,0,5"/><poly id="bad" shape="0,0 x,1"/>
                <poly id="geo" geo="1" shape="13.1,52.1 13.2,52.2"/>
                <poi id="sign" lane="e_0" pos="-10" posLat="2" color="0,.5,1"><param key="height" value="3"/></poi><poi id="lost" lon="1" lat="2"/><bus_stop/></additional>"##,
            &network,
        )
        .unwrap();
        assert_eq!((shapes.polygons.len(), shapes.points.len()), (2, 1));
        assert_eq!(shapes.polygons[0].height, Some(12.5));
        assert_eq!(shapes.polygons[1].height, None);
        assert_eq!(shapes.polygons[0].colour, [128, 64, 0, 255]);
        assert!(shapes.polygons[0].fill && shapes.polygons[0].layer == 4.0);
        assert_eq!(shapes.polygons[1].colour, [10, 11, 12, 255]);
        assert_eq!(shapes.points[0].position, Point::new(90.0, 2.0));
        assert_eq!(shapes.points[0].colour, [0, 128, 255, 255]);
    }

    #[test]
    fn a_cut_off_file_is_an_error() {
        let path = Path::new("town.poly.xml");
        let network = Network::from_xml(path, NET).unwrap();
        assert!(matches!(
            Shapes::from_xml(path, "<additional><poly id=\"a\" shape=\"0,0 ", &network),
            Err(NetworkError::Truncated { .. })
        ));
    }
}

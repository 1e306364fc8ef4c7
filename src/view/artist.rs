//! Makes the pictures for the viewers, on a thread of its own: the simulation only hands over the world.

use super::hub::{Hub, Packet, Shot};
use super::protocol;
use crate::camera::{Camera, CameraConfig, CameraError, Frame, Outputs, Town, Weather};
use crate::latent::Decoder;
use crate::network::Network;
use crate::perception::{EgoFacts, Perception, TRANSFORMED_SIZE, TransformedImage};
use bytes::Bytes;
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use serde_json::{Value, json};
use std::sync::Arc;

/// Size of the view from behind (pixels).
const CHASE: (usize, usize) = (720, 540);
/// JPEG quality: of the cameras, and of the stages, whose few colours must stay what they are.
const QUALITY: u8 = 80;
const STAGE_QUALITY: u8 = 92;

/// JPEGs by their names.
type Named = Vec<(&'static str, Vec<u8>)>;

/// What is needed to draw.
pub struct Artist {
    town: Town,
    network: Arc<Network>,
    front: Camera,
    chase: Camera,
    perception: Option<Perception>,
    decoder: Option<Box<dyn Decoder>>,
    /// The ego's length (m).
    length: f64,
}

impl Artist {
    /// One who draws `town`. With `perception`, the stages too, and with a decoder the reconstruction.
    ///
    /// # Errors
    /// Impossible cameras.
    pub fn new(
        town: Town,
        network: Arc<Network>,
        length: f64,
        perception: Option<Perception>,
        decoder: Option<Box<dyn Decoder>>,
    ) -> Result<Self, CameraError> {
        Ok(Self {
            town,
            network,
            front: Camera::new(CameraConfig::default())?,
            chase: Camera::new(CameraConfig::chase(CHASE.0, CHASE.1))?,
            perception,
            decoder,
            length,
        })
    }

    /// Whether it can show what is made of the picture, and the reconstruction.
    pub fn stages(&self) -> (bool, bool) {
        (self.perception.is_some(), self.perception.is_some() && self.decoder.is_some())
    }

    /// Draws until the hub closes or the artist of another number has taken over.
    pub fn work(mut self, hub: &Hub, number: u64) {
        #[cfg(feature = "learn")]
        tch::set_num_threads(1);
        while let Some(shot) = hub.next_shot(number) {
            if hub.viewers() > 0 {
                let packet = self.draw(hub, &shot);
                hub.packets.send_replace(Some(Arc::new(packet)));
            }
        }
    }

    fn draw(&mut self, hub: &Hub, shot: &Shot) -> Packet {
        self.town.follow(&shot.world, Some(&shot.ego));
        let weather = Weather::from(shot.weather);
        let (scene, actors, pose) = (self.town.scene(), self.town.actors(), &shot.ego.pose);
        let stages = hub.wants_stages();
        let sees = self.perception.as_ref().filter(|_| stages && shot.way.is_some());
        let outputs = sees.map_or(Outputs::RGB, |p| Outputs { rgb: true, ..p.needs() });
        let frame = self.front.render(scene, actors, pose, &weather, outputs);
        let mut images = vec![("front", jpeg(frame))];
        let mut more = protocol::around(&shot.world);
        if let Some((sees, pictures)) = self.stages_of(shot, stages) {
            more["sees"] = sees;
            images.extend(pictures);
        }
        if hub.wants_chase() {
            let (scene, actors) = (self.town.scene(), self.town.actors());
            images.push(("chase", jpeg(self.chase.render(scene, actors, pose, &weather, Outputs::RGB))));
        }
        let bytes = Bytes::from(protocol::packet(&shot.state, more, &images));
        Packet { route_id: shot.state.route_id, bytes }
    }

    /// What the ego makes of the picture that was just taken.
    fn stages_of(&mut self, shot: &Shot, wanted: bool) -> Option<(Value, Named)> {
        let (perception, (route, on_route)) = (self.perception.as_mut()?, shot.way.as_ref()?);
        if !wanted {
            return None;
        }
        let facts = EgoFacts {
            network: &self.network,
            route,
            on_route: *on_route,
            length: self.length,
            signals: &shot.world.traffic_lights,
            tick: shot.state.dt,
        };
        if let Err(error) = perception.perceive(self.front.frame(), &facts) {
            tracing::debug!("no stages in the view: {error}");
            return None;
        }
        let percept = perception.percept();
        let mut images = vec![("transformed", small(&percept.transformed))];
        if let Some(decoder) = &mut self.decoder {
            match decoder.reconstruct(&percept.transformed) {
                Ok(image) => images.push(("reconstruction", small(&image))),
                Err(error) => tracing::debug!("no reconstruction in the view: {error}"),
            }
        }
        let boxes: Vec<Value> = (percept.detections.iter())
            .map(|d| {
                let [l, t, r, b] = d.bounds.map(|v| v.round() as i32);
                json!([format!("{:?}", d.class), l, t, r, b])
            })
            .collect();
        let ground = perception.ground();
        let lanes: Vec<Value> = [&percept.lanes.left, &percept.lanes.right]
            .into_iter()
            .flatten()
            .map(|lane| lane.pixels(ground).iter().flat_map(|p| p.map(|v| v.round() as i32)).collect())
            .collect();
        let gap = percept.raw.lead.map(|lead| lead.gap);
        Some((json!({ "boxes": boxes, "lanes": lanes, "red": percept.light_red, "gap": gap }), images))
    }
}

fn small(image: &TransformedImage) -> Vec<u8> {
    encode(image.bytes(), TRANSFORMED_SIZE, TRANSFORMED_SIZE, STAGE_QUALITY, SamplingFactor::F_1_1)
}

fn jpeg(frame: &Frame) -> Vec<u8> {
    encode(&frame.rgb, frame.width, frame.height, QUALITY, SamplingFactor::F_2_2)
}

/// Empty where it cannot be encoded, which a picture of the camera's always can.
fn encode(rgb: &[u8], width: usize, height: usize, quality: u8, sampling: SamplingFactor) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(rgb.len() / 12);
    let mut encoder = Encoder::new(&mut bytes, quality);
    encoder.set_sampling_factor(sampling);
    let (Ok(width), Ok(height)) = (u16::try_from(width), u16::try_from(height)) else { return Vec::new() };
    match encoder.encode(rgb, width, height, ColorType::Rgb) {
        Ok(()) => bytes,
        Err(error) => {
            tracing::debug!("a picture cannot be encoded: {error}");
            Vec::new()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_becomes_a_jpeg() {
        let frame = Frame { width: 64, height: 48, rgb: vec![120; 64 * 48 * 3], ..Frame::default() };
        let bytes = jpeg(&frame);
        assert!(bytes.starts_with(&[0xff, 0xd8]) && bytes.ends_with(&[0xff, 0xd9]), "{}", bytes.len());
    }
}

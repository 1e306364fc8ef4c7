use super::*;
use crate::latent::PooledEncoder;
use crate::perception::testing::Road;
use crate::perception::{Detection, TruthDetector};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use sumo_network::network::Shapes;
use wad_camera::scene::Look;

/// Has weights of the default camera, and counts the images that it encodes.
#[derive(Default)]
struct Weighty(Arc<AtomicU32>);

impl Detector for Weighty {
    fn name(&self) -> &str {
        "weighty"
    }

    fn camera(&self) -> Option<CameraConfig> {
        Some(CameraConfig::default())
    }

    fn detect(
        &mut self,
        _: &Frame,
        _: &CameraConfig,
        found: &mut Vec<Detection>,
    ) -> Result<(), PerceptionError> {
        found.clear();
        Ok(())
    }
}

impl Encoder for Weighty {
    fn hash(&self) -> &str {
        "weighty"
    }

    fn image_kind(&self) -> ImageKind {
        ImageKind::Plain
    }

    fn camera(&self) -> Option<CameraConfig> {
        Some(CameraConfig::default())
    }

    fn encode(&mut self, _: &TransformedImage, latent: &mut Vec<f32>) -> Result<(), LatentError> {
        self.0.fetch_add(1, Ordering::Relaxed);
        latent.resize(LATENT_SIZE, 0.0);
        Ok(())
    }
}

impl Decoder for Weighty {
    fn decode(&mut self, _: &[f32], _: &mut TransformedImage) -> Result<(), LatentError> {
        Ok(())
    }
}

fn town(road: &Road) -> Town {
    Town::new(&road.network, &Shapes::default(), Look::of(1))
}

#[test]
fn weights_see_through_their_own_camera_alone() {
    let town = town(&Road::new("GGG"));
    let make = |camera: CameraConfig| {
        let eyes = Eyes::camera(town.share(), camera).unwrap();
        [
            Eyes::new(town.share(), camera, Box::new(Weighty::default())).map(drop),
            eyes.with_encoder(Box::new(Weighty::default())).map(drop),
        ]
    };
    assert!(make(CameraConfig::default()).iter().all(Result::is_ok));
    let narrow = CameraConfig { fov_deg: 60.0, ..CameraConfig::default() };
    for made in make(narrow) {
        let error = made.unwrap_err();
        let text = error.to_string();
        assert!(error.is_input() && text.contains("fov 90") && text.contains("fov 60"), "{text}");
    }
    let eyes = Eyes::new(town.share(), narrow, Box::new(TruthDetector::new())).unwrap();
    assert!(eyes.with_encoder(Box::new(PooledEncoder)).is_ok());
}

#[test]
fn a_look_encodes_its_image_once() {
    let road = Road::new("GGG");
    let images = Arc::new(AtomicU32::new(0));
    let weighty = || Box::new(Weighty(Arc::clone(&images)));
    let eyes = Eyes::new(town(&road), CameraConfig::default(), weighty()).unwrap();
    let mut eyes = eyes.with_encoder(weighty()).unwrap().with_decoder(weighty());
    eyes.look(&road.facts(60.0, 0.0, 0.0, 5.0)).unwrap();
    assert_eq!(images.load(Ordering::Relaxed), 1);
    assert!(eyes.reconstruction().is_some());
}

#[test]
fn a_decoder_alone_is_shown_the_image_that_it_was_trained_on() {
    let eyes = || {
        let town = town(&Road::new("GGG"));
        Eyes::new(town, CameraConfig::default(), Box::new(TruthDetector::new())).unwrap()
    };
    let decoded = |eyes: Eyes| eyes.with_decoder(Box::new(Weighty::default())).image_kind();
    assert_eq!(decoded(eyes()), ImageKind::Plain);
    // An encoder's latents are what a driver drives by.
    assert_eq!(decoded(eyes().with_encoder(Box::new(PooledEncoder)).unwrap()), ImageKind::Transformed);
}

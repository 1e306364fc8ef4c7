//! Weights are saved, read and refused. That the networks learn is tested where they are trained.

use super::graph::OUT;
use super::kind::{Backbone, Sees};
use super::network::CenterNet;
use super::{CenterNetDetector, resnet};
use crate::perception::LeastScore;
use crate::weights::WeightsError;
use tch::{Device, Kind, Tensor};
use wad_camera::{CameraConfig, Frame};

#[test]
fn the_backbones_have_the_sizes_that_are_documented() {
    let count = |backbone| {
        let network = CenterNet::new(backbone, Sees::Objects, Device::Cpu).unwrap();
        network.store.trainable_variables().iter().map(|t| t.numel()).sum::<usize>()
    };
    assert_eq!(count(Backbone::Light), 889_292);
    // ResNet-50's 23.5 million without its classifier, and the way up.
    let resnet = count(Backbone::Resnet50V2);
    assert!((23_500_000..40_000_000).contains(&resnet), "{resnet}");
    assert_eq!((OUT, resnet::OUT), (48, 64));
}

#[test]
fn weights_of_something_else_are_refused_by_name() {
    let network = CenterNet::new(Backbone::Light, Sees::Objects, Device::Cpu).unwrap();
    let mut weights = network.weights(&[]).unwrap();
    weights.metadata.insert("camera".to_string(), "another".to_string());
    let error = CenterNet::from_weights(&weights, Sees::Objects, Device::Cpu).unwrap_err().to_string();
    assert!(error.contains("another"), "{error}");

    let mut weights = network.weights(&[]).unwrap();
    weights.tensors.retain(|(name, _)| name != "heat.last.weight");
    let error = CenterNet::from_weights(&weights, Sees::Objects, Device::Cpu).unwrap_err();
    assert!(matches!(&error, WeightsError::Missing { name, .. } if name == "heat.last.weight"), "{error}");

    let mut weights = network.weights(&[]).unwrap();
    weights.metadata.insert("backbone".to_string(), "resnet50_v2".to_string());
    let error = CenterNet::from_weights(&weights, Sees::Objects, Device::Cpu).unwrap_err().to_string();
    assert!(error.contains("shape") || error.contains("no tensor"), "{error}");
}

#[test]
fn a_picture_of_a_wrong_size_is_an_error_that_names_it() {
    let network = CenterNet::new(Backbone::Light, Sees::Objects, Device::Cpu).unwrap();
    let mut detector =
        CenterNetDetector::new("test".to_string(), network, Device::Cpu, LeastScore::Usual).unwrap();
    for (width, height) in [(100, 64), (64, 100), (0, 0)] {
        let error = detector.detect_rgb(&vec![0; width * height * 3], width, height).unwrap_err().to_string();
        assert!(error.contains(&format!("{width}")) && error.contains("512"), "{error}");
    }
}

#[test]
fn a_network_that_sees_the_road_wants_whole_pictures() {
    let network = CenterNet::new(Backbone::Light, Sees::Road, Device::Cpu).unwrap();
    let mut detector =
        CenterNetDetector::new("test".to_string(), network, Device::Cpu, LeastScore::Usual).unwrap();
    let error = detector.detect_rgb(&[0; 256 * 256 * 3], 256, 256).unwrap_err().to_string();
    assert!(error.contains("(256, 256)") && error.contains("(512, 512)"), "{error}");
}

#[test]
fn the_weights_that_travel_with_the_program_are_of_its_camera() {
    crate::torch::one_thread();
    let bytes = wad_sim::bundled::detector("light").unwrap();
    assert!(bytes.len() < 6_000_000, "{}", bytes.len());
    let mut detector = crate::perception::detector("centernet", LeastScore::Usual).unwrap();
    assert_eq!(detector.name(), "centernet");
    let (width, height) = (512, 512);
    let frame = Frame { width, height, rgb: vec![128; 3 * width * height], ..Frame::default() };
    let mut found = Vec::new();
    detector.detect(&frame, &CameraConfig::default(), &mut found).unwrap();
    // Nothing is there to be seen.
    assert!(found.len() <= 2, "{found:?}");
}

#[test]
fn eyes_from_before_their_wide_block_see_as_they_did() {
    let network = CenterNet::new(Backbone::Light, Sees::Road, Device::Cpu).unwrap();
    let mut weights = network.weights(&[]).unwrap();
    let all = weights.tensors.len();
    weights.tensors.retain(|(name, _)| !name.starts_with("backbone.wide."));
    assert_eq!(all - weights.tensors.len(), 10);
    let begun = CenterNet::begun_with(&weights, Sees::Road, Sees::Road, Device::Cpu).unwrap();
    let error = CenterNet::from_weights(&weights, Sees::Road, Device::Cpu).unwrap_err().to_string();
    assert!(error.contains("backbone.wide."), "{error}");

    // CenterNet has no such block.
    weights.metadata.insert("network".to_string(), "centernet".to_string());
    let without = CenterNet::from_weights(&weights, Sees::Objects, Device::Cpu).unwrap();
    let pictures = Tensor::f_rand([1, 3, 64, 64], (Kind::Float, Device::Cpu)).unwrap();
    let heat = |network: &CenterNet| network.forward(&pictures, false).unwrap().heat;
    let before = heat(&without);
    assert_eq!(heat(&begun).f_sub(&before).unwrap().abs().max().double_value(&[]), 0.0);
    let mut scale = begun.store.variables().remove("backbone.wide.second.scale").unwrap();
    tch::no_grad(|| scale.f_fill_(1.0).map(|_| ())).unwrap();
    assert!(heat(&begun).f_sub(&before).unwrap().abs().max().double_value(&[]) > 1e-3);
}

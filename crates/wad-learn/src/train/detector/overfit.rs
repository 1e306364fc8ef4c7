//! The networks learn, and what is saved is what was learnt.

use crate::optim::AdamW;
use tch::{Device, Kind, Tensor};
use wad_see::perception::LeastScore;
use wad_see::perception::centernet::loss::{Target, loss};
use wad_see::perception::centernet::targets::{Wanted, encode, shares};
use wad_see::perception::centernet::{Backbone, CenterNet, CenterNetDetector, Sees};
use wad_see::perception::coco::class_index;

const WIDTH: usize = 96;
const HEIGHT: usize = 64;

/// A picture with coloured rectangles on grey, and the rectangles.
fn picture(boxes: &[(usize, [usize; 4], [u8; 3])]) -> (Vec<u8>, Vec<Wanted>) {
    let mut rgb = vec![110; WIDTH * HEIGHT * 3];
    let mut wanted = Vec::new();
    for &(class, [l, t, r, b], colour) in boxes {
        for y in t..b {
            for x in l..r {
                rgb[3 * (y * WIDTH + x)..][..3].copy_from_slice(&colour);
            }
        }
        let bounds = [l, t, r, b].map(|v| v as f32);
        wanted.push(Wanted { class, bounds, ignored: false });
    }
    (rgb, wanted)
}

/// Trains on two pictures until it should know them by heart, and asks for them.
fn overfit(backbone: Backbone, steps: usize, rate: f64) {
    wad_see::torch::one_thread();
    tch::manual_seed(3);
    let pictures = [
        picture(&[(0, [8, 20, 40, 44], [200, 30, 30]), (3, [70, 10, 82, 50], [30, 30, 200])]),
        picture(&[(4, [30, 8, 86, 56], [220, 200, 30])]),
    ];
    let (h, w) = (HEIGHT / 4, WIDTH / 4);
    let (mut pixels, mut heat, mut centres) = (Vec::new(), Vec::new(), Vec::new());
    for (n, (rgb, wanted)) in pictures.iter().enumerate() {
        pixels.extend(rgb);
        let mut one = vec![0.0; 8 * h * w];
        centres.extend(encode(wanted, (w, h), &mut one, shares).into_iter().map(|centre| (n, centre)));
        heat.extend(one);
    }
    let (n, h, w) = (pictures.len() as i64, h as i64, w as i64);
    let shape = [n, HEIGHT as i64, WIDTH as i64, 3];
    let x = Tensor::from_data_size(&pixels, &shape, Kind::Uint8).to_kind(Kind::Float).permute([0, 3, 1, 2])
        / 255.0;
    let heat = Tensor::from_slice(&heat).view([n, 8, h, w]);
    let target = Target::new(heat, &centres, Device::Cpu).unwrap();
    let network = CenterNet::new(backbone, Sees::Objects, Device::Cpu).unwrap();
    let mut adam = AdamW::new(&network.store, 0.0).unwrap();
    let mut losses = Vec::new();
    for step in 0..steps {
        let total = loss(&network.forward(&x, true).unwrap(), &target).unwrap().total().unwrap();
        losses.push(total.double_value(&[]));
        let left = 1.0 - step as f64 / steps as f64;
        assert!(adam.step(&total, rate * left, 10.0).unwrap());
    }
    let (first, last) = (losses[0], losses[losses.len() - 1]);
    assert!(last < 0.1 * first, "the loss went from {first} to {last}");

    let weights = network.weights(&[]).unwrap();
    let mut detector =
        CenterNetDetector::from_weights("test".to_string(), &weights, Sees::Objects, LeastScore::Fixed(0.3))
            .unwrap();
    for (rgb, wanted) in &pictures {
        let found = detector.detect_rgb(rgb, WIDTH, HEIGHT).unwrap();
        for one in wanted {
            let is_found =
                found.iter().any(|d| class_index(d.class) == one.class && d.iou(&one.bounds) > 0.5);
            assert!(is_found, "{one:?} in {found:?}");
        }
        assert_eq!(found.len(), wanted.len(), "{found:?}");
    }
}

#[test]
fn the_light_network_overfits_two_pictures() {
    overfit(Backbone::Light, 120, 3e-3);
}

#[test]
fn the_resnet_overfits_two_pictures() {
    overfit(Backbone::Resnet50V2, 60, 1e-3);
}

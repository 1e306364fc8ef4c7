use super::*;
use crate::dataset::{CameraCodec, testing};
use wad_camera::Preset;
use wad_see::perception::centernet::Backbone;

/// A blue picture with the object in red: `bounds` are left, top, right, bottom.
pub(in crate::train) fn sample(class: ObjectClass, bounds: [u32; 4]) -> Sample {
    let mut rgb = [20, 40, 180].repeat(SIDE * SIDE);
    for y in bounds[1]..bounds[3] {
        for x in bounds[0]..bounds[2] {
            rgb[3 * (y as usize * SIDE + x as usize)..][..3].copy_from_slice(&[230, 30, 20]);
        }
    }
    let pixels = (bounds[2] - bounds[0]) * (bounds[3] - bounds[1]);
    let full = bounds.map(|v| v as f32);
    let object = BoxRecord { class, id: 1, visible: bounds, full, pixels, depth: 10.0 };
    let png = CameraCodec::Png.encode(&rgb, SIDE, SIDE).unwrap();
    Sample { picture: Picture::Bytes(png), objects: vec![object], road: None }
}

fn show(window: Option<(usize, usize)>) -> Show<'static> {
    Show { backbone: Backbone::Light, batch: 16, window, vary: false, only: None, plates: &[] }
}

#[test]
fn most_steps_show_small_windows_and_the_last_ones_fewer_whole_pictures() {
    let small = show(Some((256, 192)));
    let sizes: Vec<_> = (0..8).map(|step| small.step(step, 8)).collect();
    assert_eq!(sizes[..6], [((256, 192), 16); 6]);
    // 16 windows have as many pixels as 4.8 whole pictures.
    assert_eq!(sizes[6..], [((512, 320), 4); 2]);
    assert_eq!(show(None).step(0, 8), ((512, 320), 16));
    assert_eq!(Show { batch: 1, ..small }.step(7, 8).1, 1);
}

#[test]
fn windows_lie_in_what_the_network_sees_and_mostly_round_an_object() {
    let wanted = [Wanted { class: 0, bounds: [480.0, 380.0, 510.0, 400.0], ignored: false }];
    let mut rng = seeds::rng(1, "windows");
    let mut hits = 0;
    for _ in 0..500 {
        let w = show(Some((256, 192))).place((256, 192), &wanted, &mut rng);
        assert!(w.left + 256 <= 512 && (96..=416 - 192).contains(&w.top), "{w:?}");
        hits += usize::from(w.view(&wanted[0], true).is_some_and(|o| !o.ignored));
    }
    // Four in five are placed round it; few of the others show it.
    assert!((370..450).contains(&hits), "{hits}");
    let nothing = show(Some((256, 192))).place((512, 320), &[], &mut rng);
    assert_eq!(nothing, Window { left: 0, top: 96, width: 512, height: 320 });
}

#[test]
fn targets_lie_where_the_objects_pixels_are_mirrored_or_not() {
    let samples = [sample(ObjectClass::Bus, [200, 180, 264, 216])];
    let mut rng = seeds::rng(2, "batch");
    let batch = Batch::new(&show(Some((256, 192))), &samples, (&[0; 6], 12), (256, 192), &mut rng).unwrap();
    let (w, h) = (64, 48);
    let bus = class_index(ObjectClass::Bus);
    assert!(batch.centres.len() >= 8, "{}", batch.centres.len());
    let mut columns = Vec::new();
    for &(n, centre) in &batch.centres {
        let (x, y) = (centre.cell % w, centre.cell / w);
        let [cx, cy] = [x as f32 + centre.offset[0], y as f32 + centre.offset[1]].map(|v| 4.0 * v);
        columns.push(cx as usize);
        let red = |x: f32, y: f32| {
            (0.0..256.0).contains(&x)
                && (0.0..192.0).contains(&y)
                && batch.pixels[3 * ((n * 192 + y as usize) * 256 + x as usize)] == 230
        };
        let [half_w, half_h] = centre.size.map(|v| 2.0 * v);
        for [dx, dy] in [[0.0, 0.0], [1.0 - half_w, 1.0 - half_h], [half_w - 1.0, half_h - 1.0]] {
            let is_outside = !(0.0..192.0).contains(&(cy + dy));
            assert!(is_outside || red(cx + dx, cy + dy), "window {n}: {centre:?}");
        }
        assert!(!red(cx + half_w + 1.0, cy) && !red(cx - half_w - 1.0, cy), "window {n}: {centre:?}");
        let [px, py] = [cx, cy].map(|v| (v / 4.0) as usize);
        assert_eq!(batch.heat[((n * 8 + bus) * h + py.min(h - 1)) * w + px.min(w - 1)], 1.0);
    }
    columns.dedup();
    assert!(columns.len() > 3, "the windows are all the same");
    let (pictures, target) = batch.load(Device::Cpu).unwrap();
    assert_eq!(pictures.size(), [12, 3, 192, 256]);
    assert_eq!(target.heat.size(), [12, 8, 48, 64]);
    assert_eq!(target.cells.size()[0], batch.centres.len() as i64);
    let (low, high) = (pictures.min().double_value(&[]), pictures.max().double_value(&[]));
    assert!(low >= 0.0 && high <= 1.0, "{low} to {high}");
}

#[test]
fn frames_with_rare_classes_are_shown_more_often_and_empty_ones_less() {
    let mut samples = vec![sample(ObjectClass::Car, [200, 180, 264, 220]); 20];
    samples.push(sample(ObjectClass::Bench, [200, 180, 264, 220]));
    samples.push(Sample { objects: Vec::new(), ..samples[0].clone() });
    let repeats = repeats(&samples, None);
    assert_eq!(repeats[0], 1.0);
    // One in 22 instead of one in four: the root of 22 / 4.
    assert!((repeats[20] - 5.5_f64.sqrt()).abs() < 1e-9, "{}", repeats[20]);
    assert_eq!(repeats[21], EMPTY);
}

#[test]
fn batches_do_not_depend_on_the_number_of_threads() {
    let samples: Vec<Sample> =
        (0..6).map(|n| sample(ObjectClass::Car, [40 * n + 60, 200, 40 * n + 90, 230])).collect();
    let show = Show { batch: 3, vary: true, ..show(Some((64, 32))) };
    let run = |workers: usize| {
        let mut all: Vec<(Vec<u8>, Vec<f32>)> = Vec::new();
        epoch(show, &samples, 5, (7, 1), workers, |batch| {
            all.push((batch.pixels, batch.heat));
            Ok::<_, DatasetError>(true)
        })
        .unwrap();
        all
    };
    let one = run(1);
    assert_eq!(one.len(), 5);
    assert!(one[0] != one[1]);
    assert!(one == run(3));
}

#[test]
fn a_flipped_bit_ends_its_shard_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let weather = Preset::ClearNoon;
    testing::write_frames(folder.path(), "town3", &[6, 2], weather, Some(CameraCodec::Png), |n| {
        testing::frame(testing::Picture { red: false, object: [10 + n, 50, 8, 8] }, weather)
    });
    let shard = folder.path().join("shard-00000.wads");
    let mut bytes = std::fs::read(&shard).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&shard, bytes).unwrap();
    let dataset = Dataset::open(folder.path(), false).unwrap();
    let left = samples(&dataset, &[0, 1], usize::MAX).unwrap().len();
    assert!((3..8).contains(&left), "{left} of 8 frames");
}

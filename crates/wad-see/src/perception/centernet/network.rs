//! CenterNet (Zhou, Wang, Kraehenbuehl 2019, "Objects as Points"): a heatmap of centres per class, the
//! boxes' sizes, and the centres' offsets within their cell, each a quarter of the picture in size.

use super::graph::OUT;
use super::kind::{self, Backbone, CLASSES, Learns, Part, Sees};
use super::layer::{Conv, Kernel};
use super::light::Light;
use super::reader::SignReader;
use super::resnet::{self, Resnet50V2};
use super::road::{RoadAnswer, RoadHeads};
use crate::weights::{Stored, Weights, WeightsError, half};
use std::collections::HashMap;
use std::path::PathBuf;
use tch::{Device, Kind, TchError, Tensor, nn};
use wad_camera::CameraConfig;

/// The heatmap's output before training (the paper's): -log(1 / 0.1 - 1).
pub(super) const FIRST_ANSWER: f64 = -2.19;

#[derive(Debug)]
enum Features {
    Light(Box<Light>),
    Resnet(Resnet50V2),
}

/// The network's output: (n, 8, h, w), (n, 2, h, w), (n, 2, h, w).
#[derive(Debug)]
pub struct Answer {
    /// Before the sigmoid.
    pub heat: Tensor,
    /// Width and height, in cells.
    pub size: Tensor,
    /// From the cell's corner to the centre, in cells: x, y.
    pub offset: Tensor,
    /// Lane and light, where the network sees them and the picture is whole.
    pub road: Option<RoadAnswer>,
}

/// The network with its parameters.
#[derive(Debug)]
pub struct CenterNet {
    /// The network below the heads.
    pub backbone: Backbone,
    /// The parameters.
    pub store: nn::VarStore,
    features: Features,
    /// Heatmap, size, offset: a 3x3 where the backbone is large, and a 1x1.
    heads: [(Option<Conv>, Conv); 3],
    road: Option<RoadHeads>,
    /// The head that learns alone.
    only: Option<Part>,
}

impl CenterNet {
    /// A network with weights drawn from torch's generator.
    ///
    /// # Errors
    /// torch fails.
    pub fn new(backbone: Backbone, sees: Sees, device: Device) -> Result<Self, TchError> {
        let store = nn::VarStore::new(device);
        let root = store.root();
        let (features, channels) = match backbone {
            Backbone::Light => {
                let wide = sees == Sees::Road;
                (Features::Light(Box::new(Light::new(&(&root / "backbone"), wide)?)), OUT)
            }
            Backbone::Resnet50V2 => (Features::Resnet(Resnet50V2::new(&(&root / "backbone"))), resnet::OUT),
        };
        let head = |name: &str, to: i64| {
            let path = &root / name;
            let first = (backbone == Backbone::Resnet50V2)
                .then(|| Conv::new(&(&path / "first"), channels, channels, Kernel::plain(3)));
            (first, Conv::new(&(&path / "last"), channels, to, Kernel::plain(1)))
        };
        let mut heads = [head("heat", CLASSES), head("size", 2), head("offset", 2)];
        heads[0].1.begin_at(0.01, FIRST_ANSWER)?;
        heads[1].1.begin_at(0.01, 4.0)?;
        heads[2].1.begin_at(0.01, 0.5)?;
        let road = match sees {
            Sees::Objects => None,
            Sees::Road => Some(RoadHeads::new(&(&root / "road"), channels)?),
        };
        Ok(Self { backbone, store, features, heads, road, only: None })
    }

    /// From now on nothing but one head learns: all else stays as it is, bit for bit.
    pub fn learn_only(&mut self, part: Part) {
        self.only = Some(part);
        for (name, variable) in self.store.variables() {
            let _ = variable.set_requires_grad(variable.requires_grad() && part.has(&name));
        }
    }

    /// What it sees.
    pub fn sees(&self) -> Sees {
        if self.road.is_some() { Sees::Road } else { Sees::Objects }
    }

    /// Pictures (n, 3, h, w), 0 to 1, of the rows that the backbone sees. The backbone computes in their
    /// precision; the heads and the answer are in single precision.
    ///
    /// # Errors
    /// torch fails; h and w must be multiples of 32.
    pub fn forward(&self, pictures: &Tensor, train: bool) -> Result<Answer, TchError> {
        // About zero in the middle, one wide.
        let pictures = pictures.f_sub_scalar(0.45)?.f_mul_scalar(4.0)?;
        let learns = match self.only {
            _ if !train => Learns::Nothing,
            Some(part) => Learns::Only(part),
            None => Learns::Everything,
        };
        let train = learns.all();
        let x = || match &self.features {
            Features::Light(net) => net.forward(&pictures, train),
            Features::Resnet(net) => net.forward(&pictures, train),
        };
        let x = if self.only.is_some() { tch::no_grad(x)? } else { x()? };
        let head = |(first, last): &(Option<Conv>, Conv)| {
            let hidden = first.as_ref().map(|first| first.forward(&x, train)?.f_relu()).transpose()?;
            last.forward(&hidden.as_ref().unwrap_or(&x).f_to_kind(Kind::Float)?, train)
        };
        let [heat, size, offset] = &self.heads;
        let looked = |road: &RoadHeads| road.forward(&x, &pictures, learns);
        let road = self.road.as_ref().map(looked).transpose()?.flatten();
        Ok(Answer { heat: head(heat)?, size: head(size)?, offset: head(offset)?, road })
    }

    /// What the plates of signs (n, 3, 24, 24) say (n, 14: signs, none), before the softmax; None where it sees no signs.
    ///
    /// # Errors
    /// torch fails.
    pub fn read_signs(&self, plates: &Tensor) -> Result<Option<Tensor>, TchError> {
        self.road.as_ref().map(|road| road.read(plates)).transpose()
    }

    /// The same network without torch.
    ///
    /// # Errors
    /// torch fails.
    pub fn sign_reader(&self) -> Result<Option<SignReader>, TchError> {
        let variables = self.store.variables();
        let floats = |name: &str, _: &[i64]| match variables.get(name) {
            Some(tensor) => Vec::try_from(tensor.f_to_device(Device::Cpu)?.f_flatten(0, -1)?),
            None => Err(TchError::Torch(format!("no `{name}`"))),
        };
        self.road.as_ref().map(|_| SignReader::new(floats)).transpose()
    }

    /// Folds batch norm for inference: faster, but the network cannot be trained after that.
    ///
    /// # Errors
    /// torch fails.
    pub fn fold(&mut self) -> Result<(), TchError> {
        self.store.freeze();
        if let Some(road) = &mut self.road {
            road.fold()?;
        }
        match &mut self.features {
            Features::Light(net) => net.fold(),
            Features::Resnet(net) => net.fold(),
        }
    }

    /// All tensors in half precision, with metadata: backbone, camera, and `more`.
    ///
    /// # Errors
    /// torch fails.
    pub fn weights(&self, more: &[(&str, String)]) -> Result<Weights, WeightsError> {
        let mut tensors = Vec::new();
        for (name, tensor) in self.store.variables() {
            tensors.push((name, half(&tensor)?));
        }
        tensors.sort_by(|a: &(String, Tensor), b| a.0.cmp(&b.0));
        let mut metadata = HashMap::from([
            ("network".to_string(), self.sees().network().to_string()),
            ("backbone".to_string(), self.backbone.name().to_string()),
            ("camera".to_string(), CameraConfig::default().hash()),
        ]);
        metadata.extend(more.iter().map(|(key, value)| ((*key).to_string(), value.clone())));
        Ok(Weights { path: PathBuf::new(), tensors: Stored::all(&tensors)?, metadata })
    }

    /// The network of some weights.
    ///
    /// # Errors
    /// They are of another network or of another camera, or torch fails.
    pub fn from_weights(weights: &Weights, sees: Sees, device: Device) -> Result<Self, WeightsError> {
        Self::filled(weights, sees, sees, device, |_| false)
    }

    /// A network that sees what `sees` says, its parameters from weights that see `known`; what these lack of the road's
    /// heads is new.
    ///
    /// # Errors
    /// As [`Self::from_weights`].
    pub fn begun_with(
        weights: &Weights,
        known: Sees,
        sees: Sees,
        device: Device,
    ) -> Result<Self, WeightsError> {
        let has = |name: &str| weights.tensors.iter().any(|(one, _)| one == name);
        let of_eyes = |name: &str| ["road.", "backbone.wide."].iter().any(|part| name.starts_with(part));
        Self::filled(weights, known, sees, device, |name| of_eyes(name) && !has(name))
    }

    fn filled(
        weights: &Weights,
        known: Sees,
        sees: Sees,
        device: Device,
        is_new: impl Fn(&str) -> bool,
    ) -> Result<Self, WeightsError> {
        let backbone = kind::backbone(weights, known)?;
        let network = Self::new(backbone, sees, device)?;
        tch::no_grad(|| {
            for (name, mut variable) in network.store.variables() {
                if is_new(&name) {
                    continue;
                }
                let tensor = weights.get(&name, &variable.size())?;
                variable.f_copy_(&tensor.f_to_kind(Kind::Float)?.f_to_device(device)?)?;
            }
            Ok(network)
        })
    }
}

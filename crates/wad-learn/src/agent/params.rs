//! What a trained agent's file says of it: sizes, inputs, algorithm and its constants. Nothing here needs libtorch.

use serde::{Deserialize, Serialize};
use wad_see::observation::{Observation, ObservationMode, SURROUNDINGS_SIZE};

/// Sizes of inputs and outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dims {
    /// Numbers in the latent.
    pub latent: i64,
    /// Numbers in the raw vector.
    pub raw: i64,
    /// Numbers in an action.
    pub actions: i64,
}

impl Dims {
    /// The driving agents' sizes.
    pub const DRIVING: Self = Self {
        latent: wad_see::observation::LATENT_SIZE as i64,
        raw: wad_see::observation::RAW_SIZE as i64,
        actions: super::action::ACTION_SIZE as i64,
    };

    /// Numbers in an observation.
    pub fn observation(&self) -> i64 {
        self.latent + self.raw
    }

    /// The parts of an observation that the networks take, in one: latent, then raw.
    pub fn of(&self, observation: &Observation) -> Vec<f32> {
        self.of_parts(&observation.latent, &observation.raw)
    }

    /// The same of an observation's latent and raw vector.
    pub fn of_parts(&self, latent: &[f32], raw: &[f32]) -> Vec<f32> {
        let latent = if self.latent > 0 { latent } else { &[] };
        let raw = if self.raw > 0 { raw } else { &[] };
        [latent, raw].concat()
    }
}

/// The inputs of an agent; its networks have no others. For ablations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Inputs {
    /// Latent and raw vector.
    #[default]
    Both,
    /// Latent and raw vector from the camera, the route and the ego's own motion alone ([`ObservationMode::Camera`]).
    Camera,
    /// The latent only.
    Latent,
    /// The raw vector only.
    Raw,
    /// The surroundings as numbers in place of the latent, and the raw vector; no camera
    /// ([`wad_see::surroundings`]).
    Vector,
}

impl Inputs {
    /// The sizes of networks with these inputs.
    pub fn dims(self) -> Dims {
        match self {
            Self::Both | Self::Camera => Dims::DRIVING,
            Self::Latent => Dims { raw: 0, ..Dims::DRIVING },
            Self::Raw => Dims { latent: 0, ..Dims::DRIVING },
            Self::Vector => Dims { latent: SURROUNDINGS_SIZE as i64, ..Dims::DRIVING },
        }
    }

    /// The standard deviation to which the latent is scaled by default. Beside the raw states 0.02: with 0.1 composites from
    /// the first step were not learned from reward alone (docs/learning.md). As the only input it keeps a deviation of 1.
    pub fn latent_gain(self) -> f64 {
        if self == Self::Latent { 1.0 } else { 0.02 }
    }

    /// The parts of the observation that an environment has to compute for them.
    pub fn observation(self) -> ObservationMode {
        match self {
            Self::Both => ObservationMode::LatentAndRaw,
            Self::Camera => ObservationMode::Camera,
            Self::Latent => ObservationMode::LatentOnly,
            Self::Raw => ObservationMode::RawOnly,
            Self::Vector => ObservationMode::Vector,
        }
    }
}

/// Scales an observation to about -1 to 1: x' = (x - offset) factor. Measured once, on the first
/// experience, and part of the actor from then on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InputScale {
    /// Subtracted from each number of an observation.
    pub offset: Vec<f32>,
    /// Multiplied with each number afterwards.
    pub factor: Vec<f32>,
}

impl InputScale {
    /// The identity.
    pub fn identity(dims: Dims) -> Self {
        let n = dims.observation() as usize;
        Self { offset: vec![0.0; n], factor: vec![1.0; n] }
    }

    /// From means and standard deviations of the latent; the raw vector is scaled by definition. Numbers
    /// that hardly vary are not amplified: the smallest deviation used is a tenth of the mean one. `gain` is
    /// the deviation of the scaled latent.
    pub fn measured(mean: &[f32], deviation: &[f32], dims: Dims, gain: f64) -> Self {
        let latent = dims.latent as usize;
        let floor = 0.1 * deviation[..latent].iter().sum::<f32>() / (latent as f32).max(1.0);
        let mut scale = Self::identity(dims);
        scale.offset[..latent].copy_from_slice(&mean[..latent]);
        for (factor, deviation) in scale.factor[..latent].iter_mut().zip(deviation) {
            *factor = gain as f32 / deviation.max(floor).max(1e-6);
        }
        scale
    }
}

/// The algorithm with its constants.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "algo", rename_all = "snake_case", deny_unknown_fields)]
pub enum Algorithm {
    /// WAD-T.
    Td3(Td3Params),
    /// WAD-S.
    Sac(SacParams),
}

impl Algorithm {
    /// Discount per tick.
    pub fn gamma(&self) -> f64 {
        match self {
            Self::Td3(params) => params.gamma,
            Self::Sac(params) => params.gamma,
        }
    }

    /// The agent's name in the paper: `wad-t`, `wad-s`.
    pub fn agent_name(&self) -> &'static str {
        match self {
            Self::Td3(_) => "wad-t",
            Self::Sac(_) => "wad-s",
        }
    }
}

/// A saved state that does not fit.
#[derive(Debug, thiserror::Error)]
#[error(
    "tensor `{name}`: expected {expected} numbers, found {found}; the file belongs to networks of another form"
)]
pub struct Misfit {
    /// The tensor's name.
    pub name: String,
    /// Numbers in this program's tensor.
    pub expected: i64,
    /// What the saved state has.
    pub found: String,
}

/// The weight of imitation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Imitation {
    /// Weight relative to the critic, whose mean size counts as 1. 0: no imitation.
    pub weight: f64,
    /// Updates over which the weight falls linearly.
    pub updates: u64,
    /// Share of the weight that remains after `updates` updates.
    pub floor: f64,
    /// Imitate only where the critic prefers the expert's action (Nair et al. 2018).
    pub filter: bool,
}

impl Default for Imitation {
    fn default() -> Self {
        Self { weight: 0.0, updates: 200_000, floor: 0.0, filter: false }
    }
}

/// TD3's constants, under cleanrl's names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Td3Params {
    /// Discount per tick: 0.98 has a horizon of 50 ticks, 8 s.
    pub gamma: f64,
    /// Polyak factor of the target networks.
    pub tau: f64,
    /// Adam's learning rate for the actor (paper: 3e-4).
    pub actor_learning_rate: f64,
    /// Adam's learning rate for the critics. With the paper's 3e-3 they do not hold (docs/agents.md).
    pub critic_learning_rate: f64,
    /// Noise on the target's action, in units of half an action's range.
    pub policy_noise: f64,
    /// Bound of that noise, in the same units.
    pub noise_clip: f64,
    /// Critic updates per actor update.
    pub policy_frequency: u64,
    /// Weight of the penalty on actions in the flat ends of their sigmoids, where no gradient is left to leave
    /// them (beyond the paper).
    pub saturation: f64,
    /// Hidden layers of the critics.
    pub critic_hidden: Vec<i64>,
    /// The critics' last layer.
    pub critic_end: CriticEnd,
    /// Updates in which only the critics learn: those of a trained actor are new, and would spoil it.
    pub critics_first: u64,
    /// Updates over which a saved or validated actor is averaged; 0: the newest alone. The collectors drive with the
    /// newest (beyond the paper).
    pub actor_average: u64,
    /// Imitation, beyond the paper.
    pub imitation: Imitation,
}

impl Default for Td3Params {
    fn default() -> Self {
        Self {
            gamma: 0.98,
            tau: 0.005,
            actor_learning_rate: 3e-4,
            critic_learning_rate: 3e-4,
            policy_noise: 0.1,
            noise_clip: 0.25,
            policy_frequency: 2,
            saturation: 0.01,
            critic_hidden: vec![256, 128],
            critic_end: CriticEnd::Sigmoid { low: -60.0, high: 100.0 },
            critics_first: 0,
            actor_average: 0,
            imitation: Imitation::default(),
        }
    }
}

/// The meaning of a critic's output.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum CriticEnd {
    /// The paper's sigmoid: 0 is a return of `low`, 1 of `high` (in scaled rewards). Returns outside are
    /// clamped, which also bounds overestimation.
    Sigmoid {
        /// The return at the sigmoid's 0 (scaled rewards).
        low: f64,
        /// The return at the sigmoid's 1 (scaled rewards).
        high: f64,
    },
    /// The return itself.
    Linear,
}

/// SAC's constants, under cleanrl's names.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SacParams {
    /// Discount per tick.
    pub gamma: f64,
    /// Polyak factor of the value network's target.
    pub tau: f64,
    /// Adam's learning rate for all networks (paper: 3e-4).
    pub learning_rate: f64,
    /// Temperature: scaled reward per nat of entropy. With `autotune` its initial value.
    pub alpha: f64,
    /// Adjust the temperature to keep the entropy at `target_entropy` (Haarnoja et al. 2019).
    pub autotune: bool,
    /// Target entropy (nats), over actions in -1..1; None: minus the number of actions.
    pub target_entropy: Option<f64>,
    /// Updates in which only the critics learn: those of a trained actor are new, and would spoil it.
    pub critics_first: u64,
    /// Updates over which a saved or validated actor is averaged; 0: the newest alone. The collectors drive with the
    /// newest (beyond the paper).
    pub actor_average: u64,
    /// Imitation, beyond the paper.
    pub imitation: Imitation,
}

impl Default for SacParams {
    fn default() -> Self {
        Self {
            gamma: 0.98,
            tau: 0.005,
            learning_rate: 3e-4,
            alpha: 0.1,
            autotune: true,
            target_entropy: None,
            critics_first: 0,
            actor_average: 0,
            imitation: Imitation::default(),
        }
    }
}

/// Sizes of WAD-S' hidden layers, in all its networks.
pub const HIDDEN_S: [i64; 3] = [256, 128, 64];

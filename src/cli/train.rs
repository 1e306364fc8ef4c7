//! `wad-cosim train`: one subcommand per network, one file each.

#[cfg(feature = "learn")]
pub mod agent;
#[cfg(feature = "learn")]
mod detector;
#[cfg(feature = "learn")]
mod encoder;

#[cfg(feature = "learn")]
pub use encoder::Device;

use super::Exit;
#[cfg(feature = "learn")]
use super::progress::Bar;
use clap::Subcommand;
#[cfg(feature = "learn")]
use wad_cosim::perception::centernet::Sees;
#[cfg(feature = "learn")]
use wad_cosim::train::run::{Progress, TrainError};

/// Train a network.
#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Train CenterNet on the camera's pictures of a dataset.
    #[cfg(feature = "learn")]
    Detector(Box<detector::Args>),
    /// Train a detector that also sees the ego's lane and light, on pictures of a dataset.
    #[cfg(feature = "learn")]
    #[command(after_help = detector::EYES_EXAMPLES)]
    Eyes(Box<detector::Args>),
    /// Train the encoder-decoder on the transformed images of a dataset.
    #[cfg(feature = "learn")]
    Encoder(Box<encoder::Args>),
    /// Train a driving agent: WAD-T (TD3) or WAD-S (SAC).
    #[cfg(feature = "learn")]
    Agent(Box<agent::Args>),
}

/// The exit code of an error in training an encoder or a detector.
#[cfg(feature = "learn")]
fn with_exit(error: TrainError) -> anyhow::Error {
    let exit = if error.is_input() { Exit::Input } else { Exit::Other };
    exit.because(error)
}

/// A training's `report`; where it was interrupted, how to go on.
#[cfg(feature = "learn")]
fn ended(report: String, epochs: u64, interrupted: bool) -> String {
    match (interrupted, epochs) {
        (false, _) => report,
        (true, 0) => "interrupted in the first epoch: nothing is kept; begin anew, without --resume\n".into(),
        (true, _) => report + "interrupted; --resume continues from the last epoch\n",
    }
}

/// Shows a training's progress, in the `words` of its network; each epoch's end on its own line.
#[cfg(feature = "learn")]
fn show<V>(bar: &Bar, progress: Progress<V>, words: impl Fn(&Progress<V>) -> String) {
    bar.set_total(progress.steps);
    let message = format!("epoch {}: {}", progress.epoch + 1, words(&progress));
    if progress.validation.is_some() {
        bar.say(&message);
    }
    bar.show(progress.step, &message);
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<Exit> {
    match args.command {
        #[cfg(feature = "learn")]
        Command::Detector(args) => detector::run(*args, Sees::Objects),
        #[cfg(feature = "learn")]
        Command::Eyes(args) => detector::run(*args, Sees::Road),
        #[cfg(feature = "learn")]
        Command::Encoder(args) => encoder::run(*args),
        #[cfg(feature = "learn")]
        Command::Agent(args) => agent::run(*args),
    }
}

#[cfg(all(test, feature = "learn"))]
mod tests {
    use super::ended;

    #[test]
    fn what_was_interrupted_in_its_first_epoch_cannot_be_resumed() {
        let text = |epochs, interrupted| ended("best after epoch 1\n".to_string(), epochs, interrupted);
        assert_eq!(text(2, false), "best after epoch 1\n");
        assert!(text(1, true).contains("best after epoch 1\ninterrupted; --resume continues"));
        assert!(!text(0, true).contains("best") && text(0, true).contains("nothing is kept"));
    }
}

//! `replay --view`: kept episodes in the browser, with a timeline.

use super::view::{self, ViewArgs};
use super::{Exit, print};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use wad_cosim::env::Assets;
use wad_cosim::eval::kept::Kept;
use wad_cosim::view::{Listed, Next, Played, Player, street_map};

/// Depth of the search for episodes below a folder: `runs/NAME/episodes/EPISODE`.
const DEPTH: usize = 4;
/// Most episodes in the list.
const MOST: usize = 2000;
const FILE: &str = "episode.json";

/// Plays the episode at `path`, or the first one below it, until Ctrl-C.
pub fn run(path: &Path, args: &ViewArgs) -> anyhow::Result<Exit> {
    let runtime = crate::cli::runtime()?;
    runtime.block_on(play(path, args))
}

async fn play(path: &Path, args: &ViewArgs) -> anyhow::Result<Exit> {
    let episodes = Episodes::find(path)?;
    let Some(listener) = args.listen()? else { return Ok(Exit::Done) };
    let mut interrupt = super::interrupt()?;
    let mut towns = BTreeMap::new();
    let first = load(&episodes, &episodes.first, &mut towns)?;
    let mut player = Player::open(listener, first, episodes.listed.clone(), args.view_speed)?;
    loop {
        let next = tokio::select! {
            () = interrupt.wait() => break,
            next = player.next() => next,
        };
        let Next::Open(id) = next;
        match load(&episodes, &id, &mut towns) {
            Ok(played) => player.change(played)?,
            Err(error) => player.say(format!("{id} cannot be shown: {error:#}")),
        }
    }
    player.close();
    print("")?;
    Ok(Exit::Done)
}

/// The episodes to pick from.
struct Episodes {
    listed: Vec<Listed>,
    folders: BTreeMap<String, PathBuf>,
    first: String,
}

impl Episodes {
    fn find(path: &Path) -> anyhow::Result<Self> {
        let single = path.join(FILE).is_file();
        // Also list the episodes beside this one.
        let absolute = path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
        let root = if single { absolute.parent().unwrap_or(&absolute) } else { &absolute };
        let mut found = Vec::new();
        collect(root, if single { 1 } else { DEPTH }, &mut found);
        found.sort();
        let (mut listed, mut folders) = (Vec::new(), BTreeMap::new());
        for folder in found.into_iter().take(MOST) {
            let id = folder.strip_prefix(root).unwrap_or(&folder).display().to_string();
            match list(&id, &folder) {
                Ok(entry) => {
                    listed.push(entry);
                    folders.insert(id, folder);
                }
                Err(error) => tracing::warn!("{} is left out: {error}", folder.display()),
            }
        }
        let given =
            folders.iter().find(|(_, folder)| single && **folder == absolute).map(|(id, _)| id.clone());
        let Some(first) = given.or_else(|| listed.first().map(|entry| entry.id.clone())) else {
            return Err(Exit::Input.because(anyhow::anyhow!(
                "no kept episode at or below {}: expected a folder with {FILE}, as `eval` keeps of each failure, or \
                 one with such folders below it",
                path.display()
            )));
        };
        Ok(Self { listed, folders, first })
    }
}

fn collect(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) {
    if folder.join(FILE).is_file() {
        return found.push(folder.to_path_buf());
    }
    if depth == 0 || found.len() > 2 * MOST {
        return;
    }
    // An unreadable folder counts as empty.
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            collect(&entry.path(), depth - 1, found);
        }
    }
}

fn list(id: &str, folder: &Path) -> anyhow::Result<Listed> {
    let kept: Kept = serde_json::from_str(&std::fs::read_to_string(folder.join(FILE))?)?;
    let episode = &kept.episode;
    let case = &episode.case;
    Ok(Listed {
        id: id.to_string(),
        name: format!("{} · {} · {}", case.agent, case.town, case.task.replace('_', " ")),
        outcome: episode.ending.end.to_string(),
        about: format!(
            "{} after {:.0} s, {:.0} of {:.0} m, {}, {} traffic",
            episode.ending.end.to_string().replace('_', " "),
            episode.ticks as f64 * episode.tick_s,
            episode.driven_m,
            episode.route_length_m,
            case.spec.weather.name(),
            case.spec.traffic(),
        ),
    })
}

fn load(episodes: &Episodes, id: &str, towns: &mut BTreeMap<String, Arc<Assets>>) -> anyhow::Result<Played> {
    let unknown = || Exit::Input.because(anyhow::anyhow!("no such episode in the list"));
    let folder = episodes.folders.get(id).ok_or_else(unknown)?;
    let listed = episodes.listed.iter().find(|entry| entry.id == id).cloned().ok_or_else(unknown)?;
    let (kept, recording) = Kept::open(folder).map_err(|e| Exit::Input.because(e))?;
    let config = recording.header().config.clone();
    let assets = match towns.get(&config) {
        Some(assets) => Arc::clone(assets),
        None => {
            let assets = Assets::load(&config).map_err(|e| Exit::of_assets(&e).because(e))?;
            towns.insert(config, Arc::clone(&assets));
            assets
        }
    };
    if assets.net_hash() != kept.net {
        tracing::warn!("the town has changed since the episode was driven: streets may lie elsewhere");
    }
    let network = assets.network();
    let ego = kept.options.ego.clone();
    let artist = view::artist(&assets, ego.length, &kept.options.detector, None, 0)?;
    Ok(Played {
        listed,
        route: kept.route(&recording, network).ok(),
        network: Arc::clone(network),
        map: street_map(network, assets.polygons()),
        driver: kept.episode.case.agent.to_string(),
        ending: format!(
            "{}: {}",
            kept.episode.ending.end.to_string().replace('_', " "),
            kept.episode.ending.cause
        ),
        recording,
        ego,
        artist,
    })
}

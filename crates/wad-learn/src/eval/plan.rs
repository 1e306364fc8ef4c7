//! Makes the plan of episodes from a suite and the user's selection.

use super::routes::{RouteError, Routes};
use super::suite::MOST_EPISODES;
use super::{DriverSpec, Suite, SuiteError, SuiteTask};
use crate::env::Assets;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashSet};
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;
use std::sync::Arc;
use sumo_network::seeds;
use wad_camera::Preset;
use wad_sim::tasks::TaskSpec;
use wad_sim::traffic::TrafficSpec;

/// The selected part of a suite; an empty list or None stands for the suite's own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Selection {
    /// The drivers.
    pub agents: Vec<DriverSpec>,
    /// Tasks by name.
    pub tasks: Vec<String>,
    /// Conditions by name.
    #[serde(deserialize_with = "super::suite::conditions")]
    pub conditions: Vec<String>,
    /// Towns (CONFIG).
    pub towns: Vec<String>,
    /// Weathers instead of the suite's.
    pub weathers: Vec<Preset>,
    /// Each task's episodes take the weathers in turn, instead of being driven in each of them.
    pub weathers_in_turn: bool,
    /// Traffic: selects tasks, or replaces their own traffic.
    pub traffic: Vec<TrafficSpec>,
    /// The evaluation's seeds.
    pub seeds: Vec<u64>,
    /// Episodes per task, town and weather (per task and town if weathers come in turn).
    pub episodes: Option<u64>,
    /// Route file for a town without one.
    pub routes: Option<PathBuf>,
}

/// One planned episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Case {
    /// The suite's name.
    pub suite: String,
    /// The suite's condition; `other` for a town and weather outside all of them.
    #[serde(deserialize_with = "super::suite::condition")]
    pub condition: String,
    /// The driver.
    pub agent: DriverSpec,
    /// The town (CONFIG).
    pub town: String,
    /// The suite's name for the task.
    pub task: String,
    /// The task.
    pub spec: TaskSpec,
    /// The evaluation's seed.
    pub seed: u64,
    /// Number of the episode in its row, from 0.
    pub episode: u64,
}

impl Case {
    /// The seed of the episode itself. It does not depend on agent or weather: all drive the same places in
    /// the same traffic.
    pub fn episode_seed(&self) -> u64 {
        seeds::derive(self.seed, &format!("{} {} {} {}", self.suite, self.town, self.task, self.episode))
    }

    /// Whether it comes after `other` in the same episodes: the number is higher, and nothing else differs but what
    /// follows from the number, the places and the weathers in turn.
    fn follows(&self, other: &Self) -> bool {
        let alike = |case: &Self| {
            let weather = self.spec.weather;
            let spec = TaskSpec { placement: None, tick_limit: None, weather, ..case.spec.clone() };
            Self { spec, condition: String::new(), episode: 0, ..case.clone() }
        };
        self.episode > other.episode && alike(self) == alike(other)
    }

    /// A unique name for the episode's folder.
    pub fn name(&self) -> String {
        // No other traffic is called by two numbers.
        let traffic = self.spec.traffic().to_string().replace(',', "-");
        let text = format!(
            "{}_{}_{}_{}_{traffic}_s{}_{:03}",
            self.agent,
            self.town,
            self.task,
            self.spec.weather.name(),
            self.seed,
            self.episode
        );
        let plain = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '-' };
        let name: String = text.chars().map(plain).collect();
        // `.agent` must not become a hidden folder.
        if name == text && name.len() <= 100 && !name.starts_with('.') {
            return name;
        }
        // The end identifies the episode; the number covers what is replaced or cut off.
        format!("{:08x}_{}", crc32fast::hash(text.as_bytes()), &name[name.len().saturating_sub(80)..])
    }
}

/// One of N parts of a plan, for several machines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shard {
    /// Number of the part, 1 to `of`.
    pub part: usize,
    /// Number of parts.
    pub of: usize,
}

impl Shard {
    /// Whether group number `index` of the plan belongs to it.
    pub fn has(self, index: usize) -> bool {
        index % self.of.max(1) + 1 == self.part
    }
}

impl FromStr for Shard {
    type Err = SuiteError;

    fn from_str(text: &str) -> Result<Self, SuiteError> {
        let parts = text.split_once('/').and_then(|(k, n)| Some((k.parse().ok()?, n.parse().ok()?)));
        match parts {
            Some((part, of)) if (1..=of).contains(&part) => Ok(Self { part, of }),
            _ => Err(SuiteError::Shard { found: text.to_string() }),
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.part, self.of)
    }
}

/// The cases of `plan` that drive in one SUMO each, of `shard` alone: up to `egos` of the same task, town, traffic and
/// seed, in the plan's order.
pub(super) fn groups(plan: Vec<Case>, egos: usize, shard: Option<Shard>) -> Vec<Vec<Case>> {
    let mut groups: Vec<Vec<Case>> = Vec::new();
    for case in plan {
        match groups.last_mut() {
            Some(group)
                if group.len() < egos.max(1) && group.last().is_some_and(|last| case.follows(last)) =>
            {
                group.push(case);
            }
            _ => groups.push(vec![case]),
        }
    }
    let groups = groups.into_iter().enumerate();
    groups.filter(|(i, _)| shard.is_none_or(|shard| shard.has(*i))).map(|(_, group)| group).collect()
}

/// A town of the plan with its weathers.
#[derive(Clone, Debug)]
struct Place {
    town: String,
    weathers: Vec<Preset>,
}

impl Selection {
    /// The towns of the selected part of `suite`.
    ///
    /// # Errors
    /// The suite has no such condition.
    pub fn towns(&self, suite: &Suite) -> Result<Vec<String>, SuiteError> {
        let mut towns: Vec<String> = self.places(suite)?.into_iter().map(|place| place.town).collect();
        let mut seen = std::collections::BTreeSet::new();
        towns.retain(|town| seen.insert(town.clone()));
        Ok(towns)
    }

    /// Towns with weathers: the suite's conditions, or their weathers in the selected towns.
    fn places(&self, suite: &Suite) -> Result<Vec<Place>, SuiteError> {
        known(suite, "condition", &self.conditions, suite.conditions.iter().map(|c| c.name.as_str()))?;
        let wanted = |name: &String| self.conditions.is_empty() || self.conditions.contains(name);
        let conditions: Vec<_> = suite.conditions.iter().filter(|c| wanted(&c.name)).collect();
        let weathers = |own: &[Preset]| {
            if self.weathers.is_empty() { own.to_vec() } else { self.weathers.clone() }
        };
        if self.towns.is_empty() {
            let place =
                |c: &&super::Condition| Place { town: c.town.clone(), weathers: weathers(&c.weathers) };
            return Ok(conditions.iter().map(place).collect());
        }
        let mut places = Vec::new();
        for town in &self.towns {
            let own: Vec<_> = conditions.iter().filter(|c| c.town == *town).collect();
            let mut all: Vec<Preset> = Vec::new();
            for condition in if own.is_empty() { conditions.iter().collect() } else { own } {
                let new: Vec<Preset> =
                    condition.weathers.iter().copied().filter(|w| !all.contains(w)).collect();
                all.extend(new);
            }
            places.push(Place { town: town.clone(), weathers: weathers(&all) });
        }
        Ok(places)
    }

    /// The episodes, agent by agent and town by town, so that an environment serves many. `routes` are
    /// those of each town.
    ///
    /// # Errors
    /// The suite has no such condition or task, or a town lacks routes.
    pub fn plan(
        &self,
        suite: &Suite,
        routes: &BTreeMap<String, (Routes, PathBuf)>,
    ) -> Result<Vec<Case>, SuiteError> {
        let placed = |(mut case, task): (Case, &SuiteTask)| {
            case.spec.placement = match (&task.routes, routes.get(&case.town)) {
                (Some(set), Some((routes, path))) => {
                    let places = routes.set(set, path)?;
                    Some(places[case.episode as usize % places.len()].clone())
                }
                (Some(_), None) => return Err(RouteError::None { town: case.town }.into()),
                (None, _) => None,
            };
            Ok(case)
        };
        self.cases(suite)?.into_iter().map(placed).collect()
    }

    /// The episodes with their tasks, each once, without the places from the route files:
    /// all that is known without the towns.
    ///
    /// # Errors
    /// The suite has no such condition or task, or there are too many episodes.
    pub fn cases<'a>(&self, suite: &'a Suite) -> Result<Vec<(Case, &'a SuiteTask)>, SuiteError> {
        known(suite, "task", &self.tasks, suite.tasks.iter().map(|t| t.name.as_str()))?;
        let tasks: Vec<_> =
            suite.tasks.iter().filter(|t| self.tasks.is_empty() || self.tasks.contains(&t.name)).collect();
        let agents = if self.agents.is_empty() { vec![DriverSpec::Autopilot] } else { self.agents.clone() };
        let seeds = if self.seeds.is_empty() { vec![0] } else { self.seeds.clone() };
        let episodes = self.episodes.unwrap_or(suite.episodes);
        let places = self.places(suite)?;
        let mut rows = Vec::new();
        for agent in &agents {
            for Place { town, weathers } in &places {
                for &task in &tasks {
                    let traffic: Vec<Option<TrafficSpec>> = match self.traffic.as_slice() {
                        [] => vec![task.traffic],
                        given => given.iter().copied().map(Some).collect(),
                    };
                    let turn = if suite.weathers_in_turn || self.weathers_in_turn {
                        weathers.len().max(1)
                    } else {
                        1
                    };
                    for days in weathers.chunks(turn) {
                        rows.extend(traffic.iter().map(|&traffic| (agent, town, task, days, traffic)));
                    }
                }
            }
        }
        // Before memory is reserved for them.
        let found = episodes.saturating_mul((rows.len() * seeds.len()) as u64);
        if found > MOST_EPISODES {
            return Err(SuiteError::TooMany { found });
        }
        let (mut plan, mut seen) = (Vec::new(), HashSet::new());
        for (agent, town, task, days, traffic) in rows {
            for (&seed, episode) in seeds.iter().flat_map(|s| (0..episodes).map(move |e| (s, e))) {
                let weather = days[episode as usize % days.len()];
                let case = Case {
                    suite: suite.name.clone(),
                    condition: condition_of(suite, town, weather),
                    agent: agent.clone(),
                    town: town.clone(),
                    task: task.name.clone(),
                    spec: TaskSpec {
                        traffic,
                        tick_limit: task.tick_limit,
                        endless: task.endless,
                        ..TaskSpec::new(task.kind).in_weather(weather)
                    },
                    seed,
                    episode,
                };
                // Repeated values count once.
                if seen.insert(case.name()) {
                    plan.push((case, task));
                }
            }
        }
        Ok(plan)
    }

    /// With traffic as `--traffic` gives it: it selects the tasks with that traffic; if there are none, or tasks are
    /// selected already, it changes the traffic of all tasks.
    #[must_use]
    pub fn in_traffic(mut self, suite: &Suite, traffic: &[TrafficSpec]) -> Self {
        let has = |traffic: TrafficSpec| {
            suite.tasks.iter().filter(move |t| t.traffic.unwrap_or(t.kind.traffic()) == traffic)
        };
        let names_tasks = self.tasks.is_empty()
            && suite.tasks.len() > 1
            && !traffic.is_empty()
            && traffic.iter().all(|&traffic| has(traffic).next().is_some());
        if names_tasks {
            self.tasks = traffic.iter().flat_map(|&traffic| has(traffic)).map(|t| t.name.clone()).collect();
        } else {
            self.traffic = traffic.to_vec();
        }
        self
    }

    /// The routes of the towns that the suite's tasks need.
    ///
    /// # Errors
    /// There are none for a town.
    pub fn routes(
        &self,
        suite: &Suite,
        towns: &BTreeMap<String, Arc<Assets>>,
    ) -> Result<BTreeMap<String, (Routes, PathBuf)>, SuiteError> {
        let needed =
            |t: &SuiteTask| t.routes.is_some() && (self.tasks.is_empty() || self.tasks.contains(&t.name));
        if !suite.tasks.iter().any(needed) {
            return Ok(BTreeMap::new());
        }
        let mut routes = BTreeMap::new();
        for (town, assets) in towns {
            routes.insert(town.clone(), Routes::find(town, assets, self.routes.as_deref())?);
        }
        Ok(routes)
    }
}

/// The suite's condition of a town and a weather.
fn condition_of(suite: &Suite, town: &str, weather: Preset) -> String {
    let own = suite.conditions.iter().find(|c| c.town == town && c.weathers.contains(&weather));
    own.map_or("other".to_string(), |c| c.name.clone())
}

fn known<'a>(
    suite: &Suite,
    what: &'static str,
    asked: &[String],
    has: impl Iterator<Item = &'a str>,
) -> Result<(), SuiteError> {
    let expected: Vec<String> = has.map(String::from).collect();
    match asked.iter().find(|name| !expected.contains(name)) {
        Some(found) => {
            Err(SuiteError::NotIn { suite: suite.name.clone(), what, found: found.clone(), expected })
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wad_sim::tasks::{Placement, Spot, TaskKind};

    fn routes() -> BTreeMap<String, (Routes, PathBuf)> {
        let place = |n: usize| Placement {
            from: Spot { lane: format!("a{n}_0"), s: 1.0 },
            to: Spot { lane: "b_0".into(), s: 2.0 },
            obstacle: None,
            via: Vec::new(),
        };
        let sets = Routes::SETS.iter().map(|k| (k.name().to_string(), (0..5).map(place).collect())).collect();
        let of = |town: &str| {
            let routes = Routes {
                town: town.into(),
                net: String::new(),
                sets: Clone::clone(&sets),
                missing: BTreeMap::new(),
            };
            (town.to_string(), (routes, PathBuf::from(town)))
        };
        ["town3", "town5", "town7", "my.net.xml"].map(of).into()
    }

    fn plan(selection: &Selection, suite: &str) -> Vec<Case> {
        selection.plan(&Suite::find(suite).unwrap(), &routes()).unwrap()
    }

    #[test]
    fn a_suite_is_all_of_its_conditions_unless_told_otherwise() {
        assert_eq!(plan(&Selection::default(), "nocrash").len(), 750);
        assert_eq!(plan(&Selection::default(), "tasks").len(), 5 * 9 * 25);
        let composite = plan(&Selection::default(), "composite");
        assert_eq!(composite.len(), 300);
        assert_ne!(composite[0].spec.weather, composite[1].spec.weather, "weathers in turn");
        let in_turn = plan(&Selection { weathers_in_turn: true, ..Selection::default() }, "nocrash");
        assert_eq!(in_turn.len(), 3 * 3 * 25);
        assert_ne!(in_turn[0].spec.weather, in_turn[1].spec.weather);
        let some = Selection {
            tasks: vec!["dense".into()],
            conditions: vec!["development".into()],
            weathers: vec![Preset::WetSunset, Preset::ClearNoon],
            seeds: vec![1, 2],
            episodes: Some(3),
            ..Selection::default()
        };
        let plan = plan(&some, "nocrash");
        assert_eq!(plan.len(), 12);
        assert_eq!((plan[0].condition.as_str(), plan[11].condition.as_str()), ("development", "other"));
        let mut names: Vec<String> = plan.iter().map(Case::name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), 12, "each has a name of its own");
        assert!(plan.iter().all(|case| case.spec.kind == TaskKind::Navigation && case.town == "town5"));
    }

    #[test]
    fn egos_that_share_a_sumo_have_weathers_in_turn_each_its_own_and_else_one() {
        let composite = plan(&Selection::default(), "composite");
        let whole = groups(composite.clone(), 10, None);
        assert_eq!(whole.concat(), composite);
        assert!(whole.iter().all(|group| group[0].spec.weather != group[1].spec.weather), "in turn");
        assert!(whole.iter().all(|group| group.iter().all(|case| case.town == group[0].town)));
        assert_eq!(whole.len(), 30);
        let each = groups(plan(&Selection::default(), "nocrash"), 10, None);
        assert!(each.iter().all(|group| group.iter().all(|c| c.spec.weather == group[0].spec.weather)));
        assert_eq!(each.len(), 30 * 3);
        // The same places in each weather.
        let one = Selection { episodes: Some(1), ..Selection::default() };
        assert!(groups(plan(&one, "nocrash"), 10, None).iter().all(|group| group.len() == 1));
    }

    #[test]
    fn what_is_asked_for_twice_is_driven_once() {
        let once = Selection {
            agents: vec![DriverSpec::Autopilot],
            towns: vec!["town5".into()],
            weathers: vec![Preset::WetSunset],
            seeds: vec![1],
            ..Selection::default()
        };
        let twice = Selection {
            agents: vec![DriverSpec::Autopilot; 2],
            towns: vec!["town5".into(); 2],
            weathers: vec![Preset::WetSunset; 2],
            seeds: vec![1; 2],
            ..Selection::default()
        };
        for suite in ["nocrash", "composite"] {
            assert_eq!(plan(&once, suite), plan(&twice, suite));
        }
    }

    #[test]
    fn agents_whose_names_look_alike_are_all_driven() {
        let agents = ["runs/t/1/last.safetensors", "runs/t-1/last.safetensors", "runs-t-1-last.safetensors"];
        let of = |agents: &[&str]| {
            let agents = agents.iter().map(|agent| agent.parse().unwrap()).collect();
            plan(&Selection { agents, ..Selection::default() }, "nocrash")
        };
        let all = of(&agents);
        assert_eq!(all.len(), 3 * of(&agents[..1]).len());
        assert_eq!(all.iter().map(Case::name).collect::<HashSet<_>>().len(), all.len());
    }

    #[test]
    fn a_plan_of_a_million_million_episodes_is_refused() {
        let many = Selection { episodes: Some(u64::MAX), ..Selection::default() };
        let error = many.cases(&Suite::find("nocrash").unwrap()).unwrap_err().to_string();
        assert!(error.contains(&u64::MAX.to_string()) && error.contains("at most 1000000"), "{error}");
        // A million of each of its thirty rows filled the memory.
        let many = Selection { episodes: Some(1_000_000), ..Selection::default() };
        let error = many.cases(&Suite::find("nocrash").unwrap()).unwrap_err().to_string();
        assert!(error.contains("30000000 episodes"), "{error}");
    }

    #[test]
    fn names_of_episodes_are_plain_short_and_not_hidden() {
        let plan = plan(&Selection { episodes: Some(1), ..Selection::default() }, "nocrash");
        let named = |agent: &str| Case { agent: agent.parse().unwrap(), ..plan[0].clone() }.name();
        let here = named("wad-t");
        assert!(here.starts_with("wad-t_") && here.ends_with("_000"), "{here}");
        let file = named("../runs/my agent.safetensors");
        assert!(file.contains("_..-runs-my-agent.safetensors_") && file.ends_with("_000"), "{file}");
        assert!(!file.starts_with('.') && !named(".agent").starts_with('.'), "{file}");
        let long = named(&"deep/".repeat(40));
        assert!(long.len() <= 100 && long.ends_with("_000"), "{long}");
        assert_ne!(long, named(&"deeper/".repeat(40)));
    }

    #[test]
    fn an_own_net_is_driven_in_the_suites_weathers() {
        let own = Selection { towns: vec!["my.net.xml".into()], ..Selection::default() };
        let plan = plan(&own, "nocrash");
        assert_eq!(plan.len(), 750);
        assert!(plan.iter().all(|case| case.condition == "other" && case.town == "my.net.xml"));
        let unknown = Selection { towns: vec!["elsewhere".into()], ..Selection::default() };
        let error = unknown.plan(&Suite::find("nocrash").unwrap(), &routes()).unwrap_err().to_string();
        assert!(error.contains("eval routes elsewhere"), "{error}");
        let unknown = Selection { conditions: vec!["newer".into()], ..Selection::default() };
        let error = unknown.plan(&Suite::find("nocrash").unwrap(), &routes()).unwrap_err().to_string();
        assert!(error.contains("newer") && error.contains("training, development, test"), "{error}");
    }

    #[test]
    fn agents_and_weathers_drive_the_same_places() {
        let plan = plan(&Selection { episodes: Some(1), ..Selection::default() }, "nocrash");
        let seeds: Vec<u64> = plan.iter().map(Case::episode_seed).collect();
        assert_eq!(seeds[..4], [seeds[0]; 4]);
        assert_ne!(seeds[0], seeds[4], "another task");
    }

    #[test]
    fn shards_share_a_plan_without_overlap() {
        let shards: Vec<Shard> = ["1/3", "2/3", "3/3"].map(|s| s.parse().unwrap()).into();
        for index in 0..20 {
            assert_eq!(shards.iter().filter(|shard| shard.has(index)).count(), 1);
        }
        for bad in ["0/3", "4/3", "1", "a/b", "1/0"] {
            let error = bad.parse::<Shard>().unwrap_err().to_string();
            assert!(error.contains(bad) && error.contains("K/N"), "{error}");
        }
    }
}

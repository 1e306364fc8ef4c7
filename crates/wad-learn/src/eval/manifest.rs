//! The manifest of results: results of different builds, weights, nets or settings are never mixed.

use super::{Selection, Shard, Suite};
use crate::env::EnvOptions;
use crate::one::{is_one, one};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;

/// `config.json` of an evaluation's folder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// The program's version with its commit.
    pub build: String,
    /// SUMO's version.
    pub sumo: String,
    /// The suite.
    pub suite: Suite,
    /// The driven part of the suite.
    pub selection: Selection,
    /// The environment's options.
    pub options: EnvOptions,
    /// Egos that drive their episodes in one SUMO.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub egos: usize,
    /// Each agent's identity: the hashes of its weights and of its encoder; empty for agents without weights.
    pub agents: BTreeMap<String, String>,
    /// Hashes of the towns' nets.
    pub nets: BTreeMap<String, String>,
    /// Hashes of the towns' other files: routes, polygons, a scenario's ego and events.
    #[serde(default)]
    pub towns: BTreeMap<String, String>,
    /// The hash of the detector's weights; None for detectors without weights.
    #[serde(default)]
    pub detector: Option<String>,
    /// The driven part of the plan; None: all of it.
    pub shard: Option<Shard>,
}

impl Manifest {
    /// The differences of `other`, e.g. `build: 0.1.0 (aaa), found 0.1.0 (bbb)`; `shards`: whether the shard
    /// counts.
    pub fn differences(&self, other: &Self, shards: bool) -> Vec<String> {
        let mut found = Vec::new();
        let value = |manifest: &Self| {
            let mut value = serde_json::to_value(manifest).unwrap_or_default();
            if let (false, Some(object)) = (shards, value.as_object_mut()) {
                object.remove("shard");
            }
            value
        };
        compare("", &value(self), &value(other), &mut found);
        found
    }
}

fn compare(path: &str, expected: &Value, found: &Value, out: &mut Vec<String>) {
    let below = |key: &str| if path.is_empty() { key.to_string() } else { format!("{path}.{key}") };
    match (expected, found) {
        (Value::Object(a), Value::Object(b)) => {
            let mut keys: Vec<&String> = a.keys().chain(b.keys()).collect();
            keys.sort_unstable();
            keys.dedup();
            for key in keys {
                let of = |map: &serde_json::Map<String, Value>| map.get(key).cloned().unwrap_or(Value::Null);
                compare(&below(key), &of(a), &of(b), out);
            }
        }
        (a, b) if a != b => out.push(format!("{path}: expected {a}, found {b}")),
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_named() {
        let manifest = Manifest {
            build: "1".into(),
            sumo: "1.28.0".into(),
            suite: Suite::find("nocrash").unwrap(),
            selection: Selection::default(),
            options: EnvOptions::evaluation(),
            egos: 1,
            agents: [("wad-t".to_string(), "abc".to_string())].into(),
            nets: BTreeMap::new(),
            towns: BTreeMap::new(),
            detector: None,
            shard: None,
        };
        assert!(manifest.differences(&manifest, true).is_empty());
        let mut other = manifest.clone();
        other.build = "2".into();
        other.agents.insert("wad-t".into(), "xyz".into());
        other.options.tick_ms = 100.0;
        other.towns.insert("my_jam".into(), "abc-1".into());
        other.detector = Some("def-2".into());
        other.shard = Some(Shard { part: 1, of: 2 });
        let differences = manifest.differences(&other, false).join("; ");
        for part in [
            "build: expected \"1\", found \"2\"",
            "agents.wad-t",
            "options.tick_ms: expected 167",
            "towns.my_jam: expected null",
            "detector: expected null",
        ] {
            assert!(differences.contains(part), "{differences}");
        }
        assert!(!differences.contains("shard"));
        assert_eq!(manifest.differences(&other, true).len(), 6);
    }
}

//! Lines of tables: who drove, and behind which detector.

use crate::eval::DriverSpec;
use std::fmt;
use std::str::FromStr;

/// Who drove: an agent, or a pool of them, behind one detector.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Driver {
    /// The agent as it was asked for, or the pool's name.
    pub agent: String,
    /// The detector of one that looks; None where the whole report has one.
    pub detector: Option<String>,
    /// Drives by what the camera shows.
    pub looks: bool,
}

impl Driver {
    /// The line of an agent.
    pub fn of(agent: &DriverSpec, detector: &str, pools: &[Pool]) -> Self {
        let name = agent.to_string();
        let pool = pools.iter().find(|pool| pool.agents.contains(&name));
        let looks = agent.looks();
        let detector = looks.then(|| detector.to_string());
        Self { agent: pool.map_or(name, |pool| pool.name.clone()), detector, looks }
    }
}

impl fmt::Display for Driver {
    /// `wad-t`, or `wad-t, eyes` where detectors are compared.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&short(&self.agent))?;
        self.detector.as_ref().map_or(Ok(()), |detector| write!(f, ", {}", short(detector)))
    }
}

/// Agents that share a line: trainings of one kind, with other seeds. As text `NAME=AGENT,AGENT`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pool {
    /// The line's name.
    pub name: String,
    /// The agents as `eval` was asked for them.
    pub agents: Vec<String>,
}

impl FromStr for Pool {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("expected NAME=AGENT,AGENT, found {text:?}");
        let (name, agents) = text.split_once('=').ok_or_else(expected)?;
        let agents: Vec<String> = agents.split(',').map(str::to_string).collect();
        if name.is_empty() || agents.iter().any(String::is_empty) {
            return Err(expected());
        }
        Ok(Self { name: name.to_string(), agents })
    }
}

/// An agent's name for tables: a file's name without its folder, an external one's command cut short.
pub fn short(agent: &str) -> String {
    let text = match agent.strip_prefix("exec:") {
        Some(command) => format!("exec:{}", command.rsplit('/').next().unwrap_or(command)),
        None => agent.rsplit('/').next().unwrap_or(agent).trim_end_matches(".safetensors").to_string(),
    };
    if text.chars().count() <= 24 { text } else { text.chars().take(22).collect::<String>() + ".." }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pool_is_a_name_and_agents() {
        let pool: Pool = "wad-t=wad-t,runs/t2/last.safetensors".parse().unwrap();
        assert_eq!((pool.name.as_str(), pool.agents.len()), ("wad-t", 2));
        for wrong in ["wad-t", "=wad-t", "wad-t=", "wad-t=a,,b"] {
            assert!(wrong.parse::<Pool>().unwrap_err().contains("NAME=AGENT,AGENT"), "{wrong}");
        }
        let second = DriverSpec::from_str("runs/t2/last.safetensors").unwrap();
        assert_eq!(Driver::of(&second, "eyes", &[pool]).to_string(), "wad-t, eyes");
        let blind = DriverSpec::from_str("autopilot").unwrap();
        assert_eq!(Driver::of(&blind, "eyes", &[]).to_string(), "autopilot");
    }
}

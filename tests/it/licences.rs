//! Every dependency has a licence that deny.toml allows, and comes from the registry.

use super::program::stderr;
use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// A tree of licences, read from an SPDX expression.
struct Expression<'a> {
    words: std::iter::Peekable<std::vec::IntoIter<String>>,
    allow: &'a [String],
}

impl Expression<'_> {
    /// Whether a choice of `expression` has allowed licences only. `/` is an old spelling of OR.
    fn is_met(expression: &str, allow: &[String]) -> bool {
        let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
        let words: Vec<String> = spaced.split_whitespace().map(str::to_owned).collect();
        let mut tree = Expression { words: words.into_iter().peekable(), allow };
        let met = tree.any();
        assert!(tree.words.next().is_none(), "cannot read the licence `{expression}`");
        met
    }

    fn next_is(&mut self, word: &str) -> bool {
        self.words.next_if(|next| next == word).is_some()
    }

    fn any(&mut self) -> bool {
        let mut met = self.all();
        while self.next_is("OR") {
            met |= self.all();
        }
        met
    }

    fn all(&mut self) -> bool {
        let mut met = self.one();
        while self.next_is("AND") {
            met &= self.one();
        }
        met
    }

    fn one(&mut self) -> bool {
        if self.next_is("(") {
            let met = self.any();
            assert!(self.next_is(")"), "a bracket of a licence is not closed");
            return met;
        }
        let mut id = self.words.next().expect("a licence");
        if self.next_is("WITH") {
            id = format!("{id} WITH {}", self.words.next().expect("an exception"));
        }
        self.allow.contains(&id)
    }
}

/// The strings of the list `name = [...]` in deny.toml.
fn list(deny: &str, name: &str) -> Vec<String> {
    let start = format!("\n{name} = [");
    let (_, rest) = deny.split_once(&start).unwrap_or_else(|| panic!("deny.toml has no `{name}`"));
    let (items, _) = rest.split_once(']').unwrap();
    items.split('"').skip(1).step_by(2).map(str::to_owned).collect()
}

#[test]
fn expressions_are_read_as_spdx_says() {
    let allow = ["MIT", "Apache-2.0 WITH LLVM-exception", "ISC"].map(str::to_owned);
    let met = |expression| Expression::is_met(expression, &allow);
    assert!(met("MIT") && met("MIT OR GPL-3.0") && met("GPL-3.0/MIT") && met("MIT AND ISC"));
    assert!(met("(GPL-3.0 OR MIT) AND ISC") && met("Apache-2.0 WITH LLVM-exception OR Apache-2.0"));
    assert!(!met("GPL-3.0") && !met("MIT AND GPL-3.0") && !met("Apache-2.0") && !met("MIT-0"));
    // AND binds closer than OR.
    assert!(met("MIT OR ISC AND GPL-3.0") && !met("(MIT OR ISC) AND GPL-3.0"));
}

#[test]
fn every_dependency_has_an_allowed_licence() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let deny = std::fs::read_to_string(root.join("deny.toml")).unwrap();
    let allow = list(&deny, "allow");
    for id in &allow {
        assert!(
            !["GPL", "MPL", "EPL", "CDDL"].iter().any(|copyleft| id.contains(copyleft)),
            "{id} is copyleft"
        );
    }
    let output = Command::new(env!("CARGO"))
        .current_dir(root)
        .args(["metadata", "--offline", "--locked", "--format-version", "1", "--filter-platform"])
        .arg(&list(&deny, "targets")[0])
        .output()
        .unwrap();
    assert!(output.status.success(), "cargo metadata: {}", stderr(&output));
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    assert!(packages.len() > 100, "{} packages", packages.len());
    let refused: Vec<String> = packages
        .iter()
        .filter(|package| !package["license"].as_str().is_some_and(|text| Expression::is_met(text, &allow)))
        .map(|package| format!("{} {}: {}", package["name"], package["version"], package["license"]))
        .collect();
    assert!(refused.is_empty(), "deny.toml does not allow the licences of: {}", refused.join("; "));
    let elsewhere: Vec<&Value> = packages
        .iter()
        .filter(|package| package["source"].as_str().is_some_and(|source| !source.starts_with("registry+")))
        .map(|package| &package["name"])
        .collect();
    assert!(elsewhere.is_empty(), "not from the registry: {elsewhere:?}");
}

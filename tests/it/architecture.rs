//! ARCHITECTURE.md is true: crates use only what its map allows, no file is in a circle of imports, and its links lead
//! to what they name.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The map of ARCHITECTURE.md: lines `| \`crate\` | ... | \`a\`, \`b\` |`, by crate.
fn map() -> BTreeMap<String, BTreeSet<String>> {
    let page = text(&root().join("ARCHITECTURE.md"));
    let (_, table) = page.split_once("## Who may use whom").expect("a map of the crates");
    let names = |cell: &str| cell.split('`').skip(1).step_by(2).map(str::to_string).collect::<Vec<_>>();
    let rows =
        table.lines().skip_while(|line| !line.starts_with('|')).take_while(|line| line.starts_with('|'));
    rows.filter_map(|line| {
        let cells: Vec<&str> = line.trim_matches('|').split('|').collect();
        let own = names(cells.first()?).pop()?;
        Some((own, names(cells.last()?).into_iter().collect()))
    })
    .collect()
}

/// Folder of a crate of the workspace.
fn folder(name: &str) -> PathBuf {
    if name == "wad-cosim" { root() } else { root().join("crates").join(name) }
}

#[test]
fn crates_use_only_what_the_map_allows() {
    let map = map();
    let mut crates: Vec<String> = vec!["wad-cosim".to_string()];
    for entry in std::fs::read_dir(root().join("crates")).unwrap() {
        crates.push(entry.unwrap().file_name().into_string().unwrap());
    }
    assert_eq!(map.len(), crates.len(), "the map names each crate: {map:?}");
    for name in &crates {
        let allowed = map.get(name).unwrap_or_else(|| panic!("ARCHITECTURE.md leaves out {name}"));
        let manifest = text(&folder(name).join("Cargo.toml"));
        let (_, dependencies) = manifest.split_once("\n[dependencies]").unwrap();
        let dependencies = dependencies.split("\n[").next().unwrap();
        let used = crates.iter().filter(|other| {
            dependencies
                .lines()
                .any(|line| line.starts_with(&format!("{other}.")) || line.starts_with(&format!("{other} ")))
        });
        for other in used {
            assert!(allowed.contains(other), "{name} uses {other}, which ARCHITECTURE.md does not allow");
        }
    }
    // What is allowed is no circle: there is an order in which each crate uses only those before it.
    let mut placed: BTreeSet<&String> = BTreeSet::new();
    while placed.len() < map.len() {
        let next: Vec<&String> = map
            .iter()
            .filter(|(name, uses)| !placed.contains(name) && uses.iter().all(|used| placed.contains(used)))
            .map(|(name, _)| name)
            .collect();
        assert!(!next.is_empty(), "the map allows a circle");
        placed.extend(next);
    }
}

/// The modules of a crate: module path (`a::b`, empty for lib.rs) to file.
fn modules(src: &Path, path: &str, found: &mut BTreeMap<String, PathBuf>) {
    let Ok(entries) = std::fs::read_dir(src) else { return };
    for entry in entries.flatten() {
        let file = entry.path();
        let stem = file.file_stem().unwrap().to_string_lossy().into_owned();
        let inner = if path.is_empty() { stem.clone() } else { format!("{path}::{stem}") };
        if file.is_dir() {
            modules(&file, &inner, found);
        } else if file.extension().is_some_and(|e| e == "rs") {
            let module =
                if matches!(stem.as_str(), "lib" | "main" | "mod") { path.to_string() } else { inner };
            found.insert(module, file);
        }
    }
}

/// `a::{b, c::{d}}` as `a::b`, `a::c::d`.
fn flat(tree: &str) -> Vec<String> {
    let Some(open) = tree.find('{') else {
        return vec![tree.split(" as ").next().unwrap_or_default().trim().to_string()];
    };
    let Some(close) = tree.rfind('}').filter(|close| *close > open) else { return Vec::new() };
    let (before, inner) = (&tree[..open], &tree[open + 1..close]);
    let (mut parts, mut depth, mut part) = (Vec::new(), 0, String::new());
    for c in inner.chars().chain([',']) {
        depth += i32::from(c == '{') - i32::from(c == '}');
        if c == ',' && depth == 0 {
            parts.push(std::mem::take(&mut part));
        } else {
            part.push(c);
        }
    }
    let parts = parts.iter().map(|part| part.trim()).filter(|part| !part.is_empty());
    parts.flat_map(flat).map(|part| format!("{}{part}", before.trim())).collect()
}

/// The `use` declarations of a file without its tests, whether they are public, absolute within the crate.
fn imports(code: &str, module: &str) -> Vec<(bool, String)> {
    let code: String =
        code.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n");
    let code = code.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    let mut found = Vec::new();
    for (at, _) in code.match_indices("use ") {
        let before = code[..at].rsplit('\n').next().unwrap_or_default().trim();
        if !matches!(before, "" | "pub" | "pub(crate)" | "pub(super)") {
            continue;
        }
        let Some(end) = code[at..].find(';') else { continue };
        for path in flat(&code[at + 4..at + end]) {
            let mut base: Vec<&str> = module.split("::").filter(|part| !part.is_empty()).collect();
            let mut parts = path.split("::").peekable();
            match parts.peek().copied() {
                Some("crate") => {
                    parts.next();
                    base.clear();
                }
                Some("self") => {
                    parts.next();
                }
                Some("super") => {
                    while parts.next_if_eq(&"super").is_some() {
                        base.pop();
                    }
                }
                // Of a child module, or of another crate.
                _ => {}
            }
            let path: Vec<&str> = base.into_iter().chain(parts).collect();
            found.push((before.starts_with("pub"), path.join("::")));
        }
    }
    found
}

/// The module that a path lies in, public re-exports followed.
fn home(
    path: &str,
    modules: &BTreeMap<String, PathBuf>,
    exports: &BTreeMap<String, String>,
) -> Option<String> {
    let mut path = path.to_string();
    for _ in 0..8 {
        match exports.get(&path) {
            Some(other) if *other != path => path = other.clone(),
            _ => break,
        }
    }
    let mut prefix = path.as_str();
    loop {
        if modules.contains_key(prefix) && !prefix.is_empty() {
            return Some(prefix.to_string());
        }
        prefix = prefix.rsplit_once("::")?.0;
    }
}

#[test]
fn no_file_is_in_a_circle_of_imports() {
    for name in map().keys() {
        let mut found = BTreeMap::new();
        modules(&folder(name).join("src"), "", &mut found);
        found.retain(|module, _| !module.split("::").any(|part| part.contains("test")));
        assert!(!found.is_empty(), "{name} has no modules");
        let uses: BTreeMap<&String, Vec<(bool, String)>> =
            found.iter().map(|(module, file)| (module, imports(&text(file), module))).collect();
        let mut exports = BTreeMap::new();
        for (module, paths) in &uses {
            for (public, path) in paths.iter().filter(|(public, _)| *public) {
                let item = path.rsplit("::").next().unwrap_or_default();
                let own = if module.is_empty() { item.to_string() } else { format!("{module}::{item}") };
                debug_assert!(public);
                exports.insert(own, path.clone());
            }
        }
        let mut edges: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for (module, paths) in &uses {
            for (_, path) in paths.iter().filter(|(public, _)| !public) {
                let Some(other) = home(path, &found, &exports) else { continue };
                // A folder is one idea: its files may use what its mod.rs says.
                let is_ancestor =
                    module.starts_with(&format!("{other}::")) || other.starts_with(&format!("{module}::"));
                if other != **module && !is_ancestor && !module.is_empty() {
                    edges.entry((*module).clone()).or_default().insert(other);
                }
            }
        }
        // Whoever uses nothing that is left goes; a circle stays.
        let mut left: BTreeSet<String> = edges.keys().cloned().collect();
        loop {
            let before = left.len();
            let snapshot = left.clone();
            left.retain(|module| edges[module].iter().any(|other| snapshot.contains(other)));
            if left.len() == before {
                break;
            }
        }
        let circle: Vec<String> = left
            .iter()
            .map(|module| {
                let others: Vec<&String> =
                    edges[module].iter().filter(|other| left.contains(*other)).collect();
                format!("{module} uses {others:?}")
            })
            .collect();
        assert!(circle.is_empty(), "files of {name} use each other in a circle:\n{}", circle.join("\n"));
    }
}

/// A link is written as [`what`](path#Lnumber): the line holds `what`. With `WAD_COSIM_UPDATE=1` the numbers are
/// corrected instead.
#[test]
fn links_of_the_architecture_lead_to_what_they_name() {
    let page = root().join("ARCHITECTURE.md");
    let before = text(&page);
    let mut after = String::new();
    let (mut wrong, mut links) = (Vec::new(), 0);
    let mut rest = before.as_str();
    while let Some(at) = rest.find("[`") {
        let (head, tail) = rest.split_at(at);
        after += head;
        let Some(((what, target), end)) =
            tail.find(')').and_then(|end| Some((tail[2..end].split_once("`](")?, end)))
        else {
            after += "[`";
            rest = &tail[2..];
            continue;
        };
        rest = &tail[end + 1..];
        let Some((file, line)) = target.split_once("#L") else {
            assert!(root().join(target).exists(), "{target} does not exist");
            after += &format!("[`{what}`]({target})");
            continue;
        };
        links += 1;
        let code = text(&root().join(file));
        let found = code.lines().position(|l| l.contains(what)).map(|n| n + 1);
        let found = found.unwrap_or_else(|| panic!("{file} has no line with `{what}`"));
        if code
            .lines()
            .nth(line.parse::<usize>().unwrap_or(0).saturating_sub(1))
            .is_none_or(|l| !l.contains(what))
        {
            wrong.push(format!("{file}#L{line}: `{what}` is in line {found}"));
            after += &format!("[`{what}`]({file}#L{found})");
        } else {
            after += &format!("[`{what}`]({target})");
        }
    }
    after += rest;
    if std::env::var_os("WAD_COSIM_UPDATE").is_some() && after != before {
        return std::fs::write(&page, after).unwrap();
    }
    assert!(links >= 20, "only {links} links");
    assert!(
        wrong.is_empty(),
        "links that lead elsewhere; WAD_COSIM_UPDATE=1 cargo test --release --test it architecture corrects them:\n{}",
        wrong.join("\n")
    );
}

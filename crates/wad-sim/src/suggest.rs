//! "Did you mean": the names nearest to one that is not known.

/// The entries of `names` nearest to `found`, nearest first, for "did you mean".
pub fn near<'a>(found: &str, names: impl IntoIterator<Item = &'a str>) -> Vec<&'a str> {
    let folded = |s: &str| s.replace(['-', '_', '.', ' '], "").to_ascii_lowercase();
    let wanted = folded(found);
    let mut near: Vec<(usize, &str)> = names
        .into_iter()
        .map(|name| (wad_camera::distance(&wanted, &folded(name)), name))
        .filter(|(distance, name)| *distance <= 1 + name.len() / 4)
        .collect();
    near.sort();
    near.into_iter().take(3).map(|(_, name)| name).collect()
}

/// "did you mean X?" where something is near, else the whole list.
pub fn meant(found: &str, names: &[&str]) -> String {
    let near = near(found, names.iter().copied());
    if near.is_empty() {
        format!("expected one of {}", names.join(", "))
    } else {
        format!("did you mean {}?", near.join(" or "))
    }
}

//! Elements of SUMO's route and additional files, with their generic parameters and lines.

use super::problem::Problem;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A generic parameter (`<param key="" value=""/>`).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Param {
    pub key: String,
    pub value: String,
    pub line: usize,
}

/// An element directly below a file's root.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Element {
    pub file: PathBuf,
    pub line: usize,
    pub tag: String,
    pub attributes: BTreeMap<String, String>,
    pub params: Vec<Param>,
    /// Edges of a `<route>` inside it.
    pub route: Option<String>,
}

impl Element {
    /// An attribute that is there and not empty.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.attributes.get(name).map(String::as_str).filter(|value| !value.is_empty())
    }

    pub fn id(&self) -> &str {
        self.get("id").unwrap_or_default()
    }

    /// Its generic parameter of that name; the last counts.
    pub fn param(&self, key: &str) -> Option<&str> {
        self.params.iter().rev().find(|p| p.key == key).map(|p| p.value.trim())
    }

    /// A mistake in it.
    pub fn problem(&self, what: impl Into<String>, fix: impl Into<String>) -> Problem {
        Problem {
            file: self.file.clone(),
            line: Some(self.line),
            element: format!("{} `{}`", self.tag, self.id()),
            what: what.into(),
            fix: fix.into(),
        }
    }
}

/// The elements of a route or additional file, in order.
pub fn read(path: &Path) -> Result<Vec<Element>, Problem> {
    let bytes = std::fs::read(path).map_err(|error| {
        Problem::of_file(path, format!("cannot be read: {error}"), "check the path in the .sumocfg")
    })?;
    let text = String::from_utf8_lossy(&bytes);
    let text = text.strip_prefix('\u{feff}').unwrap_or(&text);
    let mut reader = quick_xml::Reader::from_str(text);
    let mut elements: Vec<Element> = Vec::new();
    let mut depth = 0usize;
    loop {
        let line = line_of(text, reader.buffer_position());
        let broken = |line: usize, why: String| Problem {
            line: Some(line),
            ..Problem::of_file(
                path,
                format!("is not well-formed XML: {why}"),
                "save it again in netedit, or repair this line",
            )
        };
        let event = reader.read_event().map_err(|error| broken(line, error.to_string()))?;
        // The line of the tag itself: what was skipped before it ends with `<`.
        match event {
            Event::Eof if depth > 0 => return Err(broken(line, "it is cut off".to_string())),
            Event::Eof => return Ok(elements),
            Event::Start(tag) => {
                let line = line_of(text, reader.buffer_position());
                open(path, line, depth, &tag, &mut elements).map_err(|why| broken(line, why))?;
                depth += 1;
            }
            Event::Empty(tag) => {
                let line = line_of(text, reader.buffer_position());
                open(path, line, depth, &tag, &mut elements).map_err(|why| broken(line, why))?;
            }
            Event::End(_) => depth = depth.saturating_sub(1),
            _ => {}
        }
    }
}

fn line_of(text: &str, position: u64) -> usize {
    let end = usize::try_from(position).map_or(text.len(), |p| p.min(text.len()));
    1 + text.as_bytes()[..end].iter().filter(|&&b| b == b'\n').count()
}

fn open(
    path: &Path,
    line: usize,
    depth: usize,
    tag: &BytesStart<'_>,
    elements: &mut Vec<Element>,
) -> Result<(), String> {
    let mut attributes = BTreeMap::new();
    for attribute in tag.attributes() {
        let attribute = attribute.map_err(|error| error.to_string())?;
        let value = attribute.normalized_value(XmlVersion::Implicit1_0).map_err(|error| error.to_string())?;
        attributes.insert(attribute.key.0.to_string(), value.into_owned());
    }
    let name = tag.name().0;
    match (depth, elements.last_mut()) {
        (1, _) => elements.push(Element {
            file: path.to_path_buf(),
            line,
            tag: name.to_string(),
            attributes,
            params: Vec::new(),
            route: None,
        }),
        (2, Some(parent)) if name == "param" => {
            let value = |key: &str| attributes.get(key).cloned().unwrap_or_default();
            parent.params.push(Param { key: value("key").trim().to_string(), value: value("value"), line });
        }
        (2, Some(parent)) if name == "route" => parent.route = attributes.remove("edges"),
        _ => {}
    }
    Ok(())
}

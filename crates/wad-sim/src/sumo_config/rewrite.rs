//! Copies of a user's route and additional files whose outputs go to the run folder, or without a type of vehicles.

use super::error::ConfigError;
use super::xml::Events;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use sumo_network::network::read_text;

pub fn absolute_list(folder: &Path, value: &str) -> String {
    let absolute: Vec<String> = value
        .split(',')
        .map(str::trim)
        .filter(|file| !file.is_empty())
        .map(|file| absolute(folder, file))
        .collect();
    absolute.join(",")
}

fn absolute(folder: &Path, file: &str) -> String {
    // `${VARIABLE}` is SUMO's to fill in; `stdout`, `NUL` and sockets are not files.
    if file.starts_with("${") || file == "stdout" || file == "stderr" || file == "NUL" {
        return file.to_string();
    }
    folder.join(file).to_string_lossy().to_string()
}

/// Generic parameters of vehicles and vehicle types that name a file which SUMO writes, and options too.
pub const OUTPUT_PARAMETERS: [&str; 2] = ["device.ssm.file", "device.toc.file"];

/// Elements of additional files that write, with the attribute that names where.
fn output_attribute(element: &str) -> Option<&'static str> {
    match element {
        "e1Detector"
        | "inductionLoop"
        | "instantInductionLoop"
        | "e2Detector"
        | "laneAreaDetector"
        | "e3Detector"
        | "entryExitDetector"
        | "edgeData"
        | "laneData"
        | "meanData"
        | "routeProbe"
        | "vTypeProbe" => Some("file"),
        "calibrator" => Some("output"),
        "timedEvent" => Some("dest"),
        _ => None,
    }
}

/// `file` itself if nothing in it has the type `dropped`, else a copy in `dir` without those elements.
pub fn without_type(file: &Path, dropped: &str, dir: &Path) -> Result<PathBuf, ConfigError> {
    let text = read_plain(file)?;
    let malformed = |problem: String| ConfigError::NotXml { path: file.to_path_buf(), problem };
    let mut reader = Events::of(&text);
    let mut writer = quick_xml::Writer::new(Vec::with_capacity(text.len()));
    let (mut inside, mut found) = (0usize, false);
    let is_dropped = |start: &BytesStart<'_>| {
        start.attributes().flatten().any(|a| a.key.0 == "type" && a.value.as_ref() == dropped)
    };
    loop {
        let event = reader.next().map_err(malformed)?;
        let drop = match &event {
            Event::Eof => break,
            Event::Start(start) if inside > 0 || is_dropped(start) => {
                inside += 1;
                true
            }
            Event::End(_) if inside > 0 => {
                inside -= 1;
                true
            }
            Event::Empty(start) => inside > 0 || is_dropped(start),
            _ => inside > 0,
        };
        found |= drop;
        if !drop {
            writer.write_event(event).map_err(|e| malformed(e.to_string()))?;
        }
    }
    if !found {
        return Ok(file.to_path_buf());
    }
    let name = file.file_name().map(|f| f.to_string_lossy().to_string()).unwrap_or_default();
    let path = dir.join(format!("without-{dropped}-{}", name.trim_end_matches(".gz")));
    std::fs::write(&path, writer.into_inner())
        .map_err(|source| ConfigError::Write { path: path.clone(), source })?;
    Ok(path)
}

/// A file's text, plain or gzipped.
fn read_plain(file: &Path) -> Result<String, ConfigError> {
    let text = read_text(file)?;
    // SUMO reads UTF-16 too, in which nothing would be found here.
    if text.contains('\0') || !text.contains('<') {
        let problem = "it is not text in UTF-8 or Latin-1".to_string();
        return Err(ConfigError::NotXml { path: file.to_path_buf(), problem });
    }
    Ok(text)
}

/// What a file that writes something, or brings in another that may, has in its text.
const WRITERS: [&str; 9] = [
    "Detector",
    "ductionLoop",
    "edgeData",
    "laneData",
    "meanData",
    "Probe",
    "calibrator",
    "timedEvent",
    "<include",
];

/// Files that include files: no deeper than this.
const DEPTH: usize = 16;

/// Sends what SUMO writes into one folder, each of the user's files under a name of its own.
pub struct Redirection<'a> {
    folder: &'a Path,
    /// The name in the folder that stands for each output and, with a prefix, for each copy.
    names: BTreeMap<(&'static str, PathBuf), String>,
}

impl<'a> Redirection<'a> {
    pub fn into(folder: &'a Path) -> Self {
        // Those that are written there in any case.
        let own = ["sumo.sumocfg", "sumo.log"].map(|name| (("", folder.join(name)), name.to_string()));
        Self { folder, names: BTreeMap::from(own) }
    }

    /// The path in the folder for `path`, named after it: the same one each time, and another one's never.
    fn place(&mut self, prefix: &'static str, path: &Path) -> PathBuf {
        let key = (prefix, path.to_path_buf());
        if let Some(name) = self.names.get(&key) {
            return self.folder.join(name);
        }
        let own = path.file_name().map_or("output.xml".into(), |name| name.to_string_lossy());
        // SUMO takes what follows a colon for a port.
        let own = own.replace(':', "_");
        let mut name = format!("{prefix}{own}");
        for number in 2.. {
            if !self.names.values().any(|taken| *taken == name) {
                break;
            }
            name = format!("{prefix}{number}-{own}");
        }
        let place = self.folder.join(&name);
        self.names.insert(key, name);
        place
    }

    /// Where SUMO writes what should go to `value`, a file or a list of some, relative to `base`.
    pub fn output(&mut self, base: &Path, value: &str) -> Result<String, ConfigError> {
        if self.folder.to_string_lossy().contains(':') {
            return Err(ConfigError::Path { path: self.folder.to_path_buf(), found: "a colon" });
        }
        let files = value.split(',').map(str::trim).filter(|file| !file.is_empty());
        let moved: Vec<_> =
            files.map(|file| self.place("", &base.join(file)).to_string_lossy().into_owned()).collect();
        Ok(moved.join(","))
    }

    /// `file` itself where it writes nothing, else a copy in the folder whose outputs, and those of the files that
    /// it includes, go to the folder.
    pub fn copy(&mut self, file: &Path) -> Result<PathBuf, ConfigError> {
        self.copy_within(file, DEPTH)
    }

    fn copy_within(&mut self, file: &Path, depth: usize) -> Result<PathBuf, ConfigError> {
        let text = read_plain(file)?;
        if !WRITERS.iter().chain(&OUTPUT_PARAMETERS).chain(&["<!DOCTYPE"]).any(|w| text.contains(w)) {
            return Ok(file.to_path_buf());
        }
        let base = file.parent().map(Path::to_path_buf).unwrap_or_default();
        let not_xml = |problem: String| ConfigError::NotXml { path: file.to_path_buf(), problem };
        let mut reader = Events::of(&text);
        let mut writer = quick_xml::Writer::new(Vec::with_capacity(text.len()));
        loop {
            let event = match reader.next().map_err(not_xml)? {
                Event::Eof => break,
                Event::Start(start) => Event::Start(self.element(&start, file, &base, depth)?),
                Event::Empty(start) => Event::Empty(self.element(&start, file, &base, depth)?),
                other => other,
            };
            writer.write_event(event).map_err(|e| not_xml(e.to_string()))?;
        }
        let plain = PathBuf::from(file.to_string_lossy().trim_end_matches(".gz"));
        let path = self.place("redirected-", &plain);
        std::fs::write(&path, writer.into_inner())
            .map_err(|source| ConfigError::Write { path: path.clone(), source })?;
        Ok(path)
    }

    fn element(
        &mut self,
        start: &BytesStart<'_>,
        file: &Path,
        base: &Path,
        depth: usize,
    ) -> Result<BytesStart<'static>, ConfigError> {
        let not_xml = |problem: String| ConfigError::NotXml { path: file.to_path_buf(), problem };
        let name = start.name().0.to_string();
        let is_output_parameter = |a: quick_xml::events::attributes::Attribute<'_>| {
            a.key.0 == "key" && OUTPUT_PARAMETERS.contains(&a.value.as_ref())
        };
        let written = match name.as_str() {
            "param" if start.attributes().flatten().any(is_output_parameter) => Some("value"),
            name => output_attribute(name),
        };
        let includes = name == "include";
        let mut out = BytesStart::new(name);
        for attribute in start.attributes() {
            let attribute = attribute.map_err(|e| not_xml(e.to_string()))?;
            let key = attribute.key.0;
            let value =
                attribute.normalized_value(XmlVersion::Implicit1_0).map_err(|e| not_xml(e.to_string()))?;
            let value = if written == Some(key) {
                self.output(base, &value)?
            } else if includes && key == "href" {
                let Some(left) = depth.checked_sub(1) else {
                    return Err(not_xml(format!("files include files more than {DEPTH} deep")));
                };
                self.copy_within(&base.join(&*value), left)?.to_string_lossy().into_owned()
            } else if matches!(key, "file" | "href" | "imgFile" | "osgFile") && !value.is_empty() {
                absolute(base, &value)
            } else {
                value.into_owned()
            };
            out.push_attribute((key, value.as_str()));
        }
        Ok(out)
    }
}

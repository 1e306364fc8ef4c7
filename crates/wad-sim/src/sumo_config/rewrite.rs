//! Copies of a user's route and additional files whose outputs go to the run folder, or without a type of vehicles.

use super::error::ConfigError;
use super::xml::Events;
use quick_xml::XmlVersion;
use quick_xml::events::{BytesStart, Event};
use std::io::Read;
use std::path::{Path, PathBuf};

/// The same file names inside `dir`.
pub fn redirected(value: &str, dir: &Path) -> String {
    let moved: Vec<String> = value
        .split(',')
        .map(|file| {
            let name = Path::new(file.trim()).file_name().map(|f| f.to_string_lossy().to_string());
            dir.join(name.unwrap_or_else(|| "output.xml".to_string())).to_string_lossy().to_string()
        })
        .collect();
    moved.join(",")
}

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
    let malformed = |problem: String| ConfigError::Malformed { path: file.to_path_buf(), problem };
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
    let read_error = |source| ConfigError::Read { path: file.to_path_buf(), source };
    let bytes = std::fs::read(file).map_err(read_error)?;
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return Ok(String::from_utf8_lossy(&bytes).into_owned());
    }
    let mut text = String::new();
    flate2::read::MultiGzDecoder::new(&bytes[..]).read_to_string(&mut text).map_err(read_error)?;
    Ok(text)
}

/// `file` itself where it writes nothing, else a copy in `dir` whose outputs go to `dir`.
pub fn redirect_outputs(file: &Path, dir: &Path) -> Result<PathBuf, ConfigError> {
    let text = read_plain(file)?;
    let writers =
        ["Detector", "ductionLoop", "edgeData", "laneData", "meanData", "Probe", "calibrator", "timedEvent"];
    if !writers.iter().chain(&OUTPUT_PARAMETERS).any(|w| text.contains(w)) {
        return Ok(file.to_path_buf());
    }
    let folder = file.parent().map(Path::to_path_buf).unwrap_or_default();
    let malformed = |problem: String| ConfigError::Malformed { path: file.to_path_buf(), problem };
    let mut reader = Events::of(&text);
    let mut writer = quick_xml::Writer::new(Vec::with_capacity(text.len()));
    loop {
        let event = reader.next().map_err(malformed)?;
        let event = match event {
            Event::Eof => break,
            Event::Start(start) => Event::Start(redirect_element(&start, &folder, dir).map_err(malformed)?),
            Event::Empty(start) => Event::Empty(redirect_element(&start, &folder, dir).map_err(malformed)?),
            other => other,
        };
        writer.write_event(event).map_err(|e| malformed(e.to_string()))?;
    }
    let name = file.file_name().map(|f| f.to_string_lossy().to_string()).unwrap_or_default();
    let path = dir.join(format!("redirected-{}", name.trim_end_matches(".gz")));
    std::fs::write(&path, writer.into_inner())
        .map_err(|source| ConfigError::Write { path: path.clone(), source })?;
    Ok(path)
}

fn redirect_element(
    start: &BytesStart<'_>,
    folder: &Path,
    dir: &Path,
) -> Result<BytesStart<'static>, String> {
    let name = start.name().0.to_string();
    let is_output_parameter = |a: quick_xml::events::attributes::Attribute<'_>| {
        a.key.0 == "key" && OUTPUT_PARAMETERS.contains(&a.value.as_ref())
    };
    let written = match name.as_str() {
        "param" if start.attributes().flatten().any(is_output_parameter) => Some("value"),
        name => output_attribute(name),
    };
    let mut out = BytesStart::new(name);
    for attribute in start.attributes() {
        let attribute = attribute.map_err(|e| e.to_string())?;
        let key = attribute.key.0;
        let value = attribute.normalized_value(XmlVersion::Implicit1_0).map_err(|e| e.to_string())?;
        let value = if written == Some(key) {
            redirected(&value, dir)
        } else if matches!(key, "file" | "href" | "imgFile" | "osgFile") && !value.is_empty() {
            absolute(folder, &value)
        } else {
            value.into_owned()
        };
        out.push_attribute((key, value.as_str()));
    }
    Ok(out)
}

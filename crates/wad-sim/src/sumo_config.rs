//! A user's SUMO configuration, and the effective one that a run is made of.
//!
//! The user's own begin, routes and additional files are honoured; every output is redirected
//! into the run folder, so that parallel runs never write beside a user's files; what headless
//! SUMO does not know (gui-only options such as `osg-view`) is left out. The result is one file,
//! `sumo.sumocfg` in the run folder, which reruns the same simulation with plain SUMO.

mod error;
mod rewrite;
mod xml;

pub use error::ConfigError;

use rewrite::{OUTPUT_PARAMETERS, Redirection, absolute_list, without_type};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use sumo_traci::keeper;
use sumo_traci::process::{ANSWER, SumoInstall};
use xml::for_each_element;

/// The options that a SUMO binary knows, as it lists them itself.
#[derive(Clone, Debug, Default)]
pub struct OptionSchema {
    /// Canonical name by every name, synonyms included.
    canonical: BTreeMap<String, String>,
    /// Type (`FILE`, `BOOL`, ...) by canonical name.
    types: BTreeMap<String, String>,
}

impl OptionSchema {
    /// Asks the `sumo` (or `sumo-gui`) binary of an installation.
    pub fn query(install: &SumoInstall, gui: bool) -> Result<Self, ConfigError> {
        let program = if gui { "sumo-gui" } else { "sumo" };
        let binary = install.program(program);
        let fail = |problem: String| ConfigError::Schema { binary: binary.clone(), problem };
        let mut command = install.command(program);
        command.args(["--save-template", "/dev/stdout", "--save-template.commented", "true"]);
        let output = keeper::output_within(command, ANSWER).map_err(|e| fail(e.to_string()))?;
        let text = String::from_utf8_lossy(&output.stdout);
        let schema = Self::parse(&text).map_err(fail)?;
        if schema.types.is_empty() {
            return Err(fail(String::from_utf8_lossy(&output.stderr).trim().to_string()));
        }
        Ok(schema)
    }

    /// The same, queried once per process and binary: the query costs as much as starting SUMO.
    pub fn cached(install: &SumoInstall, gui: bool) -> Result<Arc<Self>, ConfigError> {
        static KNOWN: Mutex<BTreeMap<PathBuf, Arc<OptionSchema>>> = Mutex::new(BTreeMap::new());
        let binary = install.program(if gui { "sumo-gui" } else { "sumo" });
        let known = || KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(schema) = known().get(&binary) {
            return Ok(Arc::clone(schema));
        }
        let schema = Arc::new(Self::query(install, gui)?);
        known().insert(binary, Arc::clone(&schema));
        Ok(schema)
    }

    fn parse(template: &str) -> Result<Self, String> {
        let mut schema = Self::default();
        // What precedes the document (a greeting on stdout) is not XML.
        let start = template.find("<?xml").unwrap_or(0);
        for_each_element(&template[start..], |name, attributes| {
            let Some(kind) = attributes.get("type") else { return };
            schema.types.insert(name.to_string(), kind.clone());
            schema.canonical.insert(name.to_string(), name.to_string());
            for synonym in attributes.get("synonymes").into_iter().flat_map(|s| s.split_whitespace()) {
                schema.canonical.insert(synonym.to_string(), name.to_string());
            }
        })?;
        Ok(schema)
    }

    fn is_file(&self, option: &str) -> bool {
        self.types.get(option).is_some_and(|t| t.eq_ignore_ascii_case("FILE"))
    }
}

/// A parsed configuration: options with their values, file paths made absolute.
#[derive(Clone, Debug)]
pub struct SumoConfig {
    path: PathBuf,
    options: BTreeMap<String, String>,
    /// Options of the file that this SUMO does not know, left out.
    pub ignored: Vec<String>,
}

/// A run's changes to the user's configuration.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    /// Folder for everything that SUMO writes.
    pub output_dir: PathBuf,
    /// Options that win over the file's.
    pub set: Vec<(String, String)>,
    /// Options that apply if the file does not set them.
    pub default: Vec<(String, String)>,
    /// Leaves out the file's own routes.
    pub drop_demand: bool,
    /// Leaves out trips and vehicles of this type, as a scenario's ego, which the bridge brings itself.
    pub drop_type: Option<&'static str>,
}

impl SumoConfig {
    /// Reads a `.sumocfg`, or makes one of a bare `.net.xml(.gz)`.
    ///
    /// # Errors
    /// The file is unreadable or not XML, names no net, or names a file that does not exist.
    pub fn load(path: &Path, schema: &OptionSchema) -> Result<Self, ConfigError> {
        let config = Self::read(path, schema)?;
        for option in ["net-file", "route-files", "additional-files"] {
            config.present(option)?;
        }
        Ok(config)
    }

    /// The network file, which exists.
    ///
    /// # Errors
    /// There is none, or it does not exist.
    pub(crate) fn present_net(&self) -> Result<PathBuf, ConfigError> {
        self.present("net-file")?;
        self.net_file()
    }

    fn present(&self, option: &str) -> Result<(), ConfigError> {
        let missing = self.files(option).into_iter().find(|file| !file.exists());
        missing.map_or(Ok(()), |missing| {
            let (config, option) = (self.path.clone(), option.to_string());
            Err(ConfigError::MissingInput { config, option, missing })
        })
    }

    /// [`Self::load`], but files that it names may be missing.
    pub(crate) fn read(path: &Path, schema: &OptionSchema) -> Result<Self, ConfigError> {
        let path = std::path::absolute(path)
            .map_err(|source| ConfigError::Read { path: path.to_path_buf(), source })?;
        usable(&path)?;
        let name = path.to_string_lossy();
        if name.ends_with(".net.xml") || name.ends_with(".net.xml.gz") {
            let options = BTreeMap::from([("net-file".to_string(), name.to_string())]);
            return Ok(Self { path: path.clone(), options, ignored: Vec::new() });
        }
        let text = std::fs::read_to_string(&path)
            .map_err(|source| ConfigError::Read { path: path.clone(), source })?;
        let folder = path.parent().map(Path::to_path_buf).unwrap_or_default();
        let mut options = BTreeMap::new();
        let mut ignored = Vec::new();
        for_each_element(&text, |name, attributes| {
            let Some(value) = attributes.get("value").or_else(|| attributes.get("v")) else { return };
            match schema.canonical.get(name) {
                Some(option) => {
                    let value =
                        if schema.is_file(option) { absolute_list(&folder, value) } else { value.clone() };
                    options.insert(option.clone(), value);
                }
                None => ignored.push(name.to_string()),
            }
        })
        .map_err(|problem| ConfigError::Malformed { path: path.clone(), problem })?;
        let config = Self { path: path.clone(), options, ignored };
        if config.net_files().is_empty() {
            return Err(ConfigError::NoNet { path });
        }
        Ok(config)
    }

    /// The configuration's own path, absolute.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Town or net name: the file name without its endings.
    pub fn name(&self) -> String {
        let file = self.path.file_name().map(|f| f.to_string_lossy().to_string()).unwrap_or_default();
        file.split('.').next().unwrap_or_default().to_string()
    }

    /// The network file.
    pub fn net_file(&self) -> Result<PathBuf, ConfigError> {
        self.net_files().into_iter().next().ok_or_else(|| ConfigError::NoNet { path: self.path.clone() })
    }

    fn net_files(&self) -> Vec<PathBuf> {
        self.files("net-file")
    }

    /// Additional files (polygons, detectors, stops, ...), absolute.
    pub fn additional_files(&self) -> Vec<PathBuf> {
        self.files("additional-files")
    }

    /// Route files (the demand), absolute.
    pub fn route_files(&self) -> Vec<PathBuf> {
        self.files("route-files")
    }

    /// The town: the net's file name without its endings.
    pub fn town(&self) -> String {
        let net = self.net_files().into_iter().next().unwrap_or_else(|| self.path.clone());
        let file = net.file_name().map(|f| f.to_string_lossy().to_string()).unwrap_or_default();
        file.split('.').next().unwrap_or_default().to_string()
    }

    fn files(&self, option: &str) -> Vec<PathBuf> {
        let value = self.options.get(option).map(String::as_str).unwrap_or_default();
        value.split(',').map(str::trim).filter(|v| !v.is_empty()).map(PathBuf::from).collect()
    }

    /// A time option in seconds (`90`, `15:0:0`, `1:00:00:00`), None if the file does not set it
    /// or the time is negative (SUMO's "never").
    pub fn time(&self, option: &str) -> Result<Option<f64>, ConfigError> {
        let Some(text) = self.options.get(option) else { return Ok(None) };
        let parts: Option<Vec<f64>> = text.split(':').map(|p| p.trim().parse().ok()).collect();
        let seconds = match parts.as_deref() {
            Some([s]) => *s,
            Some([h, m, s]) => h * 3600.0 + m * 60.0 + s,
            Some([d, h, m, s]) => d * 86400.0 + h * 3600.0 + m * 60.0 + s,
            _ => f64::NAN,
        };
        if !seconds.is_finite() {
            return Err(ConfigError::BadValue {
                path: self.path.clone(),
                option: option.to_string(),
                value: text.clone(),
                expected: "seconds or [days:]hours:minutes:seconds",
            });
        }
        Ok((seconds >= 0.0).then_some(seconds))
    }

    /// Whether the file gives this option.
    pub fn has(&self, option: &str) -> bool {
        self.options.contains_key(option)
    }

    /// SUMO's seed in the file.
    pub fn seed(&self) -> Option<u64> {
        self.options.get("seed")?.parse().ok()
    }

    /// Writes the effective configuration into `overrides.output_dir` and returns its path.
    pub fn write_effective(
        &self,
        schema: &OptionSchema,
        overrides: &Overrides,
    ) -> Result<PathBuf, ConfigError> {
        // SUMO counts relative paths from the configuration's own folder, not from ours.
        let dir =
            &std::path::absolute(&overrides.output_dir).unwrap_or_else(|_| overrides.output_dir.clone());
        std::fs::create_dir_all(dir).map_err(|source| ConfigError::Write { path: dir.clone(), source })?;
        let mut options = self.options.clone();
        for dropped in DROPPED {
            options.remove(*dropped);
        }
        if overrides.drop_demand {
            options.remove("route-files");
        }
        let mut redirection = Redirection::into(dir);
        let folder = self.path.parent().map(Path::to_path_buf).unwrap_or_default();
        for (option, value) in options.iter_mut() {
            // SUMO calls some of them plain text.
            if is_output(option) && schema.is_file(option) || OUTPUT_PARAMETERS.contains(&option.as_str()) {
                *value = redirection.output(&folder, value)?;
            } else if option == "save-state.suffix" {
                *value = value.replace('/', "_");
            }
        }
        // Nets may hold what additional files hold.
        for option in ["net-file", "additional-files"] {
            if let Some(value) = options.get_mut(option) {
                let kept: Result<Vec<_>, _> =
                    self.files(option).iter().map(|file| redirection.copy(file)).collect();
                *value = list(&kept?)?;
            }
        }
        if let Some(value) = options.get_mut("route-files") {
            let mut kept = Vec::new();
            for file in self.route_files() {
                let mut file = redirection.copy(&file)?;
                if let Some(dropped) = overrides.drop_type {
                    file = without_type(&file, dropped, dir)?;
                }
                kept.push(file);
            }
            *value = list(&kept)?;
        }
        for (option, value) in &overrides.default {
            options.entry(option.clone()).or_insert_with(|| value.clone());
        }
        for (option, value) in &overrides.set {
            options.insert(option.clone(), value.clone());
        }
        let mut text = String::from("<sumoConfiguration>\n");
        for (option, value) in &options {
            let value = quick_xml::escape::escape(value.as_str());
            text.push_str(&format!("    <{option} value=\"{value}\"/>\n"));
        }
        text.push_str("</sumoConfiguration>\n");
        let path = dir.join("sumo.sumocfg");
        std::fs::write(&path, text).map_err(|source| ConfigError::Write { path: path.clone(), source })?;
        Ok(path)
    }
}

/// SUMO separates the files of a list by commas and replaces `%20` and the like; line breaks do not survive in XML.
fn usable(path: &Path) -> Result<(), ConfigError> {
    let text = path.to_string_lossy();
    let is_code = |part: &str| part.len() >= 2 && part.bytes().take(2).all(|b| b.is_ascii_hexdigit());
    let found = if text.contains(',') {
        "a comma"
    } else if text.contains(['\n', '\r']) {
        "a line break"
    } else if text.split('%').skip(1).any(is_code) {
        "a % before two digits"
    } else {
        return Ok(());
    };
    Err(ConfigError::Path { path: path.to_path_buf(), found })
}

/// The value of an option that takes several files.
fn list(files: &[PathBuf]) -> Result<String, ConfigError> {
    files.iter().try_for_each(|file| usable(file))?;
    let names: Vec<_> = files.iter().map(|file| file.to_string_lossy()).collect();
    Ok(names.join(","))
}

/// Options that a run decides itself or that would act on the user's files.
const DROPPED: &[&str] = &[
    "configuration-file",
    "save-configuration",
    "save-template",
    "save-schema",
    "remote-port",
    "num-clients",
    "random",
    "output-prefix",
    "output-suffix",
    "start",
    "quit-on-end",
    "demo",
    "game",
    "game.mode",
    "breakpoints",
];

fn is_output(option: &str) -> bool {
    option.ends_with("-output")
        || option.ends_with(".output")
        || matches!(
            option,
            "netstate-dump"
                | "log"
                | "message-log"
                | "error-log"
                | "save-state.prefix"
                | "save-state.files"
                | "pedestrian.jupedsim.wkt"
                | "pedestrian.jupedsim.py"
        )
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEMPLATE: &str = r#"greeting <?xml version="1.0"?><c><input>
        <net-file value="" synonymes="n net" type="FILE"/>
        <route-files value="" synonymes="r routes" type="FILE"/>
        <additional-files value="" synonymes="a additional" type="FILE"/>
        <tripinfo-output value="" synonymes="tripinfo" type="FILE"/>
        <begin value="0" synonymes="b" type="TIME"/><end value="-1" type="TIME"/>
        <seed value="23423" type="INT"/></input></c>"#;

    fn write(dir: &Path, name: &str, text: &str) -> PathBuf {
        let path = dir.join(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    #[test]
    fn outputs_go_to_the_run_folder_and_inputs_stay() {
        let dir = tempfile::tempdir().unwrap();
        let schema = OptionSchema::parse(TEMPLATE).unwrap();
        write(dir.path(), "n.net.xml", "<net/>");
        write(
            dir.path(),
            "d.add.xml",
            r#"<additional><e1Detector id="d" lane="a_0" file="out/d.xml"/><variableSpeedSign id="v" file="vss.xml"/></additional>"#,
        );
        let config = write(
            dir.path(),
            "x.sumocfg",
            r#"<configuration><input><net value="n.net.xml"/><a value="d.add.xml"/><tripinfo value="t.xml"/></input>
               <b value="15:0:0"/><end value="-1"/><osg-view value="true"/></configuration>"#,
        );
        let config = SumoConfig::load(&config, &schema).unwrap();
        assert_eq!(config.ignored, ["osg-view"]);
        assert_eq!(config.time("begin").unwrap(), Some(54000.0));
        assert_eq!(config.time("end").unwrap(), None);
        let run = dir.path().join("run");
        let overrides = Overrides {
            output_dir: run.clone(),
            set: vec![("seed".into(), "7".into())],
            ..Overrides::default()
        };
        let effective =
            std::fs::read_to_string(config.write_effective(&schema, &overrides).unwrap()).unwrap();
        let inside = |name: &str| run.join(name).to_string_lossy().to_string();
        assert!(effective.contains(&inside("t.xml")), "{effective}");
        assert!(effective.contains(&inside("redirected-d.add.xml")), "{effective}");
        assert!(effective.contains(&dir.path().join("n.net.xml").to_string_lossy().to_string()));
        assert!(effective.contains(r#"<seed value="7"/>"#));
        let additional = std::fs::read_to_string(run.join("redirected-d.add.xml")).unwrap();
        assert!(additional.contains(&inside("d.xml")), "{additional}");
        assert!(
            additional.contains(&dir.path().join("vss.xml").to_string_lossy().to_string()),
            "{additional}"
        );
    }

    #[test]
    fn a_copy_of_a_gzipped_file_in_latin_1_is_utf_8() {
        use std::io::Write;
        let dir = tempfile::tempdir().unwrap();
        let text = "<?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>\
                    <additional><e1Detector id=\"\u{fc}\" lane=\"a_0\" file=\"d.xml\"/></additional>";
        let bytes: Vec<u8> = text.chars().map(|c| u8::try_from(c).unwrap()).collect();
        let path = dir.path().join("d.add.xml.gz");
        let mut file =
            flate2::write::GzEncoder::new(std::fs::File::create(&path).unwrap(), Default::default());
        file.write_all(&bytes).unwrap();
        file.finish().unwrap();
        let copy = Redirection::into(dir.path()).copy(&path).unwrap();
        assert!(copy.ends_with("redirected-d.add.xml"), "{}", copy.display());
        let copy = std::fs::read_to_string(copy).unwrap();
        assert!(copy.contains("encoding=\"UTF-8\"") && copy.contains("id=\"\u{fc}\""), "{copy}");
    }

    #[test]
    fn a_config_that_is_not_xml_or_names_a_missing_net_says_so() {
        let dir = tempfile::tempdir().unwrap();
        let schema = OptionSchema::parse(TEMPLATE).unwrap();
        for (text, expected) in [
            ("hello", "not a SUMO configuration"),
            ("<configuration><net-file value=", "not a SUMO configuration"),
            ("<configuration/>", "names no net-file"),
            (r#"<configuration><n value="gone.net.xml"/></configuration>"#, "gone.net.xml"),
        ] {
            let path = write(dir.path(), "x.sumocfg", text);
            let error = SumoConfig::load(&path, &schema).unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }

    #[test]
    fn a_file_that_is_cut_off_is_not_a_configuration() {
        let dir = tempfile::tempdir().unwrap();
        let schema = OptionSchema::parse(TEMPLATE).unwrap();
        write(dir.path(), "a.net.xml", "<net/>");
        let whole = "<sumoConfiguration><input><net-file value=\"a.net.xml\"/></input></sumoConfiguration>";
        let path = write(dir.path(), "a.sumocfg", whole);
        SumoConfig::load(&path, &schema).unwrap();
        write(dir.path(), "a.sumocfg", whole.strip_suffix("</input></sumoConfiguration>").unwrap());
        let error = SumoConfig::load(&path, &schema).unwrap_err().to_string();
        assert!(error.contains("cut off"), "{error}");
    }

    #[test]
    fn a_vehicles_device_writes_into_the_run_folder() {
        let dir = tempfile::tempdir().unwrap();
        let schema = OptionSchema::parse(TEMPLATE).unwrap();
        write(dir.path(), "a.net.xml", "<net/>");
        let ssm = "<param key=\"device.ssm.file\" value=\"/elsewhere/ssm.xml\"/>";
        write(dir.path(), "a.rou.xml", &format!("<routes><vType id=\"t\">{ssm}</vType></routes>"));
        let text = "<c><net-file value=\"a.net.xml\"/><route-files value=\"a.rou.xml\"/></c>";
        let config = SumoConfig::load(&write(dir.path(), "a.sumocfg", text), &schema).unwrap();
        let out = dir.path().join("out");
        let overrides = Overrides { output_dir: out.clone(), ..Overrides::default() };
        let effective =
            std::fs::read_to_string(config.write_effective(&schema, &overrides).unwrap()).unwrap();
        let routes = out.join("redirected-a.rou.xml");
        assert!(effective.contains(&routes.display().to_string()), "{effective}");
        let routes = std::fs::read_to_string(routes).unwrap();
        assert!(routes.contains(&out.join("ssm.xml").display().to_string()), "{routes}");
        assert!(!routes.contains("elsewhere"), "{routes}");
        // Its copy would be in a list of files there.
        let overrides = Overrides { output_dir: dir.path().join("a,b"), ..Overrides::default() };
        let error = config.write_effective(&schema, &overrides).unwrap_err().to_string();
        assert!(error.contains("a comma"), "{error}");
    }

    #[test]
    fn nothing_that_sumo_writes_leaves_the_run_folder() {
        let dir = tempfile::tempdir().unwrap();
        let schema = OptionSchema::parse(TEMPLATE).unwrap();
        let detector = |id: &str| {
            format!(
                "<e1Detector id=\"{id}\" lane=\"a_0\" pos=\"1\" period=\"9\" file=\"/elsewhere/{id}/d.xml\"/>"
            )
        };
        write(dir.path(), "a.net.xml", &format!("<net>{}</net>", detector("net")));
        std::fs::create_dir(dir.path().join("in")).unwrap();
        write(dir.path(), "in/i.add.xml", &format!("<additional>{}</additional>", detector("included")));
        write(dir.path(), "in/a.add.xml", &format!("<additional>{}</additional>", detector("second")));
        write(dir.path(), "a.add.xml", "<additional><include href=\"in/i.add.xml\"/></additional>");
        let text = "<c><net-file value=\"a.net.xml\"/><additional-files value=\"a.add.xml,in/a.add.xml\"/>\
                    <tripinfo-output value=\"localhost:4444\"/></c>";
        let config = SumoConfig::load(&write(dir.path(), "a.sumocfg", text), &schema).unwrap();
        let out = dir.path().join("out");
        let overrides = Overrides { output_dir: out.clone(), ..Overrides::default() };
        let effective = config.write_effective(&schema, &overrides).unwrap();
        // Three files of one name stay three, and so do their detectors.
        let mut all = std::fs::read_to_string(effective).unwrap();
        assert!(all.contains(&out.join("localhost_4444").display().to_string()), "{all}");
        for name in ["a.net.xml", "a.add.xml", "i.add.xml", "2-a.add.xml"] {
            let copy = out.join(format!("redirected-{name}"));
            all += &std::fs::read_to_string(&copy).unwrap_or_else(|e| panic!("{}: {e}", copy.display()));
        }
        assert!(!all.contains("elsewhere"), "{all}");
        for name in ["d.xml", "2-d.xml", "3-d.xml"] {
            assert_eq!(all.matches(&format!("\"{}\"", out.join(name).display())).count(), 1, "{name}: {all}");
        }
        // SUMO would take what follows the colon for a port.
        let overrides = Overrides { output_dir: dir.path().join("a:b"), ..Overrides::default() };
        let error = config.write_effective(&schema, &overrides).unwrap_err().to_string();
        assert!(error.contains("a colon"), "{error}");
        // What only SUMO would see is not let through to it.
        for hidden in [
            format!("<!DOCTYPE a [<!ENTITY d '{}'>]><additional>&d;</additional>", detector("entity")),
            detector("wide").chars().flat_map(|c| [c, '\0']).collect(),
            "<additional><include href=\"a.add.xml\"/></additional>".to_string(),
        ] {
            write(dir.path(), "a.add.xml", &hidden);
            let overrides = Overrides { output_dir: out.clone(), ..Overrides::default() };
            let error = config.write_effective(&schema, &overrides).unwrap_err();
            assert!(matches!(error, ConfigError::NotXml { .. }), "{error}");
        }
    }

    #[test]
    fn a_path_that_sumo_takes_apart_is_refused_with_the_reason() {
        let dir = tempfile::tempdir().unwrap();
        let schema = OptionSchema::parse(TEMPLATE).unwrap();
        for (name, found) in [("a,b", "a comma"), ("a%20b", "a % before"), ("a\nb", "a line break")] {
            let folder = dir.path().join(name);
            std::fs::create_dir(&folder).unwrap();
            let error = SumoConfig::load(&write(&folder, "a.net.xml", "<net/>"), &schema).unwrap_err();
            assert!(error.to_string().contains(found), "{error}");
        }
        let folder = dir.path().join("100% a");
        std::fs::create_dir(&folder).unwrap();
        SumoConfig::load(&write(&folder, "a.net.xml", "<net/>"), &schema).unwrap();
    }
}

//! One self-contained HTML page.

use super::svg::escape;
use super::{Report, Section, Table, Thumbnail, figures, overview, tables};
use std::path::Path;

/// The contents of a page.
pub struct Page<'a> {
    /// The report.
    pub report: &'a Report,
    /// The program's version.
    pub build: &'a str,
    /// Pictures by section.
    pub pictures: &'a [Vec<Thumbnail>],
    /// The page's own folder, to which links are relative.
    pub folder: &'a Path,
}

const STYLE: &str = "
body{font:15px/1.5 system-ui,sans-serif;color:#1c2126;max-width:1180px;margin:0 auto;padding:24px}
h1{font-size:26px;margin:0 0 4px}h2{font-size:21px;margin:40px 0 8px;border-bottom:2px solid #dfe3e6;padding-bottom:4px}
h3{font-size:16px;margin:26px 0 8px}p{margin:6px 0}.small,.note{color:#56606a;font-size:13px}
.scroll{overflow-x:auto}table{border-collapse:collapse;font-size:13.5px}
th,td{padding:4px 10px;border-bottom:1px solid #e6e9ec;text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums}
th{background:#f4f6f7;font-weight:600;white-space:normal;vertical-align:bottom}td.t,th.t{text-align:left}
.published table{color:#56606a}.published h3::after{content:'published';font-size:11px;background:#eee6d4;color:#6a5518;border-radius:9px;padding:1px 8px;margin-left:10px;vertical-align:middle}
.row{display:flex;flex-wrap:wrap;gap:18px;align-items:flex-start}
.shots{display:grid;grid-template-columns:repeat(auto-fill,minmax(340px,1fr));gap:16px}
.shots figure{margin:0;border:1px solid #dfe3e6;border-radius:6px;overflow:hidden}.shots img{width:100%;display:block}
.shots figcaption{padding:8px 10px;font-size:13px;overflow-wrap:anywhere}code{background:#f1f3f5;padding:1px 4px;border-radius:3px;font-size:12px}
.key{margin-right:14px;font-size:13px}.key i{display:inline-block;width:11px;height:11px;border-radius:6px;margin-right:5px}
svg{max-width:100%;height:auto}a{color:#0b66b0}
";

/// The page.
pub fn page(page: &Page<'_>) -> String {
    let titles: Vec<&str> = page.report.sections.iter().map(|s| s.suite.title.as_str()).collect();
    let mut html = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>wad-cosim: {}</title>\n\
         <meta name=\"viewport\" content=\"width=device-width\"><style>{STYLE}</style></head><body>\n\
         <h1>Evaluation</h1>\n<p class=\"small\">Made by wad-cosim {}. Rates carry Wilson's 95 % intervals.</p>\n",
        escape(&titles.join(", ")),
        escape(page.build)
    );
    html += &overview(page.report).as_ref().map_or_else(String::new, table_html);
    for (index, section) in page.report.sections.iter().enumerate() {
        let pictures = page.pictures.get(index).map_or(&[][..], Vec::as_slice);
        html += &section_html(section, pictures, page.folder);
    }
    html + "</body></html>\n"
}

fn section_html(section: &Section, pictures: &[Thumbnail], folder: &Path) -> String {
    let mut html = format!("<h2>{}</h2>\n", escape(&section.suite.title));
    html += &provenance(section);
    let all = tables(section);
    let (published, own): (Vec<&Table>, Vec<&Table>) = all.iter().partition(|table| table.published);
    // Results first, with the published numbers beside them, then details.
    for (n, table) in own.iter().enumerate() {
        html += &table_html(table);
        if n == 0 {
            published.iter().for_each(|table| html += &table_html(table));
            html += &format!(
                "<h3>How episodes ended</h3>\n<div class=\"scroll\">{}</div>\n",
                figures::ends(section)
            );
        }
    }
    let [speeds, gaps] = figures::distributions(section);
    html += &format!("<h3>Speeds and gaps</h3>\n<div class=\"row\">{speeds}{gaps}</div>\n");
    html += &format!("<h3>Where episodes ended</h3>\n<p>{}</p>\n<div class=\"row\">", figures::legend());
    for (town, map) in figures::maps(section) {
        let map = map.unwrap_or_else(|| "<p class=\"note\">This net is not there any more.</p>".to_string());
        html += &format!("<div><p>{}</p>{map}</div>", escape(&town));
    }
    html += "</div>\n";
    if !pictures.is_empty() {
        html +=
            &format!("<h3>Failures: the last picture of {}</h3>\n<div class=\"shots\">\n", pictures.len());
        for shot in pictures {
            let link = relative(&shot.folder, folder);
            html += &format!(
                "<figure><img src=\"{}\" alt=\"{}\"><figcaption><b>{}</b><br>{}<br><a href=\"{}/\">recording</a> \
                 <code>wad-cosim replay {} --record film.mp4</code></figcaption></figure>\n",
                shot.image,
                escape(&shot.title),
                escape(&shot.title),
                escape(&shot.cause),
                escape(&link),
                escape(&shot.folder.display().to_string())
            );
        }
        html += "</div>\n";
    }
    html
}

/// The runs that the numbers come from.
fn provenance(section: &Section) -> String {
    let mut html = String::new();
    if !section.suite.source.is_empty() {
        html += &format!("<p class=\"small\">After {}.</p>\n", escape(&section.suite.source));
    }
    for (path, manifest) in &section.runs {
        let agents: Vec<String> = manifest.agents.iter().map(|(name, id)| format!("{name}: {id}")).collect();
        let here = section.episodes.iter().filter(|e| e.run == *path).count();
        html += &format!(
            "<p class=\"small\">{here} episodes from <code>{}</code>, driven by wad-cosim {} with SUMO {}, detector {}, {} ms a tick{}{}</p>\n",
            escape(&path.display().to_string()),
            escape(&manifest.build),
            escape(&manifest.sumo),
            escape(&manifest.options.sight_name()),
            manifest.options.tick_ms,
            if agents.is_empty() { "" } else { "; " },
            escape(&agents.join("; "))
        );
    }
    html
}

fn table_html(table: &Table) -> String {
    let class = if table.published { " class=\"published\"" } else { "" };
    let mut html =
        format!("<div{class}><h3>{}</h3>\n<div class=\"scroll\"><table>\n<thead>", escape(&table.title));
    if !table.groups.is_empty() {
        html += "<tr>";
        for (name, n) in &table.groups {
            html += &format!("<th colspan=\"{n}\" style=\"text-align:center\">{}</th>", escape(name));
        }
        html += "</tr>";
    }
    let cells = |cells: &[String], tag: &str| -> String {
        let cell = |(column, cell): (usize, &String)| {
            let class = if words(table, column) { " class=\"t\"" } else { "" };
            format!("<{tag}{class}>{}</{tag}>", escape(cell))
        };
        cells.iter().enumerate().map(cell).collect()
    };
    html += &format!("<tr>{}</tr></thead>\n<tbody>\n", cells(&table.head, "th"));
    for row in &table.rows {
        html += &format!("<tr>{}</tr>\n", cells(row, "td"));
    }
    html += "</tbody></table></div>\n";
    for note in &table.notes {
        html += &format!("<p class=\"note\">{}</p>\n", escape(note));
    }
    html + "</div>\n"
}

/// Whether a column holds words, not numbers.
fn words(table: &Table, column: usize) -> bool {
    let word = |row: &Vec<String>| row.get(column).is_some_and(|c| c.starts_with(char::is_alphabetic));
    table.rows.iter().any(word)
}

/// `to` relative to the folder `from`; unchanged if there is no relative path.
fn relative(to: &Path, from: &Path) -> String {
    let (Ok(to_full), Ok(from)) = (std::fs::canonicalize(to), std::fs::canonicalize(from)) else {
        return to.display().to_string();
    };
    let shared = to_full.components().zip(from.components()).take_while(|(a, b)| a == b).count();
    let up = std::iter::repeat_n("..".to_string(), from.components().count() - shared);
    let down = to_full.components().skip(shared).map(|c| c.as_os_str().to_string_lossy().into_owned());
    up.chain(down).collect::<Vec<_>>().join("/")
}

//! Published numbers of the paper and its baselines, as printed.

use super::table::Table;
use serde::Deserialize;

/// Of all suites.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Published {
    /// A note for all of them.
    pub note: String,
    pub tables: Vec<PublishedTable>,
}

/// Of one suite.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedTable {
    pub suite: String,
    pub title: String,
    /// Agents.
    pub columns: Vec<String>,
    pub rows: Vec<PublishedRow>,
    #[serde(default)]
    pub figures: Vec<Figure>,
    #[serde(default)]
    pub remark: Option<String>,
}

/// Success rates of a task, 0..1; None where the paper gives none.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedRow {
    pub task: String,
    pub training: Vec<Option<f64>>,
    pub new: Vec<Option<f64>>,
    /// As printed, training then new, if it is not a rate.
    #[serde(default)]
    pub text: Vec<String>,
    /// The number in the paper's text, if it differs from the table.
    #[serde(default)]
    pub text_new: std::collections::BTreeMap<String, f64>,
}

/// Something else than a success rate, by column.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Figure {
    pub name: String,
    pub values: Vec<f64>,
}

/// The published numbers; None never happens with the file that is compiled in (a test reads it).
pub fn published() -> Option<Published> {
    serde_json::from_str(include_str!("published.json")).ok()
}

impl PublishedTable {
    /// As a table of its own.
    pub fn table(&self, note: &str) -> Table {
        let mut head = vec![if self.figures.is_empty() { "task" } else { "" }.to_string()];
        let mut groups = vec![(String::new(), 1)];
        let notes = self.remark.iter().cloned().chain([note.to_string()]).collect();
        let title = format!("{} (measured in another simulator)", self.title);
        if !self.figures.is_empty() {
            head.extend(self.columns.iter().cloned());
            let row = |f: &Figure| {
                std::iter::once(f.name.clone()).chain(f.values.iter().map(|v| format!("{v:.2}"))).collect()
            };
            let rows = self.figures.iter().map(row).collect();
            return Table { title, groups: Vec::new(), head, rows, notes, published: true };
        }
        for condition in ["training", "new"] {
            groups.push((condition.to_string(), self.columns.len()));
            head.extend(self.columns.iter().cloned());
        }
        let row = |row: &PublishedRow| {
            let rate = |v: &Option<f64>| v.map_or("-".to_string(), |v| format!("{:.0} %", 100.0 * v));
            let mut cells = vec![row.task.clone()];
            if row.text.is_empty() {
                cells.extend(row.training.iter().map(rate));
                cells.extend(self.columns.iter().zip(&row.new).map(|(column, v)| {
                    let text = row.text_new.get(column);
                    rate(v) + &text.map_or(String::new(), |t| format!(" (text: {:.0} %)", 100.0 * t))
                }));
            } else {
                cells.extend(row.text.iter().cloned());
            }
            cells
        };
        Table { title, groups, head, rows: self.rows.iter().map(row).collect(), notes, published: true }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_has_its_column() {
        let published = published().unwrap();
        assert_eq!(published.tables.len(), 5);
        for table in &published.tables {
            for row in &table.rows {
                assert_eq!((row.training.len(), row.new.len()), (table.columns.len(), table.columns.len()));
            }
            let shown = table.table(&published.note);
            assert!(shown.rows.iter().all(|row| row.len() == shown.head.len()), "{}", table.suite);
            assert!(shown.title.contains("another simulator"));
        }
        let nocrash = published.tables.iter().find(|t| t.suite == "nocrash").unwrap();
        let dense = &nocrash.table("").rows[2];
        assert_eq!(dense.last().map(String::as_str), Some("100 % (text: 82 %)"));
    }
}

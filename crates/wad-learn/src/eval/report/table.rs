//! Tables as Markdown, LaTeX and CSV.

/// A table: rows of text below a head.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// The title.
    pub title: String,
    /// Above the head: groups of columns, with the number of columns in each.
    pub groups: Vec<(String, usize)>,
    /// The columns' names.
    pub head: Vec<String>,
    /// The rows, each as long as the head.
    pub rows: Vec<Vec<String>>,
    /// Notes below the table.
    pub notes: Vec<String>,
    /// Published numbers, not measured by this program.
    pub published: bool,
}

/// As Markdown. Groups become part of the head.
pub fn markdown(tables: &[Table]) -> String {
    let cell = |text: &str| text.replace('|', "\\|");
    let mut out = String::new();
    for table in tables {
        out += &format!("### {}\n\n", table.title);
        let head: Vec<String> = flat_head(table).iter().map(|h| cell(h)).collect();
        let rule: Vec<&str> =
            head.iter().enumerate().map(|(i, _)| if i == 0 { "---" } else { "---:" }).collect();
        out += &format!("| {} |\n|{}|\n", head.join(" | "), rule.join("|"));
        for row in &table.rows {
            out += &format!("| {} |\n", row.iter().map(|c| cell(c)).collect::<Vec<_>>().join(" | "));
        }
        out.push('\n');
        for note in &table.notes {
            out += &format!("{note}\n\n");
        }
    }
    out
}

/// As LaTeX: tables to be included, with `booktabs`.
pub fn latex(tables: &[Table]) -> String {
    let mut out = String::from("% Made by `wad-cosim report`. Needs \\usepackage{booktabs}.\n");
    for table in tables {
        let line =
            |cells: &[String]| cells.iter().map(|c| tex(c)).collect::<Vec<_>>().join(" & ") + " \\\\\n";
        out += &format!(
            "\n\\begin{{table}}\n\\centering\n\\caption{{{}}}\n\\begin{{tabular}}{{l{}}}\n\\toprule\n",
            tex(&table.title),
            "r".repeat(table.head.len().saturating_sub(1))
        );
        if !table.groups.is_empty() {
            let groups = table.groups.iter().map(|(name, n)| {
                if *n == 1 { tex(name) } else { format!("\\multicolumn{{{n}}}{{c}}{{{}}}", tex(name)) }
            });
            out += &(groups.collect::<Vec<_>>().join(" & ") + " \\\\\n");
        }
        out += &line(&table.head);
        out += "\\midrule\n";
        table.rows.iter().for_each(|row| out += &line(row));
        out += "\\bottomrule\n\\end{tabular}\n";
        table.notes.iter().for_each(|note| out += &format!("\\par\\footnotesize {}\n", tex(note)));
        out += "\\end{table}\n";
    }
    out
}

/// As CSV: each table with its title in the first column of each row.
pub fn csv(tables: &[Table]) -> String {
    let field = |text: &str| {
        if text.contains(['"', ',', '\n']) {
            format!("\"{}\"", text.replace('"', "\"\""))
        } else {
            text.to_string()
        }
    };
    let mut out = String::new();
    for table in tables {
        let head = flat_head(table);
        for row in std::iter::once(&head).chain(&table.rows) {
            let cells = std::iter::once(&table.title).chain(row).map(|c| field(c));
            out += &(cells.collect::<Vec<_>>().join(",") + "\n");
        }
    }
    out
}

/// The head with the groups in front of the columns' names.
fn flat_head(table: &Table) -> Vec<String> {
    let groups = table.groups.iter().flat_map(|(name, n)| std::iter::repeat_n(name.as_str(), *n));
    let mut head = table.head.clone();
    for (column, group) in head.iter_mut().zip(groups) {
        if !group.is_empty() {
            *column = format!("{group}: {column}");
        }
    }
    head
}

fn tex(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '%' | '&' | '_' | '#' | '$' | '{' | '}' => {
                out.push('\\');
                out.push(c);
            }
            '±' => out += "$\\pm$",
            '–' => out += "--",
            '“' => out += "``",
            '”' => out += "''",
            '†' => out += "$\\dagger$",
            '\\' => out += "\\textbackslash{}",
            '~' | '^' => out += &format!("\\{c}{{}}"),
            c => out.push(c),
        }
    }
    out
}

/// The head of a table whose lines are [`Section::lines`](super::Section).
pub(super) fn columns(more: &[&str]) -> Vec<String> {
    ["agent", "condition", "task"].iter().chain(more).map(ToString::to_string).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        Table {
            title: "Success, 95 % intervals".into(),
            groups: vec![(String::new(), 1), ("new".into(), 2)],
            head: vec!["task".into(), "wad_t".into(), "a|b".into()],
            rows: vec![vec!["dense".into(), "82.0 ± 1 %".into(), "1, \"2\"".into()]],
            notes: vec!["of R&D".into()],
            published: false,
        }
    }

    #[test]
    fn every_form_holds_every_cell() {
        let text = markdown(&[table()]);
        assert!(
            text.contains("| task | new: wad_t | new: a\\|b |\n|---|---:|---:|\n| dense | 82.0 ± 1 % |"),
            "{text}"
        );
        let text = latex(&[table()]);
        assert!(text.contains("\\multicolumn{2}{c}{new}") && text.contains("82.0 $\\pm$ 1 \\%"), "{text}");
        assert!(text.contains("wad\\_t") && text.contains("R\\&D"), "{text}");
        let text = csv(&[table()]);
        assert_eq!(
            text.lines().nth(1),
            Some("\"Success, 95 % intervals\",dense,82.0 ± 1 %,\"1, \"\"2\"\"\"")
        );
    }
}

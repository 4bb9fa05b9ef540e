//! The documents: links lead somewhere, tables of figures have their markers.

#![allow(clippy::unwrap_used, reason = "these are tests")]

use std::path::{Path, PathBuf};

/// Every Markdown file of the repository.
fn documents() -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let folders =
        [".", "capture", "estimator", "fusion", "fuzz", "recordings/data", "docs", "docs/experiments", "tools/studio"];
    let entries = folders.iter().flat_map(|folder| std::fs::read_dir(root.join(folder)).unwrap());
    let files = entries.map(|e| e.unwrap().path());
    files.filter(|path| path.extension().is_some_and(|e| e == "md")).collect()
}

#[test]
fn links_lead_to_files() {
    for document in documents() {
        let text = std::fs::read_to_string(&document).unwrap();
        for link in text.split("](").skip(1) {
            let target = link.split([')', '#']).next().unwrap();
            if target.is_empty() || target.contains("://") {
                continue;
            }
            let path = document.with_file_name(target);
            assert!(path.exists(), "{}: {target} does not exist", document.display());
        }
    }
}

#[test]
fn tables_of_figures_are_written_by_commands() {
    for document in documents() {
        let text = std::fs::read_to_string(&document).unwrap();
        let mut open = false;
        for line in text.lines().filter(|line| line.starts_with("<!--")) {
            let begins = line.starts_with("<!-- figures:") || line.starts_with("<!-- text:");
            if begins {
                let command = line.trim_end_matches("-->").split(':').nth(1).unwrap().trim();
                assert!(command.contains(' '), "{}: {line} names no command", document.display());
            }
            let expected = if open { !begins } else { begins };
            assert!(expected, "{}: {line} is out of place", document.display());
            open = begins;
        }
        assert!(!open, "{}: a table has no end", document.display());
    }
}

//! Tests of `taxel bench-report` on the repository's forms.

use std::path::{Path, PathBuf};

use crate::common::{In, json};

/// Blank forms of the repository.
fn forms() -> Vec<PathBuf> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs");
    let files = std::fs::read_dir(docs).unwrap().map(|file| file.unwrap().path());
    let form = |path: &PathBuf| {
        let name = path.file_name().unwrap().to_str().unwrap();
        name.starts_with("bench-") && name.ends_with(".csv")
    };
    files.filter(form).collect()
}

#[test]
fn blank_forms_read_as_nothing_measured_yet() {
    assert_eq!(forms().len(), 2);
    for form in forms() {
        let folder = tempfile::tempdir().unwrap();
        let args = ["bench-report", form.to_str().unwrap(), "--out", "page.html"];
        let said = In(folder.path()).succeeds(&args);
        assert!(said.starts_with("Nothing measured yet: none of "), "{said}");
        assert!(said.ends_with("wrote page.html\n"), "{said}");
        let told = json(&In(folder.path()).succeeds(&[&args[..], &["--force", "--json"]].concat()));
        assert_eq!([&told["done"], &told["met"], &told["missed"]], [0, 0, 0]);
        assert_eq!(told["not_measured"], told["steps"].as_array().unwrap().len());
    }
}

#[test]
fn form_with_error_leaves_no_page() {
    let folder = tempfile::tempdir().unwrap();
    for form in forms() {
        let text = std::fs::read_to_string(form).unwrap().replacen(",mA,", ",mA,a lot", 1);
        std::fs::write(folder.path().join("form.csv"), text).unwrap();
        let said = In(folder.path()).fails(1, &["bench-report", "form.csv", "--out", "page.html"]);
        let expected = "taxel: form.csv:10: `measured`: expected a finite number, found `a lot`; \
                        write the number alone, in mA; words belong in `note`\n";
        assert_eq!(said, expected);
        assert!(!folder.path().join("page.html").exists());
    }
}

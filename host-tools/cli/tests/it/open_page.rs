//! Tests that the page opens by itself only on a display.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

/// Returns the address that the demo asks the desktop to open.
fn opened(folder: &Path, environment: &[(&str, &str)], headless: bool) -> Option<String> {
    let (opener, asked) = (folder.join("xdg-open"), folder.join("asked"));
    let script = format!("#!/bin/sh\necho \"$1\" > {0}.part && mv {0}.part {0}\n", asked.display());
    std::fs::write(&opener, script).unwrap();
    std::fs::set_permissions(&opener, PermissionsExt::from_mode(0o755)).unwrap();
    let path = format!("{}:{}", folder.display(), std::env::var("PATH").unwrap());
    let output = Command::new(env!("CARGO_BIN_EXE_taxel"))
        .args(["demo", "--scene", "press", "--duration", "2"])
        .args(headless.then_some("--headless"))
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        .env_remove("SSH_CONNECTION")
        .env("PATH", path)
        .envs(environment.iter().copied())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(headless || said.contains("watch it at http://"), "{said}");
    let asked = std::fs::read_to_string(&asked).ok()?;
    assert!(said.contains(asked.trim()), "{asked} is not the page of {said}");
    Some(asked)
}

/// Demos of two seconds each.
mod endurance {
    use super::*;

    #[test]
    fn demo_opens_page_only_on_local_display() {
        let folder = || tempfile::tempdir().unwrap();
        let display = ("DISPLAY", ":0");
        assert!(opened(folder().path(), &[display], false).is_some());
        assert!(opened(folder().path(), &[("WAYLAND_DISPLAY", "wayland-0")], false).is_some());
        assert_eq!(opened(folder().path(), &[display], true), None, "--headless");
        assert_eq!(opened(folder().path(), &[], false), None, "no display");
        let far = ("SSH_CONNECTION", "10.0.0.2 50000 10.0.0.1 22");
        assert_eq!(opened(folder().path(), &[display, far], false), None, "over SSH");
    }
}

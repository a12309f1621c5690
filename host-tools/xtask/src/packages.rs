//! Packages of Debian and its kin that a task cannot do without.

use std::process::Command;

use anyhow::{Result, bail};

use crate::run::{answer, exists, program, root, run};

/// Installs `packages` where that is this machine's way and this user may; else says what to do.
pub fn install(packages: &[&str], what_for: &str) -> Result<()> {
    let list = packages.join(" ");
    let is_root = answer(Command::new("id").arg("-u")).is_some_and(|user| user == "0");
    if !is_root || !exists("apt-get") {
        bail!(
            "{what_for} is missing; install it: `sudo apt-get install {list}`, or your system's own"
        );
    }
    eprintln!("installing {list}");
    let apt = |arguments: &[&str]| {
        run(program("apt-get", &root())
            .env("DEBIAN_FRONTEND", "noninteractive")
            .stdout(std::io::stderr())
            .args(["-qq", "-o", "Dpkg::Use-Pty=0"])
            .args(arguments))
    };
    apt(&["update"])?;
    apt(&[&["install", "--yes", "--no-install-recommends"], packages].concat())
}

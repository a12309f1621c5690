//! Running the command from a folder.
#![allow(dead_code, reason = "each test file uses its part")]

use std::path::Path;
use std::process::{Command, Stdio};

/// Exit code, standard output, standard error.
pub struct Ran {
    pub code: Option<i32>,
    pub out: String,
    pub err: String,
}

/// The folder that the command is run in.
pub struct In<'f>(pub &'f Path);

impl In<'_> {
    pub fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_taxel"));
        command.current_dir(self.0).args(args);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    pub fn taxel(&self, args: &[&str]) -> Ran {
        let output = self.command(args).output().unwrap();
        Ran {
            code: output.status.code(),
            out: String::from_utf8(output.stdout).unwrap(),
            err: String::from_utf8(output.stderr).unwrap(),
        }
    }

    /// One line on standard error, nothing on standard output.
    pub fn fails(&self, code: i32, args: &[&str]) -> String {
        let ran = self.taxel(args);
        assert_eq!(ran.code, Some(code), "{}{}", ran.out, ran.err);
        assert_eq!(ran.out, "");
        assert_eq!(ran.err.lines().count(), 1, "{}", ran.err);
        assert!(ran.err.ends_with('\n'));
        ran.err
    }

    pub fn succeeds(&self, args: &[&str]) -> String {
        let ran = self.taxel(args);
        assert_eq!(ran.code, Some(0), "{}", ran.err);
        ran.out
    }
}

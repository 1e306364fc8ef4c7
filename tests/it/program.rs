//! The program as a user starts it, and what it prints.

use serde_json::Value;
use std::process::{Command, Output, Stdio};

pub fn wad(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    command.args(args).stdin(Stdio::null());
    command
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

pub fn json(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout);
    let last = text.lines().last().unwrap_or_default();
    serde_json::from_str(last).unwrap_or_else(|e| panic!("{e}: {last:?}\n{}", stderr(output)))
}

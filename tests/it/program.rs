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

#[test]
fn shells_complete_the_commands_and_each_has_a_manual_page() {
    for (shell, check) in [("bash", Some("bash")), ("zsh", None), ("fish", None)] {
        let output = wad(&["completions", shell]).output().unwrap();
        let script = String::from_utf8(output.stdout).unwrap();
        assert!(
            output.status.success() && script.contains("nocrash") && script.contains("weather"),
            "{shell}"
        );
        if let Some(check) = check {
            let ask = "source /dev/stdin; COMP_WORDS=(wad-cosim ev); COMP_CWORD=1; _wad__cosim wad-cosim ev wad-cosim; echo $COMPREPLY";
            let mut bash = Command::new(check)
                .args(["-c", ask])
                .stdin(Stdio::piped())
                .stdout(Stdio::piped())
                .spawn()
                .unwrap();
            std::io::Write::write_all(&mut bash.stdin.take().unwrap(), script.as_bytes()).unwrap();
            let answer = bash.wait_with_output().unwrap();
            assert_eq!(String::from_utf8_lossy(&answer.stdout).trim(), "eval");
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("man1");
    let output = wad(&["man", "--out", out.to_str().unwrap()]).output().unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let page = std::fs::read_to_string(out.join("wad-cosim-eval-nocrash.1")).unwrap();
    assert!(page.contains("wad\\-cosim eval nocrash") && page.contains("episodes"), "{page}");
    assert!(out.join("wad-cosim.1").exists() && !out.join("wad-cosim-help.1").exists());
}

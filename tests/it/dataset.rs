//! `wad-cosim dataset` on a real SUMO.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};

fn wad(args: &[&str], folder: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    command.args(args).arg("--out").arg(folder).arg("--json").stdin(Stdio::null());
    command.output().expect("the binary runs")
}

fn collect(folder: &Path, args: &[&str]) -> Value {
    let output = wad(&[&["dataset", "collect"], args].concat(), folder);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_str(text.lines().last().unwrap_or_default()).expect("a JSON line")
}

fn shards(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut shards: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "wads"))
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(&path).unwrap()))
        .collect();
    shards.sort();
    shards
}

/// What a shard lost or torn costs is only itself, and collecting goes on with the very same bytes,
/// whatever the number of jobs.
#[test]
fn collecting_goes_on_where_it_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--town", "town5", "--frames", "24", "--per-shard", "8", "--seed", "3"];
    let first = folder.path().join("first");
    let result = collect(&first, &[&args[..], &["--jobs", "2"]].concat());
    assert_eq!((result["frames"].as_u64(), result["complete"].as_bool()), (Some(24), Some(true)));
    let whole = shards(&first);
    assert_eq!(whole.len(), 3);
    std::fs::remove_file(first.join("shard-00001.wads")).unwrap();
    std::fs::write(first.join("shard-00002.wads"), &whole[2].1[..500]).unwrap();
    let result = collect(&first, &args);
    assert_eq!(result["frames_before"].as_u64(), Some(8));
    assert!(shards(&first) == whole, "shards differ");
    // Another seed is another dataset.
    let output =
        wad(&["dataset", "collect", "--town", "town5", "--frames", "24", "--per-shard", "8"], &first);
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(error.contains("the seed") && error.contains('3'), "{error}");
}

#[test]
fn no_time_still_leaves_a_dataset_to_go_on_with() {
    let folder = tempfile::tempdir().unwrap();
    let args = ["--town", "town3", "--frames", "20", "--per-shard", "20"];
    let result = collect(folder.path(), &[&args[..], &["--max-minutes", "0"]].concat());
    assert_eq!((result["frames"].as_u64(), result["complete"].as_bool()), (Some(0), Some(false)));
    let mut info = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    let output = info.args(["dataset", "info"]).arg(folder.path()).output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(error.contains("holds no frames"), "{error}");
}

//! Pictures and films that cannot be made: known before anything is simulated, and said plainly.

use std::path::Path;
use std::process::{Command, Stdio};

/// What the program says on stderr of an input that it refuses.
fn refused(folder: &Path, args: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_wad-cosim"));
    let output =
        command.args(args).current_dir(folder).stdin(Stdio::null()).output().expect("the binary runs");
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{args:?}: {error}");
    error
}

#[test]
fn a_picture_that_cannot_be_is_refused_with_what_would_do() {
    let dir = tempfile::tempdir().expect("a folder");
    std::fs::write(dir.path().join("file"), "").expect("a file");
    for (args, words) in [
        (&["--weather", "ClearNon"][..], &["ClearNon", "ClearNoon"][..]),
        (&["--size", "0x512"], &["0x512", "8192"]),
        (&["--size", "90000x90000"], &["90000x90000", "8192"]),
        (&["--size", "512"], &["WIDTHxHEIGHT"]),
        (&["--sheet", "--size", "4000x4000"], &["4000x4000", "1448x1448"]),
        (&["--time", "nan"], &["nan", "seconds"]),
        (&["--count", "0"], &["--count"]),
        (&["--out", "picture.bmp"], &["picture.bmp", ".png", ".jpg"]),
        (&["--out", "file/picture.png"], &["file/picture.png"]),
    ] {
        let error = refused(dir.path(), &[&["snapshot", "town5"], args].concat());
        assert!(words.iter().all(|word| error.contains(word)), "{args:?}: {error}");
    }
    assert_eq!(std::fs::read_dir(dir.path()).expect("the folder").count(), 1, "something was left there");
}

#[test]
fn a_film_that_cannot_be_is_refused_with_what_would_do() {
    let dir = tempfile::tempdir().expect("a folder");
    std::fs::write(dir.path().join("file"), "").expect("a file");
    for (args, words) in [
        (&["--record", "film.avi"][..], &["film.avi", ".mp4"][..]),
        (&["--record", "file/film.mp4"], &["cannot write", "file"]),
        (&["--record", "file/film.png"], &["cannot write", "film-000000.png"]),
        (&["--record", "film.mp4", "--record-codec", "zzzz"], &["zzzz", "mp4v", "apt-get", "film/"]),
        (&["--record", "film.mp4", "--record-codec", "abc"], &["abc", "h264"]),
        (&["--record", "film.mp4", "--record-view", "side"], &["side", "chase"]),
        (&["--record", "film.mp4", "--weather", "MidRainNoon"], &["MidRainyNoon"]),
        (&["--record-view", "bird"], &["--record"]),
    ] {
        let run = ["run", "town5", "--ticks", "1", "--traffic", "empty"];
        let error = refused(dir.path(), &[&run[..], args].concat());
        assert!(words.iter().all(|word| error.contains(word)), "{args:?}: {error}");
    }
    assert!(!dir.path().join("film.mp4").exists(), "an empty film was left there");
}

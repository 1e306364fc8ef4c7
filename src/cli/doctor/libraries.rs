//! The libraries, each tried.

use super::Finding;
use wad_cosim::inference;

#[cfg(not(all(feature = "learn", feature = "vision")))]
fn not_built_in(name: &'static str, feature: &str) -> Finding {
    Finding::optional(name, "not built in").advice(format!("build with the cargo feature `{feature}`"))
}

#[cfg(not(feature = "learn"))]
pub fn libtorch() -> Finding {
    not_built_in("libtorch", "learn")
}

#[cfg(not(feature = "vision"))]
pub fn opencv() -> Finding {
    not_built_in("OpenCV", "vision")
}

/// One gradient through libtorch's autograd, checked.
#[cfg(feature = "learn")]
pub fn libtorch() -> Finding {
    let place = loaded_from("libtorch_cpu.so");
    let version = place
        .as_deref()
        .and_then(|lib| std::fs::read_to_string(lib.parent()?.parent()?.join("build-version")).ok())
        .map_or_else(|| "of unknown version".to_owned(), |version| version.trim().to_owned());
    let place = place.map_or_else(|| "an unknown place".to_owned(), |lib| lib.display().to_string());
    match gradient_of_square(3.0) {
        Ok(6.0) => Finding::ok("libtorch", format!("{version}, works, {place}")),
        Ok(gradient) => Finding::missing(
            "libtorch",
            format!("{version} is broken: d(x*x)/dx at 3 gave {gradient}, not 6"),
        )
        .advice(format!("remove {place} and run scripts/setup")),
        Err(error) => Finding::missing("libtorch", format!("{version} fails: {error}"))
            .advice(format!("remove {place} and run scripts/setup")),
    }
}

#[cfg(feature = "learn")]
fn gradient_of_square(x: f64) -> Result<f64, tch::TchError> {
    let x = tch::Tensor::f_from_slice(&[x])?.f_set_requires_grad(true)?;
    x.f_dot(&x)?.f_backward()?;
    x.f_grad()?.f_double_value(&[0])
}

/// OpenVINO, which runs the detectors `centernet` and `eyes`: started once.
pub fn openvino() -> Finding {
    match inference::available() {
        Ok(()) => {
            let place = loaded_from("libopenvino_c.so");
            let place = place.map_or_else(|| "an unknown place".to_owned(), |lib| lib.display().to_string());
            Finding::ok("OpenVINO", format!("works, {place}"))
        }
        Err(why) if cfg!(feature = "learn") => Finding::optional("OpenVINO", why.to_string()).advice(
            "the detectors `centernet` and `eyes` run on libtorch, at a third of their speed; if OpenVINO's \
             folder is damaged, remove it and run scripts/setup",
        ),
        Err(why) => Finding::missing("OpenVINO", why.to_string()).advice(
            "the detectors `centernet` and `eyes` need it, or a build with the cargo feature `learn`; if its \
             folder is damaged, remove it and run scripts/setup",
        ),
    }
}

/// The file that the dynamic linker mapped for a library, with or without a version in its name.
fn loaded_from(library: &str) -> Option<std::path::PathBuf> {
    let maps = std::fs::read_to_string("/proc/self/maps").ok()?;
    let path = maps.lines().find_map(|line| {
        let path = std::path::Path::new(&line[line.find('/')?..]);
        path.file_name()?.to_str()?.starts_with(library).then_some(path)
    })?;
    Some(path.into())
}

/// Canny on an image of one edge, checked.
#[cfg(feature = "vision")]
pub fn opencv() -> Finding {
    let version = opencv::core::get_version_string().unwrap_or_else(|_| "of unknown version".to_owned());
    match edge_column() {
        Ok(Some(15 | 16)) => Finding::ok("OpenCV", format!("{version}, works")),
        Ok(found) => Finding::missing(
            "OpenCV",
            format!("{version} is broken: Canny should find the edge at column 15 or 16 and found {found:?}"),
        )
        .advice("reinstall the OpenCV packages"),
        Err(error) => Finding::missing("OpenCV", format!("{version} fails: {error}"))
            .advice("reinstall the OpenCV packages"),
    }
}

/// The first column where Canny finds the edge of an image that is black left of column 16 and white
/// from there on.
#[cfg(feature = "vision")]
fn edge_column() -> opencv::Result<Option<usize>> {
    use opencv::{core, imgproc, prelude::*};
    let pixels: Vec<u8> = (0..32 * 32).map(|i| if i % 32 < 16 { 0 } else { 255 }).collect();
    let image = core::Mat::new_rows_cols_with_data(32, 32, &pixels)?;
    let mut edges = core::Mat::default();
    imgproc::canny(&image, &mut edges, 50.0, 150.0, 3, false)?;
    Ok(edges.at_row::<u8>(16)?.iter().position(|&pixel| pixel != 0))
}

//! SUMO and the programs that come with it.

use super::Finding;
use wad_cosim::traci::process::SumoInstall;

/// The SUMO that `run` would start.
pub fn sumo() -> Finding {
    let checked = SumoInstall::find().and_then(|install| {
        install.check_version()?;
        Ok((install.version()?, install))
    });
    match checked {
        Ok(((major, minor, patch), install)) => {
            Finding::ok("SUMO", format!("{major}.{minor}.{patch}, {}", install.home().display()))
        }
        // The error says what to do.
        Err(error) => Finding::missing("SUMO", error.to_string()),
    }
}

/// The programs that make nets and show them. Each is started once: one whose libraries are missing
/// exists and does not run.
pub fn tools() -> Finding {
    const TOOLS: [&str; 5] = ["sumo-gui", "netedit", "netconvert", "netgenerate", "duarouter"];
    let Ok(install) = SumoInstall::find() else {
        return Finding::optional("tools", "none: they come with SUMO");
    };
    let runs = |tool: &&str| {
        install.command(tool).arg("--version").output().is_ok_and(|output| output.status.success())
    };
    let (there, missing): (Vec<_>, Vec<_>) = TOOLS.into_iter().partition(runs);
    if missing.is_empty() {
        return Finding::ok("tools", there.join(", "));
    }
    let found = if there.is_empty() { "none run".to_owned() } else { format!("{} run", there.join(", ")) };
    Finding::optional("tools", format!("{found}; {} missing or broken", missing.join(", ")))
        .advice("`run` needs none of them; scripts/setup installs them all")
}

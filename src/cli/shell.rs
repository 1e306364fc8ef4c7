//! `wad-cosim completions` and `wad-cosim man`: the command line for shells and for `man`.

use super::{Exit, print};
use anyhow::Context;
use clap::Command;
use std::path::{Path, PathBuf};

/// Print a script that completes commands and options in a shell.
#[derive(clap::Args, Debug)]
#[command(after_help = "\
Examples:
  wad-cosim completions bash > ~/.local/share/bash-completion/completions/wad-cosim
  wad-cosim completions zsh > ~/.zfunc/_wad-cosim            (fpath+=~/.zfunc before compinit in ~/.zshrc)
  wad-cosim completions fish > ~/.config/fish/completions/wad-cosim.fish")]
pub struct Completions {
    /// The shell.
    #[arg(value_enum)]
    shell: clap_complete::Shell,
}

/// Write the manual pages, one for each command.
#[derive(clap::Args, Debug)]
#[command(after_help = "\
Examples:
  wad-cosim man --out ~/.local/share/man/man1 && man wad-cosim-eval-nocrash")]
pub struct Man {
    /// The folder; it is made if it is not there.
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

/// Runs `completions`.
pub fn completions(args: &Completions, program: &mut Command) -> anyhow::Result<Exit> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, program, "wad-cosim", &mut script);
    print(&String::from_utf8_lossy(&script))?;
    Ok(Exit::Done)
}

/// Runs `man`.
pub fn man(args: &Man, mut program: Command) -> anyhow::Result<Exit> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot make `{}`", args.out.display()))?;
    // Global options and long names reach the subcommands.
    program.build();
    let pages = pages(&program, "wad-cosim", &args.out)?;
    print(&format!("{pages} pages in {}\n", args.out.display()))?;
    Ok(Exit::Done)
}

/// Writes the page of `command`, whose whole name with hyphens is `name`, and those below it.
fn pages(command: &Command, name: &str, folder: &Path) -> anyhow::Result<usize> {
    let path = folder.join(format!("{name}.1"));
    let mut page = Vec::new();
    clap_mangen::Man::new(command.clone().display_name(name)).title(name).render(&mut page)?;
    std::fs::write(&path, page).with_context(|| format!("cannot write `{}`", path.display()))?;
    let mut written = 1;
    for below in command.get_subcommands().filter(|below| below.get_name() != "help") {
        written += pages(below, &format!("{name}-{}", below.get_name()), folder)?;
    }
    Ok(written)
}

//! `memtransfer view`: a run as pages in a browser.

use std::io::IsTerminal;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use anyhow::Result;
use clap::Args;
use run_log::tell_apart;
use viewer::{Address, Site, ViewServer, write_bundle};
use world_client::{RecordedRun, Selection};

use super::{Exit, WorldCommandArgs, print};
use crate::parent::ParentFlags;

#[derive(Debug, Args)]
#[command(after_help = "\
Shows every episode step by step: the view, the map, what memory supplied, the prompt where it was
logged, and why the episode failed. Opens a browser where there is one. Views are rendered from the
log's poses, so the run needs no images.

Examples:
  memtransfer view runs/quick-grounded                        serve it here, until Ctrl-C
  memtransfer view runs/quick-grounded --out pages            files that open without a server
  memtransfer view runs/a runs/b --out pages --episodes all   two runs side by side
  memtransfer view runs/quick-grounded --serve 0.0.0.0:8080   for other machines, with a token")]
pub(super) struct ViewArgs {
    /// The run's folder
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Another run, to compare with it
    #[arg(value_name = "RUN2")]
    other: Option<PathBuf>,
    /// Write the pages into DIR, to be opened from there
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// With --out: the number of episodes of a run with views and prompts, failures first, or `all`
    #[arg(long, value_name = "N|all", requires = "out", default_value = "100")]
    episodes: Selection,
    /// Serve the pages at ADDR [default without --out: a free port of this machine alone]
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "127.0.0.1:0", conflicts_with = "out")]
    serve: Option<Address>,
    /// Open no browser
    #[arg(long)]
    no_browser: bool,
    #[command(flatten)]
    parent: ParentFlags,
    #[command(flatten)]
    world: WorldCommandArgs,
}

pub(super) fn run(args: &ViewArgs) -> Result<Exit> {
    args.parent.watch()?;
    let runs = [Some(&args.run), args.other.as_ref()].into_iter().flatten();
    let program = args.world.program()?;
    let mut runs =
        runs.map(|dir| RecordedRun::read(dir, &program.access())).collect::<Result<Vec<_>>>()?;
    tell_apart(runs.iter_mut().map(|run| &mut run.log));
    let mut site = Site::new(runs, &program, args.out.is_none())?;
    if let Some(out) = &args.out {
        let bundle = write_bundle(&mut site, out, args.episodes)?;
        for path in &bundle.missing {
            say!("warning: missing, left out: {}", path.display());
        }
        say!(
            "{} episodes, {} of them with views: {} views, {:.1} MB in all",
            bundle.episodes,
            bundle.shown,
            bundle.views,
            bundle.bytes as f64 / 1e6
        );
        print(&bundle.page.display().to_string())?;
        args.open(&bundle.page.display().to_string());
        return Ok(Exit::Complete);
    }
    let server = ViewServer::listen(args.serve.unwrap_or_default())?;
    print(&server.url())?;
    say!("serving until Ctrl-C");
    args.open(&server.url());
    server.serve(site)?;
    Ok(Exit::Complete)
}

impl ViewArgs {
    /// Opens the page in the browser of a user at a terminal with a display.
    fn open(&self, page: &str) {
        let has_screen =
            ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some());
        if self.no_browser || !has_screen || !std::io::stdout().is_terminal() {
            return;
        }
        let mut browser = Command::new("xdg-open");
        browser.arg(page).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        // The address is printed: without a browser the user can open it.
        let _ = browser.spawn();
    }
}

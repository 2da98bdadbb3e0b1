//! The files of the pages, by their path.
//!
//! | path | holds |
//! |---|---|
//! | `index.html`, `*.js`, `style.css` | the front end |
//! | `runs.js` | the runs, and whether a server answers |
//! | `run1/run.js` | the data of the run page |
//! | `run1/report.html` | the report |
//! | `run1/episodes/N.js`, `run1/prompts/N.js` | episode number N, and its prompts |
//! | `run1/maps/N.svg` | the floor with the items of world state N of streams, or of variant N with other stock |
//! | `run1/views/V-X-Y-H.jpg`, `V-X-Y-H-small.jpg` | the view of a pose in world variant V, and its thumbnail |
//! | `run1/images/HASH.jpg` | an image of a prompt |
//! | `run1/new.json?from=N` | what has happened since N episodes, only from a server |
//!
//! Data are scripts that pass their value to `memtransfer.receive`, because a page from the disk may load scripts and
//! images and nothing else.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::{OsStr, OsString};
use std::io::ErrorKind;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use case_book::{CaseVariant, GREY_VARIANT};
use conditions::Condition;
use conditions::key::EpisodeKey;
use domain::Pose;
use domain::prompt_log::{image_file, is_hash};
use png_file::RgbaImage;
use report::Published;
use run_log::step_view::{PromptLog, is_named, read_logged};
use run_log::{
    EPISODES_FILE, EpisodeRecord, EpisodeTimings, JournalTail, PROMPTS_FOLDER, REQUESTS_FILE,
    RequestRecord, RunLog, STATUS_FILE, TIMINGS_FILE,
};
use scores::Successes;
use serde_json::{Value, json};
use world_client::frames::{ViewKey, ViewRenderer, jpeg, view_arguments};
use world_client::{RecordedRun, RunWorld, WorldAccess, WorldProgram};

use crate::data::{EpisodeCell, EpisodeData, LoggedEpisode, PromptData, RunData, prompts, row};
use crate::file::File;
use crate::view_file::{VIEW_FORMAT, ViewFile};

/// The files of the front end.
pub(crate) const FRONT_END: [(&str, &[u8]); 6] = [
    ("index.html", include_bytes!("../web/index.html")),
    ("style.css", include_bytes!("../web/style.css")),
    ("app.js", include_bytes!("../web/app.js")),
    ("run-page.js", include_bytes!("../web/run-page.js")),
    ("episode-page.js", include_bytes!("../web/episode-page.js")),
    ("map.js", include_bytes!("../web/map.js")),
];

/// The pages of one or two runs.
#[derive(Debug)]
pub struct Site {
    pub(crate) runs: Vec<RunPages>,
    is_served: bool,
}

impl Site {
    /// The pages of `runs`, whose views `program` renders. If the site `is_served`, it shows every view and
    /// what a run in progress adds; otherwise a bundle decides.
    ///
    /// # Errors
    /// When the files of a run do not fit.
    pub fn new(runs: Vec<RecordedRun>, program: &WorldProgram, is_served: bool) -> Result<Self> {
        let pages = runs.into_iter().map(|run| RunPages::new(run, program, is_served));
        Ok(Self { runs: pages.collect::<Result<_>>()?, is_served })
    }

    /// The file at `path`, which may have a query; `None` if there is none.
    ///
    /// # Errors
    /// When a file of a run cannot be read, or the renderer fails.
    pub fn file(&mut self, path: &str) -> Result<Option<File>> {
        let (path, query) = path.split_once('?').unwrap_or((path, ""));
        let path = if path.is_empty() { "index.html" } else { path };
        if let Some((name, bytes)) = FRONT_END.iter().find(|(name, _)| *name == path) {
            return Ok(Some(File { kind: kind_of(name), bytes: bytes.to_vec() }));
        }
        if path == "runs.js" {
            return self.list().map(Some);
        }
        let Some((folder, rest)) = path.split_once('/') else { return Ok(None) };
        let place = (1..).zip(&mut self.runs).find(|(place, _)| folder == folder_of(*place));
        let Some((place, run)) = place else { return Ok(None) };
        run.file(&folder_of(place), rest, query)
    }

    fn list(&self) -> Result<File> {
        let runs: Vec<String> = (1..=self.runs.len()).map(folder_of).collect();
        File::script("runs", &json!({ "folders": runs, "served": self.is_served }))
    }
}

/// The folder of the run at `place`, from 1.
pub(crate) fn folder_of(place: usize) -> String {
    format!("run{place}")
}

fn kind_of(name: &str) -> &'static str {
    match name.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        _ => "text/javascript; charset=utf-8",
    }
}

/// The pages of one run.
#[derive(Debug)]
pub(crate) struct RunPages {
    pub(crate) log: RunLog,
    pub(crate) world: RunWorld,
    access: WorldAccess,
    pub(crate) conditions: Vec<Condition>,
    notices: Vec<String>,
    /// By key.
    timings: BTreeMap<String, usize>,
    /// By key, in order.
    requests: BTreeMap<String, Vec<usize>>,
    /// Episodes of streams, by sequence and position.
    sequences: BTreeMap<(String, u32), usize>,
    /// With which failures are compared.
    successes: Successes,
    growth: Option<Growth>,
    prompt_log: PromptLog,
    renderer: LazyRenderer,
}

/// The journals of a run that may go on. Of timings and requests there are many, and they are for episode pages and the
/// report: they are read when one is asked for, so that an open run page costs the run little.
#[derive(Debug)]
struct Growth {
    /// How often everything was read again. A page that knows another number begins again.
    restarts: u32,
    episodes: JournalTail<EpisodeRecord>,
    timings: JournalTail<EpisodeTimings>,
    requests: JournalTail<RequestRecord>,
    /// Requests at the start of their journal that the log has already.
    known_requests: usize,
    keys: BTreeSet<String>,
}

/// The renderer, started when the first view is needed.
#[derive(Debug)]
struct LazyRenderer {
    program: WorldProgram,
    arguments: Vec<OsString>,
    running: Option<ViewRenderer>,
}

impl LazyRenderer {
    fn render(
        &mut self,
        views: &[ViewKey],
        take: impl FnMut(&ViewKey, &[u8]) -> Result<()>,
    ) -> Result<()> {
        let mut renderer = match self.running.take() {
            Some(renderer) => renderer,
            None => ViewRenderer::start(&self.program, &self.arguments, VIEW_FORMAT)?,
        };
        renderer.render_pixels(views, take)?;
        // After an error the next view starts another.
        self.running = Some(renderer);
        Ok(())
    }
}

impl RunPages {
    fn new(run: RecordedRun, program: &WorldProgram, is_served: bool) -> Result<Self> {
        let RecordedRun { log, world, access, notices, .. } = run;
        let program_of_run = program.of_run(&log)?;
        let settings = &log.manifest.settings;
        let arguments = view_arguments(&log);
        let growth = is_served.then(|| Growth::new(&log));
        let prompt_log = PromptLog::of(&log);
        let renderer = LazyRenderer { program: program_of_run, arguments, running: None };
        let mut conditions = settings.conditions();
        for record in &log.episodes {
            if !conditions.contains(&record.condition()) {
                conditions.push(record.condition());
            }
        }
        let mut pages = Self {
            log,
            world,
            access,
            conditions,
            notices,
            timings: BTreeMap::new(),
            requests: BTreeMap::new(),
            sequences: BTreeMap::new(),
            successes: Successes::default(),
            growth,
            prompt_log,
            renderer,
        };
        pages.index((0, 0, 0));
        Ok(pages)
    }

    /// Enters the episodes, timings and requests from these numbers on under their keys.
    fn index(&mut self, from: (usize, usize, usize)) {
        let episodes = self.log.episodes.iter().enumerate().skip(from.0);
        self.sequences.extend(episodes.filter_map(|(index, record)| {
            let position = record.stream.as_ref()?.position;
            Some(((EpisodeKey::read(&record.key)?.sequence()?, position), index))
        }));
        self.successes.extend(self.log.episodes.iter().skip(from.0));
        let timings = self.log.timings.iter().enumerate().skip(from.1);
        self.timings.extend(timings.map(|(index, timings)| (timings.key.clone(), index)));
        for (index, request) in self.log.requests.iter().enumerate().skip(from.2) {
            self.requests.entry(request.key.clone()).or_default().push(index);
        }
    }

    fn file(&mut self, folder: &str, path: &str, query: &str) -> Result<Option<File>> {
        let number = |name: &str, end: &str| -> Option<usize> {
            name.strip_suffix(end)?.parse().ok().filter(|number| format!("{number}{end}") == name)
        };
        let Some((kind, name)) = path.split_once('/') else {
            return match path {
                "run.js" => self.run(folder, |_| true).map(Some),
                "report.html" => {
                    self.read_details()?;
                    self.report().map(Some)
                }
                "new.json" => self.news(query).map(Some),
                _ => Ok(None),
            };
        };
        match kind {
            "episodes" | "prompts" => {
                let Some(index) = number(name, ".js") else { return Ok(None) };
                self.read_details()?;
                if index >= self.log.episodes.len() {
                    return Ok(None);
                }
                if kind == "episodes" {
                    return Self::episode_file(folder, index, &self.episode(index)?).map(Some);
                }
                let prompts = self.prompts(index)?;
                Self::prompts_file(folder, index, &prompts).map(Some)
            }
            "maps" => {
                let ground = number(name, ".svg").and_then(|ground| u32::try_from(ground).ok());
                ground.map_or(Ok(None), |ground| self.map(ground))
            }
            "views" => ViewFile::of_name(name).map_or(Ok(None), |wanted| self.view(wanted)),
            "images" => {
                let hash = name.strip_suffix(".jpg").filter(|hash| is_hash(hash));
                let file = hash.map(|hash| image_file(&self.log.dir.join(PROMPTS_FOLDER), hash));
                file.map_or(Ok(None), |file| image(&self.log.dir, &file))
            }
            _ => Ok(None),
        }
    }

    /// `run.js`, where `has_views` says of which episodes views are there.
    pub(crate) fn run(&self, folder: &str, has_views: impl Fn(usize) -> bool) -> Result<File> {
        let views = format!("{folder}/views/");
        let mut data = RunData::new(&self.log, &self.world, &self.conditions, views, has_views)?;
        data.notices.extend(self.notices.iter().cloned());
        File::script(&format!("{folder}/run"), &data)
    }

    /// `report.html`.
    pub(crate) fn report(&self) -> Result<File> {
        let logs = std::slice::from_ref(&self.log);
        let page = report::page(&report::document(logs, &Published::paper()?))?;
        Ok(File::text("text/html; charset=utf-8", page))
    }

    /// The data of episode number `index`.
    pub(crate) fn episode(&self, index: usize) -> Result<EpisodeData> {
        let record = &self.log.episodes[index];
        let timings = self.timings_of(record);
        let requests = self.requests.get(&record.key);
        let episode = LoggedEpisode {
            record,
            timings,
            requests: requests.into_iter().flatten().map(|&at| &self.log.requests[at]).collect(),
            horizon: self.log.manifest.settings.horizon,
            prompts: timings.is_some() && self.has_prompts(),
        };
        let sequence = EpisodeKey::read(&record.key).and_then(|key| key.sequence());
        let experience = |position: u32| {
            let index = self.sequences.get(&(sequence.clone()?, position))?;
            self.log.episodes.get(*index)
        };
        EpisodeData::new(&self.world, &episode, &self.successes, experience)
            .with_context(|| format!("cannot show {}", record.key))
    }

    fn timings_of(&self, record: &EpisodeRecord) -> Option<&EpisodeTimings> {
        self.timings.get(&record.key).and_then(|&at| self.log.timings.get(at))
    }

    pub(crate) fn episode_file(folder: &str, index: usize, data: &EpisodeData) -> Result<File> {
        File::script(&format!("{folder}/episodes/{index}"), data)
    }

    /// Whether prompts were logged.
    pub(crate) fn has_prompts(&self) -> bool {
        self.prompt_log.exists()
    }

    /// The logged prompts of episode number `index`.
    pub(crate) fn prompts(&mut self, index: usize) -> Result<Vec<PromptData>> {
        let record = &self.log.episodes[index];
        let timings = self.timings.get(&record.key).and_then(|&at| self.log.timings.get(at));
        let log = &mut self.prompt_log;
        timings.map_or(Ok(Vec::new()), |timings| prompts(log, timings, record.steps))
    }

    pub(crate) fn prompts_file(folder: &str, index: usize, data: &[PromptData]) -> Result<File> {
        File::script(&format!("{folder}/prompts/{index}"), &data)
    }

    /// Whether the run's world draws maps.
    pub(crate) fn has_map(&self) -> bool {
        self.world.has_map()
    }

    /// The drawing of the floor of world state `ground` of streams, or of the variant with this number and other stock; `None` in a world that draws none.
    pub(crate) fn map(&self, ground: u32) -> Result<Option<File>> {
        if !self.has_map() {
            return Ok(None);
        }
        let states = &self.world.description().states;
        let variant = match states.get(ground as usize) {
            Some(variant) => *variant,
            None if ground == 0 || CaseVariant::with_mismatch(ground).is_some() => ground,
            None => return Ok(None),
        };
        let scene = self.world.scene(variant)?;
        Ok(Some(File::text("image/svg+xml", scene.svg.clone())))
    }

    /// Renders `views` and passes the pixels of each to `take`, in order.
    pub(crate) fn render(
        &mut self,
        views: &[ViewKey],
        take: impl FnMut(&ViewKey, &[u8]) -> Result<()>,
    ) -> Result<()> {
        self.renderer.render(views, take)
    }

    fn view(&mut self, wanted: ViewFile) -> Result<Option<File>> {
        let is_there = match &wanted.view {
            ViewKey::State(GREY_VARIANT, _) if !self.world.has_map() => true,
            ViewKey::State(variant, state) => Pose::try_from(*state).is_ok_and(|pose| {
                self.world.scene(*variant).is_ok_and(|scene| scene.is_floor(pose.cell))
            }),
            ViewKey::Steps(steps) => {
                !self.world.has_map()
                    && steps
                        .split_once('.')
                        .is_some_and(|(case, _)| self.world.index(case).is_some())
            }
        };
        if !is_there {
            return Ok(None);
        }
        let mut file = None;
        self.render(std::slice::from_ref(&wanted.view), |_, rgba| {
            file = Some(wanted.encode(rgba)?);
            Ok(())
        })?;
        Ok(file)
    }

    /// What the run has added since it had as many episodes as `query` says.
    fn news(&mut self, query: &str) -> Result<File> {
        let from: Option<usize> = query.strip_prefix("from=").and_then(|from| from.parse().ok());
        self.read_episodes()?;
        let restarts = self.growth.as_ref().map_or(0, |growth| growth.restarts);
        let rows: Vec<EpisodeCell> = self
            .log
            .episodes
            .iter()
            .skip(from.unwrap_or(0))
            .filter_map(|record| row(&self.world, &self.conditions, record, true))
            .collect();
        let status = durable::read(&self.log.dir.join(STATUS_FILE)).ok();
        let status = status.and_then(|text| serde_json::from_slice::<Value>(&text).ok());
        // A session that was killed leaves its file behind.
        let status =
            status.filter(|status| Path::new("/proc").join(status["pid"].to_string()).exists());
        let news = json!({ "restarts": restarts, "rows": rows, "status": status });
        Ok(File::text("application/json", serde_json::to_vec(&news)?))
    }

    /// Reads the episodes that were added.
    fn read_episodes(&mut self) -> Result<()> {
        let Some(growth) = &mut self.growth else { return Ok(()) };
        let Some(episodes) = growth.episodes.read_new()? else { return self.start_afresh() };
        let log = &mut self.log;
        let from = (log.episodes.len(), log.timings.len(), log.requests.len());
        let max_steps = log.manifest.settings.max_steps;
        // As when the folder was read, damaged records are left out.
        let whole = episodes.into_iter().filter(|record| record.check(max_steps).is_ok());
        for record in whole {
            if !self.conditions.contains(&record.condition()) {
                return self.start_afresh();
            }
            if growth.keys.insert(record.key.clone()) {
                log.errors.retain(|error| error.key != record.key);
                log.episodes.push(record);
            }
        }
        self.index(from);
        Ok(())
    }

    /// Reads the episodes, timings and requests that were added.
    fn read_details(&mut self) -> Result<()> {
        self.read_episodes()?;
        let Some(growth) = &mut self.growth else { return Ok(()) };
        let (Some(timings), Some(requests)) =
            (growth.timings.read_new()?, growth.requests.read_new()?)
        else {
            return self.start_afresh();
        };
        let log = &mut self.log;
        let from = (log.episodes.len(), log.timings.len(), log.requests.len());
        let known = &self.timings;
        log.timings.extend(timings.into_iter().filter(|one| !known.contains_key(&one.key)));
        let known = growth.known_requests.min(requests.len());
        growth.known_requests -= known;
        log.requests.extend(requests.into_iter().skip(known));
        self.index(from);
        Ok(())
    }

    /// Reads everything again, because the run was started afresh, or has conditions that it did not have.
    fn start_afresh(&mut self) -> Result<()> {
        let restarts = self.growth.as_ref().map_or(0, |growth| growth.restarts);
        let run = RecordedRun::read(&self.log.dir, &self.access)?;
        *self = Self::new(run, &self.renderer.program, true)?;
        if let Some(growth) = &mut self.growth {
            growth.restarts = restarts + 1;
        }
        Ok(())
    }
}

impl Growth {
    /// What the run folder of `log` gains; what `log` has is read again once, and left out.
    fn new(log: &RunLog) -> Self {
        Self {
            restarts: 0,
            episodes: JournalTail::new(log.dir.join(EPISODES_FILE)),
            timings: JournalTail::new(log.dir.join(TIMINGS_FILE)),
            requests: JournalTail::new(log.dir.join(REQUESTS_FILE)),
            known_requests: log.requests.len(),
            keys: log.episodes.iter().map(|record| record.key.clone()).collect(),
        }
    }
}

/// The image `path`, a PNG file in the prompt log of the run in the folder `run`, and its pixels; `None` if there is none. Its
/// name is the hash of the file or, for a view, of its pixels.
///
/// # Errors
/// When it cannot be read, is no image, or another than its name says.
pub fn logged_image(run: &Path, path: &Path) -> Result<Option<(Vec<u8>, RgbaImage)>> {
    let bytes = match read_logged(run, path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        bytes => bytes.with_context(|| format!("cannot read {}", path.display()))?,
    };
    let image =
        RgbaImage::decode(&bytes).with_context(|| format!("cannot read {}", path.display()))?;
    let hash = path.file_stem().and_then(OsStr::to_str).unwrap_or_default();
    ensure!(
        is_named(&bytes, hash) || is_named(image.as_bytes(), hash),
        "{} was changed after it was written: its content does not have the hash that is its name",
        path.display()
    );
    Ok(Some((bytes, image)))
}

/// As [`logged_image`], as JPEG.
pub(crate) fn image(run: &Path, path: &Path) -> Result<Option<File>> {
    let Some((_, image)) = logged_image(run, path)? else { return Ok(None) };
    let edge = |edge: u32| u16::try_from(edge).context("the image is too large");
    let size = (edge(image.width())?, edge(image.height())?);
    let bytes = jpeg(size, VIEW_FORMAT.quality, image.as_bytes())?;
    Ok(Some(File { kind: "image/jpeg", bytes }))
}

#[cfg(test)]
mod tests {
    use std::fs::{self, OpenOptions};
    use std::io::Write;

    use rigs::records::{keyed, manifest, record};
    use run_log::RunFolder;

    use super::*;

    fn line(record: &EpisodeRecord) -> String {
        serde_json::to_string(record).unwrap() + "\n"
    }

    /// The rows that a page gets which has `from` of them, and how often everything was read again.
    fn news(site: &mut Site, from: usize) -> (usize, u64) {
        let file = site.file(&format!("run1/new.json?from={from}")).unwrap().unwrap();
        let news: Value = serde_json::from_slice(&file.bytes).unwrap();
        (news["rows"].as_array().unwrap().len(), news["restarts"].as_u64().unwrap())
    }

    #[test]
    fn an_image_that_is_missing_is_no_error_and_a_damaged_one_is_named() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        assert_eq!(image(dir.path(), &path).unwrap(), None);
        fs::write(&path, "no image").unwrap();
        let problem = |path: &Path| format!("{:#}", image(dir.path(), path).unwrap_err());
        assert!(problem(&path).starts_with(&format!("cannot read {}: ", path.display())));

        let pixels = RgbaImage::filled(2, 2, [7; 4]);
        let name = |content: &[u8]| format!("{}.png", &blake3::hash(content).to_hex()[..32]);
        let view = dir.path().join(name(pixels.as_bytes()));
        pixels.write(&view).unwrap();
        assert!(image(dir.path(), &view).unwrap().is_some());
        let file = dir.path().join(name(&fs::read(&view).unwrap()));
        fs::copy(&view, &file).unwrap();
        assert!(image(dir.path(), &file).unwrap().is_some());
        pixels.write(&path).unwrap();
        assert!(problem(&path).contains("was changed after it was written"));
        let other = dir.path().join(name(b"other"));
        std::os::unix::fs::symlink(&view, &other).unwrap();
        assert!(problem(&other).contains("it is a symbolic link"));
    }

    #[test]
    fn a_page_of_a_run_in_progress_gains_whole_records_and_conditions() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("run");
        drop(RunFolder::open(&folder, manifest(), false).unwrap());
        let path = folder.join(EPISODES_FILE);
        let add = |text: &str| {
            let mut file = OpenOptions::new().append(true).open(&path).unwrap();
            file.write_all(text.as_bytes()).unwrap();
        };
        add(&line(&record("t01-01", true)));
        let program = WorldProgram {
            path: "/nonexistent".into(),
            arguments: Vec::new(),
            world_cmd: None,
            variable: ("UNUSED", ""),
        };
        let run = RecordedRun::read(&folder, &crate::testing::built_in()).unwrap();
        let mut site = Site::new(vec![run], &program, true).unwrap();
        assert_eq!(news(&mut site, 1), (0, 0));

        let second = line(&record("t01-02", true));
        let damaged = line(&record("t01-03", true)).replace("\"steps\":10", "\"steps\":11");
        let (half, rest) = second.split_at(40);
        add(&damaged);
        add(half);
        assert_eq!(news(&mut site, 1), (0, 0), "a damaged record and half of one");
        add(rest);
        assert_eq!(news(&mut site, 1), (1, 0));

        add(&line(&keyed(EpisodeRecord { window: 3, ..record("t01-04", true) })));
        assert_eq!(news(&mut site, 2), (1, 1), "a condition that the settings do not have");
        assert_eq!(news(&mut site, 3), (0, 1), "a second page gets to know it, too");

        fs::remove_file(&path).unwrap();
        fs::write(&path, line(&record("t01-05", true)).repeat(2)).unwrap();
        assert_eq!(news(&mut site, 3), (0, 2), "started afresh");
    }
}

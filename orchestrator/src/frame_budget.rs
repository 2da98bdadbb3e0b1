//! How many frames of each world stay in shared memory: as many as are useful and fit.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::{Result, ensure};
use case_book::{CaseBook, DemonstrationBook};
use conditions::{Condition, Mismatch, Route};
use domain::representation::Trajectories;
use shm_types::attach::MAX_FRAMES;
use shm_types::{Attach, FrameSize};

use crate::plan::PlannedEpisode;

/// Free shared memory left to other programs, as far as it is not more than [`SHARE_LEFT`] of what is free.
const HEADROOM_BYTES: u64 = 64 << 20;

/// Divides the free shared memory; one part is left to other programs.
const SHARE_LEFT: u64 = 8;

/// Share of the available memory that frames may take beyond the least number.
const SHARE_OF_MEMORY: f64 = 0.5;

/// Views of banks that are pinned at once while they are embedded, at least.
const BANK_VIEWS: u32 = 64;

/// Frame sizes that a message suggests are multiples of this.
const FRAME_SIZE_STEP: u32 = 64;

/// Numbers of frames that a run can use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Demand {
    /// Frames that each lane needs: its window, the current view and the next one.
    pub per_lane: u32,
    /// Maximum number of frames that the memory of one episode pins.
    pub remembered: u32,
    /// Every view of every world in the run: more frames are of no use.
    pub all_views: u32,
}

impl Demand {
    /// What `episodes` can use with the window of `attach`, so many keyframes of full-context memory, and so many images
    /// of an external memory's answer, which may come from any case. The memory of a stream is built from all its cases.
    pub fn of(
        attach: &Attach,
        (book, demonstrations): (&CaseBook, &DemonstrationBook),
        episodes: &[PlannedEpisode],
        (keyframes, images): (u32, u32),
    ) -> Self {
        let mut views_of = BTreeMap::new();
        let remembered = episodes.iter().map(|episode| {
            let condition = episode.key.condition;
            let mut views = || {
                let stream = episode.key.place.map(|place| place.stream);
                let case = stream.map_or(episode.case_index, |_| 0);
                let set = (stream, case, episode.demonstrations());
                *views_of.entry(set).or_insert_with(|| {
                    let of_stream =
                        stream.and_then(|stream| demonstrations.streams.get(stream as usize));
                    let cases = match of_stream {
                        Some(stream) => stream.cases.clone(),
                        None => vec![episode.case_index as u32],
                    };
                    let named =
                        cases.into_iter().filter_map(|case| demonstrations.of_case(case, set.2));
                    let of = named.flatten().map(|of| &demonstrations.demonstrations[of as usize]);
                    let views: BTreeSet<u32> = of.flat_map(|of| of.views.iter().copied()).collect();
                    views.len() as u32
                })
            };
            // A bank is not pinned as a whole, but what each lane recalls is.
            let is_bank = episode.demonstrations().bank_size().is_some();
            let recalled = (BANK_VIEWS + attach.lanes * images).min(book.world.views);
            match condition.memory.describe().map(|info| info.trajectories) {
                Some(Trajectories::Nothing) => 0,
                Some(Trajectories::Whole) if is_bank => attach.lanes * keyframes,
                Some(Trajectories::Segment) if is_bank => recalled,
                Some(Trajectories::Whole) => views().min(keyframes),
                Some(Trajectories::Segment) => views(),
                None => views().max(images),
            }
        });
        let is_closed = |condition: &Condition| {
            condition.route == Route::Blocked || condition.demonstrations.take_place_after()
        };
        let blocked = episodes.iter().filter(|episode| is_closed(&episode.key.condition));
        let blocked: BTreeSet<usize> = blocked.map(|episode| episode.case_index).collect();
        let states: BTreeSet<u32> =
            episodes.iter().filter_map(|episode| Some(episode.part?.world)).collect();
        let is_elsewhere =
            |episode: &PlannedEpisode| episode.demonstrations().take_place_elsewhere();
        let elsewhere =
            if episodes.iter().any(is_elsewhere) { book.world.elsewhere_views } else { 0 };
        let mismatches = episodes.iter().map(|episode| episode.key.condition.mismatch);
        let mismatches: BTreeSet<Mismatch> =
            mismatches.filter(|mismatch| mismatch.changes_world()).collect();
        let worlds = ((1 + blocked.len() + states.len()) * (1 + mismatches.len())) as u32;
        Self {
            per_lane: attach.window + 2,
            remembered: remembered.max().unwrap_or(0),
            all_views: worlds.saturating_mul(book.world.views).saturating_add(elsewhere),
        }
    }

    /// The same for a run of so many `episodes`, which show a view a step at most, beside those of `demonstrations`. A world that
    /// cannot count its views declares a million.
    pub fn of_short_run(
        self,
        episodes: usize,
        max_steps: u32,
        demonstrations: &DemonstrationBook,
    ) -> Self {
        let remembered = demonstrations.demonstrations.iter().flat_map(|of| &of.views);
        let remembered = remembered.collect::<BTreeSet<_>>().len();
        let steps = (episodes as u64).saturating_mul(u64::from(max_steps) + 1);
        let shown = steps.saturating_add(remembered as u64);
        Self { all_views: self.all_views.min(shown.try_into().unwrap_or(u32::MAX)), ..self }
    }

    /// The least number of frames that a world with so many lanes can run with.
    pub const fn least(&self, lanes: u32) -> u32 {
        lanes * self.per_lane + self.remembered
    }
}

/// The number of frames for each world of the run in `attach`: `given`, else the largest useful number that fits into its part
/// of the `free` bytes of shared memory and, beyond the least, of the share of the `available` bytes of memory.
///
/// # Errors
/// When the least number does not fit, or `given` is below it or does not fit.
pub fn choose(
    attach: &Attach,
    demand: Demand,
    given: Option<u32>,
    free: u64,
    available: u64,
) -> Result<u32> {
    let worlds = u64::from(attach.worlds);
    let room = (free - HEADROOM_BYTES.min(free / SHARE_LEFT)) / worlds;
    let lanes = attach.lanes_of_world();
    let least = demand.least(lanes);
    let Demand { per_lane, remembered, .. } = demand;
    let least_frames = format!(
        "at least {least} frames ({lanes} lanes with {per_lane} each, {remembered} of the demonstrations)"
    );
    let free_mib = room >> 20;
    let each = if worlds > 1 { format!(" for each of {worlds} worlds") } else { String::new() };
    let needed = bytes(attach, least);
    ensure!(
        needed <= room,
        "the run needs {} MiB of shared memory for {least_frames}, and {free_mib} MiB of /dev/shm are usable{each}: {}",
        needed.div_ceil(1 << 20),
        advice(attach, demand, room)
    );
    let Some(given) = given else {
        let room = room.min((SHARE_OF_MEMORY * available as f64) as u64 / worlds);
        let useful = lanes * per_lane + demand.all_views.max(remembered);
        return Ok(most_within(attach, least, useful.min(MAX_FRAMES), room));
    };
    ensure!(
        given >= least,
        "--frame-budget is {given}, and the run needs {least_frames}: fewer --lanes need fewer, or leave \
         --frame-budget out"
    );
    ensure!(
        bytes(attach, given) <= room,
        "--frame-budget is {given}, and {} frames fit into the {free_mib} MiB of /dev/shm that are usable{each}: give at \
         most that, or leave --frame-budget out",
        most_within(attach, least, given, room)
    );
    Ok(given)
}

/// Bytes of shared memory with so many frames.
pub(crate) fn bytes(attach: &Attach, frames: u32) -> u64 {
    Attach { frame_capacity: frames, ..attach.clone() }.shared_memory_bytes()
}

/// The largest number of frames from `least`, taken to fit, to `most` that fits into `room` bytes.
fn most_within(attach: &Attach, least: u32, most: u32, room: u64) -> u32 {
    // `fits` holds throughout; what is above `too_many` does not fit or is of no use.
    let (mut fits, mut too_many) = (least, most.max(least) + 1);
    while fits + 1 < too_many {
        let middle = fits + (too_many - fits) / 2;
        if bytes(attach, middle) <= room { fits = middle } else { too_many = middle }
    }
    fits
}

/// What makes the run fit into `room` bytes.
fn advice(attach: &Attach, demand: Demand, room: u64) -> String {
    const LARGER: &str = "make it larger (in Docker with --shm-size)";
    if attach.worlds > 1 {
        return format!("give fewer --worlds; or {LARGER}");
    }
    let fits = |lanes: u32, frame: FrameSize| {
        bytes(&Attach { lanes, frame, ..attach.clone() }, demand.least(lanes)) <= room
    };
    match (1..attach.lanes).rev().find(|&lanes| fits(lanes, attach.frame)) {
        Some(1) => return format!("--lanes 1 fits; or {LARGER}"),
        Some(lanes) => return format!("--lanes {lanes} or fewer fit; or {LARGER}"),
        None => {}
    }
    let mut sizes =
        (1..attach.frame.width.div_ceil(FRAME_SIZE_STEP)).rev().map(|n| n * FRAME_SIZE_STEP);
    match sizes.find(|&size| fits(1, FrameSize { width: size, height: size })) {
        Some(size) => format!(
            "--lanes 1 --frame-size {size} fits, but the agent sees smaller images; or {LARGER}"
        ),
        None => LARGER.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use conditions::Demonstrations;
    use domain::Representation;
    use shm_types::RunDir;

    use super::*;
    use crate::plan::plan;
    use crate::selection::SelectedCases;
    use crate::testing::selected;

    fn attach() -> Attach {
        let base = tempfile::tempdir().unwrap();
        let run = RunDir::create(base.path()).unwrap();
        Attach { lanes: 4, window: 6, ..run.attach() }
    }

    const DEMAND: Demand = Demand { per_lane: 8, remembered: 40, all_views: 1000 };

    #[test]
    fn as_many_frames_as_are_useful_and_fit() {
        let attach = attach();
        let chosen = |free, available| choose(&attach, DEMAND, None, free, available).unwrap();
        let (least, most) = (72, 1032);
        for frames in [least, least + 1, 500, most - 1, most] {
            let free = bytes(&attach, frames);
            // An eighth of what is free, 64 MiB at most, is left.
            let free = free + HEADROOM_BYTES.min(free.div_ceil(7));
            assert_eq!(chosen(free, u64::MAX), frames);
            assert_eq!(chosen(u64::MAX, 2 * bytes(&attach, frames)), frames);
        }
        assert_eq!(chosen(u64::MAX, u64::MAX), most);
        assert_eq!(chosen(u64::MAX, 0), least, "the least number it must have");
    }

    #[test]
    fn worlds_share_the_room_and_the_lanes() {
        let one = Attach { lanes: 2, ..attach() };
        let two = Attach { lanes: 4, worlds: 2, ..attach() };
        let (free, available) = (2_u64 << 30, 1 << 30);
        let of_one = choose(&one, DEMAND, None, free / 2, available / 2).unwrap();
        let of_each = choose(&two, DEMAND, None, free, available).unwrap();
        assert!(of_each <= of_one && of_each > of_one - 10, "{of_each} of {of_one}");
        let error = choose(&two, DEMAND, None, 1000, available).unwrap_err().to_string();
        assert!(error.contains("usable for each of 2 worlds: give fewer --worlds"), "{error}");
    }

    #[test]
    fn advice_can_be_followed() {
        let attach = attach();
        // Enough for two lanes, or for one with smaller frames, and what is left to others.
        let enough = |attach: &Attach| {
            let bytes = bytes(attach, DEMAND.least(attach.lanes));
            bytes + bytes / 7 + 8
        };
        let free = enough(&Attach { lanes: 2, ..attach.clone() });
        let error = choose(&attach, DEMAND, None, free, u64::MAX).unwrap_err().to_string();
        assert!(error.contains("--lanes 2 or fewer fit; or make it larger"), "{error}");
        let with =
            |lanes: u32| choose(&Attach { lanes, ..attach.clone() }, DEMAND, None, free, u64::MAX);
        assert!(with(2).unwrap() >= DEMAND.least(2));
        assert!(with(3).is_err());

        let frame = FrameSize { width: 192, height: 192 };
        let smaller = Attach { lanes: 1, frame, ..attach.clone() };
        let free = enough(&smaller);
        let error = choose(&attach, DEMAND, None, free, u64::MAX).unwrap_err().to_string();
        assert!(error.contains("--lanes 1 --frame-size 192 fits"), "{error}");
        assert!(choose(&smaller, DEMAND, None, free, u64::MAX).is_ok());
        let none = choose(&attach, DEMAND, None, 1000, u64::MAX).unwrap_err().to_string();
        assert!(none.ends_with("usable: make it larger (in Docker with --shm-size)"), "{none}");

        let few = choose(&attach, DEMAND, Some(10), u64::MAX, u64::MAX).unwrap_err();
        assert!(few.to_string().starts_with("--frame-budget is 10, and the run needs at least 72"));
        let free = 256 << 20;
        let many = choose(&attach, DEMAND, Some(100_000), free, u64::MAX).unwrap_err().to_string();
        let most = many.split(' ').nth(4).and_then(|word| word.parse().ok()).unwrap();
        assert_eq!(choose(&attach, DEMAND, Some(most), free, u64::MAX).unwrap(), most);
        assert!(choose(&attach, DEMAND, Some(most + 1), free, u64::MAX).is_err());
    }

    #[test]
    fn a_short_run_uses_no_more_frames_than_it_shows() {
        let SelectedCases { books, .. } = selected(&[("limit", "1")]);
        let book = &books.demonstrations.book;
        let views: BTreeSet<u32> =
            book.demonstrations.iter().flat_map(|of| of.views.iter().copied()).collect();
        let of_any_world = Demand { all_views: 1 << 20, ..DEMAND };
        let short = of_any_world.of_short_run(3, 20, book);
        assert_eq!(short, Demand { all_views: 3 * 21 + views.len() as u32, ..of_any_world });
        assert_eq!(of_any_world.of_short_run(usize::MAX, u32::MAX, book), of_any_world);
    }

    #[test]
    fn the_other_warehouse_has_views_of_its_own() {
        let SelectedCases { books, .. } =
            selected(&[("memory", "episodic"), ("demos", "4,elsewhere"), ("limit", "1")]);
        let (book, demonstrations) = (&books.cases.book, &books.demonstrations.book);
        let demand = |condition: &str| {
            let conditions = [(condition.parse().unwrap(), 1)];
            let episodes: Vec<_> = plan(&conditions, &[0], &["t01-01"], 1).collect();
            Demand::of(&attach(), (book, demonstrations), &episodes, (40, 40))
        };
        let elsewhere = demand("episodic/new/unchanged/elsewhere");
        let of = demonstrations.cases[0].elsewhere.unwrap();
        let views: BTreeSet<u32> =
            demonstrations.demonstrations[of as usize].views.iter().copied().collect();
        assert_eq!(elsewhere.remembered as usize, views.len());
        assert!(book.world.elsewhere_views > 0);
        assert_eq!(elsewhere.all_views, book.world.views + book.world.elsewhere_views);
        assert_eq!(demand("episodic/new/unchanged/4").all_views, book.world.views);
    }

    #[test]
    fn the_demand_includes_the_views_that_memory_pins() {
        let SelectedCases { books, .. } =
            selected(&[("demos", "4,original"), ("routes", "blocked")]);
        let (book, demonstrations) = (&books.cases.book, &books.demonstrations.book);
        let attach = attach();
        let remembered = |conditions: &[&str]| {
            let is_blocked = conditions.iter().any(|written| written.contains("blocked"));
            let conditions: Vec<(Condition, u32)> =
                conditions.iter().map(|written| (written.parse().unwrap(), 1)).collect();
            let ids = book.ids();
            let episodes: Vec<_> = plan(&conditions, &[0, 60], &ids, 1).collect();
            let demand = Demand::of(&attach, (book, demonstrations), &episodes, (40, 40));
            // Each case closes its passage.
            let worlds = if is_blocked { 3 } else { 1 };
            assert_eq!(demand.all_views, worlds * book.world.views);
            demand.remembered
        };
        let views = |set: Demonstrations| {
            remembered(&[&format!("{}/new/unchanged/{set}", Representation::Episodic.name())])
        };
        assert_eq!(remembered(&[]), 0);
        assert_eq!(remembered(&["working/new/unchanged/none", "hybrid/new/unchanged/4"]), 0);
        assert_eq!(remembered(&["full-context/new/unchanged/4"]), 40);
        assert_eq!(remembered(&["full-context/new/blocked/4"]), 40);
        let (original, all) = (Demonstrations::ORIGINAL, Demonstrations::ALL);
        assert!(views(original) > 10 && views(original) < views(all));
        assert!(views(all) > 40);
    }
}

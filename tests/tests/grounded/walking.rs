//! Cases walked with each representation, and under controls.

use shm_types::Representation;
use warehouse::Start;

use crate::walker::{Frames, Setup, Walker};

/// Every how many cases one is walked: two of each type.
const EVERY: usize = 5;

#[test]
fn memory_is_followed_through_the_pixels_and_only_through_them() {
    let mut walker = Walker::new();
    let episodic = Setup::of(Representation::Episodic);
    let mut solved = |setup| walker.solved(setup, EVERY);
    let working = solved(Setup::of(Representation::Working));
    let blank = solved(Setup { frames: Frames::Blank, ..episodic });
    let swapped = solved(Setup { frames: Frames::Swapped, ..episodic });
    let episodic = solved(episodic);
    let told = format!("episodic {episodic}, working {working}, blank {blank}, swapped {swapped}");
    assert!(episodic >= 19, "{told}");
    assert!(working + 5 <= episodic, "{told}");
    assert!(blank <= 2 && swapped <= 3, "{told}");
}

/// Prints how many of all cases are solved under the conditions that the environment variable
/// `GROUNDED_TABLE` names ("all" or a part of a row's name).
#[test]
#[ignore = "a measurement, some minutes long"]
fn table() {
    let wanted = std::env::var("GROUNDED_TABLE").unwrap_or_else(|_| "all".to_owned());
    let every = std::env::var("GROUNDED_EVERY").map_or(1, |every| every.parse().unwrap());
    let mut walker = Walker::new();
    let mut measure = |name: String, setup: Setup| {
        if wanted != "all" && !name.contains(&wanted) {
            return;
        }
        let walked = walker.walk(setup, every);
        let solved = walked.iter().filter(|(_, steps)| steps.is_some()).count();
        let mut types: Vec<(String, usize)> = Vec::new();
        for (id, steps) in &walked {
            let kind = id.split('-').next().unwrap().to_owned();
            if types.last().is_none_or(|(last, _)| *last != kind) {
                types.push((kind, 0));
            }
            types.last_mut().unwrap().1 += usize::from(steps.is_some());
        }
        let types: Vec<_> = types.iter().map(|(_, solved)| solved.to_string()).collect();
        println!("{name:40} {solved:3} of {}   by type {}", walked.len(), types.join(" "));
        if std::env::var("GROUNDED_CASES").is_ok() {
            walked.iter().for_each(|(id, steps)| println!("    {id} {steps:?}"));
        }
    };
    for &memory in Representation::ALL {
        for start in [Start::Original, Start::Test, Start::Blocked] {
            for demonstrations in [1, 4] {
                if memory == Representation::Working && demonstrations == 4 {
                    continue;
                }
                let setup = Setup { start, demonstrations, ..Setup::of(memory) };
                measure(format!("{memory}/{}/{demonstrations}", start.name()), setup);
            }
        }
        for window in [0, 20] {
            measure(
                format!("{memory}/original/1/h{window}"),
                Setup { window, ..Setup::of(memory) },
            );
        }
        for (name, frames) in [("blank", Frames::Blank), ("swapped", Frames::Swapped)] {
            measure(format!("{memory}/original/1/{name}"), Setup { frames, ..Setup::of(memory) });
        }
        if memory.uses_demonstrations() {
            measure(format!("{memory}/original/1/hint"), Setup { hint: true, ..Setup::of(memory) });
        }
    }
    let images = Setup { actions: false, ..Setup::of(Representation::Episodic) };
    measure("episodic/original/1/images".to_owned(), images);
}

//! The summary: items, passages and routes, updated with one demonstration after the other.

use std::collections::BTreeMap;
use std::fmt;

use domain::{Cell, Heading, Pose};
use plates::Plate;

use super::super::floor::{Floor, Stretch};
use super::super::names::{CatalogueNames, PlateLabel};
use super::super::survey::{Survey, SurveyedBay};
use super::super::transcript::Transcript;
use super::{category_digits, type_digits};

const OPENING: &str = "\
# Summary of the demonstrations
Positions are (column, row): columns grow east, rows grow north. An item is reached by standing on the cell in front of it.
";

/// The summary so far.
#[derive(Debug, Default)]
pub(super) struct SummaryDraft {
    names: CatalogueNames,
    survey: Survey,
    floor: Floor,
    routes: Vec<Route>,
}

/// A demonstrated route.
#[derive(Debug, PartialEq, Eq)]
struct Route {
    instruction: String,
    start: Pose,
    events: Vec<RouteEvent>,
}

#[derive(Debug, PartialEq, Eq)]
enum RouteEvent {
    /// A number of cells in a straight line, and the cell reached.
    Leg { towards: Heading, cells: u8, to: Cell },
    /// Sub-goals were completed; `last` if none is left.
    Completed { count: u32, at: Cell, last: bool },
}

impl SummaryDraft {
    /// Adds a demonstration.
    pub(super) fn add(&mut self, transcript: &Transcript) {
        self.names.add(&transcript.instruction);
        transcript.steps.iter().for_each(|step| self.survey.add(step));
        self.floor.add(transcript.steps.iter().map(|step| step.pose.cell));
        if let Some(route) = Route::of(transcript)
            && !self.routes.contains(&route)
        {
            self.routes.push(route);
        }
    }

    fn items(&self) -> BTreeMap<(PlateLabel<'_>, Plate), Vec<SurveyedBay>> {
        let mut items = BTreeMap::<_, Vec<SurveyedBay>>::new();
        for bay in self.survey.bays() {
            let plate = bay.landmark.plate;
            items.entry((self.names.label(plate), plate)).or_default().push(bay);
        }
        items
    }

    /// What was reached when `count` sub-goals were completed at a cell: the items, as far as they are known.
    fn reached(&self, route: &Route, count: u32, at: Cell, last: bool) -> Vec<String> {
        let asked = CatalogueNames::of(&route.instruction);
        let returns = last && at == route.start.cell && route.instruction.contains("you started");
        let targets = self.survey.at(at).filter(|&plate| asked.label(plate) != PlateLabel::Unnamed);
        let targets = targets.map(|plate| format!("reached {} at {at}", self.names.label(plate)));
        let mut words: Vec<String> = targets.take(count as usize - usize::from(returns)).collect();
        if returns {
            words.push(format!("back at the start {at}"));
        }
        if words.is_empty() {
            words.push(format!("reached a target at {at}"));
        }
        words
    }

    fn write_route(&self, f: &mut fmt::Formatter<'_>, route: &Route) -> fmt::Result {
        let Route { instruction, start, events } = route;
        write!(f, "- \"{instruction}\" from {} facing {}:", start.cell, start.heading.letter())?;
        let mut after_leg = None;
        for event in events {
            match event {
                RouteEvent::Leg { towards, cells, to } => {
                    f.write_str(match after_leg {
                        None => " ",
                        Some(true) => ", ",
                        Some(false) => "; ",
                    })?;
                    write!(f, "{} {cells} to {to}", towards.word())?;
                    after_leg = Some(true);
                }
                &RouteEvent::Completed { count, at, last } => {
                    f.write_str(if after_leg.is_none() { " " } else { "; " })?;
                    f.write_str(&self.reached(route, count, at, last).join("; "))?;
                    after_leg = Some(false);
                }
            }
        }
        f.write_str(".\n")
    }
}

impl Route {
    /// The route of a demonstration; `None` when it has no events.
    fn of(transcript: &Transcript) -> Option<Self> {
        let Transcript { instruction, steps } = transcript;
        let start = steps.first()?;
        let total = steps.last()?.completed;
        let mut events = Vec::new();
        let complete = |events: &mut Vec<RouteEvent>, before: u32, now: u32, at: Cell| {
            if now > before {
                events.push(RouteEvent::Completed { count: now - before, at, last: now == total });
            }
        };
        complete(&mut events, 0, start.completed, start.pose.cell);
        for pair in steps.windows(2) {
            let (from, to) = (pair[0].pose.cell, pair[1].pose.cell);
            if let Some(towards) = Heading::ALL.into_iter().find(|&way| from.step(way) == Some(to))
            {
                match events.last_mut() {
                    Some(RouteEvent::Leg { towards: way, cells, to: end }) if *way == towards => {
                        *cells += 1;
                        *end = to;
                    }
                    _ => events.push(RouteEvent::Leg { towards, cells: 1, to }),
                }
            }
            complete(&mut events, pair[0].completed, pair[1].completed, to);
        }
        let route = Self { instruction: instruction.clone(), start: start.pose, events };
        (!route.events.is_empty()).then_some(route)
    }
}

impl fmt::Display for SummaryDraft {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(OPENING)?;
        f.write_str("\n## Items\n")?;
        for ((label, plate), bays) in self.items() {
            let (category, own) = (category_digits(plate), type_digits(plate));
            write!(f, "- {label} [plate {category}-{own}]:")?;
            for (i, SurveyedBay { landmark, .. }) in bays.iter().enumerate() {
                let (cell, face) = (landmark.standpoint, landmark.face.letter());
                write!(f, "{} stand at {cell} facing {face}", if i == 0 { "" } else { ";" })?;
            }
            f.write_str("\n")?;
        }
        f.write_str("\n## Passages\n")?;
        for stretch in self.floor.covering() {
            match stretch {
                Stretch::Column { x, from, to } => writeln!(f, "- column {x}: rows {from}-{to}")?,
                Stretch::Row { y, from, to } => writeln!(f, "- row {y}: columns {from}-{to}")?,
            }
        }
        f.write_str("\n## Routes\n")?;
        self.routes.iter().try_for_each(|route| self.write_route(f, route))
    }
}

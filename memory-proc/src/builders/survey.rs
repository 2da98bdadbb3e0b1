//! The plates of bays, by the majority of their readings.

use std::collections::{BTreeMap, BTreeSet};

use domain::{Cell, Heading, Pose};
use plates::{Landmark, Plate};

use super::transcript::TranscriptStep;
use search::ContentHash;

/// Readings of the plate at each bay, which is named by its standpoint and the heading that faces it.
#[derive(Debug, Clone, Default)]
pub(super) struct Survey {
    readings: BTreeMap<(Cell, Heading), BTreeMap<Plate, u32>>,
    /// Frames that have been counted: each counts once.
    counted: BTreeSet<(Pose, ContentHash)>,
}

/// A bay and its plate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct SurveyedBay {
    /// Its place and plate.
    pub(super) landmark: Landmark,
    /// Frames in which this plate was read.
    pub(super) support: u32,
}

impl Survey {
    /// Adds the view of `step`.
    pub(super) fn add(&mut self, step: &TranscriptStep) {
        if !self.counted.insert((step.pose, step.seen.frame)) {
            return;
        }
        for &Landmark { standpoint, face, plate } in &step.seen.landmarks {
            let readings = self.readings.entry((standpoint, face)).or_default();
            *readings.entry(plate).or_default() += 1;
        }
    }

    /// Every bay with its most frequent reading, ordered by standpoint. Of equally frequent ones, the least plate.
    pub(super) fn bays(&self) -> impl Iterator<Item = SurveyedBay> + '_ {
        self.readings.iter().filter_map(|(&(standpoint, face), readings)| {
            let most = readings.values().copied().max()?;
            let (&plate, &support) = readings.iter().find(|&(_, &count)| count == most)?;
            Some(SurveyedBay { landmark: Landmark { standpoint, face, plate }, support })
        })
    }

    /// The plates of bays with the standpoint `cell`.
    pub(super) fn at(&self, cell: Cell) -> impl Iterator<Item = Plate> + '_ {
        let here = move |bay: &SurveyedBay| bay.landmark.standpoint == cell;
        self.bays().filter(here).map(|bay| bay.landmark.plate)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use domain::Feedback;

    use super::super::transcript::FrameReading;
    use super::*;

    const CELL: Cell = Cell::new(3, 4);

    fn plate(code: u8) -> Plate {
        Plate([code; 6])
    }

    fn look(from: u8, codes: &[u8]) -> TranscriptStep {
        let landmark =
            |&code: &u8| Landmark { standpoint: CELL, face: Heading::E, plate: plate(code) };
        let seen =
            FrameReading { frame: [from; 16], landmarks: codes.iter().map(landmark).collect() };
        TranscriptStep {
            pose: Pose::new(0, from, Heading::N),
            feedback: Feedback::Moved,
            seen: Arc::new(seen),
            completed: 0,
            action: None,
        }
    }

    #[test]
    fn the_most_frequent_reading_wins_and_a_frame_counts_once() {
        let mut survey = Survey::default();
        assert_eq!(survey.bays().next(), None);
        for step in [look(1, &[5]), look(1, &[5]), look(1, &[5]), look(2, &[2]), look(3, &[2])] {
            survey.add(&step);
        }
        let bays: Vec<SurveyedBay> = survey.bays().collect();
        assert_eq!((bays.len(), bays[0].landmark.plate, bays[0].support), (1, plate(2), 2));
        survey.add(&look(4, &[5]));
        assert_eq!(survey.at(CELL).collect::<Vec<_>>(), [plate(2)]);
        survey.add(&look(5, &[5]));
        assert_eq!(survey.at(CELL).collect::<Vec<_>>(), [plate(5)]);
        assert_eq!(survey.at(Cell::new(4, 4)).count(), 0);
    }
}

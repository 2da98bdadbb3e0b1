//! The window of an episode's last steps.

use std::collections::VecDeque;

use shm_types::message::PastStep;

/// The window W_t: the last h steps, oldest first. Supplied with every representation.
#[derive(Debug, Clone)]
pub(crate) struct Window {
    length: usize,
    steps: VecDeque<PastStep>,
}

impl Window {
    /// An empty window of `length` (h) steps.
    pub(crate) fn new(length: usize) -> Self {
        Self { length, steps: VecDeque::with_capacity(length + 1) }
    }

    /// Adds the latest step.
    pub(crate) fn push(&mut self, step: PastStep) {
        self.steps.push_back(step);
        if self.steps.len() > self.length {
            self.steps.pop_front();
        }
    }

    /// The steps, oldest first.
    pub(crate) fn steps(&self) -> impl ExactSizeIterator<Item = PastStep> + '_ {
        self.steps.iter().copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_holds_the_last_steps_oldest_first() {
        let step = |frame| PastStep { frame, action: 0, feedback: 1, reserved: [0; 6] };
        for (length, expected) in [(0, vec![]), (2, vec![4, 5]), (9, vec![1, 2, 3, 4, 5])] {
            let mut window = Window::new(length);
            (1..=5).for_each(|frame| window.push(step(frame)));
            assert_eq!(window.steps().map(|step| step.frame).collect::<Vec<_>>(), expected);
        }
    }
}

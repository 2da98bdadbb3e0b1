//! Which images of a request are sent when there are more than the budget allows.

/// The images of a request by kind, apart from the current view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ImageCounts {
    /// Keyframes of all demonstrations together.
    pub(super) keyframes: u32,
    /// Retrieved views.
    pub(super) retrieved: u32,
    /// Views of the window.
    pub(super) window: u32,
}

/// Which images are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ImagePlan {
    counts: ImageCounts,
    sent: ImageCounts,
    /// Whether the current view is sent.
    pub(super) now: bool,
}

impl ImagePlan {
    /// Leaves out images beyond `budget`: keyframes first, then retrieved views, those of the window, and the current view
    /// last.
    pub(super) fn new(counts: ImageCounts, budget: u32) -> Self {
        let mut room = budget;
        let mut take = |wanted: u32| {
            let taken = wanted.min(room);
            room -= taken;
            taken
        };
        // Room is given in the reverse order.
        let now = take(1) == 1;
        let window = take(counts.window);
        let retrieved = take(counts.retrieved);
        let keyframes = take(counts.keyframes);
        Self { counts, sent: ImageCounts { keyframes, retrieved, window }, now }
    }

    /// Number of keyframes that are sent.
    pub(super) fn keyframes(&self) -> u32 {
        self.sent.keyframes
    }

    /// Number of retrieved views that are sent.
    pub(super) fn retrieved_views(&self) -> u32 {
        self.sent.retrieved
    }

    /// Number of images that are sent.
    pub(super) fn images(&self) -> u32 {
        let ImageCounts { keyframes, retrieved, window } = self.sent;
        keyframes + retrieved + window + u32::from(self.now)
    }

    /// Whether keyframe `index` is sent: the middle one of each of as many equal stretches as there is room for.
    pub(super) fn keyframe(&self, index: u32) -> bool {
        let (of, sent) = (u64::from(self.counts.keyframes), u64::from(self.sent.keyframes));
        // Stretch s has its middle at floor((2 s + 1) of / (2 sent)); `index` lies in stretch index * sent / of.
        let stretch = u64::from(index) * sent / of.max(1);
        [stretch, stretch + 1]
            .into_iter()
            .any(|s| s < sent && (2 * s + 1) * of / (2 * sent) == u64::from(index))
    }

    /// Whether retrieved view `index` is sent: the first ones are.
    pub(super) fn retrieved(&self, index: u32) -> bool {
        index < self.sent.retrieved
    }

    /// Whether view `index` of the window is sent: the latest ones are.
    pub(super) fn window(&self, index: u32) -> bool {
        index >= self.counts.window - self.sent.window
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(keyframes: u32, retrieved: u32, window: u32, budget: u32) -> String {
        let plan = ImagePlan::new(ImageCounts { keyframes, retrieved, window }, budget);
        let letters = |count, sent: &dyn Fn(u32) -> bool| -> String {
            (0..count).map(|index| if sent(index) { 'x' } else { '.' }).collect()
        };
        format!(
            "{} {} {} {}",
            letters(keyframes, &|index| plan.keyframe(index)),
            letters(retrieved, &|index| plan.retrieved(index)),
            letters(window, &|index| plan.window(index)),
            letters(1, &|_| plan.now),
        )
    }

    #[test]
    fn images_are_left_out_in_the_documented_order() {
        for (budget, expected) in [
            (20, "xxxxxxxx xxx xx x"),
            (14, "xxxxxxxx xxx xx x"),
            (13, "xxx.xxxx xxx xx x"),
            (10, ".x.x.x.x xxx xx x"),
            (7, "....x... xxx xx x"),
            (5, "........ xx. xx x"),
            (2, "........ ... .x x"),
            (1, "........ ... .. x"),
            (0, "........ ... .. ."),
        ] {
            assert_eq!(shown(8, 3, 2, budget), expected, "budget {budget}");
        }
        assert_eq!(shown(0, 0, 0, 50), "   x");
    }

    proptest::proptest! {
        #[test]
        fn exactly_as_many_are_sent_as_fit(
            keyframes in 0u32..200, retrieved in 0u32..9, window in 0u32..21, budget in 0u32..240,
        ) {
            let sent = shown(keyframes, retrieved, window, budget).matches('x').count() as u32;
            proptest::prop_assert_eq!(sent, budget.min(keyframes + retrieved + window + 1));
        }
    }
}

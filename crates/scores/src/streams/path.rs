//! How closely the agent's paths follow the references: t-nDTW.

use super::sequence::Sequence;

/// The distance at which a path counts as off the reference, in metres.
const THRESHOLD_M: f64 = 3.0;

/// t-nDTW of a sequence: `exp(-sum DTW(P, G) / (d sum |G|))` over its learning episodes, where P is an episode's path, G that of
/// its reference, and d is 3 m (J. Krantz et al., "Iterative vision-and-language navigation", CVPR 2023; nDTW: G. Ilharco
/// et al., 2019). Paths are aligned episode by episode, so no step is matched with another episode's. Distance and length are
/// facts that the world tells; `None` if it does not.
pub(super) fn t_ndtw(sequence: &Sequence<'_>) -> Option<f64> {
    let (mut distance_m, mut length) = (0.0, 0);
    for episode in sequence.learning() {
        let path = episode.record.shared_facts().path?;
        distance_m += path.distance_m;
        length += path.length;
    }
    (length > 0).then(|| (-distance_m / (THRESHOLD_M * f64::from(length))).exp())
}

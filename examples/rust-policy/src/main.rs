//! A policy of your own in Rust. Build it, and let MemTransfer start it:
//!
//! ```sh
//! cargo build --release
//! memtransfer run --policy-cmd examples/rust-policy/target/release/rust-policy
//! ```

use peer::{
    Action, ActionCode, Decision, Feedback, FrameView, Policy, Request, serve_from_environment,
};

/// Follows memory, and otherwise moves towards the light.
struct Wanderer;

impl Policy for Wanderer {
    fn name(&self) -> &str {
        "wanderer"
    }

    // All requests that wait now, each of another episode: a policy that asks a model can send all of its requests at
    // once. Return one decision for each, in the same order.
    fn act(&mut self, batch: &[Request<'_>]) -> Vec<Decision> {
        batch.iter().map(|request| Decision::act(request, decide(request))).collect()
    }
}

// Decide from the request alone: a run can be repeated if equal requests get equal actions.
fn decide(request: &Request<'_>) -> ActionCode {
    // Episodic memory: the demonstrated view that is most like the current one, and what the expert did there.
    let demonstrated = request.segments().find_map(|segment| segment.steps.first()?.action);
    if let Some(action) = demonstrated {
        return action;
    }
    // The feedback on the last action. Codes are those of the run's world, here of the warehouse.
    if request.feedback == Feedback::Blocked.into() {
        return Action::TurnLeft.into();
    }
    // The current view: 8-bit RGB, rows from top to bottom.
    let width = request.frame.width;
    let [left, ahead, right] = [0, 1, 2].map(|third| brightness(request.frame, third * width / 3));
    let action = if ahead >= left.max(right) {
        Action::Forward
    } else if left > right {
        Action::TurnLeft
    } else {
        Action::TurnRight
    };
    action.into()
}

/// Brightness of the third of the view that starts at column `from`. Samples every eighth pixel.
fn brightness(view: FrameView<'_>, from: u32) -> u32 {
    let columns = (from..from + view.width / 3).step_by(8);
    let pixels = columns.flat_map(|x| (0..view.height).step_by(8).map(move |y| view.rgb(x, y)));
    pixels.flatten().map(u32::from).sum()
}

fn main() {
    // Joins the run in $MEMTRANSFER_ATTACH and decides until the run ends.
    if let Err(error) = serve_from_environment(&mut Wanderer) {
        eprintln!("rust-policy: {error}");
        std::process::exit(2);
    }
}

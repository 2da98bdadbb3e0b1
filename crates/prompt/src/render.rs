//! Renders a request in the words of the template.

use domain::{Action, DocumentKind};
use peer::{DocumentView, FrameView, Request, Segment, Trajectory};

use super::budget::{ImageCounts, ImagePlan};
use super::template::{Template, fill};
use super::{PartContent, Prompt, PromptPart, PromptSection};

/// The prompt for `request` in the words of `template`.
pub(super) fn prompt<'a>(
    template: &'static Template,
    request: &Request<'a>,
    image_budget: u32,
) -> Prompt<'a> {
    let mut writer = Writer { template, section: PromptSection::Memory, parts: Vec::new() };
    let plan = ImagePlan::new(counts(request), image_budget);
    writer.memory(request, &plan);
    writer.section = PromptSection::Task;
    writer.fill(&template.task.text, &[("instruction", request.instruction)]);
    writer.section = PromptSection::Window;
    writer.window(request, &plan);
    writer.section = PromptSection::Now;
    writer.now(request, &plan);
    Prompt { system: &template.system, parts: writer.parts, images_asked: request.images() }
}

fn counts(request: &Request<'_>) -> ImageCounts {
    let retrieved = request.segment.map_or(0, |segment| segment.steps.len() as u32);
    let window = request.window.len() as u32;
    ImageCounts { keyframes: request.images() - retrieved - window - 1, retrieved, window }
}

struct Writer<'a> {
    template: &'static Template,
    section: PromptSection,
    parts: Vec<PromptPart<'a>>,
}

impl<'a> Writer<'a> {
    fn text(&mut self, text: &str) {
        match self.parts.last_mut() {
            Some(PromptPart { section, content: PartContent::Text(so_far) })
                if *section == self.section =>
            {
                so_far.push_str(text);
            }
            _ if text.is_empty() => {}
            _ => self.push(PartContent::Text(text.to_owned())),
        }
    }

    fn fill(&mut self, text: &str, values: &[(&str, &str)]) {
        self.text(&fill(text, values));
    }

    fn view(&mut self, view: FrameView<'a>, sent: bool) {
        if sent {
            self.push(PartContent::View(view));
        } else {
            self.text(&self.template.view_not_shown);
        }
        self.text(&self.template.view.after);
    }

    fn push(&mut self, content: PartContent<'a>) {
        self.parts.push(PromptPart { section: self.section, content });
    }

    fn memory(&mut self, request: &Request<'a>, plan: &ImagePlan) {
        let texts = &self.template.memory;
        let Request { documents, trajectories, segment, .. } = *request;
        self.text(&texts.begin);
        if documents.is_empty() && trajectories.is_empty() && segment.is_none() {
            self.text(&texts.nothing);
        } else {
            documents.iter().for_each(|document| self.document(document));
            let mut keyframe = 0;
            for (index, trajectory) in trajectories.iter().enumerate() {
                let number = (index + 1).to_string();
                let count = trajectories.len().to_string();
                let values = [("number", number.as_str()), ("count", &count)];
                self.fill(&texts.demonstration_begin, &values);
                self.demonstration(trajectory, &mut keyframe, plan);
                self.text(&texts.demonstration_end);
            }
            if request.starts_as_demonstrated {
                self.text(&texts.hint);
            }
            if let Some(segment) = segment {
                self.retrieved(&segment, plan);
            }
        }
        self.text(&texts.end);
    }

    fn document(&mut self, &DocumentView { kind, text, .. }: &DocumentView<'_>) {
        let texts = &self.template.memory;
        let name = match kind {
            DocumentKind::Summary => &texts.summary,
            // The SDK supplies documents of these two kinds only.
            DocumentKind::Semantic | DocumentKind::Trajectories => &texts.semantic,
        };
        self.fill(&texts.document, &[("name", name), ("text", text)]);
    }

    /// The views of a demonstration, and between two of them the actions that led from one to the other.
    fn demonstration(&mut self, trajectory: &Trajectory<'a>, keyframe: &mut u32, plan: &ImagePlan) {
        let mut actions = Vec::new();
        let mut taken: usize = 0;
        for step in trajectory.steps {
            if let Some(view) = step.frame {
                self.actions(&mut actions);
                let text = &self.template.memory.demonstration_view;
                self.fill(text, &[("step", &taken.to_string())]);
                self.view(view, plan.keyframe(*keyframe));
                *keyframe += 1;
            }
            actions.extend(step.action);
            taken += usize::from(step.action.is_some());
        }
        self.actions(&mut actions);
    }

    /// Writes `actions`, if there are any, and clears them.
    fn actions(&mut self, actions: &mut Vec<Action>) {
        if actions.is_empty() {
            return;
        }
        let template = self.template;
        let runs = actions.chunk_by(|a, b| a == b).map(|run| {
            let action = template.action(run[0]);
            let times = run.len().to_string();
            match run.len() {
                1 => action.to_owned(),
                _ => fill(&template.memory.several, &[("action", action), ("times", &times)]),
            }
        });
        let runs = runs.collect::<Vec<_>>().join(&template.memory.then);
        self.fill(&template.memory.demonstration_actions, &[("actions", &runs)]);
        actions.clear();
    }

    fn retrieved(&mut self, segment: &Segment<'a>, plan: &ImagePlan) {
        let template = self.template;
        let texts = &template.memory;
        let distance = match segment.distance {
            // Rounding can make the distance of equal views slightly negative.
            distance if distance.is_finite() => format!("{:.3}", distance.max(0.0)),
            _ => texts.unknown_distance.clone(),
        };
        self.fill(&texts.retrieved_begin, &[("distance", &distance)]);
        let mut led_here = None;
        for (index, step) in segment.steps.iter().enumerate() {
            if index > 0 {
                self.text(match led_here {
                    Some(_) => &texts.retrieved_view,
                    None => &texts.retrieved_view_alone,
                });
            }
            self.view(step.frame, plan.retrieved(index as u32));
            if let Some(action) = step.action {
                self.fill(&texts.retrieved_action, &[("action", template.action(action))]);
            }
            led_here = step.action;
        }
        self.text(&texts.retrieved_end);
    }

    fn window(&mut self, request: &Request<'a>, plan: &ImagePlan) {
        let template = self.template;
        let texts = &template.window;
        self.text(&texts.begin);
        if request.window.is_empty() {
            self.text(&texts.nothing);
        }
        let count = request.window.len().to_string();
        for (index, past) in request.window.iter().enumerate() {
            let number = (index + 1).to_string();
            self.fill(&texts.view, &[("number", &number), ("count", &count)]);
            self.view(past.frame, plan.window(index as u32));
            let action = past.action.map_or(texts.no_action.as_str(), |done| template.action(done));
            let feedback = template.feedback(past.feedback);
            self.fill(&texts.step, &[("action", action), ("feedback", feedback)]);
        }
        self.text(&texts.end);
    }

    fn now(&mut self, request: &Request<'a>, plan: &ImagePlan) {
        let texts = &self.template.now;
        let cell = request.pose.cell;
        let (column, row) = (cell.x.to_string(), cell.y.to_string());
        let values = [
            ("column", column.as_str()),
            ("row", &row),
            ("heading", self.template.heading(request.pose.heading)),
            ("feedback", self.template.feedback(request.feedback)),
        ];
        self.fill(&texts.begin, &values);
        self.view(request.frame, plan.now);
        self.text(&texts.end);
    }
}

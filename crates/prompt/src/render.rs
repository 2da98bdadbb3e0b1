//! Renders a request in the words of the template.

use case_book::fill;
use domain::{ActionCode, DocumentKind};
use peer::{
    CaptionedView, FrameView, Item, PlanView, Request, StepsView, TextView, WorldDeclaration,
};

use super::budget::{ImageCounts, ImagePlan};
use super::template::Texts;
use super::{PartContent, Prompt, PromptPart, PromptSection};

/// The prompt for `request` in the words of `template`.
pub(super) fn prompt<'a>(template: &Texts, request: &Request<'a>, image_budget: u32) -> Prompt<'a> {
    let plan = ImagePlan::new(counts(request), image_budget);
    let section = PromptSection::Memory;
    let mut writer = Writer {
        template,
        world: request.world,
        plan,
        section,
        images: 0,
        keyframes: 0,
        retrieved: 0,
        parts: Vec::new(),
    };
    writer.memory(request);
    writer.section = PromptSection::Task;
    writer.fill(&template.task.text, &[("instruction", request.instruction)]);
    writer.section = PromptSection::Window;
    writer.window(request);
    writer.section = PromptSection::Now;
    writer.now(request);
    let system = system(template, request.world);
    Prompt { system, parts: writer.parts, images_asked: request.images() }
}

/// The system message: the same for all requests of a world.
fn system(template: &Texts, world: &WorldDeclaration) -> String {
    let actions = action_list(world, "\n");
    let values = [("rules", world.rules.as_str()), ("actions", &actions)];
    fill(&template.system, &[&values[..], &template.words.of(&world.name)].concat())
}

/// The words of all actions.
fn action_list(world: &WorldDeclaration, separator: &str) -> String {
    let words: Vec<&str> = world.action_codes().map(|code| world.action_words(code)).collect();
    words.join(separator)
}

fn counts(request: &Request<'_>) -> ImageCounts {
    let images = |is_keyframe: bool| {
        let items = request.items.iter().filter(|item| item.trajectory().is_some() == is_keyframe);
        items.map(Item::images).sum::<usize>() as u32
    };
    let window = request.window.len() as u32;
    ImageCounts { keyframes: images(true), retrieved: images(false), window }
}

/// What the cosine distance of opposite embeddings may be, with rounding.
const LARGEST_COSINE_DISTANCE: f32 = 2.0005;

/// How steps of a demonstration are worded.
#[derive(Clone, Copy, PartialEq, Eq)]
enum StepsWording {
    /// A demonstration that is supplied whole.
    Demonstration,
    /// The remembered view that is most like the current one, or several such views, and what followed.
    Retrieved,
    /// Any other part of a demonstration.
    Part,
}

impl StepsWording {
    fn of(steps: &StepsView<'_>) -> Self {
        if steps.is_trajectory() {
            Self::Demonstration
        } else if steps.distance.is_some() && steps.steps.iter().all(|step| step.frame.is_some()) {
            Self::Retrieved
        } else {
            Self::Part
        }
    }
}

struct Writer<'t, 'a> {
    template: &'t Texts,
    world: &'a WorldDeclaration,
    plan: ImagePlan,
    section: PromptSection,
    /// Images so far.
    images: u32,
    /// Keyframes so far.
    keyframes: u32,
    /// Other views from memory so far.
    retrieved: u32,
    parts: Vec<PromptPart<'a>>,
}

impl<'a> Writer<'_, 'a> {
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
        let words = self.template.words.of(&self.world.name);
        self.text(&fill(text, &[values, &words[..]].concat()));
    }

    fn view(&mut self, view: FrameView<'a>, sent: bool) {
        let texts = &self.template.view;
        if sent {
            self.images += 1;
            self.fill(&texts.label, &[("image", &self.images.to_string())]);
            self.push(PartContent::View(view));
        } else {
            self.text(&texts.not_shown);
        }
        self.text(&texts.after);
    }

    fn push(&mut self, content: PartContent<'a>) {
        self.parts.push(PromptPart { section: self.section, content });
    }

    fn keyframe(&mut self, view: FrameView<'a>) {
        self.view(view, self.plan.keyframe(self.keyframes));
        self.keyframes += 1;
    }

    fn retrieved_view(&mut self, view: FrameView<'a>) {
        self.view(view, self.plan.retrieved(self.retrieved));
        self.retrieved += 1;
    }

    fn memory(&mut self, request: &Request<'a>) {
        let texts = &self.template.memory;
        self.text(&texts.begin);
        if request.items.is_empty() {
            self.fill(&texts.nothing, &[]);
        } else if request.demonstrated_elsewhere {
            self.text(&texts.elsewhere);
        }
        // The hint is about demonstrations: after the demonstrations, before what was retrieved for this step.
        let shows_walk = request.items.iter().any(|item| self.shows_walk(item));
        let hint_at = (request.starts_as_demonstrated && shows_walk).then(|| {
            let first = request.items.iter().position(|item| item.segment().is_some());
            first.unwrap_or(request.items.len())
        });
        for (index, item) in request.items.iter().enumerate() {
            if hint_at == Some(index) {
                self.fill(&texts.hint, &[]);
            }
            match item {
                Item::Text(text) => self.document(text),
                Item::Frame(captioned) => self.captioned(captioned),
                Item::Steps(steps) => self.steps(steps, &request.items[..index], request.items),
                Item::Plan(plan) => self.plan(plan, &request.items[..index], request.items),
            }
        }
        if hint_at == Some(request.items.len()) {
            self.fill(&texts.hint, &[]);
        }
        self.text(&texts.end);
    }

    /// Whether the prompt shows more of a demonstration than a single view.
    fn shows_walk(&self, item: &Item<'_>) -> bool {
        let Item::Steps(steps) = item else { return false };
        let sent =
            if steps.is_trajectory() { self.plan.keyframes() } else { self.plan.retrieved_views() };
        steps.steps.iter().any(|step| step.action.is_some()) || sent.min(item.images() as u32) > 1
    }

    fn document(&mut self, &TextView { kind, text, .. }: &TextView<'_>) {
        let texts = &self.template.memory;
        let name = match kind {
            DocumentKind::Summary => &texts.summary,
            DocumentKind::Semantic => &texts.semantic,
            // The SDK supplies texts only.
            DocumentKind::Note | DocumentKind::Trajectories => {
                return self.fill(&texts.note, &[("text", text)]);
            }
        };
        self.fill(&texts.document, &[("name", name), ("text", text)]);
    }

    fn captioned(&mut self, &CaptionedView { frame, caption, instruction }: &CaptionedView<'a>) {
        let texts = &self.template.memory;
        self.fill(&texts.captioned_begin, &[("instruction", instruction)]);
        if !caption.is_empty() {
            self.fill(&texts.caption, &[("caption", caption)]);
        }
        self.retrieved_view(frame);
        self.text(&texts.captioned_end);
    }

    /// Writes steps that come after the items `before`, of `all`. Items that are worded alike are numbered.
    fn steps(&mut self, steps: &StepsView<'a>, before: &[Item<'a>], all: &[Item<'a>]) {
        let texts = &self.template.memory;
        let wording = StepsWording::of(steps);
        let alike = |items: &[Item<'_>]| {
            let is_alike =
                |item: &&Item<'_>| matches!(item, Item::Steps(s) if StepsWording::of(s) == wording);
            items.iter().filter(is_alike).count()
        };
        let (number, count) = (alike(before) + 1, alike(all));
        let (begin, end) = match wording {
            StepsWording::Demonstration => (&texts.demonstration_begin, &texts.demonstration_end),
            StepsWording::Retrieved if count == 1 => (&texts.retrieved_begin, &texts.retrieved_end),
            StepsWording::Retrieved => (&texts.one_retrieved_begin, &texts.retrieved_end),
            StepsWording::Part => (&texts.part_begin, &texts.part_end),
        };
        let values = [
            ("number", number.to_string()),
            ("count", count.to_string()),
            ("distance", self.distance(steps.distance.unwrap_or_default())),
            ("current_view", self.current_view()),
            ("instruction", steps.instruction.to_owned()),
        ];
        self.fill(begin, &values.each_ref().map(|(name, value)| (*name, value.as_str())));
        match wording {
            StepsWording::Retrieved => self.retrieved(steps),
            StepsWording::Demonstration | StepsWording::Part => self.walk(steps),
        }
        self.fill(end, &[]);
    }

    /// Writes a plan that comes after the items `before`, of `all`.
    fn plan(&mut self, plan: &PlanView<'a>, before: &[Item<'a>], all: &[Item<'a>]) {
        let texts = &self.template.memory;
        let plans = |items: &[Item<'_>]| items.iter().filter_map(Item::plan).count();
        let (number, count) = ((plans(before) + 1).to_string(), plans(all).to_string());
        self.fill(&texts.plan_begin, &[("number", &number), ("count", &count)]);
        for part in plan.parts {
            let actions = self.action_runs(part.actions);
            match part.instruction {
                Some(instruction) => {
                    let values = [("actions", actions.as_str()), ("instruction", instruction)];
                    self.fill(&texts.plan_part, &values);
                }
                None => self.fill(&texts.plan_own, &[("actions", &actions)]),
            }
        }
        self.fill(&texts.plan_end, &[]);
    }

    /// A distance with its scale.
    fn distance(&self, distance: f32) -> String {
        let texts = &self.template.memory;
        let is_cosine = distance < LARGEST_COSINE_DISTANCE;
        let text = if is_cosine { &texts.cosine_distance } else { &texts.other_distance };
        // Rounding can make the distance of equal views slightly negative.
        fill(text, &[("number", &format!("{:.3}", distance.max(0.0)))])
    }

    /// The current view, as other texts refer to it. Its image is the last one.
    fn current_view(&self) -> String {
        let texts = &self.template.view;
        if !self.plan.now {
            return texts.current_not_shown.clone();
        }
        fill(&texts.current, &[("image", &self.plan.images().to_string())])
    }

    /// The views of a demonstration, and between two of them the actions that led from one to the other.
    fn walk(&mut self, steps: &StepsView<'a>) {
        let is_trajectory = steps.is_trajectory();
        let mut actions = Vec::new();
        for (index, step) in steps.steps.iter().enumerate() {
            if let Some(view) = step.frame {
                self.actions(&mut actions);
                let text = &self.template.memory.demonstration_view;
                self.fill(text, &[("step", &index.to_string())]);
                if is_trajectory { self.keyframe(view) } else { self.retrieved_view(view) }
            }
            actions.extend(step.action);
        }
        self.actions(&mut actions);
    }

    /// Writes `actions`, if there are any, and clears them.
    fn actions(&mut self, actions: &mut Vec<ActionCode>) {
        if actions.is_empty() {
            return;
        }
        let runs = self.action_runs(actions);
        self.fill(&self.template.memory.demonstration_actions, &[("actions", &runs)]);
        actions.clear();
    }

    /// The words of actions; a repeated one is written once, with the number of times.
    fn action_runs(&self, actions: &[ActionCode]) -> String {
        let (template, world) = (self.template, self.world);
        let runs = actions.chunk_by(|a, b| a == b).map(|run| {
            let action = world.action_words(run[0]);
            let times = run.len().to_string();
            match run.len() {
                1 => action.to_owned(),
                _ => fill(&template.memory.several, &[("action", action), ("times", &times)]),
            }
        });
        runs.collect::<Vec<_>>().join(&template.memory.then)
    }

    fn retrieved(&mut self, steps: &StepsView<'a>) {
        let template = self.template;
        let texts = &template.memory;
        let mut led_here = None;
        for (index, step) in steps.steps.iter().enumerate() {
            if index > 0 {
                self.text(match led_here {
                    Some(_) => &texts.retrieved_view,
                    None => &texts.retrieved_view_alone,
                });
            }
            if let Some(view) = step.frame {
                self.retrieved_view(view);
            }
            if let Some(action) = step.action {
                self.fill(&texts.retrieved_action, &[("action", self.world.action_words(action))]);
            }
            led_here = step.action;
        }
    }

    fn window(&mut self, request: &Request<'a>) {
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
            self.view(past.frame, self.plan.window(index as u32));
            let action = past.action;
            let action =
                action.map_or(texts.no_action.as_str(), |done| self.world.action_words(done));
            let feedback = self.world.feedback_sentence(past.feedback);
            self.fill(&texts.step, &[("action", action), ("feedback", feedback)]);
        }
        self.text(&texts.end);
    }

    fn now(&mut self, request: &Request<'a>) {
        let texts = &self.template.now;
        let state = self.world.sentence(&request.state);
        let feedback = self.world.feedback_sentence(request.feedback);
        self.fill(&texts.begin, &[("state", &state), ("feedback", feedback)]);
        self.view(request.frame, self.plan.now);
        self.fill(&texts.end, &[("actions", &action_list(self.world, ", "))]);
    }
}

//! The documents of a run: which it needs, and building missing ones before it begins.

use std::collections::BTreeMap;

use anyhow::{Error, Result, anyhow, bail};
use conditions::cost::ModelPrices;
use conditions::settings::{DocumentSource, ModelSettings, RunSettings};
use documents::asking::BuildEstimate;
use documents::{
    DocumentFolder, DocumentName, DocumentSelection, DocumentState, ModelRecipe, Recipe, Sources,
    StoredDocument,
};
use domain::{shell_word, tokens};
use run_log::usage::UsageTotals;
use run_log::{DOCUMENTS_FOLDER, DocumentFacts, RunFolder, RunLog};

use crate::books::Books;
use crate::budget::Budget;
use crate::documents::{DocumentRequest, ModelServer, OwnWorld, ReadyDocuments, facts, needed};
use crate::invocation::Invocation;
use crate::progress::{BuildProgress, Verbosity, say};
use crate::run_plan::RunPlan;

/// The shortest time limit of an attempt to have a document written, in seconds: an answer is as long as a document, where a
/// decision is a few tokens.
const LEAST_TIMEOUT: u32 = 300;

/// The documents of a run, or why it has none.
#[derive(Debug)]
pub enum DocumentSupply {
    /// They are there.
    Ready(ReadyDocuments),
    /// The run was asked to stop while they were being built.
    Stopped,
    /// Building them would take more than the run may spend, or has: the reason.
    OverBudget(String),
}

/// Records documents that the run's model has written.
pub type RecordDocuments<'a> = dyn FnMut(BTreeMap<String, DocumentFacts>) -> Result<()> + 'a;

/// The documents that a run needs, and where they come from.
#[derive(Debug)]
pub struct RunDocuments {
    needed: Vec<DocumentName>,
    request: DocumentRequest,
    /// The run's own copies; none before it has episodes.
    own: Option<DocumentFolder>,
}

impl RunDocuments {
    /// The documents of a run with `settings` and `books`, which starts over if `fresh`.
    pub fn of(settings: &RunSettings, books: &Books, fresh: bool) -> Self {
        let (folder, selection) = match (&settings.documents, &settings.model) {
            (DocumentSource::Extractive, _) => {
                (None, DocumentSelection::Recipe(Recipe::Extractive))
            }
            (DocumentSource::Model(None), Some(model)) => {
                (None, DocumentSelection::Recipe(Recipe::Model(recipe(settings, model))))
            }
            (DocumentSource::Model(name), _) => (None, DocumentSelection::Model(name.clone())),
            (DocumentSource::Folder(path), _) => (Some(path.clone()), DocumentSelection::Any),
        };
        let request = DocumentRequest {
            folder,
            sources: Sources::new(
                books.demonstrations.book.clone(),
                settings.frame_size,
                settings.appearance(),
            ),
            assets: settings.assets.clone(),
            elsewhere: books.elsewhere.clone(),
            own_world: settings
                .own_world()
                .map(|_| OwnWorld::of(settings.world_cmd.clone(), &books.cases.book)),
            selection,
            server: settings.model.as_ref().map(server).unwrap_or_default(),
        };
        let uses_memory = settings.policy.has_process();
        let own = (!fresh && RunFolder::has_episodes(&settings.out))
            .then(|| DocumentFolder::new(settings.out.join(DOCUMENTS_FOLDER)));
        Self {
            needed: if uses_memory { needed(settings, &settings.conditions()) } else { Vec::new() },
            request,
            own,
        }
    }

    /// Returns the documents of the run `plan`: the run's own copies, and the others as requested, built if they are missing.
    /// `record` gets the manifest's entries so far when the run's model has written one.
    ///
    /// # Errors
    /// When a document is broken, missing without a recipe for it, or cannot be built or recorded.
    pub fn supply(
        &self,
        plan: &RunPlan,
        invocation: &Invocation<'_>,
        record: &mut RecordDocuments<'_>,
    ) -> Result<DocumentSupply> {
        let mut documents = self.own_copies();
        let others: Vec<DocumentName> = self.without(&documents);
        if others.is_empty() {
            return Ok(DocumentSupply::Ready(ReadyDocuments::unlocked(documents)));
        }
        let supply = match &self.request.selection {
            DocumentSelection::Recipe(Recipe::Model(recipe)) => {
                self.written_by_model(recipe, &others, plan, invocation, record)?
            }
            _ => {
                let progress = BuildProgress::new(invocation.verbosity);
                self.ensure(&self.request, &others, progress, invocation)?
            }
        };
        let DocumentSupply::Ready(mut ready) = supply else { return Ok(supply) };
        if !ready.built.is_empty() && invocation.verbosity == Verbosity::Progress {
            let folder = self.request.folder()?;
            say(&format!("built {} in {}", listed(&ready.built), folder.path().display()));
        }
        documents.append(&mut ready.documents);
        ready.documents = documents;
        Ok(DocumentSupply::Ready(ready))
    }

    /// The documents `wanted`; those that are missing are written by the run's model, one after the other, as far as the run may
    /// spend it.
    fn written_by_model(
        &self,
        recipe: &ModelRecipe,
        wanted: &[DocumentName],
        plan: &RunPlan,
        invocation: &Invocation<'_>,
        record: &mut RecordDocuments<'_>,
    ) -> Result<DocumentSupply> {
        let missing = self.request.missing(wanted, false)?;
        let mut ready = ReadyDocuments::unlocked(Vec::new());
        if let (Some(first), Some(unit)) = (missing.first(), &plan.unit) {
            // Every machine would have another one written.
            bail!(
                "document {first} of the plan is missing in {}, and unit {} does not have the model write another one. Make the \
                 plan with --store, which brings the documents, or copy them from the cache folder of the machine that made it",
                self.request.folder()?.path().display(),
                unit.number
            );
        }
        let mut budget = self.budget(plan, invocation.fresh)?;
        let mut request = self.request.clone();
        let estimates =
            missing.iter().map(|name| BuildEstimate::of(*name, &self.request.sources, recipe));
        let estimates: Vec<BuildEstimate> = estimates.collect();
        if !missing.is_empty() {
            (invocation.before_asking)(&plan.settings)?;
            request.server.base_url_from = invocation.base_url_from;
            if invocation.verbosity == Verbosity::Progress {
                let all = estimates.iter().copied().sum();
                let estimate = in_words(&all, plan.prices.as_ref());
                say(&format!("{} writes {} first: {estimate}", recipe.model, listed(&missing)));
            }
        }
        for &name in wanted {
            let place = missing.iter().position(|one| *one == name);
            let refused = place.and_then(|place| {
                let [least, _] = totals(&estimates[place]);
                budget.exceeded().or_else(|| budget.too_small(&format!("document {name}"), &least))
            });
            if let Some(why) = refused {
                return Ok(DocumentSupply::OverBudget(why));
            }
            let title = place.map(|place| {
                format!("writing document {name} ({} of {})", place + 1, missing.len())
            });
            let progress = BuildProgress::titled(invocation.verbosity, title);
            let supply = self.ensure(&request, &[name], progress, invocation);
            let advised =
                |error: Error| anyhow!("{error:#}\n{}", how_to_write_otherwise(name, recipe));
            match supply.map_err(advised)? {
                DocumentSupply::Ready(more) => ready.add(more),
                other => return Ok(other),
            }
            let facts = ready.facts();
            if let Some(document) = facts.get(&name.to_string()).filter(|document| document.built) {
                document.usage.iter().for_each(|usage| budget.count(&usage.totals()));
                record(facts)?;
            }
        }
        Ok(DocumentSupply::Ready(ready))
    }

    /// The documents `wanted` of `request`, built if they are missing and there is a recipe for them.
    fn ensure(
        &self,
        request: &DocumentRequest,
        wanted: &[DocumentName],
        mut progress: BuildProgress,
        invocation: &Invocation<'_>,
    ) -> Result<DocumentSupply> {
        let report = &mut |stage| progress.show(stage);
        let ready = request.ensure(wanted, false, invocation.stop, report);
        progress.close(matches!(ready, Ok(Some(_))));
        Ok(ready?.map_or(DocumentSupply::Stopped, DocumentSupply::Ready))
    }

    /// What the run may still spend: sessions before this one count, also if they were stopped before the first episode.
    fn budget(&self, plan: &RunPlan, fresh: bool) -> Result<Budget> {
        let out = &plan.settings.out;
        let model = plan.settings.model.as_ref();
        let is_limited =
            model.is_some_and(|of| of.max_tokens_total.is_some() || of.max_cost.is_some());
        let is_begun = is_limited && !fresh && out.join("manifest.json").exists();
        let earlier = is_begun.then(|| RunLog::read(out)).transpose()?;
        let earlier = match earlier {
            Some(log) if plan.manifest()?.differences(&log.manifest).is_empty() => Some(log),
            _ => None,
        };
        let past = earlier.as_ref().map_or(&[][..], |log| &log.requests);
        let mut budget = Budget::new(model, plan.prices.as_ref(), past);
        earlier.iter().for_each(|log| budget.count(&log.manifest.built_usage()));
        Ok(budget)
    }

    /// The manifest's entries as they would be now: of the run's own copies, and of the others that can be used.
    pub fn facts_now(&self) -> BTreeMap<String, DocumentFacts> {
        facts(&self.usable())
    }

    /// Sizes of the texts that are ready, in bytes.
    pub fn sizes(&self) -> BTreeMap<DocumentName, u64> {
        let usable = self.usable().into_iter();
        usable
            .filter_map(|stored| Some((stored.name, stored.document?.text.len() as u64)))
            .collect()
    }

    /// As [`Self::sizes`]; of those that the run's model writes the most that they can have.
    pub fn largest_sizes(&self) -> BTreeMap<DocumentName, u64> {
        let mut sizes = self.sizes();
        if let Some(recipe) = self.recipe_of_model() {
            let most = (f64::from(recipe.max_tokens) * tokens::DOCUMENT) as u64;
            sizes.extend(self.missing().into_iter().map(|name| (name, most)));
        }
        sizes
    }

    /// What the documents would take that the run's model writes, as they are missing.
    pub fn estimates(&self) -> Vec<(DocumentName, BuildEstimate)> {
        let Some(recipe) = self.recipe_of_model() else { return Vec::new() };
        let missing = self.missing().into_iter();
        missing.map(|name| (name, BuildEstimate::of(name, &self.request.sources, recipe))).collect()
    }

    /// How the run's own model is asked for documents; `None` if it is not.
    fn recipe_of_model(&self) -> Option<&ModelRecipe> {
        match &self.request.selection {
            DocumentSelection::Recipe(Recipe::Model(recipe)) => Some(recipe),
            _ => None,
        }
    }

    /// The documents that can be used as they are.
    pub fn ready(&self) -> Vec<DocumentName> {
        self.usable().iter().map(|stored| stored.name).collect()
    }

    /// The documents that cannot be used yet.
    pub fn missing(&self) -> Vec<DocumentName> {
        self.without(&self.usable())
    }

    /// Whether the run builds those that are missing.
    pub fn builds_missing(&self) -> bool {
        matches!(self.request.selection, DocumentSelection::Recipe(_))
    }

    /// The run's own copies of needed documents.
    fn own_copies(&self) -> Vec<StoredDocument> {
        let Some(own) = &self.own else { return Vec::new() };
        let load = |&name: &DocumentName| {
            let document = own.load_run_copy(name).ok()?;
            Some(StoredDocument::current(own.run_copy(name), document))
        };
        self.needed.iter().filter_map(load).collect()
    }

    /// The run's own copies, and the other documents that can be used as they are. A request that cannot be read has none:
    /// [`Self::supply`] reports why.
    fn usable(&self) -> Vec<StoredDocument> {
        let mut documents = self.own_copies();
        let others = self.request.find(&self.without(&documents)).unwrap_or_default().into_iter();
        documents.extend(others.filter(|stored| stored.state == DocumentState::Current));
        documents
    }

    /// The needed documents that are not among `documents`.
    fn without(&self, documents: &[StoredDocument]) -> Vec<DocumentName> {
        let is_missing =
            |name: &&DocumentName| documents.iter().all(|stored| stored.name != **name);
        self.needed.iter().filter(is_missing).copied().collect()
    }
}

/// How the run's own model is asked for documents: as for decisions.
fn recipe(settings: &RunSettings, model: &ModelSettings) -> ModelRecipe {
    let recipe = ModelRecipe::new(&*model.model);
    // A world that the user starts draws nothing before the run.
    let has_views = model.image_budget > 0 && settings.world_book.is_none();
    ModelRecipe {
        views: if has_views { recipe.views } else { 0 },
        image_budget: model.image_budget,
        reasoning: model.reasoning,
        system_role: model.system_role,
        extra_body: model.extra_body.clone(),
        image_format: model.image_format,
        ..recipe
    }
}

/// The server of the run's own model.
fn server(model: &ModelSettings) -> ModelServer {
    ModelServer {
        base_url: model.base_url.clone(),
        base_url_from: None,
        headers: model.header.clone(),
        timeout: Some(model.request_timeout.max(LEAST_TIMEOUT)),
        max_retries: Some(model.max_retries),
    }
}

/// What a document would take, at least and at most, as sums of requests.
pub fn totals(estimate: &BuildEstimate) -> [UsageTotals; 2] {
    [0, 1].map(|bound| UsageTotals {
        requests: estimate.requests[bound],
        attempts: estimate.requests[bound],
        prompt_tokens: estimate.prompt_tokens[bound],
        completion_tokens: estimate.answer_tokens[bound],
        ..UsageTotals::default()
    })
}

/// An estimate in one line.
fn in_words(estimate: &BuildEstimate, prices: Option<&ModelPrices>) -> String {
    let [least, most] = totals(estimate);
    let millions = |usage: &UsageTotals| usage.tokens() as f64 / 1e6;
    let cost = prices.map(|prices| {
        format!(", {} to {} {}", least.cost(prices), most.cost(prices), prices.currency)
    });
    let requests = match (least.requests, most.requests) {
        (least, most) if least == most => least.to_string(),
        (least, most) => format!("{least} to {most}"),
    };
    format!(
        "{requests} requests with {} images, {:.2} to {:.2} million tokens{} (an estimate)",
        estimate.images,
        millions(&least),
        millions(&most),
        cost.unwrap_or_default()
    )
}

/// Advice for a run whose model does not write a document as it is asked to.
fn how_to_write_otherwise(document: DocumentName, recipe: &ModelRecipe) -> String {
    let DocumentName { kind, demonstrations } = document;
    let ModelRecipe { context_chars, max_tokens, model, .. } = recipe;
    let model = shell_word(model);
    format!(
        "The run has asked for document {document} with prompts of {context_chars} characters and answers of {max_tokens} tokens. \
         If that is too much for the model, have it written with other limits (--context-chars, --max-tokens, --views), and use \
         it with --documents model:{model}:\n  \
         memtransfer memory build --builder model --model {model} --kind {} --demos {demonstrations}\n\
         --documents extractive needs no model",
        kind.word()
    )
}

/// Documents for a message: their names, or of many the number.
pub fn listed(names: &[DocumentName]) -> String {
    const MOST_NAMED: usize = 4;
    if names.len() > MOST_NAMED {
        return format!("{} documents", names.len());
    }
    names.iter().map(DocumentName::to_string).collect::<Vec<_>>().join(", ")
}
